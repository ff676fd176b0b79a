"""The cost of points of single contacts: which of them are timed by the solver, in which order, and what to know."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from kncal.observe.cost import CPU_TRUSTED
from kncal.study.trade.base import Candidate, Tell, TradeOptions, TradePoint
from kncal.study.trade.budget import Budget
from kncal.study.trade.front import USUAL_STEPS, pareto, worst_ratio
from kncal.study.trade.runs import Runs

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
    runs: Runs,
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
        if k > 0 and not budget.allows(predicted):
            tell(f"the budget is used: {len(wanted) - k} points are not timed")
            return
        tell(f"timing {len(batch)} runs in {options.rounds} rounds; {budget.left():.0f} s left")
        before = budget.spent()
        runs.run(batch, options.rounds, timeout=max(budget.left(), 1.0))
        predicted = max(predicted, budget.spent() - before)


def timed(point: TradePoint, runs: Runs, why_not: str) -> TradePoint:
    """Return a point with the CPU times of its runs; ``why_not`` where there are none."""
    ended = runs.ended.get(point.candidate.name)
    if not point.completed or ended is None:
        return replace(point, message=point.message or why_not) if point.completed else point
    if not ended.completed:
        return replace(point, status=ended.status, message=ended.message or ended.failure)
    return replace(point, cpu_seconds=ended.cpu_seconds)


def agreement(screened: Runs, solved: Runs, names: Collection[str]) -> float | None:
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
