"""The files of a trim: trim.json, trim.csv, the trimmed case.toml, and a page with its figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from kncal.core.files import write_csv, write_json
from kncal.core.units import quantity
from kncal.observe.row import Row, allowed
from kncal.report.page import Page, Section, Table, report_folder, write_page
from kncal.scene.case_file import CASE, dump_case, write_case
from kncal.study.trim.figures import draw_figures
from kncal.study.trim.judgement import change_text
from kncal.study.trim.trim import DOES_NOT_APPLY, RECORD, CostChange, PartResult, Trim

CSV, REPORT = "trim.csv", "report"


def write_trim(found: Trim, out: Path) -> Path:
    """Write everything that a trim found into ``out``; returns the page's path.

    Raises
    ------
    RenderError
        If the place of the report is taken by a file or a symbolic link.
    InputError
        If the trimmed scene cannot be written as a case file.
    """
    import pandas as pd

    with report_folder(out / REPORT) as drawn:
        # first, since it says whose folder this is
        write_json(out / RECORD, found.to_dict())
        figures = draw_figures(found, drawn)
    write_case(found.trimmed, out / CASE)
    rows = csv_rows(found)
    write_csv(out / CSV, pd.DataFrame(rows, columns=list(CSV_UNITS)), CSV_UNITS)
    tried = [r for r in found.results if r.verdict != DOES_NOT_APPLY]
    left = tuple(r.sentence for r in found.results if r.verdict == DOES_NOT_APPLY)
    page = Page(
        case=found.case,
        title=found.title,
        subject="what it can do without",
        about=f"Case {found.case}, {found.model} contact: what the scene can do without. Each optional part of its"
        " physics was left out (or added, if the scene has it not), one at a time; then all that may go at once.",
        verdict=found.verdict,
        sections=(
            Section(
                title="Part by part",
                table=part_table(found),
                remark=_PARTS,
                parts=(
                    Section(title="Each part in words", points=tuple(r.sentence for r in tried), folded=True),
                    Section(title="Not tried", points=left, folded=True),
                ),
            ),
            Section(title="Figures", figures=figures),
            Section(title="All at once", points=tuple(a.sentence for a in found.attempts)),
            Section(
                title="The trimmed case",
                text=(f"Run it with --model {found.trimmed_model}, or compare both models.",),
                code=dump_case(found.trimmed),
                folded=True,
            ),
            Section(
                title="Every metric",
                parts=tuple(
                    Section(
                        title=f"{r.part.text}: {r.part.tried}",
                        table=Table.of(r.effects, _EFFECT_COLUMNS, ("metric", "verdict", "remark")),
                    )
                    for r in found.results
                    if r.effects
                ),
                folded=True,
            ),
        ),
        files=(f"../{CASE}", f"../{RECORD}", f"../{CSV}"),
    )
    return write_page(page, out / REPORT)


_PARTS = (
    "Cost: of having the part, relative to the scene without it (if the scene has it not: of adding it). Effect: the"
    " changed scene minus the full one, relative to the full one; shown is the metric that uses most of its limit. ± is"
    " the discretisation error of both runs for single contacts, the 95 % confidence interval for beds; 0 means equal"
    " to the last bit."
)


#: Column of trim.csv -> its unit.
CSV_UNITS = dict.fromkeys(
    ("part", "change", "verdict", "metric", "full", "tried", "unit", "difference", "uncertainty", "tolerance", "effect",
     "cpu", "cpu_low", "cpu_high", "steps", "disk"),
    "-",
) | {"full": "see unit", "tried": "see unit"}  # fmt: skip


def csv_rows(found: Trim) -> list[dict[str, object]]:
    """Return a row per part and metric (one without a metric for a part that was not run), as in trim.csv."""
    rows: list[dict[str, object]] = []
    for result in found.results:
        first = {"part": result.part.name, "change": result.part.change, "verdict": result.verdict}
        price = _price(result.cost)
        rows += [
            {
                **first,
                "metric": row.metric,
                "full": row.reference.value,
                "tried": row.run.value,
                "unit": row.unit,
                "difference": row.difference.value,
                "uncertainty": row.difference.deciding,
                "tolerance": row.tolerance,
                "effect": row.verdict,
                **price,
            }
            for row in result.effects
        ] or [{**first, **price}]
    return rows


def _price(cost: CostChange | None) -> dict[str, object]:
    names = ("cpu", "cpu_low", "cpu_high", "steps", "disk")
    return {} if cost is None else {name: getattr(cost, name) for name in names}


_PART_COLUMNS: Mapping[str, Callable[[PartResult], str]] = {
    "part": lambda r: r.part.name,
    "tried": lambda r: r.part.tried,
    "verdict": lambda r: r.verdict,
    "CPU": lambda r: "–" if r.cost is None else _cpu(r.cost),
    "steps": lambda r: "–" if r.cost is None else _percent(r.cost.steps),
    "disk": lambda r: "–" if r.cost is None else _percent(r.cost.disk),
    "largest effect": lambda r: "–" if r.worst is None else change_text(r.worst),
    "of": lambda r: "" if r.worst is None else r.worst.metric,
}
_EFFECT_COLUMNS: Mapping[str, Callable[[Row], str]] = {
    "metric": lambda row: row.metric,
    "full": lambda row: quantity(row.reference.value, row.unit),
    "tried": lambda row: quantity(row.run.value, row.unit),
    "change": change_text,
    "allowed": lambda row: "" if row.tolerance is None else allowed(row.tolerance),
    "verdict": lambda row: "" if row.verdict == "-" else row.verdict,
    "remark": lambda row: row.reason,
}


def part_table(found: Trim) -> Table:
    """Return the parts that were tried: what, verdict, cost in CPU, steps and disk, largest effect and its metric."""
    tried = [r for r in found.results if r.verdict != DOES_NOT_APPLY]
    return Table.of(tried, _PART_COLUMNS, ("part", "tried", "verdict", "of"))


def _percent(share: float) -> str:
    return "0" if share == 0.0 else f"{100.0 * share:+.3g} %"


def _cpu(cost: CostChange) -> str:
    if cost.cpu is None:
        return "–"
    if cost.cpu_low is None or cost.cpu_high is None:
        return f"{100.0 * cost.cpu:+.3g} %"
    return f"{100.0 * cost.cpu:+.3g} % ({100.0 * cost.cpu_low:+.3g} to {100.0 * cost.cpu_high:+.3g})"
