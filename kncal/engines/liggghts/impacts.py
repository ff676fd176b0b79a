"""Impact speeds of new contacts, seen between two looks one DEM step apart; in LIGGGHTS' process, so numpy alone.

A contact that is there now and was a gap one step ago began in that step. Its impact speed is taken from the moment
before: closing speed c, gap s, and second derivative p of the overlap by the forces then and the turning of the
normal, so v_0² = c² + 2 p s. That is exact in free flight and for any constant force, whatever the contact law, since
the new contact has not acted yet. What is left out is the change within the step of forces by other contacts of the two
particles: at most (pi/N)²/2 of the speed for N steps per contact, 0.8 % for N = 25, of either sign.

Every contact begins in one step, so watching evenly spaced steps sees each with the same probability.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array

#: Speed bins per decade, and the first and last decade [log10 of m/s]; slower and faster impacts are in the outer bins.
BINS_PER_DECADE, SLOWEST, FASTEST = 20, -5, 2
BINS = (FASTEST - SLOWEST) * BINS_PER_DECADE + 1
#: Sums kept of each kind: v, v², v³.
POWERS = 3

#: Two opposite walls: their axis (0 to 2), and the coordinate of the second [m]; that of the first is 0.
Side = tuple[int, float]


def speed_edges() -> Array:
    """Return the edges of the impact speed bins [m/s]: 0, then 20 a decade from 1e-5 to 100."""
    decades = SLOWEST + np.arange(BINS) / BINS_PER_DECADE
    return np.concatenate(([0.0], 10.0**decades))


def count_speeds(speeds: Array) -> Array:
    """Return (bins,) counts of speeds (n,) [m/s]."""
    with np.errstate(divide="ignore"):  # a speed of exactly 0 belongs to the first bin
        place = np.floor((np.log10(speeds) - SLOWEST) * BINS_PER_DECADE) + 1.0
    return np.bincount(np.clip(place, 0, BINS - 1).astype(np.intp), minlength=BINS).astype(np.float64)


@dataclass(frozen=True, kw_only=True)
class Before:
    """The particles one step before a look, in any order of rows.

    Attributes
    ----------
    x, v, force : (n, 3) [m], [m/s], [N]
    row : (n,) row of particle id - 1
    mass : of each particle, all are equal [kg]
    """

    x: Array
    v: Array
    force: Array
    row: NDArray[np.intp]
    mass: float


def pair_speeds(before: Before, first: NDArray[np.intp], second: NDArray[np.intp], d: float, period: float) -> Array:
    """Return the impact speeds of the new ones among the present contacts [m/s].

    ``first``, ``second``: (contacts,) id - 1 of the particles of each; ``d``: diameter [m]; ``period``: of y [m], 0
    if it has none.
    """
    i, j = before.row.take(first), before.row.take(second)
    r = before.x.take(i, axis=0)
    r -= before.x.take(j, axis=0)
    if period:
        r[:, 1] -= period * np.round(r[:, 1] / period)
    square = np.einsum("ck,ck->c", r, r)
    new = np.flatnonzero(square >= d * d)
    if not len(new):
        return np.empty(0)
    i, j, distance = i[new], j[new], np.sqrt(square[new])
    n = r[new] / distance[:, None]
    w = before.v[i] - before.v[j]
    push = (before.force[i] - before.force[j]) / before.mass
    closing = -np.einsum("ck,ck->c", w, n)
    along = np.einsum("ck,ck->c", w, w) - closing**2
    pull = -np.einsum("ck,ck->c", push, n) - along / distance
    return _at_touch(closing, pull, distance - d)


def wall_speeds(before: Before, x: Array, ids: NDArray[np.intp], sides: Sequence[Side], radius: float) -> Array:
    """Return the impact speeds of new contacts with walls [m/s].

    ``x``: (n, 3) now [m]; ``ids``: (n,) id - 1 of each row of it; ``sides``: the walls; ``radius``: of a particle [m].
    """
    found = []
    for axis, end in sides:
        there = x[:, axis]
        for side, position in ((1.0, 0.0), (-1.0, end)):
            touching = np.flatnonzero(there < radius if side > 0.0 else there > end - radius)
            if not len(touching):
                continue
            then = before.row[ids[touching]]
            gap = side * (before.x[then, axis] - position) - radius
            new = gap >= 0.0
            if new.any():
                then, gap = then[new], gap[new]
                pull = -side * before.force[then, axis] / before.mass
                found.append(_at_touch(-side * before.v[then, axis], pull, gap))
    return np.concatenate(found) if found else np.empty(0)


def _at_touch(closing: Array, pull: Array, gap: Array) -> Array:
    # below 0 only by what the step's change of other forces makes of a touch at almost no speed
    return np.sqrt(np.maximum(closing**2 + 2.0 * pull * gap, 0.0))
