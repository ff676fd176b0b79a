"""What every engine hands back: the recorded motion of a few bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array


@dataclass(frozen=True)
class Trajectory:
    """Recorded frames; the spacing is not uniform (dense in contact, coarse in flight).

    Attributes
    ----------
    names : particle names, in the order of the scene
    step : (frames,) integer step numbers, strictly increasing
    t : (frames,) time [s]
    x, v : (frames, particles, 3) positions [m], velocities [m/s]
    spin : (frames, particles, 3) angular velocities [rad/s]
    force : (frames, particles, 3) total force on each particle, gravity included [N]
    radius : (particles,) [m]
    """

    names: tuple[str, ...]
    step: NDArray[np.int64]
    t: Array
    x: Array
    v: Array
    spin: Array
    force: Array
    radius: Array
