"""How far one run is from another of the same bodies, metric by metric, each by its scale.

Used for linear against Hertz (`kncal.observe.compare`), and for any contact against a reference (`kncal.study.trade`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from kncal.core.checks import Array
from kncal.core.units import quantity
from kncal.observe.contacts import Observations
from kncal.record.frames import Trajectory
from kncal.scene.metrics import metric_order, metric_unit
from kncal.scene.model import Model

#: A reference below this share of its natural scale counts as zero: a relative difference would be noise.
NEGLIGIBLE = 1e-12

#: The metrics that compare whole paths: the largest distance, and its root mean square.
PATHS = ("trajectory", "trajectory_rms")


class Run(Protocol):
    """What is needed of a run; `kncal.observe.compare.RunData` has it."""

    @property
    def model(self) -> Model:
        """What was run."""
        ...

    @property
    def trajectory(self) -> Trajectory:
        """Its frames."""
        ...

    @property
    def observations(self) -> Observations:
        """Its numbers."""
        ...

    @property
    def exact(self) -> Mapping[str, float] | None:
        """Metrics of the exact solution of the same model, where it is known."""
        ...

    @property
    def predicted(self) -> Mapping[str, float] | None:
        """Predicted relative discretisation error of the metrics [-], where it is known."""
        ...


class Side(NamedTuple):
    """A run and what it is called in messages."""

    name: str
    run: Run


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One metric of a run against a reference run.

    Attributes
    ----------
    metric : name
    value, reference : of the two runs [SI], None where there is none
    difference : (value - reference)/scale [-], or None
    scale : what a difference is divided by, in the metric's unit; None without a difference
    basis : what the scale is
    exact_difference : the same difference of the two exact solutions [-], or None
    numerical : predicted discretisation error of the two runs together, as a share of the scale [-], or None
    reason : why there is no difference
    """

    metric: str
    value: float | None
    reference: float | None
    difference: float | None
    scale: float | None
    basis: str
    exact_difference: float | None = None
    numerical: float | None = None
    reason: str = ""


class PathDifference(NamedTuple):
    """How far two paths are apart: a row per name of `PATHS`, the length they are divided by, and over which time."""

    rows: tuple[Difference, ...]
    scale: float
    basis: str
    common_time: tuple[float, float]


def metric_names(run: Run, reference: Run, more: Iterable[str] = ()) -> list[str]:
    """Return every metric that either run has, and ``more``, by `metric_order`; without those of `PATHS`."""
    names = {*reference.observations.metrics, *run.observations.metrics, *more}
    return sorted(names - set(PATHS), key=metric_order)


def finite(value: float | None) -> float | None:
    """Return a finite number as a float, None for anything else."""
    return None if value is None or not np.isfinite(value) else float(value)


def difference(name: str, side: Side, reference: Side) -> Difference:
    """Return the difference of one metric of ``side`` from ``reference``, by `scale_of` the reference's value."""
    values, reasons = [], []
    for label, run in (side, reference):
        given = run.observations.metrics.get(name)
        values.append(finite(given))
        if given is None:
            reasons.append(f"the {label} run has no {name}")
        elif values[-1] is None:
            reasons.append(f"{name} of the {label} run is not finite")
    a, b = values
    reason = "; ".join(reasons)
    scale, basis = (None, "") if a is None or b is None else scale_of(name, b, *reference)
    if a is not None and b is not None and scale is None:
        if a == b:
            scale = 1.0
        else:
            reason = f"{name} is 0 for {reference.name} and has no natural scale"
    if a is None or b is None or scale is None:
        return Difference(metric=name, value=a, reference=b, difference=None, scale=None, basis="", reason=reason)
    exact_a, exact_b = (finite((run.exact or {}).get(name)) for _, run in (side, reference))
    predicted = [finite((run.predicted or {}).get(name)) for _, run in (side, reference)]
    numerical = None
    if predicted[0] is not None and predicted[1] is not None:
        numerical = (abs(predicted[0] * a) + abs(predicted[1] * b)) / scale
    return Difference(
        metric=name,
        value=a,
        reference=b,
        difference=(a - b) / scale,
        scale=scale,
        basis=basis,
        exact_difference=None if exact_a is None or exact_b is None else (exact_a - exact_b) / scale,
        numerical=numerical,
    )


def scale_of(name: str, reference: float, label: str, run: Run) -> tuple[float | None, str]:
    """What a difference from ``reference`` is divided by: itself, or a natural scale of ``run`` if it is about zero."""
    unit = metric_unit(name)
    motion = run.trajectory
    scales: dict[str, tuple[float, str]] = {"–": (1.0, "absolute"), "rad": (1.0, "absolute, in rad")}
    speed = float(np.linalg.norm(motion.v, axis=2).max())
    if unit == "m/s":
        scales[unit] = (speed, f"absolute, by the largest speed {speed:.4g} m/s")
    elif unit == "rad/s":
        spin = speed / float(motion.radius.min())
        scales[unit] = (spin, f"absolute, by largest speed / smallest radius {spin:.4g} rad/s")
    elif unit == "m" and name.startswith("delta"):
        radius = float(motion.radius.min())
        scales[unit] = (radius, f"absolute, by the smallest radius {radius:.4g} m")
    elif unit == "m":
        length, basis = extent(motion.x, motion.radius)
        scales[unit] = (length, f"absolute, by the {basis}")
    elif unit == "s":
        scales[unit] = (run.model.t_end, f"absolute, by the end time {run.model.t_end:.4g} s")
    scale, basis = scales.get(unit, (0.0, ""))
    if abs(reference) > NEGLIGIBLE * scale:
        return abs(reference), f"relative to {label}"
    return (scale, basis) if scale > 0.0 else (None, "")


def path_difference(motion: Trajectory, reference: Trajectory, until: float | None = None) -> PathDifference:
    """Compare two paths of the same particles at equal times; between frames by the cubic Hermite interpolant.

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
    rows = tuple(
        Difference(
            metric=name,
            value=None,
            reference=None,
            difference=None if distance is None else distance / length,
            scale=length,
            basis=basis,
            reason="" if distance is not None else "the two runs have no common time span",
        )
        for name, distance in zip(PATHS, distances, strict=True)
    )
    return PathDifference(rows, length, basis, (start, end))


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
