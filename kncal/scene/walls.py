"""The kinds of walls that a scene may have, and how walls move: each a table of the case file.

Their geometry is in `kncal.scene.shapes`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import PurePosixPath
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import AfterValidator, Discriminator, Field, Tag

from kncal.core.registry import Registry
from kncal.physics.material import Material
from kncal.scene.bodies import RIGID, Axis, Vector, Wall
from kncal.scene.values import (
    Coordinate,
    Flag,
    Length,
    Name,
    Number,
    Position,
    Seconds,
    Size,
    Time,
    Velocity,
    Word,
    above_zero,
    checked_class,
    within,
)

#: Motions of one wall; LIGGGHTS carries out each in turn.
MOST_MOTIONS = 5
ORIGIN: Vector = (0.0, 0.0, 0.0)

Problem = tuple[tuple[str | int, ...], str]


def _direction(vector: Vector) -> Vector:
    if not any(vector):
        raise ValueError("expected a vector that is not zero")
    return vector


def _file(name: str) -> str:
    path = PurePosixPath(name)
    if not name.isprintable() or len(name) > 200 or path.is_absolute() or ".." in path.parts or not path.suffix:
        raise ValueError('expected the name of a file in the folder of the case, such as "hopper.stl"')
    return name


_Component = Annotated[Number, within(-1e6, 1e6)]
Direction = Annotated[tuple[_Component, _Component, _Component], AfterValidator(_direction)]
#: A length that may be zero, as of a cone that ends in a tip, or a disc without a hole.
Extent = Annotated[Number, within(0.0, 1e3, "m", "1 mm is 1e-3")]
FileName = Annotated[Word, AfterValidator(_file)]
Scale = Annotated[Number, above_zero(high=1e6)]
Degrees = Annotated[Number, within(-360.0, 360.0)]


@checked_class
class AnyMotion:
    """``[[walls.NAME.motion]]``: what all kinds of motion have; ends are those of intervals at or after these times."""

    kind: str
    start: Time = Field(default=0.0, description="when it starts [s]")
    stop: Seconds | None = Field(default=None, description="when it stops [s]; none: never")


@checked_class
class Translation(AnyMotion):
    """``kind = "translate"``: the wall moves at a constant velocity."""

    kind: Literal["translate"] = Field(description='"translate"')
    velocity: Velocity = Field(description="[x, y, z] [m/s]")


@checked_class
class Rotation(AnyMotion):
    """``kind = "rotate"``: the wall turns about an axis."""

    kind: Literal["rotate"] = Field(description='"rotate"')
    origin: Position = Field(default=ORIGIN, description="[x, y, z] of a point on the axis when it starts [m]")
    axis: Direction = Field(description="[x, y, z] along the axis; the wall turns by the right-hand rule")
    period: Seconds = Field(description="time of one turn [s]")


@checked_class
class Oscillation(AnyMotion):
    """``kind = "oscillate"``: the wall moves by amplitude sin(2π t/period), t from its start."""

    kind: Literal["oscillate"] = Field(description='"oscillate"')
    amplitude: Position = Field(description="[x, y, z] [m]")
    period: Seconds = Field(description="time of one oscillation [s]")


Motion = Annotated[
    Annotated[Translation, Tag("translate")]
    | Annotated[Rotation, Tag("rotate")]
    | Annotated[Oscillation, Tag("oscillate")],
    Discriminator(lambda given: _tag(given, "kind")),
]


@checked_class
class WallKeys:
    """``[walls.NAME]``: what walls of all shapes have."""

    shape: str
    material: Name = Field(default=RIGID, description='the name of a material, or "rigid"')
    motion: Annotated[tuple[Motion, ...], Field(max_length=MOST_MOTIONS)] = Field(
        default=(),
        description="[[walls.NAME.motion]], each a motion; translations first, and each carries the next axes along",
    )
    surface_velocity: Velocity = Field(
        default=ORIGIN, description="[x, y, z] of the surface of a wall that stays, as of a belt [m/s]"
    )
    remove_at: Seconds | None = Field(default=None, description="when the wall is taken away [s]; none: never")

    @property
    def moves(self) -> bool:
        """Whether the wall is ever in motion; the surface of a belt is, the belt is not."""
        return bool(self.motion)

    @property
    def stays_whole(self) -> bool:
        """Whether the wall is there from start to end, and neither it nor its surface moves."""
        return not self.motion and not any(self.surface_velocity) and self.remove_at is None


@checked_class
class PlaneWall(WallKeys):
    """``shape = "plane"``: an infinite plane; a particle stays on the side where it starts."""

    shape: Literal["plane"] = Field(default="plane", description='"plane"')
    axis: Axis = Field(description='the plane\'s normal: "x", "y" or "z"')
    position: Coordinate = Field(description="coordinate of the plane [m]")
    material: Name = Field(description='the name of a material, or "rigid"')


@checked_class
class BoxWall(WallKeys):
    """``shape = "box"``: six sides; open where an axis is periodic or the layer's."""

    shape: Literal["box"] = Field(description='"box"')
    size: Size = Field(description="[width, depth, height]: extents in x, y and z [m]")
    low: Position = Field(default=ORIGIN, description="[x, y, z] of the lowest corner [m]")

    @property
    def high(self) -> Vector:
        """The corner opposite to `low` [m]."""
        x, y, z = (low + extent for low, extent in zip(self.low, self.size, strict=True))
        return x, y, z

    @property
    def width(self) -> float:
        """Extent in x [m]."""
        return self.size[0]

    @property
    def depth(self) -> float:
        """Extent in y [m]."""
        return self.size[1]

    @property
    def height(self) -> float:
        """Extent in z [m]."""
        return self.size[2]

    @property
    def volume(self) -> float:
        """Volume [m³]."""
        return self.width * self.depth * self.height


@checked_class
class CylinderWall(WallKeys):
    """``shape = "cylinder"``: a tube without ends."""

    shape: Literal["cylinder"] = Field(description='"cylinder"')
    axis: Axis = Field(default="z", description='its axis: "x", "y" or "z"')
    centre: tuple[Coordinate, Coordinate] = Field(
        default=(0.0, 0.0), description="the axis' two other coordinates, in the order x, y, z [m]"
    )
    radius: Length = Field(description="radius [m]")
    low: Coordinate | None = Field(default=None, description="where it begins on its axis [m]; none: with the box")
    high: Coordinate | None = Field(default=None, description="where it ends on its axis [m]; none: with the box")


@checked_class
class ConeWall(WallKeys):
    """``shape = "cone"``: the frustum of a cone, without ends."""

    shape: Literal["cone"] = Field(description='"cone"')
    axis: Axis = Field(default="z", description='its axis: "x", "y" or "z"')
    centre: tuple[Coordinate, Coordinate] = Field(
        default=(0.0, 0.0), description="the axis' two other coordinates, in the order x, y, z [m]"
    )
    radius_low: Extent = Field(description="radius at its lower end [m]; 0: a tip")
    radius_high: Extent = Field(description="radius at its upper end [m]")
    low: Coordinate = Field(description="where it begins on its axis [m]")
    high: Coordinate = Field(description="where it ends on its axis [m]")


@checked_class
class PlateWall(WallKeys):
    """``shape = "plate"``: a parallelogram."""

    shape: Literal["plate"] = Field(description='"plate"')
    corner: Position = Field(description="[x, y, z] of a corner [m]")
    edge_1: Direction = Field(description="[x, y, z] from there to the next corner [m]")
    edge_2: Direction = Field(description="[x, y, z] from there to the corner on the other side [m]")


@checked_class
class DiscWall(WallKeys):
    """``shape = "disc"``: a disc, or a ring."""

    shape: Literal["disc"] = Field(description='"disc"')
    centre: Position = Field(description="[x, y, z] of its centre [m]")
    normal: Direction = Field(default=(0.0, 0.0, 1.0), description="[x, y, z] of its normal")
    radius: Length = Field(description="radius [m]")
    hole: Extent = Field(default=0.0, description="radius of the hole in its middle [m]")


@checked_class
class MeshWall(WallKeys):
    """``shape = "mesh"``: triangles from a file, scaled, then turned, then moved."""

    shape: Literal["mesh"] = Field(description='"mesh"')
    file: FileName = Field(description="name of the file in the case's folder: STL, OBJ, PLY, VTK, VTP, …")
    scale: Scale = Field(default=1.0, description="factor that makes m of the file's unit: 0.001 for mm")
    turn_axis: Direction = Field(default=(0.0, 0.0, 1.0), description="[x, y, z] of the axis, through the origin")
    turn_degrees: Degrees = Field(default=0.0, description="by how much it is turned, by the right-hand rule [°]")
    move: Position = Field(default=ORIGIN, description="[x, y, z] by which it is moved [m]")
    closed: Flag = Field(default=False, description="true: it must enclose a volume, and is refused with open edges")


class WallKind(NamedTuple):
    """A kind of wall, by the word that ``shape`` says.

    ``planes``: the infinite planes that touch, from name, table and material; ``problems``: what is wrong among the
    values of one table, as (path of the key in it, what is wrong).
    """

    name: str
    table: type[WallKeys]
    planes: Callable[[str, Any, Material | None], tuple[Wall, ...]]
    problems: Callable[[Any], Iterator[Problem]]


class MotionKind(NamedTuple):
    """A kind of motion, by the word that ``kind`` says."""

    name: str
    table: type[AnyMotion]


def _plane(name: str, wall: PlaneWall, material: Material | None) -> tuple[Wall, ...]:
    return (Wall(name=name, axis=wall.axis, position=wall.position, material=material),)


def _floor(name: str, wall: BoxWall, material: Material | None) -> tuple[Wall, ...]:
    """A box stands as its floor: all its walls are alike."""
    return (Wall(name=name, axis="z", position=wall.low[2], material=material),)


def _none(name: str, wall: WallKeys, material: Material | None) -> tuple[Wall, ...]:
    return ()


def _any_problems(wall: WallKeys) -> Iterator[Problem]:
    for i, motion in enumerate(wall.motion):
        if motion.stop is not None and motion.stop <= motion.start:
            yield ("motion", i, "stop"), f"stop = {motion.stop:g} s: expected one after start = {motion.start:g} s"
    turns = [(i, m.axis) for i, m in enumerate(wall.motion) if isinstance(m, Rotation)]
    for i, axis in turns[1:]:
        if not _parallel(axis, turns[0][1]):
            yield ("motion", i, "axis"), f"axis = {list(axis)}: expected all rotations of a wall about parallel axes"
    if wall.motion and any(wall.surface_velocity):
        yield ("surface_velocity",), "given for a wall with a motion: expected one of the two"


def _parallel(one: Vector, other: Vector) -> bool:
    (a, b, c), (d, e, f) = one, other
    area = math.hypot(b * f - c * e, c * d - a * f, a * e - b * d)
    return area <= 1e-6 * math.hypot(*one) * math.hypot(*other)


def _tube_problems(wall: CylinderWall | ConeWall) -> Iterator[Problem]:
    yield from _any_problems(wall)
    if wall.low is not None and wall.high is not None and wall.low >= wall.high:
        yield ("high",), f"high = {wall.high:g} m: expected one above low = {wall.low:g} m"
    if isinstance(wall, ConeWall) and wall.radius_low == wall.radius_high:
        hint = "expected another one, or a cylinder" if wall.radius_low else "expected one above 0"
        yield ("radius_high",), f"radius_high = {wall.radius_high:g} m, as radius_low: {hint}"


def _plate_problems(wall: PlateWall) -> Iterator[Problem]:
    yield from _any_problems(wall)
    if _parallel(wall.edge_1, wall.edge_2):
        yield ("edge_2",), f"edge_2 = {list(wall.edge_2)} is along edge_1: expected an edge in another direction"


def _disc_problems(wall: DiscWall) -> Iterator[Problem]:
    yield from _any_problems(wall)
    if wall.hole >= wall.radius:
        yield ("hole",), f"hole = {wall.hole:g} m: expected one below radius = {wall.radius:g} m"


WALLS = Registry(
    "shape",
    WallKind,
    WallKind("plane", PlaneWall, _plane, _any_problems),
    WallKind("box", BoxWall, _floor, _any_problems),
    WallKind("cylinder", CylinderWall, _none, _tube_problems),
    WallKind("cone", ConeWall, _none, _tube_problems),
    WallKind("plate", PlateWall, _none, _plate_problems),
    WallKind("disc", DiscWall, _none, _disc_problems),
    WallKind("mesh", MeshWall, _none, _any_problems),
)
MOTIONS = Registry(
    "kind",
    MotionKind,
    MotionKind("translate", Translation),
    MotionKind("rotate", Rotation),
    MotionKind("oscillate", Oscillation),
)


def _tag(given: object, key: str, default: str = "") -> str:
    found = given.get(key, default) if isinstance(given, dict) else getattr(given, key, default)
    return str(found)


AnyWall = Annotated[
    Annotated[PlaneWall, Tag("plane")]
    | Annotated[BoxWall, Tag("box")]
    | Annotated[CylinderWall, Tag("cylinder")]
    | Annotated[ConeWall, Tag("cone")]
    | Annotated[PlateWall, Tag("plate")]
    | Annotated[DiscWall, Tag("disc")]
    | Annotated[MeshWall, Tag("mesh")],
    Discriminator(lambda given: _tag(given, "shape", "plane")),
]
