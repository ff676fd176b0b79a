"""Where a moving wall is, and how fast: closed forms of the motions that LIGGGHTS carries out step by step.

Translations and oscillations of a wall come first, then its rotations in their order: each carries the axes of those
after it along. So a wall's points go with

    x(t) = s(t) + o_1 + R_1 (o_2 - o_1 + R_2 (x_0 - o_2)), s the sum of the translations,

which LIGGGHTS makes of `fix move/mesh` in that order, but for errors of the order of a step for oscillations.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from kncal.core.checks import Array
from kncal.scene.bodies import Vector
from kncal.scene.shapes import Bounds, PathOf, bounds_of, faces
from kncal.scene.walls import AnyMotion, Oscillation, Rotation, Translation, WallKeys

#: Names and triangles (n, 3, 3) [m] of walls.
Surfaces = dict[str, Array]

#: A time this near below the end of an interval, in intervals, is that end.
_ROUNDING = 1e-6


@dataclass(frozen=True, kw_only=True)
class Pose:
    """A wall at one time: a point that began at x_0 is at ``turn`` x_0 + ``shift`` [m].

    Its velocity there is ``velocity`` + ``spin`` × x [m/s], [rad/s]. ``origins``: where a point of the axis of each
    motion is [m], of those that are rotations and have started.
    """

    turn: Array
    shift: Array
    velocity: Array
    spin: Array
    origins: dict[int, Array]

    def placed(self, points: Array) -> Array:
        """Return where points (…, 3) of the wall, given as they were at the start, are now [m]."""
        return np.asarray(points @ self.turn.T + self.shift)

    def speeds(self, points: Array) -> Array:
        """Return the velocities (…, 3) of the wall at points (…, 3), given as they are now [m/s]."""
        return np.asarray(self.velocity + np.cross(self.spin, points))


def when(time: float, interval: float) -> float:
    """Return the first end of an interval at or after ``time`` [s], as events go; ``interval`` 0: the time itself."""
    return interval * math.ceil(time / interval - _ROUNDING) if interval else time


def at_work(motion: AnyMotion, time: float, interval: float = 0.0) -> bool:
    """Whether a motion goes on from ``time`` on; times are ends of intervals."""
    ends = motion.stop is not None and when(motion.stop, interval) <= time
    return when(motion.start, interval) <= time and not ends


def in_order(motions: Sequence[AnyMotion]) -> list[tuple[int, AnyMotion]]:
    """Return the motions with their numbers as they are carried out: translations, then rotations."""
    return sorted(enumerate(motions), key=lambda item: isinstance(item[1], Rotation))


def pose(motions: Sequence[AnyMotion], time: float, interval: float = 0.0) -> Pose:
    """Return the pose of a wall with these motions at ``time`` [s].

    ``interval`` [s]: motions start and stop at ends of intervals (see `when`); 0: at their own times.
    """
    times = {when(t, interval) for m in motions for t in (m.start, m.stop) if t is not None}
    turn, shift = np.eye(3), np.zeros(3)
    origins: dict[int, Array] = {}
    for begin, end in pairwise([0.0, *sorted(t for t in times if 0.0 < t < time), time]):
        moved = np.zeros(3)
        done: list[tuple[Array, Array]] = []  # turn and fixed point of the rotations so far
        for number, motion in in_order(motions):
            if not at_work(motion, begin, interval):
                origins.pop(number, None)
            elif isinstance(motion, Rotation):
                about = origins.get(number, np.array(motion.origin))
                origins[number] = _carried(about, done) + moved
                done.append((_rotation(motion, end - begin), about))
            else:
                start = when(motion.start, interval)
                moved = moved + _shift(motion, end - start) - _shift(motion, begin - start)
        shift = _carried(shift, done) + moved
        for matrix, _ in done:
            turn = matrix @ turn  # axes are parallel
    return Pose(turn=turn, shift=shift, origins=origins, **_speed(motions, time, interval, origins))


def _speed(motions: Sequence[AnyMotion], time: float, interval: float, origins: dict[int, Array]) -> dict[str, Array]:
    velocity, spin = np.zeros(3), np.zeros(3)
    for number, motion in enumerate(motions):
        if not at_work(motion, time, interval):
            continue
        if isinstance(motion, Rotation):
            omega = 2.0 * math.pi / motion.period * _unit(motion.axis)
            spin = spin + omega
            velocity = velocity - np.cross(omega, origins.get(number, np.array(motion.origin)))
        elif isinstance(motion, Translation):
            velocity = velocity + np.array(motion.velocity)
        elif isinstance(motion, Oscillation):
            rate = 2.0 * math.pi / motion.period
            velocity = velocity + rate * math.cos(rate * (time - when(motion.start, interval))) * np.array(
                motion.amplitude
            )
    return {"velocity": velocity, "spin": spin}


def _carried(point: Array, rotations: list[tuple[Array, Array]]) -> Array:
    """A point after the rotations (matrix, fixed point), the last of them first."""
    for matrix, about in reversed(rotations):
        point = about + matrix @ (point - about)
    return point


def _shift(motion: AnyMotion, since: float) -> Array:
    if isinstance(motion, Translation):
        return since * np.array(motion.velocity)
    assert isinstance(motion, Oscillation)  # noqa: S101  # there are three kinds
    return math.sin(2.0 * math.pi * since / motion.period) * np.array(motion.amplitude)


def _rotation(motion: Rotation, time: float) -> Array:
    from scipy.spatial.transform import Rotation as Turn

    angle = 2.0 * math.pi * math.fmod(time / motion.period, 1.0)
    return np.asarray(Turn.from_rotvec(angle * _unit(motion.axis)).as_matrix())


def _unit(vector: Vector) -> Array:
    return np.array(vector) / math.hypot(*vector)


#: Times of a period at which reach and speed are looked at; between them a circle is cut by 1 - cos(pi/64), 0.1 %.
_LOOKS = 64
_MISSED = 0.002


def fastest(wall: WallKeys, nodes: Array, end: float, interval: float = 0.0) -> float:
    """Return the highest speed of any of a wall's ``nodes`` (…, 3), given as at the start, up to ``end`` [s] [m/s]."""
    if not wall.motion:
        return 0.0
    corners = _corners(nodes, wall.motion)
    poses = (pose(wall.motion, time, interval) for time in _looks(wall.motion, end, interval))
    found = max(float(np.linalg.norm(p.speeds(p.placed(corners)), axis=1).max()) for p in poses)
    return (1.0 + _MISSED) * found


def swept(wall: WallKeys, nodes: Array, end: float, interval: float = 0.0) -> tuple[Array, Array]:
    """Return the lower and the upper corner of all places of a wall's ``nodes`` (…, 3) up to ``end`` [s] [m]."""
    corners = _corners(nodes, wall.motion)
    if not wall.motion:
        return corners.min(axis=0), corners.max(axis=0)
    placed = [pose(wall.motion, time, interval).placed(corners) for time in _looks(wall.motion, end, interval)]
    low = np.min([p.min(axis=0) for p in placed], axis=0)
    high = np.max([p.max(axis=0) for p in placed], axis=0)
    first, last = corners.min(axis=0), corners.max(axis=0)
    rounding = 1e-9 * float(np.abs(corners).max(initial=0.0))
    low = np.where(low < first - rounding, low - _MISSED * (high - low), first)
    high = np.where(high > last + rounding, high + _MISSED * (high - low), last)
    return low, high


def reach(wall: WallKeys, end: float, *, path_of: PathOf, radius: float) -> Bounds:
    """Return the lower and the upper corner of all places of a wall up to ``end`` [s] [m].

    They are infinite where it has no end. ``radius``: of the smallest particle [m], see `kncal.scene.shapes.faces`.
    """
    low, high = bounds_of(wall, path_of)
    finite = np.isfinite(low) & np.isfinite(high)
    if not wall.motion:
        return low, high
    if finite.all():
        return swept(wall, faces(wall, path_of=path_of, radius=radius), end)
    box = np.array(list(product(*np.where(finite, (low, high), 0.0).T)))
    far = swept(wall, box, end)
    return np.where(finite, far[0], low), np.where(finite, far[1], high)


def walls_at(
    walls: Mapping[str, WallKeys],
    time: float,
    interval: float,
    *,
    path_of: PathOf,
    extent: Bounds,
    radius: float,
    open_axes: str = "",
) -> Surfaces:
    """Return the triangles of the walls that are there at ``time`` [s], where they are then.

    ``interval`` [s]: changes are at the ends of intervals; the rest as `kncal.scene.shapes.faces` takes it.
    """
    found = {}
    for name, wall in walls.items():
        if wall.remove_at is None or when(wall.remove_at, interval) > time:
            own = faces(wall, path_of=path_of, extent=extent, radius=radius, open_axes=open_axes)
            found[name] = pose(wall.motion, time, interval).placed(own)
    return found


def _corners(nodes: Array, motions: Sequence[AnyMotion]) -> Array:
    """Few points that reach as far as all nodes do in any pose: all of them if the wall turns, else their box."""
    flat: Array = nodes.reshape(-1, 3)
    if any(isinstance(m, Rotation) for m in motions):
        return np.asarray(np.unique(flat, axis=0))
    return np.stack([flat.min(axis=0), flat.max(axis=0)])


def _looks(motions: Sequence[AnyMotion], end: float, interval: float) -> Iterator[float]:
    """Times that catch the reach of every motion: its ends, and of a period the first and the last."""
    found = {0.0, end}
    for m in motions:
        start = when(m.start, interval)
        stop = end if m.stop is None else min(end, when(m.stop, interval))
        found |= {start, stop}
        if isinstance(m, Rotation | Oscillation):
            steps = [m.period * k / _LOOKS for k in range(_LOOKS + 1)]
            found |= {t for step in steps for t in (start + step, stop - step) if start <= t <= stop}
    yield from sorted(t for t in found if t <= end)
