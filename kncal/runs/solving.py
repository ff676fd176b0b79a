"""How a scene is solved: by an engine for contacts or, with gas, by the coupled one. Only this module asks which."""

from __future__ import annotations

import logging
import math
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from kncal.core.checks import Array, one_of
from kncal.core.errors import CaseFileError, InputError, ReadError
from kncal.core.shipped import cache_folder
from kncal.core.shipped import folder as shipped_folder
from kncal.core.templating import render
from kncal.engines.base import Engine, Progress, Tell
from kncal.engines.checkpoint import GAS, PARTICLES, last_checkpoint
from kncal.engines.coupled import Coupled, check_bed_ranks
from kncal.engines.dpmfoam.case import write_case
from kncal.engines.liggghts.deck import DATA, DECK, bed_deck, write_deck
from kncal.engines.loop import gas_setup
from kncal.engines.settle import packing, to_settle
from kncal.observe.contacts import observe
from kncal.observe.run_data import RunData
from kncal.record.liggghts_log import END_MARKER
from kncal.record.outcome import RunResult
from kncal.record.series import read_series, series_reaches, write_series_csv
from kncal.runs.folder import PIECES, SERIES, Schedule
from kncal.runs.records import RESULT
from kncal.scene.bed_scene import BedScene
from kncal.scene.limits import findings_of
from kncal.scene.model import BedModel, Model
from kncal.scene.plan import first_impact_speed, plan
from kncal.scene.scene import Scene

#: Engines of cases without gas; liggghts-hooke lets LIGGGHTS find the stiffness itself (method strain_energy only).
ENGINES = ("liggghts", "builtin", "liggghts-hooke")
ALLRUN, README, POSITIONS = "Allrun", "README.txt", "positions.npy"
#: What a progress callback is asked for besides the models: steps of the settling, in all as far as known.
PACKING = "packing"

S = TypeVar("S", bound=Scene | BedScene)


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


def check_options(
    scene: Scene | BedScene, *, engine: str = "liggghts", transport: str = "auto", repeat: int = 1
) -> None:
    """Refuse an option that this scene would ignore.

    Raises
    ------
    InputError
        Naming it.
    """
    is_bed = isinstance(scene, BedScene)
    given = {"engine": engine != "liggghts", "repeat": repeat != 1} if is_bed else {"transport": transport != "auto"}
    for name, is_given in given.items():
        if is_given:
            what = "a bed" if is_bed else "a case without gas"
            raise InputError(f"--{name} has no meaning for {what}: leave it out")


def engine_for(
    scene: Scene | BedScene,
    engine: str = "liggghts",
    transport: str = "auto",
    *,
    ranks: int = 1,
    oversubscribe: bool = False,
) -> Engine | Coupled:
    """Return the engine that runs a scene: of a bed the coupled one, with ``transport``; else the one of that name.

    Raises
    ------
    InputError
        For an unknown name, or a number of ranks that cannot be.
    """
    if isinstance(scene, BedScene):
        return Coupled(transport, ranks=ranks, oversubscribe=oversubscribe)
    return get_engine(engine, ranks=ranks, oversubscribe=oversubscribe)


def plan_checked(scene: Scene | BedScene, kinds: Iterable[str]) -> Mapping[str, Any]:
    """Return the plans of a scene by kind, refused where a limit says so (the rest: `kncal.scene.limits.warnings_of`).

    Raises
    ------
    CaseFileError
        If a limit refuses the run, with every reason.
    """
    if not isinstance(scene, BedScene):
        return plan(scene, tuple(kinds))
    models = plan(scene, tuple(kinds))
    refused = dict.fromkeys(f.message for _, f in findings_of(models.values()) if f.level == "refuse")
    if refused:
        raise CaseFileError(f"{scene.name}: " + "; ".join(refused))
    return models


def guessed_speed(scene: Scene | BedScene) -> float | None:
    """Return the speed of the first impact [m/s] as far as the start of the scene tells it, or None."""
    return None if isinstance(scene, BedScene) else first_impact_speed(scene)


def trial(scene: S, v_0: float, time: float | None) -> S:
    """Return the scene calibrated at ``v_0`` [m/s], which ends at ``time`` [s] (None: as it did)."""
    contact = replace(scene.contact, v_0=v_0, measured=None)
    if isinstance(scene, BedScene):
        end = scene.run.end_time if time is None else time
        discard = scene.run.discard
        kept = discard if discard is not None and discard < 0.5 * end else None
        return replace(scene, contact=contact, run=replace(scene.run, end_time=end, discard=kept, frames_every=end))
    run = scene.run if time is None else replace(scene.run, until_time=time, until_bounces=None)
    return replace(scene, contact=contact, run=run)


def schedule(model: Any) -> Schedule:
    """Return how long the run of a model is."""
    if model.couplings:
        steps, t_end = model.couplings * model.steps_per_coupling, model.couplings * model.coupling
        return Schedule(steps=steps, dt=model.dt, t_end=t_end, interval=model.coupling)
    return Schedule(steps=model.n_steps, dt=model.dt, t_end=model.t_end)


@dataclass
class Contacts:
    """Runs of a scene of few bodies: the input that an engine renders is all there is to a run."""

    engine: Engine

    def command(self, model: Model, *, by_hand: bool) -> list[str]:
        """Return the command of the manifest."""
        del by_hand
        return list(self.engine.command(model))

    def prepare(self, tell: Tell | None, progress: Progress | None) -> None:
        """Do what all models need before anything is written."""

    def write(self, model: Model, folder: Path, *, by_hand: bool) -> None:
        """Write into ``folder``, which is new, what the solvers read; ``by_hand``: also what a person needs."""
        del by_hand
        folder.mkdir()
        self.engine.render(model, folder)

    def place(self, draft: Path, folder: Path) -> None:
        """Make the run's folder from what `write` wrote."""
        shutil.copytree(draft, folder)

    def checkpoint(self, model: Model, folder: Path) -> str:
        """Say where an unfinished run can resume; empty: nowhere."""
        del model, folder
        return ""

    def run(
        self,
        model: Model,
        folder: Path,
        *,
        timeout: float | None,
        progress: Progress | None,
        resume: bool,
        pass_fds: tuple[int, ...],
    ) -> RunResult:
        """Run a model in its folder; never raises for a failed run, the status says so."""
        del resume
        return self.engine.run(model, folder, timeout=timeout, progress=progress, pass_fds=pass_fds)


@dataclass
class Bed:
    """Runs of a bed: all models start from the same positions, gas and particles exchange through kncal."""

    scene: BedScene
    engine: Coupled
    positions: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def command(self, model: BedModel, *, by_hand: bool) -> list[str]:
        """Return the command of the manifest."""
        del model
        return [f"./{ALLRUN}"] if by_hand else []

    def prepare(self, tell: Tell | None, progress: Progress | None) -> None:
        """Settle the particles, or take them from the cache."""
        self.positions = start_positions(self.scene, tell=tell, progress=progress)

    def write(self, model: BedModel, folder: Path, *, by_hand: bool) -> None:
        """Write into ``folder``, which is new, what the solvers read; ``by_hand``: also what a person needs."""
        folder.mkdir()
        if by_hand:
            _write_by_hand(model, folder, self.positions, self.engine)
            return
        np.save(folder / POSITIONS, self.positions, allow_pickle=False)
        if model.contacts and not model.scene.particles.frozen:
            (folder / PARTICLES).mkdir()
            write_deck(bed_deck(model, self.positions), folder / PARTICLES)
        if (setup := gas_setup(model)) is not None:
            write_case(setup, folder / GAS, end_time=setup.step, write_interval=1)

    def place(self, draft: Path, folder: Path) -> None:
        """Make the run's folder; the engine writes what the solvers read when they start."""
        folder.mkdir()
        shutil.copyfile(draft / POSITIONS, folder / POSITIONS)

    def checkpoint(self, model: BedModel, folder: Path) -> str:
        """Say where an unfinished run can resume: at a whole checkpoint, with the series up to it; empty: nowhere."""
        found = last_checkpoint(folder, model.couplings)
        if found is None or not series_reaches(folder / PIECES, found.coupling):
            return ""
        return f"coupling {found.coupling} of {model.couplings}"

    def run(
        self,
        model: BedModel,
        folder: Path,
        *,
        timeout: float | None,
        progress: Progress | None,
        resume: bool,
        pass_fds: tuple[int, ...],
    ) -> RunResult:
        """Run a model in its folder; never raises for a failed run, the status says so."""
        result = self.engine.run(
            model, folder, self.positions, timeout=timeout, progress=progress, resume=resume, pass_fds=pass_fds
        )
        if result.status == "completed":
            write_series_csv(folder / SERIES, read_series(folder / PIECES))
        return result


def solving(scene: Scene | BedScene, engine: Engine | Coupled, *, by_hand: bool = False) -> Contacts | Bed:
    """Return how ``engine`` solves the scene; ``by_hand``: it is only rendered.

    Raises
    ------
    InputError
        If it cannot.
    """
    if isinstance(scene, BedScene):
        if isinstance(engine, Coupled):
            if not by_hand:
                check_bed_ranks(scene, engine.ranks)
            return Bed(scene, engine)
    elif not isinstance(engine, Coupled):
        return Contacts(engine)
    raise InputError(f"{scene.name}: the engine {engine.name} cannot run it: see `kncal.runs.solving.engine_for`")


def start_positions(scene: BedScene, *, tell: Tell | None = None, progress: Progress | None = None) -> Array:
    """Return the centres (n, 3) [m] at the start, the same for both models (the packing is cached by its inputs).

    ``tell``, ``progress``: see `kncal.engines.settle.packing`.
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
    return packing(plan(to_settle(scene), ("linear",))["linear"], kept, tell=tell, progress=progress)


def read_run(scene: Scene | BedScene, result: RunResult) -> RunData:
    """Read what a completed run of ``scene`` left in its folder.

    Raises
    ------
    ReadError
        If its files are damaged, or of another plan.
    """
    folder, kind = result.folder, result.model
    if isinstance(scene, BedScene):
        model = plan(scene, (kind,))[kind]
        series = read_series(folder / PIECES)
        if len(series.t) != model.couplings:
            raise ReadError(f"{folder}: {len(series.t)} couplings, expected {model.couplings}; run the case again")
        return RunData(model=model, result=result, signals=series)
    planned = plan(scene, (kind,))[kind]
    # another machine's logarithm may differ in the last digit of dt
    for key, found, value, off in (("steps", result.steps, planned.n_steps, 0.0), ("dt", result.dt, planned.dt, 1e-12)):
        if not math.isclose(found, value, rel_tol=off):
            raise ReadError(f"{folder / RESULT}: {key} = {found}, expected {value} of this case; run it again")
    trajectory = get_engine(result.engine).read(planned, folder)
    return RunData(
        model=planned,
        result=result,
        frames=trajectory,
        contacts=observe(planned, trajectory),
        cpu_samples=tuple(result.extra.get("cpu_samples", ())),
    )


def _write_by_hand(model: BedModel, folder: Path, positions: Array, engine: Coupled) -> None:
    """Write what runs by hand: each side alone; the exchange between the two, which kncal makes, is not in it."""
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
        steps = model.couplings * model.steps_per_coupling
        write_deck(bed_deck(model, positions), folder / PARTICLES, steps=steps)
    if setup is not None:
        write_case(
            setup,
            folder / GAS,
            end_time=end_time,
            write_interval=model.frames_every * model.gas_steps,
            ranks=engine.ranks,
            oversubscribe=engine.oversubscribe,
        )
    _script(folder / ALLRUN, render(templates, f"{ALLRUN}.j2", context))
    (folder / README).write_text(render(templates, f"{README}.j2", context), encoding="utf-8")


def _script(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
    path.chmod(0o755)
