"""Groups of particles of a scene, where they start, and where they leave: tables of the case file. SI units."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag

from kncal.core.checks import Array
from kncal.scene.bodies import AXES, Axis
from kncal.scene.sizes import Sizes
from kncal.scene.values import (
    Coordinate,
    Flag,
    Length,
    Name,
    Number,
    Position,
    Share,
    Spin,
    Stiffness,
    Time,
    Velocity,
    Whole,
    above_zero,
    checked_class,
    within,
)
from kncal.scene.walls import FileName

#: Particles of one group.
MOST_PARTICLES = 1_000_000
AT_REST = (0.0, 0.0, 0.0)


Mass = Annotated[Number, above_zero("kg", high=1e6)]


@checked_class
class BoxRegion:
    """``region`` with ``shape = "box"``: low < x < high."""

    shape: Literal["box"] = Field(default="box", description='"box"')
    low: Position = Field(description="[x, y, z] of the lower corner [m]")
    high: Position = Field(description="[x, y, z] of the upper corner [m]")

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner [m]."""
        return np.array(self.low), np.array(self.high)

    @property
    def volume(self) -> float:
        """Volume [m³]."""
        return float(np.prod(np.array(self.high) - np.array(self.low)))

    def inside(self, points: Array, margin: Array | float = 0.0) -> Array:
        """Whether each of the ``points`` (n, 3) is inside, at least ``margin`` (n,) from every side."""
        gap = np.minimum(points - np.array(self.low), np.array(self.high) - points).min(axis=1)
        return np.asarray(gap >= margin)


@checked_class
class CylinderRegion:
    """``region`` with ``shape = "cylinder"``: a cylinder along an axis."""

    shape: Literal["cylinder"] = Field(description='"cylinder"')
    axis: Axis = Field(default="z", description='"x", "y" or "z"')
    centre: tuple[Coordinate, Coordinate] = Field(
        default=(0.0, 0.0), description="of the axis in the other two coordinates, in the order x, y, z [m]"
    )
    radius: Length = Field(description="radius [m]")
    low: Coordinate = Field(description="lower end along the axis [m]")
    high: Coordinate = Field(description="upper end along the axis [m]")

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner of the box around it [m]."""
        along, across = self._axes
        low, high = np.empty(3), np.empty(3)
        low[along], high[along] = self.low, self.high
        low[across], high[across] = np.array(self.centre) - self.radius, np.array(self.centre) + self.radius
        return low, high

    @property
    def volume(self) -> float:
        """Volume [m³]."""
        return float(np.pi * self.radius**2 * (self.high - self.low))

    def inside(self, points: Array, margin: Array | float = 0.0) -> Array:
        """Whether each of the ``points`` (n, 3) is inside, at least ``margin`` (n,) from every side."""
        along, across = self._axes
        away = self.radius - np.linalg.norm(points[:, across] - np.array(self.centre), axis=1)
        ends = np.minimum(points[:, along] - self.low, self.high - points[:, along])
        return np.asarray(np.minimum(away, ends) >= margin)

    @property
    def _axes(self) -> tuple[int, list[int]]:
        along = AXES.index(self.axis)
        return along, [k for k in range(3) if k != along]


def _shape(region: object) -> str:
    found = region.get("shape", "box") if isinstance(region, dict) else getattr(region, "shape", "")
    return str(found)


Region = Annotated[Annotated[BoxRegion, Tag("box")] | Annotated[CylinderRegion, Tag("cylinder")], Discriminator(_shape)]


@checked_class
class Particles:
    """``[particles.NAME]``: spheres of one material; a single particle is a group of one."""

    material: Name = Field(description="the name of a material")
    diameter: Length | None = Field(default=None, description="diameter [m]; none: sizes")
    sizes: Sizes | None = Field(default=None, description="[particles.NAME.sizes], several sizes in place of diameter")
    count: Annotated[Whole, within(0, MOST_PARTICLES)] | None = Field(
        default=None, description="number of particles; none: of the positions given; 0: gas only"
    )
    mass: Mass | None = Field(default=None, description="mass of the group [kg], in place of count")
    fill: Share | None = Field(
        default=None, description="volume of the particles over that of their region [-], in place of count"
    )
    place: Annotated[str, Field(strict=True)] = Field(
        default="given",
        description='where they start: "given" (position, positions, file), "lattice" (a loose lattice from the floor '
        'up; at random in the region), "settled" (LIGGGHTS settles that under gravity; without gravity, periodic in '
        'every axis, they are pressed together) or "stream" (LIGGGHTS inserts them in the region during the run)',
    )
    position: Position | None = Field(default=None, description="[x, y, z] of the centre of a single particle [m]")
    positions: Annotated[tuple[Position, ...], Field(max_length=MOST_PARTICLES)] = Field(
        default=(), description="[x, y, z] of the centre of each particle [m]"
    )
    file: FileName | None = Field(
        default=None, description="file in the case's folder with the centres: CSV, VTK, or a dump or data of LIGGGHTS"
    )
    scale: Annotated[Number, above_zero("m")] = Field(
        default=1.0, description="what the unit of length of the file is [m]: 1e-3 for mm"
    )
    region: Region | None = Field(
        default=None, description='[particles.NAME.region] with shape "box" or "cylinder"; none: the box of the scene'
    )
    velocity: Velocity = Field(default=AT_REST, description="[x, y, z] of the velocity at the start [m/s]")
    spin: Spin = Field(default=AT_REST, description="[x, y, z] of the angular velocity at the start [rad/s]")
    seed: Annotated[Whole, within(0, 2**31 - 1)] = Field(default=1, description="seed of what is random at the start")
    settle_k_n: Stiffness | None = Field(
        default=None,
        description='stiffness of the spring by which "settled" particles settle [N/m]; none: of the linear run',
    )
    frozen: Flag = Field(default=False, description="true: the particles do not move")
    rate: Annotated[Number, above_zero("kg/s", high=1e6)] | None = Field(
        default=None, description='mass per time of a "stream" [kg/s]'
    )
    start: Time = Field(default=0.0, description='time from which a "stream" flows [s]')

    @property
    def centres(self) -> tuple[Position, ...]:
        """The positions that the case file itself gives [m]."""
        return self.positions if self.position is None else (self.position,)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner of a box that holds all of the start as far as the case file tells [m]."""
        if self.region is not None:
            return self.region.bounds
        x = np.array(self.centres, dtype=np.float64).reshape(-1, 3)
        if not len(x):
            return np.full(3, np.inf), np.full(3, -np.inf)
        return x.min(axis=0), x.max(axis=0)


@checked_class
class Outlet:
    """``[outlets.NAME]``: a plane that counts the particles that pass it, over all of the domain."""

    axis: Axis = Field(default="z", description='the plane\'s normal: "x", "y" or "z"')
    position: Coordinate = Field(description="coordinate of the plane [m]")
    direction: Literal[-1, 1] = Field(default=-1, description="-1: those that pass it downwards in that coordinate; 1")
    delete: Flag = Field(default=True, description="true: they leave the scene there")

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner [m], infinite but for its own axis."""
        low, high = np.full(3, -np.inf), np.full(3, np.inf)
        low[AXES.index(self.axis)] = high[AXES.index(self.axis)] = self.position
        return low, high


@checked_class
class DomainBox:
    """``[domain]``: the box that is simulated; needed only for periods, and where walls and starts do not tell it."""

    low: Position = Field(description="[x, y, z] of the lower corner [m]")
    high: Position = Field(description="[x, y, z] of the upper corner [m]")


@checked_class
class ObserveChoice:
    """``[observe]``: what is measured, where the record alone does not tell."""

    surface: Literal["slope", "cone"] | None = Field(
        default=None,
        description='free surface whose angle is measured: "slope" (a plane, seen along axis) or "cone" (a heap about '
        "the vertical through centre); none: no angle",
    )
    axis: Axis = Field(default="y", description="direction in which a slope is seen, and a drum turns")
    centre: tuple[Coordinate, Coordinate] = Field(
        default=(0.0, 0.0), description="of the heap or the drum, in the two coordinates that it is seen in [m]"
    )
    width: Length | None = Field(default=None, description="of coarse graining [m]; none: the largest diameter")
    profile: Axis = Field(default="z", description="axis along which profiles are drawn")
    cell_number: Annotated[Whole, within(5, 1000)] = Field(
        default=25, description="particles in each cell in which mixing is counted"
    )
