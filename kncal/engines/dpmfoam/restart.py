"""The gas transport that needs nothing but the stock solver: DPMFoam is started again for every step.

The gas state between two steps is three files in ``<case>/0``. A start costs about a tenth of a second, most of it the
loading of the solver's libraries; a folder in memory (tmpfs) is best.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from kncal.core.checks import Array, in_range, positive
from kncal.core.errors import RunError
from kncal.core.mpi import check_ranks
from kncal.engines.base import GasSetup
from kncal.engines.dpmfoam.case import (
    INLET,
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
from kncal.engines.dpmfoam.decomposed import decompose, reconstruct, run_in_folder
from kncal.engines.dpmfoam.forces import Exchange, Parcels
from kncal.record.openfoam import (
    CLOUD,
    read_cells,
    read_list,
    read_patch,
    write_parcel_constants,
    write_parcel_motion,
)
from kncal.record.steps import GasFields, GasStep


class RestartGas:
    """Stock DPMFoam, started anew for every gas step.

    Parameters
    ----------
    setup : GasSetup
    folder : Path
        Gets the case; empty or missing.
    time_limit : float
        Wall-clock limit of one gas step [s].
    ranks : int
        Processes that share each gas step (see `kncal.engines.dpmfoam.decomposed`).
    oversubscribe : bool
        Allow more ranks than cores.
    pass_fds : sequence of int
        Open descriptors that the solver inherits.

    Raises
    ------
    InputError, RenderError
        If the set-up or the folder will not do.
    RunError
        If the mesh cannot be made (SolverMissingError: OpenFOAM is not installed).
    """

    name = "restart"

    def __init__(
        self,
        setup: GasSetup,
        folder: Path,
        *,
        time_limit: float = 300.0,
        ranks: int = 1,
        oversubscribe: bool = False,
        pass_fds: Sequence[int] = (),
    ) -> None:
        self.setup = setup
        self._ranks, self._oversubscribe = check_ranks(ranks, oversubscribe=oversubscribe), oversubscribe
        self._folder = folder.absolute()
        self._pass_fds = tuple(pass_fds)
        self._time_limit = float(positive("time_limit", time_limit, unit="s"))
        write_case(setup, self._folder, end_time=setup.step, write_interval=1, ranks=ranks, oversubscribe=oversubscribe)
        self._cpu = make_mesh(self._folder)
        self._exchange = Exchange(setup)
        self._inlet = inlet_velocity(setup)
        self._stepped = False
        self._written: tuple[Array, Array, Array] | None = None
        self._closed = False

    def step(self, x: Array, v: Array, diameter: Array, density: Array) -> GasStep:
        """Advance the gas by one step with particles at ``x``, ``v`` (n, 3), of ``diameter``, ``density`` (n,).

        Raises
        ------
        RunError
            If DPMFoam fails, takes too long or loses a parcel, with its own error text; or after `close`.
        """
        if self._closed:
            raise RunError("this gas transport was closed; make a new one and load the saved state")
        parcels = self._exchange.parcels(x, v, diameter, density)
        self._write(parcels)
        # The name that the solver gives to the time: %g with timePrecision digits.
        end = self._folder / f"{self.setup.step:.9g}"
        self._run(end)
        result = self._read(parcels, end)
        for name in (*STATE, "alpha.air"):  # the void fraction is computed anew at each start: kept for those who look
            (end / name).replace(self._start / name)
        shutil.rmtree(end)
        self._stepped = True
        return result

    def set_inlet(self, velocity: float) -> None:
        """Change the superficial velocity at the inlet (of a jet: in its slot) for the following steps [m/s]."""
        self._inlet = float(in_range("velocity", velocity, 0.0, 1e3, unit="m/s"))
        set_case_inlet(self.setup, self._folder, self._inlet)

    def fields(self) -> GasFields:
        """Return the gas fields after the last step; RunError before the first."""
        return self._exchange.fields()

    def save(self, folder: Path) -> None:
        """Write the gas state after the last step into ``folder`` (made if missing): binary fields of OpenFOAM.

        Raises
        ------
        RunError
            Before the first step.
        """
        if not self._stepped:
            raise RunError("there is no gas state to save before the first gas step")
        folder.mkdir(parents=True, exist_ok=True)
        for name in STATE:
            shutil.copyfile(self._start / name, folder / name)

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
        if self._stepped:
            raise RunError("a gas state can only be loaded before the first gas step; make a new transport for it")
        self._exchange.U_old = install_state(folder, self._folder, self._exchange.grid.count)
        set_case_inlet(self.setup, self._folder, self._inlet)

    @property
    def cpu_seconds(self) -> float:
        """CPU time of OpenFOAM's processes so far [s]."""
        return self._cpu

    def close(self) -> None:
        """End the use of the case folder; no process lives between two steps."""
        self._closed = True

    @property
    def _start(self) -> Path:
        return self._folder / "0"

    def _write(self, parcels: Parcels) -> None:
        constants = (parcels.diameter, parcels.density, parcels.weight)
        if not len(parcels.x):
            for tree in (self._start / CLOUD, self._start / "uniform" / CLOUD):
                shutil.rmtree(tree, ignore_errors=True)
            self._written = None
            return
        if self._written is None or not all(map(np.array_equal, self._written, constants)):
            write_parcel_constants(self._start, *constants)
            self._written = constants
        write_parcel_motion(self._start, parcels.x, parcels.cell, parcels.v)

    def _run(self, end: Path) -> None:
        run = partial(
            run_in_folder,
            folder=self._folder,
            environment=case_environment(self._folder),
            time_limit=self._time_limit,
            oversubscribe=self._oversubscribe,
            error=process_error,
            pass_fds=self._pass_fds,
        )
        if self._ranks == 1:
            self._cpu += run([SOLVER, "-noFunctionObjects"], 1).cpu_seconds
        else:
            self._cpu += decompose(self._folder, run)
            self._cpu += run([SOLVER, "-parallel", "-noFunctionObjects"], self._ranks).cpu_seconds
            self._cpu += reconstruct(self._folder, end, run)
        if not end.is_dir():
            raise RunError(f"{SOLVER} ended without the time folder {end.name}; see {self._folder / f'log.{SOLVER}'}")

    def _read(self, parcels: Parcels, end: Path) -> GasStep:
        count = self._exchange.grid.count
        return self._exchange.finish(
            parcels,
            self._read_velocities(parcels, end / CLOUD),
            U=read_cells(end / "U.air", count),
            eps_g=read_cells(end / "alpha.air", count),
            p=read_cells(end / "p", count),
            U_trans=read_cells(end / "kinematicCloud:UTrans", count),
            U_coeff=read_cells(end / "kinematicCloud:UCoeff", count),
            p_in=float(read_patch(end / "p", INLET, self._exchange.grid.inlet_faces).mean()),
        )

    def _read_velocities(self, parcels: Parcels, cloud: Path) -> Array:
        sent = len(parcels.x)
        if not sent:
            return np.zeros((0, 3))
        row = read_list(cloud / "origId")
        if len(row) != sent or not np.array_equal(np.sort(row), np.arange(sent)):
            raise RunError(
                f"{SOLVER} returned {len(row)} of {sent} parcels: the others left the mesh during the gas step; "
                "shorten the step (a particle may not move more than half its diameter in it)",
                "lost-particles",
            )
        velocities = np.empty((sent, 3))
        velocities[row] = read_list(cloud / "U")
        return velocities
