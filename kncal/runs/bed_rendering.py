"""A bed as solver input that is read and run by hand: per model LIGGGHTS' deck and the case of DPMFoam.

What kncal adds in a run, the exchange between the two, is not in it.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable
from pathlib import Path

from kncal.core.checks import Array
from kncal.core.mpi import check_ranks
from kncal.core.scratch import scratch
from kncal.core.shipped import folder as shipped_folder
from kncal.core.templating import render
from kncal.engines.checkpoint import GAS, PARTICLES
from kncal.engines.coupled import Coupled
from kncal.engines.dpmfoam.case import write_case
from kncal.engines.liggghts.bed_deck import DATA, DECK, write_deck
from kncal.engines.loop import Progress, gas_setup
from kncal.record.liggghts_log import END_MARKER
from kncal.runs.bed_workflow import plan_checked, start_positions
from kncal.runs.folder import case_folder, write_model_manifest
from kncal.scene.bed_model import BedModel
from kncal.scene.bed_scene import BedScene
from kncal.scene.model import KINDS

ALLRUN, README = "Allrun", "README.txt"


def render_bed(
    scene: BedScene,
    out: Path,
    kinds: Iterable[str] = KINDS,
    *,
    ranks: int = 1,
    oversubscribe: bool = False,
    tell: Callable[[str], None] | None = None,
    progress: Progress | None = None,
) -> dict[str, BedModel]:
    """Write the case folder of a bed: per model ``particles/`` (LIGGGHTS), ``gas/`` (DPMFoam), README.txt, Allrun.

    A settled packing is made by LIGGGHTS for it. With several ``ranks``, ``gas/Allrun`` runs on that many. Returns the
    models by kind. Whatever can be refused is refused before anything is written or moved. ``tell`` is called with a
    sentence about what is done, ``progress`` while the packing settles (see `kncal.scene.packing.packing`).

    Raises
    ------
    CaseFileError
        If a limit refuses the bed.
    RenderError
        If a solver cannot simulate it, or ``out`` holds other things.
    RunError
        If the packing fails (SolverMissingError: LIGGGHTS is not installed).
    """
    check_ranks(ranks, oversubscribe=oversubscribe)
    models = plan_checked(scene, kinds)
    profile = Coupled("restart").profile()
    positions = start_positions(scene, tell=tell, progress=progress)
    with scratch() as draft:
        for kind, model in models.items():
            _write(model, draft / kind, positions, ranks, oversubscribe)
        with case_folder(scene, out, tell=tell):
            for kind, model in models.items():
                shutil.copytree(draft / kind, out / kind)
                steps = model.couplings * model.steps_per_coupling
                t_end = model.couplings * model.coupling
                write_model_manifest(model, out / kind, profile, [f"./{ALLRUN}"], steps=steps, t_end=t_end, ranks=ranks)
    return models


def _write(model: BedModel, folder: Path, positions: Array, ranks: int, oversubscribe: bool) -> None:
    folder.mkdir()
    scene, setup = model.scene, gas_setup(model)
    moving = scene.particles.count > 0 and not scene.particles.frozen
    end_time = model.couplings * model.coupling
    context: dict[str, object] = {
        "scene": scene.name,
        "kind": model.kind,
        "particles": moving,
        "gas": setup is not None,
        "jet": setup is not None and setup.jet is not None,
        "ramp": scene.gas is not None and bool(scene.gas.ramp),
        "deck": DECK,
        "data": DATA,
        "dt": model.dt,
        "steps": model.couplings * model.steps_per_coupling,
        "steps_per_coupling": model.steps_per_coupling,
        "couplings": model.couplings,
        "gas_step": model.gas_step,
        "gas_steps": model.gas_steps,
        "end_time": end_time,
        "end_marker": END_MARKER,
    }
    templates = shipped_folder("templates") / "bed"
    if moving:
        (folder / PARTICLES).mkdir()
        write_deck(model, folder / PARTICLES, positions)
        _script(folder / PARTICLES / ALLRUN, render(templates, f"{ALLRUN}.particles.j2", context))
    if setup is not None:
        write_case(
            setup,
            folder / GAS,
            end_time=end_time,
            write_interval=model.frames_every * model.gas_steps,
            ranks=ranks,
            oversubscribe=oversubscribe,
        )
    _script(folder / ALLRUN, render(templates, f"{ALLRUN}.j2", context))
    (folder / README).write_text(render(templates, f"{README}.j2", context), encoding="utf-8")


def _script(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
    path.chmod(0o755)
