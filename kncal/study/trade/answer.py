"""What a trade says: a verdict with its points, and everything as plain data."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.core.units import quantity
from kncal.observe.estimate import Estimate
from kncal.observe.row import Row, allowed, deciding_text, needed_end
from kncal.observe.verdict import Verdict
from kncal.study.trade.cost_law import Law
from kncal.study.trade.front import Conclusion, SpeedUp, Turn, changed, cost, failing, verdict, worst_ratio
from kncal.study.trade.trade import Candidate, Trade, TradePoint

if TYPE_CHECKING:
    import pandas as pd

#: Points under the sentence of a verdict; the rest are details.
MOST_POINTS = 5


def describe(candidate: Candidate) -> str:
    """Return a candidate in words."""
    return f"{contact_text(candidate)}, {candidate.steps_per_contact:g} steps per contact"


def contact_text(candidate: Candidate) -> str:
    """Return the contact of a candidate in words, without its number of steps."""
    share = "" if candidate.factor is None else shown_factor(candidate.factor)
    limit = candidate.variant.changes.get("contact.options") or {}
    return {
        "reference": "Hertz, real modulus",
        "reduced_modulus": f"Hertz, {'real modulus' if candidate.factor == 1.0 else f'modulus {share}'}",
        "softened": f"linear, k_n {share}",
        "limited_overlap": f"linear, overlap at most {100.0 * limit.get('fraction', 0.0):g} %",
        "prescribed": "linear, k_n as prescribed",
    }.get(candidate.how, f"linear, k_n by {candidate.how}")


def shown_factor(factor: float) -> str:
    """Return a factor as people write it: "/ 30" for 1/30, "x 1.05"."""
    share = 1.0 / factor
    whole = share >= 1.5 and math.isclose(share, round(share), rel_tol=1e-9)
    return f"/ {round(share)}" if whole else f"× {factor:.3g}"


def answer(trade: Trade, conclusion: Conclusion, laws: Sequence[Law]) -> Verdict:
    """Return the answer: one sentence, at most `MOST_POINTS` points, and what it rests on as details."""
    chosen = conclusion.chosen
    state = "within" if chosen else "undecided" if conclusion.promising else "outside"
    sentences = [
        _choice(trade, conclusion),
        *_nearly(trade, conclusion),
        *_changed(trade, conclusion),
        *map(_saving, conclusion.speed_ups),
        *_turns(conclusion.turns),
    ]
    points = min(len(sentences) - 1, MOST_POINTS)
    return Verdict.of(state, [*sentences, *(t for law in laws for t in law.sentences), *trade.caveats], points)


def _choice(trade: Trade, conclusion: Conclusion) -> str:
    limits = ", ".join(f"{metric} {100.0 * limit:g} %" for metric, limit in trade.tolerances.items())
    if conclusion.chosen is not None:
        return f"The cheapest contact within the tolerances ({limits}): {_with_stiffness(conclusion.chosen)}."
    ran = [verdict(p) for p in trade.points if p.completed]
    told = {"outside": "outside", "undecided": "undecided", "missing": "without a metric that has a tolerance"}
    counts = ", ".join(f"{number} {text}" for word, text in told.items() if (number := ran.count(word)))
    of = f"of {len(ran)} that ran, {counts}" if ran else "none completed"
    return f"No contact is surely within the tolerances ({limits}): {of}."


def _with_stiffness(point: TradePoint) -> str:
    k_n = "" if point.k_n is None else f", k_n = {quantity(point.k_n, 'N/m', 3)}"
    return describe(point.candidate) + k_n


def _nearly(trade: Trade, conclusion: Conclusion) -> Iterator[str]:
    """Where none is surely within: the cheapest that may be, and what decides; else the nearest."""
    point = conclusion.promising
    if point is not None:
        yield f"The cheapest that may be within: {_with_stiffness(point)}; {_there(point)}."
        yield _decides(trade, point)
    elif conclusion.nearest is not None:
        yield f"The nearest: {_with_stiffness(conclusion.nearest)}; {_there(conclusion.nearest)}."


def _there(point: TradePoint) -> str:
    return ", ".join(f"{row.metric} {deciding_text(row)} ({allowed(row.tolerance)} allowed)" for row in failing(point))


def needed_end_time(point: TradePoint) -> float | None:
    """Return the simulated time [s] at which nothing of a point is undecided; None if it is not known."""
    return needed_end(point.judged.values())


def _decides(trade: Trade, point: TradePoint) -> str:
    """Say how long a point and the reference have to run until nothing of the point is undecided."""
    needed = needed_end_time(point)
    if needed is None:
        if not trade.estimated:
            return "To decide, try more steps per contact (--steps), or allow more."
        return "What decides is not known: more than 100 times as long a run, or it cannot be predicted."
    more, end = 0.0, math.inf
    for p in (point, trade.reference):
        price = cost(trade, p)
        if not price or not p.steps or not p.dt:
            return f"To decide, it and the reference must run until about {needed:.2g} s."
        length = p.steps * p.dt  # of the whole run [s]
        end = min(end, length)
        more += price * max(needed / length - p.ran_share, 0.0)
    if needed <= end:
        how = "a larger --budget continues them"
    else:
        how = f"set run.until_time to {needed:.2g} or more"
        more = sum((cost(trade, p) or 0.0) for p in (point, trade.reference)) * needed / end
    shares = " and ".join(f"{p.ran_share * end:.2g} s" for p in (point, trade.reference))
    return (
        f"To decide, it and the reference must run until about {needed:.2g} s (now {shares}): {how} ({more:.2g} CPU s)."
    )


def _changed(trade: Trade, conclusion: Conclusion) -> Iterator[str]:
    chosen, other = conclusion.chosen, conclusion.unchanged
    if chosen is not None and (found := changed(trade, chosen)):
        yield f"But softness changes the physics there. {' '.join(sign.text for sign in found)}"
        if other is None:
            yield "No contact within the tolerances leaves the physics unchanged."
        else:
            a, b = cost(trade, chosen), cost(trade, other)
            what = {"steps": "steps", "cpu_seconds": "CPU time"}[trade.cost]
            more = f", at {b / a:.3g} times the {what}" if a and b else ""
            yield f"The cheapest that leaves the physics unchanged: {_with_stiffness(other)}{more}."
    if already := [sign.text for sign in trade.reference.signs if sign.changed]:
        yield f"The reference itself is beyond customary limits. {' '.join(already)}"


def _saving(saved: SpeedUp) -> str:
    parts = []
    if saved.steps is not None:
        parts.append(f"{saved.steps:.3g} in steps")
    if saved.cpu is not None:
        several = f"{saved.cpu.low:.3g} to {saved.cpu.high:.3g} in {saved.cpu.rounds} rounds"
        parts.append(f"{saved.cpu.median:.3g} in CPU time ({several if saved.cpu.rounds > 1 else 'one run of each'})")
    return f"Speed-up against {saved.over}: {', '.join(parts) or 'not measured'}."


def _turns(turns: Sequence[Turn]) -> Iterator[str]:
    if not turns:
        return
    first = turns[0]
    thing = {"linear": "k_n", "hertz": "the modulus"}[first.model]
    where = f"from {thing} {shown_factor(first.at)} on" if first.at != 1.0 else f"even with {thing} unsoftened"
    if first.above is not None and first.at != 1.0:
        where += f" (not yet {'unsoftened' if first.above == 1.0 else f'at {shown_factor(first.above)}'})"
    yield f"Softness changes the physics {where}, {first.model}. {first.text}"


def to_dict(trade: Trade, conclusion: Conclusion, laws: Sequence[Law]) -> dict[str, Any]:
    """Return everything as plain JSON types; what is not known is None."""
    named = {name: getattr(conclusion, name) for name in ("chosen", "unchanged", "promising", "nearest")}
    said, promising = answer(trade, conclusion, laws), conclusion.promising
    found = {
        **vars(trade),
        **{name: None if point is None else point.candidate.name for name, point in named.items()},
        "state": said.state,
        "verdict": said.all,
        "needed_end_time": None if promising is None else needed_end_time(promising),
        "front": conclusion.front,
        "front_by_metric": conclusion.by_metric,
        "speed_ups": conclusion.speed_ups,
        "turns": conclusion.turns,
        "laws": [{**vars(law), "sentences": law.sentences} for law in laws],
        "reference": _point(trade.reference),
        "points": [_point(point) for point in trade.points],
    }
    plain: dict[str, Any] = _plain(found)
    return plain


def _point(point: TradePoint) -> dict[str, Any]:
    ratio = worst_ratio(point) if point.completed else None
    return {**vars(point), "verdict": verdict(point), "worst_ratio": ratio}


def _plain(value: Any) -> Any:
    """Return JSON types; what is not finite is None."""
    if isinstance(value, Row):
        value = value.to_dict()
    elif isinstance(value, Estimate):
        value = {"value": value.value, "width": value.width, "reliable": value.reliable}
    elif is_dataclass(value):
        value = vars(value)
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
        c, cpu = point.candidate, point.cpu_seconds
        row: dict[str, Any] = {
            "name": c.name,
            "how": c.how,
            "model": c.model,
            "factor": c.factor,
            "steps_per_contact": c.steps_per_contact,
            "status": point.status,
            "verdict": "reference" if point is trade.reference else verdict(point),
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
            "worst_ratio": worst_ratio(point) if point.completed and point.errors else None,
            "signs": " ".join(sign.name for sign in changed(trade, point)),
            "message": point.message,
        }
        splits = {split.metric: split for split in trade.splits.get(c.name, ())}
        for metric in metrics:
            error, split = point.errors.get(metric), splits.get(metric)
            row[f"error_{metric}"] = None if error is None else error.difference.value
            row[f"uncertainty_{metric}"] = None if error is None else error.difference.deciding
            for part in ("discretisation", "softness", "model"):
                found = None if split is None else split.parts[part]
                row[f"{part}_{metric}"] = None if found is None else found.value
            row[f"interaction_{metric}"] = None if split is None else split.interaction
        rows.append(row)
    frame = pd.DataFrame(rows).replace([np.inf, -np.inf], np.nan)
    known = {"k_n": "N/m", "dt": "s", "cpu_seconds": "s", "cpu_low": "s", "cpu_high": "s"}
    return frame, {str(name): known.get(str(name), "-") for name in frame.columns}
