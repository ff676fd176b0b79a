"""From a scene to models that can run: contacts in numbers, time step, end time, recording schedule."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from kncal.core.errors import CaseFileError, ValidityError
from kncal.physics.material import Pair, pair, sphere_mass, wall_pair
from kncal.scene.ballistics import first_touch, initial_overlap
from kncal.scene.bodies import Particle, Wall
from kncal.scene.contact_limits import require_possible_scene
from kncal.scene.load import bottom_load
from kncal.scene.model import KINDS, PairContact, Plan
from kncal.scene.needs import Needs, decide
from kncal.scene.pair_contact import PairNumbers, Rest, numbers_of, pair_contact, smooth
from kncal.scene.scene import Scene
from kncal.scene.species import SpeciesPair, species_of

#: Records that take more than this are refused before the run [bytes]: a report reads all of them.
MOST_SERIES_BYTES = 8 * 1024**3
#: What is recorded of a coupling [bytes], most of it a histogram of overlaps; of each pair of species one of impact
#: speeds; of each wall forces by height.
COUPLING_BYTES, PAIR_BYTES, WALL_BYTES = 1550, 590, 480
#: More steps than this are refused before the run rather than after a day.
MOST_STEPS = 500_000_000


@lru_cache(maxsize=10_000)  # both models and the deck ask for the same pairs
def pair_of(a: Particle, b: Particle | Wall) -> Pair:
    """Return the `Pair` of two bodies of a scene."""
    if isinstance(b, Wall):
        return wall_pair(a.material, a.radius, b.material)
    both = pair(a.material, a.radius, b.material, b.radius)
    if a.frozen == b.frozen:
        return both
    return replace(both, m_eff=sphere_mass((b if a.frozen else a).material, (b if a.frozen else a).radius))


def plan(scene: Scene, kinds: Iterable[str] = KINDS) -> dict[str, Plan]:
    """Return the plans of ``scene`` by kind of model, all with the same end time (of a bed: but for whole couplings).

    The step is the shortest contact duration over ``steps_per_contact`` (of each model by itself). Where gas and
    particles are coupled it is no longer than the coupling interval; the interval is the largest whole number of
    steps in ``run.coupling``, and is cut into as few gas steps as ``run.gas_step`` allows. Where nothing moves but the
    gas there are no contacts, and one step per coupling.

    Raises
    ------
    CaseFileError
        If no impact speed can be found, the run would need more than `MOST_STEPS` steps, or something is sure to go
        through something else (`kncal.scene.limits`).
    """
    kinds = tuple(kinds)
    needs = decide(scene)
    if scene.coupled:
        return {kind: _coupled(scene, kind, needs) for kind in kinds}
    first_speed = speed_once()
    models = {kind: _few(scene, kind, needs, first_speed) for kind in KINDS}
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
    models: Mapping[str, Plan] = field(compare=False)


@lru_cache(maxsize=256)  # a run is planned when it is checked, when it starts and when it is read
def _bounced(known: _Known) -> float:
    """Return when the slower of the models is at the apex after its bounces [s]."""
    from kncal.scene.exact import bounce_time

    models = known.models.values()
    return max(bounce_time(model.without_friction(), model.scene.run.until_bounces or 1) for model in models)


def pair_choice(
    scene: Scene,
    a: Particle,
    b: Particle | Wall,
    first_speed: Callable[[Scene], float | None] | None = None,
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
    if scene.coupled:
        return (
            "many particles have no first impact to calibrate at: expected contact.v_0 [m/s], typical of them, or "
            "contact.k_n [N/m]"
        )
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
    """Return the normal closing speed of the scene's first touch [m/s], from ballistics; None if there is none.

    Nor is there one in a bed, whose particles are placed later.
    """
    if scene.coupled:
        return None
    touches = [touch for a, b in scene.body_pairs() if (touch := first_touch(scene, a, b)) is not None]
    return min(touches)[1] if touches else None


def species_contacts(
    scene: Scene,
    kind: str,
    overlaps: Mapping[SpeciesPair, float],
    *,
    first_speed: Callable[[Scene], float | None] | None = None,
    needs: Needs | None = None,
) -> tuple[dict[SpeciesPair, PairContact], dict[SpeciesPair, PairContact]]:
    """Return the contacts of the pairs of species in ``overlaps``, and of the other pairs, which do not meet.

    Of the others those that cannot be calibrated are missing. ``overlaps``: at t = 0 [m]; ``first_speed``: as of
    `pair_choice`; ``needs``: friction that it does not name is left out, None: all of it stays.
    """
    species, speed = species_of(scene), first_speed or speed_once()
    parts = {"tangential": "tangential", "rolling": "rolling", "damped": "tangential_damping", "spring": "history"}
    uses = {key: needs is None or needs.uses(name) for key, name in parts.items()}

    def made(which: SpeciesPair, overlap: float) -> PairContact:
        return smooth(contact_of(scene, *species.bodies(which), kind, speed, overlap), **uses)

    met = {which: made(which, overlap) for which, overlap in overlaps.items()}
    unmet = {}
    for which in species.pairs():
        if which not in met:
            with suppress(CaseFileError, ValidityError):  # nobody asked for it; a deck says what it lacks
                unmet[which] = made(which, 0.0)
    return met, unmet


def _few(scene: Scene, kind: str, needs: Needs, first_speed: Callable[[Scene], float | None]) -> Plan:
    species = species_of(scene)
    overlaps: dict[SpeciesPair, float] = {}
    for a, b in scene.body_pairs():  # of a gap nothing depends
        which = species.pair_of((a.name, b.name))
        overlaps[which] = max(overlaps.get(which, 0.0), initial_overlap(a, b))
    contacts, unmet = species_contacts(scene, kind, overlaps, first_speed=first_speed, needs=needs)
    given = Plan(scene=scene, kind=kind, needs=needs, contacts=contacts, unmet=unmet, dt=math.nan)
    dt = scene.run.dt if scene.run.dt is not None else given.shortest / scene.run.steps_per_contact
    return replace(given, dt=dt, record_every=scene.run.record_every)


def _timed(model: Plan, t_end: float) -> Plan:
    number = t_end / model.dt * (1.0 - 1e-12)
    n_steps = math.ceil(min(number, MOST_STEPS + 1.0))  # it may be infinite
    if n_steps > MOST_STEPS:
        raise CaseFileError(
            f"{model.scene.name}: the {model.kind} model needs {number:.3g} steps of {model.dt:.3g} s: expected at "
            f"most {MOST_STEPS:.3g}; shorten run.until_time, or take a softer material or a larger run.dt"
        )
    flight = max(model.record_every, round(min(model.shortest / model.dt, MOST_STEPS)))
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

    Friction is the case's, whether or not the scene needs it. ``first_speed``: as of `pair_choice`. With k_n prescribed
    and no impact speed, Hertz contacts are judged under a sphere's own weight, in a bed at its bottom.
    """
    both, numbers = pair_of(a, b), pair_choice(scene, a, b, first_speed)
    own = float(both.m_eff) * float(np.linalg.norm(scene.gravity))
    rest = Rest(overlap, bottom_load(scene) if scene.coupled else own)
    names = f"{a.name!r} and {b.name!r}"
    return pair_contact(scene.contact, both, numbers, kind, rest, scene=scene.name, names=names)


def _coupled(scene: Scene, kind: str, needs: Needs) -> Plan:
    contacts: dict[SpeciesPair, PairContact] = {}
    if needs.uses("liggghts"):
        overlaps = dict.fromkeys(species_of(scene).pairs(), 0.0)
        contacts, _ = species_contacts(scene, kind, overlaps, needs=needs)
    wish, t_end = scene.interval or math.inf, scene.run.until_time or math.inf  # checked: both are given
    shortest = min((c.t_c for c in contacts.values()), default=math.inf)
    dt = min(shortest / scene.run.steps_per_contact, wish)
    # 1e-9: a wish that is a whole number of steps but for rounding is that number
    per_coupling = max(math.floor(wish / dt * (1.0 + 1e-9)), 1)
    coupling = per_coupling * dt
    number = t_end / coupling * (1.0 - 1e-9)  # may be infinite
    if number * per_coupling > MOST_STEPS:
        raise CaseFileError(
            f"{scene.name}: the {kind} model needs {number * per_coupling:.3g} steps of {dt:.3g} s: expected at most "
            f"{MOST_STEPS:.3g}; shorten run.until_time, or take a softer material (beds are customarily run with a "
            "Young's modulus far below the real one) or a smaller run.steps_per_contact"
        )
    couplings = math.ceil(number)
    gas_steps = 1.0 if (step := scene.run.gas_step) is None else coupling / step * (1.0 - 1e-9)
    if number * gas_steps > MOST_STEPS:
        raise CaseFileError(
            f"{scene.name}: the gas needs {number * gas_steps:.3g} steps of {scene.run.gas_step:.3g} s: expected at "
            f"most {MOST_STEPS:.3g}; take a longer run.gas_step, or shorten run.until_time"
        )
    frames_every = max(round(min(scene.run.frames_every / coupling, couplings + 1.0)), 1)
    _check_series(scene, couplings, couplings // frames_every)
    return Plan(
        scene=scene,
        kind=kind,
        needs=needs,
        contacts=contacts,
        dt=dt,
        t_end=couplings * coupling,
        n_steps=couplings * per_coupling,
        steps_per_coupling=per_coupling,
        couplings=couplings,
        frames_every=frames_every,
        gas_steps=max(math.ceil(gas_steps), 1),
    )


def _check_series(scene: Scene, couplings: int, frames: int) -> None:
    """Refuse records that would fill disk and memory: single precision, nine numbers a particle, five a gas cell."""
    size = 38 * scene.number + (20 * math.prod(scene.cells) if scene.drag else 0)
    pairs, walls = len(tuple(species_of(scene).pairs())), len(scene.walls) if scene.gas is None else 0
    each = COUPLING_BYTES + PAIR_BYTES * pairs + WALL_BYTES * walls
    if frames * size + couplings * each > MOST_SERIES_BYTES:
        raise CaseFileError(
            f"{scene.name}: {frames} frames of {size / 1e6:.3g} MB and {couplings} couplings of "
            f"{each / 1e3:.3g} kB are to be recorded: expected at most {MOST_SERIES_BYTES / 1e9:.3g} GB in "
            "all; take a longer run.frames_every, a longer run.coupling or a shorter run.until_time"
        )
