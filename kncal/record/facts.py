"""What stays the same during the run of a bed and is needed to understand its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from kncal.core.checks import Array
from kncal.physics.material import sphere_mass
from kncal.scene.bodies import Axis, Vector
from kncal.scene.model import Plan
from kncal.scene.scene import Depth, Scene
from kncal.scene.values import Cells, Flag, Length, Number, Position, Seconds, Size, Whole, Word, checked_class
from kncal.scene.walls import BoxWall

#: Intervals of height in which forces on walls are recorded.
HEIGHTS = 20

_Index = Annotated[Whole, Field(ge=0)]


@checked_class
class BedFacts:
    """What stays the same during a run and is needed to understand its numbers.

    Attributes
    ----------
    name : of the scene; kind : "linear" or "hertz"
    size : box (x, y, z) [m]; cells : gas cells per axis; front_back : what bounds it in y
    low : lower corner of the box [m]; periodic : axes in which it is; up : unit vector against gravity
    count : particles that will ever be there; diameter : of all, else their Sauter mean [m]
    density : of the particles, else their mean [kg/m³]; gravity : its size [m/s²]
    groups, radii, masses, numbers : (species,) of each species of particles: its group, radius [m], mass of one [kg],
        and how many there will ever be
    pairs : pairs of species that may touch; numbers from that of species of particles on are those of walls
    walls, outlets : names of the walls whose forces are recorded, and of the planes that count particles
    gas_density : [kg/m³], 0 without gas
    jet : whether the gas enters through a jet, so that ``p_in`` is the pressure at its slot only
    coupling : interval between couplings [s]
    driven_until : when the last wall stops moving, or goes [s]; 0: no wall does
    histogram_edges : (bins + 1,) edges of the overlap histogram [m]
    impact_edges : (bins + 1,) edges of the histograms of impact speeds [m/s]; empty: they were not recorded
    """

    name: Word
    kind: Word
    size: Size
    cells: Cells
    front_back: Depth
    low: Position
    periodic: tuple[Axis, ...]
    up: tuple[Number, Number, Number]
    count: _Index
    diameter: Length
    density: Number
    gravity: Number
    groups: tuple[Word, ...]
    radii: tuple[Length, ...]
    masses: tuple[Number, ...]
    numbers: tuple[_Index, ...]
    pairs: tuple[tuple[_Index, _Index], ...]
    walls: tuple[Word, ...]
    outlets: tuple[Word, ...]
    gas_density: Number
    jet: Flag
    coupling: Seconds
    driven_until: Annotated[Number, Field(ge=0.0)] = 0.0
    histogram_edges: Annotated[tuple[Number, ...], Field(min_length=2)]
    impact_edges: tuple[Number, ...] = ()

    @property
    def impact_bins(self) -> int:
        """Number of bins of the histograms of impact speeds, 0 where they were not recorded."""
        return max(len(self.impact_edges) - 1, 0)

    @property
    def floor_area(self) -> float:
        """Area of the floor [m²]."""
        return self.size[0] * self.size[1]

    @property
    def mass(self) -> float:
        """Mass of all particles that will ever be there [kg]."""
        return float(np.array(self.numbers) @ np.array(self.masses))

    @property
    def weight(self) -> float:
        """Their weight [N]."""
        return self.mass * self.gravity

    @property
    def heights(self) -> Array:
        """Edges (`HEIGHTS` + 1,) of equal intervals of height, along ``up``, over the whole box [m]."""
        return heights(self.low, self.size, self.up)


def heights(low: Sequence[float], size: Sequence[float], up: Sequence[float]) -> Array:
    """Return edges (`HEIGHTS` + 1,) [m] along the unit vector ``up`` over a box of ``size`` [m] from ``low`` [m] on."""
    begin = float(np.dot(low, up)) + float(np.minimum(np.multiply(size, up), 0.0).sum())
    return np.asarray(np.linspace(begin, begin + float(np.abs(np.multiply(size, up)).sum()), HEIGHTS + 1))


def room(scene: Scene) -> tuple[Vector, Vector]:
    """Return lower corner and size of the box that is a scene's only wall, or of all that is simulated [m]."""
    if len(scene.walls) == 1 and isinstance(box := next(iter(scene.walls.values())), BoxWall):
        return box.low, box.size
    low, high = scene.extent
    (x, y, z), (width, depth, height) = low.tolist(), (high - low).tolist()
    return (x, y, z), (width, depth, height)


def driven_until(scene: Scene, t_end: float) -> float:
    """Return until when walls move, go away, or are belts [s], at most ``t_end``."""
    found = [0.0]
    for wall in scene.walls.values():
        found += [t_end] if any(wall.surface_velocity) else []
        found += [min(t_end if motion.stop is None else motion.stop, t_end) for motion in wall.motion]
        found += [] if wall.remove_at is None else [min(wall.remove_at, t_end)]
    return max(found)


def bed_facts(model: Plan, histogram_edges: Array, impact_edges: Array, walls: Sequence[str] = ()) -> BedFacts:
    """Collect the facts of a model.

    ``histogram_edges`` (bins + 1,) [m] as the particle side counts overlaps; ``impact_edges`` (bins + 1,) [m/s] as it
    counts impact speeds, empty where it does not; ``walls``: names of those whose forces it records.
    """
    scene, kinds = model.scene, model.scene.spheres
    low, size = room(scene)
    x, y, z = scene.up.tolist()
    return BedFacts(
        name=scene.name,
        kind=model.kind,
        size=size,
        cells=scene.cells,
        front_back=scene.front_back,
        low=low,
        periodic=scene.periodic,
        up=(x, y, z),
        count=scene.number,
        diameter=scene.diameter,
        density=scene.density,
        gravity=scene.g,
        groups=tuple(body.group or body.name for body in kinds),
        radii=tuple(body.radius for body in kinds),
        masses=tuple(float(sphere_mass(body.material, body.radius)) for body in kinds),
        numbers=tuple(found.number for found in scene.classes),
        pairs=tuple(model.species.pairs()),
        walls=tuple(walls),
        outlets=tuple(scene.outlets),
        gas_density=scene.gas.density if scene.gas else 0.0,
        jet=bool(scene.gas and scene.gas.jet),
        coupling=model.coupling,
        driven_until=driven_until(scene, model.t_end),
        histogram_edges=tuple(float(edge) for edge in histogram_edges),
        impact_edges=tuple(float(edge) for edge in impact_edges),
    )
