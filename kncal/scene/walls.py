"""The kinds of walls that a scene may have: each a table of the case file, and the planes that it stands for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Discriminator, Field, Tag

from kncal.core.registry import Registry
from kncal.physics.material import Material
from kncal.scene.bodies import RIGID, Axis, Wall
from kncal.scene.values import Coordinate, Name, Size, checked_class


@checked_class
class PlaneWall:
    """``[walls.NAME]``: an infinite plane; a particle stays on the side where it starts."""

    shape: Literal["plane"] = Field(default="plane", description='"plane"')
    axis: Axis = Field(description='the plane\'s normal: "x", "y" or "z"')
    position: Coordinate = Field(description="coordinate of the plane [m]")
    material: Name = Field(description='the name of a material, or "rigid"')


@checked_class
class BoxWall:
    """``[walls.NAME]`` with ``shape = "box"``: 0 … size; open where an axis is periodic or the layer's."""

    shape: Literal["box"] = Field(description='"box"')
    size: Size = Field(description="[width, depth, height]: extents in x, y and z [m]")
    material: Name = Field(default=RIGID, description='the name of a material, or "rigid"')

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


class WallKind(NamedTuple):
    """A kind of wall, by the word that ``shape`` says; ``planes``: what touches, from name, table and material."""

    name: str
    table: type[PlaneWall] | type[BoxWall]
    planes: Callable[[str, Any, Material | None], tuple[Wall, ...]]


def _plane(name: str, wall: PlaneWall, material: Material | None) -> tuple[Wall, ...]:
    return (Wall(name=name, axis=wall.axis, position=wall.position, material=material),)


def _floor(name: str, wall: BoxWall, material: Material | None) -> tuple[Wall, ...]:
    """A box stands as its floor: all its walls are alike."""
    return (Wall(name=name, axis="z", position=0.0, material=material),)


WALLS = Registry("shape", WallKind, WallKind("plane", PlaneWall, _plane), WallKind("box", BoxWall, _floor))


def _shape(wall: object) -> str:
    found = wall.get("shape", "plane") if isinstance(wall, dict) else getattr(wall, "shape", "")
    return str(found)


AnyWall = Annotated[Annotated[PlaneWall, Tag("plane")] | Annotated[BoxWall, Tag("box")], Discriminator(_shape)]
