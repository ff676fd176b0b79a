"""Running variants: each round of each model is a sweep, so runs go side by side, are kept, and are not run twice.

FOLDER/round-1/linear/   a sweep (see `kncal.study.design`), FOLDER/round-1/hertz/, FOLDER/round-2/linear/ ...

Rounds repeat the same runs for the sake of their CPU times: A B C, A B C, so that a slow minute of the machine hits all
of them alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from kncal.core.checks import in_range
from kncal.core.errors import InputError
from kncal.runs.folder import read_result
from kncal.runs.records import RESULT
from kncal.scene.model import KINDS
from kncal.study.design import Settings, design_points, run_folder
from kncal.study.execute import ThreadExecutor
from kncal.study.states import WAITING, failure_class
from kncal.study.sweep import SweepProgress, run_sweep
from kncal.study.variants import Variant

#: Status of a variant that was refused before any run.
REFUSED = "refused"

#: Called with (round, rounds, model, progress of that sweep).
OnStudyProgress = Callable[[int, int, str, SweepProgress], None]


@dataclass(frozen=True, kw_only=True)
class VariantRun:
    """What became of one variant.

    Attributes
    ----------
    variant : Variant
    status : of `kncal.record.outcome.RunResult` ("completed", "failed", "timed_out" ...), or `REFUSED`
    failure, message : why it did not complete; both empty if it did
    folder : its model's run folder in the first round, for `kncal.runs.workflow.load`; None if
        refused
    cpu_seconds : CPU time of each round that completed [s]
    wall_seconds : likewise [s]
    steps, dt : of the first round, None if there is no result [-], [s]
    """

    variant: Variant
    status: str
    failure: str = ""
    message: str = ""
    folder: Path | None = None
    cpu_seconds: tuple[float, ...] = ()
    wall_seconds: tuple[float, ...] = ()
    steps: int | None = None
    dt: float | None = None

    @property
    def completed(self) -> bool:
        """Whether the first round completed."""
        return self.status == "completed"


def run_variants(
    case: str | Path,
    variants: Iterable[Variant],
    folder: Path,
    *,
    rounds: int = 1,
    engine: str = "liggghts",
    transport: str = "auto",
    workers: int | None = None,
    timeout: float | None = None,
    on_progress: OnStudyProgress | None = None,
    look: bool = False,
    beyond: bool = False,
) -> dict[str, VariantRun]:
    """Run variants of a case, each ``rounds`` times, and return what became of them, by name in the order given.

    A variant that cannot run (a limit refuses it, a value is out of range) is `REFUSED` with the reason; the others
    run. Runs that ``folder`` holds already are kept, so the same call again goes on, and one with more variants or
    rounds adds to it. Variants with the same input are one run.

    Parameters
    ----------
    case : a case.toml, a folder holding one, or the name of a shipped case
    folder : of the study; `kncal clean` may remove it
    engine : of single contacts; transport : of beds
    workers : runs at a time; default: one per core
    timeout : wall-clock limit of each run [s]
    look : run nothing, only say what is there; a variant without a result is `WAITING`
    beyond : run also what a limit refuses

    Raises
    ------
    InputError
        If two variants have one name, or ``rounds`` is out of range.
    CaseFileError, SolverMissingError, InterruptedRunError
        As `kncal.study.sweep.run_sweep`.
    """
    variants = list(variants)
    names = [variant.name for variant in variants]
    if len(set(names)) < len(names):
        raise InputError(f"variants {', '.join(names)}: expected names that differ")
    in_range("rounds", rounds, 1, 1000)
    found: dict[str, VariantRun] = {}
    for number in range(1, rounds + 1):
        for kind in KINDS:
            ours = [variant for variant in variants if variant.model == kind]
            if not ours:
                continue
            settings = Settings(engine=engine, models=(kind,), transport=transport, timeout=timeout, beyond=beyond)
            told = None if on_progress is None else partial(on_progress, number, rounds, kind)
            there = folder / f"round-{number}" / kind
            for run in _round(case, ours, settings, there, workers, told, look=look):
                found[run.variant.name] = _added(found.get(run.variant.name), run)
    return {name: found[name] for name in names}


def _round(
    case: str | Path,
    variants: Sequence[Variant],
    settings: Settings,
    folder: Path,
    workers: int | None,
    on_progress: Callable[[SweepProgress], None] | None,
    *,
    look: bool,
) -> list[VariantRun]:
    """Run variants of one model once, or only look at what is there."""
    sweep, text, ids = design_points(case, [variant.point for variant in variants], settings, skip_bad=True)
    messages: Mapping[str, str] = {}
    if sweep.runs and not look:
        folder.parent.mkdir(parents=True, exist_ok=True)
        messages = run_sweep(sweep, text, folder, ThreadExecutor(workers), on_progress).messages
    reasons = iter(sweep.refused)  # in the order of the points
    none = WAITING if look else "failed"

    return [
        VariantRun(variant=variant, status=REFUSED, failure="bad-input", message=next(reasons).message)
        if run is None
        else _ended(variant, run_folder(folder, run) / variant.model, none, messages.get(run, ""))
        for variant, run in zip(variants, ids, strict=True)
    ]


def _ended(variant: Variant, folder: Path, status: str, message: str) -> VariantRun:
    """Return how a run ended; ``status``: of one without a result."""
    if not (folder / RESULT).is_file():
        return VariantRun(variant=variant, status=status, failure="run-failed", message=message)
    result = read_result(folder)
    done = result.status == "completed"
    return VariantRun(
        variant=variant,
        status=result.status,
        failure=failure_class(result.status, result.failure),
        message=result.message or message,
        folder=folder,
        cpu_seconds=(result.cpu_seconds,) if done else (),
        wall_seconds=(result.wall_seconds,) if done else (),
        steps=result.steps,
        dt=result.dt,
    )


def _added(before: VariantRun | None, run: VariantRun) -> VariantRun:
    """Return a variant's first run with the times of one more."""
    if before is None:
        return run
    return replace(
        before,
        cpu_seconds=(*before.cpu_seconds, *run.cpu_seconds),
        wall_seconds=(*before.wall_seconds, *run.wall_seconds),
    )
