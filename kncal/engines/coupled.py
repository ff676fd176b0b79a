"""The engine coupled: LIGGGHTS and DPMFoam together; it renders what each needs, and starts both for the one loop."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from kncal.core.checks import Array, one_of
from kncal.core.errors import InputError, ReadError, RunError
from kncal.core.installed import found_once
from kncal.core.mpi import MISSING as NO_MPIRUN
from kncal.core.mpi import MPIRUN, check_ranks
from kncal.core.shipped import folder as shipped_folder
from kncal.core.templating import render
from kncal.engines.base import (
    Engine,
    GasSolver,
    ParticleSolver,
    Profile,
    Progress,
    Tell,
    gas_setup,
    guarded,
)
from kncal.engines.checkpoint import GAS, PARTICLES, last_checkpoint
from kncal.engines.dpmfoam.adapter_build import AdapterError, find
from kncal.engines.dpmfoam.case import write_case
from kncal.engines.dpmfoam.decomposed import divisions as check_divisions
from kncal.engines.dpmfoam.installed import look as look_for_openfoam
from kncal.engines.dpmfoam.live import LiveGas
from kncal.engines.dpmfoam.programs import SOLVER
from kncal.engines.dpmfoam.restart import RestartGas
from kncal.engines.drive import drive
from kncal.engines.liggghts.batch import PROGRAM
from kncal.engines.liggghts.deck import DATA, DECK, bed_deck, write_deck
from kncal.engines.liggghts.installed import look as look_for_liggghts
from kncal.engines.liggghts.library import LiggghtsDem
from kncal.engines.liggghts.shared import histogram_edges
from kncal.engines.settle import start_positions
from kncal.record.liggghts_log import END_MARKER
from kncal.record.outcome import RunResult
from kncal.record.series import PIECES, SERIES, read_series, series_reaches, write_series_csv
from kncal.record.steps import ParticleState
from kncal.scene.model import Plan
from kncal.scene.placement import Start
from kncal.scene.scene import Scene

TRANSPORTS = ("auto", "live", "restart")
ALLRUN, README, POSITIONS = "Allrun", "README.txt", "positions.npy"


def choose_transport(wanted: str) -> tuple[str, Path | None]:
    """Return (transport, adapter library): "auto" is live where the adapter is built, else restart.

    Raises
    ------
    InputError
        For an unknown name.
    AdapterError
        If live is asked for and the adapter is not built.
    """
    one_of("transport", wanted, TRANSPORTS)
    if wanted == "restart":
        return wanted, None
    library = find()
    if library is None and wanted == "live":
        raise AdapterError(
            "the adapter of the live transport is not built: kncal adapter build, or --transport restart"
        )
    return ("live", library) if library is not None else ("restart", None)


def check_bed_ranks(scene: Scene, ranks: int) -> None:
    """Refuse several ranks where gas moves particles, where nothing moves, or where there are not as many parts to cut.

    Raises
    ------
    InputError
        With the reason.
    """
    if ranks == 1:
        return
    if scene.gas is None:
        if not _moves(scene):
            raise InputError(f"ranks = {ranks}: nothing moves in {scene.name}, so no work to share: expected 1")
        return
    if _moves(scene):
        raise InputError(
            f"ranks = {ranks}: the particles of {scene.name} move, and such a bed runs on one rank: gas and particles "
            "exchange everything through one process after every interval. Expected 1; several cases side by side "
            "(kncal sweep) use all cores"
        )
    check_divisions(scene.cells, ranks)


def _moves(scene: Scene) -> bool:
    return scene.number > 0 and not scene.frozen


class Still:
    """Particles that do not move, or none: a `kncal.engines.base.ParticleSolver` without a solver."""

    cpu_seconds = 0.0

    def __init__(self, start: Start, diameter: float) -> None:
        self.histogram_edges, self.impact_edges = histogram_edges(diameter), np.zeros(0)
        self.walls: tuple[str, ...] = ()
        self._state = ParticleState(
            start.x, np.zeros_like(start.x), np.zeros_like(start.x), start.kind.astype(np.int64)
        )

    def state(self) -> ParticleState:
        """Return the particles."""
        return self._state

    def run(self, steps: int, force: Array | None) -> None:
        """Leave everything as it is."""

    def end_interval(self, number: int) -> None:
        """Leave everything as it is."""

    def save(self, folder: Path) -> None:
        """Write nothing: where they are stands in the run folder."""

    def close(self) -> None:
        """End nothing."""


class Coupled(Engine):
    """One scene by Debian's LIGGGHTS and OpenFOAM.

    Parameters
    ----------
    transport : "auto", "live" or "restart"
    ranks : int
        Processes that share the particles of a scene without gas, or the gas of a bed whose particles do not move
        (see `check_bed_ranks`).
    oversubscribe : bool
        Allow more ranks than cores.
    gas : bool
        Whether the scenes have gas; without, OpenFOAM is not needed.

    Raises
    ------
    InputError
        For several ranks with the transport live, or a number of them that `kncal.core.mpi.check_ranks` refuses.
    """

    name = "coupled"
    written_by_run = (GAS, PARTICLES)

    def __init__(
        self, transport: str = "auto", *, ranks: int = 1, oversubscribe: bool = False, gas: bool = True
    ) -> None:
        self._has_gas = gas
        self.ranks, self.oversubscribe = check_ranks(ranks, oversubscribe=oversubscribe), oversubscribe
        if ranks > 1 and transport == "live":
            raise InputError(f"transport = 'live' with ranks = {ranks}: live has one gas solver; expected 'restart'")
        self.transport, self._library = choose_transport("restart" if ranks > 1 else transport)

    def profile(self) -> Profile:
        """Look for both solvers on this machine."""
        liggghts, openfoam = found_once(look_for_liggghts, "liggghts"), found_once(look_for_openfoam, SOLVER)
        needed = (liggghts, openfoam) if self._has_gas else (liggghts,)
        missing = [f"{f.name} (found: {f.found}; {f.hint})" for f in needed if not f.ok]
        missing += [NO_MPIRUN] if self.ranks > 1 and shutil.which(MPIRUN) is None else []
        program = shutil.which(SOLVER if self._has_gas else PROGRAM)
        return Profile(
            engine=self.name,
            program=None if missing or program is None else Path(program),
            version=f"LIGGGHTS {liggghts.found}" + (f"; OpenFOAM {openfoam.found}" if self._has_gas else ""),
            problem=""
            if not missing
            else f"{'a coupled bed' if self._has_gas else 'it'} needs " + " and ".join(missing),
        )

    def check(self, scene: Scene, *, by_hand: bool = False) -> None:
        """Refuse a scene that is not one of gas and many particles, or that cannot run on so many ranks."""
        if not scene.coupled:
            raise InputError(f"{scene.name}: the engine {self.name} is for beds; expected liggghts or builtin")
        if not by_hand:
            check_bed_ranks(scene, self.ranks)

    def start(self, scene: Scene, *, tell: Tell | None = None, progress: Progress | None = None) -> Start:
        """Settle the particles, or take them from the cache; see `kncal.engines.settle.start_positions`."""
        return start_positions(scene, tell=tell, progress=progress)

    def command(self, plan: Plan, *, by_hand: bool = False) -> tuple[str, ...]:
        """Return what runs each side by hand; nothing runs both."""
        return (f"./{ALLRUN}",) if by_hand else ()

    def render(self, plan: Plan, folder: Path, *, start: Start | None = None, by_hand: bool = False) -> None:
        """Write the input of both solvers.

        By hand each side runs alone; the exchange between the two, which kncal makes, is not in it.

        Raises
        ------
        RenderError
            If a solver cannot simulate the plan.
        """
        given = _given(start)
        if not by_hand:
            np.save(folder / POSITIONS, given.x, allow_pickle=False)
        if _moves(plan.scene):
            (folder / PARTICLES).mkdir()
            alone = by_hand and plan.scene.run.coupling is None
            write_deck(bed_deck(plan, given, by_hand=alone), folder / PARTICLES, steps=plan.n_steps if by_hand else 0)
        if (setup := gas_setup(plan)) is not None:
            case = folder / GAS
            if by_hand:
                interval = plan.frames_every * plan.gas_steps
                write_case(
                    setup,
                    case,
                    end_time=plan.t_end,
                    write_interval=interval,
                    ranks=self.ranks,
                    oversubscribe=self.oversubscribe,
                )
            else:
                write_case(setup, case, end_time=setup.step)
        if by_hand:
            _write_scripts(plan, folder)

    def resumes_at(self, plan: Plan, folder: Path) -> str:
        """Say where an unfinished run can resume: at a whole checkpoint, with the series up to it; empty: nowhere."""
        found = last_checkpoint(folder, plan.couplings)
        if found is None or not series_reaches(folder / PIECES, found.coupling):
            return ""
        return f"coupling {found.coupling} of {plan.couplings}"

    def run(
        self,
        plan: Plan,
        folder: Path,
        *,
        start: Start | None = None,
        timeout: float | None = None,
        progress: Progress | None = None,
        resume: bool = False,
        pass_fds: Sequence[int] = (),
    ) -> RunResult:
        """Run ``plan`` in ``folder``; never raises for a failed run, the status says so.

        With ``resume`` the run goes on from its last complete checkpoint (from the start if there is none).
        """
        transport = {"transport": self.transport if plan.scene.drag else "none"}

        def work() -> Mapping[str, Any]:
            checkpoint = last_checkpoint(folder, plan.couplings) if resume else None
            first, state, before = 0, None, None
            if checkpoint is not None:
                first, state, before = checkpoint.coupling, checkpoint.path, checkpoint.cost
            for name in (GAS, PARTICLES):
                _set_aside(folder / name)
            with ExitStack() as sides:
                if (gas := self._gas(plan, folder, pass_fds)) is not None:
                    sides.enter_context(_closing(gas))
                    if state is not None:
                        gas.load(state / GAS)
                particles = self._particles(plan, folder, _given(start), first, state, pass_fds)
                sides.enter_context(_closing(particles))
                cost = drive(
                    plan, particles, gas, folder, first=first, before=before, progress=progress, time_limit=timeout
                )
            write_series_csv(folder / SERIES, read_series(folder / PIECES))
            parts = {"cpu_dem": cost.dem, "cpu_gas": cost.gas, "cpu_exchange": cost.exchange}
            extra = transport | {"couplings": cost.couplings} | parts
            return {"cpu_seconds": sum(parts.values()), "extra": extra}

        return guarded(self.name, plan, folder, work, cpu_seconds=0.0, extra=transport)

    def _gas(self, plan: Plan, folder: Path, pass_fds: Sequence[int]) -> GasSolver | None:
        setup = gas_setup(plan)
        if setup is None:
            return None
        if self._library is not None:
            return LiveGas(setup, folder / GAS, self._library, plan.scene.number, pass_fds=pass_fds)
        return RestartGas(setup, folder / GAS, ranks=self.ranks, oversubscribe=self.oversubscribe, pass_fds=pass_fds)

    def _particles(
        self, plan: Plan, folder: Path, start: Start, first: int, state: Path | None, pass_fds: Sequence[int]
    ) -> ParticleSolver:
        """Start the particles at ``start``, or at the ``state`` after coupling ``first``."""
        if not _moves(plan.scene):
            return Still(start, plan.scene.d_min)
        at = None if state is None else state / PARTICLES
        particles = LiggghtsDem(
            plan,
            folder / PARTICLES,
            None if at else start,
            restart=at,
            first=first,
            ranks=1 if plan.scene.gas else self.ranks,
            oversubscribe=self.oversubscribe,
            pass_fds=pass_fds,
        )
        if at is not None and particles.step != first * plan.steps_per_coupling:
            particles.close()
            raise ReadError(f"{at}: the state of step {particles.step}, not of coupling {first}; run it with --rerun")
        return particles


def _given(start: Start | None) -> Start:
    return Start.at(np.zeros((0, 3))) if start is None else start


@contextmanager
def _closing(side: GasSolver | ParticleSolver) -> Iterator[None]:
    """Close a side at the end; after an error, what closing says (a dead solver is one) does not take its place."""
    try:
        yield
    except BaseException:
        with suppress(RunError):
            side.close()
        raise
    side.close()


def _set_aside(folder: Path) -> None:
    """Rename what an earlier part of this run left (its logs tell why it ended) to ``<name>-1``, ``-2``, ..."""
    if not folder.exists():
        return
    number = 1
    while (aside := folder.with_name(f"{folder.name}-{number}")).exists():
        number += 1
    folder.rename(aside)


def _write_scripts(plan: Plan, folder: Path) -> None:
    """Write what a person starts and reads."""
    scene, setup = plan.scene, gas_setup(plan)
    context: dict[str, object] = {
        "scene": scene.name,
        "kind": plan.kind,
        "particles": _moves(scene),
        "alone": _moves(scene) and scene.run.coupling is None,
        "gas": setup is not None,
        "jet": setup is not None and setup.jet is not None,
        "ramp": bool(scene.gas and scene.gas.ramp),
        "deck": DECK,
        "data": DATA,
        "dt": plan.dt,
        "steps": plan.n_steps,
        "steps_per_coupling": plan.steps_per_coupling,
        "couplings": plan.couplings,
        "gas_step": plan.gas_step,
        "gas_steps": plan.gas_steps,
        "end_time": plan.t_end,
        "end_marker": END_MARKER,
    }
    for name in (ALLRUN, README):
        text = render(shipped_folder("templates") / "bed", f"{name}.j2", context)
        (folder / name).write_text(text, encoding="utf-8")
    (folder / ALLRUN).chmod(0o755)
