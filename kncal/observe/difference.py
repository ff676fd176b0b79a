"""How far one run is from another of the same scene, metric by metric: the rows of every comparison.

Used for linear against Hertz (`kncal.observe.compare`), and for any run against a reference (`kncal.study`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.core.units import quantity
from kncal.observe.averages import voidage_difference
from kncal.observe.estimate import Estimate, apart, missing
from kncal.observe.row import RMS, Row, judge, row_of
from kncal.observe.run_data import RunData
from kncal.record.frames import Trajectory
from kncal.scene.metrics import METRICS, metric_order, metric_unit, split_metric

#: A reference below this share of its natural scale counts as zero: a relative difference would be noise.
NEGLIGIBLE = 1e-12

#: The metrics that compare whole paths: the largest distance, and its root mean square; and whole fields.
PATHS = ("trajectory", "trajectory_rms")
FIELDS = ("eps_g",)


def rows_between(
    run: RunData, reference: RunData, tolerances: Mapping[str, float], names: tuple[str, str] = ("linear", "hertz")
) -> tuple[Row, ...]:
    """Return one row per metric that either run has, or that has a tolerance; ``names`` are those of the runs in texts.

    ``tolerances``: metric -> largest allowed abs(difference) [-].
    """
    whole: dict[str, Row] = {}
    if run.frames is not None and reference.frames is not None:
        whole = {row.metric: row for row in path_difference(run.frames, reference.frames)}
    if run.signals is not None and reference.signals is not None:
        whole |= {name: field_row(name, run, reference) for name in FIELDS if reference.measures(name)}
    rows = (
        whole[name] if name in whole else value_row(name, run, reference, names)
        for name in metric_names(run, reference, (*tolerances, *whole))
    )
    return tuple(judge(row, tolerances.get(row.metric)) for row in rows)


def metric_names(run: RunData, reference: RunData, more: Iterable[str] = ()) -> list[str]:
    """Return every metric that either run has, and ``more``, by `metric_order`."""
    return sorted({*reference.estimates, *run.estimates, *more}, key=metric_order)


def finite(value: float | None) -> float | None:
    """Return a finite number as a float, None for anything else."""
    return None if value is None or not np.isfinite(value) else float(value)


def value_row(name: str, run: RunData, reference: RunData, names: tuple[str, str]) -> Row:
    """Return the row of one metric of ``run`` and ``reference``, not judged; divided by `scale_of` the reference's."""
    a, b = run.estimate(name), reference.estimate(name)
    row = row_of(name, a, b, missing(""))
    if bodies := " / ".join(dict.fromkeys(filter(None, (_bodies(name, side) for side in (run, reference))))):
        row = replace(row, text=f"{row.text} ({bodies})")
    if a.value is None or b.value is None:
        said = [f"{who}: {side.why}" for who, side in zip(names, (a, b), strict=True) if side.value is None]
        return replace(row, reason=a.why if len(said) == 2 and a.why == b.why else "; ".join(said))
    scale, basis = scale_of(name, b.value, names[1], reference)
    if scale is None:
        if a.value != b.value:
            return replace(row, reason=f"{name} is 0 for {names[1]} and has no natural scale")
        scale = 1.0
    found = apart(a, b, scale, names)
    exact_a, exact_b = (finite((side.exact or {}).get(name)) for side in (run, reference))
    return replace(
        row,
        difference=found,
        scale=scale,
        basis=basis,
        exact_difference=None if exact_a is None or exact_b is None else (exact_a - exact_b) / scale,
        reason=found.why,
    )


def _bodies(name: str, run: RunData) -> str:
    """Return who met in the contact that a metric is of; "" where all contacts are of one pair, or it is of none."""
    base, number = split_metric(name)
    events = () if run.contacts is None else run.contacts.contacts
    if base not in METRICS or not METRICS[base].each or number > len(events) or len({e.pair for e in events}) < 2:
        return ""
    return "–".join(events[number - 1].pair)


def field_row(name: str, run: RunData, reference: RunData) -> Row:
    """Return the row of the rms difference of two time-mean fields, less what sampling alone would give."""
    try:
        rms, noise = voidage_difference(run.series, reference.series, run.seen.begin, reference.seen.begin)
    except InputError as error:
        return row_of(name, missing(""), missing(""), missing(str(error)), reason=str(error))
    return field_difference(name, rms, noise, float(max(run.series.t[-1], reference.series.t[-1])))


def field_difference(name: str, rms: float, noise: float, end: float) -> Row:
    """Return the row of two fields that differ by ``rms``, ``noise`` of which sampling gives, at ``end`` [s].

    Squares add: what is left of ``rms`` after the noise is between ``sqrt(rms² - 4 noise²)`` and ``rms``.
    """
    low = float(np.sqrt(max(rms**2 - (2.0 * noise) ** 2, 0.0)))
    found = Estimate(value=0.5 * (rms + low), width=0.5 * (rms - low), chance=True, end=end)
    return row_of(name, Estimate(value=None, width=noise), missing(""), found, scale=1.0, basis=RMS)


def scale_of(name: str, reference: float, label: str, run: RunData) -> tuple[float | None, str]:
    """What a difference from ``reference`` is divided by: itself, or a natural scale of ``run`` if it is about zero."""
    unit = metric_unit(name)
    if name in METRICS and METRICS[name].difference == "absolute":
        return 1.0, "absolute"
    scale, basis = _natural(name, unit, run)
    if abs(reference) > (NEGLIGIBLE * scale if run.frames is not None else 0.0):
        return abs(reference), f"relative to {label}"
    return (scale, basis) if scale > 0.0 else (None, "")


def _natural(name: str, unit: str, run: RunData) -> tuple[float, str]:
    """Return a natural scale of a metric, and what it is; 0 if there is none."""
    if (motion := run.frames) is None:
        return (1.0, "absolute") if unit == "–" else (0.0, "")
    speed, radius = float(np.linalg.norm(motion.v, axis=2).max()), float(motion.radius.min())
    length, of_motion = extent(motion.x, motion.radius)
    scales = {
        "–": (1.0, "absolute"),
        "rad": (1.0, "absolute, in rad"),
        "m/s": (speed, f"absolute, by the largest speed {speed:.4g} m/s"),
        "rad/s": (speed / radius, f"absolute, by largest speed / smallest radius {speed / radius:.4g} rad/s"),
        "m": (length, f"absolute, by the {of_motion}"),
        "s": (run.model.t_end, f"absolute, by the end time {run.model.t_end:.4g} s"),
    }
    if name.startswith("delta"):
        scales["m"] = (radius, f"absolute, by the smallest radius {radius:.4g} m")
    return scales.get(unit, (0.0, ""))


def path_difference(motion: Trajectory, reference: Trajectory, until: float | None = None) -> tuple[Row, ...]:
    """Return a row per name of `PATHS` of two paths of the same particles at equal times.

    Between frames the motion is the cubic Hermite interpolant.

    Parameters
    ----------
    motion, reference : the scale is the `extent` of the reference
    until : look no further than this time [s]
    """
    end = float(min(motion.t[-1], reference.t[-1], np.inf if until is None else until))
    start = float(max(motion.t[0], reference.t[0]))
    seen = reference.x
    distances: tuple[float | None, float | None] = (None, None)
    if start < end:
        times = np.union1d(np.union1d(motion.t, reference.t), [start, end])
        times = times[(times >= start) & (times <= end)]
        there = _at(reference, times)
        distances = _distances(times, _at(motion, times), there)
        seen = seen if until is None else there
    length, basis = extent(seen, reference.radius)
    none = "the two runs have no common time span"
    return tuple(
        row_of(name, missing(""), missing(""), missing(none), reason=none)
        if distance is None
        else row_of(name, missing(""), missing(""), Estimate(value=distance / length), scale=length, basis=basis)
        for name, distance in zip(PATHS, distances, strict=True)
    )


def extent(x: Array, radius: Array) -> tuple[float, str]:
    """Largest diagonal of a box that holds the path of one particle's centre [m], and what to call it.

    ``x``: (frames, particles, 3) [m]. The smallest of ``radius`` (particles,) [m] if nothing moves.
    """
    sides = x.max(axis=0) - x.min(axis=0)
    length = float(np.linalg.norm(sides, axis=1).max())
    smallest = float(radius.min())
    if length > NEGLIGIBLE * smallest:
        return length, f"extent of the motion {quantity(length, 'm', 4)}"
    return smallest, f"smallest radius {smallest:.4g} m (nothing moves)"


def _at(motion: Trajectory, times: Array) -> Array:
    from scipy.interpolate import CubicHermiteSpline

    positions: Array = CubicHermiteSpline(motion.t, motion.x, motion.v, axis=0)(times)
    return positions


def _distances(times: Array, a: Array, b: Array) -> tuple[float, float]:
    """Largest and rms distance [m] of equal particles; a, b: (times, particles, 3)."""
    from scipy.integrate import trapezoid

    squares = ((a - b) ** 2).sum(axis=2)
    mean_square = trapezoid(squares.mean(axis=1), times) / (times[-1] - times[0])
    return float(np.sqrt(squares.max())), float(np.sqrt(mean_square))
