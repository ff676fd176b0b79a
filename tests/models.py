"""Models made by hand for tests: the numbers of a contact straight from its parameters, without calibration."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any

from kncal.physics.material import Material, pair, sphere_mass, wall_pair
from kncal.scene.bodies import Axis, Particle, Vector, Wall
from kncal.scene.model import PairContact, Plan
from kncal.scene.needs import decide
from kncal.scene.scene import Scene
from kncal.scene.species import SpeciesPair, species_of

GLASS = Material(young=5e6, poisson=0.25, density=2500.0, name="soft-glass")
R = 1e-3


def damping_ratio(e_n: float) -> float:
    """zeta of the linear contact that ends at zero overlap, also C/sqrt(5) of the Tsuji law."""
    return -math.log(e_n) / math.hypot(math.log(e_n), math.pi)


def contact(
    a: Particle,
    b: Particle | Wall,
    kind: str,
    *,
    e_n: float,
    k_n: float,
    friction: float,
    end: str,
    damping_t: str = "none",
    law: str = "tsuji",
) -> PairContact:
    """A linear (k_n) or a Hertz contact (from the materials) with the damping of the overlap end.

    ``damping_t``: tangentially "none", the "same" damping ratio as normally, or "half" the coefficient. ``law``: of
    the Hertz contact, "tsuji" or "kuwabara_kono".
    """
    if isinstance(b, Wall):
        both = wall_pair(a.material, a.radius, b.material)
    else:
        both = pair(a.material, a.radius, b.material, b.radius)
    m, zeta = float(both.m_eff), damping_ratio(e_n)
    linear = kind == "linear"
    k = k_n if linear else float(both.k_h)
    k_t = float(both.k_t_ratio) * k if linear else 8.0 * float(both.G_eff) * math.sqrt(float(both.R_eff))
    p = 0.0 if linear else {"tsuji": 0.25, "kuwabara_kono": 0.5}[law]
    # the second is about as strong at overlaps of some 0.01 mm
    c = (2.0 if linear else math.sqrt(5.0) if law == "tsuji" else 50.0) * zeta * math.sqrt(k * m)
    tangent = k if linear else 2.0 * float(both.E_eff) * math.sqrt(float(both.R_eff))
    return PairContact(
        law="linear" if linear else law,
        k=k,
        n=1.0 if linear else 1.5,
        c=c,
        p=p,
        end=end,
        e_n=e_n,
        v_0=None if linear else 1.0,
        t_c=math.pi * math.sqrt(m / k) if linear else 3.218 * (m * m / (k * k)) ** 0.2,
        delta_max=None,
        m_eff=m,
        R_eff=float(both.R_eff),
        E_eff=float(both.E_eff),
        G_eff=float(both.G_eff),
        friction=friction,
        rolling_friction=0.0,
        k_t=k_t,
        c_t={"none": 0.0, "same": c * math.sqrt(k_t / tangent), "half": 0.5 * c}[damping_t],
    )


def model(
    scene: Scene,
    kind: str,
    *,
    t_end: float,
    steps_per_contact: float = 50.0,
    e_n: float | Mapping[tuple[str, str], float] = 1.0,
    k_n: float = 1000.0,
    friction: float = 0.0,
    end: str = "overlap",
    damping_t: str = "none",
    law: str = "tsuji",
    flight_every: int = 20,
    record_every: int = 1,
) -> Plan:
    """A model of ``scene`` whose dt is the shortest contact duration over ``steps_per_contact``."""
    contacts: dict[SpeciesPair, PairContact] = {}
    species = species_of(scene)
    for a, b in scene.body_pairs():
        names = (a.name, b.name)
        e = e_n if isinstance(e_n, float) else e_n[names]
        contacts[species.pair_of(names)] = contact(
            a, b, kind, e_n=e, k_n=k_n, friction=friction, end=end, damping_t=damping_t, law=law
        )
    dt = min(c.t_c for c in contacts.values()) / steps_per_contact
    return Plan(
        scene=scene,
        kind=kind,
        needs=decide(scene),
        contacts=contacts,
        dt=dt,
        t_end=t_end,
        n_steps=math.ceil(t_end / dt),
        record_every=record_every,
        flight_every=flight_every,
    )


def finer(given: Plan, factor: float) -> Plan:
    """The same model with a time step ``factor`` times smaller."""
    dt = given.dt / factor
    return dataclasses.replace(given, dt=dt, n_steps=math.ceil(given.t_end / dt))


def head_on(speed: float = 1.0, gap: float = 1.7e-5, radius_2: float = R, axis: int = 0) -> Scene:
    """Two beads that meet with relative ``speed``, momentum zero only if they are equal."""
    x: list[float] = [0.0, 0.0, 0.0]
    v: list[float] = [0.0, 0.0, 0.0]
    x[axis], v[axis] = R + radius_2 + gap, -speed / 2.0
    return Scene.of(
        name="head_on",
        spheres=(
            Particle(
                name="a",
                material=GLASS,
                radius=R,
                position=(0.0, 0.0, 0.0),
                velocity=_vector([-c for c in v]),
            ),
            Particle(name="b", material=GLASS, radius=radius_2, position=_vector(x), velocity=_vector(v)),
        ),
    )


def on_wall(
    *,
    gap: float = 1.7e-5,
    velocity: Vector = (0.0, 0.0, -1.0),
    gravity: float = 0.0,
    axis: Axis = "z",
    spin: Vector = (0.0, 0.0, 0.0),
) -> Scene:
    """One bead above a wall of the same material at 0 on ``axis``; gravity points into the wall."""
    index = "xyz".index(axis)
    x, g = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
    x[index], g[index] = R + gap, -gravity
    return Scene.of(
        name="on_wall",
        spheres=(Particle(name="bead", material=GLASS, radius=R, position=_vector(x), velocity=velocity, spin=spin),),
        planes=(Wall(name="floor", axis=axis, position=0.0, material=GLASS),),
        gravity=_vector(g),
    )


def with_bodies(
    scene: Scene, spheres: Iterable[Particle] | None = None, planes: Iterable[Wall] | None = None, **changes: Any
) -> Scene:
    """The same scene with other spheres or planes."""
    rest = {f.name: getattr(scene, f.name) for f in dataclasses.fields(scene)}
    for key in ("materials", "particles", "walls"):
        del rest[key]
    return Scene.of(
        scene.spheres if spheres is None else spheres, scene.planes if planes is None else planes, **(rest | changes)
    )


def mass(particle: Particle) -> float:
    """Mass of a particle [kg]."""
    return float(sphere_mass(particle.material, particle.radius))


def _vector(values: list[float]) -> Vector:
    x, y, z = values
    return (x, y, z)
