"""A given time, and how runs share it: all in rounds of growing length, from each of which the better half goes on."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from kncal.core.awake import awake
from kncal.core.checks import positive

#: So many candidates, beside the reference, go through to the last round.
FEWEST = 2


class Budget:
    """Wall-clock time from now on, but for pauses (see `kncal.core.awake`); without an end for ``seconds`` None.

    Raises
    ------
    InputError
        If ``seconds`` is not a positive number.
    """

    def __init__(self, seconds: float | None, clock: Callable[[], float] = awake) -> None:
        if seconds is not None:
            positive("budget", seconds, unit="s")
        self.seconds = seconds
        self._clock = clock
        self._started = clock()

    def spent(self) -> float:
        """Return the time since the start [s]."""
        return self._clock() - self._started

    def left(self) -> float:
        """Return what is left [s], never below 0; infinite without an end."""
        return math.inf if self.seconds is None else max(self.seconds - self.spent(), 0.0)


def rounds_of(number: int) -> int:
    """Return after how many rounds, each with half as many, `FEWEST` of ``number`` candidates have run."""
    return 1 + max(math.ceil(math.log2(max(number, 1) / FEWEST)), 0)


def limit_of(models: Sequence[str], seconds: float, lanes: int, overhead: float = 0.0) -> float:
    """Return the time that each run may take [s], at most, so that all of them end within ``seconds``.

    Parameters
    ----------
    models : contact model of each run; those of one model run side by side, model after model
    lanes : runs at a time
    overhead : what starting and stopping a run takes beside [s]
    """
    turns = sum(math.ceil(models.count(model) / lanes) for model in set(models))
    return seconds / max(turns, 1) - overhead


def affordable(models: Sequence[str], seconds: float, lanes: int, overhead: float, shortest: float) -> int:
    """Return how many runs, from the first on, can each have ``shortest`` [s] in the first of their rounds."""
    return max(
        (
            number
            for number in range(1, len(models) + 1)
            if limit_of(models[:number], seconds / rounds_of(number), lanes, overhead) >= shortest
        ),
        default=0,
    )


def spread(number: int) -> list[int]:
    """Return 0 ... number - 1 in an order whose beginnings lie far apart: the ends' middle, the halves' middles ..."""
    order, parts = list[int](), [(0, number)]
    while parts:
        low, high = parts.pop(0)
        if low < high:
            middle = (low + high) // 2
            order.append(middle)
            parts += [(low, middle), (middle + 1, high)]
    return order
