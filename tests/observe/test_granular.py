"""Metrics of many particles without gas, from records whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest
from seen_grains import BOX, DT, MASS, D, G, chute, pile, seen_of

from kncal.core.errors import InputError
from kncal.observe.estimate import Estimate
from kncal.observe.grain_metrics import GRAIN_METRICS, grain_estimate, one_packing
from kncal.scene.metrics import METRICS
from kncal.scene.walls import CylinderWall

pytestmark = pytest.mark.slow


def covered(found, truth, slack=1.0):
    assert found.value is not None, found.why
    assert abs(found.value - truth) <= slack * found.width, (found.value, truth, found.width)


def test_every_function_is_of_a_metric():
    assert set(GRAIN_METRICS) <= set(METRICS)


def test_what_comes_to_rest_is_measured_in_its_last_frame_and_the_rest_is_left_out():
    rng = np.random.default_rng(1)
    speeds = np.where(np.arange(200) < 120, 0.3, 1e-4)
    frames = [pile(rng, 0.0) for _ in range(20)] + [pile(rng, np.tan(np.radians(24.0)))]
    seen = seen_of(frames, speeds=speeds, surface="slope")
    assert seen.kind == "resting" and seen.window.begin == pytest.approx(1.21)
    covered(grain_estimate(seen, "angle_of_repose"), 24.0, 2.0)
    assert grain_estimate(seen, "angle_of_repose").width < 6.0
    moving = grain_estimate(seen, "dynamic_angle")
    assert moving.value is None and "rest" in moving.why


def test_a_moving_surface_has_the_mean_of_its_frames():
    rng = np.random.default_rng(2)
    angles = 25.0 + rng.normal(0.0, 1.5, 41)
    seen = seen_of([pile(rng, np.tan(np.radians(a))) for a in angles], surface="slope")
    assert seen.kind == "steady"
    found = grain_estimate(seen, "dynamic_angle")
    covered(found, 25.0, 1.5)
    assert found.width < 1.5
    assert grain_estimate(seen, "angle_of_repose").value is None


def test_the_flow_through_an_outlet_is_that_of_its_steady_part():
    rng = np.random.default_rng(3)
    rate = 2000.0 * np.concatenate([np.zeros(40), np.ones(300), np.linspace(1, 0, 30), np.zeros(30)])
    out = MASS * np.cumsum(rng.poisson(rate * DT))
    seen = seen_of([pile(rng, 0.0)] * 41, out=out, inside=out[-1] - out + MASS)
    assert seen.kind == "passing"
    covered(grain_estimate(seen, "mass_flow"), 2000.0 * MASS, 1.5)
    assert grain_estimate(seen, "residence_time").value is None
    assert 0.4 < seen.flow.begin <= seen.series.t_frame[seen.of_window[0]]


def test_what_passes_a_plane_and_leaves_behind_it_counts_once():
    out = MASS * np.cumsum(np.full(400, 20.0))
    x = pile(np.random.default_rng(10), 0.0)
    for planes in (("out",), ("plane", "out"), ("plane",), ("plane", "other")):
        seen = seen_of([x] * 41, out=out, outlets=planes)
        assert grain_estimate(seen, "mass_flow").value == pytest.approx(2000.0 * MASS), planes


def test_the_height_of_a_heap_is_as_uncertain_as_its_angle():
    """Heaps of other angles have other heights, however well the packing is known."""
    height = Estimate(value=0.02, width=1e-6)
    known = {"packing_fraction": Estimate(value=0.6, width=0.003), "angle_of_repose": Estimate(value=24.0, width=3.0)}
    assert one_packing("z_mean", height, known).width == pytest.approx(0.02 * 3.0 / 24.0)
    del known["angle_of_repose"]
    assert one_packing("z_mean", height, known).width == pytest.approx(0.02 * 0.003 / 0.6)
    assert one_packing("z_mean", height, {}).width == pytest.approx(0.02)


def test_what_is_inside_stays_as_long_as_it_takes_to_flow_out():
    rng = np.random.default_rng(4)
    out, inside = MASS * np.cumsum(rng.poisson(20.0, 400)), MASS * rng.normal(6000.0, 20.0, 400)
    seen = seen_of([pile(rng, 0.0)] * 41, out=out, inside=inside)
    covered(grain_estimate(seen, "residence_time"), 3.0, 1.5)


def test_mixing_over_time():
    """Two halves of a box: a share 1 - exp(-t/tau) of all particles has drawn its place anew."""
    rng, tau = np.random.default_rng(5), 0.4
    x, frames = rng.uniform(BOX[0], BOX[1], (4000, 3)), []
    kinds = np.where(x[:, 0] < 0.03, 0, np.where(x[:, 1] < 0.01, 1, 2)).astype(np.int16)
    order = rng.permutation(4000)
    for k in range(41):
        moved = order[: int(4000 * (1.0 - np.exp(-0.1 * k / tau)))]
        at = x.copy()
        at[moved] = x[rng.permutation(moved)]
        frames.append(at)
    seen = seen_of(frames, kinds=kinds)
    assert set(seen.groups.tolist()) == {0, 1}
    covered(grain_estimate(seen, "mixing_index"), 1.0, 3.0)
    curve = seen.mixing
    assert curve.lacey[0] < 0.1
    # a share s of particles that were drawn anew leaves (1 - s)² of the variance
    expected = 1.0 - np.exp(-2.0 * curve.t / tau)
    assert curve.lacey == pytest.approx(expected, abs=0.08)
    found = grain_estimate(seen, "mixing_time")
    assert found.value == pytest.approx(-0.5 * tau * np.log(0.1), abs=0.05)
    segregation = grain_estimate(seen, "segregation")
    assert segregation.value == pytest.approx(1.0 / 31.25, abs=0.01)


@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_a_layer_that_flows_has_its_exponent_and_loses_what_gravity_gives(exponent):
    tilt = np.radians(24.0)
    seen = chute(tilt, exponent)
    assert grain_estimate(seen, "profile_exponent").value == pytest.approx(exponent, abs=0.06)
    mean = 0.2 + 0.8 * (1.0 - 1.0 / (exponent + 1.0))
    power = 6000 * MASS * G * np.sin(tilt) * mean
    covered(grain_estimate(seen, "dissipation"), power, 2.0)
    covered(grain_estimate(seen, "speed"), mean, 2.0)


def test_the_temperature_is_that_about_the_local_motion():
    seen = chute(0.0, 1.5, noise=0.05)
    assert grain_estimate(seen, "granular_temperature").value == pytest.approx(0.05**2, rel=0.03)


def test_walls_that_follow_janssen_have_his_length_and_carry_the_weight():
    rng, length, top, bins = np.random.default_rng(7), 0.02, 0.045, 25
    x = np.column_stack(
        [rng.uniform(0, 0.06, 40_000), rng.uniform(0, 0.02, 40_000), (rng.permutation(40_000) + 0.5) / 40_000 * top]
    )
    weight, edges = 40_000 * MASS * G, np.linspace(0.0, 0.05, bins + 1)
    depth = top - edges.clip(max=top)
    through = weight / top * length * (1.0 - np.exp(-depth / length))
    side = weight / top * np.diff(edges.clip(max=top)) - (through[:-1] - through[1:])
    force = np.zeros((200, 2, bins, 3))
    force[:, 1, :, 2] = -side
    force[:, 0, 0, 2] = -through[0]
    seen = seen_of([x] * 21, speeds=np.full(200, 1e-5), walls=force)
    assert seen.resting
    assert grain_estimate(seen, "support").value == pytest.approx(1.0, rel=1e-9)
    assert grain_estimate(seen, "wall_share").value == pytest.approx(1.0 - through[0] / weight, rel=1e-6)
    assert grain_estimate(seen, "janssen_length").value == pytest.approx(length, rel=0.02)
    assert grain_estimate(seen, "janssen_k_mu").value is None  # of no cylinder
    seen.scene.walls["silo"] = CylinderWall(shape="cylinder", axis="z", centre=(0.0, 0.0), radius=0.012)
    assert grain_estimate(seen, "janssen_k_mu").value == pytest.approx(0.024 / (4.0 * length), rel=0.02)
    heap = force.copy()
    heap[:, 1] *= 0.02
    heap[:, 0, 0, 2] = -weight
    assert grain_estimate(seen_of([x] * 21, speeds=np.full(200, 1e-5), walls=heap), "janssen_length").value is None


def test_a_packing_with_holes_at_rest_has_a_fraction_with_a_width():
    """Of a lattice with a tenth of its places empty, at random: parts of it differ by the chance of that."""
    rng, hits = np.random.default_rng(8), 0
    side = np.stack(np.meshgrid(np.arange(30), np.arange(10), np.arange(20), indexing="ij"), axis=-1).reshape(-1, 3)
    for _ in range(6):
        x = (side + 0.5) * D
        x[rng.uniform(size=len(x)) < 0.1] = np.nan
        seen = seen_of([x] * 21, speeds=np.full(200, 1e-5))
        found = grain_estimate(seen, "packing_fraction")
        assert 1e-3 < found.width < 0.03
        hits += abs(found.value - 0.9 * np.pi / 6.0) <= found.width
    assert hits >= 4
    # neighbours just touch, so that single precision cannot tell: the width says so
    contacts = grain_estimate(seen, "coordination")
    assert contacts.width > 1.0 and abs(contacts.value - 6 * 0.9) < contacts.width


@pytest.mark.parametrize("left", [0, 1, 2, 30])
def test_of_what_is_too_little_every_metric_says_why(left):
    rng = np.random.default_rng(9)
    frames = [pile(rng, 0.1, 300) for _ in range(30)]
    for x in frames[15:]:
        x[left:] = np.nan
    inside = MASS * np.repeat([np.isfinite(x[:, 0]).sum() for x in frames[1:]], 10)
    for speeds in (0.1, 1e-5):
        seen = seen_of(
            frames, inside=inside, speeds=np.full(290, speeds), surface="slope", walls=np.zeros((290, 1, 25, 3))
        )
        for name in GRAIN_METRICS:
            found = grain_estimate(seen, name)
            assert found.why if found.value is None else np.isfinite(found.value), name


def test_a_scene_without_outlets_has_no_flow_and_says_so():
    seen = seen_of([pile(np.random.default_rng(10), 0.1)] * 41, surface="slope", outlets=())
    with pytest.raises(InputError, match="outlets"):
        _ = seen.flow
