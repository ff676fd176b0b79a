"""What softness does to the physics: signs that a contact is too soft, each with its limit and where that is from.

A sign tells of the run itself, whatever a tolerance says: a metric may agree by luck in a scene whose particles overlap
too far.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.observe.averages import OVERLAP_LIMIT
from kncal.observe.estimate import apart, averaged, decide
from kncal.observe.run_data import RunData
from kncal.physics.calibration import OVERLAP_DOUBTFUL
from kncal.physics.material import sphere_mass
from kncal.physics.statistics import MIN_SAMPLES, average, start_up
from kncal.record.series import BedSeries
from kncal.scene.bodies import Particle
from kncal.scene.load import bottom_overlaps
from kncal.scene.model import PairContact, Plan
from kncal.scene.species import SpeciesPair

#: Speed over the speed of sound of a chain: at 0.1 densities vary by about 1 %.
MACH_LIMIT = 0.1
#: Contacts per particle against those of the reference.
CONTACTS_LIMIT = 0.1
#: Overlap under the weight above it, over the diameter: a bed is lower by half of that of its bottom.
STATIC_LIMIT = OVERLAP_LIMIT

_CUSTOM = "customary bound on overlaps, 0.1 to 1 % of the diameter (after Lan & Rosato, Phys. Fluids 9 (1997) 3615)"
#: Sign -> the limit from which it matters, and where that is from.
_LIMITS: Mapping[str, tuple[float, str]] = {
    "overlap_share": (
        OVERLAP_DOUBTFUL,
        "small-overlap theory of both models (kncal warns beyond it; MFIX reports overlaps above 0.2 R)",
    ),
    "mean_overlap": (OVERLAP_LIMIT, _CUSTOM),
    "static_overlap": (STATIC_LIMIT, _CUSTOM),
    "leaking": (
        0.0,
        "a particle is through when its centre is: with 100 N/m they pass a cyclone's wall, with 1000 not (MFIX FAQ)",
    ),
    "sound_speed": (
        MACH_LIMIT,
        "sound ten times as fast as what moves keeps densities within 1 % (Monaghan, J. Comput. Phys. 110 (1994) 399)",
    ),
    "contact_number": (CONTACTS_LIMIT, "a convention of kncal: a tenth"),
}


@dataclass(frozen=True, kw_only=True)
class Sign:
    """One way in which softness changes the physics.

    Attributes
    ----------
    name : one of `_LIMITS`
    value : what was found [-]
    limit : where it begins to matter [-]; ``source``: of this limit
    changed : whether it is beyond the limit
    text : one sentence
    """

    name: str
    value: float
    limit: float
    source: str
    changed: bool
    text: str


def signs(data: RunData, reference: RunData | None = None) -> tuple[Sign, ...]:
    """Return what softness did in a completed run; with the ``reference`` (of the same scene) also against it.

    Raises
    ------
    InputError
        If a bed ran too short for any average.
    """
    if data.signals is not None:
        return _of_signals(data, reference)
    return _of_contacts(data, None if reference is None else reference.model)


def sound_speed(contact: PairContact, diameter: float, mass: float) -> float:
    """Return the speed of long waves along a chain of equal particles [m/s]: d sqrt(k_n/m).

    From omega = 2 sqrt(k/m) sin(q d/2) of masses and springs (Kittel, Introduction to Solid State Physics, chapter 4).
    For Hertz k is the secant stiffness at the impact speed (`secant`).

    Parameters
    ----------
    diameter : of a particle, the distance of two [m]; mass : of a particle [kg]
    """
    return diameter * math.sqrt(secant(contact) / mass)


def secant(contact: PairContact) -> float:
    """Return the stiffness of a contact [N/m]: k_n; for Hertz k_h sqrt(delta_max) at v_0, or that of the duration."""
    if contact.n == 1.0:
        return contact.k
    if contact.delta_max is not None:
        return float(contact.k * contact.delta_max ** (contact.n - 1.0))
    return math.pi**2 * contact.m_eff / contact.t_c**2


def model_signs(model: Plan) -> tuple[Sign, ...]:
    """Return the signs of a bed that need no run: the overlap under its weight, and the speed of sound."""
    if not model.contacts:
        return ()
    scene = model.scene
    d = scene.d_min
    return (_static(max(bottom_overlaps(model).values()) / d, "at the bottom of the bed at rest"), _sound_of(model))


# --- of signals ---------------------------------------------------------------


def _of_signals(data: RunData, reference: RunData | None) -> tuple[Sign, ...]:
    model, series = data.model, data.series
    if not model.contacts or not np.isfinite(series.overlap_max).any():
        return ()
    d = 2.0 * min(series.facts.radii)
    begin = _settled(series)
    largest = float(np.nanmax(series.overlap_max))
    mean = float(np.nanmean(series.overlap_mean[begin:]))
    found = [
        _overlap_share(largest / (0.5 * d), "between two particles, of the whole run"),
        _mean_overlap(mean / d),
        *_leaks(data, largest / (0.5 * d)),
        *model_signs(model),
    ]
    if reference is not None and np.isfinite(reference.series.contacts).any():
        found.append(_contact_number(data, reference))
        found[-2] = _sound_of(model, reference.model)
    return tuple(found)


def _sound_of(model: Plan, reference: Plan | None = None) -> Sign:
    scene = model.scene
    contact, d = _shortest(model.contacts), scene.d_min
    smallest = min(scene.spheres, key=lambda sphere: sphere.radius)
    mass = float(sphere_mass(smallest.material, smallest.radius))
    fastest = {"v_0": contact.v_0 or 0.0, "U_0": scene.inlet_at(0.0)}
    name = max(fastest, key=fastest.__getitem__)
    other = None if reference is None else _shortest(reference.contacts)
    return _sound(fastest[name], name, contact, d, mass, other)


def _contact_number(data: RunData, reference: RunData) -> Sign:
    """Contacts per particle against the reference: changed if the whole interval is beyond the limit."""
    sides = []
    for series in (data.series, reference.series):
        begin = float(series.t[min(_settled(series), max(len(series.t) - MIN_SAMPLES, 0))])
        each = 2.0 * series.contacts / np.maximum(series.number, 1)
        sides.append(averaged(average(series.t, each, begin), begin, float(series.t[-1])))
    here, there = sides
    between = apart(here, there, abs(there.value or math.nan), ("run", "reference"))
    relative, width = between.value or 0.0, between.deciding
    found = decide(abs(relative), width, CONTACTS_LIMIT)
    undecided = "; undecided, the runs are short" if found == "undecided" else ""
    text = (
        f"{here.value:.3g} contacts per particle, {there.value:.3g} in the reference:"
        f" {100.0 * relative:+.2g} ± {100.0 * width:.2g} %{undecided}."
    )
    return _sign("contact_number", relative, text, changed=found == "outside")


def _settled(series: BedSeries) -> int:
    """Return the coupling at which the height of the particles has settled; while there are none it is not known."""
    there = np.flatnonzero(np.isfinite(series.z_mean))
    return int(there[0]) + start_up(series.z_mean[there]) if len(there) else 0


def _leaks(data: RunData, softness: float) -> Iterator[Sign]:
    """Yield whether particles leave through the walls of a box, where these are all walls."""
    facts = data.series.facts
    if data.model.scene.run.coupling is not None:
        yield _leaking(sum(_beyond(x, facts.size, facts.front_back) for x in data.series.x), softness)


def _beyond(x: Array | np.ndarray[tuple[int, ...], np.dtype[np.float32]], size: Iterable[float], depth: str) -> int:
    """Count the centres (n, 3) that are beyond a wall of the box 0 … size."""
    high = np.array(tuple(size))
    outside = (x < 0.0) | (x > high)
    if depth != "walls":
        outside = outside[..., [0, 2]]
    return int(outside.any(axis=-1).sum())


# --- of single contacts -------------------------------------------------------


def _of_contacts(data: RunData, reference: Plan | None) -> tuple[Sign, ...]:
    model, events = data.model, data.observations.contacts
    if not events:
        return ()
    bodies = {p.name: p for p in model.scene.spheres}
    radius = {
        (a.name, b.name): min(body.radius for body in (a, b) if isinstance(body, Particle))
        for a, b in model.scene.body_pairs()
    }
    worst = max(events, key=lambda event: event.delta_max / radius[event.pair])
    share = worst.delta_max / radius[worst.pair]
    mean = max(event.delta_mean / (2.0 * radius[event.pair]) for event in events)
    softest = max(radius, key=lambda pair: _at_rest(model, pair) / radius[pair])
    found = [
        _overlap_share(share, f"of {'–'.join(worst.pair)}"),
        _mean_overlap(mean),
        _leaking(_through(data), share),
        _static(_at_rest(model, softest) / (2.0 * radius[softest]), f"of {'–'.join(softest)} under its own weight"),
    ]
    fastest = max(events, key=lambda event: event.v_in)
    contact, r = model.between(*fastest.pair), radius[fastest.pair]
    mass = min(_mass(bodies[name]) for name in fastest.pair if name in bodies)
    other = None if reference is None else reference.between(*fastest.pair)
    found.append(_sound(fastest.v_in, "the impact speed", contact, 2.0 * r, mass, other))
    return tuple(found)


def _mass(particle: Particle) -> float:
    return float(sphere_mass(particle.material, particle.radius))


def _at_rest(model: Plan, pair: tuple[str, str]) -> float:
    scene = model.scene
    masses = [_mass(p) for p in scene.spheres if p.name in pair]
    pull = float(np.linalg.norm(scene.gravity))
    return model.between(*pair).overlap_under(min(masses) * pull)


def _through(data: RunData) -> int:
    """Count the pairs of a particle and a wall whose overlap was more than the radius."""
    radius = {p.name: p.radius for p in data.model.scene.spheres}
    walls = {wall.name for wall in data.model.scene.planes}
    return sum(
        bool((series.delta > sum(radius.get(name, 0.0) for name in pair)).any())
        for pair, series in data.observations.series.items()
        if any(name in walls for name in pair)
    )


# --- each sign ----------------------------------------------------------------


def _sign(name: str, value: float, text: str, *, changed: bool | None = None) -> Sign:
    """Return a sign; ``changed``: None if it is so above its limit."""
    limit, source = _LIMITS[name]
    return Sign(
        name=name,
        value=value,
        limit=limit,
        source=source,
        changed=value > limit if changed is None else changed,
        text=text,
    )


def _overlap_share(value: float, where: str) -> Sign:
    return _sign("overlap_share", value, f"The largest overlap {where} is {value:.3g} of the radius.")


def _mean_overlap(value: float) -> Sign:
    return _sign("mean_overlap", value, f"The mean overlap of a contact is {100.0 * value:.3g} % of the diameter.")


def _leaking(number: int, overlap: float) -> Sign:
    deep = overlap >= 1.0
    passed = ", and two particles overlapped by a radius or more: they may pass each other" if deep else ""
    return _sign("leaking", float(number), f"{number} centre(s) beyond a wall{passed}.", changed=number > 0 or deep)


def _static(value: float, where: str) -> Sign:
    return _sign("static_overlap", value, f"The overlap {where} is {100.0 * value:.3g} % of the diameter.")


def _sound(speed: float, what: str, contact: PairContact, d: float, mass: float, reference: PairContact | None) -> Sign:
    c = sound_speed(contact, d, mass)
    text = f"Sound would travel at {c:.3g} m/s along a chain of such particles, {what} is {speed:.3g} m/s"
    if reference is not None:
        text += f"; with the real contact it is {math.sqrt(secant(reference) / secant(contact)):.3g} times as fast"
    return _sign("sound_speed", speed / c, f"{text}.")


def _shortest(contacts: Mapping[SpeciesPair, PairContact]) -> PairContact:
    return min(contacts.values(), key=lambda contact: contact.t_c)
