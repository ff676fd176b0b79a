"""LIGGGHTS as a library on scenes without gas: particles come and go, walls move and go; nothing is lost."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from granular import RAIN, G, placed, plan_of, start_at

from kncal.core.errors import RunError
from kncal.engines.liggghts.library import LiggghtsDem
from kncal.engines.liggghts.library_child import WATCH_EVERY
from kncal.record.steps import DemStep, ParticleState
from kncal.scene.model import Plan
from kncal.scene.placement import Start
from kncal.scene.plan import plan

pytestmark = pytest.mark.solver
R = 0.0025
MASS = 2500.0 * 4.0 / 3.0 * math.pi * R**3

HOPPER = """
[walls.tube]
shape = "cylinder"
radius = 0.025
material = "glass"
[walls.cone]
shape = "cone"
radius_low = 0.012
radius_high = 0.025
low = 0.0
high = 0.02
material = "glass"
[walls.plug]
shape = "disc"
centre = [0, 0, 0.001]
radius = 0.0125
remove_at = 0.35
[outlets.out]
position = -0.01
"""
GRID = np.array(
    [[0.0075 * (i % 4) - 0.011, 0.0075 * (i // 4 % 4) - 0.011, 0.02 + 0.0075 * (i // 16)] for i in range(60)]
)


class Look(NamedTuple):
    """What was seen at the end of one interval."""

    state: ParticleState
    step: DemStep

    def same_as(self, other: Look) -> bool:
        """Whether both are the same to the last bit."""
        parts = [*zip(self.state, other.state, strict=True)]
        parts += [
            (np.asarray(a), np.asarray(b))
            for a, b in zip(vars(self.step).values(), vars(other.step).values(), strict=True)
        ]
        return all(np.array_equal(a, b, equal_nan=a.dtype.kind == "f") for a, b in parts)


def intervals(
    dem: LiggghtsDem, model: Plan, first: int, last: int, save: Sequence[int] = (), to: Path = Path()
) -> list[Look]:
    looks = []
    for number in range(first + 1, last + 1):
        step = dem.run(model.steps_per_coupling)
        looks.append(Look(dem.state(), step))
        dem.end_interval(number)
        if number in save:
            dem.save(to / f"state-{number}")
    return looks


def resumed(model: Plan, start: Start, folder: Path, saves: Sequence[int]) -> tuple[list[Look], dict[int, list[Look]]]:
    """A run that is saved, and for each save the run that goes on from there."""
    with LiggghtsDem(model, folder / "run", start) as dem:
        whole = intervals(dem, model, 0, model.couplings, saves, folder)
    parts = {}
    for save in saves:
        with LiggghtsDem(model, folder / f"from-{save}", None, folder / f"state-{save}", first=save) as dem:
            end = min([later for later in saves if later > save], default=model.couplings)
            parts[save] = intervals(dem, model, save, end)
    return whole, parts


@pytest.fixture(scope="module")
def hopper(tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, list[Look], dict[int, list[Look]]]:
    model = plan_of(placed(*GRID) + HOPPER, until=0.55)
    folder = tmp_path_factory.mktemp("hopper")
    return model, *resumed(model, Start.at(GRID), folder, [20, 75, 90])


def test_a_hopper_goes_on_bit_by_bit_before_and_after_its_plug_is_taken_away(hopper) -> None:
    _, whole, parts = hopper
    for save, looks in parts.items():
        assert looks, save
        assert all(a.same_as(b) for a, b in zip(looks, whole[save:], strict=False)), save


def test_every_particle_is_inside_or_has_passed(hopper) -> None:
    model, whole, _ = hopper
    opened = round(0.35 / model.coupling)
    for number, look in enumerate(whole, start=1):
        inside = look.state.kind >= 0
        assert inside.sum() + look.step.out_number[0] == 60
        assert look.step.out_mass[0] == pytest.approx(look.step.out_number[0] * MASS)
        assert np.isnan(look.state.x[~inside]).all() and np.isfinite(look.state.x[inside]).all()
        assert (number > opened) or inside.all()
    assert whole[-1].step.out_number[0] == 60
    gone = np.array([look.state.kind < 0 for look in whole])
    assert (np.diff(gone.astype(int), axis=0) >= 0).all()  # none comes back


def test_walls_carry_the_weight_each_at_its_height(hopper) -> None:
    model, whole, _ = hopper
    opened = round(0.35 / model.coupling)
    tube, cone, plug = np.mean([look.step.wall_force for look in whole[opened - 4 : opened]], axis=0)
    assert (tube + cone + plug)[:, 2].sum() == pytest.approx(-60 * MASS * G, rel=0.02)
    edges = np.linspace(model.scene.extent[0][2], model.scene.extent[1][2], len(tube) + 1)
    low, high = edges[:-1], edges[1:]
    assert not plug[(high < 0.0) | (low > 2 * R)].any() and plug[:, 2].sum() < 0.0
    assert not cone[(high < 0.0) | (low > 0.02 + R)].any() and cone[:, 2].sum() < 0.0
    assert not np.array([look.step.wall_force[2] for look in whole[opened + 1 :]]).any()


@pytest.fixture(scope="module")
def rain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, list[Look], dict[int, list[Look]]]:
    model = plan_of(RAIN, until=0.3)
    x = np.array(model.scene.particles["large"].centres)
    start = Start.at(x, kind=np.ones(3, dtype=np.intp))
    return model, *resumed(model, start, tmp_path_factory.mktemp("rain"), [8, 25, 45])


def test_a_stream_with_a_turning_paddle_goes_on_bit_by_bit(rain) -> None:
    _, whole, parts = rain
    for save, looks in parts.items():
        assert looks, save
        assert all(a.same_as(b) for a, b in zip(looks, whole[save:], strict=False)), save


def test_a_stream_brings_what_its_rate_says(rain) -> None:
    model, whole, _ = rain
    mass = 2500.0 * math.pi / 6.0 * 0.004**3
    for number, look in enumerate(whole, start=1):
        come = (look.state.kind == 0).sum() + look.step.out_number[1] - (3 - (look.state.kind == 1).sum())
        assert come == pytest.approx(min(120.0, 0.04 * number * model.coupling / mass), abs=1.01)


def test_a_row_is_one_particle_whatever_id_it_has(rain) -> None:
    """LIGGGHTS gives the ids of deleted particles to new ones."""
    _, whole, _ = rain
    kinds = np.array([look.state.kind for look in whole])
    for row in kinds.T:
        there = np.flatnonzero(row >= 0)
        if len(there):
            assert (np.diff(there) == 1).all() and len(set(row[there])) == 1
    assert (kinds[:, :3].max(axis=0) == 1).all() and (kinds[:, 3:] < 1).all()
    x = np.array([look.state.x for look in whole])
    assert np.nanmax(np.linalg.norm(np.diff(x, axis=0), axis=2)) < 0.02  # no jumps: 5 ms at up to 2 m/s
    assert whole[-1].step.out_number[1] > 20  # so that ids were given anew


def test_the_outlet_that_only_counts_lets_them_pass(rain) -> None:
    _, whole, _ = rain
    for look in whole:
        middle, out = look.step.out_number
        below = np.nan_to_num(look.state.x[:, 2], nan=1.0) < 0.015
        assert middle == out + below.sum()


def test_a_particle_that_leaves_elsewhere_is_found(tmp_path: Path) -> None:
    text = placed((0.0, 0.0, 0.0), (0.0, 0.0, 0.01)) + "velocity = [2.0, 0.0, 0.0]\n[outlets.out]\nposition = -0.01\n"
    model = plan_of(text)
    x = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.01]])
    start = Start.at(x, np.array([[2.0, 0.0, 0.0]] * 2))
    with pytest.raises(RunError, match="left") as lost, LiggghtsDem(model, tmp_path, start) as dem:
        intervals(dem, model, 0, model.couplings)
    assert lost.value.failure == "lost-particles"


def test_a_stream_that_does_not_find_room_ends_the_run(tmp_path: Path) -> None:
    """LIGGGHTS only warns; the particles stand still in their region."""
    crowded = RAIN.replace("velocity = [0, 0, -0.5]", "velocity = [0, 0, 0]").replace("rate = 0.04", "rate = 0.4")
    model = plan_of(
        crowded.replace("[-0.02, -0.02, 0.06]", "[-0.005, -0.005, 0.07]").replace(
            "[0.02, 0.02, 0.08]", "[0.005, 0.005, 0.08]"
        ),
        gravity=1e-3,
    )
    start = Start.at(np.array(model.scene.particles["large"].centres), kind=np.ones(3, dtype=np.intp))
    with pytest.raises(RunError, match="region"), LiggghtsDem(model, tmp_path, start) as dem:
        intervals(dem, model, 0, model.couplings)


def watched_steps(model: Plan) -> int:
    """An interval in which every last step is watched."""
    assert model.steps_per_coupling >= WATCH_EVERY
    return model.steps_per_coupling


@pytest.mark.parametrize("kind", ["linear", "hertz"])
def test_beads_are_hit_by_a_moving_mesh_at_the_speed_between_them(kind: str, tmp_path: Path) -> None:
    """Beads at rest without gravity, a plate that comes: v_0 = its speed, at the step when it must be."""
    plate = """
[walls.ram]
shape = "plate"
corner = [-0.025, -0.025, -0.005]
edge_1 = [0.05, 0, 0]
edge_2 = [0, 0.05, 0]
[[walls.ram.motion]]
kind = "translate"
velocity = [0, 0, 0.4]
"""
    places = np.array([[-0.015, 0.0, 0.0], [0.0, 0.0, 0.0], [0.015, 0.0, 0.0]])
    model = plan_of(placed(*places) + plate, kind, until=0.06, gravity=1e-9)
    # each is touched in the middle of the last step of an interval
    due = np.array([1, 2, 4])
    x = places + np.outer(-0.005 + R + 0.4 * model.dt * (due * watched_steps(model) - 0.5), [0.0, 0.0, 1.0])
    with LiggghtsDem(model, tmp_path, Start.at(x)) as dem:
        looks = intervals(dem, model, 0, 5)
    (pair,) = (n for n, pair in enumerate(model.species.pairs()) if pair == (0, 1))
    assert [int(look.step.impacts[pair].sum()) for look in looks] == [1, 1, 0, 1, 0]
    speeds = [look.step.impact_sums[pair, 0] for look in looks if look.step.impacts.sum()]
    assert speeds == pytest.approx([0.4] * 3, rel=1e-6)


def test_unequal_spheres_meet_at_their_speed_by_pair(tmp_path: Path) -> None:
    text = """
[particles.small]
material = "glass"
diameter = 0.004
position = [0, 0, 0]
[particles.large]
material = "glass"
diameter = 0.008
position = [0.01, 0, 0]
"""
    model = plan_of(text, until=0.05, gravity=1e-9)
    steps = watched_steps(model)
    gap = 1.5 * model.dt * (2 * steps - 0.5)
    x = np.array([[0.0, 0.0, 0.0], [0.006 + gap, 0.0, 0.0]])
    start = Start.at(x, np.array([[1.0, 0.0, 0.0], [-0.5, 0.0, 0.0]]), np.array([0, 1]))
    with LiggghtsDem(model, tmp_path, start) as dem:
        looks = intervals(dem, model, 0, 2)
    pairs = list(model.species.pairs())
    assert [look.step.impacts.sum() for look in looks] == [0, 1]
    assert looks[1].step.impact_sums[pairs.index((0, 1))] == pytest.approx([1.5, 1.5**2, 1.5**3], rel=1e-6)


def test_two_ranks_give_the_same_particles_and_all_of_them(tmp_path: Path) -> None:
    """Sums are added up in another order, so positions differ by rounding, which grows with every contact."""
    model = plan_of(placed(*GRID) + HOPPER.replace("remove_at = 0.35", "remove_at = 0.06"), until=0.13)
    runs = []
    for ranks in (1, 2):
        folder = tmp_path / str(ranks)
        with LiggghtsDem(model, folder, Start.at(GRID), ranks=ranks, oversubscribe=True) as dem:
            runs.append(intervals(dem, model, 0, model.couplings, [6], folder))
        with LiggghtsDem(
            model, folder / "on", None, folder / "state-6", first=6, ranks=ranks, oversubscribe=True
        ) as dem:
            on = intervals(dem, model, 6, 8)
        assert np.nanmax(np.abs(on[-1].state.x - runs[-1][7].state.x)) < 1e-12
    one, two = runs
    for a, b in zip(one[:12], two[:12], strict=True):
        np.testing.assert_allclose(b.state.x, a.state.x, rtol=0.0, atol=1e-9 * R)
        np.testing.assert_allclose(b.step.wall_force, a.step.wall_force, rtol=0.0, atol=1e-6 * MASS * G)
    assert all((look.state.kind >= 0).sum() + look.step.out_number[0] == 60 for look in two)
    assert two[-1].step.out_number[0] > 0


def test_a_periodic_slope_brings_particles_back_and_carries_them(tmp_path: Path) -> None:
    """Gravity along (1, 0, -2): a bead on a plane that slides without friction; periods in x and y."""
    text = placed((0.0, 0.0, R - 2e-7), (0.0, 0.025, R - 2e-7)) + "velocity = [0.0, -0.5, 0.0]\n"
    text += '[walls.base]\nshape = "plane"\naxis = "z"\nposition = 0.0\nmaterial = "glass"\n'
    model = plan_of(text, until=0.3)
    scene = replace(
        model.scene,
        periodic=("x", "y"),
        gravity=(3.0, 0.0, -6.0),
        contact=replace(model.scene.contact, friction=0.0),
    )
    model = plan(scene)["linear"]
    x = np.array(scene.particles["beads"].centres)
    with LiggghtsDem(model, tmp_path, Start.at(x, np.full((2, 3), (0.0, -0.5, 0.0)))) as dem:
        looks = intervals(dem, model, 0, model.couplings)
    low, high = scene.extent
    for number, look in enumerate(looks, start=1):
        t = number * model.coupling
        flown = x[:, :2] + np.array([0.5 * 3.0 * t * t, -0.5 * t])
        expected = low[:2] + (flown - low[:2]) % (high - low)[:2]
        apart = (look.state.x[:, :2] - expected + 0.5 * (high - low)[:2]) % (high - low)[:2] - 0.5 * (high - low)[:2]
        # Velocity Verlet is exact for a constant force, but for half a kick at the start
        assert np.abs(apart).max() < 3.0 * t * model.dt + 1e-12
        assert (look.state.x[:, :2] >= low[:2]).all() and (look.state.x[:, :2] <= high[:2]).all()
    base = np.mean([look.step.wall_force[0].sum(axis=0) for look in looks[-20:]], axis=0)
    assert base == pytest.approx([0.0, 0.0, -2 * MASS * 6.0], abs=0.02 * MASS * 6.0)
    # the means over the intervals come from the momentum balance, along gravity
    along = np.mean([look.step.other_walls_force for look in looks[-20:]])
    assert along == pytest.approx(-base @ scene.up, rel=0.02)


def test_a_rank_that_is_killed_ends_the_run_and_leaves_nothing(tmp_path: Path) -> None:
    model = plan_of(placed(*GRID) + HOPPER, until=0.1)
    dem = LiggghtsDem(model, tmp_path, Start.at(GRID), ranks=2, oversubscribe=True)
    ranks = [pid for pid in _below(dem.pid) if "library_child" in (Path("/proc") / pid / "cmdline").read_text()]
    assert len(ranks) == 2
    os.kill(int(ranks[-1]), signal.SIGKILL)
    with pytest.raises(RunError, match="LIGGGHTS"):
        intervals(dem, model, 0, model.couplings)
    dem.close()
    assert not [pid for pid in ranks if (Path("/proc") / pid / "cwd").exists() and _works(pid)]


def _below(pid: int) -> list[str]:
    """All processes that a process has started, and those that they have."""
    found = [p for path in Path(f"/proc/{pid}/task").glob("*/children") for p in path.read_text().split()]
    return found + [below for p in found for below in _below(int(p))]


def _works(pid: str) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@pytest.mark.parametrize("kind", ["linear", "hertz"])
def test_what_holds_frozen_particles_is_recorded_like_the_force_on_a_wall(kind: str, tmp_path: Path) -> None:
    """At first their own weight, then, when a bead has come to rest on them, both; gravity is oblique."""
    oblique = np.array([-0.6, 0.0, -0.8]) * G
    anvil = placed([0, 0, 0]).replace("beads", "anvil") + "frozen = true\n"
    x = np.array([[0.0, 0.0, 0.0], [0.0012, 0.0, 0.0016]]) * 2.5001  # above each other along gravity
    model = plan_of(anvil + placed(x[1]), kind, until=1.0, sample=0.01)
    scene = replace(model.scene, gravity=tuple(oblique))
    model = plan(scene)[kind]
    with LiggghtsDem(model, tmp_path, start_at(model)) as dem:
        assert dem.walls == ("anvil",)
        (first,), last = (dem.run(1).wall_force.sum(axis=1), [dem.run(model.steps_per_coupling) for _ in range(60)])
    assert first == pytest.approx(MASS * oblique, abs=1e-12)
    assert last[-1].wall_force[0].sum(axis=0) == pytest.approx(2.0 * MASS * oblique, rel=1e-4, abs=1e-9)
