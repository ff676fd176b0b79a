"""The cost of points of single contacts: which of them are timed by the solver, in which order, and what to know."""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from kncal.observe.cost import CPU_TRUSTED
from kncal.study.trade.budget import Budget
from kncal.study.trade.front import USUAL_STEPS, pareto, worst_ratio
from kncal.study.trade.runs import BedRuns, ContactRuns
from kncal.study.trade.trade import Candidate, Tell, TradeOptions, TradePoint

#: Runs that are started together under a budget.
_BATCH = 8


def timing_order(
    points: Sequence[TradePoint], tolerances: Mapping[str, float], usual_steps: float
) -> Iterator[TradePoint]:
    """Give the completed points in the order in which their CPU time tells most.

    Usual practice and the front first, nearest to the tolerances, then what the law of cost needs, then the rest.
    """
    done = {p.candidate.name: p for p in points if p.completed}
    ratio = {name: worst_ratio(p, tolerances) for name, p in done.items()}
    names = [name for name in done if ratio[name] < math.inf]
    front = [names[i] for i in pareto([done[n].steps or 0 for n in names], [ratio[n] for n in names])]
    front.sort(key=lambda n: abs(math.log(max(ratio[n], 1e-9))))
    hertz = [
        name
        for name, p in done.items()
        if p.candidate.how == "reduced_modulus" and p.candidate.factor == 1.0
        if p.candidate.steps_per_contact == USUAL_STEPS
    ]
    at = min({p.candidate.steps_per_contact for p in done.values()}, key=lambda n: abs(n - usual_steps), default=0.0)
    law = [
        name
        for name, p in done.items()
        if p.candidate.steps_per_contact == at and (p.candidate.how in _LAW or p.candidate.factor == 1.0)
    ]
    rest = sorted(done, key=lambda n: abs(math.log(max(min(ratio[n], 1e9), 1e-9))))
    for name in dict.fromkeys([*hertz, *front, *law, *rest]):
        yield done[name]


#: Softened contacts, whose cost over stiffness is the law.
_LAW = ("softened", "reduced_modulus")


def time_points(
    runs: ContactRuns,
    reference: Candidate,
    points: Sequence[TradePoint],
    options: TradeOptions,
    usual_steps: float,
    budget: Budget,
    tell: Tell,
) -> None:
    """Run the reference and the points in interleaved rounds; with a budget in batches, until it is used."""
    wanted = [p.candidate for p in timing_order(points, options.tolerances, usual_steps)]
    if budget.seconds is None:
        tell(f"timing {len(wanted) + 1} runs in {options.rounds} interleaved rounds with {runs.engine}")
        runs.run([reference, *wanted], options.rounds)
        return
    predicted = 0.0
    for k in range(0, len(wanted), _BATCH):
        batch = [reference, *wanted[k : k + _BATCH]] if k == 0 else wanted[k : k + _BATCH]
        if k > 0 and predicted > budget.left():
            tell(f"the budget is used: {len(wanted) - k} points are not timed")
            return
        tell(f"timing {len(batch)} runs in {options.rounds} rounds; {budget.left():.0f} s left")
        before = budget.spent()
        runs.run(batch, options.rounds, max(budget.left(), 1.0))
        predicted = max(predicted, budget.spent() - before)


def timed(point: TradePoint, runs: ContactRuns, why_not: str) -> TradePoint:
    """Return a point with the CPU times of its runs; ``why_not`` where there are none."""
    ended = runs.ended.get(point.candidate.name)
    if not point.completed or ended is None:
        return replace(point, message=point.message or why_not) if point.completed else point
    if not ended.completed:
        return replace(point, status=ended.status, message=ended.message or ended.failure)
    return replace(point, cpu_seconds=ended.cpu_seconds)


def agreement(screened: ContactRuns, solved: ContactRuns, names: Collection[str]) -> float | None:
    """Return the largest relative difference of metrics between the two engines [-]; None: nothing in common."""
    found = [
        abs(value - other) / abs(value)
        for name, data in solved.data.items()
        if name in screened.data
        for metric, value in data.observations.metrics.items()
        if metric in names
        if (other := screened.data[name].observations.metrics.get(metric)) is not None and value != 0.0
    ]
    return max(found, default=None)


def time_sentences(points: Sequence[TradePoint], reference: TradePoint, engine: str, load: float) -> Iterator[str]:
    """Say what the CPU times are worth."""
    skipped = sum(p.status == "skipped" for p in points)
    if skipped:
        yield f"{skipped} of {len(points)} points were not run: the budget was used; a larger one goes on with them."
    times = [c for p in (reference, *points) for c in p.cpu_seconds]
    if not times:
        yield "No run was timed: costs are numbers of steps."
        return
    if engine == "builtin":
        yield "The builtin engine jumps over free flight: its CPU time says nothing about a solver's."
    elif float(np.median(times)) < CPU_TRUSTED:
        yield (
            f"Most runs take less than {CPU_TRUSTED:g} s of CPU, which is mostly the solver's start: points are ordered"
            " by their steps, and the ratio of steps is the saving in a long run."
        )
    untimed = [p for p in points if p.completed and not p.cpu_seconds]
    if untimed:
        yield f"{len(untimed)} of {len(points)} points were not timed (the budget was used)."
    yield f"Load of the machine before the runs: {load:.1f}."


def bed_sentences(
    runs: BedRuns, candidates: Sequence[Candidate], step: tuple[float, float], budget: Budget, load: float
) -> Iterator[str]:
    """Tell what to keep in mind of the runs of a bed.

    Parameters
    ----------
    candidates : all that could run, the reference first
    step : N of the reference, and the discretisation error of its contacts that is predicted there
    budget : that was given; load : load average at the start
    """
    n, error = step
    yield (
        f"The reference, Hertz at the real modulus, has N = {n:g}: there the step changes its contacts by"
        f" {100.0 * error:.2g} % in the mean, by prediction; what it does to averages was not resolved by runs"
        " of their own unless another N is among the points."
    )
    top, *others = (runs.share(c.name) for c in candidates)
    if top < 1.0:
        yield (
            f"The reference was run in part: {100.0 * top:.3g} % of its time. Averages are over that time,"
            " with the wider intervals of it; CPU times are extrapolated to the whole time."
        )
    if part := sum(0.0 < share < 1.0 for share in others):
        yield f"{part} more run(s) came to a part of their time only (ran_share); the same holds for them."
    held = [later / first for name in runs.spans if (rates := runs.rates(name))[1:] for first, later in [rates]]
    if held:
        worst = max(held, key=lambda ratio: abs(math.log(ratio)))
        yield (
            f"Extrapolation of CPU times, checked on {len(held)} run(s): what followed the first part took"
            f" {float(np.median(held)):.3g} times as long as that predicted (median; farthest: {worst:.3g})."
        )
    yield (
        f"{runs.lanes} run(s) side by side on {os.cpu_count()} cores; load average {load:.2f} at the start,"
        f" {os.getloadavg()[0]:.2f} at the end: others' work makes CPU times longer, by the cache, and more so"
        " wall-clock times."
    )
    if budget.seconds is not None:
        waiting = sum(share == 0.0 for share in others)
        yield (
            f"Budget {budget.seconds:g} s, used {budget.spent():.0f} s; {waiting} candidate(s) had no"
            " turn. The same command with a larger budget goes on with these runs; with another run.end_time"
            " they would be others."
        )
