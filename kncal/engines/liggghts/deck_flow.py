"""Particles that come and go, in LIGGGHTS' words: streams that it inserts, outlets that count and delete."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.core.templating import checked_name, number
from kncal.scene.bodies import AXES, Vector
from kncal.scene.groups import BoxRegion, CylinderRegion
from kncal.scene.model import Plan
from kncal.scene.shapes import Bounds, faces
from kncal.scene.wall_motion import when
from kncal.scene.walls import PlaneWall

#: LIGGGHTS takes primes above 10 000 as seeds, and different ones.
LEAST_SEED, MOST_SEED = 100_000, 100_000_000


def primes(seed: Sequence[int], count: int) -> list[int]:
    """Return ``count`` different primes that LIGGGHTS takes as seeds; the same for the same ``seed``."""
    rng = np.random.default_rng(list(seed))
    found: list[int] = []
    while len(found) < count:
        candidate = int(rng.integers(LEAST_SEED, MOST_SEED)) | 1
        while not _is_prime(candidate):
            candidate += 2
        if candidate not in found:
            found.append(candidate)
    return found


def _is_prime(odd: int) -> bool:
    divisors = np.arange(3, math.isqrt(odd) + 1, 2)
    return bool((odd % divisors != 0).all())


@dataclass(frozen=True, kw_only=True)
class SizeOf:
    """Particles of one size in a stream: index of the atom type, radius [m], density [kg/m³], share by number."""

    kind: int
    radius: float
    density: float
    share: float


@dataclass(frozen=True, kw_only=True)
class DeckStream:
    """A group that LIGGGHTS inserts.

    Attributes
    ----------
    name : of the group
    place : of the stream among those of the scene, from 1
    sizes : of its particles
    region : where they appear
    total : number of them; rate [kg/s]; velocity [m/s]
    first : step of the first insertion; every : steps from one to the next; each : mean number that one brings
    seed : the user's
    """

    name: str
    place: int
    sizes: tuple[SizeOf, ...]
    region: BoxRegion | CylinderRegion
    total: int
    rate: float
    velocity: Vector
    first: int
    every: int
    each: float
    seed: int

    @property
    def fix(self) -> str:
        """Id of the command that inserts."""
        return f"stream_{self.place}"

    def lines(self, *, by_hand: bool) -> list[str]:
        """Return the commands of the stream: by hand LIGGGHTS inserts by itself, else kncal asks for it each time."""
        region, distribution, insertion, *seeds = primes((self.seed, self.place), 3 + len(self.sizes))
        lines = [
            f"fix           {name} all particletemplate/sphere {seed} atom_type {size.kind + 1} "
            f"density constant {number(size.density)} radius constant {number(size.radius)}"
            for name, seed, size in zip(self._templates, seeds, self.sizes, strict=True)
        ]
        lines += self._source(region, distribution)
        if by_hand:
            rate = f"massrate {number(self.rate)} insert_every {self.every} start {self.first}"
            lines.append(self._insertion(insertion, self.total, rate))
        return lines

    def number_by(self, step: int) -> int:
        """Return how many particles have come when ``step`` is done."""
        return min(self.total, round(max(0, (step - self.first) // self.every + 1) * self.each))

    def insert_lines(self, step: int, dt: float, *, again: bool) -> list[str]:
        """Return the commands that insert in the step after ``step``, of ``dt`` [s], what is due there.

        No restart holds all random numbers of a stream, so that each insertion is made of new ones. ``again``: there
        was an insertion before. Empty if nothing is due.
        """
        due = self.number_by(step + 1) - self.number_by(step)
        if not due:
            return []
        region, distribution, insertion = primes((self.seed, self.place, step + 1), 3)
        off = [*([self.fix] if again else []), f"sizes_{self.place}"]
        # Half a particle more, so that LIGGGHTS' random rounding reaches the number that it may not exceed.
        rate = f"particlerate {number((due + 0.5) / (self.every * dt))} insert_every {self.every} start {step + 1}"
        return [
            *(f"unfix {name}" for name in off),
            f"region {self.fix} delete",
            *self._source(region, distribution),
            self._insertion(insertion, due, rate),
        ]

    @property
    def _templates(self) -> list[str]:
        return [f"size_{self.place}_{i}" for i, _ in enumerate(self.sizes, start=1)]

    def _source(self, region: int, distribution: int) -> list[str]:
        """Where the particles appear, and which, with two seeds."""
        shares = " ".join(
            f"{name} {number(size.share)}" for name, size in zip(self._templates, self.sizes, strict=True)
        )
        return [
            f"region        {self.fix} {self._region} units box seed {region}",
            f"fix           sizes_{self.place} all particledistribution/discrete/numberbased {distribution} "
            f"{len(self.sizes)} {shares}",
        ]

    def _insertion(self, seed: int, most: int, rate: str) -> str:
        velocity = " ".join(map(number, self.velocity))
        return (
            f"fix           {self.fix} all insert/rate/region seed {seed} distributiontemplate sizes_{self.place} "
            f"nparticles {most} {rate} overlapcheck yes all_in yes random_distribute exact "
            f"vel constant {velocity} region {self.fix}"
        )

    @property
    def _region(self) -> str:
        if isinstance(self.region, BoxRegion):
            sides = zip(self.region.low, self.region.high, strict=True)
            return "block " + " ".join(f"{number(low)} {number(high)}" for low, high in sides)
        one, two = self.region.centre
        values = (one, two, self.region.radius, self.region.low, self.region.high)
        return f"cylinder {self.region.axis} {' '.join(map(number, values))}"


def deck_streams(plan: Plan) -> list[DeckStream]:
    """Return the streams of a scene."""
    scene = plan.scene
    streams: list[DeckStream] = []
    for name, group in scene.particles.items():
        if group.place != "stream" or group.rate is None or group.region is None:
            continue
        classes = [c for c in scene.classes if c.group == name and c.number]
        total = sum(c.number for c in classes)
        density = float(scene.materials[group.material].density)
        mass = density * math.pi / 6.0 * sum(c.number * c.diameter**3 for c in classes) / max(total, 1)
        # Insertions are at the begin of an interval, and bring one particle at least.
        intervals = max(1, math.ceil(mass / (group.rate * plan.coupling)))
        streams.append(
            DeckStream(
                name=name,
                place=len(streams) + 1,
                sizes=tuple(
                    SizeOf(
                        kind=plan.species.index[c.name],
                        radius=0.5 * c.diameter,
                        density=density,
                        share=c.number / total,
                    )
                    for c in classes
                ),
                region=group.region,
                total=total,
                rate=group.rate,
                velocity=group.velocity,
                first=1 + round(when(group.start, plan.coupling) / plan.dt),
                every=intervals * plan.steps_per_coupling,
                each=group.rate * intervals * plan.coupling / mass,
                seed=group.seed,
            )
        )
    return streams


@dataclass(frozen=True, kw_only=True)
class DeckOutlet:
    """An outlet: ``fix`` is the id of the command that counts, [1] mass, [2] number; ``triangles``: its plane."""

    name: str
    place: int
    axis: str
    direction: int
    deletes: bool
    triangles: Array

    @property
    def fix(self) -> str:
        """Id of the command that counts."""
        return f"outlet_{self.place}"

    @property
    def file(self) -> str:
        """Name of the file of its triangles."""
        return f"outlet_{checked_name(self.name)}.stl"

    def lines(self) -> Iterator[str]:
        """Yield the commands of the outlet."""
        side = " ".join(str(self.direction * (axis == self.axis)) for axis in AXES)
        yield f"fix           plane_{self.place} all mesh/surface/planar file {self.file} type 1"
        yield (
            f"fix           {self.fix} all massflow/mesh mesh plane_{self.place} vec_side {side} count "
            f"{'once delete_atoms yes' if self.deletes else 'multiple'}"
        )


def deck_outlets(plan: Plan, box: Bounds) -> list[DeckOutlet]:
    """Return the outlets of a scene, each a plane over all of the ``box``."""
    return [
        DeckOutlet(
            name=name,
            place=place,
            axis=outlet.axis,
            direction=outlet.direction,
            deletes=outlet.delete,
            triangles=faces(
                PlaneWall(axis=outlet.axis, position=outlet.position, material="rigid"),
                path_of=plan.scene.path_of,
                extent=box,
            ),
        )
        for place, (name, outlet) in enumerate(plan.scene.outlets.items(), start=1)
    ]
