"""One row of a comparison of beds, and its verdict by confidence intervals instead of by bare numbers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from kncal.physics.statistics import Average, difference, needed_length
from kncal.scene.bed_metrics import ABSOLUTE, BED_METRICS, NOT_AVERAGED

#: The basis of a difference of two fields.
RMS = "rms over the cells, absolute"
#: Intervals of averages that are not reliable are taken this many times as wide before they decide anything.
DOUBT = 3.0
#: More than this many times the run's length is not worth a number.
_OUT_OF_REACH = 100.0


@dataclass(frozen=True, kw_only=True)
class BedRow:
    """One quantity of both runs. Uncertainties are half-widths of 95 % confidence intervals.

    Attributes
    ----------
    metric, unit, text : name, unit of ``linear`` and ``hertz``, and what it is
    linear, linear_uncertainty, hertz, hertz_uncertainty : values, or None
    difference, uncertainty : (linear - hertz)/scale [-] and of it, or None
    basis : what the scale is
    significant : whether the difference is larger than its uncertainty; None if that is not known
    tolerance : allowed size of the difference [-], None: informative
    verdict : "ok" (the whole interval is within the tolerance), "outside" (all of it is outside), "undecided" (the
        runs are too short to tell), "missing" (has a tolerance, cannot be computed) or "-" (no tolerance)
    needed_end_time : run.end_time that would decide [s], for "undecided"; None if more than 100 times as long
    reason : why a value is missing or doubtful, or what to know about the row
    """

    metric: str
    unit: str
    text: str
    linear: float | None
    linear_uncertainty: float | None
    hertz: float | None
    hertz_uncertainty: float | None
    difference: float | None
    uncertainty: float | None
    basis: str
    significant: bool | None
    tolerance: float | None
    verdict: str
    needed_end_time: float | None = None
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class Side:
    """One run's part of a row: its average or why there is none, and the window [s] that it was taken over.

    For names in `kncal.scene.bed_metrics.NOT_AVERAGED` the "average" is one value with its uncertainty, see
    `one_value`.
    """

    average: Average | None
    missing: str
    begin: float
    end: float

    def needed_end_time(self, precision: float) -> float:
        """Predict the end time [s] for an uncertainty of ``precision``, beyond this run's end."""
        found, length = self.average, self.end - self.begin
        if found is None:
            raise ValueError("no average: expected one")
        if found.length > 0.0:
            needed = needed_length(found, precision)
        else:  # a mean over events, such as bubbles: as many more of them as the run is longer
            needed = length * (found.uncertainty / precision) ** 2
        if not found.reliable and needed <= length:  # a drift or a long start-up is not cured by statistics
            needed = 2.0 * length
        return self.begin + needed


def one_value(value: float, uncertainty: float, begin: float, end: float) -> Average:
    """Return a value that is no average over time in the form of one: one sample, from ``begin`` to ``end`` [s]."""
    return Average(
        mean=value,
        uncertainty=uncertainty,
        standard_error=0.5 * uncertainty,
        std=0.0,
        n_effective=1.0,
        correlation_time=0.0,
        length=end - begin,
        discarded=begin,
        reliable=True,
        why="",
    )


def describe(name: str) -> tuple[str, str]:
    """Return unit and text of a quantity; ("", "") for a name that kncal doesn't know."""
    return BED_METRICS.get(name, ("", ""))


def row_order(name: str) -> tuple[int, str]:
    """Return the key to sort quantities by: as in `BED_METRICS`, other names follow, by alphabet."""
    return list(BED_METRICS).index(name) if name in BED_METRICS else len(BED_METRICS), name


def judge(
    name: str, linear: Side, hertz: Side, tolerance: float | None, names: tuple[str, str] = ("linear", "hertz")
) -> BedRow:
    """Make the row of a quantity and give the verdict; the second of the two runs is the reference.

    Other runs than a linear and a Hertz one have other ``names`` in texts.

    The interval of the difference decides (two one-sided tests: Schuirmann, J. Pharmacokinet. Biopharm. 15 (1987)
    657): that no difference is seen in a short run is no proof of agreement. Relative to the Hertz value; absolute for
    `ABSOLUTE` and where the Hertz value is zero and the quantity a number without a unit.
    """
    unit, _ = describe(name)
    a, b = linear.average, hertz.average
    first, second = names
    if a is None or b is None:
        sides = ((first, linear), (second, hertz))
        reason = "; ".join(f"{kind}: {s.missing or 'not observed'}" for kind, s in sides if s.average is None)
        if linear.missing == hertz.missing and a is b is None:
            reason = linear.missing or "not observed"
        return _row(name, a, b, None, None, "", None, tolerance, "-" if tolerance is None else "missing", None, reason)
    found = difference(a, b)
    scale, basis = abs(b.mean), f"relative to {second}"
    if name in ABSOLUTE or (scale == 0.0 and unit == "–"):
        scale, basis = 1.0, "absolute"
    doubt = found.why.replace("first:", f"{first}:").replace("second:", f"{second}:")
    if scale == 0.0:
        if found.value == 0.0:
            scale = 1.0
        else:
            verdict = "-" if tolerance is None else "missing"
            reason = f"{name} is 0 for {second} and has no natural scale"
            return _row(name, a, b, None, None, "", None, tolerance, verdict, None, reason)
    trusted = found.reliable
    width = found.uncertainty * (1.0 if trusted else DOUBT)
    significant = True if abs(found.value) > width else (False if trusted else None)
    verdict, needed = "-", None
    if tolerance is not None:
        limit = tolerance * scale
        verdict = decide(abs(found.value), width, limit)
        if verdict == "undecided" and name not in NOT_AVERAGED:
            needed = _needed((linear, hertz), abs(found.value), found.uncertainty, limit)
    return _row(
        name,
        a,
        b,
        found.value / scale,
        found.uncertainty / scale,
        basis,
        significant,
        tolerance,
        verdict,
        needed,
        doubt,
    )


def judge_field(
    name: str, rms: float | None, noise: float, tolerance: float | None, end: float, reason: str = ""
) -> BedRow:
    """Make the row of the rms difference of two fields, ``rms``, of which sampling alone would give ``noise``.

    Squares add: what is left of ``rms`` after the noise is between ``sqrt(rms² - 4 noise²)`` and ``rms``.
    """
    if rms is None:
        verdict = "-" if tolerance is None else "missing"
        return _row(name, None, None, None, None, "", None, tolerance, verdict, None, reason)
    low = float(np.sqrt(max(rms**2 - (2.0 * noise) ** 2, 0.0)))
    verdict, needed = "-", None
    if tolerance is not None:
        verdict = "ok" if rms <= tolerance else "outside" if low > tolerance else "undecided"
        if verdict == "undecided":
            factor = (2.0 * noise / tolerance) ** 2
            needed = end * max(factor, 2.0) if factor < _OUT_OF_REACH else None
    return _row(name, None, None, rms, noise, RMS, low > 0.0, tolerance, verdict, needed, reason)


def decide(difference: float, width: float, limit: float) -> str:
    """Return the verdict on a difference of size ``difference`` ± ``width`` where ``limit`` is allowed."""
    if difference + width <= limit:
        return "ok"
    return "outside" if difference - width > limit else "undecided"


def _needed(sides: tuple[Side, Side], difference: float, uncertainty: float, limit: float) -> float | None:
    """Predict the end time [s] that decides; None beyond a hundred times the run."""
    # While the uncertainty hides the difference, plan for runs that agree: half of the tolerance for each of
    # the difference that chance leaves and its uncertainty. After that, for the distance to the tolerance.
    target = 0.5 * limit if uncertainty > 0.5 * limit else max(abs(difference - limit), 1e-3 * limit)
    if target <= 0.0:
        return None
    end = max(side.needed_end_time(target / np.sqrt(2.0)) for side in sides)
    return float(end) if end < _OUT_OF_REACH * max(side.end for side in sides) else None


def _row(
    name: str,
    a: Average | None,
    b: Average | None,
    difference: float | None,
    uncertainty: float | None,
    basis: str,
    significant: bool | None,
    tolerance: float | None,
    verdict: str,
    needed: float | None,
    reason: str,
) -> BedRow:
    unit, text = describe(name)
    return BedRow(
        metric=name,
        unit=unit,
        text=text,
        linear=None if a is None else a.mean,
        linear_uncertainty=None if a is None else a.uncertainty,
        hertz=None if b is None else b.mean,
        hertz_uncertainty=None if b is None else b.uncertainty,
        difference=difference,
        uncertainty=uncertainty,
        basis=basis,
        significant=significant,
        tolerance=None if tolerance is None else float(tolerance),
        verdict=verdict,
        needed_end_time=needed,
        reason=reason,
    )


def sampled(rows: Iterable[BedRow]) -> tuple[BedRow, ...]:
    """Return the rows of averages that are known well enough for a statement about chance."""
    return tuple(r for r in rows if r.significant is not None and r.linear is not None and r.metric not in NOT_AVERAGED)


def called_by_chance(rows: Iterable[BedRow]) -> float:
    """Return how many of the rows would be called different by chance alone, if none were: one in twenty."""
    return 0.05 * len(sampled(rows))
