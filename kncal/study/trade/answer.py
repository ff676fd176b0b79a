"""What a trade says: sentences, and everything as plain data."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.core.units import quantity
from kncal.study.trade.cost_law import Law
from kncal.study.trade.front import Conclusion, SpeedUp, Turn, changed, cost, failing, verdict, worst_ratio
from kncal.study.trade.trade import Candidate, Trade, TradePoint

if TYPE_CHECKING:
    import pandas as pd


def describe(candidate: Candidate) -> str:
    """Return a candidate in words."""
    steps = f"{candidate.steps_per_contact:g} steps per contact"
    share = "" if candidate.factor is None else shown_factor(candidate.factor)
    return {
        "reference": f"Hertz, real modulus, {steps}",
        "reduced_modulus": f"Hertz, {'real modulus' if candidate.factor == 1.0 else f'modulus {share}'}, {steps}",
        "softened": f"linear, k_n {share}, {steps}",
        "limited_overlap": f"linear, overlap limited (k_n {share or 'given by it'}), {steps}",
        "prescribed": f"linear, k_n as prescribed, {steps}",
    }.get(candidate.how, f"linear, k_n by {candidate.how}, {steps}")


def shown_factor(factor: float) -> str:
    """Return a factor as people write it: "/ 30" for 1/30, "x 1.05"."""
    share = 1.0 / factor
    whole = share >= 1.5 and math.isclose(share, round(share), rel_tol=1e-9)
    return f"/ {round(share)}" if whole else f"× {factor:.3g}"


def sentences(trade: Trade, conclusion: Conclusion, laws: Sequence[Law]) -> tuple[str, ...]:
    """Return the answer, then what it rests on."""
    return (
        _choice(trade, conclusion),
        *_changed(trade, conclusion),
        *(_saving(saved) for saved in conclusion.speed_ups),
        *_turns(conclusion.turns),
        *(text for law in laws for text in law.sentences),
        *trade.caveats,
    )


def _choice(trade: Trade, conclusion: Conclusion) -> str:
    limits = ", ".join(f"{metric} {100.0 * limit:g} %" for metric, limit in trade.tolerances.items())
    chosen = conclusion.chosen
    if chosen is not None:
        k_n = "" if chosen.k_n is None else f", k_n = {quantity(chosen.k_n, 'N/m', 3)}"
        return f"Cheapest contact inside the tolerances ({limits}): {describe(chosen.candidate)}{k_n}."
    if conclusion.nearest is None:
        return f"No contact is inside the tolerances ({limits}): no point completed."
    if trade.bed:
        return f"No contact is surely inside the tolerances ({limits}): {_of_bed(trade, conclusion)}"
    nearest = conclusion.nearest
    return (
        f"No contact is surely inside the tolerances ({limits}). Nearest: {describe(nearest.candidate)}; "
        f"there {_there(nearest, trade)}."
    )


def _of_bed(trade: Trade, conclusion: Conclusion) -> str:
    """Say whether the contacts of a bed are outside or only undecided, and what would decide."""
    ran = [verdict(p, trade.tolerances) for p in trade.points if p.completed]
    counts = {word: ran.count(word) for word in ("outside", "undecided", "missing")}
    told = {"outside": "surely outside", "undecided": "only undecided", "missing": "without a metric that has one"}
    of = ", ".join(f"{number} {told[word]}" for word, number in counts.items() if number)
    point = conclusion.promising
    if point is None:
        nearest = conclusion.nearest
        last = "" if nearest is None else f" Nearest: {describe(nearest.candidate)}; there {_there(nearest, trade)}."
        return f"of {len(ran)} that ran, {of}.{last}"
    return (
        f"of {len(ran)} that ran, {of}. The cheapest that may be inside: {describe(point.candidate)}; "
        f"there {_there(point, trade)}. {_decides(trade, point)}"
    )


def _there(point: TradePoint, trade: Trade) -> str:
    return ", ".join(
        f"{metric} " + ("not computed" if ratio == math.inf else _failing(point, metric, ratio, trade))
        for metric, ratio in failing(point, trade.tolerances).items()
    )


def _decides(trade: Trade, point: TradePoint) -> str:
    """Say how long a point of a bed and the reference have to run until nothing of the point is undecided."""
    needed = needed_end_time(trade, point)
    if needed is None:
        return "How long a run would decide is not known: more than 100 times as long, or it cannot be predicted."
    ends = f"it and the reference have to come to about {needed:.2g} s of simulated time"
    more, end = 0.0, math.inf
    for p in (point, trade.reference):
        price = cost(trade, p)
        if not price or not p.steps or not p.dt:
            return f"To decide, {ends}."
        length = p.steps * p.dt  # of the whole run [s]
        end = min(end, length)
        more += price * max(needed / length - p.ran_share, 0.0)
    shares = " and ".join(f"{100.0 * p.ran_share:.0f} %" for p in (point, trade.reference))
    now = f"now {shares} of {end:.3g} s"
    if needed <= end:
        return (
            f"To decide, {ends} ({now}): about {more:.2g} CPU s more for the two; a larger --budget goes on with them."
        )
    whole = sum((cost(trade, p) or 0.0) for p in (point, trade.reference)) * needed / end
    return (
        f"To decide, {ends} ({now}): run.end_time = {needed:.2g} or more, which takes about {whole:.2g} CPU s"
        " for the two."
    )


def _changed(trade: Trade, conclusion: Conclusion) -> Iterator[str]:
    chosen, other = conclusion.chosen, conclusion.unchanged
    found = [sign.text for sign in changed(trade, chosen)] if chosen is not None else []
    if found:
        yield f"Beware: inside the tolerances, but at this contact softness has changed the physics. {' '.join(found)}"
        if other is None:
            yield "No contact inside the tolerances leaves the physics unchanged."
        else:
            k_n = "" if other.k_n is None else f", k_n = {quantity(other.k_n, 'N/m', 3)}"
            more = _more(trade, other, conclusion)
            yield f"The cheapest that leaves the physics unchanged: {describe(other.candidate)}{k_n}{more}."
    already = [sign.text for sign in trade.reference.signs if sign.changed]
    if already:
        yield f"Already the reference is beyond customary limits: {' '.join(already)}"


def _more(trade: Trade, other: TradePoint, conclusion: Conclusion) -> str:
    """How much dearer another point is than the chosen one."""
    a = None if conclusion.chosen is None else cost(trade, conclusion.chosen)
    b = cost(trade, other)
    what = "CPU time" if trade.bed else "steps"
    return "" if not a or not b else f", at {b / a:.3g} times the {what}"


def _failing(point: TradePoint, metric: str, ratio: float, trade: Trade) -> str:
    error = point.errors[metric]
    width = "" if error.uncertainty is None else f" ± {100.0 * error.uncertainty:.2g} %"
    value = f"is {100.0 * (error.error or 0.0):+.3g} %{width}"
    if error.verdict(trade.tolerances[metric]) == "undecided":
        return f"{value}, undecided: the interval reaches {ratio:.3g} times the tolerance"
    return f"{value}, outside: up to {ratio:.3g} times its tolerance"


def needed_end_time(trade: Trade, point: TradePoint) -> float | None:
    """Return the simulated time [s] at which nothing of a bed's point is undecided; None if it is not known."""
    open_ones = [e for m, limit in trade.tolerances.items() if (e := point.errors[m]).verdict(limit) == "undecided"]
    times = [e.needed_end_time for e in open_ones if e.needed_end_time is not None]
    return max(times) if times and len(times) == len(open_ones) else None


def _saving(saved: SpeedUp) -> str:
    parts = []
    if saved.steps is not None:
        parts.append(f"{saved.steps:.3g} times fewer steps")
    if saved.cpu is not None:
        spread = f" (median; {saved.cpu.low:.3g} to {saved.cpu.high:.3g} in {saved.cpu.rounds} rounds)"
        spread = spread if saved.cpu.rounds > 1 else " (one run of each: the spread is not known)"
        parts.append(f"{saved.cpu.median:.3g} times less CPU time as measured{spread}")
    return f"Against {saved.over}: {', '.join(parts) or 'not measured'}."


def _turns(turns: Sequence[Turn]) -> Iterator[str]:
    if not turns:
        return
    first = turns[0]
    thing = {"linear": "k_n", "hertz": "the modulus"}[first.model]
    where = f"at {thing} {shown_factor(first.at)}" if first.at != 1.0 else f"even with {thing} unsoftened"
    if first.above is not None and first.at != 1.0:
        where += f" (not yet at {shown_factor(first.above)})" if first.above != 1.0 else " (not yet unsoftened)"
    yield f"Softness changes the physics first {where}, {first.model}: {first.text}"


def to_dict(trade: Trade, conclusion: Conclusion, laws: Sequence[Law]) -> dict[str, Any]:
    """Return everything as plain JSON types; what is not known is None."""
    chosen, promising, nearest = conclusion.chosen, conclusion.promising, conclusion.nearest
    found = {
        "case": trade.case,
        "title": trade.title,
        "bed": trade.bed,
        "verdict": list(sentences(trade, conclusion, laws)),
        "tolerances": dict(trade.tolerances),
        "chosen": None if chosen is None else chosen.candidate.name,
        "unchanged": None if conclusion.unchanged is None else conclusion.unchanged.candidate.name,
        "promising": None if promising is None else promising.candidate.name,
        "needed_end_time": None if promising is None else needed_end_time(trade, promising),
        "nearest": None if nearest is None else nearest.candidate.name,
        "failing": dict(conclusion.failing),
        "cost": conclusion.cost,
        "front": list(conclusion.front),
        "front_by_metric": {metric: list(names) for metric, names in conclusion.by_metric.items()},
        "speed_ups": [asdict(saved) for saved in conclusion.speed_ups],
        "turns": [asdict(turn) for turn in conclusion.turns],
        "laws": [asdict(law) | {"sentences": list(law.sentences)} for law in laws],
        "convergence": None if trade.convergence is None else asdict(trade.convergence),
        "reference": _point(trade, trade.reference),
        "points": [_point(trade, point) for point in trade.points],
        "splits": {name: [asdict(split) for split in splits] for name, splits in trade.splits.items()},
        "caveats": list(trade.caveats),
        "options": asdict(trade.options),
        "wall_seconds": trade.wall_seconds,
    }
    plain: dict[str, Any] = _plain(found)
    return plain


def _point(trade: Trade, point: TradePoint) -> dict[str, Any]:
    return asdict(point) | {
        "verdict": verdict(point, trade.tolerances),
        "worst_ratio": worst_ratio(point, trade.tolerances) if point.completed else None,
    }


def _plain(value: Any) -> Any:
    """Return JSON types; what is not finite is None."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def to_frame(trade: Trade, conclusion: Conclusion) -> tuple[pd.DataFrame, dict[str, str]]:
    """Return one row per point, the reference first, and the unit of each column.

    For each metric: its error, the uncertainty of that, and the parts of it, all shares.
    """
    import pandas as pd

    metrics = list(dict.fromkeys(name for point in trade.points for name in point.errors))
    rows = []
    for point in (trade.reference, *trade.points):
        c = point.candidate
        cpu = point.cpu_seconds
        row: dict[str, Any] = {
            "name": c.name,
            "how": c.how,
            "model": c.model,
            "factor": c.factor,
            "steps_per_contact": c.steps_per_contact,
            "status": point.status,
            "verdict": "reference" if point is trade.reference else verdict(point, trade.tolerances),
            "on_front": c.name in conclusion.front,
            "chosen": conclusion.chosen is not None and c.name == conclusion.chosen.candidate.name,
            "k_n": point.k_n,
            "steps": point.steps,
            "dt": point.dt,
            "cpu_seconds": float(np.median(cpu)) if cpu else None,
            "cpu_low": min(cpu, default=None),
            "cpu_high": max(cpu, default=None),
            "rounds": len(cpu),
            "ran_share": point.ran_share,
            "worst_ratio": worst_ratio(point, trade.tolerances) if point.completed and point.errors else None,
            "signs": " ".join(sign.name for sign in changed(trade, point)),
            "message": point.message,
        }
        splits = {split.metric: split for split in trade.splits.get(c.name, ())}
        for metric in metrics:
            error, split = point.errors.get(metric), splits.get(metric)
            row[f"error_{metric}"] = None if error is None else error.error
            row[f"uncertainty_{metric}"] = None if error is None else error.uncertainty
            for part in ("discretisation", "softness", "model"):
                found = None if split is None else getattr(split, part)
                row[f"{part}_{metric}"] = None if found is None else found.value
            row[f"interaction_{metric}"] = None if split is None else split.interaction
        rows.append(row)
    frame = pd.DataFrame(rows).replace([np.inf, -np.inf], np.nan)
    known = {"k_n": "N/m", "dt": "s", "cpu_seconds": "s", "cpu_low": "s", "cpu_high": "s"}
    return frame, {str(name): known.get(str(name), "-") for name in frame.columns}
