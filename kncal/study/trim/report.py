"""The files of a trim: trim.json, trim.csv, the trimmed case.toml, and a page with its figures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from kncal.core.errors import RenderError
from kncal.core.files import write_csv, write_json, write_text
from kncal.core.units import quantity
from kncal.report.figures import Figure
from kncal.report.page import Table, page_template
from kncal.scene.case_file import CASE, dump_case
from kncal.study.trim.base import DOES_NOT_APPLY, RECORD, CostChange, PartResult, Trim
from kncal.study.trim.figures import draw_figures
from kncal.study.trim.judgement import change_text

CSV, REPORT = "trim.csv", "report"


def write_trim(found: Trim, out: Path) -> Path:
    """Write everything that a trim found into ``out``; returns the page's path.

    The page needs no network and runs no script; every text in it is escaped.

    Raises
    ------
    RenderError
        If the place of the report is taken by a file or a symbolic link.
    InputError
        If the trimmed scene cannot be written as a case file.
    """
    import pandas as pd

    folder = out / REPORT
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise RenderError(f"{folder}: expected a folder for the report (or nothing yet), not a file or a link")
    folder.mkdir(parents=True, exist_ok=True)
    # first, since it says whose folder this is
    write_json(out / RECORD, found.to_dict())
    write_text(out / CASE, dump_case(found.trimmed))
    rows = csv_rows(found)
    write_csv(out / CSV, pd.DataFrame(rows, columns=list(CSV_UNITS)), CSV_UNITS)
    figures: tuple[Figure, ...] = draw_figures(found, folder)
    page = folder / "index.html"
    write_text(
        page,
        page_template("trim.html.j2").render(
            case=found.case,
            title=found.title,
            model=found.model,
            state="within" if found.without else "open",
            sentences=found.sentences,
            parts=Table(
                ("part", "tried", "verdict", "CPU", "steps", "disk", "largest effect", "of"),
                tuple(_part_row(r) for r in found.results if r.verdict != DOES_NOT_APPLY),
            ),
            reasons=[r.sentence for r in found.results if r.verdict != DOES_NOT_APPLY],
            not_tried=[r.sentence for r in found.results if r.verdict == DOES_NOT_APPLY],
            effects=[(r.part.text, r.part.tried, _effects(r)) for r in found.results if r.effects],
            attempts=[a.sentence for a in found.attempts],
            figures=figures,
            trimmed=dump_case(replace(found.trimmed)),
            trimmed_model=found.trimmed_model,
            files=(f"../{CASE}", f"../{RECORD}", f"../{CSV}"),
        ),
    )
    return page


#: Column of trim.csv -> its unit.
CSV_UNITS = {
    "part": "-",
    "change": "-",
    "verdict": "-",
    "metric": "-",
    "full": "see unit",
    "tried": "see unit",
    "unit": "-",
    "difference": "-",
    "uncertainty": "-",
    "tolerance": "-",
    "effect": "-",
    "cpu": "-",
    "cpu_low": "-",
    "cpu_high": "-",
    "steps": "-",
    "disk": "-",
}


def csv_rows(found: Trim) -> list[dict[str, object]]:
    """Return a row per part and metric (one without a metric for a part that was not run), as in trim.csv."""
    rows: list[dict[str, object]] = []
    for result in found.results:
        first = {"part": result.part.name, "change": result.part.change, "verdict": result.verdict}
        price = _price(result.cost)
        rows += [
            {
                **first,
                "metric": e.metric,
                "full": e.full,
                "tried": e.tried,
                "unit": e.unit,
                "difference": e.change,
                "uncertainty": e.uncertainty,
                "tolerance": e.tolerance,
                "effect": e.verdict,
                **price,
            }
            for e in result.effects
        ] or [{**first, **price}]
    return rows


def _price(cost: CostChange | None) -> dict[str, object]:
    names = ("cpu", "cpu_low", "cpu_high", "steps", "disk")
    return {} if cost is None else {name: getattr(cost, name) for name in names}


def part_row(result: PartResult) -> tuple[str, ...]:
    """Return name, what was tried, verdict, cost of CPU, steps and disk, largest effect and its metric, as text."""
    cost, worst = result.cost, result.worst
    return (
        result.part.name,
        result.part.tried,
        result.verdict,
        "–" if cost is None else _cpu(cost),
        "–" if cost is None else _percent(cost.steps),
        "–" if cost is None else _percent(cost.disk),
        "–" if worst is None else change_text(worst),
        "" if worst is None else worst.metric,
    )


_part_row = part_row


def _percent(share: float) -> str:
    return "0" if share == 0.0 else f"{100.0 * share:+.3g} %"


def _cpu(cost: CostChange) -> str:
    if cost.cpu is None:
        return "–"
    if cost.cpu_low is None or cost.cpu_high is None:
        return f"{100.0 * cost.cpu:+.3g} %"
    return f"{100.0 * cost.cpu:+.3g} % ({100.0 * cost.cpu_low:+.3g} to {100.0 * cost.cpu_high:+.3g})"


def _effects(result: PartResult) -> Table:
    rows: Iterable[tuple[str, ...]] = (
        (
            e.metric,
            quantity(e.full, e.unit),
            quantity(e.tried, e.unit),
            change_text(e),
            "" if e.tolerance is None else f"±{100.0 * e.tolerance:.3g} %",
            "" if e.verdict == "-" else e.verdict,
            e.reason,
        )
        for e in result.effects
    )
    return Table(("", "full", "tried", "change", "allowed", "", "remark"), tuple(rows))
