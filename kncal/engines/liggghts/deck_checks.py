"""What LIGGGHTS does not check itself: it runs a negative or infinite stiffness, or dt = 0, all the same."""

from __future__ import annotations

import math

from kncal.core.errors import RenderError
from kncal.engines.plan_checks import check_schedule, expect
from kncal.physics.laws import LAWS
from kncal.scene.bodies import AXES, Particle, Vector
from kncal.scene.model import PairContact, Plan
from kncal.scene.scene import Scene

#: LIGGGHTS counts the steps of one `run` in 32 bits.
MOST_STEPS = 2**31 - 1
#: Relative difference up to which two routes to one number count as rounding.
ROUNDING = 1e-9
#: A periodic column is at least so many diameters deep: no particle may touch another and its image.
LEAST_PERIODIC = 3.0


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


def check_run(name: str, kind: str, kind_of_style: str, dt: float, steps: int | None) -> None:
    """Refuse a model, a time step or a number of steps that LIGGGHTS would run all the same."""
    expect(kind == kind_of_style, name, f"model kind {kind!r}", f"{kind_of_style!r}")
    expect(math.isfinite(dt) and dt > 0.0, name, f"dt = {dt!r} s", "a finite dt > 0")
    expect(steps is None or 1 <= steps <= MOST_STEPS, name, f"{steps} steps", f"1 to {MOST_STEPS} steps")


def check_model(model: Plan) -> None:
    """Refuse a recording schedule that is none, or a model without exactly one contact for every pair."""
    check_schedule(model)
    wanted = {pair for pair in model.species.pairs() if model.species.meetings(pair)}
    expect(
        wanted == set(model.contacts),
        model.scene.name,
        "contacts of other pairs than the scene's",
        "one contact per pair",
    )


def check_bed(model: Plan) -> None:
    """Refuse what LIGGGHTS would run without a word: sizes, gravity, a missing contact, a thin periodic box."""
    scene, name = model.scene, model.scene.name
    for d in (scene.d_min, scene.d_max):
        expect(math.isfinite(d) and d > 0.0, name, f"diameter = {d!r} m", "a finite diameter > 0")
    expect_vector(name, "gravity", scene.gravity)
    for pair in model.species.pairs():
        one, other = model.species.names(pair)
        expect(pair in model.contacts, name, f"no contact of {one} with {other}", "one contact per pair")
    low, high = scene.extent
    for axis in scene.periodic:
        length = float((high - low)[AXES.index(axis)])
        expect(
            length >= LEAST_PERIODIC * scene.d_max,
            name,
            f"periodic over {length:g} m in {axis}",
            f"at least {LEAST_PERIODIC:g} diameters ({LEAST_PERIODIC * scene.d_max:g} m), so that no two particles "
            "touch twice",
        )


def check_start(scene: Scene) -> None:
    """Refuse bodies of one name and centres in one place (LIGGGHTS computes NaN from there to the end)."""
    names = [body.name for body in scene.bodies]
    expect(len(set(names)) == len(names), scene.name, "two bodies of one name", "a name of its own for each")
    expect(bool(scene.spheres), scene.name, "no particle", "at least one")
    expect_vector(scene.name, "gravity", scene.gravity)
    for particle in scene.spheres:
        expect_vector(particle.name, "position", particle.position)
        expect_vector(particle.name, "velocity", particle.velocity)
        expect_vector(particle.name, "spin", particle.spin)
        radius = particle.radius
        expect(math.isfinite(radius) and radius > 0.0, particle.name, f"radius = {radius!r} m", "a radius > 0")
    for wall in scene.planes:
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


def require_law(names: tuple[str, str], contact: PairContact, model: str) -> None:
    """Refuse a contact that LIGGGHTS' normal ``model`` does not make."""
    law = LAWS.get(contact.law)
    damped = law is not None and contact.p == law.damping_exponent
    if law is not None and law.liggghts == model and contact.n == law.stiffness_exponent and (damped or not contact.c):
        return
    why = f"LIGGGHTS has no {contact.law!r} law"
    if law is not None and law.liggghts:
        why = f"LIGGGHTS has this law as its model {law.liggghts}"
    made = " or ".join(
        f"{name!r}{' without damping' if law.elastic else ''}" for name, law in LAWS.items() if law.liggghts == model
    )
    raise RenderError(
        f"pair {names[0]}, {names[1]}: law {contact.law!r}: {why}; its model {model} is {made}: expected such a law, "
        "or (single contacts only) the builtin engine for the hertz model"
    )
