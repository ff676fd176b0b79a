"""A bed: particles in a box column with gas from below. Said once, independent of any solver. SI units, z is up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from kncal.physics.material import Material
from kncal.scene.scene import ContactChoice, PairChoice, Particle, Wall, names_of

#: What bounds the bed in y: walls, periodic, or one layer of particles held in its plane (no front and back walls).
DEPTHS = ("walls", "periodic", "layer")
#: Drag laws of stock DPMFoam (names of OpenFOAM v1912 without "Drag").
#: Where the particles start: settled by a run of their own, on a loose lattice, or where the case says.
PACKINGS = ("settled", "lattice", "given")
#: The two kinds of bodies in a bed: their names in plans, and in the exceptions of a case.
PARTICLES, WALLS = "particles", "walls"
#: Parcels that may share a particle's volume.
PARCELS = (1, 8, 27)


@dataclass(frozen=True, kw_only=True)
class Column:
    """The box 0 … width (x), 0 … depth (y), 0 … height (z), and its gas cells.

    Attributes
    ----------
    width, depth, height : [m]
    cells : number of gas cells in x, y, z
    front_back : one of `DEPTHS`
    wall_material : of side walls, floor and lid; None: rigid
    gas_walls : "slip" or "noSlip"
    """

    width: float
    depth: float
    height: float
    cells: tuple[int, int, int]
    front_back: str = "walls"
    wall_material: Material | None = None
    gas_walls: str = "slip"


@dataclass(frozen=True, kw_only=True)
class Jet:
    """A slot in the floor over the whole depth: gas enters through it only.

    Attributes
    ----------
    x_low, x_high : the slot's ends, on cell faces [m]
    velocity : of the gas in the slot, upwards [m/s]
    """

    x_low: float
    x_high: float
    velocity: float


@dataclass(frozen=True, kw_only=True)
class Gas:
    """The gas and how it enters.

    Attributes
    ----------
    density [kg/m³], viscosity (dynamic) [Pa s]
    U_0 : superficial velocity over the whole floor [m/s]; 0 with a jet
    ramp : (time [s], U_0 [m/s]) pairs for a velocity that changes, linear in between and constant outside; the loop
        asks `inlet_at` before each gas step; empty: constant ``U_0``
    jet : Jet or None
    drag : one of `kncal.physics.drag.DRAGS`
    parcels_per_particle : 1, 8 or 27: parcels that share a particle's volume, for cells near the particle's size
    """

    density: float
    viscosity: float
    U_0: float = 0.0
    ramp: tuple[tuple[float, float], ...] = ()
    jet: Jet | None = None
    drag: str = "ErgunWenYu"
    parcels_per_particle: int = 1

    def inlet_at(self, time: float) -> float:
        """Return the superficial velocity through the floor at ``time`` [s]: U_0 or the ramp's [m/s]; 0 with a jet."""
        if not self.ramp:
            return self.U_0
        times, velocities = zip(*self.ramp, strict=True)
        return float(np.interp(time, times, velocities))


@dataclass(frozen=True, kw_only=True)
class BedParticles:
    """Equal spheres.

    Attributes
    ----------
    count : number; 0: gas only
    diameter : [m]
    material : Material
    packing : "settled" (LIGGGHTS settles a loose lattice under gravity), "lattice" (loose lattice, as placed), or
        "given" (``positions``)
    positions : (x, y, z) per particle [m], for packing "given"
    settle_k_n : of the spring by which "settled" particles settle [N/m], whatever contact they have in the run; None:
        by that of the linear run
    seed : of the lattice's small random offsets
    frozen : particles do not move (packed bed below fluidisation)
    """

    count: int
    diameter: float
    material: Material
    packing: str = "settled"
    positions: tuple[tuple[float, float, float], ...] = ()
    settle_k_n: float | None = None
    seed: int = 1
    frozen: bool = False


@dataclass(frozen=True, kw_only=True)
class BedRun:
    """How long and how finely.

    Attributes
    ----------
    end_time : [s]
    discard : start-up left out of averages [s]; None: detected
    steps_per_contact : DEM steps per contact duration
    coupling : coupling interval [s]; rounded down to a whole number of DEM steps of each model
    gas_step : longest gas step [s]; None: one per coupling interval
    frames_every : time between recorded frames (particles and gas fields) [s]
    """

    end_time: float
    discard: float | None = None
    steps_per_contact: float = 50.0
    coupling: float
    gas_step: float | None = None
    frames_every: float = 0.01


@dataclass(frozen=True, kw_only=True)
class BedScene:
    """Everything that a coupled run needs to know, and nothing about the solvers.

    ``contact`` as in `kncal.scene.scene.Scene`; its ``pairs`` name "particles" and "walls".
    ``tolerances``: metric -> allowed relative difference of linear against Hertz.
    """

    name: str
    title: str = ""
    source: str = ""
    column: Column
    particles: BedParticles
    gas: Gas | None
    gravity: float = 9.81
    contact: ContactChoice = field(default_factory=ContactChoice)
    run: BedRun
    tolerances: Mapping[str, float] = field(default_factory=dict)
    overrules: Mapping[str, bool] = field(default_factory=dict)

    @property
    def bodies(self) -> tuple[Particle | Wall, ...]:
        """A particle and a wall that stand for all of them."""
        p = self.particles
        one = Particle(name=PARTICLES, material=p.material, radius=p.diameter / 2.0, position=(0.0, 0.0, 0.0))
        return one, Wall(name=WALLS, axis="z", position=0.0, material=self.column.wall_material)

    def choice_for(self, a: Particle, b: Particle | Wall) -> PairChoice | None:
        """Return the first exception of the case that names both bodies (or their materials), or None."""
        return self.contact.exception(names_of(a), names_of(b))
