"""The page of a trade: the answer, the front, where the errors come from, the law of cost, and every point."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from kncal import __version__
from kncal.core.units import percent, plus_minus, quantity, si_prefix
from kncal.observe.estimate import Estimate
from kncal.observe.row import deciding_text
from kncal.report.page import Page, Section, Table, report_folder, write_page
from kncal.study.trade.answer import answer, contact_text, describe
from kncal.study.trade.cost_law import Law
from kncal.study.trade.figures import draw_trade_figures
from kncal.study.trade.front import Conclusion, changed, cost, reach, worst_ratio
from kncal.study.trade.front import verdict as verdict_of
from kncal.study.trade.trade import Candidate, ErrorSplit, Trade, TradePoint

#: Points of the front whose worst error is more times its tolerance are not shown with it.
NEAR = 10.0
_SHOWN = (
    "No other point has both a smaller number of steps and a smaller worst error over tolerance, uncertainty included."
)
_SHOWN_ESTIMATED = (
    "From cheap to dear. A share run is the part of the case's time that was simulated; CPU times are extrapolated to"
    " the whole time."
)
_COLUMNS = (
    "N: steps per contact, with the same meaning for every contact. Errors are relative to the reference; ± is {}."
    " Worst: the largest (|error| + uncertainty)/tolerance. A point is inside only if its whole interval is."
    " CPU: median of the rounds, or of the parts of a run (smallest–largest)."
)
_WIDTH = (
    "the remaining error of the reference and what another moment of first touch within a step could add (a run shows"
    " one such moment and may be lucky)"
)
_WIDTH_ESTIMATED = "the 95 % interval of the difference of the two averages"
_SPLIT = (
    "Each part is measured by changing one thing. Discretisation: this contact at its N against the same contact at the"
    " N of the reference. Softness: this contact against the unsoftened one of the same model. Model: the unsoftened"
    " linear contact against the reference. For numbers the parts add up exactly; for distances of paths they need not:"
    " what is left over is called interaction."
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
    lost = tuple(f"{p.candidate.name}: {p.status}: {p.message}" for p in trade.points if not p.completed)
    about = "what a softer or coarser contact saves, and what it costs in accuracy"
    page = Page(
        case=trade.case,
        title=trade.title,
        subject="speed for accuracy",
        about=f"Case {trade.case}: {about}. Reference: {describe(trade.reference.candidate)}.",
        verdict=answer(trade, conclusion, laws),
        sections=(
            Section(title="Cost against error", figures=figures),
            Section(
                title=shown_title(trade),
                text=(_SHOWN_ESTIMATED if trade.estimated else _SHOWN + _left_out(conclusion, near),),
                table=point_table(trade, conclusion, [trade.reference, *near]),
                remark=_COLUMNS.format(_WIDTH_ESTIMATED if trade.estimated else _WIDTH),
            ),
            Section(
                title="Where the errors come from",
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


def shown_title(trade: Trade) -> str:
    """Return what `shown_points` are."""
    return "Contacts that ran" if trade.estimated else "Pareto front"


def shown_points(trade: Trade, conclusion: Conclusion) -> list[TradePoint]:
    """Return what stands first: the points of the front whose worst error is at most `NEAR` times its tolerance.

    Where errors are estimated all that ran, from cheap to dear: they are few, and a wide interval says little of a
    contact.
    """
    if trade.estimated:
        return sorted((p for p in trade.points if p.completed), key=lambda p: cost(trade, p) or math.inf)
    by_name = {point.candidate.name: point for point in trade.points}
    return [p for name in conclusion.front if worst_ratio(p := by_name[name]) <= NEAR]


def _left_out(conclusion: Conclusion, near: Sequence[TradePoint]) -> str:
    far = len(conclusion.front) - len(near)
    return f" {far} more points of the front are cheaper, and more than {NEAR:g} times outside." if far else ""


def point_table(trade: Trade, conclusion: Conclusion, points: Sequence[TradePoint], *, brief: bool = False) -> Table:
    """Return points as a table: what, cost, errors of the judged metrics, signs of softness, verdict.

    ``brief``: one cost, and of the errors the one that reaches farthest in its tolerance.
    """

    def worst(p: TradePoint) -> str:
        return max(p.judged, key=partial(reach, p), default="")

    def error(p: TradePoint, metric: str) -> str:
        return deciding_text(p.errors[metric]) if metric in p.errors else "–"

    ratio = {p.candidate.name: worst_ratio(p) for p in points}
    columns: dict[str, Callable[[TradePoint], str]] = {
        "contact": lambda p: contact_text(p.candidate),
        "k_n": lambda p: quantity(p.k_n, "N/m", 3),
        "N": lambda p: f"{p.candidate.steps_per_contact:g}",
        "steps": lambda p: quantity(p.steps, ""),
        "CPU": _cpu,
        **{metric: partial(error, metric=metric) for metric in trade.tolerances},
        "worst": lambda p: "" if (r := ratio[p.candidate.name]) == math.inf else f"{r:.3g}",
        "signs": lambda p: ", ".join(sign.name for sign in changed(trade, p)),
        "worst error": lambda p: error(p, worst(p)),
        "of": worst,
        "verdict": partial(_verdict, trade, conclusion),
    }
    paid = {"steps": "steps", "cpu_seconds": "CPU"}[trade.cost]
    few = ("contact", "k_n", "N", paid, "worst error", "of", "verdict")
    shown = few if brief else [name for name in columns if name not in ("worst error", "of")]
    return Table.of(points, {name: columns[name] for name in shown}, ("contact", "signs", "of", "verdict"))


def _verdict(trade: Trade, conclusion: Conclusion, point: TradePoint) -> str:
    if point is trade.reference:
        return "reference"
    return "← chosen" if point is conclusion.chosen else verdict_of(point)


def _cpu(point: TradePoint) -> str:
    if not point.cpu_seconds:
        return "–"
    low, high = min(point.cpu_seconds), max(point.cpu_seconds)
    factor, unit = si_prefix(high, "s")
    text = f"{factor * float(np.median(point.cpu_seconds)):.3g}"
    text += f" ({factor * low:.3g}–{factor * high:.3g}) {unit}" if len(point.cpu_seconds) > 1 else f" {unit}"
    return text + ("" if point.ran_share == 1.0 else f", {100.0 * point.ran_share:.0f} % run")


def _split_table(trade: Trade, points: Sequence[TradePoint]) -> Table:
    """The split of the judged errors of points."""
    splits = [(p.candidate, split) for p in points for split in trade.splits.get(p.candidate.name, ())]
    names = ("discretisation", "softness", "model")
    columns: dict[str, Callable[[tuple[Candidate, ErrorSplit]], str]] = {
        "contact": lambda of: contact_text(of[0]),
        "N": lambda of: f"{of[0].steps_per_contact:g}",
        "metric": lambda of: of[1].metric,
        "error": lambda of: _part(of[1].total),
        **{name: partial(_named_part, name) for name in names},
        "interaction": lambda of: percent(of[1].interaction),
        "not known": lambda of: ", ".join(of[1].missing),
    }
    judged = [(candidate, split) for candidate, split in splits if split.metric in trade.tolerances]
    return Table.of(judged, columns, ("contact", "metric", "not known"))


def _named_part(name: str, of: tuple[Candidate, ErrorSplit]) -> str:
    return _part(of[1].parts[name])


def _part(part: Estimate | None) -> str:
    if part is None or part.value is None:
        return "–"
    if part.value == 0.0 and not part.width:
        return "0"
    width = 100.0 * (part.width or 0.0)
    text = f"{plus_minus(100.0 * part.value, width, signed=True)} %" if width else percent(part.value)
    return text if part.significant else f"({text})"


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
