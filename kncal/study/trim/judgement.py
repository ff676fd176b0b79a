"""From effects and cost to a verdict on a part, and on everything that is left out at once, in words."""

from __future__ import annotations

from collections.abc import Sequence

from kncal.core.units import percent, quantity
from kncal.observe.row import Row, allowed, deciding_text, needed_end
from kncal.study.trim.trim import (
    CANNOT_RUN,
    EITHER,
    KEEP,
    LEAVE_OUT,
    MATTERS,
    NOT_NEEDED,
    OFF,
    ON,
    OTHER,
    UNDECIDED,
    CostChange,
    Part,
    PartResult,
    share,
    worst_of,
)

#: Smaller shares of the cost are not worth a word; CPU times of single runs spread by so much.
_WORTH, _USUAL_SPREAD = 0.02, 0.1
#: Metrics that are named in a sentence.
_NAMED = 3
#: Verdict without an effect, and with one, by `Part.change`.
_VERDICTS = {OFF: (LEAVE_OUT, KEEP), ON: (NOT_NEEDED, MATTERS), OTHER: (EITHER, MATTERS)}
_SAID = {
    LEAVE_OUT: "leave it out",
    KEEP: "keep it",
    NOT_NEEDED: "not needed",
    EITHER: "either will do",
    MATTERS: "it matters",
}


def judge_part(part: Part, effects: tuple[Row, ...], cost: CostChange) -> PartResult:
    """Return the verdict on a part that was run."""
    outcome, found = describe(effects)
    price = cost_text(cost, output=part.output)
    if outcome == UNDECIDED:
        verdict, said = UNDECIDED, UNDECIDED + _what_to_do(effects)
    elif outcome == "free" and part.change == OFF and not part.output and _dearer_without(cost):
        verdict, said = KEEP, "keep it, since the scene is dearer without it"
    else:
        verdict = _VERDICTS[part.change][outcome == "changed"]
        said = _SAID[verdict]
    sentence = f"{_capital(part.text)} (tried: {part.tried}): {said}. Cost: {price}. Effect: {found}."
    return PartResult(part=part, verdict=verdict, sentence=sentence, cost=cost, effects=effects)


def _dearer_without(cost: CostChange) -> bool:
    """Whether the part saves time for certain, or, where the spread is not known, by more than it usually is."""
    if cost.cpu_high is not None:
        return cost.cpu_high < -_WORTH
    return cost.steps < -_WORTH if cost.cpu is None else cost.cpu < -_USUAL_SPREAD


def cannot_run(part: Part, status: str, message: str) -> PartResult:
    """Return the result of a part without which (or with which) the scene does not run."""
    how = "cannot be run" if status == "refused" else f"ended as {status.replace('_', ' ')}"
    return PartResult(
        part=part, verdict=CANNOT_RUN, sentence=f"{_capital(part.text)}: the scene {how} with {part.tried}: {message}"
    )


def describe(effects: Sequence[Row]) -> tuple[str, str]:
    """Return "free", "changed" or "undecided", and the effects in words."""
    outside, undecided = ([row for row in effects if row.verdict == word] for word in ("outside", "undecided"))
    aside = [row for row in effects if row.verdict == "-" and row.difference.significant]
    gone = [r.metric for r in effects if r.verdict == "-" and r.reference.value is not None and r.run.value is None]
    also = f"; without tolerance: {_listed(aside)}" if aside else ""
    also += f"; no longer there: {', '.join(gone)}" if gone else ""
    if outside:
        return "changed", _listed(outside) + also
    if undecided:
        return UNDECIDED, _listed(undecided) + also
    known = [row for row in effects if row.difference.value is not None]
    if known and not any(row.difference.value for row in known):
        return "free", "no metric changes by a single bit" + also
    judged = [row for row in effects if row.verdict == "ok"]
    if not judged:
        return UNDECIDED, "no metric could be judged" + also
    worst = worst_of(judged)
    closest = "" if worst is None or not worst.difference.value else f"; closest: {effect_text(worst)}"
    limit = "tolerance" if any(row.difference.significant for row in judged) else "uncertainty"
    return "free", f"no judged metric changes by more than its {limit}{closest}{also}"


def _listed(effects: Sequence[Row]) -> str:
    ordered = sorted(effects, key=lambda row: -sum(share(row) or (0.0, 0.0)))
    more = f" and {len(ordered) - _NAMED} more" if len(ordered) > _NAMED else ""
    return ", ".join(effect_text(row) for row in ordered[:_NAMED]) + more


def effect_text(row: Row) -> str:
    """Return "e_n -12.0 ± 0.1 % (±1 % allowed)"."""
    if row.difference.value is None:
        gone = "is gone" if row.run.value is None and row.reference.value is not None else "cannot be compared"
        return f"{row.metric} {gone}" + (f" ({row.reason})" if row.reason else "")
    limit = "" if row.tolerance is None else f" ({allowed(row.tolerance)} allowed)"
    return f"{row.metric} {change_text(row)}{limit}"


def change_text(row: Row) -> str:
    """Return a change with its uncertainty in percent: "+1.2 ± 0.4 %"; "0" for none, "–" for one not known."""
    found = row.difference
    if found.value == 0.0:
        return "0"
    if found.value is not None and found.width is None:
        return f"{100.0 * found.value:+.3g} ± ? %"
    # a small width would give more digits of the change than anybody reads
    return percent(found.value) if found.deciding < 1e-3 * abs(found.value or 0.0) else deciding_text(row)


def _what_to_do(effects: Sequence[Row]) -> str:
    undecided = [row for row in effects if row.verdict == "undecided" and row.difference.value is not None]
    if (end := needed_end(undecided)) is not None:
        return f", run until about {end:.3g} s (run.until_time) to decide"
    if undecided and all(row.tolerance is None for row in undecided):
        return ", say with --tolerance what matters"
    if any(row.difference.needed_end is None for row in undecided):
        return ", run much longer (of single contacts: with more steps per contact), or allow more"
    return ""


def cost_text(cost: CostChange, *, output: bool = False) -> str:
    """Return what a part costs: "+24 % CPU (20 to 27 %)", or the steps where CPU times say nothing."""
    texts = []
    if cost.cpu is not None:
        span = ""
        if cost.cpu_low is not None and cost.cpu_high is not None:
            span = f" ({100.0 * cost.cpu_low:+.3g} to {100.0 * cost.cpu_high:+.3g} %)"
        texts.append(f"{100.0 * cost.cpu:+.3g} % CPU{span}")
    else:
        texts.append("no more steps" if cost.steps == 0.0 else f"{100.0 * cost.steps:+.3g} % steps")
    if output:
        texts.append(f"{quantity(float(cost.full_bytes), 'B', 3)} against {quantity(float(cost.tried_bytes), 'B', 3)}")
    return ", ".join(texts)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
