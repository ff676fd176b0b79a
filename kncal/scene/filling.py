"""Start positions of spheres of several sizes in a region: at random, none touching another or a wall.

Random sequential addition, large spheres first: each place is tried at random and kept if nothing is there, up to about
0.3 of the volume. Where more are asked for, the rest is put at random anyway, and all that overlap are pushed apart
along their centre lines, again and again, until none do (about 0.5 between walls, 0.6 in a periodic box). What is to be
denser than that is ``pressed``: the same, until the overlaps that remain are spread evenly. All take their numbers from
the seed alone. LIGGGHTS' own insertion is not used: it inserts fewer than asked with a warning only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

#: Share of the volume beyond which nothing is tried (randomly packed spheres jam at 0.64), and that usually works.
DENSEST, USUAL = 0.62, 0.5
#: Spheres that are pressed into one another fill no more than this.
PRESSED = 0.85
#: Places tried at once, and the share of them that must be free for random addition to go on.
_BATCH, _LEAST_FREE = 100_000, 2e-2
#: Rounds of pushing apart; the gap that is aimed at, over the radius; how far a push goes.
_ROUNDS, _GAP, _PUSH = 600, 0.004, 1.2
_SAMPLES = 20_000
#: Sizes that are looked at together differ by this factor at most.
_SIMILAR = 1.5

Free = Callable[[Array, Array], NDArray[np.bool_]]


class Space(Protocol):
    """Where spheres are put: a region of a scene."""

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner of a box around it, each (3,) [m]."""
        ...

    def inside(self, points: Array, margin: Array | float = 0.0) -> Array:
        """Whether each of the ``points`` (n, 3) is inside, at least ``margin`` from every side."""
        ...


def fill(
    space: Space,
    radii: Array,
    seed: int,
    *,
    free: Free | None = None,
    periods: Mapping[int, tuple[float, float]] | None = None,
    taken: tuple[Array, Array] | None = None,
    pressed: bool = False,
) -> Array:
    """Return centres (n, 3) [m] of spheres inside a region, none of which overlap (but see ``pressed``).

    Parameters
    ----------
    space : the region; spheres lie inside it as a whole, but for axes in which it fills a period
    radii : (n,) [m], in any order, of few different values
    seed : what is random follows from it alone
    free : whether spheres at points (m, 3) with radii (m,) touch no wall
    periods : axis -> lower and upper end of the domain where it is periodic [m]
    taken : centres (k, 3) and radii (k,) of spheres that are there already [m]
    pressed : whether spheres that do not fit may overlap: as little, and as evenly, as pushing them apart reaches

    Raises
    ------
    InputError
        If they do not fit; the text says how many about do.
    """
    room = _Room(space, free, periods or {})
    rng = np.random.default_rng(seed)
    radii = np.asarray(radii, dtype=np.float64)
    held_x, held_r = taken if taken is not None else (np.empty((0, 3)), np.empty(0))
    available = room.volume(rng)
    if (share := 4.0 / 3.0 * np.pi * float(np.sum(radii**3)) / max(available, 1e-300)) > (
        most := PRESSED if pressed else DENSEST
    ):
        raise _do_not_fit(radii, int(most / share * radii.size), available)
    x = np.full((radii.size, 3), np.nan)
    there = [(held_x[held_r == r], r) for r in np.unique(held_r)]
    for r in np.unique(radii)[::-1]:
        rows = np.flatnonzero(radii == r)
        found = room.add(rng, rows.size, float(r), there)
        x[rows[: len(found)]] = found
        there.append((found, float(r)))
    missing = np.flatnonzero(np.isnan(x[:, 0]))
    if missing.size:
        x = _anywhere(room, rng, x, radii, missing)
        if (bad := room.push_apart(rng, x, radii, held_x, held_r)) and not pressed:
            raise _do_not_fit(
                radii, max(radii.size - bad, min(radii.size - 1, int(USUAL / share * radii.size))), available
            )
    return x


def _do_not_fit(radii: Array, about: int, volume: float) -> InputError:
    return InputError(
        f"{radii.size} particles with radii from {radii.min():g} to {radii.max():g} m in a region with {volume:.4g} m³ "
        f"of free volume: about {about} of them fit: expected fewer, or a larger region (about 0.3 filled is quick)"
    )


def _anywhere(room: _Room, rng: np.random.Generator, x: Array, radii: Array, missing: NDArray[np.intp]) -> Array:
    """Put the ``missing`` rows at random where walls allow, whatever else is there."""
    x = x.copy()
    for _ in range(200):
        tried = room.points(rng, missing.size)
        good = room.allows(tried, radii[missing])
        x[missing[good]] = tried[good]
        missing = missing[~good]
        if not missing.size:
            return x
    raise _do_not_fit(radii, radii.size - missing.size, room.volume(rng))


class _Room:
    """A region with its walls and periods, in coordinates from the lower end of each period."""

    def __init__(self, space: Space, free: Free | None, periods: Mapping[int, tuple[float, float]]) -> None:
        self._space, self._free = space, free
        self._low, self._high = (np.array(end, dtype=np.float64) for end in space.bounds)
        self._begin, self._length = np.zeros(3), np.zeros(3)
        self._whole: list[int] = []
        for axis, (low, high) in periods.items():
            self._begin[axis], self._length[axis] = low, high - low
            if self._high[axis] - self._low[axis] >= (high - low) * (1.0 - 1e-9):
                self._whole.append(axis)
                self._low[axis], self._high[axis] = low, high

    def points(self, rng: np.random.Generator, number: int) -> Array:
        return rng.uniform(self._low, self._high, (number, 3))

    def allows(self, x: Array, radii: Array | float) -> NDArray[np.bool_]:
        """Whether spheres lie inside the region and touch no wall (n,)."""
        inner = x.copy()
        middle = 0.5 * (self._low + self._high)
        inner[:, self._whole] = middle[self._whole]
        radii = np.broadcast_to(radii, len(x))
        good = np.asarray(self._space.inside(inner, radii), dtype=bool)
        if self._free is not None and good.any():
            good[good] = self._free(x[good], radii[good])
        return good

    def volume(self, rng: np.random.Generator) -> float:
        """Estimate the volume that the walls leave of the region [m³]."""
        share = np.mean(self.allows(self.points(rng, _SAMPLES), 0.0))
        return float(np.prod(self._high - self._low) * share)

    def wrapped(self, x: Array) -> Array:
        """Return points with what `cKDTree` needs: from 0 to below the period on each periodic axis."""
        along = self._length > 0.0
        if not along.any():
            return x
        y = x - self._begin
        y[:, along] %= self._length[along]
        y[:, along] = np.where(y[:, along] >= self._length[along], 0.0, y[:, along])
        return np.where(along, y, x)

    def _tree(self, x: Array) -> cKDTree:
        from scipy.spatial import cKDTree

        return cKDTree(self.wrapped(x), boxsize=self._length)

    def add(self, rng: np.random.Generator, number: int, r: float, there: list[tuple[Array, float]]) -> Array:
        """Return up to ``number`` centres (m, 3) of spheres of one radius beside those that are ``there``."""
        found: list[Array] = []
        left = number
        others = [(self._tree(x), r + other) for x, other in there if len(x)]
        while left:
            tried = self.points(rng, min(_BATCH, max(4 * left, 1000)))
            number_tried = len(tried)
            tried = tried[self.allows(tried, r)]
            own = [(self._tree(np.vstack(found)), 2.0 * r)] if found else []
            for tree, distance in (*others, *own):
                nearest, _ = tree.query(self.wrapped(tried), distance_upper_bound=distance)
                tried = tried[nearest > distance]  # infinite: none so near
            tried = tried[self._one_by_one(tried, 2.0 * r)][:left]
            found.append(tried)
            left -= len(tried)
            if left and number_tried >= 1000 and len(tried) < _LEAST_FREE * number_tried:
                break
        return np.vstack(found) if found else np.empty((0, 3))

    def _one_by_one(self, x: Array, distance: float) -> NDArray[np.bool_]:
        """Which points stay if each in turn is refused that is too near to one that stayed (n,)."""
        stays = np.ones(len(x), dtype=bool)
        for i, j in self._pairs(x, distance).tolist():
            if stays[i]:
                stays[j] = False
        return stays

    def _pairs(self, x: Array, distance: float) -> NDArray[np.intp]:
        """Pairs (i < j) of points nearer than ``distance``, sorted (m, 2)."""
        found = self._tree(x).query_pairs(distance, output_type="ndarray")
        return found[np.lexsort((found[:, 1], found[:, 0]))]

    def push_apart(self, rng: np.random.Generator, x: Array, radii: Array, held_x: Array, held_r: Array) -> int:
        """Move overlapping spheres of ``x`` apart along their centre lines; those of ``held_x`` stay.

        Returns how many would have to go for none to overlap: 0 if it was done.
        """
        n = len(x)
        all_x, all_r = np.vstack([x, held_x]), np.concatenate([radii, held_r])
        moving = np.arange(len(all_x)) < n
        for _ in range(_ROUNDS):
            i, j, along, gap = self._overlaps(all_x, all_r)
            if not np.any(gap < 0.0):
                break
            step = (_GAP * (all_r[i] + all_r[j]) - gap)[:, None] * along
            step *= np.where(moving[i] & moving[j], 0.5, 1.0)[:, None]
            push = np.stack([np.bincount(i, s, len(all_x)) - np.bincount(j, s, len(all_x)) for s in step.T], axis=1)
            touching = np.bincount(np.concatenate([i, j]), minlength=len(all_x))
            rows = np.flatnonzero((touching > 0) & moving)
            to = all_x[rows] + _PUSH * push[rows] / np.maximum(1.0, 0.4 * touching[rows, None])
            self._move(rng, all_x, rows, to, all_r)
        i, j, _, gap = self._overlaps(all_x, all_r)
        x[:] = np.where(self._length > 0.0, self._begin + self.wrapped(all_x[:n]), all_x[:n])
        return _in_the_way(i[gap < 0.0], j[gap < 0.0])

    def _move(self, rng: np.random.Generator, x: Array, rows: NDArray[np.intp], to: Array, radii: Array) -> None:
        """Move those that walls allow; the others as far, in a direction at random."""
        for attempt in range(3):
            good = self.allows(to, radii[rows])
            x[rows[good]] = to[good]
            rows, to = rows[~good], to[~good]
            if attempt == 2 or not rows.size:
                break
            size = np.linalg.norm(to - x[rows], axis=1, keepdims=True)
            aside = rng.normal(size=to.shape)
            to = x[rows] + size * aside / np.linalg.norm(aside, axis=1, keepdims=True)

    def _overlaps(self, x: Array, radii: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array, Array]:
        """Pairs nearer than the gap aimed at: i, j, direction from j to i (m, 3) and gap between surfaces (m,) [m]."""
        i, j = self._near(x, (1.0 + _GAP) * radii).T
        way = x[i] - x[j]
        for axis in np.flatnonzero(self._length):
            way[:, axis] -= self._length[axis] * np.round(way[:, axis] / self._length[axis])
        distance = np.linalg.norm(way, axis=1)
        near = distance < (1.0 + _GAP) * (radii[i] + radii[j])
        i, j, way, distance = i[near], j[near], way[near], distance[near]
        along = way / np.maximum(distance, 1e-300)[:, None]
        return i, j, along, distance - radii[i] - radii[j]

    def _near(self, x: Array, reach: Array) -> NDArray[np.intp]:
        """Pairs (m, 2) of points nearer than the sum of their reaches (n,), and some that are not.

        Looked for by groups of similar sizes: within the reach of the largest a small one has thousands.
        """
        groups = np.floor(np.log(reach / reach.min()) / np.log(_SIMILAR)).astype(int)
        members = [np.flatnonzero(groups == g) for g in np.unique(groups)]
        trees = [self._tree(x[rows]) for rows in members]
        most = [float(reach[rows].max()) for rows in members]
        found = []
        for a, rows in enumerate(members):
            found.append(rows[trees[a].query_pairs(2.0 * most[a], output_type="ndarray")])
            for b in range(a):
                near = trees[a].sparse_distance_matrix(trees[b], most[a] + most[b], output_type="ndarray")
                found.append(np.stack([rows[near["i"]], members[b][near["j"]]], axis=1))
        return np.vstack(found)


def _in_the_way(i: NDArray[np.intp], j: NDArray[np.intp]) -> int:
    """How many must go until no pair is left, one after the other."""
    gone: set[int] = set()
    for a, b in zip(i.tolist(), j.tolist(), strict=True):
        if a not in gone and b not in gone:
            gone.add(b)
    return len(gone)
