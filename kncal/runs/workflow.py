"""The main job in one place: scene -> models -> rendered folders -> runs -> observations."""

from __future__ import annotations

import logging
import math
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
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
from kncal.engines.base import Engine, Progress, run_result
from kncal.observe.compare import Comparison, RunData
from kncal.observe.contacts import observe
from kncal.record.outcome import RunResult
from kncal.runs.folder import (
    case_folder,
    model_manifest,
    read_manifest,
    read_model_folder,
    read_result,
    write_result,
)
from kncal.runs.records import MANIFEST, RESULT
from kncal.runs.resume import Tell, take_up
from kncal.runs.started import started
from kncal.scene.bed_scene import BedScene
from kncal.scene.model import KINDS, Model
from kncal.scene.plan import plan
from kncal.scene.scene import Scene

#: Engines by name; liggghts-hooke lets LIGGGHTS find the stiffness itself (cases with method strain_energy only).
ENGINES = ("liggghts", "builtin", "liggghts-hooke")

#: Called for each model with its kind; returns the progress callback of that run.
ProgressFor = Callable[[str], Progress | None]


def get_engine(name: str, *, ranks: int = 1, oversubscribe: bool = False) -> Engine:
    """Return an engine by name, for runs on ``ranks`` ranks (see `kncal.core.mpi.check_ranks`).

    Raises
    ------
    InputError
        For an unknown name, or a number of ranks that cannot be.
    """
    one_of("engine", name, ENGINES)
    if name == "builtin":
        if ranks != 1:
            raise InputError(f"ranks = {ranks}: the engine builtin computes in kncal's own process; expected 1")
        from kncal.engines.builtin import Builtin

        return Builtin()
    from kncal.engines.liggghts.batch import Liggghts

    style = "hooke" if name == "liggghts-hooke" else "hooke/stiffness"
    return Liggghts(style, ranks=ranks, oversubscribe=oversubscribe)


def render_case(
    scene: Scene, engine: Engine, out: Path, kinds: Iterable[str] = KINDS, *, tell: Tell | None = None
) -> Mapping[str, Model]:
    """Write the case folder: one subfolder with solver input per model, manifests, the case itself.

    Returns the models by kind. Whatever can be refused is refused before anything is written or moved; what an earlier
    run left in ``out`` is moved to ``attempt-N``.
    """
    with _rendered(scene, engine, out, kinds, anew=True, repeat=1, tell=tell) as (models, _, _):
        return models


@contextmanager
def _rendered(
    scene: Scene, engine: Engine, out: Path, kinds: Iterable[str], *, anew: bool, repeat: int, tell: Tell | None
) -> Iterator[tuple[Mapping[str, Model], dict[str, RunResult], int]]:
    """Render into ``out`` and own it: the models, finished results that are kept, the lock for the solvers."""
    kinds = tuple(one_of("model", kind, KINDS) for kind in kinds)
    models = plan(scene, kinds)
    profile = engine.profile()
    with scratch() as draft:
        for kind, model in models.items():
            (draft / kind).mkdir()
            engine.render(model, draft / kind)
        with case_folder(scene, out, keep=not anew, tell=tell) as lock:
            manifests = {
                kind: model_manifest(
                    model,
                    draft / kind,
                    profile,
                    list(engine.command(model)),
                    steps=model.n_steps,
                    t_end=model.t_end,
                    ranks=engine.ranks,
                )
                for kind, model in models.items()
            }
            found = take_up(out, manifests, repeat=repeat, tell=tell)
            kept = {kind: earlier.result for kind, earlier in found.items() if earlier.result is not None}
            for kind, manifest in manifests.items():
                if kind not in kept:
                    shutil.copytree(draft / kind, out / kind)
                    write_json(out / kind / MANIFEST, manifest)
            yield models, kept, lock


def run_case(
    scene: Scene,
    engine: Engine,
    out: Path,
    kinds: Iterable[str] = KINDS,
    *,
    timeout: float | None = None,
    progress_for: ProgressFor | None = None,
    repeat: int = 1,
    anew: bool = False,
    tell: Tell | None = None,
) -> dict[str, RunResult]:
    """Render and run the models, and stop at the first that does not complete.

    A model whose completed run is in ``out``, of the same input by the same solver, is not run again (``anew``: it is).
    Whatever else was there is moved to ``attempt-N``. ``tell`` is called with a sentence about each such model.

    With ``repeat`` > 1 the models are run in turn that many times (A B A B ...), so that their CPU times are comparable
    on a busy machine; the frames kept are the last run's, the CPU seconds of all stand in ``extra["cpu_samples"]``.
    Every started run leaves its ``result.json``; the caller looks at the status (or calls `require_completed`).

    Raises
    ------
    InputError
        If the timeout or the number of repeats is not positive, or a kind is unknown.
    SolverMissingError
        If there is no solver; nothing is written then.
    RunError
        If the folder cannot be written.
    """
    in_range("repeat", repeat, 1, 1e6)
    if timeout is not None:
        positive("timeout", timeout, unit="s")
    profile = engine.profile()
    if profile.program is None:
        raise SolverMissingError(profile.problem)
    if profile.warning:
        logging.getLogger("kncal").warning("kncal: %s", profile.warning)
    results: dict[str, RunResult] = {}
    samples: dict[str, list[float]] = {kind: [] for kind in KINDS}
    try:
        with _rendered(scene, engine, out, kinds, anew=anew, repeat=repeat, tell=tell) as (models, kept, lock):
            results |= kept
            for kind, model in [item for item in models.items() if item[0] not in kept] * repeat:
                folder, progress = out / kind, progress_for(kind) if progress_for else None
                with started(folder):  # a result of an earlier repeat would vouch for what this one is writing
                    try:
                        result = engine.run(model, folder, timeout=timeout, progress=progress, pass_fds=(lock,))
                    except KeyboardInterrupt:
                        result = run_result(engine.name, model, folder, "interrupted", message="stopped by the user")
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


def load_run(folder: Path) -> RunData:
    """Read a completed model's run folder back: scene, model, frames, observations.

    Raises
    ------
    ReadError
        If the folder is not one, or its files are damaged.
    RunError
        If the run did not complete.
    """
    scene, kind, engine_name = read_model_folder(folder)
    if isinstance(scene, BedScene):
        raise ReadError(f"{folder}: the run of a bed, expected that of a single contact")
    result = read_result(folder)
    require_completed([result])
    model = plan(scene, (kind,))[kind]
    expected: dict[str, Any] = {"model": kind, "engine": engine_name, "steps": model.n_steps, "dt": model.dt}
    for key, value in expected.items():
        found = getattr(result, key)
        # another machine's logarithm may differ in the last digit of dt
        if not (math.isclose(found, value, rel_tol=1e-12) if key == "dt" else found == value):
            raise ReadError(f"{folder / RESULT}: {key} = {found}, expected {value} of this case; run it again")
    trajectory = get_engine(engine_name).read(model, folder)
    return RunData(
        model=model,
        result=result,
        trajectory=trajectory,
        observations=observe(model, trajectory),
        cpu_samples=tuple(result.extra.get("cpu_samples", ())),
    )


def load_both(out: Path) -> tuple[RunData, RunData]:
    """Read the linear and the hertz run of a case's run folder."""
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
    runs = load_run(linear), load_run(hertz)
    for data, kind in zip(runs, KINDS, strict=True):
        if data.model.kind != kind:
            raise InputError(
                f"{data.result.folder} is a {data.model.kind} run: expected the folder of the linear run, then that of "
                "the Hertz run"
            )
    return runs


def complete(data: RunData) -> RunData:
    """Add the exact motion and metrics of the same model, where they exist, and the predicted discretisation error."""
    from kncal.observe.truth import exact_metrics, exact_motion, predicted_errors

    motion = exact_motion(data.model)
    return replace(
        data,
        motion=motion,
        exact=exact_metrics(data.model, motion),
        predicted=predicted_errors(data.model, data.observations),
    )


def report_on(comparison: Comparison, folder: Path) -> Path:
    """Write the report of a comparison, with every table that its scene allows; returns the page's path."""
    import pandas as pd

    from kncal.report.overview import error_table, kn_curves, method_table
    from kncal.report.page import write_report
    from kncal.scene.needs import decide
    from kncal.scene.plan import pair_choice, pair_of

    scene = comparison.hertz.model.scene
    a, b = scene.body_pairs()[0]
    e_n, _, v_0, _ = pair_choice(scene, a, b)
    table, curves = pd.DataFrame(), {}
    if v_0 is not None:
        law, end, pair = scene.contact.law, scene.contact.end, pair_of(a, b)
        table = method_table(pair, v_0=v_0, e_n=e_n, law=law, end=end, options=scene.contact.method_options)
        curves = kn_curves(pair, v_0=v_0, e_n=e_n, law=law, end=end)
    models = {"linear": comparison.linear.model, "hertz": comparison.hertz.model}
    runs = (comparison.linear, comparison.hertz)
    return write_report(
        comparison,
        folder,
        calibration_table=table,
        kn_curves=curves,
        error_table=error_table(models),
        needs_table=decide(scene).to_frame(),
        provenance={r.model.kind: read_manifest(r.result.folder) for r in runs},
    )
