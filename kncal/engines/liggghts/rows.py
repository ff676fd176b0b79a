"""Which row of the callers' arrays a particle has: always the same one, whatever id LIGGGHTS gives it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Rows:
    """Rows of the callers' arrays by id: a new id gets the next row, one that was gone before is another particle's."""

    def __init__(self, most: int) -> None:
        self._most, self._next = most, 0
        self._row_of_id = np.full(most, -1)

    @property
    def come(self) -> int:
        """Number of particles that were ever there."""
        return self._next

    @property
    def full(self) -> bool:
        """Whether more particles came than there are rows."""
        return self._next > self._most

    @property
    def state(self) -> tuple[NDArray[np.int64], int]:
        """What `load` takes."""
        return self._row_of_id, self._next

    def load(self, row_of_id: NDArray[np.int64], following: int) -> None:
        """Go on as another one would."""
        self._row_of_id[:], self._next = row_of_id, following

    def __call__(self, ids: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the rows of the particles that are there now, by their ids less 1."""
        if len(ids) == self._most == self._next:
            return self._row_of_id[ids]
        there = np.zeros(max(self._most, int(ids.max(initial=-1)) + 1), dtype=bool)
        there[ids] = True
        if len(there) > self._most:
            self._next = self._most + 1
            return ids
        self._row_of_id[~there] = -1
        new = np.flatnonzero(there & (self._row_of_id < 0))
        self._row_of_id[new] = self._next + np.arange(len(new))
        self._next += len(new)
        return self._row_of_id[ids]


def inverse(rows: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Return the row of LIGGGHTS for each of ``most`` rows of the callers' arrays, -1 where there is none."""
    places = np.full(most, -1)
    places[rows] = np.arange(len(rows))
    return places
