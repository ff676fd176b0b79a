"""Small scenes made from a case's materials and contact, each with one question.

*Pressed* probes rest in equilibrium, pressed together by walls (or by gravity), and are nudged a little: an unstable
iteration lets the nudge grow from step to step, however slowly, so that they show the stability limit proper. *Impact*
probes meet once, within a few steps at the edge: too short for an instability to grow, they show what a user sees
(restitution, energy, passing through).

Friction is left out of all of them but a packing that sticks: its springs add to the stiffness that the formula knows
of.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.physics.material import Material
from kncal.scene.bodies import AXES, Axis, Particle, Vector, Wall
from kncal.scene.contact import ContactChoice, PairChoice
from kncal.scene.model import PairContact, Plan
from kncal.scene.plan import first_impact_speed, plan
from kncal.scene.run_control import RunControl
from kncal.scene.scene import Scene

#: Overlap of a pressed cluster over the diameter. Small, since squeezed spheres without friction buckle sideways, at
#: sqrt(overlap/d) of the frequency of the springs; the stiffness of a linear contact does not care.
PRESSED_SHARE = 1e-6
#: The nudge of a pressed probe over omega times the overlap: small enough to grow by a factor of 1e4 before a contact
#: opens.
NUDGE = 1e-4
#: Gravity that a case may have [m/s²] (see `kncal.scene.values`), but for a margin.
STRONGEST = 9e4
#: Spheres side by side in an impact on a wall: as many sub-step phases of first touch.
ABREAST = 8
_SIGNS = (-1.0, 0.0, 1.0)
#: Number of contacts at once -> directions of the neighbours of one sphere (not of unit length).
DIRECTIONS: dict[int, tuple[Vector, ...]] = {
    2: ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)),
    4: ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)),
    6: tuple((x, y, z) for x, y, z in product(_SIGNS, repeat=3) if abs(x) + abs(y) + abs(z) == 1.0),
    8: tuple((x, y, z) for x, y, z in product((-1.0, 1.0), repeat=3)),
    # the nearest neighbours in the fcc lattice: they touch one another, too
    12: tuple((x, y, z) for x, y, z in product(_SIGNS, repeat=3) if abs(x) + abs(y) + abs(z) == 2.0),
}
#: What the probes leave out of a contact.
_SMOOTH = ("friction", "rolling_friction", "cohesion_energy_density")


@dataclass(frozen=True, kw_only=True)
class Ingredients:
    """What probes are made from.

    Attributes
    ----------
    name : of the case
    material, radius : of its first particle; radius in m
    wall : material of its first wall, None: rigid
    contact : of the case, without friction and with ``v_0`` [m/s]
    steps_per_contact : of the case
    notes : what of the case the probes leave out
    """

    name: str
    material: Material
    radius: float
    wall: Material | None
    contact: ContactChoice
    steps_per_contact: float
    notes: tuple[str, ...] = ()

    @property
    def v_0(self) -> float:
        """Impact speed that the contacts are calibrated at [m/s]."""
        assert self.contact.v_0 is not None  # noqa: S101  # `ingredients` gives one
        return self.contact.v_0


def ingredients(case: Scene) -> Ingredients:
    """Return what the probes of a case are made from.

    Raises
    ------
    InputError
        If the case has no impact speed, neither given nor from its own motion.
    """
    if case.coupled and not case.number:
        raise InputError(f"{case.name}: a bed without particles has no contacts: expected some particles")
    spheres, planes = case.spheres, case.planes
    material, radius = spheres[0].material, spheres[0].radius
    wall = planes[0].material if planes else None
    others = [p.name for p in spheres if (p.material, p.radius) != (material, radius)]
    others += [w.name for w in planes[1:] if w.material != wall]
    speed = case.contact.v_0 if case.contact.v_0 is not None else first_impact_speed(case)
    names = {p.name: p.material.name for p in spheres} | {w.name: _name(w.material) for w in planes}
    if speed is None:
        raise InputError(f"{case.name}: nothing meets, so there is no impact speed: expected contact.v_0 [m/s]")
    contact = case.contact
    pairs, notes = _exceptions(contact.pairs, names, {material.name, _name(wall)})
    if others:
        notes += (
            f"the probes are made of the first particle and the first wall: nothing is said of {', '.join(others)}",
        )
    left_out = [what for what in _SMOOTH if getattr(contact, what) > 0.0]
    if left_out:
        notes += (f"the probes leave out {' and '.join(left_out)}",)
    return Ingredients(
        name=case.name,
        material=material,
        radius=radius,
        wall=wall,
        contact=replace(
            contact, v_0=speed, pairs=pairs, friction=0.0, rolling_friction=0.0, cohesion_energy_density=0.0
        ),
        steps_per_contact=case.run.steps_per_contact,
        notes=notes,
    )


def _name(wall: Material | None) -> str:
    return "rigid" if wall is None else wall.name


def _exceptions(
    pairs: Iterable[PairChoice], names: dict[str, str], known: set[str]
) -> tuple[tuple[PairChoice, ...], tuple[str, ...]]:
    """Return the exceptions that name materials of the probes (or bodies of them), and a note about the others."""
    kept, left = [], []
    for choice in pairs:
        one, two = (names.get(name, name) for name in choice.between)
        # of one material, particle and wall cannot be told apart by it
        if {one, two} <= known and (len(known) > 1 or choice.between == (one, two)):
            kept.append(
                replace(choice, between=(one, two), friction=None, rolling_friction=None, cohesion_energy_density=None)
            )
        else:
            left.append("–".join(choice.between))
    kept = [c for c in kept if any(v is not None for v in (c.e_n, c.v_0, c.k_n))]
    return tuple(kept), ((f"the probes leave out the exceptions for {', '.join(left)}",) if left else ())


@dataclass(frozen=True, kw_only=True)
class Probe:
    """A scene with a question.

    Attributes
    ----------
    name : letters, digits and dashes
    kind : "linear" or "hertz"
    e_n : restitution of its contacts [-]
    contacts : contacts at once of the particle that has most [-]
    size_ratio : largest over smallest radius [-]
    pressed : whether it rests (stability limit), or meets once
    scene : without a meaningful time step; see `at_step`
    model : the scene with the numbers of its contacts
    """

    name: str
    kind: str
    e_n: float
    contacts: int
    size_ratio: float = 1.0
    pressed: bool
    scene: Scene
    model: Plan


def at_step(model: Plan, dt: float, n_steps: int) -> Plan:
    """Return ``model`` with another time step [s] and number of steps; every step in contact leaves a frame."""
    flight = max(round(model.shortest / dt), 1)
    return replace(model, dt=dt, t_end=dt * n_steps, n_steps=n_steps, record_every=1, flight_every=flight)


def pressed(given: Ingredients, kind: str, e_n: float, contacts: int, *, size_ratio: float = 1.0) -> Probe:
    """Return a probe at rest under load: z contacts at one sphere, or an unequal pair between two walls.

    ``contacts`` = 1: a sphere that gravity presses on a wall; 2 with ``size_ratio`` 1: a sphere between two walls, both
    as deep in the walls as an impact at v_0 gets (or as the strongest gravity of a case presses it); a key of
    `DIRECTIONS` above 2: a sphere amid its neighbours, squeezed by walls.
    """
    if contacts == 1:
        return _on_floor(given, kind, e_n)
    if size_ratio != 1.0:
        return _unequal_pressed(given, kind, e_n, size_ratio)
    return _between_walls(given, kind, e_n) if contacts == 2 else _cluster(given, kind, e_n, contacts)


def impact_on_wall(given: Ingredients, kind: str, e_n: float) -> Probe:
    """Return spheres that hit a wall side by side at v_0, at different sub-step phases of first touch."""
    R, v = given.radius, given.v_0
    start = 0.2 * v * _contact(given, kind, e_n, wall=True).t_c
    golden = (math.sqrt(5.0) - 1.0) / 2.0  # multiples of it, without their whole part, are spread evenly
    gaps = [start * (1.0 + 5.0 * math.fmod(golden * (i + 1), 1.0)) for i in range(ABREAST)]
    particles = tuple(
        _sphere(given, f"s{i}", (3.0 * R * i, 0.0, R + gap), (0.0, 0.0, -v)) for i, gap in enumerate(gaps)
    )
    floor = Wall(name="floor", axis="z", position=0.0, material=given.wall)
    scene = probe_scene(given, f"impact-wall-{kind}", e_n, particles, (floor,))
    return probe_of(scene, kind, e_n, 1, pressed=False)


def impact_of_pair(given: Ingredients, kind: str, e_n: float, size_ratio: float = 1.0) -> Probe:
    """Return a sphere of the case's size that meets one ``size_ratio`` times larger, head on at v_0."""
    big, v = given.radius * size_ratio, given.v_0

    def scene(gap: float) -> Scene:
        small = _sphere(given, "small", (-given.radius - gap, 0.0, 0.0), (v, 0.0, 0.0))
        large = replace(_sphere(given, "large", (big, 0.0, 0.0)), radius=big)
        return probe_scene(given, f"impact-pair-{size_ratio:g}-{kind}", e_n, (small, large), ())

    t_c = plan(scene(0.0), (kind,))[kind].between("small", "large").t_c
    return probe_of(scene(0.37 * v * t_c), kind, e_n, 1, pressed=False, size_ratio=size_ratio)


def impact_of_cluster(given: Ingredients, kind: str, e_n: float, contacts: int) -> Probe:
    """Return ``contacts`` spheres that hit one at rest from all sides, all at once and at v_0."""
    v = given.v_0
    start = 2.0 * given.radius + 0.37 * v * _contact(given, kind, e_n, wall=False).t_c
    particles = [_sphere(given, "s0", (0.0, 0.0, 0.0))]
    particles += [
        _sphere(given, f"s{i}", _vector(start * u), _vector(-v * u)) for i, u in enumerate(_units(contacts), start=1)
    ]
    scene = probe_scene(given, f"impact-cluster-{contacts}-{kind}", e_n, tuple(particles), ())
    return probe_of(scene, kind, e_n, contacts, pressed=False)


def _on_floor(given: Ingredients, kind: str, e_n: float) -> Probe:
    c = _contact(given, kind, e_n, wall=True)
    delta = min(_depth(c), (c.m_eff * STRONGEST / c.k) ** (1.0 / c.n))
    ball = _sphere(given, "s0", (0.0, 0.0, given.radius - delta), (0.0, 0.0, _nudge(c, delta)))
    floor = Wall(name="floor", axis="z", position=0.0, material=given.wall)
    g = c.k * delta**c.n / c.m_eff
    scene = probe_scene(given, f"pressed-floor-{kind}", e_n, (ball,), (floor,), (0.0, 0.0, -g))
    return probe_of(scene, kind, e_n, 1, pressed=True)


def _between_walls(given: Ingredients, kind: str, e_n: float) -> Probe:
    c = _contact(given, kind, e_n, wall=True)
    delta = _depth(c)
    ball = _sphere(given, "s0", (0.0, 0.0, 0.0), (_nudge(c, delta), 0.0, 0.0))
    walls = _box({"x": given.radius - delta}, given.wall)
    return probe_of(probe_scene(given, f"pressed-walls-{kind}", e_n, (ball,), walls), kind, e_n, 2, pressed=True)


def _unequal_pressed(given: Ingredients, kind: str, e_n: float, size_ratio: float) -> Probe:
    R, big = given.radius, given.radius * size_ratio

    def scene(delta: float, left: float, right: float, nudge: float) -> Scene:
        """With overlaps of the pair and at either wall [m]."""
        small = _sphere(given, "small", (-R + delta, 0.0, 0.0), (nudge, 0.0, 0.0))
        # less for the heavier one
        large = _sphere(given, "large", (big, 0.0, 0.0), (-0.3 * nudge / size_ratio**3, 0.0, 0.0))
        walls = tuple(
            Wall(name=f"x-{side}", axis="x", position=plane, material=given.wall)
            for side, plane in (("low", -2.0 * R + delta + left), ("high", 2.0 * big - right))
        )
        name = f"pressed-pair-{size_ratio:g}-{kind}"
        return probe_scene(given, name, e_n, (small, replace(large, radius=big)), walls)

    model = plan(scene(0.0, 0.0, 0.0, 0.0), (kind,))[kind]
    middle, delta = model.between("small", "large"), 2.0 * R * PRESSED_SHARE
    force = middle.k * delta**middle.n
    left, right = model.between("small", "x-low"), model.between("large", "x-high")
    in_left, in_right = ((force / c.k) ** (1.0 / c.n) for c in (left, right))
    return probe_of(
        scene(delta, in_left, in_right, _nudge(middle, delta)), kind, e_n, 2, pressed=True, size_ratio=size_ratio
    )


def _cluster(given: Ingredients, kind: str, e_n: float, contacts: int) -> Probe:
    """One sphere amid ``contacts`` others, squeezed by walls; every pair in contact has the same overlap."""
    R = given.radius
    inner, outer = _contact(given, kind, e_n, wall=False), _contact(given, kind, e_n, wall=True)
    units = _units(contacts)
    delta = 2.0 * R * PRESSED_SHARE
    apart = 2.0 * R - delta
    centres = np.vstack([np.zeros(3), apart * units])
    # what its neighbours push an outer sphere with is what its walls must hold: alike for all by symmetry
    d = centres[1] - np.delete(centres, 1, axis=0)
    length = np.linalg.norm(d, axis=1)
    near = length < 2.0 * R
    push = np.abs((d[near] / length[near, None]).sum(axis=0)) * inner.k * delta**inner.n
    axis = int(np.argmax(np.abs(units[0])))
    plane = float(np.abs(centres).max()) + R - (float(push[axis]) / outer.k) ** (1.0 / outer.n)
    axes: dict[Axis, float] = {AXES[k]: plane for k in range(3) if np.any(units[:, k] != 0.0)}
    # within the space of the arrangement: in the other directions nothing holds the spheres
    held = np.array([float(a in axes) for a in "xyz"])
    nudges: Array = np.random.default_rng(1).uniform(-1.0, 1.0, centres.shape) * held * _nudge(inner, delta)
    particles = tuple(
        _sphere(given, f"s{i}", _vector(x), _vector(v)) for i, (x, v) in enumerate(zip(centres, nudges, strict=True))
    )
    scene = probe_scene(given, f"pressed-cluster-{contacts}-{kind}", e_n, particles, _box(axes, given.wall))
    return probe_of(scene, kind, e_n, contacts, pressed=True)


def _units(contacts: int) -> Array:
    if contacts not in DIRECTIONS:
        raise InputError(f"contacts = {contacts}: expected one of {', '.join(map(str, DIRECTIONS))}")
    directions = np.array(DIRECTIONS[contacts])
    return np.asarray(directions / np.linalg.norm(directions, axis=1)[:, None])


def _box(axes: dict[Axis, float], material: Material | None) -> tuple[Wall, ...]:
    return tuple(
        Wall(name=f"{axis}-{side}", axis=axis, position=sign * plane, material=material)
        for axis, plane in axes.items()
        for side, sign in (("low", -1.0), ("high", 1.0))
    )


def _sphere(given: Ingredients, name: str, position: Vector, velocity: Vector = (0.0, 0.0, 0.0)) -> Particle:
    return Particle(name=name, material=given.material, radius=given.radius, position=position, velocity=velocity)


def _contact(given: Ingredients, kind: str, e_n: float, *, wall: bool) -> PairContact:
    """Numbers of the contact of two of the case's spheres, or of one with its wall."""
    R = given.radius
    balls = tuple(_sphere(given, f"s{i}", (3.0 * R * i, 0.0, 2.0 * R)) for i in range(2))
    floor = Wall(name="floor", axis="z", position=0.0, material=given.wall)
    scene = probe_scene(given, "contact", e_n, balls, (floor,))
    return plan(scene, (kind,))[kind].between("s0", "floor" if wall else "s1")


def _depth(contact: PairContact) -> float:
    assert contact.delta_max is not None  # noqa: S101  # probes have a v_0
    return contact.delta_max


def _nudge(contact: PairContact, delta: float) -> float:
    """A small speed [m/s]: that of an oscillation `NUDGE` as wide as the overlap."""
    omega = math.sqrt(contact.n * contact.k * delta ** (contact.n - 1.0) / contact.m_eff)
    return NUDGE * omega * delta


def probe_scene(
    given: Ingredients,
    name: str,
    e_n: float,
    particles: tuple[Particle, ...],
    walls: tuple[Wall, ...],
    gravity: Vector = (0.0, 0.0, 0.0),
    *,
    friction: float = 0.0,
) -> Scene:
    """Return a scene of these bodies with the case's contact."""
    pairs = tuple(replace(choice, e_n=None if choice.e_n is None else e_n) for choice in given.contact.pairs)
    return Scene.of(
        particles,
        walls,
        name=name,
        title=f"Probe of {given.name}",
        gravity=gravity,
        contact=replace(given.contact, e_n=e_n, pairs=pairs, friction=friction),
        # one step: each run brings its own (see `at_step`)
        run=RunControl(dt=1.0, until_time=1.0),
        needs={"tangential": friction > 0.0, "rolling": False},
    )


def probe_of(scene: Scene, kind: str, e_n: float, contacts: int, *, pressed: bool, size_ratio: float = 1.0) -> Probe:
    """Return the probe of a scene."""
    return Probe(
        name=scene.name,
        kind=kind,
        e_n=e_n,
        contacts=contacts,
        size_ratio=size_ratio,
        pressed=pressed,
        scene=scene,
        model=plan(scene, (kind,))[kind],
    )


def _vector(values: Array) -> Vector:
    x, y, z = (float(value) + 0.0 for value in values)  # no -0.0
    return x, y, z
