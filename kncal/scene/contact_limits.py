"""What the contacts and the start of a scene run into: limits for `kncal.scene.limits`.

A calibration holds for v_0; a scene also has its own speeds, weights and start, and its time step. Solvers take any of
them without a word.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from kncal.physics.calibration import OVERLAP_DOUBTFUL, OVERLAP_MEANINGLESS
from kncal.physics.cohesion import share as pulled
from kncal.physics.material import sphere_mass
from kncal.physics.tangential import LIGHTER
from kncal.physics.timestep import verlet_limit
from kncal.scene.ballistics import first_touch, initial_overlap
from kncal.scene.bodies import AXES, Particle, Wall
from kncal.scene.finding import Finding, require_possible
from kncal.scene.load import bottom_overlaps, layers
from kncal.scene.model import PairContact, Plan
from kncal.scene.species import SpeciesPair
from kncal.scene.step_error import step_error

#: Overlap at the start over the smaller radius that is worth a word; a stack squeezed on purpose starts with 0.2.
START_LARGE = 0.25
#: Most bodies that touch one sphere at once: its nearest neighbours in the densest packing of equal spheres.
MOST_CONTACTS = 12
#: The error of the step falls with the number of steps, but not smoothly: so many times more steps surely have less.
STEPS_MARGIN = 1.5
#: Of limits of one sort this many are told one by one.
MOST_ALIKE = 3
#: Fewer frames in a contact than this, or frames of a bed, are no picture of it any more.
FEWEST_FRAMES = 5

#: Overlap at the bottom of the settled bed over the diameter: the bed is lower by about half of that share, more than a
#: softer contact is meant to cost, from the second on; at a radius (the first) it does not carry the bed.
STATIC_LARGEST, STATIC_LARGE = 0.5, 0.05
#: Contacts per particle for the stability limit of the DEM step.
CONTACTS_DENSE = 12.0
#: Contacts per particle for the step of tangential springs that stick: packings at rest are stable beyond that of four
#: (`kncal.study.stability.packings`, sizes 1 to 5, e_n 0.06 to 1); that of twelve is for certain.
CONTACTS_STICKING = 4.0
#: Walls that a particle touches at once, in a corner.
CORNER = 3


_Bodies = tuple[Particle, Particle | Wall]
#: Whom a limit concerns, how bad it is (within one sort), and what is said.
_Found = tuple[_Bodies, float, Finding]


def first_impacts_starts_and_rest(model: Plan) -> Iterator[Finding]:
    """Of bodies that are alike the worst: overlaps at the first impact, at the start and at rest."""
    return worst_of_each(model, [*first_impacts(model), *starts(model), *resting(model)])


def require_possible_scene(model: Plan) -> None:
    """Raise `CaseFileError` if a limit refuses the scene: something goes through something else for sure."""
    require_possible(worst_of_each(model, [*first_impacts(model), *resting(model)]))


def worst_of_each(model: Plan, found: Iterable[_Found]) -> Iterator[Finding]:
    """Of the findings about bodies that are alike the worst, and of each kind of limit a few."""
    worst: dict[tuple[str, str, SpeciesPair], tuple[float, Finding]] = {}
    number: dict[object, int] = {}
    for (a, b), bad, finding in found:
        key = (finding.code, finding.level, model.species.pair_of((a.name, b.name)))
        number[key] = number.get(key, 0) + 1
        if key not in worst or bad > worst[key][0]:
            worst[key] = bad, finding
    by_limit: dict[str, list[tuple[float, Finding, int]]] = {}
    for which, (bad, finding) in worst.items():
        by_limit.setdefault(finding.code, []).append((bad, finding, number[which] - 1))
    for code, each in by_limit.items():
        each.sort(key=lambda item: (item[1].level != "refuse", -item[0]))
        for _, finding, others in each[:MOST_ALIKE]:
            more = f" (the worst of {others + 1} pairs of bodies alike)" if others else ""
            yield replace(finding, message=finding.message + more)
        if len(each) > MOST_ALIKE:
            yield Finding(code, "warn", f"{len(each) - MOST_ALIKE} more kinds of pairs have the last of these limits")


def _pairs(model: Plan) -> Iterator[tuple[_Bodies, PairContact, str, float]]:
    """Bodies, contact, names in words, and the radius of the smaller sphere [m]."""
    for a, b in model.scene.body_pairs():
        smaller = a.radius if isinstance(b, Wall) else min(a.radius, b.radius)
        yield (a, b), model.between(a.name, b.name), f"{a.name}–{b.name}", smaller


def overlap_at(contact: PairContact, speed: float) -> float | None:
    """Return the largest overlap [m] of an impact at ``speed`` [m/s]: as v, or as v^(4/5) for Hertz; None without v_0.

    For the laws whose damping grows with the speed an upper bound above v_0.
    """
    if contact.delta_max is None or not contact.v_0:
        return None
    return float(contact.delta_max * (speed / contact.v_0) ** (2.0 / (contact.n + 1.0)))


def first_impacts(model: Plan) -> Iterator[_Found]:
    """The calibration refuses an overlap that reaches the radius at v_0; here at the speeds of the scene."""
    touches: list[tuple[float, float, float, str, float | None, _Bodies]] = []
    for (a, b), contact, who, radius in _pairs(model):
        touch = first_touch(model.scene, a, b)
        if touch is not None and (delta := overlap_at(contact, touch[1])) is not None:
            touches.append((touch[0], touch[1], delta / radius, who, contact.v_0, (a, b)))
    for k, (_, speed, share, who, v_0, bodies) in enumerate(sorted(touches, key=lambda touch: touch[:4])):
        if v_0 is None or speed <= v_0 * (1.0 + 1e-9) or share <= OVERLAP_DOUBTFUL:
            continue  # what happens at v_0 is said by the calibration
        through = share >= OVERLAP_MEANINGLESS
        text = (
            f"{who}: meets at {speed:.3g} m/s, {speed / v_0:.3g} times the v_0 that its contact is made for: the "
            f"overlap would be {share:.3g} of the smaller radius"
            f"{', so it goes through' if through else ''}: expected contact.v_0 of about that speed, or a stiffer "
            "contact"
        )
        # later ones may not come about, once the first has changed the motion
        yield bodies, share, Finding("first-impact", "refuse" if through and k == 0 else "warn", text)


def starts(model: Plan) -> Iterator[_Found]:
    """Find bodies that start deep in each other."""
    for bodies, _, who, radius in _pairs(model):
        share = initial_overlap(*bodies) / radius
        if share > START_LARGE:
            text = (
                f"{who}: starts with an overlap of {share:.3g} of the smaller radius, whose spring will throw it out: "
                f"expected at most {START_LARGE:g}, or a start without overlap"
            )
            yield bodies, share, Finding("start-overlap", "warn", text)


def resting(model: Plan) -> Iterator[_Found]:
    """Whether the contact carries the weight, of the sphere alone (certain) and of all spheres (the worst case)."""
    scene = model.scene
    masses = {p.name: float(sphere_mass(p.material, p.radius)) for p in scene.spheres}
    everything = sum(masses.values())
    for (a, b), contact, who, radius in _pairs(model):
        if not isinstance(b, Wall):
            continue
        axis = AXES.index(b.axis)
        pull = -math.copysign(1.0, a.position[axis] - b.position) * scene.gravity[axis]
        if pull <= 0.0:
            continue
        own, all_of_them = (
            (mass * pull / contact.k) ** (1.0 / contact.n) / radius for mass in (masses[a.name], everything)
        )
        if own >= OVERLAP_MEANINGLESS:
            text = (
                f"{who}: at rest the sphere's own weight needs an overlap of {own:.3g} radii: the contact can't carry "
                "it, it sinks through the wall: expected a stiffer contact"
            )
            yield (a, b), own, Finding("static-overlap", "refuse", text)
        elif max(own, all_of_them) > OVERLAP_DOUBTFUL:
            text = (
                f"{who}: under the weight of all spheres the overlap at rest is {all_of_them:.3g} of the radius (of "
                f"its own: {own:.3g}): expected at most {OVERLAP_DOUBTFUL:g}; take a stiffer contact"
            )
            yield (a, b), all_of_them, Finding("static-overlap", "warn", text)


def _deepest(model: Plan) -> Iterator[tuple[_Bodies, PairContact, str, float]]:
    """As `_pairs`, of each pair of species the two that start deepest in each other."""
    found: dict[SpeciesPair, tuple[float, tuple[_Bodies, PairContact, str, float]]] = {}
    for item in _pairs(model):
        (a, b), overlap = item[0], initial_overlap(*item[0])
        which = model.species.pair_of((a.name, b.name))
        if which not in found or overlap > found[which][0]:
            found[which] = overlap, item
    return (item for _, item in found.values())


def recording(model: Plan) -> Iterator[Finding]:
    """Whether frames are close enough for a contact to be seen in them; what is measured comes from frames alone."""
    if model.record_every == 1 or not model.contacts:
        return
    names, contact = min(model.named.items(), key=lambda item: item[1].t_c)
    fewest = contact.t_c / model.dt
    frames = fewest / model.record_every
    if frames >= FEWEST_FRAMES * (1.0 - 1e-9):
        return  # a contact of few steps is told by its step
    most = max(math.floor(fewest / FEWEST_FRAMES), 1)
    found = f"has {frames:.2g} frames" if frames >= 1.0 else "can pass between two frames, and is not seen then"
    yield Finding(
        "not-recorded",
        "warn",
        f"{'–'.join(names)}: a contact lasts {fewest:.3g} steps and with a frame every {model.record_every} steps "
        f"{found}: expected run.record_every = {most} at most",
    )


def _alike(contact: PairContact) -> tuple[str, float, str]:
    """What the error of a number of steps depends on."""
    return contact.law, contact.e_n, contact.end


def steps(model: Plan) -> Iterator[Finding]:
    """Find a time step that is not stable, or makes e_n wrong."""
    bodies = len(model.scene.bodies)
    most = float(min(max(bodies - 1, 1), MOST_CONTACTS))
    shortest = model.shortest
    # a step that is not stable is worse than a coarse one: one is enough, the step is one for all pairs
    worst: tuple[bool, float, Finding] | None = None
    pairs: list[tuple[PairContact, str, float]] = []
    stiff: list[tuple[float, float, float]] = []
    coarsest: dict[object, float] = {}
    for (a, b), c, who, _ in _deepest(model):
        delta = max(c.delta_max or 0.0, initial_overlap(a, b))
        if delta <= 0.0 and c.n != 1.0:
            continue  # never stiff: nothing is known to press it
        tangent = c.n * c.k * delta ** (c.n - 1.0) if c.n != 1.0 else c.k
        stiff.append((tangent, c.m_eff, c.c * delta**c.p if c.p else c.c))
        pairs.append((c, who, delta))
        coarsest[_alike(c)] = min(coarsest.get(_alike(c), math.inf), c.t_c)
    if not pairs:
        return
    k, mass, c_n = np.transpose(stiff)
    limits = [np.atleast_1d(verlet_limit(k, mass, c_n, z)).tolist() for z in (1.0, most)]
    for (contact, who, delta), one, many in zip(pairs, *limits, strict=True):
        found: tuple[bool, float, Finding] | None = None
        if model.dt >= one:
            text = (
                f"{who}: dt = {model.dt:.3g} s is {model.dt / one:.3g} of the largest stable step of one contact: "
                f"energy will be created, the result is wrong: expected at most {0.1 * one:.2g} s"
            )
            found = True, model.dt / one, Finding("dt-unstable", "warn", text)
        elif model.dt >= many:
            text = (
                f"{who}: dt = {model.dt:.3g} s is {model.dt / many:.3g} of the largest step that is stable for sure "
                f"with {most:g} contacts at once: expected at most {0.5 * many:.2g} s where so many touch"
            )
            found = True, model.dt / one, Finding("dt-unstable", "warn", text)
        elif model.dt >= (sticking := sticking_limit(contact, delta, most)):
            text = _swings(who, model.dt, sticking, most)
            found = True, model.dt / one, Finding("dt-unstable", "warn", text)
        elif contact.t_c > STEPS_MARGIN * coarsest[_alike(contact)]:
            continue  # the same impact in more steps: its error is smaller
        elif (coarse := step_error(contact, model.dt, shortest)) is not None:
            found = False, coarse.error, Finding("dt-coarse", "warn", f"{who}: {coarse}")
        if found is not None and (worst is None or found[:2] > worst[:2]):
            worst = found
    if worst is not None:
        yield worst[2]


def cohesion(model: Plan) -> Iterator[Finding]:
    """Find linear contacts whose cohesion pulls harder than their spring pushes."""
    for (a, b), c in model.named.items():
        share = pulled(c.k, c.n, c.cohesion, c.R_eff, 1.0) if c.n == 1.0 else 0.0
        if share >= 1.0:
            yield Finding(
                "cohesion",
                "refuse",
                f"{a}–{b}: cohesion pulls with {share:.3g} of the force by which the linear spring pushes, so the "
                "bodies fall into each other: expected less than 1; take a smaller cohesion_energy_density, a stiffer "
                "contact, or the hertz model",
            )


def sticking_limit(contact: PairContact, delta: float, contacts: float = 1.0) -> float:
    """Return the largest stable step [s] of a contact that sticks, at an overlap [m]; infinite without friction.

    Its contact point is 7/2 times as light as the spheres are: `verlet_limit` of 3.5 k_t and 3.5 c_t.
    """
    if contact.friction == 0.0 or contact.k_t == 0.0 or not contact.spring:
        return math.inf
    k_t, c_t = contact.k_t * delta ** (contact.n - 1.0), contact.c_t * delta**contact.p
    return float(verlet_limit(LIGHTER * k_t, contact.m_eff, LIGHTER * c_t, contacts))


def _swings(who: str, dt: float, limit: float, contacts: float) -> str:
    return (
        f"{who}: dt = {dt:.3g} s is {dt / limit:.3g} of the largest step at which a tangential spring that sticks is "
        f"stable, with {contacts:g} contacts at once: it swings up until it slips: expected at most {limit:.2g} s"
    )


def dem_steps(model: Plan) -> Iterator[Finding]:
    """Find a time step of a bed that is not stable, or makes e_n wrong."""
    others = model.scene.number - 1
    most = min(CONTACTS_DENSE, others + CORNER)
    warned: list[tuple[float, str]] = []
    for (a, b), contact in model.named.items():
        if a == b and not others:
            continue  # a lone particle meets none of its kind
        steps = contact.t_c / model.dt
        # tangent stiffness and damping at the largest overlap; those of the linear contact are constant
        delta = contact.delta_max or (1.0 if contact.n == 1.0 else 0.0)
        if delta > 0.0:
            stiffness = contact.n * contact.k * delta ** (contact.n - 1.0)
            limit = float(verlet_limit(stiffness, contact.m_eff, contact.c * delta**contact.p, most))
            if model.dt > limit:
                yield Finding(
                    "dem-step",
                    "refuse",
                    f"{a}–{b}: the DEM step of {model.dt:.3g} s is above the stability limit of a particle with "
                    f"{most:g} contacts, {limit:.3g} s ({steps:.3g} steps per contact): expected a larger "
                    "run.steps_per_contact",
                )
                continue
            stuck = min(most, CONTACTS_STICKING)
            if model.dt > (sticking := sticking_limit(contact, delta, stuck)):
                yield Finding("dem-step", "warn", _swings(f"{a}–{b}", model.dt, sticking, stuck))
                continue
        if (coarse := step_error(contact, model.dt, model.shortest)) is not None:
            warned.append((coarse.error, f"{a}–{b}: {coarse}"))
    warned.sort(key=lambda found: -found[0])
    for i, (_, text) in enumerate(warned[:MOST_ALIKE]):
        more = len(warned) - MOST_ALIKE if i == MOST_ALIKE - 1 else 0
        yield Finding("dem-step", "warn", text + (f"; {more} more pairs are less wrong" if more > 0 else ""))


def bottom_of_bed(model: Plan) -> Iterator[Finding]:
    """Find contacts too soft for the weight of the bed."""
    scene = model.scene
    if scene.frozen or scene.number == 0:
        return
    for pair, overlap in bottom_overlaps(model).items():
        a, b = model.species.names(pair)
        share = overlap / scene.diameter
        if share > STATIC_LARGE:
            refused = share >= STATIC_LARGEST
            yield Finding(
                "static-overlap",
                "refuse" if refused else "warn",
                f"{a}–{b}: the weight of {layers(model.scene):.3g} layers needs an overlap of {share:.2g} diameters at "
                f"the bottom of the bed{': the contact cannot carry it' if refused else ''}: expected at most "
                f"{STATIC_LARGE:g}; take a stiffer contact",
            )
