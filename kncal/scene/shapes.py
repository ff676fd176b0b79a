"""Geometry of walls: triangles, bounds, distances. SI units, arrays of float64.

A surface of revolution (cylinder, cone, disc) is a straight line in the half-plane of radius and height, turned about
its axis; all else is made of flat pieces.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kncal.core.checks import Array
from kncal.scene.bodies import AXES
from kncal.scene.meshes import triangles_of
from kncal.scene.walls import BoxWall, ConeWall, CylinderWall, DiscWall, MeshWall, PlaneWall, PlateWall, WallKeys

if TYPE_CHECKING:
    import pyvista

#: Lower and upper corner, each (3,) [m]; infinite where something has no end.
Bounds = tuple[Array, Array]
#: From the name of a file that the case names to where it lies.
PathOf = Callable[[str], Path]

#: How far the flat triangles of a curved wall may be from it, in radii of the smallest particle. Finer triangles are
#: touched by two at once over much of the wall: within delta/angle of an edge, so it must be above delta/8.
CHORD = 0.02
#: A curved wall has at least so many sides, and at most: a finer one costs more than it is worth.
LEAST_SIDES, MOST_SIDES = 24, 720
#: Most length over width of a triangle of a curved wall: LIGGGHTS wants angles of more than half a degree, and square
#: ones cost 1.7 times as much, of a drum of 2 500 particles.
ASPECT = 8.0


#: Where endless walls end if nobody says where [m].
_FAR = 1e5


class _Revolved(NamedTuple):
    """The line from (r, h) = ``start`` to ``end`` [m], turned about ``axis`` (3,) through ``origin`` (3,) [m]."""

    start: tuple[float, float]
    end: tuple[float, float]
    origin: Array
    axis: Array


def revolved(wall: WallKeys) -> _Revolved | None:
    """Return a surface of revolution as the line that makes it; None for other walls."""
    if isinstance(wall, DiscWall):
        normal = np.array(wall.normal) / math.hypot(*wall.normal)
        return _Revolved((wall.hole, 0.0), (wall.radius, 0.0), np.array(wall.centre), normal)
    if not isinstance(wall, CylinderWall | ConeWall):
        return None
    along = AXES.index(wall.axis)
    origin = np.insert(np.array(wall.centre), along, 0.0)
    low = -math.inf if wall.low is None else wall.low
    high = math.inf if wall.high is None else wall.high
    radii = (wall.radius_low, wall.radius_high) if isinstance(wall, ConeWall) else (wall.radius, wall.radius)
    return _Revolved((radii[0], low), (radii[1], high), origin, np.eye(3)[along])


def bounds_of(wall: WallKeys, path_of: PathOf) -> Bounds:
    """Return the lower and the upper corner of a wall at the start [m], infinite where it has no end."""
    if isinstance(wall, PlaneWall):
        low, high = np.full(3, -np.inf), np.full(3, np.inf)
        low[AXES.index(wall.axis)] = high[AXES.index(wall.axis)] = wall.position
        return low, high
    if isinstance(wall, BoxWall):
        return np.array(wall.low), np.array(wall.high)
    if (line := revolved(wall)) is not None:
        # a circle of radius r about the axis n reaches r sqrt(1 - n_k²) along the coordinate k
        reach = np.sqrt(np.maximum(0.0, 1.0 - line.axis**2))
        lows, highs = [], []
        for r, h in (line.start, line.end):
            centre = line.origin + (line.axis * h if math.isfinite(h) else np.where(line.axis > 0.0, h, 0.0))
            lows.append(centre - r * reach)
            highs.append(centre + r * reach)
        return np.minimum(*lows), np.maximum(*highs)
    nodes = faces(wall, path_of=path_of).reshape(-1, 3)
    return nodes.min(axis=0), nodes.max(axis=0)


def is_endless(wall: WallKeys, extent: Bounds) -> bool:
    """Whether a wall that stays has no end inside the box: a plane, a box, a long cylinder; a solver needs no mesh."""
    if wall.motion or any(wall.surface_velocity):
        return False
    if isinstance(wall, CylinderWall):
        k = AXES.index(wall.axis)
        low, high = extent[0][k], extent[1][k]
        return (wall.low is None or wall.low <= low) and (wall.high is None or wall.high >= high)
    return isinstance(wall, PlaneWall | BoxWall)


def faces(
    wall: WallKeys, *, path_of: PathOf, extent: Bounds | None = None, radius: float = 0.0, open_axes: str = ""
) -> Array:
    """Return the triangles of a wall at the start, (n, 3, 3): the corners of each [m].

    Parameters
    ----------
    path_of : where a mesh file lies
    extent : lower and upper corner of the box [m] where infinite walls are cut off
    radius : of the smallest particle [m]: no triangle is further than `CHORD` of it from a curved wall
    open_axes : on which a box has no sides, as "y"
    """
    low, high = (np.full(3, -_FAR), np.full(3, _FAR)) if extent is None else extent
    if isinstance(wall, MeshWall):
        return placed_mesh(wall, path_of)
    if (line := revolved(wall)) is not None:
        along = float(line.axis @ low), float(line.axis @ high)
        cut = [(r, min(max(h, along[0]), along[1])) if math.isinf(h) else (r, h) for r, h in (line.start, line.end)]
        return _turned(line._replace(start=cut[0], end=cut[1]), CHORD * radius)
    return np.concatenate([_parallelogram(*piece) for piece in _flat(wall, low, high, open_axes)])


def _flat(wall: WallKeys, low: Array, high: Array, open_axes: str) -> list[tuple[Array, Array, Array]]:
    """The parallelograms of a flat wall: corner, edge, edge."""
    if isinstance(wall, PlateWall):
        return [(np.array(wall.corner), np.array(wall.edge_1), np.array(wall.edge_2))]
    if isinstance(wall, PlaneWall):
        return [_side(AXES.index(wall.axis), wall.position, low, high)]
    assert isinstance(wall, BoxWall)  # noqa: S101  # all others are curved, or files
    low, high = (np.where([axis in open_axes for axis in AXES], *ends) for ends in ((low, wall.low), (high, wall.high)))
    closed = [k for k in (2, 0, 1) if AXES[k] not in open_axes]
    return [_side(k, end[k], low, high) for k in closed for end in (low, high)]


def _side(axis: int, at: float, low: Array, high: Array) -> tuple[Array, Array, Array]:
    """A rectangle at a coordinate of an axis, between the other coordinates of two corners."""
    corner: Array = np.array(low, dtype=np.float64)
    corner[axis] = at
    one, two = (np.eye(3)[k] * (high[k] - low[k]) for k in range(3) if k != axis)
    return corner, one, two


def _parallelogram(corner: Array, one: Array, two: Array) -> Array:
    a, b, c, d = corner, corner + one, corner + one + two, corner + two
    return np.array([[a, b, c], [a, c, d]])


def sides_of(radius: float, error: float) -> int:
    """Return how many sides a regular polygon in a circle of ``radius`` [m] has, at most ``error`` [m] from it."""
    if error <= 0.0 or error >= radius:
        return LEAST_SIDES
    needed = math.pi / math.acos(1.0 - error / radius)
    return int(min(max(4 * math.ceil(needed / 4.0), LEAST_SIDES), MOST_SIDES))


def _turned(line: _Revolved, error: float) -> Array:
    """Triangles of a surface of revolution, in rings of about square pieces at most `ASPECT` long."""
    number = sides_of(max(line.start[0], line.end[0]), error)
    wide = 2.0 * math.pi * max(line.start[0], line.end[0]) / number
    rings = max(1, math.ceil(math.dist(line.start, line.end) / (ASPECT * wide)))
    across = np.cross(line.axis, np.eye(3)[int(np.argmin(np.abs(line.axis)))])
    across /= np.linalg.norm(across)
    angle = 2.0 * np.pi * np.arange(number) / number
    around = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(line.axis, across)
    r, h = (np.linspace(one, other, rings + 1) for one, other in zip(line.start, line.end, strict=True))
    nodes = line.origin + h[:, None, None] * line.axis + r[:, None, None] * around
    low, high = nodes[:-1], nodes[1:]
    next_low, next_high = np.roll(low, -1, axis=1), np.roll(high, -1, axis=1)
    first = np.stack([low, next_low, next_high], axis=2)[r[:-1] > 0.0]  # a tip has no triangle with two corners there
    second = np.stack([low, next_high, high], axis=2)[r[1:] > 0.0]
    return np.concatenate([first.reshape(-1, 3, 3), second.reshape(-1, 3, 3)])


def placed_mesh(wall: MeshWall, path_of: PathOf) -> Array:
    """Return the triangles (n, 3, 3) [m] of a mesh wall's file, scaled, turned and moved as the case says."""
    from scipy.spatial.transform import Rotation

    axis = np.array(wall.turn_axis) / math.hypot(*wall.turn_axis)
    turn = Rotation.from_rotvec(math.radians(wall.turn_degrees) * axis).as_matrix()
    own: Array = triangles_of(path_of(wall.file))
    return np.asarray(wall.scale * own @ turn.T + np.array(wall.move))


def distance_to(wall: WallKeys, points: Array, *, path_of: PathOf, open_axes: str = "") -> Array:
    """Return the distance (n,) [m] of each of ``points`` (n, 3) [m] from a wall at the start.

    ``open_axes``: on which a box has no sides, as "y".
    """
    if isinstance(wall, PlaneWall):
        return np.asarray(np.abs(points[:, AXES.index(wall.axis)] - wall.position))
    if isinstance(wall, BoxWall):
        return _from_box(points, np.array(wall.low), np.array(wall.high), open_axes)
    if (line := revolved(wall)) is not None:
        h = (points - line.origin) @ line.axis
        r = np.linalg.norm(points - line.origin - h[:, None] * line.axis, axis=1)
        return _from_segment(np.stack([r, h], axis=1), np.array(line.start), np.array(line.end))
    return distance_to_faces(faces(wall, path_of=path_of), points)


def _from_box(points: Array, low: Array, high: Array, open_axes: str) -> Array:
    """Distance (n,) of points (n, 3) from the sides of a box that it has."""
    beyond = points - np.clip(points, low, high)
    beyond[:, [axis in open_axes for axis in AXES]] = 0.0
    found = np.full(len(points), np.inf)
    for k in (k for k, axis in enumerate(AXES) if axis not in open_axes):
        for end in (low[k], high[k]):
            away = beyond.copy()
            away[:, k] = points[:, k] - end
            found = np.minimum(found, np.linalg.norm(away, axis=1))
    return found


def _from_segment(points: Array, start: Array, end: Array) -> Array:
    """Distance (n,) of points (n, 2) in a plane from a line segment, whose second coordinates may be infinite."""
    if not np.isfinite([start, end]).all():  # parallel to the axis
        beyond = np.maximum(np.maximum(start[1] - points[:, 1], points[:, 1] - end[1]), 0.0)
        return np.asarray(np.hypot(points[:, 0] - start[0], beyond))
    along = end - start
    share = np.clip((points - start) @ along / (along @ along), 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - start - share[:, None] * along, axis=1))


def distance_to_faces(triangles: Array, points: Array) -> Array:
    """Return the distance (n,) of each of ``points`` (n, 3) from the nearest of ``triangles`` (m, 3, 3)."""
    if not len(points):
        return np.empty(0)
    _, nearest = surface(triangles).find_closest_cell(points, return_closest_point=True)
    return np.asarray(np.linalg.norm(points - nearest, axis=1))


def surface(triangles: Array) -> pyvista.PolyData:
    """Return triangles (m, 3, 3) as a `pyvista.PolyData`."""
    import pyvista

    corners = np.arange(3 * len(triangles)).reshape(-1, 3)
    return pyvista.PolyData.from_regular_faces(np.ascontiguousarray(triangles.reshape(-1, 3)), corners)


def write_stl(triangles: Array, path: Path) -> None:
    """Write triangles (n, 3, 3) as an STL file of text with every digit: the binary form would have seven."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    rows = np.concatenate([normal[:, None], triangles], axis=1).reshape(-1, 12).tolist()
    text = "facet normal %.6g %.6g %.6g\nouter loop\n" + 3 * "vertex %.17g %.17g %.17g\n" + "endloop\nendfacet\n"
    with path.open("w", encoding="ascii") as file:
        file.write("solid wall\n")
        file.writelines(text % tuple(row) for row in rows)
        file.write("endsolid wall\n")
