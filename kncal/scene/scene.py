"""A scene: what is simulated, said once, independent of any solver. SI units throughout, z is up.

The classes are the schema of a case file: each is a table of it, and each field a key, with the ranges of
`kncal.scene.values`. What values must satisfy together is in `kncal.scene.case_checks`.
"""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import replace
from functools import cached_property
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import Field

from kncal.core.errors import InputError
from kncal.physics.material import RANGES, Material
from kncal.scene.bodies import RIGID, Axis, Body, Particle, Wall
from kncal.scene.values import (
    Acceleration,
    Cells,
    Coordinate,
    Flag,
    Friction,
    GasDensity,
    GasSpeed,
    GasViscosity,
    Length,
    Name,
    Number,
    Option,
    Parcels,
    Position,
    Ramp,
    Restitution,
    Seconds,
    Share,
    Speed,
    Spin,
    Step,
    Stiffness,
    Text,
    Time,
    Tolerance,
    Velocity,
    Whole,
    Word,
    checked_class,
    within,
)
from kncal.scene.walls import WALLS, AnyWall, BoxWall, PlaneWall

#: Particles of one group, and most groups and walls of a scene.
MOST_PARTICLES, MOST_WALLS, MOST_PAIRS = 1_000_000, 20, 200
#: Particles of which each may touch each; every pair is planned and observed.
MOST_SINGLE = 100
#: Parcels that may share a particle's volume.
PARCELS = (1, 8, 27)
#: What bounds a box in y: walls, nothing (periodic), or nothing since particles are held in one layer.
Depth = Literal["walls", "periodic", "layer"]
AT_REST = (0.0, 0.0, 0.0)

_T = TypeVar("_T")
StepsPerContact = Annotated[Number, within(4.0, 1e6, hint="50 is usual")]


@checked_class
class MaterialData:
    """``[materials.NAME]``; the ranges are those of `kncal.physics.material.Material`."""

    young: Number = Field(description="Young's modulus [Pa]")
    poisson: Number = Field(description="Poisson's ratio [-]")
    density: Number = Field(description="density [kg/m³]")
    yield_strength: Number | None = Field(default=None, description="yield strength [Pa]")


@checked_class
class Particles:
    """``[particles.NAME]``: equal spheres; a single particle is a group of one."""

    material: Name = Field(description="the name of a material")
    diameter: Length = Field(description="diameter [m]")
    count: Annotated[Whole, within(0, MOST_PARTICLES)] | None = Field(
        default=None, description="number of particles; none: of the positions given; 0: gas only"
    )
    place: Word = Field(
        default="given",
        description='where they start: "given" (position, positions), "lattice" (a loose lattice from the floor up) or '
        '"settled" (LIGGGHTS settles that lattice under gravity)',
    )
    position: Position | None = Field(default=None, description="[x, y, z] of the centre of a single particle [m]")
    positions: Annotated[tuple[Position, ...], Field(max_length=MOST_PARTICLES)] = Field(
        default=(), description="[x, y, z] of the centre of each particle [m]"
    )
    velocity: Velocity = Field(default=AT_REST, description="[x, y, z] of the velocity at the start [m/s]")
    spin: Spin = Field(default=AT_REST, description="[x, y, z] of the angular velocity at the start [rad/s]")
    seed: Annotated[Whole, within(0, 2**31 - 1)] = Field(default=1, description="seed of the lattice's random offsets")
    settle_k_n: Stiffness | None = Field(
        default=None,
        description='stiffness of the spring by which "settled" particles settle [N/m]; none: of the linear run',
    )
    frozen: Flag = Field(default=False, description="true: the particles do not move")

    @property
    def centres(self) -> tuple[Position, ...]:
        """The positions that are given [m]."""
        return self.positions if self.position is None else (self.position,)

    @property
    def number(self) -> int:
        """Number of particles."""
        return len(self.centres) if self.count is None else self.count


@checked_class
class Jet:
    """``[gas.jet]``: a slot in the floor over the whole depth; gas enters through it only."""

    x_low: Coordinate = Field(description="lower end of the slot in x, on a cell face [m]")
    x_high: Coordinate = Field(description="upper end of the slot in x, on a cell face [m]")
    velocity: Annotated[Number, within(1e-6, 1e3, "m/s")] = Field(
        description="velocity of the gas in the slot, upwards [m/s]"
    )


@checked_class
class Gas:
    """``[gas]``: the gas in the box, its cells, and how it enters."""

    cells: Cells = Field(description="numbers of gas cells of the box in x, y and z")
    density: GasDensity = Field(description="density [kg/m³]")
    viscosity: GasViscosity = Field(description="dynamic viscosity [Pa s]")
    walls: Literal["slip", "noSlip"] = Field(default="slip", description='of the gas at the walls: "slip" or "noSlip"')
    U_0: GasSpeed = Field(default=0.0, description="superficial velocity over the whole floor [m/s]")
    ramp: Ramp = Field(
        default=(),
        description="[time [s], superficial velocity [m/s]] points, linear in between and constant outside",
    )
    jet: Jet | None = Field(default=None, description="[gas.jet] with x_low, x_high, velocity")
    drag: Word = Field(
        default="ErgunWenYu", description="drag law: ErgunWenYu, PlessisMasliyah, or one that a package adds"
    )
    parcels_per_particle: Parcels = Field(
        default=1, description="parcels that share a particle's volume, for cells near the particle's size: 1, 8 or 27"
    )

    def inlet_at(self, time: float) -> float:
        """Return the superficial velocity through the floor at ``time`` [s]: U_0 or the ramp's [m/s]; 0 with a jet."""
        if not self.ramp:
            return self.U_0
        times, velocities = zip(*self.ramp, strict=True)
        return float(np.interp(time, times, velocities))


@checked_class
class PairChoice:
    """``[[contact.pairs]]``: what differs for one pair."""

    between: tuple[Name, Name] = Field(description="two names of particles, walls or materials")
    e_n: Restitution | None = Field(default=None, description="normal restitution [-]")
    friction: Friction | None = Field(default=None, description="Coulomb friction coefficient [-]")
    v_0: Speed | None = Field(default=None, description="impact speed to calibrate at [m/s]")
    k_n: Stiffness | None = Field(default=None, description="prescribed linear stiffness [N/m]")


@checked_class
class MeasuredSpeed:
    """``[contact.measured]``: how the speed is measured with ``v_0 = "measured"`` (`kncal.runs.measure_speed`)."""

    statistic: Literal["energy_weighted", "mean", "p99"] = Field(
        default="energy_weighted", description='of the impact speeds: "energy_weighted" mean, "mean" or "p99"'
    )
    start: Speed | None = Field(default=None, description="first guess of v_0 [m/s]; none: the first impact's")
    run_time: Seconds | None = Field(
        default=None, description="end time of a measuring round [s]; none: as the case runs"
    )
    tolerance: Share = Field(default=0.02, description="relative change of k_n below which it has settled [-]")
    rounds: Annotated[Whole, within(1, 50)] = Field(default=6, description="most rounds")


@checked_class
class ContactChoice:
    """``[contact]``: the reference contact law and how its linear counterpart is found.

    ``measured`` is there where the case says ``v_0 = "measured"``: such a scene has no numbers before
    `kncal.runs.measure_speed.resolve_measured` puts a speed in its place. Of ``pairs`` the first match counts.
    """

    law: Word = Field(default="tsuji", description="reference contact law")
    e_n: Restitution = Field(default=1.0, description="normal restitution [-]")
    end: Literal["overlap", "force"] = Field(default="overlap", description='contact end: "overlap" or "force"')
    method: Word = Field(default="mean_overlap", description="how k_n is found")
    v_0: Speed | None = Field(
        default=None, description='impact speed to calibrate at [m/s], or "measured"; none: the first impact\'s'
    )
    measured: MeasuredSpeed | None = Field(default=None, description='[contact.measured], for v_0 = "measured"')
    k_n: Stiffness | None = Field(default=None, description="prescribed linear stiffness [N/m], in place of a method")
    friction: Friction = Field(default=0.0, description="Coulomb friction coefficient [-]")
    k_t_ratio: Annotated[Number, within(0.0, 10.0)] | None = Field(
        default=None, description="k_t/k_n of the linear contact [-]; none: the Mindlin ratio of the pair"
    )
    rolling_friction: Friction = Field(default=0.0, description="rolling friction coefficient [-]")
    options: dict[Name, Option] = Field(default_factory=dict, description="options of the method")
    pairs: Annotated[tuple[PairChoice, ...], Field(max_length=MOST_PAIRS)] = Field(
        default=(), description="exceptions for single pairs"
    )

    def exception(self, names_a: Container[str], names_b: Container[str]) -> PairChoice | None:
        """Return the first exception that names both bodies, each known by several names, or None."""
        for choice in self.pairs:
            one, two = choice.between
            if (one in names_a and two in names_b) or (two in names_a and one in names_b):
                return choice
        return None


@checked_class
class RunControl:
    """``[run]``: how long and how finely to run.

    With ``coupling``, particles (and gas) go on in intervals, and each is recorded; without, the solver runs once from
    start to end, and every contact is recorded step by step.
    """

    until_time: Seconds | None = Field(default=None, description="end time [s]")
    until_bounces: Annotated[Whole, within(1, 1000)] | None = Field(
        default=None,
        description="number of contacts; the run ends at the apex after the last (of the model that needs longer), or "
        "half way to a contact before it",
    )
    steps_per_contact: StepsPerContact = Field(
        default=50.0, description="steps per contact duration [-], the same meaning for every model"
    )
    dt: Step | None = Field(default=None, description="time step of all models [s]; none: from steps_per_contact")
    record_every: Annotated[Whole, within(1, 1e6)] = Field(
        default=1, description="steps between recorded frames during a contact"
    )
    coupling: Seconds | None = Field(
        default=None,
        description="coupling interval [s], rounded down to whole steps of each model; none: nothing is coupled",
    )
    gas_step: Seconds | None = Field(default=None, description="longest gas step [s]; none: one per coupling interval")
    discard: Time | None = Field(default=None, description="start-up left out of averages [s]; none: detected")
    frames_every: Seconds = Field(
        default=0.01, description="time between recorded frames of particles and gas fields of a coupled run [s]"
    )


@checked_class
class Scene:
    """A case: everything that a run needs to know, and nothing about the solver that will run it.

    ``name`` is also the folder's; a case file takes it from there. ``tolerances``: metric -> allowed relative
    difference of linear against Hertz. ``needs``: the user's decisions against `kncal.scene.needs`.
    """

    name: Name
    title: Text = Field(default="", description="one line: what the case is")
    source: Text = Field(default="", description="one line: where its parameters come from")
    materials: dict[Name, MaterialData] = Field(min_length=1, description="at least one [materials.NAME]")
    particles: dict[Name, Particles] = Field(
        min_length=1, max_length=MOST_SINGLE, description="at least one [particles.NAME]"
    )
    walls: dict[Name, AnyWall] = Field(default_factory=dict, max_length=MOST_WALLS, description="[walls.NAME]")
    gravity: Acceleration = Field(default=AT_REST, description="[x, y, z] of gravity [m/s²]")
    periodic: tuple[Axis, ...] = Field(default=(), description='axes in which a box is periodic: ["y"]')
    layer: Axis | None = Field(
        default=None,
        description='"y": one layer of particles, held in its plane; no walls in front and at the back',
    )
    gas: Gas | None = Field(default=None, description="[gas]; none: particles only")
    contact: ContactChoice = Field(default_factory=ContactChoice, description="[contact]")
    run: RunControl = Field(default_factory=RunControl, description="[run] with until_time or until_bounces")
    tolerances: dict[Word, Tolerance] = Field(default_factory=dict, description="metric = allowed relative difference")
    needs: dict[Word, Flag] = Field(default_factory=dict, description="physics = true or false")

    @classmethod
    def of(cls, spheres: Iterable[Particle], planes: Iterable[Wall] = (), **rest: Any) -> Scene:
        """Return the scene of these bodies, each a group or a wall of its own; ``rest``: the other fields.

        Raises
        ------
        InputError
            If two bodies or two different materials have one name, or a material has the one of rigid walls.
        """
        spheres, planes = tuple(spheres), tuple(planes)
        found: dict[str, Material] = {}
        bodies: tuple[Body, ...] = (*spheres, *planes)
        for material in (body.material for body in bodies):
            if material is not None and found.setdefault(material.name, material) != material:
                raise InputError(f"two different materials are called {material.name!r}: expected a name for each")
        if RIGID in found:
            raise InputError(f"a material is called {RIGID!r}, the name for a rigid wall: expected another name")
        names = [body.name for body in bodies]
        if twins := {name for name in names if names.count(name) > 1}:
            raise InputError(f"several bodies are called {sorted(twins)}: expected a name for each")
        return cls(
            materials={name: MaterialData(**{key: getattr(m, key) for key in RANGES}) for name, m in found.items()},
            particles={
                p.name: Particles(
                    material=p.material.name,
                    diameter=2.0 * p.radius,
                    position=p.position,
                    velocity=p.velocity,
                    spin=p.spin,
                )
                for p in spheres
            },
            walls={
                w.name: PlaneWall(axis=w.axis, position=w.position, material=w.material.name if w.material else RIGID)
                for w in planes
            },
            **rest,
        )

    def with_group(self, **changes: Any) -> Scene:
        """Return a coupled scene with changes of its group of particles."""
        group = replace(self.group, **changes)
        return replace(self, particles=dict.fromkeys(self.particles, group))

    def with_box(self, **changes: Any) -> Scene:
        """Return a coupled scene with changes of its box."""
        box = replace(self.box, **changes)
        return replace(self, walls=dict.fromkeys(self.walls, box))

    @property
    def coupled(self) -> bool:
        """Whether the run goes on in coupling intervals, with gas or without."""
        return self.run.coupling is not None

    @property
    def front_back(self) -> Depth:
        """What bounds the box in y; a layer is in the middle."""
        return "layer" if self.layer else "periodic" if self.periodic else "walls"

    def material(self, name: str) -> Material | None:
        """Return a material with its checks; None for a rigid wall's."""
        if name != RIGID and name not in self.materials:
            raise InputError(f"{self.name}: no material {name!r}: expected one of {', '.join(self.materials)}, {RIGID}")
        return None if name == RIGID else self._materials[name]

    @cached_property
    def _materials(self) -> dict[str, Material]:
        return {name: Material(name=name, **vars(data)) for name, data in self.materials.items()}

    @cached_property
    def spheres(self) -> tuple[Particle, ...]:
        """Every particle, in the order of the case file; of a coupled scene one per group that stands for all of it."""
        return tuple(sphere for name, group in self.particles.items() for sphere in self._of_group(name, group))

    def _of_group(self, name: str, group: Particles) -> tuple[Particle, ...]:
        centres = (AT_REST,) if self.coupled else group.centres
        if (material := self.material(group.material)) is None:
            raise InputError(f"{self.name}: particles.{name}.material = {RIGID!r}: expected a material")
        return tuple(
            Particle(
                name=name if len(centres) == 1 else f"{name}.{i}",
                group=name,
                material=material,
                radius=group.diameter / 2.0,
                position=position,
                velocity=group.velocity,
                spin=group.spin,
            )
            for i, position in enumerate(centres, start=1)
        )

    @cached_property
    def planes(self) -> tuple[Wall, ...]:
        """Every plane wall, in the order of the case file; a box stands as its floor."""
        return tuple(
            plane
            for name, wall in self.walls.items()
            for plane in WALLS[wall.shape].planes(name, wall, self.material(wall.material))
        )

    @property
    def bodies(self) -> tuple[Body, ...]:
        """Particles, then walls, in the order of the case file."""
        return (*self.spheres, *self.planes)

    def body_pairs(self) -> tuple[tuple[Particle, Body], ...]:
        """Every pair that may touch: particle–particle (i < j) and particle–wall."""
        spheres = self.spheres
        pairs: list[tuple[Particle, Body]] = [(a, b) for i, a in enumerate(spheres) for b in spheres[i + 1 :]]
        pairs += [(a, w) for a in spheres for w in self.planes]
        return tuple(pairs)

    def choice_for(self, a: Particle, b: Body) -> PairChoice | None:
        """Return the first exception of the case that names both bodies (or their group or materials), or None."""
        return self.contact.exception(a.names, b.names)

    @property
    def group(self) -> Particles:
        """The one group of particles of a coupled scene; `InputError` if there are several."""
        return _only(self.name, "group of particles", list(self.particles.values()))

    @property
    def box(self) -> BoxWall:
        """The one box of a coupled scene; `InputError` if there is none."""
        return _only(self.name, "box", [wall for wall in self.walls.values() if isinstance(wall, BoxWall)])

    @property
    def cells(self) -> Cells:
        """Gas cells of the box in x, y and z; one without gas."""
        return (1, 1, 1) if self.gas is None else self.gas.cells

    @property
    def drag(self) -> str:
        """Drag law; "" without gas."""
        return "" if self.gas is None else self.gas.drag

    def inlet_at(self, time: float) -> float:
        """Return the superficial gas velocity through the floor at ``time`` [s], see `Gas.inlet_at`; 0 without gas."""
        return 0.0 if self.gas is None else self.gas.inlet_at(time)

    @property
    def density(self) -> float:
        """Density of the particles of a coupled scene [kg/m³]."""
        return self.materials[self.group.material].density

    @property
    def g(self) -> float:
        """Size of gravity [m/s²]; of a coupled scene it points downwards."""
        return float(np.linalg.norm(self.gravity))


def _only(scene: str, what: str, found: list[_T]) -> _T:
    if len(found) != 1:
        raise InputError(f"{scene}: {len(found)} times a {what}: expected exactly one")
    return found[0]
