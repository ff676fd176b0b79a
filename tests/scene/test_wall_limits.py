"""Meshes that a solver cannot take, and walls that are too fast, are found before a run."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from granular import placed, plan_of

from kncal.core.checks import Array
from kncal.scene.granular_limits import phases
from kncal.scene.limits import check
from kncal.scene.shapes import faces
from kncal.scene.wall_limits import SKIN, mesh
from kncal.scene.walls import BoxWall, DiscWall

D = 0.005


def box() -> Array:
    return faces(BoxWall(shape="box", size=(0.02, 0.02, 0.02)), path_of=Path)


def codes(triangles: Array, *, closed: bool = False) -> set[tuple[str, str]]:
    return {(f.code, f.level) for f in mesh("hopper", triangles, D, D, closed=closed)}


def test_a_closed_box_and_an_open_disc_are_fine() -> None:
    assert not codes(box(), closed=True)
    disc = faces(DiscWall(shape="disc", centre=(0, 0, 0), radius=0.03), path_of=Path, radius=0.5 * D)
    assert not codes(disc)
    assert codes(disc, closed=True) == {("mesh-open", "refuse")}


def test_injected_faults_are_found() -> None:
    whole = box()
    assert codes(whole[:-1], closed=True) == {("mesh-open", "refuse")}
    assert ("mesh-duplicate", "refuse") in codes(np.concatenate([whole, whole[:1, [1, 2, 0]]]))
    flat = whole[:1].copy()
    flat[0, 2] = flat[0, 1]
    assert codes(np.concatenate([whole, flat])) == {("mesh-degenerate", "refuse")}
    line = whole[:1].copy()
    line[0, 2] = 0.5 * (line[0, 0] + line[0, 1])
    assert codes(np.concatenate([whole, line])) == {("mesh-degenerate", "refuse")}
    fin = whole[:1].copy()
    fin[0, 2] = [0.05, 0.05, 0.05]
    assert ("mesh-edges", "warn") in codes(np.concatenate([whole, fin]))


def grid(edge: float) -> Array:
    """Return a square of 0.02 m of triangles with such edges."""
    line = np.arange(0.0, 0.02 + 0.5 * edge, edge)
    x, y = np.meshgrid(line, line, indexing="ij")
    p = np.stack([x, y, np.zeros_like(x)], axis=2)
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    return np.concatenate(
        [np.stack([a, b, c], axis=2).reshape(-1, 3, 3), np.stack([a, c, d], axis=2).reshape(-1, 3, 3)]
    )


def test_triangles_much_smaller_than_particles_are_told_and_refused_where_lists_overflow() -> None:
    """The real LIGGGHTS ends with an overflow at edges of a tenth of the radius."""
    assert not codes(grid(0.5 * D))
    assert codes(grid(0.1 * D)) == {("mesh-fine", "warn")}
    assert codes(grid(0.05 * D * 0.5)) == {("mesh-fine", "refuse")}


PADDLE = """
[walls.paddle]
shape = "plate"
corner = [0.0, 0.0, 0.0]
edge_1 = [0.02, 0.0, 0.0]
edge_2 = [0.0, 0.0, 0.02]
[[walls.paddle.motion]]
kind = "rotate"
axis = [0, 0, 1]
period = PERIOD
"""


def test_a_wall_faster_than_its_lists_is_refused_at_the_speed_that_the_skin_says() -> None:
    """Its tip goes 2 pi 0.02 m a turn; lists allow half the skin in a step."""
    slow = plan_of(placed((0.0, 0.02, 0.01)) + PADDLE.replace("PERIOD", "1.0"))
    edge = 2.0 * math.pi * 0.02 * slow.dt / (0.5 * SKIN * D)
    for period, level in ((0.9 * edge, "refuse"), (1.1 * edge, "warn"), (11.0 * edge, None)):
        model = plan_of(placed((0.0, 0.02, 0.01)) + PADDLE.replace("PERIOD", repr(period)), until=0.02)
        found = {f.level for f in check(model) if f.code == "wall-speed"}
        assert found == ({level} if level else set())


def test_a_mesh_that_leaves_a_periodic_box_is_refused() -> None:
    turning = placed((0.0, 0.02, 0.01)) + PADDLE.replace("PERIOD", "1.0")
    periodic = 'periodic = ["x"]\n'
    assert not [f for f in check(plan_of(turning, periodic=periodic)) if f.code == "wall-periodic"]
    moved = turning.replace(
        'kind = "rotate"\naxis = [0, 0, 1]\nperiod = 1.0', 'kind = "translate"\nvelocity = [0.1, 0, 0]'
    )
    found = [f for f in check(plan_of(moved, periodic=periodic)) if f.code == "wall-periodic"]
    assert [f.level for f in found] == ["refuse"]
    assert "surface_velocity" in found[0].message


def test_overlaps_that_reach_two_triangles_of_a_curved_wall_over_much_of_it_are_told() -> None:
    """delta/(4 chord error): chord error 2 % of the radius, so from 2 % of the radius on it is a quarter."""
    tube = '[walls.tube]\nshape = "cylinder"\nradius = 0.028\nlow = 0.0\nhigh = 0.1\nmaterial = "glass"\n'
    for share, told in ((0.012, False), (0.04, True)):
        model = plan_of(placed((0.0, 0.0, 0.05)) + tube)
        stiff = model.contacts[0, 1].delta_max
        assert stiff is not None
        contacts = {pair: replace(c, delta_max=share * 0.5 * D) for pair, c in model.contacts.items()}
        found = [f for f in check(replace(model, contacts=contacts)) if f.code == "wall-edges"]
        assert bool(found) == told
        endless = plan_of(placed((0.0, 0.0, 0.05)) + tube.replace("low = 0.0\nhigh = 0.1\n", ""))
        assert not [f for f in check(replace(endless, contacts=contacts)) if f.code == "wall-edges"]


@pytest.mark.slow
def test_a_mesh_file_that_cannot_be_read_is_a_refusal_of_the_scene(tmp_path: Path) -> None:
    (tmp_path / "hopper.stl").write_text("solid a\nendsolid a\n")
    with pytest.raises(Exception, match=r"hopper\.stl"):
        plan_of(placed((0.0, 0.02, 0.01)) + '[walls.hopper]\nshape = "mesh"\nfile = "hopper.stl"\n', home=tmp_path)


SHAKER = """
[walls.floor]
shape = "disc"
centre = [0, 0, -0.003]
radius = 0.02
motion = [{kind = "oscillate", amplitude = [0.0, 0.0, 1e-3], period = 0.05}]
"""


@pytest.mark.parametrize(
    ("sample", "frames", "keys"),
    [
        (5e-4, 0.0131, set()),
        (5e-4, 0.05, {"run.frames_every"}),
        (5e-4, 0.1, {"run.frames_every"}),
        (5e-4, 0.025, {"run.frames_every"}),
        (0.05, 0.05, {"run.sample_every", "run.frames_every"}),
    ],
)
def test_frames_that_see_few_phases_of_a_shaken_floor_are_told(sample: float, frames: float, keys: set[str]) -> None:
    """As the phases of the frames themselves show: there are gaps between them."""
    model = plan_of(placed([0, 0, 0.01]) + SHAKER, until=1.5, sample=sample, frames=frames)
    assert {found.message.partition(":")[0] for found in phases(model)} == keys
    every = model.frames_every * model.coupling
    seen = np.sort(np.mod(np.arange(1, 1 + model.couplings // model.frames_every) * every / 0.05, 1.0))
    gap = np.diff(np.append(seen, seen[0] + 1.0)).max()
    assert ("run.frames_every" in keys) == (gap > 0.12)
