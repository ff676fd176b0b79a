"""The error of a run against the reference run, and where it comes from."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

from kncal.observe.difference import PATHS, metric_names, path_difference, value_row
from kncal.observe.estimate import Estimate, apart
from kncal.observe.row import RMS, Row, judge
from kncal.observe.run_data import RunData
from kncal.observe.truth import exact_metrics, exact_motion, predicted_errors
from kncal.scene.metrics import split_metric
from kncal.study.trade.trade import Candidate, Convergence, ErrorSplit

NAMES = ("candidate", "reference")
#: From one N to the next, orders of convergence between these are believed: velocity Verlet is of second order, at a
#: force that jumps at touch (a damped contact) of first.
ORDERS = (1.0, 2.0)

#: Two runs that differ in one thing; None: not known.
Step = tuple[RunData | None, RunData | None]


@dataclass(frozen=True, kw_only=True)
class Reference:
    """The run that all others are compared with.

    Attributes
    ----------
    run : RunData
    until : paths are compared up to this time [s], None: the whole run
    contacts : contacts 1 to this number count, None: all
    left : metric -> what is left of its discretisation error [-]
    """

    run: RunData
    until: float | None = None
    contacts: int | None = None
    left: Mapping[str, float] = field(default_factory=dict)

    def names(self, more: tuple[str, ...] = ()) -> tuple[str, ...]:
        """Return the metrics that the reference has (and ``more``), those of `PATHS` last."""
        names = [n for n in metric_names(self.run, self.run, more) if n not in PATHS and (n in more or self._counts(n))]
        return (*names, *PATHS)

    def _counts(self, name: str) -> bool:
        return self.contacts is None or split_metric(name)[1] <= self.contacts

    def differences(self, run: RunData, more: tuple[str, ...] = ()) -> dict[str, Row]:
        """Return the differences of ``run`` from the reference, metric by metric."""
        paths = {row.metric: row for row in path_difference(run.trajectory, self.run.trajectory, self.until)}
        return {
            name: paths[name] if name in PATHS else value_row(name, run, self.run, NAMES) for name in self.names(more)
        }

    def step(self, name: str, scale: float, a: RunData, b: RunData) -> float | None:
        """Return how far ``a`` is from ``b`` in one metric, by ``scale`` (of the reference) [-]; None: not known."""
        if name in PATHS:
            rows = path_difference(a.trajectory, b.trajectory, self.until)
            (row,) = (row for row in rows if row.metric == name)
            moved = row.difference.value
            return None if moved is None or row.scale is None else moved * row.scale / scale
        value, other = (data.observations.metrics.get(name) for data in (a, b))
        return None if value is None or other is None else (value - other) / scale


def contact_rows(
    reference: Reference,
    run: RunData,
    converged: RunData | None,
    worst: Mapping[str, float],
    tolerances: Mapping[str, float],
) -> dict[str, Row]:
    """Return the judged error of every metric of single contacts, with its uncertainty.

    The uncertainty is what is left of the reference's own discretisation error, plus what another sub-step phase of
    the first touch could add: a run sees one phase, and may be lucky. It goes up to the error of the converged contact
    plus the worst discretisation error over all phases.

    Parameters
    ----------
    reference, run : what is compared
    converged : the same contact, converged in N; None: not known
    worst : metric -> predicted worst relative discretisation error at the run's N [-]
    tolerances : metric -> largest allowed abs(error) [-]
    """
    more = tuple(tolerances)
    there = {} if converged is None else reference.differences(converged, more)
    found = {}
    for name, row in reference.differences(run, more).items():
        error = row.difference.value
        if error is not None and row.scale is not None:
            width = reference.left.get(name, 0.0)
            phase = _phase(name, row, run, worst, reference.until)
            if phase is not None:
                base = there[name].difference.value if name in there else None
                width += max(0.0, abs(base or 0.0) + phase - abs(error))
            row = replace(row, difference=Estimate(value=error, width=width))  # noqa: PLW2901
        found[name] = judge(row, tolerances.get(name))
    return found


def _phase(name: str, row: Row, run: RunData, worst: Mapping[str, float], until: float | None) -> float | None:
    """Return what another sub-step phase of the contacts could add to a difference, by its scale; None: not known.

    Paths: a leaving speed v that is wrong by a share e makes the way (and all later flights) wrong by e in time, so
    the body is elsewhere by up to e v times the time left.
    """
    if row.scale is None:
        return None
    if name not in PATHS:
        return None if name not in worst or row.run.value is None else worst[name] * abs(row.run.value) / row.scale
    if "e_n" not in worst:
        return None
    end = run.model.t_end if until is None else until
    left = ((c.v_out or 0.0) * max(end - c.t_start - c.t_c, 0.0) for c in run.observations.contacts)
    return worst["e_n"] * sum(left) / row.scale


def split_errors(
    reference: Reference,
    run: RunData,
    converged: RunData | None,
    unsoftened: RunData | None,
    worst: Mapping[str, Mapping[str, float]],
    more: tuple[str, ...] = (),
) -> tuple[ErrorSplit, ...]:
    """Split the error of every metric of single contacts; see `split`.

    Differences of a number add up exactly; distances of paths don't, and what is left over is their interaction.

    Parameters
    ----------
    reference, run : as of `contact_rows`
    converged : the same contact, converged in N; None: not known
    unsoftened : the same model unsoftened, converged; None: not known (of Hertz, give the reference's run)
    worst : "linear" and "hertz" -> metric -> predicted worst relative discretisation error of converged runs [-]
    """
    steps: dict[str, Step] = {"discretisation": (run, converged), "softness": (converged, unsoftened)}
    if run.model.kind != "hertz":
        steps["model"] = (unsoftened, reference.run)

    def bound(row: Row, data: RunData) -> float:
        """What the step of a converged run leaves of a difference [-]."""
        value, share = data.observations.metrics.get(row.metric), worst.get(data.model.kind, {}).get(row.metric)
        if data is reference.run or value is None or share is None:
            return reference.left.get(row.metric, 0.0)
        return share * abs(value) / (row.scale or 1.0)

    def between(row: Row, a: RunData, b: RunData) -> Estimate | None:
        value = reference.step(row.metric, row.scale or 1.0, a, b)
        width = 0.0 if a is b else sum(bound(row, data) for data in (a, b) if data is not run)
        return None if value is None else Estimate(value=value, width=width)

    rows = [r for r in reference.differences(run, more).values() if r.difference.value is not None and r.scale]
    left = [reference.left.get(row.metric, 0.0) for row in rows]
    return tuple(
        split(row.metric, replace(row.difference, width=width), steps, partial(between, row))
        for row, width in zip(rows, left, strict=True)
    )


def split(
    metric: str, total: Estimate, steps: Mapping[str, Step], between: Callable[[RunData, RunData], Estimate | None]
) -> ErrorSplit:
    """Split the error of one metric by what was changed one at a time.

    Discretisation: the run against the same contact converged in N. Softness: that against the same model unsoftened,
    converged. Model: the unsoftened linear contact against the reference.

    Parameters
    ----------
    total : the whole error
    steps : part -> the two runs that differ in it, None: not known; a part that is not there has no meaning
    between : the difference of two runs in this metric
    """
    parts = {what: None if a is None or b is None else between(a, b) for what, (a, b) in steps.items()}
    missing = tuple(what for what, part in parts.items() if part is None)
    known = math.fsum(part.value or 0.0 for part in parts.values() if part is not None)
    left = None if missing else (total.value or 0.0) - known
    return ErrorSplit(metric=metric, total=total, **parts, interaction=left, missing=missing)


def worst_errors(run: RunData) -> Mapping[str, float]:
    """Return metric -> predicted worst relative discretisation error of a run over all sub-step phases [-]."""
    return predicted_errors(run.model, run.observations)


def converge(
    runs: Mapping[float, RunData],
    tolerances: Mapping[str, float],
    threshold: float,
    until: float | None,
    contacts: int | None,
) -> Convergence:
    """Judge runs of one contact at growing N: how far each metric moved to the last, and what is left.

    What is left is by Richardson: the last move over 2^p - 1, with the order p from the last two moves (between 1 and
    2, else 1), or the distance to the exact solution where there is one and that is farther.

    Parameters
    ----------
    runs : N -> run, N doubled from one to the next
    tolerances : the metrics that decide; empty: all
    threshold : what none of them may move by, or have left [-]
    until, contacts : as of `Reference`
    """
    steps = sorted(runs)
    last = Reference(run=runs[steps[-1]], until=until, contacts=contacts)
    names = last.names()
    values = {n: tuple(runs[s].observations.metrics.get(n) for s in steps) for n in names if n not in PATHS}
    left: dict[str, float] = {}
    motion = exact_motion(last.run.model)
    # without a whole exact motion there are closed forms of limits, which a run need not converge to
    exact = {} if motion is None else exact_metrics(last.run.model, motion) or {}
    moves: dict[str, list[float | None]] = {name: [] for name in names}
    for a, b in pairwise(steps):
        for name, row in last.differences(runs[a]).items():
            scale = row.scale
            moves[name].append(None if scale is None else last.step(name, scale, runs[b], runs[a]))
    for name, row in last.differences(last.run).items():
        known = [abs(move) for move in moves[name] if move is not None]
        if row.scale is None or not known:
            continue
        order = math.log2(known[-2] / known[-1]) if len(known) > 1 and 0.0 < known[-1] < known[-2] else ORDERS[0]
        left[name] = known[-1] / (2.0 ** min(max(order, ORDERS[0]), ORDERS[1]) - 1.0)
        if name in exact and row.run.value is not None:
            left[name] = max(left[name], abs(row.run.value - exact[name]) / row.scale)
    asked = [name for name in (tolerances or names) if name in names]
    small = [name in left and max(left[name], abs(moves[name][-1] or 0.0)) <= threshold for name in asked]
    return Convergence(
        steps_per_contact=tuple(steps),
        values=values,
        chosen=steps[-1],
        left=left,
        threshold=threshold,
        converged=len(steps) > 1 and all(small),
    )


# --- averages -----------------------------------------------------------------


def average_splits(
    runs: Iterable[tuple[Candidate, RunData, Mapping[str, Row]]], reference: RunData, steps: float
) -> dict[str, tuple[ErrorSplit, ...]]:
    """Split the errors of each candidate whose averages are compared, metric by metric; see `split`.

    ``steps``: N of the reference. Each part is the difference of two averages, with the interval of both: a part within
    its own is not resolved. At the N of the reference there is no part of the step, since the reference has the same.
    """
    runs = list(runs)
    at = {(c.model, c.how, c.factor, c.steps_per_contact): run for c, run, _ in runs}
    unsoftened = next(
        (r for c, r, _ in runs if (c.model, c.factor, c.steps_per_contact) == ("linear", 1.0, steps)), None
    )
    found = {}
    for c, run, errors in runs:
        hard = reference if c.model == "hertz" else unsoftened
        real = c.model == "hertz" and c.factor == 1.0
        fine = reference if real else at.get((c.model, c.how, c.factor, steps))
        chain: dict[str, Step] = {}
        if c.steps_per_contact != steps:
            chain["discretisation"] = (run, fine)
        if c.factor != 1.0:
            chain["softness"] = (fine, hard)
        if c.model == "linear":
            chain["model"] = (hard, reference)
        found[c.name] = tuple(
            split(row.metric, row.difference, chain, partial(_between_averages, row))
            for row in errors.values()
            if row.difference.value is not None and row.basis != RMS
        )
    return found


def _between_averages(row: Row, a: RunData, b: RunData) -> Estimate | None:
    first, second = a.estimate(row.metric), b.estimate(row.metric)
    if first.value is None or second.value is None or not row.scale:
        return None
    return apart(first, second, row.scale, NAMES)
