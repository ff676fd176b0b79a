"""Linear against Hertz: the differences of two runs of one scene, and whether they are within the tolerances.

What belongs to the contact model and what belongs to the time step are kept apart: next to every difference
stands the difference of the two exact solutions and the predicted discretisation error, where they are known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from kncal.checks import Array
from kncal.cost import Cost, Speed, cost, speed
from kncal.engines.base import RunResult
from kncal.errors import InputError, RunError
from kncal.metrics import ExactRow, MetricRow, judge, metric_order, metric_unit
from kncal.model import Model
from kncal.trajectory import Trajectory
from kncal.units import quantity
from kncal.verdict import sentences

if TYPE_CHECKING:
    import pandas as pd

    from kncal.observe import Observations

#: A deviation up to this many times the predicted error counts as explained: the prediction is the worst of
#: sampled sub-step phases, the run has a phase of its own.
PREDICTION_MARGIN = 1.1

#: A reference below this share of its natural scale counts as zero: a relative difference would be noise.
NEGLIGIBLE = 1e-12


class ExactMotion(Protocol):
    """The exact motion of a model, as `kncal.exact.solve` returns it."""

    def at(self, times: Array) -> tuple[Array, Array]:
        """Positions [m] and velocities [m/s], each (times, particles, 3), at ``times`` [s]."""
        ...


@dataclass(frozen=True, kw_only=True)
class RunData:
    """One completed run with everything read from it.

    Attributes
    ----------
    model, result, trajectory, observations : what was run, how it ended, its frames, its numbers
    exact : metric -> value of the exact solution of the same model [SI], or None
    predicted : metric -> predicted relative discretisation error at this dt (worst phase) [-], or None
    motion : the exact motion of the same model, for figures, or None
    cpu_samples : CPU seconds of repeated runs of the same input; empty: only ``result.cpu_seconds``
    """

    model: Model
    result: RunResult
    trajectory: Trajectory
    observations: Observations
    exact: Mapping[str, float] | None = None
    predicted: Mapping[str, float] | None = None
    motion: ExactMotion | None = None
    cpu_samples: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """The verdict on two runs; made by `compare`.

    Attributes
    ----------
    linear, hertz : RunData
    rows : one MetricRow per metric, and ``trajectory``, ``trajectory_rms``
    exact : one ExactRow per run and metric with an exact value
    costs : (linear, hertz)
    speed : Speed
    trajectory_scale, trajectory_basis : length [m] by which the trajectory rows are divided, and what it is
    common_time : time span [s] covered by both runs, over which the trajectories are compared
    """

    linear: RunData
    hertz: RunData
    rows: tuple[MetricRow, ...]
    exact: tuple[ExactRow, ...]
    costs: tuple[Cost, Cost]
    speed: Speed
    trajectory_scale: float
    trajectory_basis: str
    common_time: tuple[float, float]

    @property
    def within(self) -> bool:
        """Whether every metric with a tolerance could be computed and is within it (True if none has one)."""
        return not self.failures

    @property
    def judged(self) -> tuple[MetricRow, ...]:
        """The rows with a tolerance."""
        return tuple(r for r in self.rows if r.tolerance is not None)

    @property
    def failures(self) -> tuple[MetricRow, ...]:
        """The rows that are outside their tolerance or have one and could not be computed."""
        return tuple(r for r in self.rows if r.verdict in ("outside", "missing"))

    @property
    def limits(self) -> tuple[tuple[str, str], ...]:
        """What limits the contacts that happened: (warning code, sentence with its pairs), each once."""
        met = {event.pair for data in (self.linear, self.hertz) for event in data.observations.contacts}
        pairs: dict[tuple[str, str], list[str]] = {}
        for data in (self.linear, self.hertz):
            for pair, contact in data.model.contacts.items():
                for warning in contact.warnings.items() if pair in met else ():
                    names = pairs.setdefault(warning, [])
                    names.extend({"–".join(pair)} - set(names))
        texts = [(code, f"{', '.join(names)}: {text}") for (code, text), names in pairs.items()]
        if not met:
            texts.append(("no-contact", "no contact happened in either run: lengthen run.until_time"))
        return tuple(texts)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict in words: what was compared and judged, what was saved, and what to keep in mind."""
        models = (self.linear.model, self.hertz.model)
        return sentences(models, self.rows, self.exact, self.costs, self.speed, self.limits)

    def row(self, metric: str) -> MetricRow:
        """Return the row of ``metric``; raises `InputError` if there is none."""
        for row in self.rows:
            if row.metric == metric:
                return row
        raise InputError(f"metric = {metric!r}: expected one of {', '.join(r.metric for r in self.rows)}")

    def to_dict(self) -> dict[str, Any]:
        """Everything but the frames, as plain JSON types (no NaN)."""
        return {
            "case": self.hertz.model.scene.name,
            "title": self.hertz.model.scene.title,
            "within": self.within,
            "verdict": list(self.sentences),
            "models": {"linear": _contacts(self.linear.model), "hertz": _contacts(self.hertz.model)},
            "rows": [asdict(r) for r in self.rows],
            "exact": [asdict(r) for r in self.exact],
            "costs": [asdict(c) for c in self.costs],
            "speed": {**asdict(self.speed), "caveats": list(self.speed.caveats)},
            "trajectory": {
                "scale": self.trajectory_scale,
                "basis": self.trajectory_basis,
                "common_time": list(self.common_time),
            },
        }

    def to_frame(self) -> pd.DataFrame:
        """One row per metric; the columns are the fields of `MetricRow`."""
        import pandas as pd

        return pd.DataFrame([asdict(r) for r in self.rows], columns=list(MetricRow.__dataclass_fields__))


def compare(linear: RunData, hertz: RunData, tolerances: Mapping[str, float] | None = None) -> Comparison:
    """Compare a linear run with a Hertz run of the same scene.

    Differences are relative to the Hertz value. Where that is zero (below 1e-12 of the metric's natural
    scale: 1 for ratios, the largest Hertz speed for speeds, the extent of the Hertz motion for heights, ...)
    the difference is absolute, divided by that scale; ``basis`` says which. ``trajectory`` is the largest
    distance between the same particle in the two runs at equal times, ``trajectory_rms`` its root mean square
    over time and particles, both divided by the extent of the motion: the largest diagonal of a box that
    holds the path of one particle's centre in the Hertz run (by the smallest radius if nothing moves).
    Between frames the motion is the cubic Hermite interpolant of positions and velocities, exact in flight.

    Parameters
    ----------
    linear, hertz : RunData
    tolerances : metric -> largest allowed abs(difference) [-]; None: those of the Hertz run's scene.
        One for a metric that cannot be computed makes the comparison fail.

    Raises
    ------
    RunError
        If a run did not complete.
    InputError
        If the runs are not of the same bodies, or a tolerance is not a finite number >= 0.
    """
    for kind, data in (("linear", linear), ("hertz", hertz)):
        if data.result.status != "completed":
            raise RunError(
                f"the {kind} run in {data.result.folder} ended as {data.result.status!r}"
                f" ({data.result.message or 'no message'}): only completed runs can be compared; run it again"
            )
    _same_bodies(linear, hertz)
    limits = dict(hertz.model.scene.tolerances if tolerances is None else tolerances)
    for name, limit in limits.items():
        if isinstance(limit, bool) or not isinstance(limit, int | float) or not 0.0 <= limit < np.inf:
            raise InputError(f"tolerances: {name} = {limit!r}: expected a finite number >= 0, 0.05 means 5 %")

    length, basis = _extent(hertz.trajectory)
    span, distances = _distances(linear.trajectory, hertz.trajectory)
    rows = [_row(name, linear, hertz, limits.get(name)) for name in _metric_names(linear, hertz, limits)]
    for name, distance in zip(("trajectory", "trajectory_rms"), distances, strict=True):
        reason = "" if distance is not None else "the two runs have no common time span"
        value = None if distance is None else distance / length
        rows.append(judge(name, None, None, value, basis=basis, tolerance=limits.get(name), reason=reason))
    costs = (_cost("linear", linear), _cost("hertz", hertz))
    return Comparison(
        linear=linear,
        hertz=hertz,
        rows=tuple(rows),
        exact=(*_exact_rows("linear", linear), *_exact_rows("hertz", hertz)),
        costs=costs,
        speed=speed(*costs),
        trajectory_scale=length,
        trajectory_basis=basis,
        common_time=span,
    )


def _same_bodies(linear: RunData, hertz: RunData) -> None:
    a, b = linear.model.scene, hertz.model.scene
    for what, left, right in (
        ("particles", a.particles, b.particles),
        ("walls", a.walls, b.walls),
        ("gravity", a.gravity, b.gravity),
    ):
        if left != right:
            raise InputError(
                f"the runs in {linear.result.folder} and {hertz.result.folder} differ in their {what}:"
                " only runs of the same scene can be compared"
            )
    if linear.trajectory.names != hertz.trajectory.names:
        raise InputError(
            f"the recorded particles differ: {linear.trajectory.names} and {hertz.trajectory.names};"
            " expected the same in both runs"
        )


def _metric_names(linear: RunData, hertz: RunData, limits: Mapping[str, float]) -> list[str]:
    """Every metric that either run has or a tolerance asks for: by `metric_order`."""
    names = {*hertz.observations.metrics, *linear.observations.metrics, *limits}
    return sorted(names - {"trajectory", "trajectory_rms"}, key=metric_order)


def _finite(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


def _row(name: str, linear: RunData, hertz: RunData, tolerance: float | None) -> MetricRow:
    values, reasons = [], []
    for kind, data in (("linear", linear), ("hertz", hertz)):
        given = data.observations.metrics.get(name)
        values.append(_finite(given))
        if given is None:
            reasons.append(f"the {kind} run has no {name}")
        elif values[-1] is None:
            reasons.append(f"{name} of the {kind} run is not finite")
    a, b = values
    if a is None or b is None:
        return judge(name, a, b, None, basis="", tolerance=tolerance, reason="; ".join(reasons))
    scale, basis = _scale(name, b, "hertz", hertz)
    if scale is None:
        if a != b:
            reason = f"{name} is 0 for hertz and has no natural scale"
            return judge(name, a, b, None, basis="", tolerance=tolerance, reason=reason)
        scale = 1.0
    exact_a, exact_b = (_finite((d.exact or {}).get(name)) for d in (linear, hertz))
    predicted = [_finite((d.predicted or {}).get(name)) for d in (linear, hertz)]
    numerical = None
    if predicted[0] is not None and predicted[1] is not None:
        numerical = (abs(predicted[0] * a) + abs(predicted[1] * b)) / scale
    reason = ""
    # Worth a word only where it decides: a difference far outside is no matter of steps, and none at all is no matter.
    close = tolerance is not None and numerical is not None and 0.0 < abs(a - b) / scale <= tolerance + numerical
    if close and tolerance is not None and numerical is not None and numerical > tolerance:
        reason = "the tolerance is tighter than the discretisation error: take more steps per contact"
    return judge(
        name,
        a,
        b,
        (a - b) / scale,
        basis=basis,
        tolerance=tolerance,
        exact_difference=None if exact_a is None or exact_b is None else (exact_a - exact_b) / scale,
        numerical=numerical,
        reason=reason,
    )


def _scale(name: str, reference: float, label: str, run: RunData) -> tuple[float | None, str]:
    """What a difference from ``reference`` is divided by: itself, or a natural scale if it is about zero."""
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
        length, basis = _extent(motion)
        scales[unit] = (length, f"absolute, by the {basis}")
    elif unit == "s":
        scales[unit] = (run.model.t_end, f"absolute, by the end time {run.model.t_end:.4g} s")
    scale, basis = scales.get(unit, (0.0, ""))
    if abs(reference) > NEGLIGIBLE * scale:
        return abs(reference), f"relative to {label}"
    return (scale, basis) if scale > 0.0 else (None, "")


def _exact_rows(kind: str, data: RunData) -> list[ExactRow]:
    rows = []
    values = data.exact or {}
    for name in sorted(values, key=metric_order):
        exact = _finite(values[name])
        if exact is None:
            raise InputError(f"exact solution of the {kind} model: {name} = {values[name]}: expected a finite number")
        value = _finite(data.observations.metrics.get(name))
        scale, basis = _scale(name, exact, "exact", data)
        deviation = None if value is None or scale is None else (value - exact) / scale
        predicted = _finite((data.predicted or {}).get(name))
        explained = None
        if deviation is not None and predicted is not None:
            explained = abs(deviation) <= PREDICTION_MARGIN * predicted
        rows.append(
            ExactRow(
                model=kind,
                metric=name,
                unit=metric_unit(name),
                value=value,
                exact=exact,
                deviation=deviation,
                basis=basis,
                predicted=predicted,
                explained=explained,
            )
        )
    return rows


def _extent(motion: Trajectory) -> tuple[float, str]:
    sides = motion.x.max(axis=0) - motion.x.min(axis=0)
    extent = float(np.linalg.norm(sides, axis=1).max())
    radius = float(motion.radius.min())
    if extent > NEGLIGIBLE * radius:
        return extent, f"extent of the motion {quantity(extent, 'm', 4)}"
    return radius, f"smallest radius {radius:.4g} m (nothing moves)"


def _distances(a: Trajectory, b: Trajectory) -> tuple[tuple[float, float], tuple[float | None, float | None]]:
    """Common time span [s]; largest and rms distance [m] of equal particles at the frame times of both."""
    from scipy.integrate import trapezoid
    from scipy.interpolate import CubicHermiteSpline

    start, end = float(max(a.t[0], b.t[0])), float(min(a.t[-1], b.t[-1]))
    if not start < end:
        return (start, end), (None, None)
    times = np.union1d(a.t, b.t)
    times = times[(times >= start) & (times <= end)]
    motions = [CubicHermiteSpline(m.t, m.x, m.v, axis=0)(times) for m in (a, b)]
    squares = ((motions[0] - motions[1]) ** 2).sum(axis=2)
    mean_square = trapezoid(squares.mean(axis=1), times) / (end - start)
    return (start, end), (float(np.sqrt(squares.max())), float(np.sqrt(mean_square)))


def _cost(kind: str, data: RunData) -> Cost:
    durations = [contact.t_c for contact in data.model.contacts.values()]
    return cost(kind, data.result, durations, data.cpu_samples)


def _contacts(model: Model) -> list[dict[str, Any]]:
    """The contact of every pair, for the JSON file."""
    return [
        {"pair": list(pair), **{**asdict(contact), "warnings": dict(contact.warnings)}}
        for pair, contact in model.contacts.items()
    ]
