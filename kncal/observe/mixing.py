"""How well groups of particles are mixed: Lacey's index and the intensity of segregation, in cells of equal number.

Cells are made by halving: all particles are split at the median along their longest extent, again and again, until a
cell holds the number that is asked for. So no cell is empty or partly outside, whatever the walls, and the limits of
the variance are exact: S_0² = sum p(1 - p) of separate groups, S_R² = S_0²/n (N - n)/(N - 1) of N particles drawn into
cells of n without putting back.

Sources: Lacey, J. Appl. Chem. 4 (1954) 257; Danckwerts, Appl. Sci. Res. A 3 (1952) 279; several groups: the variances
are added.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError

#: Particles per cell of the mixing index.
CELL = 25
#: Mixing time: when the index has come this near to its final value, of the way from its first.
MIXED = 0.9


@dataclass(frozen=True, kw_only=True)
class Mixture:
    """How well particles are mixed at one time.

    Attributes
    ----------
    lacey : (S_0² - S²)/(S_0² - S_R²): 0 separate, 1 as by chance
    chance : S_R²/S_0², what cells of so few particles have by chance
    error : standard deviation of ``lacey`` of a mixture whose cells are drawn independently: by the spread of the
        cells, and at least what a random mixture has
    cells : their number; number : particles per cell
    """

    lacey: float
    chance: float
    error: float
    cells: int
    number: float


@dataclass(frozen=True, kw_only=True)
class MixingCurve:
    """How well particles were mixed over time.

    Attributes
    ----------
    t, lacey, error : (frames,) times [s], and see `Mixture`; chance : of the last frame
    """

    t: Array
    lacey: Array
    error: Array
    chance: float

    @property
    def intensity(self) -> Array:
        """(frames,) intensity of segregation S²/S_0²."""
        return 1.0 - self.lacey * (1.0 - self.chance)


def cells_of(x: Array, number: int) -> NDArray[np.int64]:
    """Return the cell (n,) of every particle at ``x`` (n, 3) [m]: cells of about ``number`` particles, all within one.

    Raises
    ------
    InputError
        If there are fewer than two cells' worth.
    """
    most = max(len(x), 1)
    depth = int(min(np.floor(np.log2(most / number) + 0.5), np.floor(np.log2(most))))  # none of them empty
    if depth < 1:
        raise InputError(f"{len(x)} particles: expected at least {int(1.5 * number)} for cells of {number}")
    parts = [np.arange(len(x))]
    for _ in range(depth):
        parts = [half for part in parts for half in _halved(x, part)]
    cell = np.empty(len(x), dtype=np.int64)
    for k, part in enumerate(parts):
        cell[part] = k
    return cell


def _halved(x: Array, part: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    axis = int(np.ptp(x[part], axis=0).argmax())
    order = part[np.argpartition(x[part, axis], len(part) // 2)]
    return order[: len(part) // 2], order[len(part) // 2 :]


def mixture(group: NDArray[np.int64], cell: NDArray[np.int64]) -> Mixture:
    """Return how well particles of ``group`` (n,) are mixed among cells (n,), both counted from 0.

    Raises
    ------
    InputError
        If there is only one group.
    """
    groups, cells, total = int(group.max()) + 1, int(cell.max()) + 1, len(group)
    counts = np.bincount(cell * groups + group, minlength=cells * groups).reshape(cells, groups).astype(np.float64)
    number = counts.sum(axis=1)
    p = counts.sum(axis=0) / total
    separate = float((p * (1.0 - p)).sum())
    if not separate > 0.0:
        raise InputError("all particles are of one group: expected two for a mixing index")
    each = ((counts / number[:, None] - p) ** 2).sum(axis=1)
    variance = float((each * number).sum() / total)  # as if every cell had its share of all particles
    chance = separate * (cells / total) * (total - total / cells) / (total - 1.0)
    # the spread of few cells is often too small by chance: at least that of S² of a random mixture, chi squared
    spread = max(float(each.std(ddof=1)) / np.sqrt(cells), chance * np.sqrt(2.0 / ((cells - 1) * (groups - 1))))
    error = spread / (separate - chance)
    return Mixture(
        lacey=(separate - variance) / (separate - chance),
        chance=chance / separate,
        error=error,
        cells=cells,
        number=total / cells,
    )


def mixing_time(t: Array, lacey: Array, last: float) -> float:
    """Return when an index (n,) at times t (n,) [s] has gone `MIXED` of the way to its final value ``last`` [s].

    Of the curve that only rises and fits the index best in the mean square, linear between frames: the noise of single
    frames does not end it early.

    Raises
    ------
    InputError
        If it does not change by more than chance, or is not there before the last frame.
    """
    from scipy.optimize import isotonic_regression

    way = (lacey - lacey[0]) / (last - lacey[0]) if last != lacey[0] else np.zeros(len(lacey))
    smooth = isotonic_regression(way).x
    there = np.flatnonzero(smooth >= MIXED)
    if not len(there) or there[0] == 0:
        raise InputError(f"the mixing index does not go {MIXED:.0%} of the way to its final value")
    k = int(there[0])
    return float(np.interp(MIXED, smooth[k - 1 : k + 1], t[k - 1 : k + 1]))
