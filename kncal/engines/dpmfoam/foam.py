"""What both gas solvers share: the case folder, the exchange, the inlet, and states that either can take up."""

from __future__ import annotations

import shutil
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from kncal.core.checks import Array, in_range, positive
from kncal.core.errors import RunError
from kncal.engines.base import GasSetup
from kncal.engines.dpmfoam.case import STATE, inlet_velocity, install_state, set_case_inlet, write_case
from kncal.engines.dpmfoam.forces import Exchange
from kncal.engines.dpmfoam.programs import make_mesh
from kncal.record.steps import GasFields, GasStep


class FoamGas(ABC):
    """A DPMFoam (the protocol `kncal.engines.base.GasSolver`); how it is reached is the matter of its two kinds.

    Parameters
    ----------
    setup : GasSetup
    folder : Path
        Gets the case; empty or missing.
    time_limit : float
        Wall-clock limit of one gas step [s].
    pass_fds : sequence of int
        Open descriptors that the solver inherits.
    case
        More for `kncal.engines.dpmfoam.case.write_case`.

    Raises
    ------
    InputError, RenderError
        If the set-up or the folder will not do.
    RunError
        If the mesh cannot be made (SolverMissingError: OpenFOAM is not installed).
    """

    def __init__(
        self, setup: GasSetup, folder: Path, *, time_limit: float, pass_fds: Sequence[int], **case: Any
    ) -> None:
        self.setup = setup
        self._folder = folder.absolute()
        self._time_limit = float(positive("time_limit", time_limit, unit="s"))
        self._pass_fds = tuple(pass_fds)
        write_case(setup, self._folder, end_time=setup.step, **case)
        self._cpu = make_mesh(self._folder)
        self._exchange = Exchange(setup)
        self._inlet = inlet_velocity(setup)
        self._stepped = self._closed = False

    @abstractmethod
    def step(self, x: Array, v: Array, diameter: Array, density: Array) -> GasStep:
        """Advance the gas by one step with particles at ``x``, ``v`` (n, 3), of ``diameter``, ``density`` (n,).

        Raises
        ------
        RunError
            If DPMFoam fails, takes too long or loses a parcel, with its own error text; or after `close`.
        """

    def set_inlet(self, velocity: float) -> None:
        """Change the superficial velocity at the inlet (of a jet: in its slot) for the following steps [m/s]."""
        self._check_open()
        self._inlet = float(in_range("velocity", velocity, 0.0, 1e3, unit="m/s"))
        self._apply_inlet()

    def _apply_inlet(self) -> None:
        set_case_inlet(self.setup, self._folder, self._inlet)

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
        state = self._state()
        folder.mkdir(parents=True, exist_ok=True)
        for name in STATE:
            shutil.copyfile(state / name, folder / name)

    @abstractmethod
    def _state(self) -> Path:
        """Return the folder that holds the state after the last step."""

    def load(self, folder: Path) -> None:
        """Take up a state that `save` of either kind wrote, before the first `step`.

        The inlet velocity is not taken from it: it stays that of the set-up, or of `set_inlet`.

        Raises
        ------
        RunError
            After the first step.
        ReadError
            If the state is not complete, or of another mesh.
        """
        self._check_open()
        if self._stepped:
            raise RunError("a gas state can only be loaded before the first gas step; make a new solver for it")
        self._exchange.U_old = install_state(folder, self._folder, self._exchange.grid.count)
        set_case_inlet(self.setup, self._folder, self._inlet)

    @property
    def cpu_seconds(self) -> float:
        """CPU time of OpenFOAM's processes so far [s]."""
        return self._cpu

    def close(self) -> None:
        """End the solver; leaves no process, descriptor or shared memory behind. May be called twice."""
        self._closed = True

    def _check_open(self) -> None:
        if self._closed:
            raise RunError("this gas solver was closed; make a new one and load the saved state")


def lost_parcels(returned: int, sent: int) -> RunError:
    """Return the error of a step that lost parcels."""
    return RunError(
        f"DPMFoam returned {returned} of {sent} parcels: the others left the mesh during the gas step; "
        "shorten the step (a particle may not move more than half its diameter in it)",
        "lost-particles",
    )
