"""A bed's main job: scene -> models -> limits -> packing -> coupled runs -> series -> comparison -> report."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kncal.core.checks import Array, one_of, positive
from kncal.core.errors import CaseFileError, ReadError, RunError, SolverMissingError, failure_of
from kncal.core.files import write_json
from kncal.core.scratch import scratch
from kncal.core.shipped import cache_folder
from kncal.engines.base import Profile
from kncal.engines.checkpoint import GAS, PARTICLES, last_checkpoint
from kncal.engines.coupled import Coupled, check_bed_ranks
from kncal.engines.dpmfoam.case import write_case
from kncal.engines.liggghts.bed_deck import write_deck
from kncal.engines.loop import Progress, gas_setup
from kncal.observe.bed_compare import BedComparison, BedRunData, compare_beds
from kncal.record.outcome import RunResult
from kncal.record.series import read_series, series_reaches, write_series_csv
from kncal.report.bed_page import write_bed_report
from kncal.runs.folder import (
    PIECES,
    SERIES,
    case_folder,
    model_manifest,
    read_manifest,
    read_model_folder,
    read_result,
    write_result,
)
from kncal.runs.records import MANIFEST
from kncal.runs.resume import Tell, take_up
from kncal.runs.started import started
from kncal.runs.workflow import require_completed
from kncal.scene.bed_limits import findings_of
from kncal.scene.bed_model import BedModel
from kncal.scene.bed_planning import plan_bed
from kncal.scene.bed_scene import BedScene
from kncal.scene.model import KINDS
from kncal.scene.packing import packing, to_settle

POSITIONS = "positions.npy"

#: What `run_bed` asks a progress callback for besides the models: steps of the settling, in all as far as known.
PACKING = "packing"
#: Called for each model with its kind; returns the progress callback of that run.
ProgressFor = Callable[[str], Progress | None]


def plan_checked(scene: BedScene, kinds: Iterable[str]) -> dict[str, BedModel]:
    """Return the models of a bed, refused where a limit says so (`warnings_of` has the rest).

    Raises
    ------
    CaseFileError
        If a limit refuses the run, with every reason.
    """
    models = plan_bed(scene, [one_of("model", kind, KINDS) for kind in kinds])
    refused = dict.fromkeys(f.message for f in findings_of(models.values()) if f.level == "refuse")
    if refused:
        raise CaseFileError(f"{scene.name}: " + "; ".join(refused))
    return models


def warnings_of(models: Iterable[BedModel]) -> tuple[str, ...]:
    """Return what is to be minded about the runs, each text once: limits of the bed, and of its contacts."""
    models = tuple(models)
    texts = dict.fromkeys(finding.message for finding in findings_of(models) if finding.level == "warn")
    for model in models:
        for pair, contact in model.contacts.items():
            texts |= {f"{'–'.join(pair)}: {text}": None for text in contact.warnings.values()}
    return tuple(texts)


def run_bed(
    scene: BedScene,
    out: Path,
    kinds: Iterable[str] = KINDS,
    *,
    transport: str = "auto",
    timeout: float | None = None,
    progress_for: ProgressFor | None = None,
    anew: bool = False,
    tell: Tell | None = None,
    ranks: int = 1,
    oversubscribe: bool = False,
) -> dict[str, RunResult]:
    """Run a bed with each model from the same packing, and stop at the first that does not complete.

    A model whose completed run is in ``out``, of the same input by the same solvers, is not run again; one that was
    stopped goes on from its last complete checkpoint (``anew``: both start again). What else was there is moved to
    ``attempt-N``. ``tell`` is called with a sentence about each such model. Every started run leaves its
    ``result.json``.

    Raises
    ------
    CaseFileError
        If a limit refuses the run; nothing is written then.
    InputError
        If there are several ``ranks`` and the bed cannot use them (`kncal.engines.coupled.check_bed_ranks`).
    RunError
        If the packing fails or the folder cannot be written.
    """
    if timeout is not None:
        positive("timeout", timeout, unit="s")
    engine = Coupled(transport, ranks=ranks, oversubscribe=oversubscribe)
    check_bed_ranks(scene, ranks)
    profile = engine.profile()
    if profile.program is None:
        raise SolverMissingError(profile.problem)
    models = plan_checked(scene, kinds)
    positions = start_positions(scene, tell=tell, progress=progress_for(PACKING) if progress_for else None)
    results: dict[str, RunResult] = {}
    try:
        with case_folder(scene, out, keep=not anew, tell=tell) as lock:
            manifests = _manifests(models, profile, positions, ranks)
            found = take_up(out, manifests, checkpoints=_checkpoints(out, models), tell=tell)
            for kind, model in models.items():
                folder, earlier = out / kind, found[kind]
                if earlier.result is not None:
                    results[kind] = earlier.result
                    used = earlier.result.extra.get("transport")
                    if tell and transport not in ("auto", used) and used != "none":
                        tell(f"{kind}: that run used the {used} transport, which gives the same numbers")
                    continue
                if earlier.action == "run":
                    folder.mkdir()
                    np.save(folder / POSITIONS, positions, allow_pickle=False)
                    write_json(folder / MANIFEST, manifests[kind])
                progress = progress_for(kind) if progress_for else None
                resume = earlier.action == "go on"
                results[kind] = _run(engine, model, folder, positions, timeout, progress, resume=resume, lock=lock)
                if results[kind].status != "completed":
                    break
    except OSError as error:
        raise RunError(f"{error.filename or out}: {error.strerror or error}", failure_of(error)) from error
    return results


def _manifests(
    models: Mapping[str, BedModel], profile: Profile, positions: Array, ranks: int
) -> dict[str, dict[str, Any]]:
    """Return the manifests of runs from ``positions``; what both solvers will read is hashed, before they read it."""
    with scratch() as draft:
        for kind, model in models.items():
            _write_inputs(model, draft / kind, positions)
        return {
            kind: model_manifest(
                model,
                draft / kind,
                profile,
                [],
                steps=model.couplings * model.steps_per_coupling,
                t_end=model.couplings * model.coupling,
                ranks=ranks,
            )
            for kind, model in models.items()
        }


def _write_inputs(model: BedModel, folder: Path, positions: Array) -> None:
    folder.mkdir()
    np.save(folder / POSITIONS, positions, allow_pickle=False)
    if model.contacts and not model.scene.particles.frozen:
        (folder / PARTICLES).mkdir()
        write_deck(model, folder / PARTICLES, positions)
    if (setup := gas_setup(model)) is not None:
        write_case(setup, folder / GAS, end_time=setup.step, write_interval=1)


def _checkpoints(out: Path, models: Mapping[str, BedModel]) -> dict[str, str]:
    """Say where each unfinished model could go on: with a whole checkpoint, and the series up to it."""
    found = {kind: last_checkpoint(out / kind, model.couplings) for kind, model in models.items()}
    return {
        kind: f"coupling {checkpoint.coupling} of {models[kind].couplings}"
        for kind, checkpoint in found.items()
        if checkpoint is not None and series_reaches(out / kind / PIECES, checkpoint.coupling)
    }


def start_positions(scene: BedScene, *, tell: Tell | None = None, progress: Progress | None = None) -> Array:
    """Return the centres (n, 3) [m] at the start, the same for both models (the packing is cached by its inputs).

    ``tell``, ``progress``: see `kncal.scene.packing.packing`.
    """
    if scene.particles.count == 0:
        return np.zeros((0, 3))
    log = logging.getLogger("kncal")
    log.info("packing %d particles", scene.particles.count)
    try:
        kept = cache_folder() / "packings"
        kept.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        log.warning("settled packings cannot be kept (%s): each run settles its own", error)
        kept = None
    return packing(plan_bed(to_settle(scene), ("linear",))["linear"], kept, tell=tell, progress=progress)


def load_bed_run(folder: Path) -> BedRunData:
    """Read a completed run of a bed back.

    Raises
    ------
    ReadError
        If the folder is not one, or its files are damaged or of another plan.
    RunError
        If the run did not complete.
    """
    scene, kind, _ = read_model_folder(folder)
    if not isinstance(scene, BedScene):
        raise ReadError(f"{folder}: the run of a single contact, expected that of a bed")
    result = read_result(folder)
    require_completed([result])
    model = plan_bed(scene, (kind,))[kind]
    series = read_series(folder / "series")
    if len(series.t) != model.couplings:
        raise ReadError(f"{folder}: {len(series.t)} couplings, expected {model.couplings}; run the case again")
    return BedRunData(model=model, result=result, series=series)


def compare_bed(out: Path, report: Path) -> tuple[BedComparison, Path]:
    """Compare the linear and the Hertz run in ``out`` and write the report; returns both."""
    linear, hertz = load_bed_run(out / "linear"), load_bed_run(out / "hertz")
    comparison = compare_beds(linear, hertz)
    runs = (linear, hertz)
    page = write_bed_report(
        comparison,
        report,
        warnings=list(warnings_of(r.model for r in runs)),
        provenance={r.model.kind: read_manifest(r.result.folder) for r in runs},
    )
    return comparison, page


def _run(
    engine: Coupled,
    model: BedModel,
    folder: Path,
    positions: Array,
    timeout: float | None,
    progress: Progress | None,
    *,
    resume: bool,
    lock: int,
) -> RunResult:
    with started(folder):
        result = engine.run(
            model, folder, positions, timeout=timeout, progress=progress, resume=resume, pass_fds=(lock,)
        )
        if result.status == "completed":
            write_series_csv(folder / SERIES, read_series(folder / "series"))
        write_result(result)
    return result
