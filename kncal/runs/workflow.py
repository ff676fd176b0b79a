"""The main job in one place: scene -> models -> rendered folders -> runs -> numbers -> comparison -> report."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from kncal.core.checks import in_range, one_of, positive
from kncal.core.errors import (
    CaseFileError,
    InputError,
    InterruptedRunError,
    ReadError,
    RunError,
    SolverMissingError,
    failure_of,
)
from kncal.core.files import write_json
from kncal.core.scratch import scratch
from kncal.engines.base import Engine, Profile, Progress, Tell
from kncal.observe.compare import Comparison, compare
from kncal.observe.run_data import RunData
from kncal.observe.truth import exact_metrics, exact_motion, predicted_errors
from kncal.record.outcome import RunResult
from kncal.report.comparison import write_report
from kncal.report.overview import context_of
from kncal.report.tables import export_paraview, export_tables
from kncal.runs.folder import (
    REPORT,
    case_folder,
    model_manifest,
    read_manifest,
    read_model_folder,
    read_result,
    write_result,
)
from kncal.runs.records import MANIFEST, RESULT
from kncal.runs.resume import Earlier, take_up
from kncal.runs.solving import check_options, plan_checked, read_run
from kncal.runs.started import started
from kncal.scene.limits import no_contact, warnings_of
from kncal.scene.model import KINDS
from kncal.scene.placement import Start
from kncal.scene.scene import Scene

#: What a progress callback is asked for besides the models: steps of the settling, in all as far as known.
PACKING = "packing"
#: Called for each model with its kind, and with `PACKING`; returns the progress callback of that run.
ProgressFor = Callable[[str], Progress | None]


@dataclass(frozen=True, kw_only=True)
class _Rendered:
    """A run folder that is held: its models, what an earlier start left of each, where particles start, the lock."""

    models: Mapping[str, Any]
    earlier: Mapping[str, Earlier]
    start: Start | None
    lock: int


def render_case(
    scene: Scene,
    engine: Engine,
    out: Path,
    kinds: Iterable[str] = KINDS,
    *,
    progress_for: ProgressFor | None = None,
    tell: Tell | None = None,
) -> Mapping[str, Any]:
    """Write the case folder: one subfolder with solver input per model, manifests, the case itself.

    Returns the models by kind. Whatever can be refused is refused before anything is written or moved; what an earlier
    run left in ``out`` is moved to ``attempt-N``. The settled packing of a bed is made by LIGGGHTS for it.

    Raises
    ------
    CaseFileError
        If a limit refuses the scene.
    RenderError
        If the engine cannot simulate it, or ``out`` holds other things.
    RunError
        If the packing fails (SolverMissingError: LIGGGHTS is not installed).
    """
    with _rendered(
        scene, engine, out, kinds, by_hand=True, rerun=True, repeat=1, progress_for=progress_for, tell=tell
    ) as it:
        return it.models


@contextmanager
def _rendered(
    scene: Scene,
    engine: Engine,
    out: Path,
    kinds: Iterable[str],
    *,
    by_hand: bool,
    rerun: bool,
    repeat: int,
    beyond: bool = False,
    progress_for: ProgressFor | None,
    tell: Tell | None,
) -> Iterator[_Rendered]:
    """Render into ``out`` and hold it."""
    engine.check(scene, by_hand=by_hand)
    models = plan_checked(scene, [one_of("model", kind, KINDS) for kind in kinds], beyond=beyond)
    profile = engine.profile()
    start = engine.start(scene, tell=tell, progress=progress_for(PACKING) if progress_for else None)
    with scratch() as draft:
        for kind, model in models.items():
            (draft / kind).mkdir()
            engine.render(model, draft / kind, start=start, by_hand=by_hand)
        with case_folder(scene, out, keep=not rerun, tell=tell) as lock:
            manifests = {
                kind: model_manifest(model, draft / kind, profile, engine.command(model, by_hand=by_hand), engine.ranks)
                for kind, model in models.items()
            }
            checkpoints = {kind: engine.resumes_at(model, out / kind) for kind, model in models.items()}
            earlier = take_up(out, manifests, repeat=repeat, checkpoints=checkpoints, tell=tell)
            left_out = shutil.ignore_patterns(*(() if by_hand else engine.written_by_run))
            for kind, manifest in manifests.items():
                if earlier[kind].action == "run":
                    shutil.copytree(draft / kind, out / kind, ignore=left_out)
                    write_json(out / kind / MANIFEST, manifest)
            yield _Rendered(models=models, earlier=earlier, start=start, lock=lock)


def run_case(
    scene: Scene,
    engine: Engine,
    out: Path,
    kinds: Iterable[str] = KINDS,
    *,
    timeout: float | None = None,
    progress_for: ProgressFor | None = None,
    repeat: int = 1,
    rerun: bool = False,
    beyond: bool = False,
    tell: Tell | None = None,
) -> dict[str, RunResult]:
    """Render and run the models, and stop at the first that does not complete.

    A model whose completed run is in ``out``, of the same input by the same solver, is not run again; a bed that was
    stopped resumes at its last complete checkpoint (``rerun``: both start again). Whatever else was there is moved to
    ``attempt-N``. ``tell`` is called with a sentence about each such model. ``beyond``: limits are not asked.

    With ``repeat`` > 1 the models are run in turn that many times (A B A B ...), so that their CPU times are comparable
    on a busy machine; the frames kept are the last run's, the CPU seconds of all stand in ``extra["cpu_samples"]``.
    Every started run leaves its ``result.json``; the caller looks at the status (or calls `require_completed`).

    Raises
    ------
    InputError
        If the timeout or the number of repeats is not positive, a kind is unknown, or the scene cannot use them or the
        engine's ranks.
    CaseFileError
        If a limit refuses the run; nothing is written then.
    SolverMissingError
        If there is no solver; nothing is written then.
    RunError
        If the packing of a bed fails, or the folder cannot be written.
    """
    in_range("repeat", repeat, 1, 1e6)
    check_options(scene, repeat=repeat)
    if timeout is not None:
        positive("timeout", timeout, unit="s")
    profile = _looked_for(engine, scene)
    results: dict[str, RunResult] = {}
    samples: dict[str, list[float]] = {kind: [] for kind in KINDS}
    try:
        with _rendered(
            scene,
            engine,
            out,
            kinds,
            by_hand=False,
            rerun=rerun,
            repeat=repeat,
            beyond=beyond,
            progress_for=progress_for,
            tell=tell,
        ) as it:
            results |= {kind: found.result for kind, found in it.earlier.items() if found.result is not None}
            _tell_transports(results, engine, tell)
            for kind in [kind for kind in it.models if kind not in results] * repeat:
                progress = progress_for(kind) if progress_for else None
                with started(out / kind):  # a result of an earlier repeat would vouch for what this one is writing
                    result = engine.run(
                        it.models[kind],
                        out / kind,
                        start=it.start,
                        timeout=timeout,
                        progress=progress,
                        resume=it.earlier[kind].action == "resume",
                        pass_fds=(it.lock,),
                    )
                    samples[kind].append(result.cpu_seconds)
                    extra = {**result.extra, "cpu_samples": list(samples[kind])}
                    extra |= {"warning": profile.warning} if profile.warning else {}
                    results[kind] = replace(result, extra=extra)
                    write_result(results[kind])
                if result.status != "completed":
                    break
    except OSError as error:
        raise RunError(f"{error.filename or out}: {error.strerror or error}", failure_of(error)) from error
    return {kind: results[kind] for kind in KINDS if kind in results}


def _looked_for(engine: Engine, scene: Scene) -> Profile:
    """Return what this machine has of an engine; refuse a scene that it cannot run, or solvers that are missing."""
    engine.check(scene)
    profile = engine.profile()
    if profile.program is None:
        raise SolverMissingError(profile.problem)
    if profile.warning:
        logging.getLogger("kncal").warning("kncal: %s", profile.warning)
    return profile


def _tell_transports(kept: Mapping[str, RunResult], engine: Engine, tell: Tell | None) -> None:
    for kind, result in kept.items():
        used = result.extra.get("transport", "none")
        if tell and used not in ("none", getattr(engine, "transport", used)):
            tell(f"{kind}: that run used the {used} transport, which gives the same numbers")


def require_completed(results: Iterable[RunResult]) -> None:
    """Raise with the decisive lines if a run did not complete.

    Raises
    ------
    SolverMissingError, InterruptedRunError, RunError
        If the solver is not installed, if the run was stopped, or for any other reason.
    """
    kinds = {"not_installed": SolverMissingError, "interrupted": InterruptedRunError}
    for result in results:
        if result.status == "completed":
            continue
        where = f" (log: {result.log})" if result.log and str(result.log) not in result.message else ""
        text = f"{result.model} run {result.status.replace('_', ' ')}: {result.message}{where}"
        raise kinds.get(result.status, RunError)(text)


def load(folder: Path) -> RunData:
    """Read a completed model's run folder back: scene, model, result, and what was recorded.

    Raises
    ------
    ReadError
        If the folder is not one, or its files are damaged or of another plan.
    RunError
        If the run did not complete.
    """
    scene, kind, engine = read_model_folder(folder)
    result = read_result(folder)
    require_completed([result])
    for key, found, value in (("model", result.model, kind), ("engine", result.engine, engine)):
        if found != value:
            raise ReadError(f"{folder / RESULT}: {key} = {found}, expected {value} of this case; run it again")
    return read_run(scene, result)


def load_both(out: Path) -> tuple[RunData, RunData]:
    """Read the linear and the Hertz run of a case's run folder."""
    missing = [kind for kind in KINDS if not (out / kind).is_dir()]
    if missing:
        raise CaseFileError(f"{out}: no {missing[0]} run in it; expected the run folder of a case with both models")
    return load_pair(out / "linear", out / "hertz")


def load_pair(linear: Path, hertz: Path) -> tuple[RunData, RunData]:
    """Read a linear and a Hertz run from two folders.

    Raises
    ------
    InputError
        If one of them is of the other model.
    """
    runs = load(linear), load(hertz)
    for data, kind in zip(runs, KINDS, strict=True):
        if data.model.kind != kind:
            raise InputError(
                f"{data.result.folder} is a {data.model.kind} run: expected the folder of the linear run, then that of "
                "the Hertz run"
            )
    return runs


def compare_runs(linear: RunData, hertz: RunData) -> Comparison:
    """Compare a linear with a Hertz run of the same scene, as `load_pair` returns them."""
    return compare(complete(linear), complete(hertz))


def compare_case(out: Path, report: Path | None = None) -> tuple[Comparison, Path]:
    """Compare the linear and the Hertz run in ``out``; write the report (to OUT/report), return both."""
    comparison = compare_runs(*load_both(out))
    return comparison, report_on(comparison, report or out / REPORT)


def complete(data: RunData) -> RunData:
    """Add the exact motion and metrics of the same model, where they exist, and the predicted discretisation error."""
    if data.contacts is None:
        return data
    motion = exact_motion(data.model)
    return replace(
        data,
        motion=motion,
        exact=exact_metrics(data.model, motion),
        predicted=predicted_errors(data.model, data.contacts),
    )


def remarks(data: RunData) -> tuple[str, ...]:
    """Return what a user should know about a run that its numbers do not say: that nothing touched."""
    if data.contacts is None or data.contacts.contacts:
        return ()
    return (f"{data.model.kind}: {no_contact(data.model)}",)


def export(data: RunData, *, paraview: bool = False) -> None:
    """Write a run's numbers into its folder for other programs: tables, and frames for ParaView if asked for."""
    if data.contacts is not None:  # of signals the table is there since the run
        export_tables(data)
    if paraview:
        export_paraview(data)


def report_on(comparison: Comparison, folder: Path) -> Path:
    """Write the report of a comparison, with every table that its scene allows; returns the page's path."""
    runs = comparison.runs
    models: dict[str, Any] = {r.model.kind: r.model for r in runs}
    return write_report(
        comparison,
        folder,
        context=None if comparison.run.contacts is None else context_of(models),
        warnings=list(warnings_of(models)),
        provenance={r.model.kind: read_manifest(r.result.folder) for r in runs},
    )
