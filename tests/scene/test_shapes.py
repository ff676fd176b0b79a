"""Geometry of walls against closed forms: areas, distances, bounds, and rigid motion."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kncal.core.checks import Array
from kncal.core.errors import ReadError
from kncal.scene.shapes import CHORD, bounds_of, distance_to, distance_to_faces, faces, write_stl
from kncal.scene.wall_motion import fastest, pose, swept, when
from kncal.scene.walls import WALLS, MeshWall, Oscillation, Rotation, Translation, WallKeys

EXTENT = (np.array([-1.0, -1.0, -1.0]), np.array([1.0, 1.0, 2.0]))
RADIUS = 0.01


def made(shape: str, **values: Any) -> WallKeys:
    return WALLS[shape].table(shape=shape, **values)


def nowhere(name: str) -> Path:
    raise AssertionError(name)


CURVED = {
    "cylinder": (made("cylinder", radius=0.3, low=0.0, high=1.0), 2.0 * math.pi * 0.3),
    "cylinder, infinite, along x": (made("cylinder", axis="x", radius=0.3), 2.0 * math.pi * 0.3 * 2.0),
    "cone": (
        made("cone", radius_low=0.1, radius_high=0.4, low=0.0, high=0.4),
        math.pi * (0.1 + 0.4) * math.hypot(0.3, 0.4),
    ),
    "tip": (made("cone", radius_low=0.0, radius_high=0.3, low=0.0, high=0.4), math.pi * 0.3 * 0.5),
    "tip up": (made("cone", radius_low=0.3, radius_high=0.0, low=0.0, high=0.4), math.pi * 0.3 * 0.5),
    "disc": (made("disc", centre=(0.1, 0.2, 0.3), normal=(1.0, 2.0, -2.0), radius=0.3), math.pi * 0.09),
    "ring": (
        made("disc", centre=(0.0, 0.0, 0.0), normal=(0.0, 1.0, 0.0), radius=0.3, hole=0.2),
        math.pi * (0.09 - 0.04),
    ),
}
FLAT = {
    "plane": (made("plane", axis="y", position=0.5, material="rigid"), 2.0 * 3.0),
    "box": (made("box", size=(1.0, 0.5, 0.25), low=(0.0, 0.0, 1.0)), 2.0 * (0.5 + 0.25 + 0.125)),
    "plate": (made("plate", corner=(0, 0, 0), edge_1=(1, 0, 0), edge_2=(-1, 0, 2)), 2.0),
}


def areas(triangles: Array) -> Array:
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


@pytest.mark.parametrize("name", [*CURVED, *FLAT])
def test_triangles_have_the_area_of_the_wall_and_none_is_a_needle(name: str) -> None:
    wall, area = (CURVED | FLAT)[name]
    triangles = faces(wall, path_of=nowhere, extent=EXTENT, radius=RADIUS)
    tolerance = 1e-12 if name in FLAT else 2.0 * CHORD * RADIUS / 0.3
    assert areas(triangles).sum() == pytest.approx(area, rel=tolerance)
    edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2)
    heights = 2.0 * areas(triangles) / edges.max(axis=1)
    assert (heights / edges.max(axis=1) > math.tan(math.radians(0.5))).all()  # LIGGGHTS warns of smaller angles
    assert len(np.unique(np.sort(triangles.round(12), axis=1), axis=0)) == len(triangles)


@pytest.mark.parametrize("name", CURVED)
def test_no_triangle_is_further_from_a_curved_wall_than_its_chord_error(name: str) -> None:
    wall, _ = CURVED[name]
    triangles = faces(wall, path_of=nowhere, extent=EXTENT, radius=RADIUS)
    assert distance_to(wall, triangles.reshape(-1, 3), path_of=nowhere).max() < 1e-12
    middles = np.concatenate([triangles.mean(axis=1), 0.5 * (triangles[:, 0] + triangles[:, 1])])
    assert distance_to(wall, middles, path_of=nowhere).max() <= CHORD * RADIUS * (1.0 + 1e-9)


@pytest.mark.parametrize("name", [*CURVED, *FLAT])
def test_bounds_are_those_of_the_nodes(name: str) -> None:
    wall, _ = (CURVED | FLAT)[name]
    low, high = bounds_of(wall, nowhere)
    nodes = faces(wall, path_of=nowhere, extent=EXTENT, radius=RADIUS).reshape(-1, 3)
    assert np.clip(low, *EXTENT) == pytest.approx(nodes.min(axis=0), abs=2.0 * CHORD * RADIUS)
    assert np.clip(high, *EXTENT) == pytest.approx(nodes.max(axis=0), abs=2.0 * CHORD * RADIUS)


def test_distances_are_those_of_closed_forms() -> None:
    cone = made("cone", radius_low=0.1, radius_high=0.4, low=0.0, high=0.4)
    normal = np.array([0.4, 0.0, -0.3]) / 0.5
    points = np.array([[0.25, 0.0, 0.2] + 0.05 * normal, [0.0, 0.0, -1.0], [0.0, 0.4, 0.6]])
    expected = [0.05, math.hypot(0.1, 1.0), 0.2]
    assert distance_to(cone, points, path_of=nowhere) == pytest.approx(expected, rel=1e-12)
    tube = made("cylinder", axis="x", centre=(0.1, 0.2), radius=0.3)
    assert distance_to(tube, np.array([[7.0, 0.1, 0.3]]), path_of=nowhere) == pytest.approx([0.2])
    ring = made("disc", centre=(0, 0, 0), radius=0.3, hole=0.1)
    assert distance_to(ring, np.array([[0.0, 0.0, 0.2]]), path_of=nowhere) == pytest.approx([math.hypot(0.1, 0.2)])


def test_distances_from_a_box_are_those_of_its_triangles_and_of_the_sides_it_has() -> None:
    box = made("box", size=(1.0, 2.0, 3.0), low=(-0.5, 0.0, 1.0))
    points = np.random.default_rng(2).uniform(-2.0, 5.0, (50, 3))
    for open_axes in ("", "y", "xz"):
        extent = (np.full(3, -50.0), np.full(3, 50.0))
        triangles = faces(box, path_of=nowhere, extent=extent, open_axes=open_axes)
        expected = distance_to_faces(triangles, points)
        assert distance_to(box, points, path_of=nowhere, open_axes=open_axes) == pytest.approx(expected, rel=1e-9)


@pytest.mark.slow
def test_distance_from_flat_walls_and_meshes(tmp_path: Path) -> None:
    box = made("box", size=(1.0, 2.0, 3.0))
    points = np.array([[0.5, 0.9, 1.5], [0.2, 1.0, 1.0], [-3.0, -4.0, 1.0]])
    assert distance_to(box, points, path_of=nowhere) == pytest.approx([0.5, 0.2, 5.0])
    write_stl(faces(box, path_of=nowhere), tmp_path / "box.stl")
    mesh = MeshWall(shape="mesh", file="box.stl", scale=2.0, turn_axis=(0, 0, 1), turn_degrees=90.0, move=(1, 0, 0))
    x, y, z = np.moveaxis(2.0 * points, 1, 0)
    there = np.stack([1.0 - y, x, z], axis=1)
    found = distance_to(mesh, there, path_of=tmp_path.joinpath)
    assert found == pytest.approx([1.0, 0.4, 10.0], rel=1e-6)  # VTK reads STL files in single precision


@pytest.mark.slow
@pytest.mark.parametrize("text", ["", "solid a\nendsolid a\n", "facet normal nan"])
def test_mesh_without_triangles_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_text(text)
    with pytest.raises(ReadError, match=r"a\.stl"):
        faces(MeshWall(shape="mesh", file="a.stl"), path_of=tmp_path.joinpath)


POINTS = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 1.0]])
SHAKE = Oscillation(kind="oscillate", amplitude=(0.0, 0.0, 0.5), period=2.0)
GO = Translation(kind="translate", velocity=(1.0, 0.0, 0.0), start=1.0, stop=3.0)
SPIN = Rotation(kind="rotate", axis=(0.0, 0.0, 2.0), period=4.0)


def test_poses_of_single_motions() -> None:
    assert pose([GO], 0.5).placed(POINTS) == pytest.approx(POINTS)
    assert pose([GO], 2.5).placed(POINTS) == pytest.approx(POINTS + np.array([1.5, 0.0, 0.0]))
    assert pose([GO], 9.0).placed(POINTS) == pytest.approx(POINTS + np.array([2.0, 0.0, 0.0]))
    assert pose([SHAKE], 0.5).placed(POINTS) == pytest.approx(POINTS + np.array([0.0, 0.0, 0.5]))
    assert pose([SPIN], 5.0).placed(POINTS) == pytest.approx(np.array([[0.0, 1.0, 0.0], [-2.0, 0.0, 1.0]]), abs=1e-12)


def test_an_axis_is_carried_along_by_translations_and_earlier_rotations() -> None:
    """A wheel that rolls: its axle goes straight, and a point of its rim is at rest where it touches the ground."""
    rolling = [
        Rotation(kind="rotate", origin=(0.0, 0.0, 1.0), axis=(0.0, 1.0, 0.0), period=2.0 * math.pi),
        Translation(kind="translate", velocity=(1.0, 0.0, 0.0)),
    ]
    for t in (0.0, 0.7, 3.0):
        found = pose(rolling, t)
        assert found.placed(np.array([0.0, 0.0, 1.0])) == pytest.approx(np.array([t, 0.0, 1.0]), abs=1e-12)
        assert found.speeds(np.array([t, 0.0, 0.0])) == pytest.approx(np.zeros(3), abs=1e-12)
    planet = [SPIN, Rotation(kind="rotate", origin=(1.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0), period=1.0)]
    x = pose(planet, 1.0).placed(np.array([1.5, 0.0, 0.0]))  # a quarter of an orbit, and own turns: one, and a quarter
    assert x == pytest.approx(np.array([0.0, 1.5, 0.0]), abs=1e-12)


def test_velocities_are_the_derivative_of_places() -> None:
    late = Rotation(kind="rotate", origin=(0.3, 0.1, 0.0), axis=(0.0, 0.0, -1.0), period=3.0, start=2.0, stop=8.0)
    motions, h = [SPIN, GO, SHAKE, late], 1e-6
    for t in (0.6, 1.7, 2.4, 5.3, 9.1):
        now = pose(motions, t)
        rate = (pose(motions, t + h).placed(POINTS) - pose(motions, t - h).placed(POINTS)) / (2.0 * h)
        assert now.speeds(now.placed(POINTS)) == pytest.approx(rate, abs=1e-8)


def test_reach_and_speed_of_a_motion() -> None:
    wall = made("plate", corner=(0, 0, 0), edge_1=(1, 0, 0), edge_2=(0, 0, 1), motion=(SPIN,))
    nodes = faces(wall, path_of=nowhere)
    low, high = swept(wall, nodes, 40.0)
    assert low == pytest.approx([-1.0, -1.0, 0.0], rel=5e-3)
    assert high == pytest.approx([1.0, 1.0, 1.0], rel=5e-3)
    assert fastest(wall, nodes, 40.0) == pytest.approx(2.0 * math.pi / 4.0, rel=5e-3)
    shaken = made("plate", corner=(0, 0, 0), edge_1=(1, 0, 0), edge_2=(0, 0, 1), motion=(SHAKE,))
    assert swept(shaken, nodes, 0.25)[1][2] == pytest.approx(1.0 + 0.5 * math.sin(math.pi / 4.0), rel=5e-3)
    assert fastest(shaken, nodes, 40.0) == pytest.approx(math.pi * 0.5, rel=5e-3)


def test_motions_start_and_stop_at_ends_of_intervals() -> None:
    assert [when(t, 0.1) for t in (0.0, 0.05, 0.1, 0.3, 0.31)] == pytest.approx([0.0, 0.1, 0.1, 0.3, 0.4])
    late = Translation(kind="translate", velocity=(1.0, 0.0, 0.0), start=0.25, stop=0.55)
    assert pose([late], 1.0, interval=0.1).shift == pytest.approx(np.array([0.3, 0.0, 0.0]))
