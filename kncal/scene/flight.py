"""When two bodies in free flight touch next: roots of the polynomials of ballistics, without cancellation."""

from __future__ import annotations

import math
from math import sqrt

from kncal.scene.bodies import Vector


def wall_touch_time(gap: float, rate: float, acceleration: float) -> float:
    """Time until gap + rate t + acceleration t²/2 falls through zero [s]; inf if it never does.

    ``gap`` >= 0 [m], ``rate`` its change [m/s]. The form without cancellation of the root is taken.
    """
    square = rate * rate - 2.0 * acceleration * gap
    if square < 0.0 or (rate >= 0.0 and acceleration >= 0.0):
        return math.inf
    root = sqrt(square)
    return 2.0 * gap / (root - rate) if rate < 0.0 else (rate + root) / -acceleration


def pair_touch_time(d: Vector, w: Vector, r_sum: float) -> float:
    """Time until |d + w t| falls through ``r_sum`` [s]; inf if it never does.

    ``d`` is the distance vector of the centres [m], ``w`` its change [m/s]; gravity acts on both alike.
    """
    approach = -(d[0] * w[0] + d[1] * w[1] + d[2] * w[2])
    excess = d[0] * d[0] + d[1] * d[1] + d[2] * d[2] - r_sum * r_sum
    square = approach * approach - (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) * excess
    if approach <= 0.0 or square < 0.0:
        return math.inf
    return max(excess, 0.0) / (approach + sqrt(square))
