"""Errors of a bed against the reference, by averages and their intervals; and where they come from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from kncal.observe.bed_compare import ObservedRun, rows_between
from kncal.observe.bed_rows import DOUBT, RMS, BedRow
from kncal.physics.statistics import difference
from kncal.study.trade.base import Candidate, ErrorSplit, MetricError, Part

NAMES = ("candidate", "reference")


def bed_errors(run: ObservedRun, reference: ObservedRun, tolerances: Mapping[str, float]) -> dict[str, MetricError]:
    """Return the error of every metric that one of the two runs has, or that has a tolerance.

    The uncertainty is the half-width of the 95 % interval of both averages, three times that where one of them is
    not reliable (`kncal.observe.bed_rows.DOUBT`).
    """
    return {row.metric: _error(row) for row in rows_between(run, reference, tolerances, NAMES)}


def _error(row: BedRow) -> MetricError:
    error, width, reason = row.difference, row.uncertainty, row.reason
    if error is not None and row.basis == RMS:
        # what is left of the rms difference after the noise is between these two: see
        # `kncal.observe.bed_rows.judge_field`
        noise = width or 0.0
        low = float(np.sqrt(max(error**2 - 4.0 * noise**2, 0.0)))
        error, width = 0.5 * (error + low), 0.5 * (error - low)
    elif error is not None and width is not None and reason:
        width *= DOUBT
        reason = f"interval taken {DOUBT:g} times as wide: {reason}"
    return MetricError(
        metric=row.metric,
        unit=row.unit,
        value=row.linear,
        reference=row.hertz,
        error=error,
        uncertainty=width,
        basis=row.basis,
        reason=reason,
        needed_end_time=row.needed_end_time,
    )


@dataclass(frozen=True, kw_only=True)
class Judged:
    """A candidate whose run was observed, and its errors."""

    candidate: Candidate
    run: ObservedRun
    errors: Mapping[str, MetricError]


def bed_splits(judged: Iterable[Judged], reference: ObservedRun, steps: float) -> dict[str, tuple[ErrorSplit, ...]]:
    """Split the errors of each candidate by what was changed one at a time, metric by metric.

    Discretisation: the candidate against the same contact at ``steps``, the N of the reference. Softness: that one
    against the same model unsoftened. Model: the unsoftened linear spring against the reference. They add up to the
    whole. Each is the difference of two averages, with the interval of both: a part within its own is not resolved.
    """
    judged = list(judged)
    at = {_contact(j.candidate, j.candidate.steps_per_contact): j.run for j in judged}
    hard: dict[str, ObservedRun | None] = {"hertz": reference, "linear": None}
    for j in judged:
        c = j.candidate
        if c.model == "linear" and c.factor == 1.0 and c.steps_per_contact == steps:
            hard["linear"] = j.run
    found = {}
    for j in judged:
        c = j.candidate
        fine = reference if c.model == "hertz" and c.factor == 1.0 else at.get(_contact(c, steps))
        splits = [
            _split(error, c, steps, (j.run, fine, hard[c.model], reference))
            for error in j.errors.values()
            if error.error is not None and error.basis != RMS
        ]
        found[c.name] = tuple(splits)
    return found


def _contact(candidate: Candidate, steps: float) -> tuple[str, str, float | None, float]:
    return candidate.model, candidate.how, candidate.factor, steps


def _split(
    error: MetricError,
    candidate: Candidate,
    steps: float,
    chain: tuple[ObservedRun, ObservedRun | None, ObservedRun | None, ObservedRun],
) -> ErrorSplit:
    """Split one error along ``chain``: the run, converged in N, unsoftened, the reference."""
    run, fine, hard, reference = chain
    scale = abs(error.reference or 0.0) if error.basis.startswith("relative") else 1.0
    missing: list[str] = []

    def part(what: str, a: ObservedRun | None, b: ObservedRun | None, why: str) -> Part | None:
        found = None if a is None or b is None else _between(a, b, error.metric, scale)
        if found is None:
            missing.append(f"{what}: {why}")
        return found

    parts: dict[str, Part | None] = {"discretisation": None, "softness": None, "model": None}
    if candidate.steps_per_contact != steps:
        parts["discretisation"] = part("discretisation", run, fine, f"this contact was not run at N = {steps:g}")
    if candidate.factor != 1.0:
        parts["softness"] = part("softness", fine, hard, f"one of the two was not run at N = {steps:g}")
    if candidate.model == "linear":
        parts["model"] = part("model", hard, reference, f"the unsoftened spring was not run at N = {steps:g}")
    total = error.error or 0.0
    known = sum(p.value for p in parts.values() if p is not None)
    told = ["discretisation: none against the reference, which has the same N"]
    return ErrorSplit(
        metric=error.metric,
        total=Part(value=total, uncertainty=error.uncertainty),
        **parts,
        interaction=None if missing else total - known,
        missing=tuple((told if candidate.steps_per_contact == steps else []) + missing),
    )


def _between(a: ObservedRun, b: ObservedRun, name: str, scale: float) -> Part | None:
    first, second = a.found.side(name).average, b.found.side(name).average
    if first is None or second is None or scale == 0.0:
        return None
    apart = difference(first, second)
    return Part(value=apart.value / scale, uncertainty=apart.uncertainty * (1.0 if apart.reliable else DOUBT) / scale)
