"""What is compared: the registry of metrics, what each needs of a record, and which a kind of bed has."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

from kncal.core.registry import Registry

#: What a run records -> what it is. A metric is offered where all that it needs is recorded.
RECORDS: Mapping[str, str] = {
    "contacts": "the motion of a few particles, dense in time during each contact",
    "frames": "positions and velocities of the particles at some times",
    "series:pressure": "pressure of the gas at the inlet, per coupling",
    "series:forces": "forces of gas, floor and walls, per coupling",
    "series:particles": "height, energy and momentum of the particles, per coupling",
    "series:overlaps": "number and overlaps of the contacts, per coupling",
    "fields:eps_g": "the void fraction of the gas, in some cells and at some times",
    "frames:grains": "positions and kinds of many particles without gas, at some times",
    "frames:kinds": "the same of several groups or sizes",
    "frames:surface": "the same of a scene that says which surface it has (observe.surface)",
    "series:outlets": "what passed the outlets, per interval",
    "series:grains": "mass inside and energies of many particles without gas, per interval",
    "series:walls": "forces on the walls by height, per interval",
}
#: What the run of a few particles records, and what that of a bed does.
FEW_PARTICLES = ("contacts", "frames")
COUPLED = tuple(name for name in RECORDS if name != "contacts")

#: How two values are compared: over that of the reference (or a natural scale where that is zero), as they are, by the
#: distance of two paths, or by the rms difference of two fields.
DIFFERENCES = ("relative", "absolute", "path", "field")

#: Kinds of beds: see `kncal.observe.signals.bed_kind`.
KINDS_OF_BEDS: Mapping[str, str] = {
    "gas": "gas alone",
    "single": "a single particle",
    "frozen": "a frozen bed (the particles do not move)",
    "ramp": "a bed in a gas velocity that changes",
    "steady": "a moving bed in a steady gas velocity, or a steady flow without gas",
    "resting": "particles at rest, without gas",
    "passing": "particles that run in or out, without gas",
}


@dataclass(frozen=True)
class Metric:
    """A named quantity of a run.

    Attributes
    ----------
    name, unit, text : of it; "–" for a number without a unit
    needs : what must be recorded, names of `RECORDS`
    difference : how two of them are compared, one of `DIFFERENCES`
    of : kinds of beds for which it means something (`KINDS_OF_BEDS`)
    each : whether every contact has it, the later ones with a suffix: ``t_c_2``
    function : of a package that adds a metric: a run (`kncal.observe.runs`) -> number or
        `kncal.observe.estimate.Estimate`; None: computed with others in `kncal.observe`
    """

    name: str
    unit: str
    text: str
    needs: tuple[str, ...]
    difference: str = "relative"
    of: tuple[str, ...] = tuple(KINDS_OF_BEDS)
    each: bool = False
    function: Callable[[Any], Any] | None = None


_CONTACT, _PARTICLES, _OVERLAPS = ("contacts",), ("series:particles",), ("series:overlaps",)
_PRESSURE, _FIELD = ("series:pressure",), ("fields:eps_g",)
_BALANCE = (*_PRESSURE, "series:forces", *_PARTICLES)
_STEADY, _RAMP, _SINGLE = ("steady", "resting"), ("ramp",), ("single",)
_FLOWING = ("gas", "frozen", "steady", "resting", "passing")
_GRAINS, _KINDS, _SURFACE = ("frames:grains",), ("frames:kinds",), ("frames:surface",)
_MOVING, _ANY, _REST = ("steady",), ("steady", "resting", "passing"), ("resting",)


def _bed(
    name: str, unit: str, text: str, needs: tuple[str, ...], of: tuple[str, ...] = _STEADY, difference: str = "relative"
) -> Metric:
    return Metric(name, unit, text, needs, difference, of)


#: Every metric by its name, in the order of the rows of a comparison; a case may set a tolerance for each that its runs
#: can have. Packages add to it by entry points of the group ``kncal.metrics``.
METRICS: Registry[Metric] = Registry(
    "metric",
    Metric,
    # of contacts
    Metric("e_n", "–", "normal restitution", _CONTACT, each=True),
    Metric("t_c", "s", "contact duration", _CONTACT, each=True),
    Metric("delta_max", "m", "maximum overlap", _CONTACT, each=True),
    Metric("delta_mean", "m", "mean overlap", _CONTACT, each=True),
    Metric("v_out", "m/s", "relative normal speed after the contact", _CONTACT, each=True),
    Metric("rebound_height", "m", "rebound height", _CONTACT, each=True),
    Metric("slip_end_time", "s", "time at which slip ends", _CONTACT),
    Metric("slip_end_speed", "m/s", "speed at which slip ends", _CONTACT),
    Metric("tangential_restitution", "–", "tangential restitution", _CONTACT),
    Metric("spin_out", "rad/s", "spin after the contact", _CONTACT),
    Metric("slip_out", "m/s", "speed of the contact point along the other body after the contact", _CONTACT),
    Metric("rebound_angle", "rad", "rebound angle", _CONTACT),
    Metric("trajectory", "–", "largest distance of the two paths / extent of the motion", _CONTACT, "path"),
    Metric("trajectory_rms", "–", "rms distance of the two paths / extent of the motion", _CONTACT, "path"),
    # of beds: one value each
    _bed(
        "velocity", "m/s", "final velocity of a single particle, upwards, relative to the column", _PARTICLES, _SINGLE
    ),
    _bed(
        "slip", "m/s", "final velocity of a single particle, downwards, relative to the gas (U_0)", _PARTICLES, _SINGLE
    ),
    _bed(
        "ergun_ratio",
        "–",
        "pressure gradient over Ergun's, each cell with its own void fraction and velocity;"
        " of several gas velocities the one farthest from 1",
        _FIELD,
        ("frozen",),
    ),
    _bed(
        "U_mf",
        "m/s",
        "minimum fluidisation velocity: falling gas velocity, packed bed's curve meets weight/area",
        _PRESSURE,
        _RAMP,
    ),
    _bed("U_mf_rising", "m/s", "the same with rising gas velocity, from the packing at the start", _PRESSURE, _RAMP),
    _bed(
        "overshoot",
        "–",
        "largest pressure drop with rising gas velocity, over weight/area, less 1",
        _PRESSURE,
        _RAMP,
        "absolute",
    ),
    _bed(
        "plateau",
        "–",
        "mean pressure drop of the fluidised bed over weight/area, falling gas velocity",
        _PRESSURE,
        _RAMP,
    ),
    _bed("eps_mf", "–", "mean void fraction of the packed bed of the falling branch", _FIELD, _RAMP),
    # of beds: averages over time, after the start-up
    _bed("pressure_drop", "Pa", "gauge pressure at the inlet", _PRESSURE, _FLOWING),
    _bed("pressure_fluctuation", "Pa", "standard deviation of the pressure at the inlet", _PRESSURE, _FLOWING),
    _bed(
        "dominant_frequency", "Hz", "frequency of the largest peak of the pressure drop's spectrum", _PRESSURE, _FLOWING
    ),
    _bed(
        "weight_balance",
        "–",
        "gas force on the particles plus reaction of floor and walls, over their weight",
        ("series:forces",),
    ),
    _bed(
        "weight_closure",
        "–",
        "(Δp A + floor + walls − weight − change of momentum)/weight, gas weight taken off",
        _BALANCE,
        ("ramp", "steady"),
        "absolute",
    ),
    _bed("floor_share", "–", "share of the bed's weight that stands on the floor", ("series:forces",)),
    _bed("z_mean", "m", "mean height of the particles", _PARTICLES),
    _bed("z_95", "m", "height below which 95 % of the particles are", _PARTICLES),
    _bed("bed_height", "m", "height at which the laterally averaged void fraction crosses 0.8", _FIELD),
    _bed("height_pressure", "m", "height at which the pressure line of the bed meets that of the freeboard", _FIELD),
    _bed("voidage", "–", "mean void fraction below the bed height", _FIELD),
    _bed("eps_g", "–", "rms difference of the time-mean void fraction fields", _FIELD, _STEADY, "field"),
    _bed("bubble_number", "–", "bubbles in the bed at a time", _FIELD),
    _bed("bubble_share", "–", "share of the bed's volume that is bubbles", _FIELD),
    _bed("bubble_diameter", "m", "mean equivalent diameter of the bubbles", _FIELD),
    _bed("bubble_velocity", "m/s", "mean rise velocity of the bubbles", _FIELD),
    _bed("kinetic_energy", "J", "kinetic energy of the particles' translation", _PARTICLES, _MOVING),
    _bed(
        "granular_temperature",
        "m²/s²",
        "mean square of the particles' velocity fluctuation, per direction",
        ("frames", "series:particles"),
        _MOVING,
    ),
    _bed("contacts", "–", "number of contacts between particles", _OVERLAPS),
    _bed("overlap_mean", "m", "mean overlap of all contacts", _OVERLAPS),
    _bed("overlap_max", "m", "largest overlap of the run", _OVERLAPS, ("ramp", *_ANY)),
    _bed("overlap_share", "–", "share of contacts with an overlap above 1 % of the diameter", _OVERLAPS),
    # of many particles without gas
    _bed(
        "mass_flow",
        "kg/s",
        "mass flow rate through the outlets where particles leave, in its steady part",
        ("series:outlets",),
        _ANY,
    ),
    _bed("residence_time", "s", "mass inside over the mass flow rate", ("series:outlets",), _MOVING),
    _bed("angle_of_repose", "°", "angle of the surface at rest to the horizontal", _SURFACE, _REST),
    _bed("dynamic_angle", "°", "mean angle of the moving surface to the horizontal", _SURFACE, ("steady", "passing")),
    _bed("packing_fraction", "–", "solids fraction away from walls and surfaces", _GRAINS, _ANY),
    _bed("coordination", "–", "mean number of contacts with particles, rattlers left out", _GRAINS),
    _bed("rattlers", "–", "share of particles that carry nothing", _GRAINS, difference="absolute"),
    _bed("anisotropy", "–", "anisotropy of the directions of contacts", _GRAINS, difference="absolute"),
    _bed("speed", "m/s", "mean speed of the particles", _GRAINS, ("steady", "passing")),
    _bed("profile_exponent", "–", "exponent of the velocity profile of a layer that flows on a base", _GRAINS, _MOVING),
    _bed("mixing_index", "–", "Lacey's mixing index at the end", _KINDS, _STEADY, "absolute"),
    _bed("segregation", "–", "intensity of segregation at the end", _KINDS, _STEADY, "absolute"),
    _bed("mixing_time", "s", "time until the mixing index has gone 90 % of its way", _KINDS),
    _bed("support", "–", "vertical force on all walls over the weight of the particles", ("series:walls",)),
    _bed("wall_share", "–", "share of the weight on walls other than floors", ("series:walls",), _REST, "absolute"),
    _bed(
        "janssen_length",
        "m",
        "length D/(4 K μ) of Janssen's law, fitted to the walls' forces",
        ("series:walls",),
        _REST,
    ),
    _bed("janssen_k_mu", "–", "K μ of Janssen's law", ("series:walls",), _REST),
    _bed("kinetic_rotation", "J", "kinetic energy of the particles' rotation", ("series:grains",), _MOVING),
    _bed("dissipation", "W", "power that contacts and still walls take", ("series:grains", "frames:grains"), _MOVING),
    group="kncal.metrics",
)
_ORDER = {name: place for place, name in enumerate(METRICS)}
_FLOW = ("pressure_drop", "pressure_fluctuation", "dominant_frequency")


def offered(recorded: Collection[str]) -> tuple[str, ...]:
    """Return the metrics that a run can have that records ``recorded`` (names of `RECORDS`)."""
    return tuple(name for name, metric in METRICS.items() if set(metric.needs) <= set(recorded))


def split_metric(name: str) -> tuple[str, int]:
    """Return the metric and the number of the contact: ("t_c", 2) for "t_c_2", ("t_c", 1) for "t_c"."""
    found = None if name in METRICS else re.fullmatch(r"(.+?)_(\d+)", name)
    return (found[1], int(found[2])) if found else (name, 1)


def metric_order(name: str) -> tuple[int, int, str]:
    """Return the key to sort metrics by: contact after contact, each as in `METRICS`."""
    base, contact = split_metric(name)
    return contact, _ORDER.get(base, len(_ORDER)), name


def metric_unit(name: str) -> str:
    """Return the unit of a metric, "" for a name that kncal doesn't know."""
    base, _ = split_metric(name)
    return METRICS[base].unit if base in METRICS else ""


def metric_text(name: str) -> str:
    """Return a metric in words, e.g. "contact duration, contact 2"; the name itself if kncal doesn't know it."""
    base, contact = split_metric(name)
    text = METRICS[base].text if base in METRICS else name
    return text if contact == 1 else f"{text}, contact {contact}"


def why_not(name: str, kind: str, changes: bool) -> str:
    """Return why a bed of ``kind`` has no metric ``name``; empty if it may have it, or kncal does not know the name.

    ``changes``: see `kncal.observe.signals.gas_changes`.
    """
    of = METRICS[name].of if name in METRICS else tuple(KINDS_OF_BEDS)
    if kind not in of:
        if kind == "ramp" and "steady" in of:
            return "the gas velocity changes: it would be an average over different states"
        own = [text for other, text in KINDS_OF_BEDS.items() if other in of]
        return f"only of {' or '.join(own)}; this is {KINDS_OF_BEDS[kind]}"
    if changes and name in _FLOW:
        return "the gas velocity changes: it would be an average over different states"
    return ""
