"""The box that is simulated: as the case says, or as large as walls and starting particles need it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from kncal.core.checks import Array

#: Lower and upper corner, each (3,) [m]; infinite where something has no end.
Bounds = tuple[Array, Array]


def extent_of(domain: Bounds | None, things: Iterable[Bounds], periodic: Iterable[int], margin: float) -> Bounds:
    """Return the lower and the upper corner [m] of a box that holds every one of ``things``.

    Parameters
    ----------
    domain : the box that the case gives; None: as small as possible
    things : bounds of walls, regions, planes
    periodic : indices of the axes in which the box is periodic: no margin is added there
    margin : added on every other side where the case gives no domain [m]
    """
    if domain is not None:
        return domain
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for lower, upper in things:
        low = np.where(np.isfinite(lower), np.minimum(low, lower), low)
        high = np.where(np.isfinite(upper), np.maximum(high, upper), high)
    nothing = low > high
    low, high = np.where(nothing, 0.0, low), np.where(nothing, 0.0, high)
    added = np.full(3, margin)
    added[list(periodic)] = 0.0
    return low - added, high + added
