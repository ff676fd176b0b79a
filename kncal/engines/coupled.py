"""The engine coupled: DPMFoam and LIGGGHTS together, two transports to the gas, one exchange loop."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from kncal import __version__
from kncal.core.checks import Array, one_of
from kncal.core.disk import blame
from kncal.core.errors import InputError, KncalError, ReadError, RunError, SolverMissingError, failure_of
from kncal.core.mpi import MISSING as NO_MPIRUN
from kncal.core.mpi import MPIRUN, check_ranks
from kncal.engines.base import Profile
from kncal.engines.checkpoint import GAS, PARTICLES, last_checkpoint
from kncal.engines.coupling import Dem, GasTransport
from kncal.engines.dpmfoam.decomposed import divisions as check_divisions
from kncal.engines.dpmfoam.installed import look as look_for_openfoam
from kncal.engines.liggghts.installed import look as look_for_liggghts
from kncal.engines.loop import CoupledCost, CoupledRun, Progress, gas_setup
from kncal.record.outcome import RunResult
from kncal.scene.bed_scene import BedScene
from kncal.scene.model import BedModel

TRANSPORTS = ("auto", "live", "restart")


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
    from kncal.engines.dpmfoam.adapter_build import AdapterError, find

    library = find()
    if library is None and wanted == "live":
        raise AdapterError(
            "the adapter of the live transport is not built: kncal adapter build, or --transport restart"
        )
    return ("live", library) if library is not None else ("restart", None)


def check_bed_ranks(scene: BedScene, ranks: int) -> None:
    """Refuse several ranks for a bed whose particles move, or whose gas cannot be cut into so many parts.

    Raises
    ------
    InputError
        With the reason.
    """
    if ranks == 1:
        return
    if scene.gas is None:
        raise InputError(f"ranks = {ranks}: only the gas of a bed is shared among ranks, and {scene.name} has none")
    if scene.particles.count and not scene.particles.frozen:
        raise InputError(
            f"ranks = {ranks}: the particles of {scene.name} move, and such a bed runs on one rank: gas and particles "
            "exchange everything through one process after every interval. Expected 1; several cases side by side "
            "(kncal sweep) use all cores"
        )
    check_divisions(scene.column.cells, ranks)


class Coupled:
    """One bed by Debian's LIGGGHTS and OpenFOAM.

    Parameters
    ----------
    transport : "auto", "live" or "restart"
    ranks : int
        Processes that share the gas; only for beds whose particles do not move (see `check_bed_ranks`).
    oversubscribe : bool
        Allow more ranks than cores.

    Raises
    ------
    InputError
        For several ranks with the transport live, or a number of them that `kncal.core.mpi.check_ranks` refuses.
    """

    name = "coupled"

    def __init__(self, transport: str = "auto", *, ranks: int = 1, oversubscribe: bool = False) -> None:
        self.ranks, self.oversubscribe = check_ranks(ranks, oversubscribe=oversubscribe), oversubscribe
        if ranks > 1 and transport == "live":
            raise InputError(f"transport = 'live' with ranks = {ranks}: live has one gas solver; expected 'restart'")
        self.transport, self._library = choose_transport("restart" if ranks > 1 else transport)

    def profile(self) -> Profile:
        """Look for both solvers on this machine."""
        liggghts, openfoam = look_for_liggghts(), look_for_openfoam()
        missing = [f"{f.name} (found: {f.found}; {f.hint})" for f in (liggghts, openfoam) if not f.ok]
        missing += [NO_MPIRUN] if self.ranks > 1 and shutil.which(MPIRUN) is None else []
        program = shutil.which("DPMFoam")
        return Profile(
            engine=self.name,
            program=None if missing or program is None else Path(program),
            version=f"LIGGGHTS {liggghts.found}; OpenFOAM {openfoam.found}",
            problem="" if not missing else f"a coupled bed needs {' and '.join(missing)}",
        )

    def run(
        self,
        model: BedModel,
        folder: Path,
        positions: Array,
        *,
        timeout: float | None = None,
        progress: Progress | None = None,
        resume: bool = False,
        pass_fds: Sequence[int] = (),
    ) -> RunResult:
        """Run ``model`` in ``folder``; never raises for a failed run, the status says so.

        With ``resume`` the run goes on from its last complete checkpoint (from the start if there is none). The solvers
        inherit the descriptors ``pass_fds`` (the lock of the run folder).
        """
        started = time.monotonic()
        status, message, failure = "completed", "", ""
        extra: dict[str, Any] = {"transport": self.transport if model.scene.gas else "none"}
        cpu = 0.0
        try:
            cost = self._couple(model, folder, positions, timeout, progress, resume, pass_fds)
            cpu = cost.dem + cost.gas + cost.exchange
            extra |= {
                "couplings": cost.couplings,
                "cpu_dem": cost.dem,
                "cpu_gas": cost.gas,
                "cpu_exchange": cost.exchange,
            }
        except SolverMissingError as error:
            status, message = "not_installed", str(error)
        except KeyboardInterrupt:
            status, message = "interrupted", "interrupted by the user"
        except TimeoutError as error:
            status, message = "timed_out", str(error)
        except (KncalError, OSError) as error:
            status = "failed"
            failure, message = blame(failure_of(error), str(error), folder)
        return RunResult(
            status=status,
            engine=self.name,
            model=model.kind,
            folder=folder,
            steps=model.couplings * model.steps_per_coupling,
            dt=model.dt,
            cpu_seconds=cpu,
            wall_seconds=time.monotonic() - started,
            version=__version__,
            message=message,
            failure=failure,
            extra=extra,
        )

    def _couple(
        self,
        model: BedModel,
        folder: Path,
        positions: Array,
        timeout: float | None,
        progress: Progress | None,
        resume: bool,
        pass_fds: Sequence[int],
    ) -> CoupledCost:
        from kncal.engines.liggghts.library import LiggghtsDem
        from kncal.engines.liggghts.library_child import histogram_edges

        frozen = model.scene.particles.frozen or model.scene.particles.count == 0
        checkpoint = last_checkpoint(folder, model.couplings) if resume else None
        first, state = (0, None) if checkpoint is None else (checkpoint.coupling, checkpoint.path)
        for name in (GAS, PARTICLES):
            _set_aside(folder / name)
        dem = None
        with ExitStack() as sides:
            if (gas := self._gas(model, folder, pass_fds)) is not None:
                sides.enter_context(_closing(gas))
                if state is not None:
                    gas.load(state / GAS)
            if not frozen:
                at = None if state is None else state / PARTICLES
                start = None if at else positions
                dem = LiggghtsDem(model, folder / PARTICLES, start, restart=at, pass_fds=pass_fds)
                sides.enter_context(_closing(dem))
                if at is not None and dem.step != first * model.steps_per_coupling:
                    raise ReadError(f"{at}: the state of step {dem.step}, not of coupling {first}; run it with --rerun")
            run = CoupledRun(
                model,
                folder,
                gas,
                dem,
                positions=positions,
                histogram_edges=histogram_edges(model.scene.particles.diameter),
                first=first,
                before=None if checkpoint is None else checkpoint.cost,
            )
            cost = run.run(progress, time_limit=timeout)
        return cost

    def _gas(self, model: BedModel, folder: Path, pass_fds: Sequence[int]) -> GasTransport | None:
        setup = gas_setup(model)
        if setup is None:
            return None
        if self.transport == "live" and self._library is not None:
            from kncal.engines.dpmfoam.live import LiveGas

            count = model.scene.particles.count
            return LiveGas(setup, folder / GAS, self._library, count, pass_fds=pass_fds)
        from kncal.engines.dpmfoam.restart import RestartGas

        return RestartGas(setup, folder / GAS, ranks=self.ranks, oversubscribe=self.oversubscribe, pass_fds=pass_fds)


@contextmanager
def _closing(side: GasTransport | Dem) -> Iterator[None]:
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
