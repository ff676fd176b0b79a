"""The gas solver that needs nothing but the stock program: DPMFoam is started again for every step.

The gas state between two steps is three files in ``<case>/0``. A start costs about a tenth of a second, most of it the
loading of the solver's libraries; a folder in memory (tmpfs) is best.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import RunError
from kncal.core.mpi import check_ranks
from kncal.engines.base import GasSetup
from kncal.engines.dpmfoam.case import INLET, STATE
from kncal.engines.dpmfoam.decomposed import decompose, reconstruct
from kncal.engines.dpmfoam.foam import FoamGas, lost_parcels
from kncal.engines.dpmfoam.forces import Parcels
from kncal.engines.dpmfoam.programs import SOLVER, run_program
from kncal.record.openfoam import (
    CLOUD,
    read_cells,
    read_list,
    read_patch,
    write_parcel_constants,
    write_parcel_motion,
)
from kncal.record.steps import GasStep


class RestartGas(FoamGas):
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
        self._ranks, self._oversubscribe = check_ranks(ranks, oversubscribe=oversubscribe), oversubscribe
        super().__init__(
            setup, folder, time_limit=time_limit, pass_fds=pass_fds, ranks=ranks, oversubscribe=oversubscribe
        )
        self._written: tuple[Array, Array, Array] | None = None

    def step(self, x: Array, v: Array, diameter: Array, density: Array) -> GasStep:
        """Advance the gas by one step with particles at ``x``, ``v`` (n, 3), of ``diameter``, ``density`` (n,).

        Raises
        ------
        RunError
            If DPMFoam fails, takes too long or loses a parcel, with its own error text; or after `close`.
        """
        self._check_open()
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

    def _state(self) -> Path:
        return self._start

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
        def run(command: list[str], ranks: int) -> float:
            return run_program(
                command,
                self._folder,
                ranks=ranks,
                time_limit=self._time_limit,
                oversubscribe=self._oversubscribe,
                pass_fds=self._pass_fds,
            )

        if self._ranks == 1:
            self._cpu += run([SOLVER, "-noFunctionObjects"], 1)
        else:
            self._cpu += decompose(self._folder, run)
            self._cpu += run([SOLVER, "-parallel", "-noFunctionObjects"], self._ranks)
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
            raise lost_parcels(len(row), sent)
        velocities = np.empty((sent, 3))
        velocities[row] = read_list(cloud / "U")
        return velocities
