"""The metrics of many particles without gas: each computed of `GrainObservations`, by one table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from kncal.core.errors import InputError
from kncal.observe.coarse_graining import local_temperature
from kncal.observe.estimate import Estimate, averaged, missing
from kncal.observe.granular import GrainObservations
from kncal.observe.mixing import CELL, cells_of, mixing_time
from kncal.observe.signals import rows_from
from kncal.physics.statistics import MIN_SAMPLES, average, average_of_samples

#: A mixing index that rises by less is no mixing.
_MIXES = 0.25
#: Metric of a packing at rest -> those whose parts tell how far another packing might be: the least certain counts.
_LIKE = {
    "z_mean": ("packing_fraction", "angle_of_repose"),
    "z_95": ("packing_fraction", "angle_of_repose"),
    "contacts": ("coordination", "angle_of_repose"),
    "overlap_mean": ("coordination", "angle_of_repose"),
    "overlap_max": ("coordination",),
    "overlap_share": ("coordination",),
    "floor_share": ("janssen_length",),
    "wall_share": ("janssen_length",),
}


def one_packing(name: str, found: Estimate, estimates: Mapping[str, Estimate]) -> Estimate:
    """Return an average over time of particles at rest with the width that another packing might differ by.

    That time changes nothing says nothing of chance: the relative width is that of a metric whose parts differ, and
    the whole value where there is none. It is not reliable.
    """
    if name not in _LIKE or found.value is None:
        return found
    like = [estimates.get(other, missing("")) for other in _LIKE[name]]
    share = max((one.width / abs(one.value) for one in like if one.value and one.width is not None), default=1.0)
    why = "one packing at rest: how far another would differ is estimated from parts of it"
    of = 1.0 - found.value if name == "floor_share" else found.value  # walls carry the rest
    width = max(found.width or 0.0, share * abs(of))
    return replace(found, width=width, reliable=False, why=why, average=None)


def grain_estimate(seen: GrainObservations, name: str) -> Estimate:
    """Return a metric of the table; one without a value, and why, if the run does not have it."""
    try:
        return GRAIN_METRICS[name](seen)
    except InputError as error:
        return missing(str(error))


def _wider(found: Estimate, by: float) -> Estimate:
    """Return an estimate with another, independent uncertainty in its width."""
    return replace(found, width=None if found.width is None else float(np.hypot(found.width, by)))


# --- flow ---------------------------------------------------------------------------------------------------------


def _mass_flow(seen: GrainObservations) -> Estimate:
    flow = seen.flow
    return replace(
        seen.averaged(flow.rate),
        started=True,
        reliable=flow.rate.reliable,
        why=flow.rate.why,
        begin=flow.begin,
        end=flow.end,
    )


def _residence(seen: GrainObservations) -> Estimate:
    """Mass inside over the mass flow, where both are steady (Little's law)."""
    if seen.kind != "steady":
        raise InputError("the mass inside changes, or nothing moves: expected as much to come in as goes out")
    inside, rate = seen.over_rows(seen.series.mass), _mass_flow(seen)
    if not inside.value or not rate.value:
        raise InputError("nothing is inside, or nothing leaves")
    value = inside.value / rate.value
    share = float(np.hypot((inside.width or 0.0) / inside.value, (rate.width or 0.0) / rate.value))
    return replace(
        inside,
        value=value,
        width=value * share,
        reliable=inside.reliable and rate.reliable,
        why="; ".join(filter(None, (inside.why, rate.why))),
        average=None,
    )


def _speed(seen: GrainObservations) -> Estimate:
    """Mean speed of the particles, each by its mass."""
    found = [
        float(np.average(np.linalg.norm(f.v, axis=1), weights=f.mass)) if len(f.x) else np.nan
        for f in seen.flowing(seen.of_window)
    ]
    return seen.over_frames(np.array(found))


def _temperature(seen: GrainObservations) -> Estimate:
    """Granular temperature about the affine motion of `CELL` neighbours, in each frame."""
    flat = 2 if seen.scene.layer else 3
    values = [local_temperature(f.x, f.v, cells_of(f.x, CELL), flat) for f in seen.flowing(seen.of_window)]
    return seen.over_frames(np.array(values))


def _exponent(seen: GrainObservations) -> Estimate:
    found = average_of_samples(seen.exponents)
    return Estimate(value=found.mean, width=found.uncertainty, reliable=found.reliable, why=found.why, chance=True)


def _dissipation(seen: GrainObservations) -> Estimate:
    """Power of gravity on the particles less the growth of their kinetic energy: what contacts and still walls take."""
    if not all(wall.stays_whole for wall in seen.scene.walls.values()):
        raise InputError("walls move: the power that they add is not recorded")
    if seen.series.facts.outlets or any(group.place == "stream" for group in seen.scene.particles.values()):
        raise InputError("particles come or go: the energy that they carry is not recorded")
    gravity = np.asarray(seen.scene.gravity)
    power = seen.over_frames(np.array([f.mass @ (f.v @ gravity) for f in seen.flowing(seen.of_window)]))
    rows = rows_from(seen.series, seen.window.begin)
    energy = (seen.series.kinetic_energy + seen.series.kinetic_rotation)[rows]
    grown = float(energy[-1] - energy[0]) / float(np.ptp(seen.series.t[rows]))
    return replace(power, value=(power.value or 0.0) - grown)


# --- surface and packing ------------------------------------------------------------------------------------------


def _angle(seen: GrainObservations) -> Estimate:
    """The angle of the surface; what the choice of the flank moves adds to its width."""
    values = np.array([fit.angle for fit in seen.fits])
    found = seen.state(values, seen.angles)
    if seen.resting and (found.width is None or not found.reliable):  # too few parts: as rough as the surface is
        found = Estimate(value=float(values[-1]), width=seen.fits[-1].error, chance=True)
    return _wider(found, float(np.mean([fit.choice for fit in seen.fits])))


def _static_angle(seen: GrainObservations) -> Estimate:
    if not seen.resting:
        raise InputError("the particles are not at rest at the end: run longer")
    return _angle(seen)


def _dynamic_angle(seen: GrainObservations) -> Estimate:
    if seen.resting:
        raise InputError("the particles are at rest")
    return _angle(seen)


def _fraction(seen: GrainObservations) -> Estimate:
    return seen.state(np.array([one.bulk.fraction for one in seen.packings]), lambda _: seen.packings[-1].bulk.parts)


def _coordination(seen: GrainObservations) -> Estimate:
    found = seen.state(np.array([one.coordination for one in seen.packings]), lambda _: seen.packings[-1].each[:, 0])
    return _wider(found, float(np.mean([one.precision for one in seen.packings])))


def _rattlers(seen: GrainObservations) -> Estimate:
    return seen.state(np.array([one.rattlers for one in seen.packings]), lambda _: seen.packings[-1].each[:, 1])


def _anisotropy(seen: GrainObservations) -> Estimate:
    """At rest it is known to what chance gives of so many contacts."""
    if not seen.resting:
        return seen.over_frames(np.array([one.anisotropy for one in seen.packings]))
    if not np.isfinite(seen.packings[-1].chance):
        raise InputError("no contact in the bulk")
    return Estimate(value=seen.packings[-1].anisotropy, width=2.0 * seen.packings[-1].chance, chance=True)


# --- mixing -------------------------------------------------------------------------------------------------------


def _mixing_index(seen: GrainObservations) -> Estimate:
    """Lacey's index at the end: the mean after its own start-up, which takes longer than that of the motion."""
    curve = seen.mixing
    if seen.resting or len(curve.t) < MIN_SAMPLES:
        width = 2.0 * float(curve.error[-1])
        return Estimate(value=float(curve.lacey[-1]), width=width, chance=True, reliable=seen.resting)
    found = average(curve.t, curve.lacey)
    return averaged(found, found.discarded, float(seen.series.t[-1]))


def _segregation(seen: GrainObservations) -> Estimate:
    """S²/S_0² at the end: it is linear in Lacey's index."""
    index, rest = _mixing_index(seen), 1.0 - seen.mixing.chance
    if index.value is None or index.width is None:
        raise InputError("no mixing index")
    return replace(index, value=1.0 - index.value * rest, width=index.width * rest, average=None)


def _mixing_time(seen: GrainObservations) -> Estimate:
    curve, last = seen.mixing, _mixing_index(seen)
    if last.value is None or last.width is None:
        raise InputError("no final value of the mixing index")
    if last.value - float(curve.lacey[0]) < max(_MIXES, 4.0 * float(curve.error[0])):
        raise InputError("the mixing index hardly rises: nothing mixes")
    value = mixing_time(curve.t, curve.lacey, last.value)
    ends = []
    for end in (last.value - last.width, last.value + last.width):
        try:
            ends.append(mixing_time(curve.t, curve.lacey, end))
        except InputError:
            continue
    width = max([abs(end - value) for end in ends] + [0.5 * float(np.diff(curve.t).mean())])
    sure = len(ends) == 2
    why = "" if sure else "the mixing index does not stay at its final value long enough"
    return Estimate(value=value, width=width, reliable=sure and last.reliable, why=why or last.why, chance=True)


# --- walls --------------------------------------------------------------------------------------------------------


def _support(seen: GrainObservations) -> Estimate:
    """Vertical force on all walls over the weight of the particles."""
    weight = seen.series.mass * seen.series.facts.gravity
    if not (weight > 0.0).all():
        raise InputError("the particles have no weight")
    floor, side = seen.carried
    return seen.over_rows((floor + side.sum(axis=1)) / weight)


def _wall_share(seen: GrainObservations) -> Estimate:
    floor, side = seen.carried
    total = floor + side.sum(axis=1)
    if not total.mean() > 0.0:
        raise InputError("no weight stands on the walls")
    return seen.over_rows(side.sum(axis=1) / total.mean())


def _silo_length(seen: GrainObservations) -> Estimate:
    """Janssen's length; its width is what the upper and the lower half of the filling would give alone."""
    found = seen.silo
    if not np.isfinite(found.length):
        raise InputError("the walls carry nothing")
    return Estimate(value=found.length, width=found.spread, reliable=seen.resting, chance=True)


def _k_mu(seen: GrainObservations) -> Estimate:
    diameter, length = seen.hydraulic_diameter, _silo_length(seen)
    if length.value is None or length.width is None:
        raise InputError("no length of Janssen's law")
    value = diameter / (4.0 * length.value)
    return replace(length, value=value, width=value * length.width / length.value)


#: Metric -> how it is computed of what was seen; `InputError` where that is not possible.
GRAIN_METRICS: Mapping[str, Callable[[GrainObservations], Estimate]] = {
    "mass_flow": _mass_flow,
    "residence_time": _residence,
    "angle_of_repose": _static_angle,
    "dynamic_angle": _dynamic_angle,
    "packing_fraction": _fraction,
    "coordination": _coordination,
    "rattlers": _rattlers,
    "anisotropy": _anisotropy,
    "speed": _speed,
    "granular_temperature": _temperature,
    "profile_exponent": _exponent,
    "mixing_index": _mixing_index,
    "segregation": _segregation,
    "mixing_time": _mixing_time,
    "support": _support,
    "wall_share": _wall_share,
    "janssen_length": _silo_length,
    "janssen_k_mu": _k_mu,
    "kinetic_rotation": lambda seen: seen.over_rows(seen.series.kinetic_rotation),
    "dissipation": _dissipation,
}
