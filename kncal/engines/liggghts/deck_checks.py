"""What LIGGGHTS does not check itself: it runs a negative or infinite stiffness, or dt = 0, all the same."""

from __future__ import annotations

import math

from kncal.core.errors import RenderError
from kncal.physics.material import pair, wall_pair
from kncal.scene.model import Model, PairContact
from kncal.scene.scene import AXES, Particle, Scene, Vector, Wall

#: LIGGGHTS counts the steps of one `run` in 32 bits.
MOST_STEPS = 2**31 - 1
#: Relative difference up to which two routes to one number count as rounding.
ROUNDING = 1e-9


def expect(condition: bool, where: object, what: str, expected: str) -> None:
    """Raise `RenderError` unless ``condition``; ``where`` is a pair of names or one name."""
    if not condition:
        place = f"pair {where[0]}, {where[1]}" if isinstance(where, tuple) else str(where)
        raise RenderError(f"{place}: {what}: expected {expected}")


def expect_same(names: tuple[str, str], what: str, given: float, applied: float, meaning: str) -> None:
    """Raise `RenderError` unless LIGGGHTS will apply the ``given`` number (but for rounding)."""
    if not math.isclose(given, applied, rel_tol=ROUNDING):
        raise RenderError(
            f"pair {names[0]}, {names[1]}: {what} = {given!r}: expected {applied!r}, the {meaning}; LIGGGHTS "
            "works it out from the materials and takes no other"
        )


def expect_vector(where: str, what: str, vector: Vector) -> None:
    """Raise `RenderError` unless ``vector`` holds three finite numbers."""
    good = len(vector) == 3 and all(isinstance(value, int | float) and math.isfinite(value) for value in vector)
    expect(good, where, f"{what} = {vector!r}", "three finite numbers")


def check_numbers(model: Model) -> None:
    """Refuse a model with a number out of its range, or without exactly one contact for every pair."""
    name = model.scene.name
    expect(model.kind in ("linear", "hertz"), name, f"model kind {model.kind!r}", "'linear' or 'hertz'")
    expect(math.isfinite(model.dt) and model.dt > 0.0, name, f"dt = {model.dt!r} s", "a finite dt > 0")
    expect(1 <= model.n_steps <= MOST_STEPS, name, f"{model.n_steps} steps", f"1 to {MOST_STEPS} steps")
    expect(model.record_every >= 1, name, f"record_every = {model.record_every}", "at least 1 step")
    expect(
        model.flight_every >= model.record_every,
        name,
        f"flight_every = {model.flight_every}",
        f"at least record_every = {model.record_every}",
    )
    wanted = {(a.name, b.name) for a, b in model.scene.body_pairs()}
    expect(
        wanted == set(model.contacts),
        name,
        "contacts of other pairs than the scene's",
        "one contact per pair",
    )
    for names, c in model.contacts.items():
        for key in ("k", "m_eff", "R_eff", "E_eff", "G_eff"):
            value = getattr(c, key)
            expect(math.isfinite(value) and value > 0.0, names, f"{key} = {value!r}", "a finite value > 0")
        for key in ("c", "friction", "rolling_friction", "k_t"):
            value = getattr(c, key)
            expect(math.isfinite(value) and value >= 0.0, names, f"{key} = {value!r}", "a finite value >= 0")
        expect(c.end in ("overlap", "force"), names, f"contact end {c.end!r}", "'overlap' or 'force'")


def check_start(scene: Scene) -> None:
    """Refuse bodies of one name and centres in one place (LIGGGHTS computes NaN from there to the end)."""
    names = [body.name for body in scene.bodies]
    expect(len(set(names)) == len(names), scene.name, "two bodies of one name", "a name of its own for each")
    expect(bool(scene.particles), scene.name, "no particle", "at least one")
    expect_vector(scene.name, "gravity", scene.gravity)
    for particle in scene.particles:
        expect_vector(particle.name, "position", particle.position)
        expect_vector(particle.name, "velocity", particle.velocity)
        expect_vector(particle.name, "spin", particle.spin)
        radius = particle.radius
        expect(math.isfinite(radius) and radius > 0.0, particle.name, f"radius = {radius!r} m", "a radius > 0")
    for wall in scene.walls:
        expect(math.isfinite(wall.position), wall.name, f"position = {wall.position!r} m", "a finite position")
    for a, b in scene.body_pairs():
        if isinstance(b, Particle):
            apart = math.dist(a.position, b.position)
        else:
            apart = abs(a.position[AXES.index(b.axis)] - b.position)
        expect(
            apart > 0.0,
            (a.name, b.name),
            "centre in the same place",
            "a distance > 0 (the force would have no direction)",
        )


def require_tsuji(names: tuple[str, str], contact: PairContact) -> None:
    """Refuse a contact that LIGGGHTS' `hertz` model doesn't make: that is Tsuji's, or Hertz's without damping."""
    tsuji = contact.law == "tsuji" and (contact.p == 0.25 or contact.c == 0.0)
    if (tsuji or (contact.law == "hertz" and contact.c == 0.0)) and contact.n == 1.5:
        return
    if contact.law == "kuwabara_kono":
        why = "LIGGGHTS has this law as its model hertz/stiffness, which kncal does not write"
    else:
        why = f"LIGGGHTS has no {contact.law!r} law"
    raise RenderError(
        f"pair {names[0]}, {names[1]}: law {contact.law!r}: {why}; its model hertz is 'tsuji', or 'hertz' without "
        "damping: expected one of these, or (single contacts only) the builtin engine for the hertz model"
    )


def check_elastic(scene: Scene, names: tuple[str, str], contact: PairContact) -> None:
    """Refuse an effective mass, radius or modulus that is not what LIGGGHTS makes of the materials."""
    bodies = {body.name: body for body in scene.bodies}
    a, b = bodies[names[0]], bodies[names[1]]
    assert isinstance(a, Particle)  # noqa: S101  # `Scene.body_pairs` puts the particle first
    own = (
        wall_pair(a.material, a.radius, b.material)
        if isinstance(b, Wall)
        else pair(a.material, a.radius, b.material, b.radius)
    )
    for key, value in (("m_eff", own.m_eff), ("R_eff", own.R_eff), ("E_eff", own.E_eff)):
        expect_same(names, key, getattr(contact, key), float(value), "value of these two bodies")


def check_tangential(names: tuple[str, str], c: PairContact, style: str) -> None:
    """Refuse a tangential stiffness where LIGGGHTS takes one of its own and this is another."""
    if style == "hertz":
        mindlin = 8.0 * c.G_eff * math.sqrt(c.R_eff)
        expect_same(names, "k_t", c.k_t, mindlin, "Mindlin stiffness 8 G_eff sqrt(R_eff)")
    elif style == "hooke":
        meaning = "normal stiffness, which the model hooke also takes tangentially (or, with ktToKnUser on, 2/7 of it, "
        expect_same(names, "k_t", c.k_t, c.k, f"{meaning}which kncal does not write)")
