"""A bed's main job: scene -> models -> limits -> packing -> coupled runs -> series -> comparison -> report."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from kncal.bed.compare import BedComparison, BedRunData, compare_beds
from kncal.bed.limits import check_bed
from kncal.bed.model import BedModel
from kncal.bed.packing import packing
from kncal.bed.planning import plan_bed
from kncal.bed.report import write_bed_report
from kncal.bed.scene import BedScene
from kncal.bed.series import read_series, write_series_csv
from kncal.case_file import dump_case
from kncal.checks import Array, one_of, positive
from kncal.coupling.loop import Progress
from kncal.engines.base import RunResult
from kncal.engines.coupled import Coupled
from kncal.errors import CaseFileError, ReadError, SolverMissingError
from kncal.folder import (
    CASE,
    RESULT,
    SERIES,
    case_folder,
    read_manifest,
    read_model_folder,
    read_result,
    write_model_manifest,
    write_result,
)
from kncal.lock import locked
from kncal.model import KINDS
from kncal.workflow import require_completed

POSITIONS = "positions.npy"

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
    refused: dict[str, None] = {}
    for model in models.values():
        for finding in check_bed(model):
            if finding.level == "refuse":
                refused[finding.message] = None
    if refused:
        raise CaseFileError(f"{scene.name}: " + "; ".join(refused))
    return models


def warnings_of(models: Iterable[BedModel]) -> tuple[str, ...]:
    """Return what is to be minded about the runs, each text once: limits of the bed, and of its contacts."""
    texts: dict[str, None] = {}
    for model in models:
        texts |= {finding.message: None for finding in check_bed(model) if finding.level == "warn"}
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
) -> dict[str, RunResult]:
    """Run a bed with each model from the same packing, and stop at the first that does not complete.

    Every started run leaves its ``result.json``.

    Raises
    ------
    CaseFileError
        If a limit refuses the run; nothing is written then.
    RunError
        If the packing fails or the folder cannot be written.
    """
    if timeout is not None:
        positive("timeout", timeout, unit="s")
    engine = Coupled(transport)
    profile = engine.profile()
    if profile.program is None:
        raise SolverMissingError(profile.problem)
    models = plan_checked(scene, kinds)
    positions = start_positions(scene)
    results: dict[str, RunResult] = {}
    with case_folder(scene, out):
        for kind, model in models.items():
            folder = out / kind
            folder.mkdir()
            np.save(folder / POSITIONS, positions, allow_pickle=False)
            steps = model.couplings * model.steps_per_coupling
            write_model_manifest(model, folder, profile, [], steps=steps, t_end=model.couplings * model.coupling)
            results[kind] = _run(engine, model, folder, positions, timeout, progress_for, resume=False)
            if results[kind].status != "completed":
                break
    return results


def resume_bed(
    scene: BedScene,
    out: Path,
    *,
    transport: str = "auto",
    timeout: float | None = None,
    progress_for: ProgressFor | None = None,
) -> dict[str, RunResult]:
    """Go on with the unfinished models in ``out``, each from its last complete checkpoint, or from its start.

    Raises
    ------
    CaseFileError
        If ``out`` does not hold runs of this very case.
    """
    case = out / CASE
    if not case.is_file() or case.read_text(encoding="utf-8") != dump_case(scene):
        raise CaseFileError(f"{out}: no run of this very case to go on with (was the case changed?); run it anew")
    engine = Coupled(transport)
    results: dict[str, RunResult] = {}
    with locked(out):
        for kind, model in plan_checked(scene, KINDS).items():
            folder = out / kind
            if not (folder / POSITIONS).is_file():
                continue
            if (folder / RESULT).is_file():
                done = read_result(folder)
                if done.status == "completed":
                    results[kind] = done
                    continue
            positions = np.load(folder / POSITIONS, allow_pickle=False)
            results[kind] = _run(engine, model, folder, positions, timeout, progress_for, resume=True)
            if results[kind].status != "completed":
                break
    return results


def start_positions(scene: BedScene) -> Array:
    """Return the centres (n, 3) [m] at the start, the same for both models (the packing is cached by its inputs)."""
    if scene.particles.count == 0:
        return np.zeros((0, 3))
    logging.getLogger("kncal").info("packing %d particles", scene.particles.count)
    return packing(plan_bed(scene, ("linear",))["linear"])


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
    progress_for: ProgressFor | None,
    *,
    resume: bool,
) -> RunResult:
    (folder / RESULT).unlink(missing_ok=True)
    progress = progress_for(model.kind) if progress_for else None
    result = engine.run(model, folder, positions, timeout=timeout, progress=progress, resume=resume)
    if result.status == "completed":
        write_series_csv(folder / SERIES, read_series(folder / "series"))
    write_result(result)
    return result
