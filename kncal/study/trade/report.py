"""The page of a trade: the answer, the front, where the errors come from, the law of cost, and every point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kncal import __version__
from kncal.core.errors import RenderError
from kncal.core.files import write_text
from kncal.core.scratch import drawn_aside
from kncal.core.units import quantity, si_prefix
from kncal.report.page import Table, page_template
from kncal.study.trade.answer import describe, sentences, shown_factor
from kncal.study.trade.cost_law import Law
from kncal.study.trade.figures import draw_trade_figures
from kncal.study.trade.front import Conclusion, changed, cost, verdict, worst_ratio
from kncal.study.trade.trade import Candidate, ErrorSplit, MetricError, Part, Trade, TradePoint

#: Points of the front whose worst error is more times its tolerance are not shown with it.
NEAR = 10.0


def write_trade_report(trade: Trade, conclusion: Conclusion, laws: Sequence[Law], folder: Path) -> Path:
    """Write the report into ``folder`` (made if missing, files of an earlier report replaced); return the page.

    It needs no network and runs no script; every text in it is escaped.

    Raises
    ------
    RenderError
        If ``folder`` is a file or a symbolic link.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise RenderError(f"{folder}: expected a folder for the report (or nothing yet), not a file or a link")
    folder.mkdir(parents=True, exist_ok=True)
    with drawn_aside(folder) as drawn:
        figures = draw_trade_figures(trade, conclusion, laws, drawn)
    texts = sentences(trade, conclusion, laws)
    near = shown_points(trade, conclusion)
    page = folder / "index.html"
    write_text(
        page,
        page_template("trade.html.j2").render(
            case=trade.case,
            title=trade.title,
            state="within"
            if conclusion.chosen is not None
            else "outside"
            if conclusion.promising is None
            else "undecided",
            sentences=texts,
            figures=figures,
            front=point_table(trade, conclusion, [trade.reference, *near]),
            far=0 if trade.bed else len(conclusion.front) - len(near),
            limit=f"{NEAR:g}",
            splits=_split_table(trade, near),
            convergence=_convergence_table(trade),
            points=point_table(trade, conclusion, [trade.reference, *trade.points]),
            not_run=[f"{p.candidate.name}: {p.status}: {p.message}" for p in trade.points if not p.completed],
            cost="CPU time" if trade.bed else "number of steps",
            bed=trade.bed,
            reference=describe(trade.reference.candidate),
            provenance={"kncal": {"version": __version__, "wall time": quantity(trade.wall_seconds, "s", 3)}},
            files=("../trade.json", "../trade.csv", *(("../case.toml",) if conclusion.chosen is not None else ())),
        ),
    )
    return page


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
                "reference" if reference else {"inside": "ok"}.get(found := verdict(point, trade.tolerances), found),
            )
        )
    headings = ("contact", "factor", "k_n", "N", "steps", "CPU", *metrics, "worst/tol.", "signs", "")
    return Table(headings, tuple(rows))


def short(candidate: Candidate) -> str:
    """Return what a contact is, where its factor and N stand beside it."""
    kind = {"linear": "linear", "hertz": "Hertz"}[candidate.model]
    how = {"reference": "reference", "reduced_modulus": ""}.get(candidate.how, candidate.how)
    return f"{kind}, {how}".removesuffix(", ")


def _cpu(point: TradePoint) -> str:
    if not point.cpu_seconds:
        return "–"
    low, high = min(point.cpu_seconds), max(point.cpu_seconds)
    factor, unit = si_prefix(float(np.median(point.cpu_seconds)), "s")
    text = f"{factor * float(np.median(point.cpu_seconds)):.3g}"
    text += f" ({factor * low:.3g}–{factor * high:.3g}) {unit}" if len(point.cpu_seconds) > 1 else f" {unit}"
    return text + ("" if point.ran_share == 1.0 else f", {100.0 * point.ran_share:.0f} % run")


def error_text(error: MetricError | None) -> str:
    """Return an error with its uncertainty in percent."""
    if error is None or error.error is None:
        return "–"
    width = "" if error.uncertainty is None else f" ± {100.0 * error.uncertainty:.2g}"
    return f"{100.0 * error.error:+.3g}{width} %"


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
    return Table(headings, tuple(rows))


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
    width = "" if part.uncertainty is None else f" ± {100.0 * part.uncertainty:.2g}"
    return f"{100.0 * part.value:+.3g}{width} %" + ("" if part.resolved else ", not resolved")


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
