"""The page of a trade: the answer, the front, where the errors come from, the law of cost, and every point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kncal import __version__
from kncal.core.units import plus_minus, quantity, si_prefix
from kncal.report.page import Page, Section, Table, report_folder, verdict, write_page
from kncal.report.style import model_name
from kncal.study.trade.answer import describe, sentences, shown_factor
from kncal.study.trade.cost_law import Law
from kncal.study.trade.figures import draw_trade_figures
from kncal.study.trade.front import Conclusion, changed, cost, worst_ratio
from kncal.study.trade.front import verdict as verdict_of
from kncal.study.trade.trade import Candidate, ErrorSplit, MetricError, Part, Trade, TradePoint

#: Points of the front whose worst error is more times its tolerance are not shown with it.
NEAR = 10.0
_SPLIT = (
    "Each part is measured by changing one thing. Discretisation: this contact at its N against the same contact at the"
    " N of the reference. Softness: this contact against the unsoftened one of the same model. Model: the unsoftened"
    " linear contact against the reference. For numbers the parts add up exactly; for distances of paths they need not,"
    " and what is left over is called interaction."
)
_REFERENCE = (
    "N was doubled until no judged metric changed by more than a tenth of the smallest tolerance. Left: the remaining"
    " discretisation error (by Richardson, or the distance to the exact solution if that is larger). SI units."
)


def write_trade_report(trade: Trade, conclusion: Conclusion, laws: Sequence[Law], folder: Path) -> Path:
    """Write the report into ``folder`` (made if missing, files of an earlier report replaced); return the page.

    Raises
    ------
    RenderError
        If ``folder`` is a file or a symbolic link.
    """
    with report_folder(folder) as drawn:
        figures = draw_trade_figures(trade, conclusion, laws, drawn)
    near = shown_points(trade, conclusion)
    state = "within" if conclusion.chosen else "outside" if conclusion.promising is None else "undecided"
    lost = tuple(f"{p.candidate.name}: {p.status}: {p.message}" for p in trade.points if not p.completed)
    about = "what a softer or coarser contact saves, and what it costs in accuracy"
    page = Page(
        case=trade.case,
        title=trade.title,
        subject="speed for accuracy",
        about=f"Case {trade.case}: {about}. Reference: {describe(trade.reference.candidate)}.",
        verdict=verdict(state, sentences(trade, conclusion, laws), points=5),
        sections=(
            Section(title="Cost against error", figures=figures),
            _first_section(trade, conclusion, near),
            Section(
                title="Where the errors come from" if trade.bed else "Where the errors of the front come from",
                text=(_SPLIT,) if trade.splits else (),
                table=_split_table(trade, near),
                remark="In brackets: not resolved (smaller than its uncertainty, or that is not known).",
            ),
            Section(title="The reference", table=_convergence_table(trade), remark=_REFERENCE),
            Section(
                title="Every point",
                table=point_table(trade, conclusion, [trade.reference, *trade.points]),
                parts=(Section(title="Without numbers", points=lost),),
                folded=True,
            ),
        ),
        provenance={"kncal": {"version": __version__, "wall time": quantity(trade.wall_seconds, "s", 3)}},
        files=("../trade.json", "../trade.csv", *(("../case.toml",) if conclusion.chosen is not None else ())),
    )
    return write_page(page, folder)


def _first_section(trade: Trade, conclusion: Conclusion, near: Sequence[TradePoint]) -> Section:
    """The points that count: the front, or of a bed all that ran."""
    end = "Worst: the largest (|error| + uncertainty)/tolerance. A point is ok only if its whole interval is inside."
    start = "N: steps per contact, with the same meaning for every contact. Errors are relative to the reference;"
    table = point_table(trade, conclusion, [trade.reference, *near])
    if trade.bed:
        return Section(
            title="The contacts that ran",
            text=(
                "From cheap to dear. A share run is the part of the case's time that was simulated; CPU times are"
                " extrapolated to the whole time.",
            ),
            table=table,
            remark=f"{start} ± is the 95 % interval of the difference of the two averages. {end} Undecided: its"
            " interval is partly inside. CPU: of the whole run, median of its parts (smallest–largest).",
        )
    far = len(conclusion.front) - len(near)
    left_out = f" {far} more points of the front are cheaper, and more than {NEAR:g} times outside." if far else ""
    return Section(
        title="The Pareto front",
        text=(
            "No other point has both a smaller number of steps and a smaller worst error over tolerance, uncertainty"
            f" included.{left_out}",
        ),
        table=table,
        remark=f"{start} ± is the remaining error of the reference and what another moment of first touch within a step"
        f" could add: a run shows one such moment and may be lucky. {end} CPU: median of the rounds"
        " (smallest–largest).",
    )


def shown_points(trade: Trade, conclusion: Conclusion) -> list[TradePoint]:
    """Return what stands first: the points of the front whose worst error is at most `NEAR` times its tolerance.

    Of a bed all that ran, from cheap to dear: they are few, and a wide interval says little of a contact.
    """
    if trade.bed:
        return sorted((p for p in trade.points if p.completed), key=lambda p: cost(trade, p) or math.inf)
    by_name = {point.candidate.name: point for point in trade.points}
    return [p for name in conclusion.front if worst_ratio(p := by_name[name], trade.tolerances) <= NEAR]


def point_table(trade: Trade, conclusion: Conclusion, points: Sequence[TradePoint]) -> Table:
    """Return points as a table: what, cost, errors of the judged metrics, signs of softness, verdict."""
    metrics = list(trade.tolerances)
    rows = []
    for point in points:
        c = point.candidate
        reference = point is trade.reference
        chosen = conclusion.chosen is not None and c.name == conclusion.chosen.candidate.name
        name = f"{short(c)} ← chosen" if chosen else short(c)
        ratio = worst_ratio(point, trade.tolerances) if point.completed and point.errors else math.inf
        rows.append(
            (
                name,
                "" if c.factor is None else shown_factor(c.factor),
                quantity(point.k_n, "N/m", 3),
                f"{c.steps_per_contact:g}",
                quantity(point.steps, ""),
                _cpu(point),
                *("" if reference else error_text(point.errors.get(metric)) for metric in metrics),
                "" if ratio == math.inf else f"{ratio:.3g}",
                ", ".join(sign.name for sign in changed(trade, point)),
                "reference" if reference else {"inside": "ok"}.get(found := verdict_of(point, trade.tolerances), found),
            )
        )
    headings = ("contact", "factor", "k_n", "N", "steps", "CPU", *metrics, "worst", "signs", "")
    return Table(headings, tuple(rows), text=(0, len(headings) - 2, len(headings) - 1))


def short(candidate: Candidate) -> str:
    """Return what a contact is, where its factor and N stand beside it."""
    how = {"reference": "reference", "reduced_modulus": ""}.get(candidate.how, candidate.how)
    return f"{model_name(candidate.model)}, {how}".removesuffix(", ")


def _cpu(point: TradePoint) -> str:
    if not point.cpu_seconds:
        return "–"
    low, high = min(point.cpu_seconds), max(point.cpu_seconds)
    factor, unit = si_prefix(high, "s")
    text = f"{factor * float(np.median(point.cpu_seconds)):.3g}"
    text += f" ({factor * low:.3g}–{factor * high:.3g}) {unit}" if len(point.cpu_seconds) > 1 else f" {unit}"
    return text + ("" if point.ran_share == 1.0 else f", {100.0 * point.ran_share:.0f} % run")


def error_text(error: MetricError | None) -> str:
    """Return an error with its uncertainty in percent."""
    if error is None or error.error is None:
        return "–"
    return f"{_share(error.error, error.uncertainty)} %"


def _split_table(trade: Trade, points: Sequence[TradePoint]) -> Table:
    """The split of the judged errors of points."""
    rows = []
    for c in (point.candidate for point in points):
        for split in trade.splits.get(c.name, ()):
            if split.metric in trade.tolerances:
                factor = "" if c.factor is None else shown_factor(c.factor)
                rows.append((short(c), factor, f"{c.steps_per_contact:g}", *_split_cells(split)))
    headings = (
        "contact",
        "factor",
        "N",
        "metric",
        "error",
        "discretisation",
        "softness",
        "model",
        "sum",
        "interaction",
        "not known",
    )
    return Table(headings, tuple(rows), text=(0, 3, 10))


def _split_cells(split: ErrorSplit) -> tuple[str, ...]:
    parts = (split.discretisation, split.softness, split.model)
    known = [part.value for part in parts if part is not None]
    return (
        split.metric,
        _part(split.total),
        *(_part(part) for part in parts),
        f"{100.0 * math.fsum(known):+.3g} %" if known else "–",
        "–" if split.interaction is None else f"{100.0 * split.interaction:+.2g} %",
        ", ".join(split.missing),
    )


def _part(part: Part | None) -> str:
    if part is None:
        return "–"
    if part.value == 0.0 and not part.uncertainty:
        return "0"
    text = f"{_share(part.value, part.uncertainty)} %"
    return text if part.resolved else f"({text})"


def _share(value: float, uncertainty: float | None) -> str:
    if uncertainty is None:
        return f"{100.0 * value:+.3g}"
    return plus_minus(100.0 * value, 100.0 * uncertainty, signed=True)


def _convergence_table(trade: Trade) -> Table | None:
    found = trade.convergence
    if found is None:
        return None
    rows = tuple(
        (metric, *(quantity(value, "", 7) for value in values), _left(found.left.get(metric)))
        for metric, values in found.values.items()
    )
    return Table(("metric", *(f"N = {n:g}" for n in found.steps_per_contact), "left"), rows)


def _left(share: float | None) -> str:
    return "–" if share is None else f"{100.0 * share:.2g} %"
