"""Impact speeds of new contacts: exact where the motion is, right in distribution for a gas, seen without a trace."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from beds import BOX, D, G, model, scene, still
from scipy.optimize import brentq

from kncal.core.checks import Array
from kncal.engines.liggghts.impacts import (
    Before,
    Surface,
    count_speeds,
    mesh_speeds,
    pair_speeds,
    speed_edges,
    wall_speeds,
)
from kncal.engines.liggghts.library import LiggghtsDem
from kncal.engines.liggghts.library_child import WATCH_EVERY
from kncal.scene.contact import ContactChoice
from kncal.scene.groups import AT_REST
from kncal.scene.model import KINDS
from kncal.scene.placement import Start, lattice

solver = pytest.mark.solver
SMOOTH, ELASTIC = ContactChoice(e_n=0.9), ContactChoice(e_n=1.0)


def before(x: Array, v: Array, push: Array, radius: float | Array) -> Before:
    n = len(x)
    return Before(
        x=x, v=v, push=push, radius=np.broadcast_to(radius, n), kind=np.zeros(n, dtype=np.int64), row=np.arange(n)
    )


# --- the formula ------------------------------------------------------------------------------------------------------


def touch_speed(r: Array, w: Array, a: Array, d: float, dt: float) -> float:
    """Closing speed when |r + w t + a t²/2| = d, by bisection."""
    t = brentq(lambda t: np.linalg.norm(r + w * t + 0.5 * a * t * t) - d, 0.0, dt, xtol=1e-16)
    at, speed = r + w * t + 0.5 * a * t * t, w + a * t
    return float(-(at @ speed) / d)


def test_the_speed_at_touch_is_right_to_second_order_of_the_step() -> None:
    """Oblique, under a constant force: what is left is the change of the turning of the normal within a step."""
    d, w, a = 1.0, np.array([-0.8, 0.6, 0.0]), np.array([3.0, 1.0, 2.0])
    errors = []
    for dt in (4e-3, 2e-3, 1e-3):
        r = np.array([d, 0.3, 0.0]) / math.hypot(1.0, 0.3) * d
        r = r - 0.5 * dt * w  # it touches in the middle of the step, nearly
        x, v = np.stack([r, np.zeros(3)]), np.stack([w, np.zeros(3)])
        found = pair_speeds(before(x, v, np.stack([a, np.zeros(3)]), d / 2), np.array([0]), np.array([1]), (0, 0, 0))
        errors.append(abs(float(found.v[0]) - touch_speed(r, w, a, d, dt)))
    assert errors[-1] < 1e-6
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 1.7).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_pair_across_the_period_meets_as_any_other(axis: int) -> None:
    x, v = np.zeros((4, 3)), np.zeros((4, 3))
    x[:, axis], v[:, axis] = [0.01, 2.99, 1.0, 1.02], [-1.0, 1.0, 1.0, -1.0]
    pairs, periods = (np.array([0, 2]), np.array([1, 3])), [3.0 * (k == axis) for k in range(3)]
    assert pair_speeds(before(x, v, np.zeros_like(x), 0.0095), *pairs, periods).v == pytest.approx([2.0, 2.0])


def test_contacts_that_were_there_before_do_not_count() -> None:
    x = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.9], [0.0, 0.0, 1.95]])
    v = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, -3.0]])
    given = before(x, v, np.zeros_like(x), 0.5)
    assert pair_speeds(given, np.array([0, 1]), np.array([1, 2]), (0, 0, 0)).v == pytest.approx([2.0])
    floor = Surface(1, 2)
    lying = before(x, v, np.zeros_like(x), 0.2)  # the first lies through the floor all the time
    assert len(wall_speeds(lying, x, np.arange(3), floor).v) == 0
    falling = before(x + np.array([0.0, 0.0, 0.21]), v - np.array([0.0, 0.0, 1.0]), np.zeros_like(x), 0.2)
    assert wall_speeds(falling, x, np.arange(3), floor).v == pytest.approx([1.0])
    assert wall_speeds(falling, x, np.arange(3), floor).other.tolist() == [1]


def test_those_that_came_within_the_step_have_no_speed() -> None:
    x, nothing = np.array([[0.0, 0.0, 0.9], [0.0, 0.0, 1.8]]), np.zeros((2, 3))
    given = replace(before(x + 1.0, nothing, nothing, 0.5), row=np.array([0, -1]))
    assert not len(pair_speeds(given, np.array([0]), np.array([1]), (0, 0, 0)).v)
    assert not len(wall_speeds(given, x[1:] - 2.0, np.array([1]), Surface(1, 2)).v)


@pytest.mark.parametrize("rho", [0.7, 1.3])
def test_at_a_cylinder_the_speed_is_the_radial_one(rho: float) -> None:
    """A point of radius 0.2 that flies straight on, inside and outside: |R - |r + w t|| = 0.2, by bisection."""
    r, w, dt, side = np.array([rho, 0.0]), np.array([1.0 if rho < 1.0 else -1.0, 0.5]), 0.15, np.sign(1.0 - rho)

    def gap(t: float) -> float:
        return float(side * (1.0 - np.linalg.norm(r + w * t)) - 0.2)

    t = brentq(gap, 0.0, dt, xtol=1e-15)
    exact = side * float((r + w * t) @ w / np.linalg.norm(r + w * t))
    x, v = np.array([[0.3, *r]]), np.array([[2.0, *w]])
    given = before(x, v, np.zeros((1, 3)), 0.2)
    found = wall_speeds(given, x + v * dt, np.array([0]), Surface(2, 0, radius=1.0))
    assert found.v == pytest.approx([exact], rel=1e-2)  # third derivatives are left out
    assert found.other.tolist() == [2]


def row(mesh: int, triangle: int, number: int, point: Array, centre: Array, overlap: float) -> list[float]:
    return [*point, *centre, mesh, triangle, number, 0.0, 0.0, 0.0, overlap]


def test_at_a_moving_mesh_the_speed_is_that_at_which_the_gap_closes() -> None:
    """Under a constant acceleration, towards a plate that moves: both triangles of an edge are one contact."""
    radius, dt, a, w, plate = 0.1, 1e-3, -9.0, -2.0, 0.5
    t = 0.4 * dt  # of touch
    gap = -((w - plate) * t + 0.5 * a * t * t)
    z, z_now = radius + gap, radius + gap + w * dt + 0.5 * a * dt * dt
    given = before(np.array([[0.0, 0.0, z]]), np.array([[0.0, 0.0, w]]), np.array([[0.0, 0.0, a]]), radius)
    earlier = np.array([row(0, k, 1, np.zeros(3), np.array([0.0, 0.0, z]), -gap) for k in (3, 4)])
    overlap = plate * dt + radius - z_now
    now = np.array([row(0, 3, 1, np.array([0.0, 0.0, plate * dt]), np.array([0.0, 0.0, z_now]), overlap)])
    found = mesh_speeds(given, earlier, now, [5], dt)
    assert found.v == pytest.approx([-(w - plate) - a * t], rel=1e-9)
    assert found.other.tolist() == [5]
    assert not len(mesh_speeds(given, now, now, [5], dt).v)  # it was there before
    assert not len(mesh_speeds(given, earlier[:0], now[:0], [5], dt).v)


def test_every_speed_is_counted_in_its_bin() -> None:
    speeds = np.array([0.0, 1e-7, 1.00001e-5, 0.1234, 99.9, 1e4])
    counted = count_speeds(speeds)
    edges = speed_edges()
    assert len(edges) == len(counted) + 1
    inside = np.histogram(speeds.clip(max=99.99), edges)[0]
    assert counted.tolist() == inside.tolist()


# --- in LIGGGHTS ------------------------------------------------------------------------------------------------------


@solver
@pytest.mark.parametrize("kind", KINDS)
def test_drops_hit_the_floor_at_the_speed_of_their_fall(tmp_path: Path, kind: str) -> None:
    """Free flight is exact in LIGGGHTS: v_0 = sqrt(2 g h), whatever the contact law; no drop that is due is missed."""
    grid = np.stack(np.meshgrid(1.25 * D * (0.6 + np.arange(9)), 1.25 * D * (0.6 + np.arange(3))), -1).reshape(-1, 2)
    bed = scene(len(grid), box=replace(BOX, size=(0.015, 0.006, 0.03)), contact=SMOOTH)
    given = model(bed, kind)
    rounds = 25 + np.arange(len(grid))
    # every third comes down half way between two steps that are watched
    seen = np.arange(len(grid)) % 3 != 2
    time = (WATCH_EVERY * (rounds - 0.5 * ~seen) - 0.5) * given.dt
    start = np.column_stack([grid, 0.5 * D + 0.5 * G * time**2])
    watched = 0.0
    found: dict[int, float] = {}
    with LiggghtsDem(given, tmp_path, Start.at(start)) as dem:
        for number in range(1, int(rounds.max()) + 1):
            step = dem.run(WATCH_EVERY, still(bed))
            assert step.impacts[0].sum() == 0
            watched += step.watched
            if step.impacts[1].sum():
                found[number] = float(step.impact_sums[1, 0])
                assert step.impacts[1].sum() == 1
                speed = found[number]
                assert step.impact_sums[1] == pytest.approx([speed, speed**2, speed**3])
                (place,) = np.flatnonzero(step.impacts[1])
                assert dem.impact_edges[place] <= speed < dem.impact_edges[place + 1]
    # rebounds come down after 2.8 times the time of the first fall: none of them yet
    assert found == pytest.approx({int(n): G * t for n, t in zip(rounds[seen], time[seen], strict=True)}, rel=1e-9)
    assert watched == pytest.approx(rounds.max() * given.dt)


@solver
def test_oblique_pairs_meet_at_their_normal_speed(tmp_path: Path) -> None:
    """In free flight: v_0 = w sqrt(1 - (b/d)²) for the offset b; also across the periodic sides."""
    box = replace(BOX, size=(0.06, 0.006, 0.06))
    offsets = np.array([0.0, 0.3, 0.6, 0.9]) * D
    bed = scene(8, box=box, periodic=("y",), contact=SMOOTH, gravity=AT_REST)
    given = model(bed)
    speed = np.array([0.1, 0.4, 1.0, 2.0])
    time = (3 * WATCH_EVERY - 0.5) * given.dt
    x, v = np.zeros((8, 3)), np.zeros((8, 3))
    for k, (b, w) in enumerate(zip(offsets, speed, strict=True)):
        gap = math.sqrt(D * D - b * b) + w * time
        # the second of each pair rests just before the end of the period; the first comes from behind it, or over it
        x[2 * k + 1] = (0.01 * (k + 1), 0.0059, 0.03)
        x[2 * k] = (0.01 * (k + 1) + b, (0.0059 + gap) % 0.006, 0.03)
        v[2 * k, 1] = -w
    with LiggghtsDem(given, tmp_path, Start.at(x, v)) as dem:
        steps = [dem.run(WATCH_EVERY, still(bed)) for _ in range(3)]
    assert [step.impacts.sum() for step in steps] == [0, 0, 4]
    expected = speed * np.sqrt(1.0 - (offsets / D) ** 2)
    # the turning of the normal within a step: (w dt/d)² = 3e-4 of the fastest
    assert steps[-1].impact_sums[0, 0] == pytest.approx(expected.sum(), rel=1e-4)
    assert steps[-1].impact_sums[0, 2] == pytest.approx((expected**3).sum(), rel=3e-4)


@solver
@pytest.mark.parametrize("kind", KINDS)
def test_impacts_in_a_gas_are_those_of_kinetic_theory(tmp_path: Path, kind: str) -> None:
    """p(v) = v/(2 s²) exp(-v²/(4 s²)) for pairs, v/s² exp(-v²/(2 s²)) for walls; s: velocity deviation by component.

    That is exact in equilibrium for spheres of any hardness, since positions and velocities are independent.
    """
    n, side = 1000, 0.0145
    box = replace(BOX, size=(side, side, side))
    bed = scene(n, box=box, periodic=("y",), contact=ELASTIC, gravity=AT_REST)
    given = model(bed, kind, k_n=2000.0, dt=4e-6)
    sites = np.stack(np.meshgrid(*[np.arange(10)] * 3, indexing="ij"), -1).reshape(-1, 3)
    x = (sites + 0.5) * side / 10
    v = np.random.default_rng(1).normal(0.0, 1.0, (n, 3))
    counts, sums, energy = np.zeros((2, len(speed_edges()) - 1)), np.zeros((2, 3)), []
    with LiggghtsDem(given, tmp_path, Start.at(x, v)) as dem:
        for number in range(220):
            step = dem.run(WATCH_EVERY, still(bed))
            if number >= 20:  # 20 intervals are 6 ms, in which each particle collides dozens of times
                counts += step.impacts
                sums += step.impact_sums
                energy.append(float((dem.state()[1] ** 2).mean()))
    s = math.sqrt(np.mean(energy))
    for k, scale, least in ((0, math.sqrt(2.0) * s, 800), (1, s, 80)):
        number = counts[k].sum()
        assert number > least
        # Rayleigh of this scale: mean sqrt(pi/2), E v³/E v² = 3/2 sqrt(pi/2), E v² = 2; four standard errors
        mean, weighted = sums[k, 0] / number, sums[k, 2] / sums[k, 1]
        unit = math.sqrt(0.5 * math.pi) * scale
        assert mean == pytest.approx(unit, abs=4.0 * math.sqrt((2.0 - 0.5 * math.pi) / number) * scale)
        # Var(v³ - R v²)/(E v²)² with R = 3/2 sqrt(pi/2), moments of Rayleigh: E v⁴ = 8, E v⁵ = 15 sqrt(pi/2), E v⁶ = 48
        ratio, root = 1.5 * math.sqrt(0.5 * math.pi), math.sqrt(0.5 * math.pi)
        variance = (48.0 - 2.0 * ratio * 15.0 * root + 8.0 * ratio**2) / 4.0
        assert weighted == pytest.approx(1.5 * unit, abs=4.0 * math.sqrt(variance / number) * scale)


@solver
def test_watching_leaves_no_trace(tmp_path: Path) -> None:
    """Intervals of 80 steps are watched at other steps than one of 400; not a bit of the run differs."""
    bed = scene(200, contact=replace(SMOOTH, friction=0.3))
    given = model(bed)
    states = []
    for name, parts in (("often", [80] * 20), ("seldom", [400] * 4), ("odd", [79, 81] * 10)):
        with LiggghtsDem(given, tmp_path / name, Start.at(lattice(bed))) as dem:
            watched = sum(dem.run(steps, still(bed)).watched for steps in parts)
            states.append(dem.state())
        assert watched == pytest.approx(
            len({0: 0} | dict.fromkeys(np.cumsum(parts) // WATCH_EVERY)) * given.dt - given.dt
        )
    for x, v, *_ in states[1:]:
        assert np.array_equal(x, states[0][0])
        assert np.array_equal(v, states[0][1])
    assert np.abs(states[0][1]).max() > 0.02
