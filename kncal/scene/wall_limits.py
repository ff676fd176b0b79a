"""Limits of walls: meshes that LIGGGHTS refuses, or takes in another way than drawn, and walls that move too fast."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import CaseFileError, ReadError
from kncal.scene.bodies import AXES
from kncal.scene.finding import Finding
from kncal.scene.model import Plan
from kncal.scene.shapes import CHORD, faces, is_endless, revolved, sides_of
from kncal.scene.wall_motion import fastest, swept
from kncal.scene.walls import ConeWall, CylinderWall, MeshWall, WallKeys

#: Neighbour skin in diameters of the smallest particle: fewer rebuilds than 0.1, fewer pairs than 0.5.
SKIN = 0.25
#: Nodes nearer than so many diameters of the smallest particle are one for LIGGGHTS.
PRECISION = 1e-5
#: LIGGGHTS refuses a triangle with a smaller angle [°].
LEAST_ANGLE = 0.06
#: LIGGGHTS ends where a particle has more triangles near it than 2000; where it has many, it touches several at once,
#: and each pushes it with the force of a whole wall.
MOST_NEAR, MANY_NEAR = 1500, 60
#: Lists that are made anew more often than once in so many steps cost more than the steps.
LEAST_REBUILD = 10.0
#: Share of a curved wall where a particle may touch two triangles at once.
MOST_SHARE = 0.25
#: Triangles of which the surroundings are counted.
_LOOKED_AT = 2000


def walls(plan: Plan) -> Iterator[Finding]:
    """Yield the limits that the walls of a scene of many particles run into."""
    scene = plan.scene
    for name, wall in scene.walls.items():
        if is_endless(wall, scene.extent):
            continue
        try:
            triangles = faces(
                wall,
                path_of=scene.path_of,
                extent=scene.extent,
                radius=0.5 * scene.d_min,
                open_axes=scene.open_axes,
            )
        except (ReadError, CaseFileError) as error:
            yield Finding("mesh", "refuse", f"walls.{name}: {error}")
            continue
        if isinstance(wall, MeshWall):
            yield from mesh(name, triangles, scene.d_min, scene.d_max, closed=wall.closed)
        yield from _periods(plan, name, wall, triangles)
        yield from _speed(plan, name, wall, triangles)
        yield from _edges(plan, name, wall)


def mesh(name: str, triangles: Array, d_min: float, d_max: float, *, closed: bool = False) -> Iterator[Finding]:
    """Yield what is wrong with the ``triangles`` (n, 3, 3) of the wall ``name`` for particles of these diameters [m].

    ``closed``: whether they must enclose a volume.
    """
    where = f"walls.{name}: its mesh"
    _, ids = np.unique(np.round(triangles.reshape(-1, 3) / (PRECISION * d_min)), axis=0, return_inverse=True)
    corners = np.sort(ids.reshape(-1, 3), axis=1)
    flat = (corners[:, 0] == corners[:, 1]) | (corners[:, 1] == corners[:, 2])
    flat |= _smallest_angles(triangles) < LEAST_ANGLE
    if flat.any():
        yield Finding(
            "mesh-degenerate",
            "refuse",
            f"{where} has {flat.sum()} triangles without an area, or with an angle below {LEAST_ANGLE:g}° (the first: "
            f"number {np.flatnonzero(flat)[0] + 1}): LIGGGHTS refuses them: expected a mesh without; repair it in a "
            "mesh editor",
        )
        return
    _, counts = np.unique(corners, axis=0, return_counts=True)
    if (twins := int((counts - 1).sum())) > 0:
        yield Finding(
            "mesh-duplicate",
            "refuse",
            f"{where} has {twins} triangles twice: LIGGGHTS refuses them: expected each once; merge duplicates in a "
            "mesh editor",
        )
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [0, 2]]])
    _, sides = np.unique(edges, axis=0, return_counts=True)
    if closed and (sides == 1).any():
        yield Finding(
            "mesh-open",
            "refuse",
            f"{where} has {(sides == 1).sum()} open edges: expected a closed surface, or walls.{name}.closed = false",
        )
    if (sides > 2).any():
        yield Finding(
            "mesh-edges",
            "warn",
            f"{where} has {(sides > 2).sum()} edges of more than two triangles: particles there are pushed by all of "
            "them; expected two at most",
        )
    yield from _fine(where, triangles, d_max, (0.5 + SKIN) * d_max)


def _smallest_angles(triangles: Array) -> Array:
    """The smallest angle of each triangle [°]; 0 without an area."""
    sides = np.sort(np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2), axis=1)
    one, two = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    area2 = np.linalg.norm(np.cross(one, two), axis=1)
    product = sides[:, 1] * sides[:, 2]
    sine = np.divide(area2, product, out=np.zeros_like(area2), where=product > 0.0)
    return np.asarray(np.degrees(np.arcsin(np.clip(sine, 0.0, 1.0))))


def _fine(where: str, triangles: Array, d_max: float, reach: float) -> Iterator[Finding]:
    """Yield whether too many triangles are near one particle."""
    from scipy.spatial import cKDTree

    centres = triangles.mean(axis=1)
    looked_at = centres[:: max(1, len(centres) // _LOOKED_AT)]
    near = int(cKDTree(centres).query_ball_point(looked_at, reach, return_length=True).max())
    if near > MANY_NEAR:
        refused = near > MOST_NEAR
        told = "LIGGGHTS has room for 2000" if refused else "where it is curved, several push it at once"
        yield Finding(
            "mesh-fine",
            "refuse" if refused else "warn",
            f"{where} has up to {near} triangles within reach of one particle of {d_max:g} m: {told}: expected "
            "triangles about as large as a particle; coarsen it in a mesh editor",
        )


def _periods(plan: Plan, name: str, wall: WallKeys, triangles: Array) -> Iterator[Finding]:
    """Yield whether a mesh leaves a periodic box: LIGGGHTS would wrap its triangles, with a warning alone."""
    scene = plan.scene
    low, high = swept(wall, triangles, plan.n_steps * plan.dt, plan.coupling)
    for axis in map(AXES.index, scene.periodic):
        room = 1e-9 * (scene.extent[1] - scene.extent[0])[axis]
        if low[axis] < scene.extent[0][axis] - room or high[axis] > scene.extent[1][axis] + room:
            yield Finding(
                "wall-periodic",
                "refuse",
                f"walls.{name}: reaches from {low[axis]:g} to {high[axis]:g} m in {AXES[axis]}, beyond the box, which "
                f"is periodic there ({scene.extent[0][axis]:g} to {scene.extent[1][axis]:g} m): expected a wall that "
                "stays inside; for one that moves along itself take surface_velocity",
            )


def _speed(plan: Plan, name: str, wall: WallKeys, triangles: Array) -> Iterator[Finding]:
    """Yield whether a wall moves more in a step than neighbour lists allow: particles would be inside it unseen."""
    scene = plan.scene
    speed = fastest(wall, triangles, plan.n_steps * plan.dt, plan.coupling)
    room = 0.5 * SKIN * scene.d_min
    if speed * plan.dt * LEAST_REBUILD > room:
        refused = speed * plan.dt > room
        told = "particles would be behind it unseen" if refused else "neighbour lists are made anew nearly every step"
        yield Finding(
            "wall-speed",
            "refuse" if refused else "warn",
            f"walls.{name}: moves with up to {speed:.3g} m/s, {speed * plan.dt:.3g} m in a step of {plan.dt:.3g} s, "
            f"against {room:.3g} m that lists allow (half their skin): {told}: expected a slower motion or a shorter "
            "run.dt",
        )


def _edges(plan: Plan, name: str, wall: WallKeys) -> Iterator[Finding]:
    """Yield whether overlaps are so large that particles touch two triangles of a curved wall over much of it.

    A particle within delta/theta of an inner edge touches both triangles, theta the angle between them. They are w
    wide, theta is w/R, and the chord error w²/(8 R): a share of delta/(4 chord error).
    """
    if not isinstance(wall, CylinderWall | ConeWall):
        return
    line = revolved(wall)
    assert line is not None  # noqa: S101  # it is one
    largest = max(line.start[0], line.end[0])
    chord = largest * (1.0 - math.cos(math.pi / sides_of(largest, CHORD * 0.5 * plan.scene.d_min)))
    own = plan.species.index[name]
    overlap = max((c.delta_max or 0.0 for (_, j), c in plan.contacts.items() if j == own), default=0.0)
    if (share := 0.25 * overlap / chord) > MOST_SHARE:
        yield Finding(
            "wall-edges",
            "warn",
            f"walls.{name}: with an overlap of {overlap:.2g} m particles touch two of its triangles at once over "
            f"{100.0 * min(share, 1.0):.2g} % of it, and it is twice as stiff there: expected a stiffer contact, or a "
            "cylinder without ends and motion, which is no mesh",
        )
