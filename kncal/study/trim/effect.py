"""What changes between runs of a scene and of the scene without a part: cost, and each metric with its resolution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from kncal.core.errors import InputError
from kncal.observe.cost import CPU_MEASURABLE, CPU_TRUSTED
from kncal.observe.difference import rows_between
from kncal.observe.row import Row
from kncal.observe.run_data import RunData, observed
from kncal.observe.truth import predicted_errors
from kncal.runs.workflow import load
from kncal.study import VariantRun
from kncal.study.trim.base import OFF, CostChange, Effect, Part

#: What the two runs are called in texts.
NAMES = ("tried", "full")
#: Relative changes below this are those of another order of the same sums.
_ROUNDING = 1e-12
#: The error of a run is at most so many times its difference from one with half the step (a method of first order at
#: least); of two runs, twice that.
_FIRST_ORDER = 2.0


def see_contacts(run: VariantRun) -> RunData:
    """Read a completed run of single contacts, with its predicted discretisation errors."""
    data = load(_folder(run))
    return replace(data, predicted=predicted_errors(data.model, data.observations))


def see_bed(run: VariantRun) -> RunData:
    """Read a completed run of a bed, and observe it."""
    return observed(load(_folder(run)))


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


def contact_effects(
    part: Part | None,
    tried: RunData,
    full: RunData,
    tolerances: Mapping[str, float],
    resolution: Mapping[str, float],
) -> tuple[Effect, ...]:
    """Return the change of every metric of single contacts.

    ``resolution`` (see `resolution_of`) stands in where no discretisation error is predicted. Two runs that differ in
    what they record alone make the same steps: the change is then known as it is. ``part``: None for several at once.
    """
    recorded = part is not None and part.output
    found = [
        _contact_effect(row, 0.0 if recorded else _width(row, resolution), tolerances)
        for row in rows_between(tried, full, tolerances, NAMES)
    ]
    # a tolerance for what the scene has not, with or without the part
    found = [replace(e, verdict="-") if e.full is None and e.change is None and e.tried is None else e for e in found]
    return _settled(found)


def _width(row: Row, resolution: Mapping[str, float]) -> float | None:
    return row.difference.width if row.difference.width is not None else resolution.get(row.metric)


def _contact_effect(row: Row, width: float | None, tolerances: Mapping[str, float]) -> Effect:
    change, tolerance = row.difference.value, tolerances.get(row.metric)
    width = None if width is None else max(width, _ROUNDING)
    effect = Effect(
        metric=row.metric,
        unit=row.unit,
        full=row.reference.value,
        tried=row.run.value,
        change=change,
        uncertainty=None if change is None else width,
        basis=row.basis,
        tolerance=tolerance,
        verdict="-",
        significant=None,
        reason=row.reason,
    )
    if change is None:
        return _without_change(effect)
    if change == 0.0:
        return replace(effect, verdict="none", uncertainty=0.0, significant=False)
    if width is None:
        return replace(effect, verdict="undecided" if tolerance is not None or not tolerances else "-")
    significant = abs(change) > width
    verdict = "-"
    if tolerance is not None:
        verdict = _verdict(abs(change), width, tolerance)
    elif not tolerances:  # what the step cannot resolve is no effect of the part
        verdict = "changed" if significant else "within"
    return replace(effect, verdict=verdict, significant=significant)


def _verdict(change: float, width: float, tolerance: float) -> str:
    if change + width <= tolerance:
        return "within"
    return "changed" if change - width > tolerance else "undecided"


def _without_change(effect: Effect) -> Effect:
    """Give the verdict on a metric that cannot be compared: gone without the part, or not there to begin with."""
    if effect.tolerance is None:
        return effect
    gone = effect.full is not None and effect.tried is None
    return replace(effect, verdict="changed" if gone else "undecided", significant=True if gone else None)


def _settled(effects: list[Effect]) -> tuple[Effect, ...]:
    """What neither run has does not differ, if all else is equal to the last bit."""
    known = [e for e in effects if e.change is not None]
    same = bool(known) and all(e.verdict == "none" for e in known)
    return tuple(
        replace(e, verdict="none") if same and e.full is None and e.tried is None and e.change is None else e
        for e in effects
    )


def bed_effects(
    tried: RunData, full: RunData, tolerances: Mapping[str, float], lost: Mapping[str, str]
) -> tuple[Effect, ...]:
    """Return the change of every quantity of a bed; ``lost``: quantity -> why it cannot be compared."""
    found = [
        _bed_effect(row, bool(tolerances), lost.get(row.metric, ""))
        for row in rows_between(tried, full, tolerances, NAMES)
    ]
    return _settled(found)


def _bed_effect(row: Row, limits: bool, lost: str) -> Effect:
    found = row.difference
    change, width = found.value, None if found.width is None else found.deciding
    effect = Effect(
        metric=row.metric,
        unit=row.unit,
        full=row.reference.value,
        tried=row.run.value,
        change=change,
        uncertainty=width,
        basis=row.basis,
        tolerance=row.tolerance,
        verdict="-",
        significant=found.significant,
        needed_end_time=found.needed_end,
        reason=row.reason,
    )
    if lost:
        verdict = "-" if row.tolerance is None else "undecided"
        return replace(effect, change=None, uncertainty=None, significant=None, verdict=verdict, reason=lost)
    if change is None:
        return _without_change(effect)
    if change == 0.0:
        return replace(effect, verdict="none", uncertainty=0.0, significant=False, needed_end_time=None)
    if row.tolerance is not None:
        return replace(effect, verdict={"ok": "within", "outside": "changed"}.get(row.verdict, "undecided"))
    # where nothing is judged, a difference that is not seen in a short run is no proof that there is none
    return effect if limits else replace(effect, verdict="changed" if found.significant else "undecided")


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
