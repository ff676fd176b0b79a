"""What changes between runs of a scene and of the scene without a part: cost, and each metric with its resolution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from kncal.core.errors import InputError
from kncal.observe.cost import CPU_MEASURABLE, CPU_TRUSTED
from kncal.observe.difference import FIELDS, PATHS, rows_between
from kncal.observe.estimate import Estimate, missing
from kncal.observe.row import Row, judge
from kncal.observe.run_data import RunData
from kncal.observe.truth import predicted_errors
from kncal.runs.workflow import load
from kncal.study import VariantRun
from kncal.study.trim.trim import OFF, CostChange, Part

#: What the two runs are called in texts.
NAMES = ("tried", "full")
#: Relative changes below this are those of another order of the same sums.
_ROUNDING = 1e-12
#: The error of a run is at most so many times its difference from one with half the step (a method of first order at
#: least); of two runs, twice that.
_FIRST_ORDER = 2.0
#: The difference of what is equal to the last bit.
_EQUAL = Estimate(value=0.0, width=0.0)


def see(run: VariantRun) -> RunData:
    """Read a completed run, with its predicted discretisation errors where there are any."""
    data = load(_folder(run))
    return data if data.contacts is None else replace(data, predicted=predicted_errors(data.model, data.contacts))


def _folder(run: VariantRun) -> Path:
    if run.folder is None:
        raise InputError(f"{run.variant.name}: {run.status}: {run.message}")
    return run.folder


def resolution_of(full: RunData, fine: RunData) -> dict[str, float]:
    """Return, by metric, what two runs at the step of ``full`` may differ by through that step alone [-].

    ``fine`` is the same scene at half the step. For metrics without a predicted error (`kncal.observe.truth`).
    """
    rows = rows_between(fine, full, {}, NAMES)
    moved = {row.metric: row.difference.value for row in rows}
    return {name: 2.0 * _FIRST_ORDER * abs(value) for name, value in moved.items() if value is not None}


def effects(
    tried: RunData,
    full: RunData,
    tolerances: Mapping[str, float],
    *,
    lost: Mapping[str, str] | None = None,
    resolution: Mapping[str, float] | None = None,
    recorded: bool = False,
) -> tuple[Row, ...]:
    """Return the change of every metric: a row of ``tried`` and ``full``, judged.

    A change is "ok" (all of its interval is inside the tolerance, or it is exactly 0: nothing differs to the last bit),
    "outside" (all of it is outside, or the metric is gone), "undecided", or "-" (not judged).

    Parameters
    ----------
    tolerances : metric -> largest allowed change [-]. Empty: what the step cannot resolve is no effect; of averages
        nothing but equality shows that there is none
    lost : metric -> why it cannot be compared
    resolution : see `resolution_of`; stands in where no discretisation error is predicted
    recorded : whether the two differ in what they record alone. They make the same steps: the change is known as it is
    """

    def judged(row: Row) -> Row:
        why = (lost or {}).get(row.metric)
        row = _lost(row, why) if why else _resolved(row, resolution or {}, recorded=recorded)
        return _effect(row, bool(tolerances))

    rows = [judged(row) for row in rows_between(tried, full, tolerances, NAMES)]
    # what neither run has does not differ, if all else is equal to the last bit
    known = [row for row in rows if row.difference.value is not None]
    same = bool(known) and not any(row.difference.value for row in known)
    return tuple(replace(row, difference=_EQUAL, verdict="ok") if same and not row.seen else row for row in rows)


def _lost(row: Row, why: str) -> Row:
    verdict = "-" if row.tolerance is None else "undecided"
    return replace(row, difference=missing(why), verdict=verdict, reason=why)


def _resolved(row: Row, resolution: Mapping[str, float], *, recorded: bool) -> Row:
    """Return a row whose difference has the width that the step leaves; that of averages as it is."""
    found = row.difference
    if found.value is None or found.chance:
        return row
    width = 0.0 if recorded else found.width if found.width is not None else resolution.get(row.metric)
    width = None if width is None else max(width, _ROUNDING)
    return judge(replace(row, difference=replace(found, width=width)), row.tolerance)


def _effect(row: Row, limits: bool) -> Row:
    """Give the verdict where it is not that of a difference with a width and a tolerance."""
    found = row.difference
    if found.value is None:
        if row.tolerance is None or row.verdict == "undecided":
            return row
        gone = row.reference.value is not None and row.run.value is None
        # a tolerance for what the scene has not, with or without the part
        none = not row.seen and row.metric not in (*FIELDS, *PATHS)
        return replace(row, verdict="outside" if gone else "-" if none else "undecided")
    if found.value == 0.0:
        return replace(row, difference=_EQUAL, verdict="ok")
    if found.width is None:
        return replace(row, verdict="-" if limits and row.tolerance is None else "undecided")
    if limits:
        return row
    # where nothing is judged, a difference that is not seen in a short run is no proof that there is none
    unseen = "undecided" if found.chance else "ok"
    return replace(row, verdict="outside" if found.significant else unseen)


def cost_change(part: Part | None, tried: VariantRun, full: VariantRun, engine: str) -> CostChange:
    """Return what having ``part`` costs; None: what the full scene costs beyond the one tried."""
    has, has_not = (full, tried) if part is None or part.change == OFF else (tried, full)
    caveat, pairs = "", list[float]()
    slowest = min(min(run.cpu_seconds) for run in (full, tried))
    if engine == "builtin":
        caveat = "the builtin engine jumps over free flight: its CPU time says nothing about a solver's"
    elif slowest < CPU_MEASURABLE:
        caveat = f"runs below {CPU_MEASURABLE:g} s of CPU are mostly the solver's start: only the steps are compared"
    elif len(has.cpu_seconds) != len(has_not.cpu_seconds):
        caveat = "not every round completed, so that CPU times cannot be paired"
    else:
        pairs = [a / b - 1.0 for a, b in zip(has.cpu_seconds, has_not.cpu_seconds, strict=True)]
        if slowest < CPU_TRUSTED:
            caveat = f"runs below {CPU_TRUSTED:g} s of CPU are mostly the solver's start and the writing of frames"
        elif len(pairs) == 1:
            caveat = "one run each: the spread of the CPU times is not known"
    full_bytes, tried_bytes = _bytes(_folder(full)), _bytes(_folder(tried))
    disk = (full_bytes, tried_bytes) if has is full else (tried_bytes, full_bytes)
    return CostChange(
        cpu=float(np.median(pairs)) if pairs else None,
        cpu_low=min(pairs) if len(pairs) > 1 else None,
        cpu_high=max(pairs) if len(pairs) > 1 else None,
        rounds=max(len(pairs), 1),
        steps=(has.steps or 0) / max(has_not.steps or 0, 1) - 1.0,
        disk=disk[0] / disk[1] - 1.0,
        full_cpu=float(np.median(full.cpu_seconds)),
        tried_cpu=float(np.median(tried.cpu_seconds)),
        full_bytes=full_bytes,
        tried_bytes=tried_bytes,
        caveat=caveat,
    )


def _bytes(folder: Path) -> int:
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
