"""A scene: what is simulated, said once, independent of any solver. SI units throughout, z is up.

The classes are the schema of a case file: each is a table of it, and each field a key, with the ranges of
`kncal.scene.values`. What values must satisfy together is in `kncal.scene.case_checks`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field as stdlib_field
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from pydantic import Field

from kncal.core.checks import Array
from kncal.core.errors import CaseFileError, InputError
from kncal.physics.material import RANGES, Material
from kncal.scene.bodies import AXES, RIGID, Axis, Body, Particle, Vector, Wall
from kncal.scene.contact import ContactChoice, PairChoice
from kncal.scene.events import Event, events_of
from kncal.scene.extent import Bounds, extent_of
from kncal.scene.gas import Gas
from kncal.scene.groups import AT_REST, DomainBox, ObserveChoice, Outlet, Particles
from kncal.scene.population import FromFile, SizeClass, from_file, number_of
from kncal.scene.run_control import RunControl
from kncal.scene.sizes import Classes, classes, counts
from kncal.scene.values import (
    Acceleration,
    Cells,
    Flag,
    Name,
    Number,
    Text,
    Tolerance,
    Word,
    checked_class,
)
from kncal.scene.wall_motion import reach
from kncal.scene.walls import WALLS, AnyWall, BoxWall, MeshWall, PlaneWall

#: Most walls and outlets of a scene.
MOST_WALLS, MOST_OUTLETS = 20, 10
#: Particles of which each may touch each; every pair is planned and observed.
MOST_SINGLE = 100
#: Parcels that may share a particle's volume.
PARCELS = (1, 8, 27)
#: Where copies of a case keep the files that it names, beside the case.
FILES = "files"
#: What bounds a box in y: walls, nothing (periodic), or nothing since particles are held in one layer.
Depth = Literal["walls", "periodic", "layer"]

_T = TypeVar("_T")


@checked_class
class MaterialData:
    """``[materials.NAME]``; the ranges are those of `kncal.physics.material.Material`."""

    young: Number = Field(description="Young's modulus [Pa]")
    poisson: Number = Field(description="Poisson's ratio [-]")
    density: Number = Field(description="density [kg/m³]")
    yield_strength: Number | None = Field(default=None, description="yield strength [Pa]")


@checked_class
class Scene:
    """A case: everything that a run needs to know, and nothing about the solver that will run it.

    ``name`` is also the folder's; a case file takes it from there. ``tolerances``: metric -> allowed relative
    difference of linear against Hertz. ``needs``: the user's decisions against `kncal.scene.needs`. ``folder``: where
    the files lie that the case names; no part of its text.
    """

    name: Name
    title: Text = Field(default="", description="one line: what the case is")
    source: Text = Field(default="", description="one line: where its parameters come from")
    materials: dict[Name, MaterialData] = Field(min_length=1, description="at least one [materials.NAME]")
    particles: dict[Name, Particles] = Field(
        min_length=1, max_length=MOST_SINGLE, description="at least one [particles.NAME]"
    )
    walls: dict[Name, AnyWall] = Field(default_factory=dict, max_length=MOST_WALLS, description="[walls.NAME]")
    outlets: dict[Name, Outlet] = Field(default_factory=dict, max_length=MOST_OUTLETS, description="[outlets.NAME]")
    domain: DomainBox | None = Field(default=None, description="[domain]; none: what walls and starts need")
    gravity: Acceleration = Field(default=AT_REST, description="[x, y, z] of gravity [m/s²]")
    periodic: tuple[Axis, ...] = Field(default=(), description='axes in which a box or the domain is periodic: ["y"]')
    layer: Axis | None = Field(
        default=None,
        description='"y": one layer of particles, held in its plane; no walls in front and at the back',
    )
    gas: Gas | None = Field(default=None, description="[gas]; none: particles only")
    contact: ContactChoice = Field(default_factory=ContactChoice, description="[contact]")
    run: RunControl = Field(default_factory=RunControl, description="[run] with until_time or until_bounces")
    observe: ObserveChoice = Field(default_factory=ObserveChoice, description="[observe]")
    tolerances: dict[Word, Tolerance] = Field(default_factory=dict, description="metric = allowed relative difference")
    needs: dict[Word, Flag] = Field(default_factory=dict, description="physics = true or false")
    folder: Path | None = stdlib_field(default=None, compare=False, repr=False)

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

    def with_settled(self, **changes: Any) -> Scene:
        """Return the scene with changes of every group that settles before the run."""
        groups = {n: replace(g, **changes) if g.place == "settled" else g for n, g in self.particles.items()}
        return replace(self, particles=groups)

    def with_box(self, **changes: Any) -> Scene:
        """Return a coupled scene with changes of its box."""
        box = replace(self.box, **changes)
        return replace(self, walls=dict.fromkeys(self.walls, box))

    @property
    def coupled(self) -> bool:
        """Whether the run goes on in intervals, with gas or without: many particles, of which averages are told."""
        return self.interval is not None

    @property
    def interval(self) -> float | None:
        """The interval that the case asks for [s]: of the coupling, or of the looks at a run without gas."""
        return self.run.sample_every if self.run.coupling is None else self.run.coupling

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
    def classes(self) -> tuple[SizeClass, ...]:
        """The particles of each group by size, in the order of the case file."""
        return tuple(found for name, group in self.particles.items() for found in self._classes(name, group))

    def _classes(self, name: str, group: Particles) -> list[SizeClass]:
        given = len(group.centres)
        if group.file is not None:
            found, given = self.from_files[name].classes, len(self.from_files[name].kind)
        elif group.sizes is None:
            found = Classes(np.array([group.diameter or 0.0]), np.ones(1))
        else:
            found = classes(group.sizes, self.path_of, min([self.contact.e_n, *self._exceptional("e_n")]))
        number = number_of(group, given, found.volume, self.materials[group.material].density)
        numbers = counts(found.shares, number)
        several = len(found.diameters) > 1
        made = [
            SizeClass(group=name, name=f"{name}.{i}" if several else name, diameter=float(d), number=int(n))
            for i, (d, n) in enumerate(zip(found.diameters, numbers, strict=True), start=1)
        ]
        # a size of which there is no particle has no contacts; from a file each has its place
        return made if group.file is not None or not number else [c for c in made if c.number]

    @cached_property
    def from_files(self) -> Mapping[str, FromFile]:
        """Particles that start where a file says, by the name of their group; `ReadError` if one cannot be read."""
        e_n = min([self.contact.e_n, *self._exceptional("e_n")])
        return {
            name: from_file(self.path_of(group.file), group.diameter, e_n, group.scale)
            for name, group in self.particles.items()
            if group.file is not None
        }

    def _exceptional(self, key: str) -> list[float]:
        return [value for choice in self.contact.pairs if (value := getattr(choice, key)) is not None]

    @cached_property
    def spheres(self) -> tuple[Particle, ...]:
        """Every particle, in the order of the case file; of a coupled scene one for each size of a group."""
        if not self.coupled:
            return tuple(sphere for name, group in self.particles.items() for sphere in self._of_group(name, group))
        return tuple(self._sphere(c.name, c.group, c.diameter, AT_REST, self.particles[c.group]) for c in self.classes)

    def _of_group(self, name: str, group: Particles) -> Iterator[Particle]:
        several, diameter = len(group.centres) > 1, group.diameter or 0.0
        for i, position in enumerate(group.centres, start=1):
            yield self._sphere(f"{name}.{i}" if several else name, name, diameter, position, group)

    def _sphere(self, name: str, of: str, diameter: float, position: Vector, group: Particles) -> Particle:
        if (material := self.material(group.material)) is None:
            raise InputError(f"{self.name}: particles.{of}.material = {RIGID!r}: expected a material")
        return Particle(
            name=name,
            group=of,
            material=material,
            radius=diameter / 2.0,
            position=position,
            velocity=group.velocity,
            spin=group.spin,
            frozen=group.frozen,
        )

    @cached_property
    def planes(self) -> tuple[Wall, ...]:
        """Every plane wall, in the order of the case file; of a coupled scene a stand-in for each wall of any shape."""
        if self.coupled:
            return tuple(
                Wall(name=name, axis="z", position=0.0, material=self.material(wall.material))
                for name, wall in self.walls.items()
            )
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
    def number(self) -> int:
        """Number of particles, those included that a stream brings later."""
        return sum(c.number for c in self.classes)

    @property
    def d_min(self) -> float:
        """Smallest diameter [m]."""
        return min(c.diameter for c in self.classes)

    @property
    def d_max(self) -> float:
        """Largest diameter [m]."""
        return max(c.diameter for c in self.classes)

    @cached_property
    def diameter(self) -> float:
        """Sauter mean diameter of all particles [m]: that of each where all are equal."""
        if self.d_min == self.d_max or not self.number:
            return self.d_max
        d, n = np.array([(c.diameter, c.number) for c in self.classes]).T
        return float((n * d**3).sum() / (n * d**2).sum())

    @property
    def volume(self) -> float:
        """Volume of all particles [m³]."""
        return math.pi / 6.0 * sum(c.number * c.diameter**3 for c in self.classes)

    @property
    def mass(self) -> float:
        """Mass of all particles [kg]."""
        return sum(
            c.number * math.pi / 6.0 * c.diameter**3 * self.materials[self.particles[c.group].material].density
            for c in self.classes
        )

    @property
    def density(self) -> float:
        """Mean density of the particles of a coupled scene [kg/m³]."""
        found = {self.materials[group.material].density for group in self.particles.values()}
        return found.pop() if len(found) == 1 else self.mass / self.volume

    @property
    def frozen(self) -> bool:
        """Whether no particle moves."""
        return all(group.frozen for group in self.particles.values())

    @property
    def held(self) -> tuple[str, ...]:
        """Groups that are frozen beside others that move, as the rough base of a chute."""
        return () if self.frozen else tuple(name for name, group in self.particles.items() if group.frozen)

    @property
    def settles(self) -> bool:
        """Whether particles settle before the run."""
        return any(group.place == "settled" and group.count != 0 for group in self.particles.values())

    @property
    def presses(self) -> bool:
        """Whether what settles is pressed together: without gravity, in a box that is periodic in every axis."""
        return self.settles and not self.g and len(set(self.periodic)) == len(AXES)

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
    def g(self) -> float:
        """Size of gravity [m/s²]."""
        return float(np.linalg.norm(self.gravity))

    @property
    def up(self) -> Array:
        """Unit vector against gravity; z without gravity."""
        return np.array([0.0, 0.0, 1.0]) if not self.g else -np.array(self.gravity) / self.g

    @property
    def open_axes(self) -> str:
        """The axes on which a box has no sides: periodic ones, and a layer's; as "xy"."""
        return "".join(self.periodic) + (self.layer or "")

    @cached_property
    def extent(self) -> Bounds:
        """Lower and upper corner of what is simulated [m]: the domain, or what walls, their ways and starts need."""
        domain = None if self.domain is None else (np.array(self.domain.low), np.array(self.domain.high))
        end, radius = self.run.until_time or 0.0, 0.5 * self.d_min
        things = [reach(wall, end, path_of=self.path_of, radius=radius) for wall in self.walls.values()]
        things += [group.bounds for group in self.particles.values()]
        things += [(found.particles.x.min(axis=0), found.particles.x.max(axis=0)) for found in self.from_files.values()]
        things += [outlet.bounds for outlet in self.outlets.values()]
        return extent_of(domain, things, map(AXES.index, self.periodic), self.d_max)

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """What changes during the run, by time."""
        return tuple(sorted(event for name, wall in self.walls.items() for event in events_of(name, wall)))

    @property
    def files(self) -> tuple[str, ...]:
        """The files that the case names, each once."""
        named = [wall.file for wall in self.walls.values() if isinstance(wall, MeshWall)]
        for group in self.particles.values():
            named += [group.file] if group.file else []
            named += [group.sizes.sieve.file] if group.sizes and group.sizes.sieve else []
        return tuple(sorted(set(named)))

    def path_of(self, name: str) -> Path:
        """Return where a file that the case names lies; `CaseFileError` if it is not in the folder of the case."""
        home = (self.folder or Path()).resolve()
        for path in (home / name, home / FILES / name):
            if path.is_file() and home in path.resolve().parents:
                return path
        raise CaseFileError(f"{self.name}: no file {name!r} in the folder of the case, {home}")


def _only(scene: str, what: str, found: list[_T]) -> _T:
    if len(found) != 1:
        raise InputError(f"{scene}: {len(found)} times a {what}: expected exactly one")
    return found[0]
