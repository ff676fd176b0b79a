"""From a scene to models that can run: contacts in numbers, time step, end time, recording schedule."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from kncal.core.errors import CaseFileError, ValidityError
from kncal.physics.material import Pair, pair, wall_pair
from kncal.scene.ballistics import first_touch, initial_overlap
from kncal.scene.limits import require_possible_scene
from kncal.scene.model import KINDS, Model, PairContact
from kncal.scene.needs import Needs, decide
from kncal.scene.pair_contact import PairNumbers, Rest, numbers_of, pair_contact, smooth
from kncal.scene.scene import Particle, Scene, Wall
from kncal.scene.species import SpeciesPair, species_of

#: More steps than this are refused before the run rather than after a day.
MOST_STEPS = 500_000_000


@lru_cache(maxsize=10_000)  # both models and the deck ask for the same pairs
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
        If no impact speed can be found, the run would need more than `MOST_STEPS` steps, or something is sure to go
        through something else (`kncal.scene.limits`).
    """
    kinds = tuple(kinds)
    needs = decide(scene)
    first_speed = speed_once()
    models = {kind: _model(scene, kind, needs, first_speed) for kind in KINDS}
    for kind in kinds:
        require_possible_scene(models[kind])
    t_end = scene.run.until_time
    if t_end is None:
        t_end = _bounced(_Known(repr(scene), models))
    return {kind: _timed(models[kind], t_end) for kind in kinds}


@dataclass(frozen=True)
class _Known:
    """Models of a scene, told from others by its text: every number of it stands there with all its digits."""

    text: str
    models: Mapping[str, Model] = field(compare=False)


@lru_cache(maxsize=256)  # a run is planned when it is checked, when it starts and when it is read
def _bounced(known: _Known) -> float:
    """Return when the slower of the models is at the apex after its bounces [s]."""
    from kncal.scene.exact import bounce_time

    models = known.models.values()
    return max(bounce_time(model.without_friction(), model.scene.run.until_bounces or 1) for model in models)


def pair_choice(
    scene: Scene, a: Particle, b: Particle | Wall, first_speed: Callable[[Scene], float | None] | None = None
) -> PairNumbers:
    """Return the numbers of one pair: the scene's choice, or the first exception that names both bodies.

    v_0 is the speed of the scene's first impact where the case gives none, and None if nothing moves towards anything
    and k_n is prescribed. ``first_speed``: what knows that speed, by default `first_impact_speed`, which looks at
    every pair.
    """
    numbers = numbers_of(scene.contact, scene.choice_for(a, b))
    if numbers.v_0 is None:
        numbers = numbers._replace(v_0=(first_speed or first_impact_speed)(scene))
        if numbers.v_0 is None and numbers.k_n is None:
            raise CaseFileError(f"{scene.name}: {_why_no_speed(scene)}")
    return numbers


def speed_once() -> Callable[[Scene], float | None]:
    """Return `first_impact_speed` for one scene, found at the first call: it looks at every pair of bodies."""
    speeds: list[float | None] = []

    def first_speed(scene: Scene) -> float | None:
        if not speeds:
            speeds.append(first_impact_speed(scene))
        return speeds[0]

    return first_speed


def species_choices(scene: Scene) -> dict[SpeciesPair, PairNumbers]:
    """Return the numbers (`pair_choice`) of every pair of species that bodies of the scene form."""
    species, first_speed = species_of(scene), speed_once()
    return {
        which: pair_choice(scene, *species.bodies(which), first_speed)
        for which in species.pairs()
        if species.meetings(which)
    }


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


def _model(scene: Scene, kind: str, needs: Needs, first_speed: Callable[[Scene], float | None]) -> Model:
    species = species_of(scene)
    uses = {name: needs.uses(name) for name in ("tangential", "rolling")}

    def made(a: Particle, b: Particle | Wall, overlap: float) -> PairContact:
        return smooth(contact_of(scene, a, b, kind, first_speed, overlap), **uses)

    known: dict[tuple[SpeciesPair, float], PairContact] = {}
    contacts = {}
    for a, b in scene.body_pairs():
        names = (a.name, b.name)
        key = (species.pair_of(names), max(initial_overlap(a, b), 0.0))  # of a gap nothing depends
        contacts[names] = known[key] if key in known else known.setdefault(key, made(a, b, key[1]))
    unmet = {}
    for which in set(species.pairs()) - {which for which, _ in known}:
        with suppress(CaseFileError, ValidityError):  # nobody asked for it; a deck says what it lacks
            unmet[which] = made(*species.bodies(which), 0.0)
    shortest = min(c.t_c for c in contacts.values())
    dt = scene.run.dt if scene.run.dt is not None else shortest / scene.run.steps_per_contact
    return Model(
        scene=scene,
        kind=kind,
        contacts=contacts,
        unmet=unmet,
        dt=dt,
        t_end=math.nan,
        n_steps=0,
        record_every=scene.run.record_every,
        flight_every=0,
    )


def _timed(model: Model, t_end: float) -> Model:
    number = t_end / model.dt * (1.0 - 1e-12)
    n_steps = math.ceil(min(number, MOST_STEPS + 1.0))  # it may be infinite
    if n_steps > MOST_STEPS:
        raise CaseFileError(
            f"{model.scene.name}: the {model.kind} model needs {number:.3g} steps of {model.dt:.3g} s: expected at "
            f"most {MOST_STEPS:.3g}; shorten run.until_time, or take a softer material or a larger run.dt"
        )
    shortest = min(c.t_c for c in model.contacts.values())
    flight = max(model.record_every, round(min(shortest / model.dt, MOST_STEPS)))
    return replace(model, t_end=t_end, n_steps=n_steps, flight_every=flight)


def contact_of(
    scene: Scene,
    a: Particle,
    b: Particle | Wall,
    kind: str,
    first_speed: Callable[[Scene], float | None],
    overlap: float,
) -> PairContact:
    """Return the contact of two bodies, which stand for their species; ``overlap`` [m]: at t = 0.

    Friction is the case's, whether or not the scene needs it. ``first_speed``: as of `pair_choice`.
    """
    both, numbers = pair_of(a, b), pair_choice(scene, a, b, first_speed)
    rest = Rest(overlap, float(both.m_eff) * float(np.linalg.norm(scene.gravity)))
    names = f"{a.name!r} and {b.name!r}"
    return pair_contact(scene.contact, both, numbers, kind, rest, scene=scene.name, names=names)
