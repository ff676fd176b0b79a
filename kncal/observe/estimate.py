"""A number and how well it is known: one class for every "value ± width"."""

from __future__ import annotations

import math
from dataclasses import dataclass

from kncal.physics.statistics import Average, needed_length

#: Widths that are not reliable are taken this many times as wide before they decide anything.
DOUBT = 3.0


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A value and the half-width of what it is known to.

    Attributes
    ----------
    value : or None if there is none
    width : half-width: of the 95 % confidence interval of an average, or the predicted discretisation error of a single
        contact; 0 of an exact value; None if it is not known
    reliable : whether the width may be believed
    why : why there is no value, or why its width is not reliable; may be empty
    needed_end : end time of the run at which a difference would be decided [s]; None: it is, or no such time is known
    started : whether the start-up was over when the average began; if not, it is of something else, however narrow
    chance : whether the width is that of chance, so that those of two runs add in squares
    average : the statistics that the value comes from; None of what no longer run would make more certain
    begin, end : the window of the average [s]
    """

    value: float | None
    width: float | None = None
    reliable: bool = True
    why: str = ""
    needed_end: float | None = None
    started: bool = True
    chance: bool = False
    average: Average | None = None
    begin: float = 0.0
    end: float = 0.0

    @property
    def deciding(self) -> float:
        """The width that decides: `DOUBT` times as wide if it is not reliable, 0 if it is not known."""
        return (self.width or 0.0) * (1.0 if self.reliable else DOUBT)

    @property
    def significant(self) -> bool | None:
        """Whether the value differs from zero by more than its width; None if that cannot be told."""
        if self.value is None or self.width is None:
            return None
        return True if abs(self.value) > self.deciding else (False if self.reliable else None)

    def end_for(self, width: float) -> float:
        """Predict the end time [s] at which an average would have this ``width``, beyond the run's end.

        Raises
        ------
        ValueError
            If it is no average.
        """
        found, length = self.average, self.end - self.begin
        if found is None:
            raise ValueError("no average: expected one")
        # of a mean over events, such as bubbles, there are as many more as the run is longer
        by_events = length * (found.uncertainty / width) ** 2
        needed = needed_length(found, width) if found.length > 0.0 else by_events
        if not found.reliable and needed <= length:  # a drift or a long start-up is not cured by statistics
            needed = 2.0 * length
        return self.begin + needed


def averaged(found: Average, begin: float, end: float) -> Estimate:
    """Return an average over the window from ``begin`` to ``end`` [s]."""
    return Estimate(
        value=found.mean,
        width=found.uncertainty,
        reliable=found.reliable,
        why=found.why,
        chance=True,
        average=found,
        begin=begin,
        end=end,
    )


def decide(difference: float, width: float, limit: float) -> str:
    """Return the verdict on a difference of size ``difference`` ± ``width`` where ``limit`` is allowed.

    Two one-sided tests (Schuirmann, J. Pharmacokinet. Biopharm. 15 (1987) 657): "ok" if the whole interval is within
    the limit, "outside" if all of it is outside, else "undecided". That no difference is seen is no proof of agreement.
    """
    if difference + width <= limit:
        return "ok"
    return "outside" if difference - width > limit else "undecided"


def missing(why: str) -> Estimate:
    """Return an estimate that there is none of, and ``why``."""
    return Estimate(value=None, why=why)


def apart(a: Estimate, b: Estimate, scale: float, names: tuple[str, str]) -> Estimate:
    """Return (a - b)/scale of two values that are there; ``names`` are theirs in the reason for a doubt.

    Widths of chance add in squares, since the two are independent; others add up, since the same step errs alike. Of
    two values that are equal to the last bit, but for chance, the difference is exactly zero.
    """
    if a.value is None or b.value is None:
        raise ValueError("no value: expected two")
    value, width = a.value - b.value, None
    if a.width is not None and b.width is not None:
        width = math.hypot(a.width, b.width) if a.chance or b.chance else a.width + b.width
        width = 0.0 if value == 0.0 and not (a.chance or b.chance) else width
    return Estimate(
        value=value / scale,
        width=None if width is None else width / scale,
        reliable=a.reliable and b.reliable,
        started=a.started and b.started,
        why="; ".join(f"{name}: {side.why}" for name, side in zip(names, (a, b), strict=True) if side.why),
        chance=a.chance or b.chance,
    )
