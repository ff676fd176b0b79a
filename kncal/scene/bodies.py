"""The bodies of a scene one by one: spheres, and planes that bound them. SI units throughout."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from kncal.physics.material import Material

Vector = tuple[float, float, float]
Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, ...] = ("x", "y", "z")
#: What ``material = ...`` of a wall says for a rigid one; no material may have this name.
RIGID = "rigid"


@dataclass(frozen=True, kw_only=True)
class Particle:
    """A solid sphere.

    Attributes
    ----------
    name : unique among particles and walls
    group : of the case file that it belongs to; the name itself where the group has one particle
    material : Material
    radius : [m]
    position, velocity : of the centre at t = 0 [m], [m/s]
    spin : angular velocity at t = 0 [rad/s]
    frozen : whether it never moves: to those that move its mass is infinite
    """

    name: str
    group: str = ""
    material: Material
    radius: float
    position: Vector
    velocity: Vector = (0.0, 0.0, 0.0)
    spin: Vector = (0.0, 0.0, 0.0)
    frozen: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """What an exception of the case may call it: its own name, that of its group, and of its material."""
        return self.name, self.group or self.name, self.material.name


@dataclass(frozen=True, kw_only=True)
class Wall:
    """An infinite plane wall normal to a coordinate axis; a particle stays on the side where it starts.

    Attributes
    ----------
    name : unique among particles and walls
    axis : "x", "y" or "z", the plane's normal
    position : coordinate of the plane on that axis [m]
    material : Material, or None for a rigid wall
    """

    name: str
    axis: Axis
    position: float
    material: Material | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """What an exception of the case may call it: its own name, and that of its material."""
        return self.name, RIGID if self.material is None else self.material.name


Body = Particle | Wall
