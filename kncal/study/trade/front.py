"""The answer of a trade: the Pareto front, the cheapest point inside the tolerances, and what it saves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from kncal.observe.row import Row
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
    front : names of the points that no other beats in cost and `worst_ratio`, from cheap to dear
    by_metric : metric -> the same for what its error alone may be
    chosen : the cheapest point inside all tolerances, or None
    unchanged : the cheapest of those at which softness has not changed the physics (see `changed`), or None
    promising : without a chosen one, the cheapest point that is not surely outside, which more of a run may show to be
        inside; None if all are
    nearest : without a chosen one, the point whose `worst_ratio` is smallest
    speed_ups : of the chosen point, over the reference and over usual practice
    turns : where softness changes the physics, the stiffest first
    """

    front: tuple[str, ...]
    by_metric: Mapping[str, tuple[str, ...]]
    chosen: TradePoint | None
    unchanged: TradePoint | None
    promising: TradePoint | None
    nearest: TradePoint | None
    speed_ups: tuple[SpeedUp, ...]
    turns: tuple[Turn, ...]


def conclude(trade: Trade) -> Conclusion:
    """Draw the conclusions of a trade."""
    priced = [(p, c) for p in trade.points if p.completed and (c := cost(trade, p)) is not None]
    within = sorted(((p, c) for p, c in priced if inside(p)), key=lambda item: (item[1], worst_ratio(item[0])))
    chosen = next((p for p, _ in within), None)
    promising = nearest = None
    if chosen is None:
        open_ones = [(p, c) for p, c in priced if verdict(p) == "undecided"]
        promising = min(open_ones, key=lambda item: item[1], default=(None, 0.0))[0]
        nearest = min((p for p in trade.points if p.completed), key=worst_ratio, default=None)
    return Conclusion(
        front=_front(priced, worst_ratio),
        by_metric={metric: _front(priced, partial(reach, metric=metric)) for metric in trade.tolerances},
        chosen=chosen,
        unchanged=next((p for p, _ in within if not changed(trade, p)), None),
        promising=promising,
        nearest=nearest,
        speed_ups=() if chosen is None else _speed_ups(trade, chosen),
        turns=turns(trade),
    )


def _front(priced: Sequence[tuple[TradePoint, float]], error: Callable[[TradePoint], float]) -> tuple[str, ...]:
    """Names of the points on the Pareto front of cost and ``error``, of those whose error is known."""
    known = [(p, c, e) for p, c in priced if (e := error(p)) < math.inf]
    return tuple(known[i][0].candidate.name for i in pareto([c for _, c, _ in known], [e for *_, e in known]))


def cost(trade: Trade, point: TradePoint) -> float | None:
    """Return what points are ordered by, `Trade.cost`; None: not known."""
    if trade.cost == "steps":
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


def reach(point: TradePoint, metric: str) -> float:
    """Return (abs(error) + uncertainty)/tolerance [-]; infinite if it could not be computed."""
    row = point.errors.get(metric)
    return math.inf if row is None or row.difference.value is None else row.reach


def worst_ratio(point: TradePoint) -> float:
    """Return the largest `reach` of the judged metrics.

    At most 1 means inside for certain: what an error may be counts, or luck would win.
    """
    return max((reach(point, metric) for metric in point.judged), default=math.inf)


def inside(point: TradePoint) -> bool:
    """Return whether every error is within its tolerance with its whole interval; undecided is not inside."""
    return verdict(point) == "inside"


def verdict(point: TradePoint) -> str:
    """Return "inside", "outside", "undecided" or "missing" for all metrics together, or the status of a failed point.

    "outside" if one metric surely is; else "missing" or "undecided" if one is.
    """
    if not point.completed:
        return point.status
    found = {row.verdict for row in point.judged.values()}
    ranked = ("outside", "missing", "undecided")
    return next((word for word in ranked if word in found), "inside" if found else "missing")


def failing(point: TradePoint) -> tuple[Row, ...]:
    """Return the rows that are not surely inside."""
    return tuple(row for row in point.judged.values() if row.verdict != "ok")


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
