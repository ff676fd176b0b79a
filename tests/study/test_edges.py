"""Edges found by bisection against closed forms and eigenvalues; advice against both."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from models import with_bodies

from kncal import advise_time_step, calibrate, pair, wall_pair
from kncal.core.errors import InputError
from kncal.engines.builtin.integrator import integrate
from kncal.physics.material import sphere_mass
from kncal.physics.timestep import verlet_limit
from kncal.scene.case_file import load_case
from kncal.study.stability import accuracy
from kncal.study.stability.accuracy import accuracy_edges
from kncal.study.stability.edges import RESOLUTION, edges, find_edge, liggghts_runner, run_builtin
from kncal.study.stability.limits import advised_limit, arrangement_limit, touching
from kncal.study.stability.outcome import judge
from kncal.study.stability.probes import DIRECTIONS, at_step, impact_of_cluster, ingredients, pressed

pytestmark = pytest.mark.slow

SPHERE = ingredients(load_case("wall_impact"))
BED = ingredients(load_case("bubbling_bed_mini"))


def between_walls(kind: str, e_n: float) -> tuple[float, float]:
    """omega [1/s] and zeta of a sphere between two walls: springs and dashpots of two contacts side by side."""
    probe = pressed(SPHERE, kind, e_n, 2)
    c = probe.model.between("s0", "x-low")
    (ball,) = probe.scene.spheres
    m = float(sphere_mass(ball.material, ball.radius))
    assert c.delta_max is not None
    k = c.n * c.k * c.delta_max ** (c.n - 1.0)
    omega = math.sqrt(2.0 * k / m)
    return omega, 2.0 * c.c * c.delta_max**c.p / (2.0 * omega * m)


@pytest.mark.parametrize("kind", ["linear", "hertz"])
@pytest.mark.parametrize("e_n", [1.0, 0.9, 0.5, 0.1, 0.01])
def test_edge_of_a_sphere_between_two_walls_is_the_closed_form(kind: str, e_n: float) -> None:
    """omega dt = 2 (sqrt(1 + zeta²) - zeta) with omega² = 2 k/m lies within the bracket that bisection leaves.

    Looked for from far off. Just above the edge a nudge grows too slowly to be seen in the steps of a run: at zeta = 1
    by 1.03 a step at 1 %, so that a third of a per cent grows by 1.01^130 = 4 in a third of the run, as looked for.
    """
    omega, zeta = between_walls(kind, e_n)
    closed = 2.0 * (math.sqrt(1.0 + zeta**2) - zeta) / omega
    found = find_edge(run_builtin, pressed(SPHERE, kind, e_n, 2), 0.31 * closed, 0.37 * closed)
    assert found.high / found.low - 1.0 <= RESOLUTION
    assert found.low <= closed * (1.0 + RESOLUTION)
    assert found.high >= closed
    assert arrangement_limit(pressed(SPHERE, kind, e_n, 2).model) == pytest.approx(closed, rel=1e-5)


@pytest.mark.parametrize("kind", ["linear", "hertz"])
@pytest.mark.parametrize(("contacts", "size_ratio"), [(1, 1.0), (2, 10.0), (4, 1.0), (12, 1.0)])
def test_advice_is_safe_and_edges_are_where_eigenvalues_say(kind: str, contacts: int, size_ratio: float) -> None:
    (edge,) = edges([pressed(SPHERE, kind, 0.6, contacts, size_ratio=size_ratio)])
    assert edge.safe_by("builtin") > -RESOLUTION
    assert abs(edge.off_by("builtin")) <= RESOLUTION


def test_twelve_neighbours_without_damping_by_hand() -> None:
    """The bound sqrt(12) against the fcc lattice, whose largest frequency is twice that of a pair.

    A cluster of thirteen has lower frequencies than the lattice, walls as stiff as pairs none above: its limit lies
    between that of the lattice and twice it.
    """
    probe = pressed(replace(BED, contact=replace(BED.contact, e_n=1.0)), "linear", 1.0, 12)
    pair = next(t for t in touching(probe.model) if t.second is not None)
    advised, own = advised_limit(probe.model, 12.0), arrangement_limit(probe.model)
    one = float(verlet_limit(pair.stiffness, pair.m_eff))
    assert advised <= one / math.sqrt(12.0) * (1.0 + 1e-12)
    assert 0.5 * one * (1.0 - 1e-6) <= own < one


@pytest.mark.parametrize("contacts", [1, 2, *DIRECTIONS])
def test_pressed_probes_are_in_equilibrium(contacts: int) -> None:
    """Without the nudge nothing moves: forces balance to the rounding of positions over overlaps."""
    probe = pressed(SPHERE, "linear", 0.6, contacts)
    still = tuple(replace(p, velocity=(0.0, 0.0, 0.0)) for p in probe.scene.spheres)
    model = replace(probe.model, scene=with_bodies(probe.scene, spheres=still))
    run = integrate(at_step(model, 0.1 * arrangement_limit(model), 30))
    there = touching(model)
    omega = max(math.sqrt(t.stiffness / t.m_eff) for t in there)
    # an overlap is the difference of positions of the size of the probe, rounded at 1e-16 of it
    rounding = 16.0 * 1e-16 * 4.0 * SPHERE.radius
    assert abs(run.v).max() < 20.0 * omega * rounding


@pytest.mark.parametrize("kind", ["linear", "hertz"])
def test_twelve_at_once_keep_the_momentum_at_zero(kind: str) -> None:
    probe = impact_of_cluster(SPHERE, kind, 0.6, 12)
    t_c = min(c.t_c for c in probe.model.contacts.values())
    model = at_step(probe.model, t_c / 100.0, 350)
    outcome = judge(model, integrate(model))
    assert outcome.stable
    assert outcome.numbers["momentum"] < 1e-13
    assert outcome.numbers["energy_change"] < 0.0


def test_accuracy_edge_is_no_later_than_predicted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy, "NUMBERS", (6.0, 8.5, 12.0, 17.0, 24.0, 34.0, 48.0, 68.0, 96.0, 136.0, 192.0))
    for edge in accuracy_edges(SPHERE, "linear", 0.6):
        assert edge.measured is not None
        assert edge.predicted is not None
        assert edge.measured <= edge.predicted


def test_no_edge_without_contact() -> None:
    with pytest.raises(InputError, match="nothing touches"):
        arrangement_limit(impact_of_cluster(SPHERE, "linear", 0.6, 2).model)


def test_no_speed_no_probe() -> None:
    scene = load_case("falling_particle")
    with pytest.raises(InputError, match=r"contact\.v_0"):
        ingredients(replace(scene, gravity=(0.0, 0.0, 0.0)))


@pytest.mark.solver
def test_liggghts_has_the_same_edge(tmp_path: Path) -> None:
    (edge,) = edges([pressed(SPHERE, "linear", 0.6, 2)], liggghts_runner(tmp_path))
    assert edge.measured["liggghts"].low == edge.measured["builtin"].low
    assert edge.measured["liggghts"].high == edge.measured["builtin"].high


@pytest.mark.parametrize("contacts", [2, 12])
def test_advice_in_seconds_is_for_the_contact_of_the_case(contacts: int) -> None:
    """Not for a Hertz cluster squeezed by a millionth of its diameter: what is advised is what the calibration gives.

    For the falling particle of 4.4 ms: between two walls, and amid as many spheres as a dense packing has.
    """
    ball = ingredients(load_case("falling_particle"))
    e_n, speed = ball.contact.e_n, ball.v_0
    wall, both = wall_pair(ball.material, ball.radius, ball.wall), pair(ball.material, ball.radius)
    for kind in ("linear", "hertz"):
        (edge,) = edges([pressed(ball, kind, e_n, contacts)])
        found = [
            advise_time_step(
                calibrate(p, v_0=speed, e_n=e_n, method=ball.contact.method or "mean_overlap"), 50, contacts
            )
            for p in ((wall, both) if contacts == 12 else (wall,))
        ]
        limits = [a.linear_limit if kind == "linear" else a.hertz_limit for a in found]
        assert edge.advised == pytest.approx(min(map(float, limits)), rel=1e-9)
        assert edge.advised < 4.4e-3
        assert edge.at_v_0("builtin") >= edge.advised * (1.0 - RESOLUTION)
        # a linear contact is as stiff under any load
        if kind == "linear":
            assert edge.at_v_0("builtin") == pytest.approx(edge.measured["builtin"].middle, rel=1e-9)
