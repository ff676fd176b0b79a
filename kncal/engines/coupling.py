"""The interface between the exchange loop and the two sides, gas and particles.

Row order: every particle array has one row per particle, in the order of the particles' ids (row i is id i+1), always.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from kncal.core.checks import Array
from kncal.record.steps import DemStep, GasFields, GasStep
from kncal.scene.bed_scene import Jet


@dataclass(frozen=True, kw_only=True)
class GasSetup:
    """All that the gas side needs to know.

    Attributes
    ----------
    size : (3,) box [m]; cells : number of cells per axis
    inlet : superficial velocity through the floor [m/s] (0 with a jet); jet : Jet or None
    density [kg/m³], viscosity (dynamic) [Pa s], gravity (downwards) [m/s²]
    step : gas step [s]
    drag : name of the drag law (`kncal.physics.drag.DRAGS`)
    walls : "slip" or "noSlip"; front_back : "walls", "periodic" or "layer" (no gas motion in y: patch type empty)
    parcels_per_particle : 1, 8 or 27
    """

    size: tuple[float, float, float]
    cells: tuple[int, int, int]
    inlet: float
    jet: Jet | None
    density: float
    viscosity: float
    gravity: float
    step: float
    drag: str = "ErgunWenYu"
    walls: str = "slip"
    front_back: str = "walls"
    parcels_per_particle: int = 1


class GasTransport(Protocol):
    """One gas solver at work. `step` may be called with a changing number of particles."""

    name: str
    setup: GasSetup

    def step(self, x: Array, v: Array, diameter: Array, density: Array) -> GasStep:
        """Advance the gas by one step with particles at ``x``, ``v`` (n, 3), of ``diameter``, ``density`` (n,).

        Raises RunError with the solver's own error text if it ends, hangs, or loses a parcel.
        """
        ...

    def set_inlet(self, velocity: float) -> None:
        """Change the superficial inlet velocity for the following steps [m/s]."""
        ...

    def fields(self) -> GasFields:
        """Return the gas fields after the last step."""
        ...

    def save(self, folder: Path) -> None:
        """Write the gas state after the last step into ``folder`` (made if missing)."""
        ...

    def load(self, folder: Path) -> None:
        """Take up a state that `save` of either transport wrote, before the first `step`."""
        ...

    @property
    def cpu_seconds(self) -> float:
        """CPU time of the solver's processes so far [s]."""
        ...

    def close(self) -> None:
        """End the solver; leaves no process, file descriptor or shared memory behind. May be called twice."""
        ...


class Dem(Protocol):
    """The particles at work: LIGGGHTS in a child process of its own."""

    histogram_edges: Array
    impact_edges: Array

    def state(self) -> tuple[Array, Array]:
        """Return positions [m] and velocities [m/s], both (n, 3), by id."""
        ...

    def run(self, steps: int, force: Array) -> DemStep:
        """Hold ``force`` (n, 3) [N] on the particles and run; RunError if LIGGGHTS ends, hangs or loses particles."""
        ...

    def save(self, folder: Path) -> None:
        """Write a restart (contact history included) into ``folder``."""
        ...

    @property
    def cpu_seconds(self) -> float:
        """CPU time of the child so far [s]."""
        ...

    def close(self) -> None:
        """End the child; may be called twice."""
        ...
