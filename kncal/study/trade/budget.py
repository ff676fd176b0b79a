"""A given time, and what to spend it on: how long each run is worth running, and which softness is tried next."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from kncal.core.awake import awake
from kncal.core.checks import positive


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

    def allows(self, predicted_seconds: float) -> bool:
        """Return whether something that takes this long would end in time."""
        return predicted_seconds <= self.left()


@dataclass(frozen=True, kw_only=True)
class Work:
    """One run among others that share the time.

    Attributes
    ----------
    name : unique
    rate : seconds of a core per simulated second [-]
    done : simulated so far [s]
    weight : how many comparisons rest on it [-]
    """

    name: str
    rate: float
    done: float = 0.0
    weight: float = 1.0


def allocate(works: Iterable[Work], capacity: float, longest: float) -> dict[str, float]:
    """Return the simulated time [s] that each run should come to, by name.

    The variance of an average falls with the simulated time T, so the summed variance of all differences from one
    reference is ``sum w/T``, with w = 1 for a candidate and the number of candidates for the reference. Under
    ``sum rate (T - done) <= capacity`` it is smallest for T proportional to ``sqrt(w/rate)``: of equal cost, the
    reference runs sqrt(candidates) times as long (Dunnett, J. Am. Stat. Assoc. 50 (1955) 1096, section 5). No run is
    shortened below what it has done, none is longer than ``longest``.

    Parameters
    ----------
    capacity : seconds of a core that are left, of all cores together
    longest : [s]
    """
    works = list(works)
    if not works:
        return {}

    def times(scale: float) -> list[float]:
        return [min(max(scale * math.sqrt(w.weight / w.rate), w.done), max(longest, w.done)) for w in works]

    def cost(scale: float) -> float:
        return sum(w.rate * (t - w.done) for w, t in zip(works, times(scale), strict=True))

    high = max(max(longest, w.done) / math.sqrt(w.weight / w.rate) for w in works)
    low = 0.0
    if cost(high) <= capacity:
        low = high
    else:
        for _ in range(100):  # to rounding
            middle = 0.5 * (low + high)
            low, high = (middle, high) if cost(middle) <= capacity else (low, middle)
    return {w.name: t for w, t in zip(works, times(low), strict=True)}


def affordable(works: Sequence[Work], capacity: float, longest: float, least: float) -> int:
    """Return how many of ``works``, from the first on, can each come to ``least`` [s] of simulated time.

    The first is the reference; its weight is that of the others together, whatever it says.
    """
    number = 0
    for count in range(1, len(works) + 1):
        given = allocate(weighted(works[:count]), capacity, longest)
        if min(given.values()) < least * (1.0 - 1e-9):
            break
        number = count
    return number


def weighted(works: Sequence[Work]) -> list[Work]:
    """Return the same with the weight of the first, the reference, set to the number of the others."""
    weight = float(max(len(works) - 1, 1))
    return [Work(name=w.name, rate=w.rate, done=w.done, weight=1.0 if k else weight) for k, w in enumerate(works)]


def bisection_order(factors: Iterable[float], inside: Mapping[float, bool]) -> tuple[float, ...]:
    """Return those ``factors`` that are not known yet, in an order that finds the edge soonest.

    Parameters
    ----------
    factors : shares of a stiffness; 1 is the stiffest
    inside : factor -> whether it was found to do. The edge is taken to lie between the softest that does, above the
        stiffest that does not, and that one. Of what may hold the edge the middle comes first, then the middles of
        its halves, and so on; then the rest, the nearest first.
    """
    ordered = sorted(set(factors), reverse=True)
    bad = min((k for k, f in enumerate(ordered) if inside.get(f) is False), default=len(ordered))
    good = max((k for k, f in enumerate(ordered[:bad]) if inside.get(f)), default=-1)
    order: list[int] = []
    parts = [(good, bad)]
    while parts:
        low, high = parts.pop(0)
        if high - low > 1:
            middle = (low + high) // 2
            order.append(middle)
            parts += [(low, middle), (middle, high)]
    rest = [k for k in range(len(ordered)) if k not in order]
    order += sorted(rest, key=lambda k: min(abs(k - good), abs(k - bad)))
    return tuple(ordered[k] for k in order if ordered[k] not in inside)
