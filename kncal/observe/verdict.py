"""The verdict of a comparison in words: what was compared, whether it holds, what it saves, what to mind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

from kncal.core.units import percent, quantity
from kncal.observe.cost import Cost, Speed
from kncal.scene.metrics import ExactRow, MetricRow
from kncal.scene.model import Model

#: The largest difference without a tolerance is named in the verdict if it is larger than this.
NOTABLE = 0.01


class Compared(Protocol):
    """A row of a comparison, of single contacts or a bed."""

    @property
    def metric(self) -> str:
        """Name."""
        ...

    @property
    def difference(self) -> float | None:
        """Of the two runs, over a scale [-]."""
        ...

    @property
    def tolerance(self) -> float | None:
        """Allowed size of the difference [-], None: informative."""
        ...


Row = TypeVar("Row", bound=Compared)


def not_judged(rows: Sequence[Row], text_of: Callable[[Row], str]) -> str:
    """Return what a verdict says of the largest difference that nobody judged; "" if nothing is judged, or it is small.

    ``text_of`` writes the difference of a row.
    """
    left = [r for r in rows if r.tolerance is None and abs(r.difference or 0.0) > NOTABLE]
    if not left or all(r.tolerance is None for r in rows):
        return ""
    worst = max(left, key=lambda r: abs(r.difference or 0.0))
    return f" Not judged by any tolerance: {worst.metric}, {text_of(worst)}."


def sentences(
    models: tuple[Model, Model],
    rows: Sequence[MetricRow],
    exact: Sequence[ExactRow],
    costs: tuple[Cost, Cost],
    speed: Speed,
    limits: Sequence[tuple[str, str]] = (),
) -> tuple[str, ...]:
    """Return the verdict as sentences: the verdict itself, the speed, then notes (limits, caveats, surprises).

    ``limits`` are (warning code, sentence); attraction, which nearly every damped contact has, is left to the tables.
    """
    minded = [f"Mind: {text}." for code, text in limits if code != "attraction"]
    notes = (*minded, *speed.caveats, *_notes(rows, exact))
    judgement = _judgement(*models, rows) + not_judged(rows, lambda row: percent(row.difference))
    return (judgement, _speed(costs, speed), *notes)


def _judgement(linear: Model, hertz: Model, rows: Sequence[MetricRow]) -> str:
    scene = hertz.scene
    laws = ", ".join(dict.fromkeys(c.law for c in hertz.contacts.values())) or hertz.kind
    who = f"in {scene.name} the linear spring ({_spring(linear)})"
    judged = [r for r in rows if r.tolerance is not None]
    failed = [r for r in judged if r.verdict != "ok"]
    if not judged:
        return f"Not judged: no tolerance is given; {who} was compared with {laws}, the differences are below."
    if not failed:
        nearest = max(judged, key=_use)
        return (
            f"Within tolerance: {who} agrees with {laws} in {_all(len(judged))} judged; closest to its"
            f" limit: {nearest.metric}, {percent(nearest.difference)} where {allowed(nearest.tolerance)} is allowed."
        )
    texts = [
        f"{r.metric} by {percent(r.difference)} ({allowed(r.tolerance)} allowed)"
        if r.verdict == "outside"
        else f"{r.metric} could not be computed ({r.reason})"
        for r in failed
    ]
    how_many = f"{len(failed)} of {len(judged)} metrics judged"
    return f"Outside tolerance: {who} fails against {laws} in {how_many}: {'; '.join(texts)}."


def _spring(model: Model) -> str:
    stiffness = sorted({c.k for c in model.contacts.values()})
    if not stiffness:
        return "no contact"
    ends = dict.fromkeys((stiffness[0], stiffness[-1]))
    numbers = " to ".join(quantity(k, "N/m", 4) for k in ends)
    choice = model.scene.contact
    how = "prescribed" if choice.k_n is not None else f"by {choice.method}"
    return f"k_n = {numbers} {how}"


def _use(row: MetricRow) -> float:
    """Share of its tolerance that a row uses up; 0 of 0 is none."""
    if not row.difference:
        return 0.0
    return abs(row.difference) / row.tolerance if row.tolerance else float("inf")


def _speed(costs: tuple[Cost, Cost], speed: Speed) -> str:
    linear, hertz = costs
    text = f"The linear run took {linear.steps:,} steps, the Hertz run {hertz.steps:,}:"
    text += f" {factor(speed.steps, 'steps')}. CPU time: {quantity(linear.cpu_seconds, 's', 3)} against"
    text += f" {quantity(hertz.cpu_seconds, 's', 3)}"
    if speed.cpu is None:
        return f"{text}." if "builtin" in (linear.engine, hertz.engine) else f"{text}, too short for a ratio."
    text += f", {factor(speed.cpu, 'CPU time')}"
    if min(linear.runs, hertz.runs) > 1:
        text += f" (ratio {speed.cpu_low:.2f} to {speed.cpu_high:.2f} over {linear.runs} and {hertz.runs} runs)"
    return f"{text}."


def factor(ratio: float, what: str) -> str:
    """Return a ratio of "steps" or "CPU time" in words: "2.00 times fewer steps"."""
    if abs(ratio - 1.0) < 0.005:
        return f"the same {what}"
    word = "fewer" if what == "steps" else "less"
    return f"{ratio:.2f} times {word} {what}" if ratio > 1.0 else f"{1.0 / ratio:.2f} times more {what}"


def _notes(rows: Sequence[MetricRow], exact: Sequence[ExactRow]) -> list[str]:
    notes = [f"{r.metric}: {r.reason}." for r in rows if r.verdict in ("ok", "outside") and r.reason]
    judged = any(r.tolerance is not None for r in rows)
    blurred = [
        r.metric
        for r in rows
        if r.difference is not None
        and r.numerical is not None
        and 0.0 < abs(r.difference) <= r.numerical
        and (r.tolerance is not None or not judged)
    ]
    if blurred:
        notes.append(f"{', '.join(blurred)}: the two runs differ by no more than the predicted discretisation error.")
    odd = [f"{r.metric} ({r.model})" for r in exact if r.explained is False]
    if odd:
        notes.append(
            f"Further from the exact solution than the predicted discretisation error: {', '.join(odd)}."
            " Look for a contact that was not resolved before you trust the comparison."
        )
    return notes


def _all(n: int) -> str:
    return "the one metric" if n == 1 else f"all {n} metrics"


def allowed(tolerance: float | None) -> str:
    """Return a tolerance as text: "±5 %"."""
    return f"±{100.0 * (tolerance or 0.0):.3g} %"
