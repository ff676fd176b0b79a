"""The fast gas transport: one stock DPMFoam kept alive, its parcels replaced in memory between two of its steps.

A small function object library inside the solver (see `kncal.engines.dpmfoam.adapter_build`) publishes the gas and the
parcels' velocities after each step and waits. The numbers are those of the restart transport, bit for bit: in both,
the solver starts a step from the same fields and parcels, and both use `kncal.engines.dpmfoam.forces`.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from kncal.core.checks import Array, in_range, positive
from kncal.core.errors import InputError, RunError
from kncal.core.solver_process import PeerLostError, SolverProcess
from kncal.engines.base import GasSetup
from kncal.engines.dpmfoam.adapter_build import LIBRARY, AdapterError
from kncal.engines.dpmfoam.case import (
    SOLVER,
    STATE,
    case_environment,
    inlet_velocity,
    install_state,
    make_mesh,
    process_error,
    set_case_inlet,
    write_case,
)
from kncal.engines.dpmfoam.forces import Exchange
from kncal.engines.dpmfoam.memory import ExchangeMemory
from kncal.record.steps import GasFields, GasStep

_END, _STEP, _SAVE = 0, 1, 2  # commands of the adapter
_NEVER = 1_000_000_000  # steps between written time folders
# One step only: should the library not be loaded, which is a mere warning to the solver, it ends at once instead of
# running on alone. The library lifts the end.
_FUNCTIONS = f'libs ("{LIBRARY}");\nfunctions {{ exchange {{ type kncalExchange; }} }}'


class LiveGas:
    """One DPMFoam for all gas steps. It starts with the first step and ends with `close`, or with the calling thread.

    Parameters
    ----------
    setup : GasSetup
    folder : Path
        Gets the case; empty or missing.
    library : Path
        The adapter, from `kncal.engines.dpmfoam.adapter_build.build` or ``find``.
    n_max : int
        Largest number of particles that a step will have.
    time_limit : float
        Wall-clock limit of one gas step [s].
    pass_fds : sequence of int
        Open descriptors that the solver inherits.

    Raises
    ------
    InputError, RenderError
        If the set-up, ``n_max`` or the folder will not do.
    AdapterError
        If there is no such library.
    RunError
        If the mesh cannot be made (SolverMissingError: OpenFOAM is not installed).
    """

    name = "live"

    def __init__(
        self,
        setup: GasSetup,
        folder: Path,
        library: Path,
        n_max: int,
        *,
        time_limit: float = 300.0,
        pass_fds: Sequence[int] = (),
    ) -> None:
        if isinstance(n_max, bool) or not isinstance(n_max, int) or n_max < 0:
            raise InputError(f"n_max = {n_max!r}: expected the largest number of particles, a whole number >= 0")
        if library.name != LIBRARY or not library.is_file():
            raise AdapterError(
                f"{library}: expected the adapter {LIBRARY}, there is none; kncal adapter build makes it"
            )
        self.setup = setup
        self._folder = folder.absolute()
        self._library = library.absolute()
        self._time_limit = float(positive("time_limit", time_limit, unit="s"))
        self._pass_fds = tuple(pass_fds)
        write_case(setup, self._folder, end_time=setup.step, write_interval=_NEVER, functions=_FUNCTIONS)
        self._cpu = make_mesh(self._folder)
        self._exchange_cpu = 0.0
        self._exchange = Exchange(setup)
        self._inlet = inlet_velocity(setup)
        self._solver: SolverProcess | None = None
        self._attached = self._stepped = self._closed = False
        grid = self._exchange.grid
        self._memory = ExchangeMemory(n_max * setup.parcels_per_particle, grid.count, grid.inlet_faces)

    def step(self, x: Array, v: Array, diameter: Array, density: Array) -> GasStep:
        """Advance the gas by one step with particles at ``x``, ``v`` (n, 3), of ``diameter``, ``density`` (n,).

        Raises
        ------
        InputError
            If there are more particles than ``n_max``.
        RunError
            If DPMFoam fails, takes too long or loses a parcel, with its own error text; or after `close`.
        AdapterError
            If the solver does not load the library.
        """
        parcels = self._exchange.parcels(x, v, diameter, density)
        count = len(parcels.x)
        if count > self._memory.room:
            raise InputError(
                f"{len(x)} particles: this gas transport was made for at most n_max = "
                f"{self._memory.room // self.setup.parcels_per_particle}; make it with a larger one"
            )
        solver = self._running()
        self._memory.put(parcels)
        self._command(solver, _STEP)
        self._stepped = True
        if (returned := self._memory.count()) != count:
            self.close()
            raise RunError(
                f"{SOLVER} returned {returned} of {count} parcels: the others left the mesh during the gas step; "
                "shorten the step (a particle may not move more than half its diameter in it)",
                "lost-particles",
            )
        take = self._memory.take
        return self._exchange.finish(
            parcels,
            take("v_new", count),
            U=take("U"),
            eps_g=take("eps_g"),
            p=take("p"),
            U_trans=take("U_trans"),
            U_coeff=take("U_coeff"),
            p_in=float(take("p_inlet").mean()),
        )

    def set_inlet(self, velocity: float) -> None:
        """Change the superficial velocity at the inlet (of a jet: in its slot) for the following steps [m/s]."""
        self._check_open()
        self._inlet = float(in_range("velocity", velocity, 0.0, 1e3, unit="m/s"))
        if self._solver is None:
            set_case_inlet(self.setup, self._folder, self._inlet)
        else:
            self._memory.set_inlet(self._inlet)

    def fields(self) -> GasFields:
        """Return the gas fields after the last step; RunError before the first."""
        return self._exchange.fields()

    def save(self, folder: Path) -> None:
        """Write the gas state after the last step into ``folder`` (made if missing): binary fields of OpenFOAM.

        Raises
        ------
        RunError
            Before the first step; or if the solver fails.
        """
        if not self._stepped:
            raise RunError("there is no gas state to save before the first gas step")
        self._command(self._running(), _SAVE)
        folder.mkdir(parents=True, exist_ok=True)
        for name in STATE:
            shutil.copyfile(self._folder / "state" / name, folder / name)

    def load(self, folder: Path) -> None:
        """Take up a state that `save` of either transport wrote, before the first `step`.

        The inlet velocity is not taken from it: it stays that of the set-up, or of `set_inlet`.

        Raises
        ------
        RunError
            After the first step.
        ReadError
            If the state is not complete, or of another mesh.
        """
        self._check_open()
        if self._solver is not None:
            raise RunError("a gas state can only be loaded before the first gas step; make a new transport for it")
        self._exchange.U_old = install_state(folder, self._folder, self._exchange.grid.count)
        set_case_inlet(self.setup, self._folder, self._inlet)

    @property
    def cpu_seconds(self) -> float:
        """CPU time of OpenFOAM's processes so far [s]."""
        return self._cpu + (0.0 if self._solver is None else self._solver.cpu_seconds)

    @property
    def exchange_seconds(self) -> float:
        """The part of `cpu_seconds` that the adapter took to give and take parcels and fields [s]."""
        return self._exchange_cpu if self._closed else self._memory.cpu_seconds()

    def close(self) -> None:
        """End the solver; leaves no process, descriptor or shared memory behind. May be called twice."""
        if self._closed:
            return
        self._exchange_cpu = self._memory.cpu_seconds()
        self._closed = True
        self._memory.close()
        if self._solver is None or self._solver.ended:
            return
        result = self._solver.finish(_END)
        if result.returncode != 0:
            raise process_error(SOLVER, result, self._solver.log)

    def _running(self) -> SolverProcess:
        """Return the solver, started if need be."""
        self._check_open()
        if self._solver is not None:
            return self._solver
        environment = case_environment(self._folder)
        paths = [str(self._library.parent), os.environ.get("LD_LIBRARY_PATH", "")]
        solver = self._solver = SolverProcess(
            [SOLVER],
            cwd=self._folder,
            log=self._folder / f"log.{SOLVER}",
            environment={**environment, "LD_LIBRARY_PATH": ":".join(filter(None, paths))},
            variable="KNCAL_EXCHANGE",
            descriptor=self._memory.descriptor,
            pass_fds=self._pass_fds,
        )
        self._await(solver)
        self._attached = True
        return solver

    def _command(self, solver: SolverProcess, command: int) -> None:
        solver.send(command)
        self._await(solver)

    def _await(self, solver: SolverProcess) -> None:
        """Wait for the solver's answer; without one, close and say why in the solver's own words."""
        try:
            solver.receive(self._time_limit)
        except PeerLostError as error:
            self.close()
            result = error.result
            if result.returncode == 0 and not self._attached:
                words = [line for line in result.last_lines if "ncalExchange" in line or "dlopen" in line]
                raise AdapterError(
                    f"{SOLVER} ran without the adapter {self._library}: {' / '.join(words) or 'it was not loaded'}; "
                    f"remove it and build it again: kncal adapter build; see {solver.log}"
                ) from error
            raise process_error(SOLVER, result, solver.log) from error
        except BaseException:
            self.close()
            raise

    def _check_open(self) -> None:
        if self._closed:
            raise RunError("this gas transport was closed; make a new one and load the saved state")
