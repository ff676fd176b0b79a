"""The fast gas solver: one stock DPMFoam kept alive, its parcels replaced in memory between two of its steps.

A small function object library inside the solver (see `kncal.engines.dpmfoam.adapter_build`) publishes the gas and the
parcels' velocities after each step and waits. The numbers are those of `kncal.engines.dpmfoam.restart`, bit for bit: in
both, the solver starts a step from the same fields and parcels, and both use `kncal.engines.dpmfoam.forces`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.core.solver_process import PeerLostError, SolverProcess
from kncal.engines.base import GasSetup
from kncal.engines.dpmfoam.adapter_build import LIBRARY, AdapterError
from kncal.engines.dpmfoam.foam import FoamGas, lost_parcels
from kncal.engines.dpmfoam.memory import ExchangeMemory
from kncal.engines.dpmfoam.programs import SOLVER, case_environment, process_error
from kncal.record.steps import GasStep

_END, _STEP, _SAVE = (number.to_bytes(4, "little") for number in range(3))  # commands of the adapter
_NEVER = 1_000_000_000  # steps between written time folders
# One step only: should the library not be loaded, which is a mere warning to the solver, it ends at once instead of
# running on alone. The library lifts the end.
_FUNCTIONS = f'libs ("{LIBRARY}");\nfunctions {{ exchange {{ type kncalExchange; }} }}'


class LiveGas(FoamGas):
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
        rare = {"write_interval": _NEVER, "functions": _FUNCTIONS}
        super().__init__(setup, folder, time_limit=time_limit, pass_fds=pass_fds, **rare)
        self._library = library.absolute()
        self._exchange_cpu = 0.0
        self._solver: SolverProcess | None = None
        self._attached = False
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
            raise lost_parcels(returned, count)
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

    def _apply_inlet(self) -> None:
        if self._solver is None:
            super()._apply_inlet()
        else:
            self._memory.set_inlet(self._inlet)

    def _state(self) -> Path:
        self._command(self._running(), _SAVE)
        return self._folder / "state"

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
            SOLVER,
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

    def _command(self, solver: SolverProcess, command: bytes) -> None:
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
