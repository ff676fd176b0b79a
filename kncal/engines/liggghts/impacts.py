"""Impact speeds of new contacts, seen between two looks one DEM step apart; in LIGGGHTS' process, so numpy alone.

A contact that is there now and was a gap one step ago began in that step. Its impact speed is taken from the moment
before: closing speed c, gap s, and second derivative p of the overlap by the forces then and the turning of the
normal, so v_0² = c² + 2 p s. That is exact in free flight and for any constant force, whatever the contact law, since
the new contact has not acted yet. What is left out is the change within the step of forces by other contacts of the two
particles: at most (pi/N)²/2 of the speed for N steps per contact, 0.8 % for N = 25, of either sign.

At a mesh, which may move, c is what the gap lost within the step, less the half of p that the step adds.

Every contact begins in one step, so watching evenly spaced steps sees each with the same probability.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array

#: Speed bins per decade, and the first and last decade [log10 of m/s]; slower and faster impacts are in the outer bins.
BINS_PER_DECADE, SLOWEST, FASTEST = 20, -5, 2
BINS = (FASTEST - SLOWEST) * BINS_PER_DECADE + 1
#: Sums kept of each pair: v, v², v³.
POWERS = 3
#: Columns of a row of contacts with meshes: contact point, centre, number of the mesh, id, overlap.
_POINT, _CENTRE, _MESH, _ID, _OVERLAP = slice(0, 3), slice(3, 6), 6, 8, 12


class Surface(NamedTuple):
    """A wall without triangles: ``kind`` is the number of its species.

    ``axis``: a plane's normal, or a cylinder's axis; ``position``: of the plane on it [m]; ``radius`` [m] and
    ``centre``, the two other coordinates [m], of a cylinder; radius 0: a plane.
    """

    kind: int
    axis: int
    position: float = 0.0
    centre: Sequence[float] = (0.0, 0.0)
    radius: float = 0.0

    def distances(self, x: Array) -> Array:
        """Return the distances of points (n, 3) [m]."""
        if not self.radius:
            return np.asarray(np.abs(x[:, self.axis] - self.position))
        return np.asarray(np.abs(self.radius - np.hypot(*(x[:, self._across] - self.centre).T)))

    def approach(self, x: Array, v: Array, push: Array) -> tuple[Array, Array]:
        """Return minus the first and second derivative of the distances by time; ``push``: acceleration (n, 3)."""
        if not self.radius:
            side = np.copysign(1.0, x[:, self.axis] - self.position)
            return -side * v[:, self.axis], -side * push[:, self.axis]
        out = x[:, self._across] - self.centre
        rho = np.hypot(*out.T)
        side, out = np.where(rho < self.radius, 1.0, -1.0), out / rho[:, None]
        speed = v[:, self._across]
        outwards = np.einsum("ij,ij->i", speed, out)
        around = np.einsum("ij,ij->i", speed, speed) - outwards**2
        return side * outwards, side * (np.einsum("ij,ij->i", push[:, self._across], out) + around / rho)

    @property
    def _across(self) -> list[int]:
        return [axis for axis in range(3) if axis != self.axis]


class Speeds(NamedTuple):
    """Impact speeds (n,) [m/s], and the species (n,) of both sides."""

    v: Array
    one: NDArray[np.int64]
    other: NDArray[np.int64]


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
    x, v, push : (n, 3) [m], [m/s], acceleration by all forces [m/s²]
    radius : (n,) [m]; kind : (n,) species
    row : (most,) row of particle id - 1, -1 if it was not there
    """

    x: Array
    v: Array
    push: Array
    radius: Array
    kind: NDArray[np.int64]
    row: NDArray[np.intp]


def pair_speeds(before: Before, first: NDArray[np.intp], second: NDArray[np.intp], periods: Sequence[float]) -> Speeds:
    """Return the impact speeds of the new ones among the present contacts.

    ``first``, ``second``: (contacts,) id - 1 of the particles of each; ``periods``: of each axis [m], 0: it has none.
    """
    i, j = before.row.take(first), before.row.take(second)
    if (unknown := (i < 0) | (j < 0)).any():
        i, j = i[~unknown], j[~unknown]
    r = before.x.take(i, axis=0)
    r -= before.x.take(j, axis=0)
    for axis, period in enumerate(periods):
        if period:
            r[:, axis] -= period * np.round(r[:, axis] / period)
    square, touch = np.einsum("ck,ck->c", r, r), before.radius.take(i) + before.radius.take(j)
    new = np.flatnonzero(square >= touch * touch)
    i, j, distance = i[new], j[new], np.sqrt(square[new])
    n = r[new] / distance[:, None]
    w = before.v[i] - before.v[j]
    closing = -np.einsum("ck,ck->c", w, n)
    along = np.einsum("ck,ck->c", w, w) - closing**2
    pull = -np.einsum("ck,ck->c", before.push[i] - before.push[j], n) - along / distance
    return Speeds(_at_touch(closing, pull, distance - touch[new]), before.kind[i], before.kind[j])


def wall_speeds(before: Before, x: Array, ids: NDArray[np.intp], wall: Surface) -> Speeds:
    """Return the impact speeds of new contacts with a wall; ``x``: (n, 3) now [m]; ``ids``: (n,) id - 1 of its rows."""
    then = before.row.take(ids)
    if (unknown := then < 0).any():
        x, then = x[~unknown], then[~unknown]
    touching = then[wall.distances(x) < before.radius.take(then)]
    gap = wall.distances(before.x[touching]) - before.radius[touching]
    new, gap = touching[gap >= 0.0], gap[gap >= 0.0]
    closing, pull = wall.approach(before.x[new], before.v[new], before.push[new])
    return Speeds(_at_touch(closing, pull, gap), before.kind[new], np.full(len(new), wall.kind))


def mesh_speeds(before: Before, earlier: Array, now: Array, kinds: Sequence[int], dt: float) -> Speeds:
    """Return the impact speeds of new contacts with meshes, which may move.

    ``earlier``, ``now``: rows of contacts and gaps (see `kncal.engines.liggghts.c_library`) one step of ``dt`` [s]
    before, and now; ``kinds``: species of each mesh.
    """
    keys, then = _nearest(earlier)
    touching, there = _nearest(now[now[:, _OVERLAP] > 0.0])
    at = np.minimum(np.searchsorted(keys, touching), max(len(keys) - 1, 0))
    known = np.flatnonzero(keys[at] == touching) if len(keys) else np.empty(0, dtype=np.intp)
    row = before.row[then[at[known], _ID].astype(np.intp) - 1]
    new = (then[at[known], _OVERLAP] <= 0.0) & (row >= 0)
    then, there, row = then[at[known[new]]], there[known[new]], row[new]
    n = then[:, _CENTRE] - then[:, _POINT]
    n /= np.linalg.norm(n, axis=1)[:, None]
    pull = -np.einsum("ck,ck->c", before.push[row], n)
    gap = -then[:, _OVERLAP]
    closing = (gap + there[:, _OVERLAP]) / dt - 0.5 * pull * dt
    meshes = np.array(kinds, dtype=np.int64)[then[:, _MESH].astype(np.intp)]
    return Speeds(_at_touch(closing, pull, gap), before.kind[row], meshes)


def _nearest(rows: Array) -> tuple[NDArray[np.int64], Array]:
    """Return for each particle at each mesh the row of the nearest triangle, in the order of a key of both."""
    keys = rows[:, _MESH].astype(np.int64) << 32 | rows[:, _ID].astype(np.int64)
    order = np.lexsort((rows[:, _OVERLAP], keys))
    keys = keys[order]
    last = np.append(keys[1:] != keys[:-1], True)[: len(keys)]
    return keys[last], rows[order[last]]


def _at_touch(closing: Array, pull: Array, gap: Array) -> Array:
    # below 0 only by what the step's change of other forces makes of a touch at almost no speed
    return np.sqrt(np.maximum(closing**2 + 2.0 * pull * gap, 0.0))
