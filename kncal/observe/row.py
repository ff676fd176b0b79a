"""One row of a comparison: a metric of a run and of its reference, their difference, and the one judge's verdict."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from kncal.core.units import percent, plus_minus
from kncal.observe.estimate import Estimate, decide
from kncal.scene.metrics import metric_text, metric_unit

#: The basis of a difference of two fields.
RMS = "rms over the cells, absolute"
#: More than this many times the run's length is not worth a number.
_OUT_OF_REACH = 100.0
#: A width below this share of the value is rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True)
class Row:
    """One metric of a run and of its reference.

    Attributes
    ----------
    metric, unit, text : name, unit of ``run`` and ``reference``, and what it is
    run, reference : Estimate; of two fields without a value, and the ``width`` of ``run`` is what sampling alone gives
    difference : (run - reference)/scale [-]; its ``needed_end`` is the ``run.until_time`` that would decide [s], of an
        undecided one: None if that is more than 100 times as long, or no question of length
    scale, basis : what a difference is divided by, in the metric's unit (None if there is none), and what that is
    tolerance : allowed size of the difference [-]; None: not judged
    verdict : "ok" (the whole interval is within the tolerance), "outside" (all of it is outside), "undecided",
        "missing" (has a tolerance, cannot be computed) or "-" (no tolerance)
    exact_difference : the same difference of the two exact solutions [-], or None
    reason : why a value is missing or doubtful, or what to know about the row
    model : of a row about one run alone, its contact model; ``reference`` is then what the run should have given
    """

    metric: str
    unit: str
    text: str
    run: Estimate
    reference: Estimate
    difference: Estimate
    scale: float | None = None
    basis: str = ""
    tolerance: float | None = None
    verdict: str = "-"
    exact_difference: float | None = None
    reason: str = ""
    model: str = ""

    @property
    def seen(self) -> bool:
        """Whether either run has the metric, or their difference is known."""
        return any(e.value is not None for e in (self.run, self.reference, self.difference))

    @property
    def reach(self) -> float:
        """Share of its tolerance that the interval of the difference reaches; 0 of 0 is none."""
        size = abs(self.difference.value or 0.0) + self.difference.deciding
        return size / self.tolerance if self.tolerance else (math.inf if size else 0.0)

    def to_dict(self) -> dict[str, Any]:
        """Return the row as plain JSON types; the same keys for every kind of run."""
        d = self.difference
        of_one = {"model": self.model} if self.model else {}
        return of_one | {
            "metric": self.metric,
            "unit": self.unit,
            "text": self.text,
            "run": self.run.value,
            "run_width": self.run.width,
            "reference": self.reference.value,
            "reference_width": self.reference.width,
            "difference": d.value,
            "difference_width": d.width,
            "reliable": d.reliable,
            "significant": d.significant,
            "exact_difference": self.exact_difference,
            "basis": self.basis,
            "tolerance": self.tolerance,
            "verdict": self.verdict,
            "needed_end": d.needed_end,
            "reason": self.reason,
        }


#: The columns of a table of rows.
COLUMNS = tuple(Row(metric="", unit="", text="", run=(_ := Estimate(value=None)), reference=_, difference=_).to_dict())


def row_of(metric: str, run: Estimate, reference: Estimate, difference: Estimate, **rest: Any) -> Row:
    """Return the row of a metric, not judged; ``rest``: the other attributes of `Row`."""
    text, unit = metric_text(metric), metric_unit(metric)
    return Row(metric=metric, unit=unit, text=text, run=run, reference=reference, difference=difference, **rest)


def judge(row: Row, tolerance: float | None) -> Row:
    """Give the verdict on a row whose difference is known, or known to be missing: the one judge of all kinds of runs.

    `kncal.observe.estimate.decide` decides with the width of the difference, three times that where it is not reliable.
    Averages that began within the start-up are never "ok".
    An average says until when both runs must go on to be decided.
    """
    tolerance = None if tolerance is None else float(tolerance)
    if tolerance is None:
        return replace(row, tolerance=None, verdict="-")
    found = row.difference
    if found.value is None:
        return replace(row, tolerance=tolerance, verdict="missing")
    verdict = decide(abs(found.value), found.deciding, tolerance)
    if verdict == "ok" and not found.started:
        verdict = "undecided"  # two start-ups that agree say nothing of what comes after
    if verdict == "undecided":
        found = replace(found, needed_end=_needed(row, tolerance))
    return replace(row, difference=found, tolerance=tolerance, verdict=verdict)


def _needed(row: Row, tolerance: float) -> float | None:
    """Predict the end time [s] that decides; None beyond a hundred times the run, and for what is no time average."""
    sides, found = (row.run, row.reference), row.difference
    if row.basis == RMS:
        noise = row.run.width or 0.0
        factor = (2.0 * noise / tolerance) ** 2 if tolerance else math.inf
        return found.end * max(factor, 2.0) if factor < _OUT_OF_REACH else None
    if row.scale is None or found.value is None or any(side.average is None for side in sides):
        return None
    limit, size, width = tolerance * row.scale, abs(found.value) * row.scale, (found.width or 0.0) * row.scale
    # While the width hides the difference, plan for runs that agree: half of the tolerance for each of
    # the difference that chance leaves and its width. After that, for the distance to the tolerance.
    target = 0.5 * limit if width > 0.5 * limit else max(abs(size - limit), 1e-3 * limit)
    if target <= 0.0:
        return None
    end = max(side.end_for(target / math.sqrt(2.0)) for side in sides)
    return float(end) if end < _OUT_OF_REACH * max(side.end for side in sides) else None


def needed_end(rows: Iterable[Row]) -> float | None:
    """Return the end time [s] that would decide all undecided rows; None if there is none, or it is out of reach."""
    times = [row.difference.needed_end for row in rows if row.verdict == "undecided"]
    known = [time for time in times if time is not None]
    return max(known) if known and len(known) == len(times) else None


def difference_text(row: Row) -> str:
    """Return a difference with its width: "+1.2 ± 0.4 %", or "–"."""
    value, width = row.difference.value, row.difference.width
    if value is None or not width or width <= _ROUNDING * abs(value):
        return percent(value)
    return f"{plus_minus(100.0 * value, 100.0 * width, signed=row.basis != RMS)} %"


def deciding_text(row: Row) -> str:
    """Return a difference with the width that decides, see `kncal.observe.estimate.Estimate.deciding`."""
    return difference_text(replace(row, difference=replace(row.difference, width=row.difference.deciding)))


def allowed(tolerance: float | None) -> str:
    """Return a tolerance as text: "±5 %"."""
    return f"±{100.0 * (tolerance or 0.0):.3g} %"
