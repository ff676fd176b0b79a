"""The report of a comparison: its page, with its figures and its numbers as files beside it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.core.files import write_csv, write_json
from kncal.core.units import percent, quantity
from kncal.observe.compare import Comparison
from kncal.observe.cost import Cost
from kncal.record.series import write_series_csv
from kncal.report.figures import draw_calibration, draw_comparison
from kncal.report.grains import grains_section
from kncal.report.overview import Context
from kncal.report.page import Page, Section, Table, report_folder, write_page
from kncal.report.rows import table_of
from kncal.report.settings import conventions, run_settings
from kncal.report.speeds import speeds_section
from kncal.report.style import Album
from kncal.scene.species import listed

if TYPE_CHECKING:
    import pandas as pd

#: Column of a table -> (heading, unit); a table shows the columns it has, in this order.
_METHODS = {
    "method": ("method", ""),
    "k_n": ("k_n", "N/m"),
    "eta_n": ("η_n", "N s/m"),
    "kappa": ("κ", "–"),
    "t_c": ("t_c", "s"),
    "delta_max": ("δ_max", "m"),
    "delta_mean": ("δ_mean", "m"),
    "warnings": ("warnings", ""),
}
_ACCURACY = {
    "model": ("model", ""),
    "steps_per_contact": ("N", "–"),
    "dt": ("dt", "s"),
    "steps": ("steps", ""),
    "error_e_n": ("error of e_n", "%"),
    "error_t_c": ("of t_c", "%"),
    "error_delta_max": ("of δ_max", "%"),
    "error_delta_mean": ("of δ_mean", "%"),
    "cpu_seconds": ("CPU, as run", "s"),
}
_NEEDS = {"physics": ("physics", ""), "needed": ("used", ""), "why": ("why", ""), "decided_by": ("decided by", "")}
_EXACT = {"ok": "yes", "outside": "no", "-": "–"}
_DIFFERENCE = "Difference: linear minus Hertz, relative to Hertz unless the row says otherwise"
_SEEN = "Difference seen: whether it is larger than its ± (three times that where the ± is not reliable)."


def write_report(
    comparison: Comparison,
    folder: Path,
    *,
    provenance: Mapping[str, Any],
    context: Context | None = None,
    warnings: Sequence[str] = (),
) -> Path:
    """Write the report into ``folder`` (made if missing, files of an earlier report replaced).

    Parameters
    ----------
    comparison : of two runs
    provenance : section -> entries (nested mappings, lists, text, numbers), shown as they are
    context : what puts the calibration in context, if anything does
    warnings : what the limits of the solvers say about the case, one sentence each; those of the contacts are added

    Returns
    -------
    Path
        Of ``index.html``; beside it ``comparison.json``, ``metrics.csv``, the figures as PNG and SVG, and what the
        kind of scene has: ``calibration.csv``, ``speed_accuracy.csv``, the numbers per coupling of each run
        (``linear.csv``, ``hertz.csv``), ``animation.gif``.

    Raises
    ------
    RenderError
        If ``folder`` is a file or a symbolic link.
    """
    scene, context = comparison.reference.model.scene, context or Context()
    accuracy = _with_cost(context.errors, comparison)
    with report_folder(folder) as drawn:
        album = Album(drawn)
        draw_comparison(comparison, album)
        draw_calibration(context.kn_curves, accuracy, album)
        told = tuple(dict.fromkeys((*warnings, *comparison.limits)))
        sections = _sections(comparison, context, accuracy, told, album)
    write_json(
        folder / "comparison.json", {**comparison.to_dict(), "warnings": list(told), "provenance": dict(provenance)}
    )
    tables = {"metrics.csv": comparison.to_frame(), "calibration.csv": context.methods, "speed_accuracy.csv": accuracy}
    tables = {name: table for name, table in tables.items() if len(table)}
    for name, table in tables.items():
        write_csv(folder / name, table, _units(table))
    series = {f"{run.model.kind}.csv": run.signals for run in comparison.runs if run.signals is not None}
    for name, signals in series.items():
        write_series_csv(folder / name, signals)
    source = f" Source: {scene.source}" if scene.source else ""
    page = Page(
        case=scene.name,
        title=scene.title,
        subject="linear spring against Hertz",
        about=f"Case {scene.name}: linear spring–dashpot contact against a Hertz-type contact.{source}",
        verdict=comparison.verdict,
        sections=sections,
        provenance=provenance,
        files=("comparison.json", *tables, *series),
    )
    return write_page(page, folder)


def _sections(
    comparison: Comparison, context: Context, accuracy: pd.DataFrame, warnings: tuple[str, ...], album: Album
) -> tuple[Section, ...]:
    """The sections that the runs have something for; the page leaves out empty ones."""
    rows = table_of(comparison.rows)
    figures = tuple(album.figures)  # those of the speeds stand in their own section
    methods, shared = _split_warnings(context.methods)
    models = (comparison.run.model, comparison.reference.model)
    return (
        Section(
            title="Linear against Hertz",
            table=rows.table,
            remark=_remark(comparison),
            notes=rows.notes,
            parts=(
                Section(title="Not shown by these runs", points=rows.unseen, folded=True),
                Section(title="Cost", table=cost_table(comparison)),
            ),
        ),
        Section(
            title="Can the runs be trusted?",
            table=_invariant_table(comparison),
            remark="The worst value of each whole run, start-up included. The weight balance is that of the averages.",
            parts=(
                Section(title="Limits and warnings", points=warnings),
                Section(
                    title="Each run against its own exact solution",
                    table=_exact_table(comparison),
                    remark="Explained: the deviation is no larger than the error predicted for this time step.",
                    folded=True,
                ),
            ),
        ),
        grains_section(comparison.runs, album),
        Section(title="Figures", figures=figures),
        speeds_section(comparison.runs, album),
        Section(
            title="Linear stiffness by every method",
            table=_frame_table(methods, _METHODS),
            parts=(Section(title="Warnings of every method", points=tuple(shared), folded=True),),
        ),
        Section(
            title="Speed against accuracy",
            table=_frame_table(accuracy, _ACCURACY),
            remark="N: steps per contact, with the same meaning for both models. Errors: predicted, for the worst"
            " moment of first touch within a step.",
        ),
        Section(title="Physics that this case needs", table=_frame_table(context.needs, _NEEDS), folded=True),
        Section(title="How it was run", table=run_settings(*models, comparison.costs)),
        Section(
            title="Conventions",
            text=(*conventions(*models, {row.metric for row in comparison.rows if row.seen}), *_attraction(comparison)),
            folded=True,
        ),
    )


def _remark(comparison: Comparison) -> str:
    """How the table of the rows is to be read."""
    if comparison.run.signals is not None:
        return (
            f"Time averages after the start-up ({_windows(comparison)}); ± half the 95 % confidence interval."
            f" {_DIFFERENCE}; the runs are independent, so their uncertainties add in squares. {_SEEN}"
            " A row is ok if the whole interval of its difference is within the allowed range, outside if the whole"
            " interval is outside, undecided if the runs are too short to tell."
        )
    return (
        f"{_DIFFERENCE}; ± the predicted error of the time step in both runs together. Exact difference: the same for"
        f" the exact solutions, free of any time step. {_SEEN} A row is undecided if ± is too large to tell."
        " Trajectory: distance of the same particle in both runs at equal times, by the"
        f" {comparison.row('trajectory').basis}."
    )


def _windows(comparison: Comparison) -> str:
    texts = [
        f"{d.model.kind}: {seen.begin:.3g} to {float(d.series.t[-1]):.3g} s"
        + {"given": "", "rest": ", at rest"}.get(seen.window.by, f", start-up found in {seen.window.by}")
        for d, seen in ((run, run.seen) for run in comparison.runs)
    ]
    return "; ".join(texts)


def _attraction(comparison: Comparison) -> list[str]:
    """The attraction at the end of a contact, which nearly every damped contact has: each text once, with its pairs."""
    pairs: dict[str, list[str]] = {}
    for run in comparison.runs:
        for pair, contact in run.model.named.items():
            if text := contact.warnings.get("attraction"):
                pairs.setdefault(text, []).append("–".join(pair))
    return [f"{listed(list(dict.fromkeys(names)))}: {text}." for text, names in pairs.items()]


def cost_table(comparison: Comparison) -> Table:
    """Return what the runs cost; what none of them has (particles that move, gas) has no lines."""
    costs, timed = comparison.costs, comparison.speed.cpu is not None
    coupled = any(c.couplings for c in costs)
    totals = [c.total for c in costs]
    rows: list[tuple[str, ...]] = []

    def line(
        name: str, value: Callable[[Cost], float | None], unit: str = "", digits: int = 3, *, ratio: bool = True
    ) -> None:
        values = linear, hertz = [value(cost) for cost in costs]
        texts = [quantity(each, unit, digits) for each in values]
        if coupled and name.startswith("CPU time of"):
            parts = zip(texts, values, totals, strict=True)
            texts = [
                f"{text} ({part / total:.0%})" if part is not None and total else text for text, part, total in parts
            ]
        rows.append((name, *texts, f"{hertz / linear:.3g}" if ratio and linear and hertz is not None else "–"))

    if not coupled or any(c.cpu_seconds for c in costs):
        rows.append(("solver of the contacts", *(f"{c.engine} {c.version}" for c in costs), "–"))
        line("steps", lambda c: c.steps)
        line("time step dt", lambda c: c.dt, "s", 5)
        line("steps per (shortest) contact", lambda c: c.steps_per_contact, "–", 4)
        line("CPU time of the particles", lambda c: c.cpu_seconds, "s", ratio=timed)
        line("CPU time per step", lambda c: c.cpu_per_step, "s", ratio=timed)
    if max(c.runs for c in costs) > 1:
        spread = (f"{quantity(c.cpu_low, 's', 3)} to {quantity(c.cpu_high, 's', 3)}, {c.runs} runs" for c in costs)
        rows.append(("CPU time, smallest to largest", *spread, "–"))
    if coupled:
        with_gas = any(c.has_gas for c in costs)
        line("couplings" if with_gas else "intervals", lambda c: c.couplings)
        if with_gas:
            line("CPU time of the gas", lambda c: c.gas, "s", ratio=timed)
        line(f"CPU time of {'the exchange' if with_gas else 'recording'}", lambda c: c.exchange, "s", ratio=timed)
        line("CPU time, total", lambda c: c.total, "s", ratio=timed)
        line("CPU time per simulated second", lambda c: c.total / c.simulated, "s", ratio=timed)
    line("wall time", lambda c: c.wall_seconds, "s", ratio=coupled)
    return Table(("", "linear", "Hertz", "Hertz / linear"), tuple(rows))


def _exact_table(comparison: Comparison) -> Table:
    rows = tuple(
        (
            r.model,
            r.metric,
            quantity(r.run.value, r.unit),
            quantity(r.reference.value, r.unit),
            percent(r.difference.value),
            "–" if r.difference.width is None else f"±{100.0 * r.difference.width:.2g} %",
            _EXACT[r.verdict],
        )
        for r in comparison.exact
    )
    headings = ("model", "metric", "run", "exact", "deviation", "predicted", "explained")
    return Table(headings, rows, text=(0, 1, 6))


def _invariant_table(comparison: Comparison) -> Table:
    rows = tuple(
        (
            i.name,
            i.text,
            "–" if i.run is None else f"{i.run:.3g}",
            "–" if i.reference is None else f"{i.reference:.3g}",
            f"{'more than' if i.at_least else 'at most'} {i.limit:g}",
            "ok" if i.holds else "outside",
        )
        for i in comparison.invariants
        if not (i.holds and i.run is i.reference is None)
    )
    return Table(("", "", "linear", "Hertz", "limit", ""), rows, text=(0, 1, 5))


def _split_warnings(table: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """The table with only each method's own warnings, and the warnings that all methods share."""
    if "warnings" not in table.columns or not len(table):
        return table, []
    # between warnings, not inside the parentheses of one
    lists = [re.split(r";\s(?![^(]*\))", text) if text else [] for text in table["warnings"].fillna("")]
    shared = [text for text in lists[0] if all(text in other for other in lists)] if len(lists) > 1 else []
    own = ["; ".join(t for t in texts if t not in shared) for texts in lists]
    if not any(own):
        return table.drop(columns="warnings"), shared
    return table.assign(warnings=own), shared


def _with_cost(error_table: pd.DataFrame, comparison: Comparison) -> pd.DataFrame:
    """The speed–accuracy table with the CPU time of the runs that were made; NaN where none was."""
    table = error_table.copy()
    if not len(table):
        return table
    cpu = {cost.model: cost.cpu_seconds for cost in comparison.costs}
    table["cpu_seconds"] = table["model"].map(cpu).where(table["run"].astype(bool))
    return table


def _units(frame: pd.DataFrame) -> dict[str, str]:
    """Unit of every column of a table, "-" for text and numbers without one."""
    # reference_t_c is the t_c of the reference contact
    known = {name: unit for name, (_, unit) in {**_METHODS, **_ACCURACY}.items() if unit not in ("", "–", "%")}
    known |= {"v_0": "m/s", "delta_end": "m", **{f"reference_{name}": unit for name, unit in known.items()}}
    runs = ("run", "run_width", "reference", "reference_width")
    known |= {"needed_end": "s", **dict.fromkeys(runs, "see unit")}
    return {str(name): known.get(str(name), "-") for name in frame.columns}


def _frame_table(frame: pd.DataFrame, columns: Mapping[str, tuple[str, str]]) -> Table:
    shown = [name for name in columns if name in frame.columns]
    rows = tuple(
        tuple(_cell(value, columns[name][1]) for name, value in zip(shown, row, strict=True))
        for row in frame[shown].itertuples(index=False, name=None)
    )
    words = [i for i, name in enumerate(shown) if columns[name][1] == "" and name != "steps"]
    return Table(tuple(columns[name][0] for name in shown), rows, text=tuple(words))


def _cell(value: Any, unit: str) -> str:
    if value is None or isinstance(value, str):
        return value or ""
    if isinstance(value, int | np.integer):
        return quantity(int(value), unit)
    return quantity(float(value), unit, 4)
