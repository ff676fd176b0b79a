"""Before and after a run of any scene: options and limits that refuse it, what it left read back."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from kncal.core.errors import CaseFileError, InputError, ReadError
from kncal.engines.base import read_frames
from kncal.observe.contacts import observe
from kncal.observe.run_data import RunData
from kncal.record.outcome import RunResult
from kncal.record.series import PIECES, read_series
from kncal.runs.records import RESULT
from kncal.scene.limits import findings_of
from kncal.scene.model import Plan
from kncal.scene.plan import plan
from kncal.scene.scene import Scene


def check_options(scene: Scene, *, engine: str = "liggghts", transport: str = "auto", repeat: int = 1) -> None:
    """Refuse an option that this scene would ignore.

    Raises
    ------
    InputError
        Naming it.
    """
    is_bed = scene.coupled
    given = {"engine": engine != "liggghts", "repeat": repeat != 1} if is_bed else {"transport": transport != "auto"}
    for name, is_given in given.items():
        if is_given:
            what = "a bed" if is_bed else "a case without gas"
            raise InputError(f"--{name} has no meaning for {what}: leave it out")


def plan_checked(scene: Scene, kinds: Iterable[str], *, beyond: bool = False) -> Mapping[str, Plan]:
    """Return the plans of a scene by kind, refused where a limit says so (the rest: `kncal.scene.limits.warnings_of`).

    ``beyond``: limits are not asked.

    Raises
    ------
    CaseFileError
        If a limit refuses the run, with every reason.
    """
    models = plan(scene, tuple(kinds))
    if beyond or not scene.coupled:
        return models
    refused = dict.fromkeys(f.message for _, f in findings_of(models.values()) if f.level == "refuse")
    if refused:
        raise CaseFileError(f"{scene.name}: " + "; ".join(refused))
    return models


def read_run(scene: Scene, result: RunResult) -> RunData:
    """Read what a completed run of ``scene`` left in its folder.

    Raises
    ------
    ReadError
        If its files are damaged, or of another plan.
    """
    folder = result.folder
    model = plan(scene, (result.model,))[result.model]
    # another machine's logarithm may differ in the last digit of dt
    for key, found, value, off in (("steps", result.steps, model.n_steps, 0.0), ("dt", result.dt, model.dt, 1e-12)):
        if not math.isclose(found, value, rel_tol=off):
            raise ReadError(f"{folder / RESULT}: {key} = {found}, expected {value} of this case; run it again")
    if model.couplings:
        series = read_series(folder / PIECES)
        if len(series.t) != model.couplings:
            raise ReadError(f"{folder}: {len(series.t)} couplings, expected {model.couplings}; run the case again")
        return RunData(model=model, result=result, signals=series)
    frames = read_frames(model, folder)
    samples = tuple(result.extra.get("cpu_samples", ()))
    return RunData(model=model, result=result, frames=frames, contacts=observe(model, frames), cpu_samples=samples)
