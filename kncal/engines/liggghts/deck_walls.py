"""Walls, their motions and what happens to them, in LIGGGHTS' words.

A wall that stays and has no end is a primitive of LIGGGHTS, exact and with a command of its own. Any other is a mesh.
LIGGGHTS takes one ``fix wall/gran ... mesh`` for all of them, so a mesh is taken away by making that command anew for
those that are left: their contacts begin with new tangential springs. Superposed motions of a mesh are taken off in
reverse order: where one of them starts or stops all go, and those that go on are put back with the phase and the axis
that they have.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.core.templating import checked_name, number
from kncal.scene.bodies import AXES, Vector
from kncal.scene.shapes import Bounds, PathOf, faces, is_endless
from kncal.scene.wall_limits import PRECISION
from kncal.scene.wall_motion import at_work, in_order, pose, swept, when
from kncal.scene.walls import BoxWall, CylinderWall, Oscillation, PlaneWall, Rotation, Translation, WallKeys


@dataclass(frozen=True, kw_only=True)
class DeckWall:
    """What LIGGGHTS has for a wall, or for a side of it.

    Attributes
    ----------
    name : of the wall of the scene
    side : its own name where a wall has several
    kind : index of its atom type
    fix : id of its command: of the primitive, or of its mesh
    axis, position : of a plane's normal [m]; of a cylinder the axis
    centre, radius : of a cylinder [m]; radius 0: a plane
    triangles : (n, 3, 3) of a mesh [m]; None: a primitive
    wall : its table of the scene, for what happens to it
    """

    name: str
    side: str = ""
    kind: int
    fix: str
    axis: str = "z"
    position: float = 0.0
    centre: tuple[float, float] = (0.0, 0.0)
    radius: float = 0.0
    triangles: Array | None = None
    wall: WallKeys

    @property
    def is_mesh(self) -> bool:
        """Whether it is a mesh."""
        return self.triangles is not None

    @property
    def file(self) -> str:
        """Name of the file of its triangles."""
        return f"wall_{checked_name(self.name)}.stl"

    @property
    def primitive(self) -> str:
        """LIGGGHTS' words for a primitive."""
        if self.radius:
            return f"{self.axis}cylinder {number(self.radius)} {' '.join(map(number, self.centre))}"
        return f"{self.axis}plane {number(self.position)}"

    def there(self, time: float, interval: float) -> bool:
        """Whether the wall is still there after what happens at ``time`` [s]."""
        return self.wall.remove_at is None or when(self.wall.remove_at, interval) > time


def deck_walls(
    walls: Mapping[str, WallKeys],
    kinds: Mapping[str, int],
    *,
    extent: Bounds,
    open_axes: str,
    radius: float,
    path_of: PathOf,
) -> list[DeckWall]:
    """Return LIGGGHTS' walls for those of a scene, primitives first.

    Parameters
    ----------
    walls : by name
    kinds : index of the atom type of each
    extent : of the box where endless walls end [m]
    open_axes : on which boxes have no sides: periodic, or a layer's, as "y"
    radius : of the smallest particle [m]
    path_of : where mesh files lie
    """
    made: list[DeckWall] = []
    for name, wall in walls.items():
        made += _primitives(name, wall, kinds[name], len(made), extent, open_axes)
    whole = {wall.name for wall in made}
    for name, wall in walls.items():
        if name not in whole:
            triangles = faces(wall, path_of=path_of, extent=extent, radius=radius, open_axes=open_axes)
            fix = f"mesh_{len(made) + 1}"
            made.append(DeckWall(name=name, kind=kinds[name], fix=fix, triangles=triangles, wall=wall))
    return made


_SIDES = {"z": ("floor", "lid"), "x": ("left", "right"), "y": ("front", "back")}


def _primitives(
    name: str, wall: WallKeys, kind: int, before: int, extent: Bounds, open_axes: str
) -> Iterator[DeckWall]:
    """The primitives of a wall; none if it must be a mesh."""
    if not is_endless(wall, extent):
        return
    if isinstance(wall, PlaneWall):
        yield DeckWall(
            name=name, kind=kind, fix=f"wall_{before + 1}", axis=wall.axis, position=wall.position, wall=wall
        )
    if isinstance(wall, CylinderWall):
        yield DeckWall(
            name=name,
            kind=kind,
            fix=f"wall_{before + 1}",
            axis=wall.axis,
            centre=wall.centre,
            radius=wall.radius,
            wall=wall,
        )
    if isinstance(wall, BoxWall):
        sides = [(axis, side, end) for axis in "zxy" for side, end in enumerate((wall.low, wall.high))]
        kept = [(axis, side, end[AXES.index(axis)]) for axis, side, end in sides if axis not in open_axes]
        for i, (axis, side, at) in enumerate(kept, start=before + 1):
            yield DeckWall(
                name=name, side=_SIDES[axis][side], kind=kind, fix=f"wall_{i}", axis=axis, position=at, wall=wall
            )


def box_of(extent: Bounds, walls: Sequence[DeckWall], periodic: str, end: float, interval: float) -> Bounds:
    """Return the box for LIGGGHTS [m]: the extent, and all that moving meshes reach up to ``end`` [s].

    A node of a mesh outside it would be dropped or wrapped, with a warning alone. Where the box is periodic it stays.
    """
    low, high = extent[0].copy(), extent[1].copy()
    fixed = [AXES.index(axis) for axis in periodic]
    for wall in walls:
        if wall.triangles is not None:
            reach = swept(wall.wall, wall.triangles, end, interval)
            more = 1e-6 * (extent[1] - extent[0])
            low = np.where(reach[0] < low, reach[0] - more, low)
            high = np.where(reach[1] > high, reach[1] + more, high)
    low[fixed], high[fixed] = extent[0][fixed], extent[1][fixed]
    return low, high


def mesh_words(wall: DeckWall, d_min: float) -> str:
    """Return what follows ``fix ID all mesh/surface``."""
    words = f"file {wall.file} type {wall.kind + 1} precision {number(min(PRECISION * d_min, 1e-4))}"
    words += " curvature_tolerant yes"
    if any(wall.wall.surface_velocity):
        words += f" surface_vel {_vector(wall.wall.surface_velocity)}"
    return words


def mesh_walls_line(walls: Iterable[DeckWall], selectors: str, switches: str) -> str:
    """Return the one command that makes walls of meshes; "" if there are none."""
    ids = [wall.fix for wall in walls if wall.is_mesh]
    if not ids:
        return ""
    return (
        f"fix           meshes all wall/gran model {selectors} mesh n_meshes {len(ids)} meshes {' '.join(ids)}"
        f"{' ' + switches if switches else ''}"
    )


def move_lines(wall: DeckWall, since: float, now: float, interval: float) -> list[str]:
    """Return the commands that move a mesh from ``now`` on, of motions that were put on it at ``since`` [s].

    At a restart ``now`` is later: LIGGGHTS goes on with the phase of an oscillation, but forgets that an axis was
    carried along.
    """
    wanted = [(n, m) for n, m in in_order(wall.wall.motion) if at_work(m, now, interval)]
    origins = pose(wall.wall.motion, now, interval).origins
    lines = []
    for n, motion in wanted:
        if isinstance(motion, Translation):
            words = f"linear {_vector(motion.velocity)}"
        elif isinstance(motion, Oscillation):
            words = _oscillation(motion, since - when(motion.start, interval))
        else:
            assert isinstance(motion, Rotation)  # noqa: S101  # there are three kinds
            about = origins.get(n, np.array(motion.origin))
            words = f"rotate origin {_vector(about)} axis {_vector(motion.axis)} period {number(motion.period)}"
        lines.append(f"fix           {_move(wall, n)} all move/mesh mesh {wall.fix} {words}")
    return lines


def _oscillation(motion: Oscillation, since: float) -> str:
    phase = 2.0 * math.pi * math.fmod(since / motion.period, 1.0)
    if phase == 0.0:
        return f"wiggle amplitude {_vector(motion.amplitude)} period {number(motion.period)}"
    size = math.hypot(*motion.amplitude)
    axis = np.array(motion.amplitude) / size if size else np.array([0.0, 0.0, 1.0])
    # LIGGGHTS' shift is amplitude (cos(2 pi t/period + phase) - cos(phase))
    return (
        f"viblin axis {_vector(axis)} order 1 amplitude {number(size)} phase {number(phase - 0.5 * math.pi)} "
        f"period {number(motion.period)}"
    )


def _move(wall: DeckWall, motion: int) -> str:
    return f"{wall.fix}_move_{motion + 1}"


def _vector(values: Vector | Array) -> str:
    return " ".join(number(float(value)) for value in values)


def last_change(wall: WallKeys, time: float, interval: float) -> float:
    """Return when the motions of a wall were last put on it, up to ``time`` [s]."""
    times = [when(t, interval) for m in wall.motion for t in (m.start, m.stop) if t is not None]
    return max((t for t in times if t <= time), default=0.0)


def change_times(walls: Iterable[DeckWall], interval: float) -> list[float]:
    """Return the times after the start at which something happens to a wall, in order [s]."""
    found = set()
    for wall in walls:
        own = [wall.wall.remove_at] + [t for m in wall.wall.motion for t in (m.start, m.stop)]
        found |= {when(t, interval) for t in own if t is not None}
    return sorted(found - {0.0})


def changed(walls: Iterable[DeckWall], time: float, interval: float) -> list[str]:
    """Return the names of the walls to which something happens at ``time`` [s], an end of an interval."""
    return sorted({wall.name for wall in walls if time in change_times([wall], interval)})


def output_lines(wall: DeckWall, every: int) -> list[str]:
    """Return the commands that write the force of the particles on a wall [N] every so many steps."""
    file = f"force_{wall.name}{'_' + wall.side if wall.side else ''}.txt"
    if wall.is_mesh:
        lines, source = [], f"f_{wall.fix}"
    else:
        source = f"c_sum_{wall.fix}"
        parts = " ".join(f"f_force_{wall.fix}[{k}]" for k in (1, 2, 3))
        lines = [f"compute       sum_{wall.fix} all reduce sum {parts}"]
    values = " ".join(f"{source}[{k}]" for k in (1, 2, 3))
    return [*lines, f"fix           out_{wall.fix} all ave/time {every} 1 {every} {values} file {file}"]


def change_lines(
    walls: Sequence[DeckWall],
    time: float,
    interval: float,
    selectors: str,
    switches: str,
    *,
    recorded: bool = False,
) -> list[str]:
    """Return the commands for what happens to the walls at ``time`` [s], an end of an interval.

    ``recorded``: whether the deck has `output_lines`.
    A ``run`` with its set-up must follow: LIGGGHTS ends at a mesh that begins to move without.
    """
    before = time - 0.5 * interval
    lines: list[str] = []
    gone = [wall for wall in walls if wall.there(before, interval) and not wall.there(time, interval)]
    if recorded:
        for wall in gone:
            lines.append(f"unfix         out_{wall.fix}")
            lines += [] if wall.is_mesh else [f"uncompute     sum_{wall.fix}"]
    for wall in walls:
        changes = wall.is_mesh and wall.there(before, interval) and last_change(wall.wall, time, interval) > before
        if wall.is_mesh and (changes or wall in gone):
            ended = [n for n, m in in_order(wall.wall.motion) if at_work(m, before, interval)]
            lines += [f"unfix         {_move(wall, n)}" for n in reversed(ended)]
        if changes and wall not in gone:
            lines += move_lines(wall, time, time, interval)
    if any(wall.is_mesh for wall in gone):
        lines.append("unfix         meshes")
    lines += [f"unfix         {wall.fix}" for wall in gone]
    if any(wall.is_mesh for wall in gone):
        left = mesh_walls_line([wall for wall in walls if wall.there(time, interval)], selectors, switches)
        lines += [left] if left else []
    return lines
