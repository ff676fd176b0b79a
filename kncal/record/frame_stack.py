"""Frames of a long run, of which only those are in memory that somebody asks for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]


class Pieces:
    """Files of arrays, of which the last ones that were read are kept."""

    def __init__(self, read: Callable[[Path], Arrays]) -> None:
        self.read = lru_cache(maxsize=2)(read)


class FrameStack(NDArrayOperatorsMixin):
    """One array of all frames, (frames, ...), read piece by piece: indexed as a numpy array, which it gives.

    What is computed with all of it reads all of it.

    Parameters
    ----------
    pieces : reads a file
    name : of the array in each file
    places : (frames,) file of each frame, and its row there
    kind, shape : of one frame
    """

    def __init__(
        self,
        pieces: Pieces,
        name: str,
        places: Sequence[tuple[Path, int]],
        kind: type[np.generic],
        shape: tuple[int, ...],
    ) -> None:
        self._pieces, self._name, self._places = pieces, name, places
        self.dtype, self.shape = np.dtype(kind), (len(places), *shape)

    def __len__(self) -> int:
        return len(self._places)

    def __iter__(self) -> Iterator[NDArray[Any]]:
        return map(self._frame, range(len(self)))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return self[:] if dtype is None else self[:].astype(dtype)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **given: Any) -> Any:
        return getattr(ufunc, method)(*(i[:] if isinstance(i, FrameStack) else i for i in inputs), **given)

    def __getitem__(self, index: Any) -> NDArray[Any]:
        which, rest = (index[0], index[1:]) if isinstance(index, tuple) else (index, ())
        if which is Ellipsis:
            whole: NDArray[Any] = self[:][index]
            return whole
        numbers = np.arange(len(self))[which]
        if numbers.ndim == 0:
            one: NDArray[Any] = self._frame(int(numbers))[rest]
            return one
        found = [self._frame(number)[rest] for number in numbers.ravel().tolist()]
        shape = found[0].shape if found else np.empty(self.shape[1:])[rest].shape
        return np.array(found, dtype=self.dtype).reshape(*numbers.shape, *shape)

    def _frame(self, number: int) -> NDArray[Any]:
        path, row = self._places[number]
        frame: NDArray[Any] = self._pieces.read(path)[self._name][row]
        return frame
