"""The answer of a trade: the Pareto front, the cheapest point inside the tolerances, and what it saves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kncal.observe.softness import Sign
from kncal.study.trade.trade import Trade, TradePoint

#: Steps per contact of usual practice, to which the saving is stated, too.
USUAL_STEPS = 50.0


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Ratios of CPU times, one per round: median, smallest and largest [-]."""

    median: float
    low: float
    high: float
    rounds: int


@dataclass(frozen=True, kw_only=True)
class SpeedUp:
    """What a point saves over another.

    Attributes
    ----------
    over : what it is compared with, in words
    steps : ratio of the numbers of steps [-], None where one is not known
    cpu : ratios of CPU times of the same round, None without such a round
    """

    over: str
    steps: float | None
    cpu: Spread | None


@dataclass(frozen=True, kw_only=True)
class Turn:
    """Between which factors a sign of softness turns, of one model.

    Attributes
    ----------
    sign : name
    model : "linear" or "hertz"
    at : the largest factor (of stiffness or modulus) at which it has turned [-]
    above : the next larger factor tried, at which it has not; None: it has turned at every one
    k_n : stiffness at ``at`` [N/m], or None
    text : what the sign says there
    """

    sign: str
    model: str
    at: float
    above: float | None
    k_n: float | None
    text: str


@dataclass(frozen=True, kw_only=True)
class Conclusion:
    """What follows from a trade.

    Attributes
    ----------
    cost : what cost means here: "steps" (single contacts) or "cpu_seconds" (beds)
    front : names of the points that no other beats in cost and `worst_ratio`, from cheap to dear
    by_metric : metric -> the same for what its error alone may be
    chosen : the cheapest point inside all tolerances, or None
    unchanged : the cheapest of those at which softness has not changed the physics (see `changed`), or None
    promising : without a chosen one, the cheapest point that is not surely outside, which more of a run may show to be
        inside; None if all are
    nearest : without a chosen one, the point whose `worst_ratio` is smallest
    failing : of ``nearest``: metric -> (abs(error) + uncertainty)/tolerance of those not surely inside; infinite: not
        computed
    speed_ups : of the chosen point, over the reference and over usual practice
    turns : where softness changes the physics, the stiffest first
    """

    cost: str
    front: tuple[str, ...]
    by_metric: Mapping[str, tuple[str, ...]]
    chosen: TradePoint | None
    unchanged: TradePoint | None
    promising: TradePoint | None
    nearest: TradePoint | None
    failing: Mapping[str, float]
    speed_ups: tuple[SpeedUp, ...]
    turns: tuple[Turn, ...]


def conclude(trade: Trade) -> Conclusion:
    """Draw the conclusions of a trade."""
    done = [p for p in trade.points if p.completed and cost(trade, p) is not None]
    priced = [(p, cost(trade, p) or 0.0) for p in done]
    rated = [(p, c, ratio) for p, c in priced if (ratio := worst_ratio(p, trade.tolerances)) < math.inf]
    front = [rated[i][0].candidate.name for i in pareto([r[1] for r in rated], [r[2] for r in rated])]
    by_metric = {}
    for metric in trade.tolerances:
        with_it = [(p, c, e) for p, c in priced if (e := _error(p, metric)) is not None]
        found = pareto([r[1] for r in with_it], [r[2] for r in with_it])
        by_metric[metric] = tuple(with_it[i][0].candidate.name for i in found)
    within = sorted(
        ((p, c) for p, c in priced if inside(p, trade.tolerances)),
        key=lambda item: (item[1], worst_ratio(item[0], trade.tolerances)),
    )
    chosen = next((p for p, _ in within), None)
    promising = nearest = None
    if chosen is None:
        open_ones = [(p, c) for p, c in priced if verdict(p, trade.tolerances) == "undecided"]
        promising = min(open_ones, key=lambda item: item[1], default=(None, 0.0))[0]
        tried = [p for p in trade.points if p.completed]
        nearest = min(tried, key=lambda p: worst_ratio(p, trade.tolerances), default=None)
    return Conclusion(
        cost="cpu_seconds" if trade.bed else "steps",
        front=tuple(front),
        by_metric=by_metric,
        chosen=chosen,
        unchanged=next((p for p, _ in within if not changed(trade, p)), None),
        promising=promising,
        nearest=nearest,
        failing={} if nearest is None else failing(nearest, trade.tolerances),
        speed_ups=() if chosen is None else _speed_ups(trade, chosen),
        turns=turns(trade),
    )


def cost(trade: Trade, point: TradePoint) -> float | None:
    """Return what points are ordered by: CPU seconds of a bed, steps of single contacts; None: not known.

    A run of a single contact is mostly the solver's start, and the noise of that would order the points; in any run
    long enough to matter its cost goes with its steps.
    """
    if not trade.bed:
        return None if point.steps is None else float(point.steps)
    return float(np.median(point.cpu_seconds)) if point.cpu_seconds else None


def pareto(costs: Sequence[float], errors: Sequence[float]) -> list[int]:
    """Return the indices of the points that no other dominates, from cheap to dear.

    One dominates another if it is no worse in both and better in one.
    """
    order = sorted(range(len(costs)), key=lambda i: (costs[i], errors[i]))
    front: list[int] = []
    for i in order:
        if not front or errors[i] < errors[front[-1]] or (costs[i], errors[i]) == (costs[front[-1]], errors[front[-1]]):
            front.append(i)
    return front


def worst_ratio(point: TradePoint, tolerances: Mapping[str, float]) -> float:
    """Return the largest (abs(error) + uncertainty)/tolerance [-]; infinite if one could not be computed.

    At most 1 means inside for certain: what an error may be counts, or luck would win.
    """
    return max((_ratio(point, metric, limit) for metric, limit in tolerances.items()), default=0.0)


def inside(point: TradePoint, tolerances: Mapping[str, float]) -> bool:
    """Return whether every error is within its tolerance with its whole interval; undecided is not inside."""
    errors = point.errors
    return bool(tolerances) and all(m in errors and errors[m].verdict(t) == "ok" for m, t in tolerances.items())


def verdict(point: TradePoint, tolerances: Mapping[str, float]) -> str:
    """Return "inside", "outside", "undecided" or "missing" for all metrics together, or the status of a failed point.

    "outside" if one metric surely is; else "missing" or "undecided" if one is.
    """
    if not point.completed:
        return point.status
    found = [point.errors[m].verdict(t) if m in point.errors else "missing" for m, t in tolerances.items()]
    return next((word for word in ("outside", "missing", "undecided") if word in found), "inside")


def _error(point: TradePoint, metric: str) -> float | None:
    """Return the size that an error may have, abs(error) + uncertainty [-]; None if it could not be computed."""
    found = point.errors.get(metric)
    return None if found is None or found.error is None else abs(found.error) + (found.uncertainty or 0.0)


def _ratio(point: TradePoint, metric: str, limit: float) -> float:
    error = _error(point, metric)
    return math.inf if error is None else error / limit


def failing(point: TradePoint, tolerances: Mapping[str, float]) -> dict[str, float]:
    """Return (abs(error) + uncertainty)/tolerance of the metrics not surely inside; infinite: not computed."""
    return {
        metric: _ratio(point, metric, limit)
        for metric, limit in tolerances.items()
        if metric not in point.errors or point.errors[metric].verdict(limit) != "ok"
    }


def usual(trade: Trade) -> TradePoint | None:
    """Return Hertz at the real modulus with the N of usual practice, or None if it was not run."""
    for point in trade.points:
        c = point.candidate
        if c.how == "reduced_modulus" and c.factor == 1.0 and c.steps_per_contact == USUAL_STEPS and point.completed:
            return point
    return None


def speed_up(point: TradePoint, slow: TradePoint, over: str) -> SpeedUp:
    """Return what ``point`` saves over ``slow``, round by round."""
    rounds = [a / b for a, b in zip(slow.cpu_seconds, point.cpu_seconds, strict=False) if b > 0.0]
    spread = None
    if rounds:
        spread = Spread(median=float(np.median(rounds)), low=min(rounds), high=max(rounds), rounds=len(rounds))
    known = slow.steps and point.steps
    return SpeedUp(over=over, steps=(slow.steps or 0) / (point.steps or 1) if known else None, cpu=spread)


def _speed_ups(trade: Trade, chosen: TradePoint) -> tuple[SpeedUp, ...]:
    n = trade.reference.candidate.steps_per_contact
    found = [speed_up(chosen, trade.reference, f"the reference (Hertz, N = {n:g})")]
    if (practice := usual(trade)) is not None:
        found.append(speed_up(chosen, practice, f"usual practice (Hertz, N = {USUAL_STEPS:g})"))
    return tuple(found)


def changed(trade: Trade, point: TradePoint) -> tuple[Sign, ...]:
    """Return the signs that softness has changed the physics of a point: those that the reference does not have."""
    already = {sign.name for sign in trade.reference.signs if sign.changed}
    return tuple(sign for sign in point.signs if sign.changed and sign.name not in already)


def turns(trade: Trade) -> tuple[Turn, ...]:
    """Return, by model and sign, the largest factor at which softness has changed the physics.

    Of the softened contacts alone (and the unsoftened ones), each factor at its finest N.
    """
    found: list[Turn] = []
    for model in ("linear", "hertz"):
        finest: dict[float, TradePoint] = {}
        for point in trade.points:
            c = point.candidate
            kept = c.how in ("softened", "reduced_modulus") or c.factor == 1.0
            if c.model == model and kept and c.factor is not None and point.completed and point.signs:
                other = finest.get(c.factor)
                if other is None or other.candidate.steps_per_contact < c.steps_per_contact:
                    finest[c.factor] = point
        factors = sorted(finest, reverse=True)
        for name in dict.fromkeys(sign.name for point in finest.values() for sign in point.signs):
            for above, factor in zip([None, *factors], factors, strict=False):
                sign = next((sign for sign in changed(trade, finest[factor]) if sign.name == name), None)
                if sign is not None:
                    k_n = finest[factor].k_n
                    found.append(Turn(sign=name, model=model, at=factor, above=above, k_n=k_n, text=sign.text))
                    break
    return tuple(sorted(found, key=lambda turn: -turn.at))
