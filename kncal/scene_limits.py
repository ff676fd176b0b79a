"""What a scene of single contacts runs into, found before a run: refused, or said (for beds: `kncal.bed.limits`).

A calibration holds for v_0; a scene also has its own speeds, weights and start, and its time step. Solvers take any of
them without a word.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from kncal.ballistics import first_touch, initial_overlap
from kncal.finding import Finding, require_possible
from kncal.material import sphere_mass
from kncal.model import Model, PairContact
from kncal.scene import AXES, Particle, Wall
from kncal.step_error import step_error
from kncal.timestep import verlet_limit
from kncal.validity import OVERLAP_DOUBTFUL, OVERLAP_MEANINGLESS

#: Overlap at the start over the smaller radius that is worth a word; a stack squeezed on purpose starts with 0.2.
START_LARGE = 0.25
#: Most bodies that touch one sphere at once: its nearest neighbours in the densest packing of equal spheres.
MOST_CONTACTS = 12

_Bodies = tuple[Particle, Particle | Wall]


def check_scene(model: Model) -> tuple[Finding, ...]:
    """Return every limit that a scene runs into, refusals first; warnings of its contacts are in `PairContact`."""
    found = [*_first_impacts(model), *_starts(model), *_resting(model), *_steps(model)]
    return tuple(sorted(found, key=lambda finding: finding.level != "refuse"))


def require_possible_scene(model: Model) -> None:
    """Raise `CaseFileError` if a limit refuses the scene: something goes through something else for sure."""
    require_possible([*_first_impacts(model), *_resting(model)])


def warnings_of(models: Mapping[str, Model], *, usual: bool = True) -> tuple[str, ...]:
    """Return what is to be minded about the runs of these models, each text once, with whom it concerns.

    ``usual``: also what nearly every damped contact has, attraction at its end.
    """
    texts: dict[str, None] = {}
    for kind, model in models.items():
        texts |= {f"{kind}: {finding.message}": None for finding in check_scene(model) if finding.level == "warn"}
    pairs: dict[str, dict[str, None]] = {}
    for model in models.values():
        for pair, contact in model.contacts.items():
            for code, text in contact.warnings.items():
                if usual or code != "attraction":
                    pairs.setdefault(text, {})["–".join(pair)] = None
    return (*texts, *(f"{', '.join(names)}: {text}" for text, names in pairs.items()))


def _pairs(model: Model) -> Iterator[tuple[_Bodies, PairContact, str, float]]:
    """Bodies, contact, names in words, and the radius of the smaller sphere [m]."""
    for a, b in model.scene.body_pairs():
        smaller = a.radius if isinstance(b, Wall) else min(a.radius, b.radius)
        yield (a, b), model.contacts[a.name, b.name], f"{a.name}–{b.name}", smaller


def overlap_at(contact: PairContact, speed: float) -> float | None:
    """Return the largest overlap [m] of an impact at ``speed`` [m/s]: as v, or as v^(4/5) for Hertz; None without v_0.

    For the laws whose damping grows with the speed an upper bound above v_0.
    """
    if contact.delta_max is None or not contact.v_0:
        return None
    return float(contact.delta_max * (speed / contact.v_0) ** (2.0 / (contact.n + 1.0)))


def _first_impacts(model: Model) -> Iterator[Finding]:
    """The calibration refuses an overlap that reaches the radius at v_0; here at the speeds of the scene."""
    touches = []
    for (a, b), contact, who, radius in _pairs(model):
        touch = first_touch(model.scene, a, b)
        if touch is not None and (delta := overlap_at(contact, touch[1])) is not None:
            touches.append((touch[0], touch[1], delta / radius, who, contact.v_0))
    for k, (_, speed, share, who, v_0) in enumerate(sorted(touches)):
        if v_0 is None or speed <= v_0 * (1.0 + 1e-9) or share <= OVERLAP_DOUBTFUL:
            continue  # what happens at v_0 is said by the calibration
        through = share >= OVERLAP_MEANINGLESS
        yield Finding(
            "first-impact",
            # later ones may not come about, once the first has changed the motion
            "refuse" if through and k == 0 else "warn",
            f"{who}: meets at {speed:.3g} m/s, {speed / v_0:.3g} times the v_0 that its contact is made for: the "
            f"overlap would be {share:.3g} of the smaller radius"
            f"{', so it goes through' if through else ''}: expected contact.v_0 of about that speed, or a stiffer "
            "contact",
        )


def _starts(model: Model) -> Iterator[Finding]:
    for (a, b), _, who, radius in _pairs(model):
        share = initial_overlap(a, b) / radius
        if share > START_LARGE:
            yield Finding(
                "start-overlap",
                "warn",
                f"{who}: starts with an overlap of {share:.3g} of the smaller radius, whose spring will throw it out: "
                f"expected at most {START_LARGE:g}, or a start without overlap",
            )


def _resting(model: Model) -> Iterator[Finding]:
    """Whether the contact carries the weight, of the sphere alone (certain) and of all spheres (the worst case)."""
    scene = model.scene
    masses = {p.name: float(sphere_mass(p.material, p.radius)) for p in scene.particles}
    for (a, b), contact, who, radius in _pairs(model):
        if not isinstance(b, Wall):
            continue
        axis = AXES.index(b.axis)
        pull = -math.copysign(1.0, a.position[axis] - b.position) * scene.gravity[axis]
        if pull <= 0.0:
            continue
        own, all_of_them = (
            (mass * pull / contact.k) ** (1.0 / contact.n) / radius for mass in (masses[a.name], sum(masses.values()))
        )
        if own >= OVERLAP_MEANINGLESS:
            yield Finding(
                "static-overlap",
                "refuse",
                f"{who}: at rest the sphere's own weight needs an overlap of {own:.3g} radii: the contact can't carry "
                "it, it sinks through the wall: expected a stiffer contact",
            )
        elif max(own, all_of_them) > OVERLAP_DOUBTFUL:
            yield Finding(
                "static-overlap",
                "warn",
                f"{who}: under the weight of all spheres the overlap at rest is {all_of_them:.3g} of the radius (of "
                f"its own: {own:.3g}): expected at most {OVERLAP_DOUBTFUL:g}; take a stiffer contact",
            )


def _steps(model: Model) -> Iterator[Finding]:
    bodies = len(model.scene.bodies)
    most = float(min(max(bodies - 1, 1), MOST_CONTACTS))
    shortest = min(c.t_c for c in model.contacts.values())
    # a step that is not stable is worse than a coarse one: one is enough, the step is one for all pairs
    worst: tuple[bool, float, Finding] | None = None
    for (a, b), contact, who, _ in _pairs(model):
        delta = max(contact.delta_max or 0.0, initial_overlap(a, b))
        if delta <= 0.0 and contact.n != 1.0:
            continue  # never stiff: nothing is known to press it
        stiffness = contact.n * contact.k * delta ** (contact.n - 1.0) if contact.n != 1.0 else contact.k
        damping = contact.c * delta**contact.p if contact.p else contact.c
        one, many = (float(verlet_limit(stiffness, contact.m_eff, damping, z)) for z in (1.0, most))
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
        elif (coarse := step_error(contact, model.dt, shortest)) is not None:
            found = False, coarse.error, Finding("dt-coarse", "warn", f"{who}: {coarse}")
        if found is not None and (worst is None or found[:2] > worst[:2]):
            worst = found
    if worst is not None:
        yield worst[2]
