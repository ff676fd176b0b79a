"""The interface between the exchange loop and the two sides, gas and particles.

Row order: every particle array has one row per particle, in the order of the particles' ids (row i is id i+1), always.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from kncal.core.checks import Array
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
    drag : name of the drag law (`kncal.scene.bed_scene.DRAGS`)
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


@dataclass(frozen=True, kw_only=True)
class GasStep:
    """What one gas step did.

    Attributes
    ----------
    force : (n, 3) force of the gas on each particle, buoyancy included [N]
    p_in : area mean of the gauge pressure at the inlet patch (jet: the jet patch) [Pa]
    reaction_error : |sum of the drag booked on particles + that booked on the gas| [N], rounding only
    not_passed : |momentum per time that the gas received and no particle was given| [N]
    solids_error : relative difference of the solid volume in the void fraction field to that of the particles [-]
    eps_g_min : smallest void fraction [-]
    courant_max : largest Courant number U dt/h of the step [-]
    """

    force: Array
    p_in: float
    reaction_error: float
    not_passed: float
    solids_error: float
    eps_g_min: float
    courant_max: float


@dataclass(frozen=True, kw_only=True)
class GasFields:
    """Gas fields after the last step; cells in the order x fastest, then y, then z.

    Attributes
    ----------
    eps_g : (nz, ny, nx) void fraction; p : (nz, ny, nx) gauge pressure [Pa]; U : (nz, ny, nx, 3) [m/s]
    """

    eps_g: Array
    p: Array
    U: Array


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


@dataclass(frozen=True, kw_only=True)
class DemStep:
    """Contacts during one coupling interval.

    Attributes
    ----------
    floor_force : force of the particles on the floor, time mean over the interval [N], positive downwards
    other_walls_force : vertical force of the particles on the side walls (friction) and the lid, likewise; what the
        momentum balance of the particles leaves for them
    contacts : number of particle-particle contacts (mean over the samples)
    overlap_max, overlap_mean : over the interval's samples of all particle-particle contacts [m]
    histogram : (bins,) counts of overlaps, summed over the samples; edges in `Dem.histogram_edges`
    watched : time in which new contacts were watched for [s]
    impacts : (2, bins) counts of the impact speeds of new contacts of two particles, and of a particle and a wall;
        edges in `Dem.impact_edges`
    impact_sums : (2, 3) sums over the same impacts of v [m/s], v² and v³
    """

    floor_force: float
    other_walls_force: float
    contacts: float
    overlap_max: float
    overlap_mean: float
    histogram: Array
    watched: float
    impacts: Array
    impact_sums: Array


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
