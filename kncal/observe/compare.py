"""Linear against Hertz: the differences of two runs of one scene, and whether they are within the tolerances.

What belongs to the contact model and what belongs to the time step are kept apart: next to every difference
stands the difference of the two exact solutions and the predicted discretisation error, where they are known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError, RunError
from kncal.observe.cost import Cost, Speed, cost, speed
from kncal.observe.difference import Difference, Side, difference, finite, metric_names, path_difference, scale_of
from kncal.observe.verdict import sentences
from kncal.record.frames import Trajectory
from kncal.record.outcome import RunResult
from kncal.scene.limits import no_contact
from kncal.scene.metrics import ExactRow, MetricRow, judge, metric_order, metric_unit
from kncal.scene.model import Model
from kncal.scene.species import listed

if TYPE_CHECKING:
    import pandas as pd

    from kncal.observe.contacts import Observations

#: A deviation up to this many times the predicted error counts as explained: the prediction is the worst of
#: sampled sub-step phases, the run has a phase of its own.
PREDICTION_MARGIN = 1.1


class ExactMotion(Protocol):
    """The exact motion of a model, as `kncal.scene.exact.solve` returns it."""

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
            for pair in sorted(met):
                for warning in data.model.between(*pair).warnings.items():
                    names = pairs.setdefault(warning, [])
                    names.extend({"–".join(pair)} - set(names))
        texts = [(code, f"{listed(names)}: {text}") for (code, text), names in pairs.items()]
        if not met:
            texts.append(("no-contact", no_contact(self.linear.model, self.hertz.model)))
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

    sides = Side("linear", linear), Side("hertz", hertz)
    paths = path_difference(linear.trajectory, hertz.trajectory)
    rows = [_row(difference(name, *sides), limits.get(name)) for name in metric_names(linear, hertz, limits)]
    rows += [_row(row, limits.get(row.metric)) for row in paths.rows]
    costs = (_cost("linear", linear), _cost("hertz", hertz))
    return Comparison(
        linear=linear,
        hertz=hertz,
        rows=tuple(rows),
        exact=(*_exact_rows("linear", linear), *_exact_rows("hertz", hertz)),
        costs=costs,
        speed=speed(*costs),
        trajectory_scale=paths.scale,
        trajectory_basis=paths.basis,
        common_time=paths.common_time,
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


def _row(found: Difference, tolerance: float | None) -> MetricRow:
    """Judge a difference of the linear run (its ``value``) from the Hertz run."""
    reason, numerical = found.reason, found.numerical
    # Worth a word only where it decides: a difference far outside is no matter of steps, and none at all is no matter.
    size = 0.0 if found.difference is None else abs(found.difference)
    if tolerance is not None and numerical is not None and 0.0 < size <= tolerance + numerical < 2.0 * numerical:
        reason = "the tolerance is tighter than the discretisation error: take more steps per contact"
    return judge(
        found.metric,
        found.value,
        found.reference,
        found.difference,
        basis=found.basis,
        tolerance=tolerance,
        exact_difference=found.exact_difference,
        numerical=numerical,
        reason=reason,
    )


def _exact_rows(kind: str, data: RunData) -> list[ExactRow]:
    rows = []
    values = data.exact or {}
    for name in sorted(values, key=metric_order):
        exact = finite(values[name])
        if exact is None:
            raise InputError(f"exact solution of the {kind} model: {name} = {values[name]}: expected a finite number")
        value = finite(data.observations.metrics.get(name))
        scale, basis = scale_of(name, exact, "exact", data)
        deviation = None if value is None or scale is None else (value - exact) / scale
        predicted = finite((data.predicted or {}).get(name))
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


def _cost(kind: str, data: RunData) -> Cost:
    durations = [contact.t_c for contact in data.model.contacts.values()]
    return cost(kind, data.result, durations, data.cpu_samples)


def _contacts(model: Model) -> list[dict[str, Any]]:
    """The contacts for the JSON file; pairs that are alike once, with their number."""
    return [
        {
            "pair": list(model.species.names(pair)),
            "pairs_of_bodies": model.species.meetings(pair),
            **{**asdict(contact), "warnings": dict(contact.warnings)},
        }
        for pair, contact in model.contacts.items()
    ]
