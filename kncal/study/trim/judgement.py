"""From effects and cost to a verdict on a part, and on everything that is left out at once, in words."""

from __future__ import annotations

from collections.abc import Sequence

from kncal.core.units import plus_minus, quantity
from kncal.study.trim.base import (
    CANNOT_RUN,
    EITHER,
    KEEP,
    LEAVE_OUT,
    MATTERS,
    NOT_NEEDED,
    OFF,
    ON,
    UNDECIDED,
    CostChange,
    Effect,
    Part,
    PartResult,
    worst_of,
)

#: Smaller shares of the cost are not worth a word; CPU times of single runs spread by so much.
_WORTH, _USUAL_SPREAD = 0.02, 0.1
#: Metrics that are named in a sentence.
_NAMED = 3
#: Without effect: verdict by `Part.change`.
_FREE = {OFF: LEAVE_OUT, ON: NOT_NEEDED}
_CONSEQUENCE = {
    LEAVE_OUT: "leave it out",
    NOT_NEEDED: "it is not needed",
    EITHER: "either will do",
}


def judge_part(part: Part, effects: tuple[Effect, ...], cost: CostChange) -> PartResult:
    """Return the verdict on a part that was run."""
    outcome, found = describe(effects)
    price = f"{_capital(part.text)}: {cost_text(cost, output=part.output)}"
    if outcome == "changed":
        verdict = KEEP if part.change == OFF else MATTERS
        consequence = {OFF: "keep it", ON: "the scene leaves out something that matters"}.get(
            part.change, "the choice matters"
        )
    elif outcome == UNDECIDED:
        verdict, consequence = UNDECIDED, "undecided" + _what_to_do(effects)
    elif part.change == OFF and not part.output and _dearer_without(cost):
        verdict, consequence = KEEP, "but without it the scene is dearer: keep it"
    else:
        verdict = _FREE.get(part.change, EITHER)
        consequence = _CONSEQUENCE[verdict]
    tried = f" (tried: {part.tried})"
    sentence = f"{price}{tried}; {found}: {consequence}."
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


def describe(effects: Sequence[Effect]) -> tuple[str, str]:
    """Return "free", "changed" or "undecided", and the effects in words."""
    changed = [e for e in effects if e.verdict == "changed"]
    undecided = [e for e in effects if e.verdict == "undecided"]
    aside = [e for e in effects if e.verdict == "-" and e.significant]
    gone = [e.metric for e in effects if e.verdict == "-" and e.full is not None and e.tried is None]
    told = ([f"without tolerance: {_listed(aside)}"] if aside else []) + (
        [f"no longer there: {', '.join(gone)}"] if gone else []
    )
    also = f" ({'; '.join(told)})" if told else ""
    if changed:
        return "changed", _listed(changed) + also
    if undecided:
        return UNDECIDED, _listed(undecided) + also
    known = [e for e in effects if e.change is not None]
    if known and all(e.verdict == "none" for e in known):
        return "free", "no metric changes by a single bit" + also
    judged = [e for e in effects if e.verdict in ("none", "within")]
    if not judged:
        return UNDECIDED, "no metric could be judged" + also
    worst = worst_of(tuple(judged))
    closest = "" if worst is None or worst.verdict == "none" else f" (closest: {effect_text(worst)})"
    which = "no judged metric" if any(e.verdict == "-" for e in effects) else "no metric"
    limit = "tolerance" if any(e.significant for e in judged) else "uncertainty"
    return "free", f"{which} changes by more than its {limit}{closest}{also}"


def _listed(effects: Sequence[Effect]) -> str:
    ordered = sorted(effects, key=lambda e: -sum(e.share or (0.0, 0.0)))
    more = f" and {len(ordered) - _NAMED} more" if len(ordered) > _NAMED else ""
    return ", ".join(effect_text(e) for e in ordered[:_NAMED]) + more


def effect_text(effect: Effect) -> str:
    """Return "e_n_2 -12.0 ± 0.1 % (1 % allowed)"."""
    if effect.change is None:
        gone = "is gone" if effect.tried is None and effect.full is not None else "cannot be compared"
        return f"{effect.metric} {gone}" + (f" ({effect.reason})" if effect.reason else "")
    allowed = "" if effect.tolerance is None else f" ({100.0 * effect.tolerance:.3g} % allowed)"
    return f"{effect.metric} {change_text(effect)}{allowed}"


def change_text(effect: Effect) -> str:
    """Return a change with its uncertainty in percent: "+1.2 ± 0.4 %"; "0" for none, "–" for one not known."""
    if effect.change is None:
        return "–"
    if effect.verdict == "none":
        return "0"
    if effect.uncertainty is None:
        return f"{100.0 * effect.change:+.3g} ± ? %"
    change, width = 100.0 * effect.change, 100.0 * effect.uncertainty
    if width < 1e-3 * abs(change):  # more digits of the change than anybody reads
        return f"{change:+.4g} ± {width if width > 1e-9 else 0.0:.1g} %"
    return f"{plus_minus(change, width, signed=True)} %"


def _what_to_do(effects: Sequence[Effect]) -> str:
    undecided = [e for e in effects if e.verdict == "undecided" and e.change is not None]
    times = [e.needed_end_time for e in undecided]
    known = [time for time in times if time is not None]
    if known and len(known) == len(times):
        return f", run until about {max(known):.3g} s (run.end_time) to decide"
    if undecided and all(e.tolerance is None for e in undecided):
        return ", say with --tolerance what matters"
    if any(e.needed_end_time is None and e.full is not None for e in undecided):
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
