"""From a scene to models that can run: contacts in numbers, time step, end time, recording schedule."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kncal.ballistics import first_touch, initial_overlap
from kncal.calibration import Calibration, calibrate
from kncal.contact.registry import get_law
from kncal.errors import CaseFileError
from kncal.impact import dimensionless_impact
from kncal.material import Pair, pair, wall_pair
from kncal.model import KINDS, Model, PairContact
from kncal.needs import Needs, decide
from kncal.scene import Particle, Scene, Wall
from kncal.timestep import contact_time

#: More steps than this are refused before the run rather than after a day.
MOST_STEPS = 500_000_000


def pair_of(a: Particle, b: Particle | Wall) -> Pair:
    """Return the `Pair` of two bodies of a scene."""
    if isinstance(b, Wall):
        return wall_pair(a.material, a.radius, b.material)
    return pair(a.material, a.radius, b.material, b.radius)


def plan(scene: Scene, kinds: Iterable[str] = KINDS) -> dict[str, Model]:
    """Return the models of ``scene`` by kind, all with the same end time.

    Raises
    ------
    CaseFileError
        If no impact speed can be found, or the run would need more than `MOST_STEPS` steps.
    """
    kinds = tuple(kinds)
    needs = decide(scene)
    models = {kind: _model(scene, kind, needs) for kind in KINDS}
    control = scene.run
    if control.until_time is not None:
        t_end = control.until_time
    else:
        from kncal.exact import bounce_time

        bounces = control.until_bounces or 1
        t_end = max(bounce_time(model.without_friction(), bounces) for model in models.values())
    return {kind: _timed(models[kind], t_end) for kind in kinds}


def calibration_of(scene: Scene, a: Particle, b: Particle | Wall) -> Calibration | None:
    """Return the calibration of one pair, or None where the case prescribes k_n without an impact speed."""
    e_n, _, v_0, k_n = pair_choice(scene, a, b)
    if v_0 is None:
        return None
    contact = scene.contact
    contact_pair = pair_of(a, b)
    if k_n is not None:
        # A prescribed stiffness is a contact of the duration that this stiffness gives.
        t_c = contact_time(k_n, contact_pair.m_eff, e_n, contact.end)
        return calibrate(
            contact_pair, v_0=v_0, e_n=e_n, law=contact.law, method="contact_time", end=contact.end, t_c=t_c
        )
    return calibrate(
        contact_pair,
        v_0=v_0,
        e_n=e_n,
        law=contact.law,
        method=contact.method,
        end=contact.end,
        **contact.method_options,
    )


class PairNumbers(NamedTuple):
    """What the case says about one pair: e_n [-], friction [-], v_0 [m/s] and k_n [N/m] where prescribed."""

    e_n: float
    friction: float
    v_0: float | None
    k_n: float | None


def pair_choice(scene: Scene, a: Particle, b: Particle | Wall) -> PairNumbers:
    """Return the numbers of one pair: the scene's choice, or the first exception that names both bodies.

    v_0 is the speed of the scene's first impact where the case gives none, and None if nothing moves towards anything
    and k_n is prescribed.
    """
    contact = scene.contact
    e_n, friction, v_0, k_n = contact.e_n, contact.friction, contact.v_0, contact.k_n
    if (choice := scene.choice_for(a, b)) is not None:
        e_n = e_n if choice.e_n is None else choice.e_n
        friction = friction if choice.friction is None else choice.friction
        v_0 = v_0 if choice.v_0 is None else choice.v_0
        k_n = k_n if choice.k_n is None else choice.k_n
    if v_0 is None:
        v_0 = first_impact_speed(scene)
        if v_0 is None and k_n is None:
            raise CaseFileError(f"{scene.name}: {_why_no_speed(scene)}")
    return PairNumbers(e_n, friction, v_0, k_n)


def _why_no_speed(scene: Scene) -> str:
    pressed = [(a, b, d) for a, b in scene.body_pairs() if (d := initial_overlap(a, b)) > 0.0]
    if pressed:
        a, b, depth = max(pressed, key=lambda item: item[2] / item[0].radius)
        return (
            f"{a.name!r} starts {depth:.3g} m ({depth / a.radius:.2g} of its radius) inside {b.name!r}, and nothing "
            "else meets: check position and diameter (in m: 3 mm is 0.003), or give contact.v_0 [m/s] or "
            "contact.k_n [N/m]"
        )
    return (
        "nothing in the scene moves towards anything, so there is no impact speed to calibrate at: expected "
        "contact.v_0 [m/s] or contact.k_n [N/m]"
    )


def first_impact_speed(scene: Scene) -> float | None:
    """Return the normal closing speed of the scene's first touch [m/s], from ballistics; None if there is none."""
    touches = [touch for a, b in scene.body_pairs() if (touch := first_touch(scene, a, b)) is not None]
    return min(touches)[1] if touches else None


def _model(scene: Scene, kind: str, needs: Needs) -> Model:
    contacts = {(a.name, b.name): _contact(scene, a, b, kind) for a, b in scene.body_pairs()}
    if not needs.uses("tangential"):
        contacts = {names: replace(c, friction=0.0) for names, c in contacts.items()}
    if not needs.uses("rolling"):
        contacts = {names: replace(c, rolling_friction=0.0) for names, c in contacts.items()}
    shortest = min(c.t_c for c in contacts.values())
    dt = scene.run.dt if scene.run.dt is not None else shortest / scene.run.steps_per_contact
    return Model(
        scene=scene,
        kind=kind,
        contacts=contacts,
        dt=dt,
        t_end=math.nan,
        n_steps=0,
        record_every=scene.run.record_every,
        flight_every=0,
    )


def _timed(model: Model, t_end: float) -> Model:
    n_steps = math.ceil(t_end / model.dt * (1.0 - 1e-12))
    if n_steps > MOST_STEPS:
        raise CaseFileError(
            f"{model.scene.name}: the {model.kind} model needs {n_steps:.3g} steps of {model.dt:.3g} s: expected at "
            f"most {MOST_STEPS:.3g}; shorten run.until_time, or take a softer material or a larger run.dt"
        )
    shortest = min(c.t_c for c in model.contacts.values())
    flight = max(model.record_every, round(shortest / model.dt))
    return replace(model, t_end=t_end, n_steps=n_steps, flight_every=flight)


def _resting_time(scene: Scene, a: Particle, b: Particle | Wall, both: Pair) -> float:
    """Half period of a small oscillation about the start overlap or else the overlap under gravity [s]."""
    k_h, m_eff = float(both.k_h), float(both.m_eff)
    g = float(np.linalg.norm(scene.gravity))
    delta = max(initial_overlap(a, b), (m_eff * g / k_h) ** (2.0 / 3.0))
    if delta <= 0.0:
        raise CaseFileError(
            f"{scene.name}: no speed, no overlap and no gravity between {a.name!r} and {b.name!r} to choose a time "
            "step from: expected contact.v_0 [m/s]"
        )
    return math.pi * math.sqrt(m_eff / (1.5 * k_h * math.sqrt(delta)))


def _contact(scene: Scene, a: Particle, b: Particle | Wall, kind: str) -> PairContact:
    e_n, friction, v_0, k_n = pair_choice(scene, a, b)
    contact, both = scene.contact, pair_of(a, b)
    calibration = calibration_of(scene, a, b)
    m_eff, E_eff, R_eff, G_eff = (float(x) for x in (both.m_eff, both.E_eff, both.R_eff, both.G_eff))
    ratio = contact.k_t_ratio
    if kind == "linear":
        stiffness = k_n if k_n is not None else float(calibration.k_n)  # type: ignore[union-attr]
        t_c = float(contact_time(stiffness, m_eff, e_n, contact.end))
        delta_max = None if calibration is None else float(calibration.delta_max)
        law, n, p = "linear", 1.0, 0.0
        c = float(dimensionless_impact("linear", e_n, contact.end).C) * math.sqrt(stiffness * m_eff)
        k_t = stiffness * float(both.k_t_ratio if ratio is None else ratio)
    else:
        reference = get_law(contact.law)
        if reference.stiffness_exponent == 1.0:
            raise CaseFileError(
                f"{scene.name}: contact.law = {reference.name!r}: expected a Hertz-type reference law for the "
                "hertz run (tsuji, hertz, kuwabara_kono, hunt_crossley)"
            )
        stiffness, law, n = float(both.k_h), reference.name, 1.5
        p = reference.damping_exponent or 0.0
        speed = v_0 if v_0 is not None else 1.0
        length = (m_eff * speed**2 / stiffness) ** 0.4
        C = float(dimensionless_impact(reference, 1.0 if law == "hertz" else e_n, contact.end).C)
        if v_0 is None and reference.e_depends_on_speed:
            raise CaseFileError(
                f"{scene.name}: law {law!r} needs contact.v_0 [m/s], since its e_n depends on the speed"
            )
        c = C * m_eff * speed / length ** (p + 1.0)
        if calibration is None:
            t_c, delta_max = _resting_time(scene, a, b, both), None
        else:
            t_c, delta_max = float(calibration.reference.t_c), float(calibration.reference.delta_max)
            if initial_overlap(a, b) > delta_max:
                # pressed together harder than an impact at v_0 would: stiffer, so shorter
                t_c = min(t_c, _resting_time(scene, a, b, both))
        k_t = 8.0 * G_eff * math.sqrt(R_eff)
    return PairContact(
        law=law,
        k=stiffness,
        n=n,
        c=c,
        p=p,
        end=contact.end,
        e_n=e_n if law != "hertz" else 1.0,
        v_0=v_0,
        t_c=t_c,
        delta_max=delta_max,
        m_eff=m_eff,
        R_eff=R_eff,
        E_eff=E_eff,
        G_eff=G_eff,
        friction=friction,
        rolling_friction=contact.rolling_friction,
        k_t=k_t,
        warnings={} if calibration is None else {w.code: str(w) for w in calibration.warnings},
    )
