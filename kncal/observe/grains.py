"""Particles of many sizes at one time, and the space that they are in: what observers of granular scenes take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Grains:
    """The particles that are there at one time.

    Attributes
    ----------
    t : [s]
    x, v, spin : (n, 3) positions [m], velocities [m/s], angular velocities [rad/s]
    radius : (n,) [m]; mass : (n,) [kg]
    kind : (n,) index of the particle's species
    row : (n,) the particle's id less 1
    """

    t: float
    x: Array
    v: Array
    spin: Array
    radius: Array
    mass: Array
    kind: NDArray[np.int64]
    row: NDArray[np.int64]

    @property
    def volume(self) -> Array:
        """(n,) volumes [m³]."""
        return 4.0 / 3.0 * np.pi * self.radius**3


@dataclass(frozen=True, kw_only=True)
class Space:
    """The box that is simulated.

    Attributes
    ----------
    low, high : corners [m]
    periodic : whether it is, per axis
    up : unit vector against gravity
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    periodic: tuple[bool, bool, bool]
    up: tuple[float, float, float]

    @property
    def size(self) -> Array:
        """(3,) [m]."""
        return np.subtract(self.high, self.low)

    def wrapped(self, x: Array) -> Array:
        """Return positions (n, 3) [m] with those beyond a periodic side put back."""
        low, size = np.asarray(self.low), self.size
        return np.where(self.periodic, low + np.mod(x - low, size), x)

    def nearest(self, delta: Array) -> Array:
        """Return differences of positions (n, 3) [m] by the shortest way through periodic sides."""
        size = self.size
        return np.where(self.periodic, delta - size * np.round(delta / size), delta)

    def axis_of(self, vector: tuple[float, float, float] | None = None) -> int:
        """Return which axis ``vector`` (``up`` if none) points along.

        Raises
        ------
        InputError
            If it is along none.
        """
        direction = np.abs(self.up if vector is None else vector)
        axis = int(direction.argmax())
        if direction[axis] < (1.0 - 1e-9) * np.linalg.norm(direction):
            raise InputError(f"direction {direction.tolist()}: expected one along x, y or z")
        return axis
