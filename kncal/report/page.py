"""The report of a comparison: a page that opens from disk, with its figures and its numbers as files."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.core.errors import RenderError
from kncal.core.files import write_csv, write_json, write_text
from kncal.core.scratch import drawn_aside
from kncal.core.templating import Page
from kncal.core.units import percent, quantity
from kncal.observe.compare import Comparison
from kncal.observe.row import allowed, difference_text
from kncal.observe.run_data import RunData
from kncal.physics.methods import METHODS
from kncal.report.figures import draw_figures
from kncal.scene.scene import ContactChoice

if TYPE_CHECKING:
    import pandas as pd

#: Column of a table -> (heading, unit); a table shows the columns it has, in this order.
_CALIBRATION = {
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
_NEEDS = {
    "physics": ("physics", ""),
    "needed": ("used", ""),
    "why": ("why", ""),
    "decided_by": ("decided by", ""),
}

#: Contact end -> what it means.
CONTACT_ENDS = {
    "overlap": "Contact end: the overlap is back at zero. Restitution and duration count to that moment, and"
    " a damped contact may pull shortly before it.",
    "force": "Contact end: the normal force is back at zero. Attraction is cut off, and restitution and"
    " duration of the calibration count to that moment.",
}


@dataclass(frozen=True)
class Table:
    """A table as the page shows it: headings, and rows of cells that are text already."""

    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def write_report(
    comparison: Comparison[RunData],
    folder: Path,
    *,
    calibration_table: pd.DataFrame,
    kn_curves: Mapping[str, Any],
    error_table: pd.DataFrame,
    needs_table: pd.DataFrame,
    provenance: Mapping[str, Any],
) -> Path:
    """Write the report into ``folder`` (made if missing, files of an earlier report replaced).

    The page needs no network and runs no script: a Content-Security-Policy forbids both, and every text in
    it is escaped.

    Parameters
    ----------
    comparison : Comparison
    calibration_table : all methods with their warnings, as by `kncal.report.overview.method_table`; may be empty
    kn_curves : as `kncal.report.overview.kn_curves` gives them; may be empty
    error_table : as `kncal.report.overview.error_table` gives it; may be empty. The runs' CPU time is added here.
    needs_table : columns physics, needed, why, decided_by; may be empty
    provenance : section -> entries (nested mappings, lists, text, numbers), shown as they are

    Returns
    -------
    Path
        Of ``index.html``; beside it ``comparison.json``, ``metrics.csv``, ``calibration.csv``,
        ``speed_accuracy.csv`` and the figures as PNG and SVG.

    Raises
    ------
    RenderError
        If ``folder`` is a file or a symbolic link.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise RenderError(f"{folder}: expected a folder for the report (or nothing yet), not a file or a link")
    folder.mkdir(parents=True, exist_ok=True)
    accuracy = _with_cost(error_table, comparison)
    # drawn aside and moved, so that each is whole and no link in the folder is followed
    with drawn_aside(folder) as drawn:
        figures = draw_figures(comparison, kn_curves, accuracy, drawn)
    write_json(folder / "comparison.json", {**comparison.to_dict(), "provenance": dict(provenance)})
    files = ["comparison.json"]
    for name, frame in (
        ("metrics.csv", comparison.to_frame()),
        ("calibration.csv", calibration_table),
        ("speed_accuracy.csv", accuracy),
    ):
        if len(frame):
            write_csv(folder / name, frame, _units(frame))
            files.append(name)
    scene = comparison.reference.model.scene
    methods, shared_warnings = _split_warnings(calibration_table)
    page = folder / "index.html"
    write_text(
        page,
        page_template("index.html.j2").render(
            case=scene.name,
            title=scene.title,
            source=scene.source,
            state=comparison.state,
            sentences=comparison.verdict.all,
            metrics=_metric_table(comparison),
            trajectory_basis=comparison.row("trajectory").basis,
            exact=_exact_table(comparison),
            costs=_cost_table(comparison),
            warnings=_warnings(comparison),
            figures=figures,
            calibration=_table(methods, _CALIBRATION),
            shared_warnings=shared_warnings,
            accuracy=_table(accuracy, _ACCURACY),
            needs=_table(needs_table, _NEEDS),
            contact_end=CONTACT_ENDS[scene.contact.end],
            method=_method(scene.contact),
            provenance=provenance,
            files=files,
        ),
    )
    return page


def page_template(name: str) -> Page:
    """Return a page of ``templates/report`` as a template that escapes every text it is given."""
    return Page(name)


def _metric_table(comparison: Comparison[RunData]) -> Table:
    rows = []
    for r in comparison.rows:
        remark = r.reason
        if r.basis.startswith("absolute"):
            remark = "; ".join(filter(None, (r.reason, f"difference {r.basis}")))
        rows.append(
            (
                r.metric,
                "; ".join(filter(None, (r.text, remark))),
                quantity(r.run.value, r.unit),
                quantity(r.reference.value, r.unit),
                difference_text(r),
                percent(r.exact_difference),
                "" if r.tolerance is None else allowed(r.tolerance),
                "" if r.verdict == "-" else r.verdict,
            )
        )
    headings = ("metric", "", "linear", "Hertz", "difference ± step error", "exact difference", "allowed", "")
    return Table(headings, tuple(rows))


def _exact_table(comparison: Comparison[RunData]) -> Table:
    explained = {"ok": "yes", "outside": "no", "-": "–"}
    rows = tuple(
        (
            r.model,
            r.metric,
            quantity(r.run.value, r.unit),
            quantity(r.reference.value, r.unit),
            percent(r.difference.value),
            "–" if r.difference.width is None else f"±{100.0 * r.difference.width:.2g} %",
            explained[r.verdict],
        )
        for r in comparison.exact
    )
    return Table(("model", "metric", "run", "exact", "deviation", "predicted", "explained by the step"), rows)


def _cost_table(comparison: Comparison[RunData]) -> Table:
    linear, hertz = comparison.costs
    rows = [
        ("solver", *(f"{c.engine} {c.version}" for c in (linear, hertz))),
        ("steps", *(quantity(c.steps, "") for c in (linear, hertz))),
        ("time step dt", *(quantity(c.dt, "s") for c in (linear, hertz))),
        ("steps per (shortest) contact", *(quantity(c.steps_per_contact, "–", 4) for c in (linear, hertz))),
        ("CPU time", *(quantity(c.cpu_seconds, "s", 3) for c in (linear, hertz))),
        ("CPU time per step", *(quantity(c.cpu_per_step, "s", 3) for c in (linear, hertz))),
        ("wall time", *(quantity(c.wall_seconds, "s", 3) for c in (linear, hertz))),
    ]
    if max(linear.runs, hertz.runs) > 1:
        spread = (f"{quantity(c.cpu_low, 's', 3)} to {quantity(c.cpu_high, 's', 3)}" for c in (linear, hertz))
        rows.insert(5, ("CPU time, smallest to largest", *spread))
        rows.insert(6, ("runs timed", *(str(c.runs) for c in (linear, hertz))))
    return Table(("", "linear", "Hertz"), tuple(rows))


def _warnings(comparison: Comparison[RunData]) -> list[str]:
    """What the calibration says about the pairs that met."""
    return [text for _, text in comparison.limits]


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


def _method(contact: ContactChoice) -> dict[str, str] | None:
    """What the method keeps and loses; None where the case prescribes k_n."""
    if contact.k_n is not None:
        return None
    method = METHODS.find(contact.method)
    return {name: getattr(method, name) for name in ("name", "title", "source", "keeps", "loses", "avoid")}


def _with_cost(error_table: pd.DataFrame, comparison: Comparison[RunData]) -> pd.DataFrame:
    """The speed–accuracy table with the CPU time of the runs that were made; NaN where none was."""
    table = error_table.copy()
    if not len(table):
        return table
    cpu = {cost.model: cost.cpu_seconds for cost in comparison.costs}
    table["cpu_seconds"] = table["model"].map(cpu).where(table["run"].astype(bool))
    return table


def _units(frame: pd.DataFrame) -> dict[str, str]:
    """Unit of every column of a table, "-" for text and numbers without one."""
    shown = {**_CALIBRATION, **_ACCURACY}
    # reference_t_c is the t_c of the reference contact
    known = {name: unit for name, (_, unit) in shown.items() if unit not in ("", "–", "%")}
    known |= {"v_0": "m/s", "delta_end": "m", **{f"reference_{name}": unit for name, unit in known.items()}}
    return {str(name): known.get(str(name), "-") for name in frame.columns}


def _table(frame: pd.DataFrame, columns: Mapping[str, tuple[str, str]]) -> Table:
    shown = [name for name in columns if name in frame.columns]
    rows = tuple(
        tuple(_cell(value, columns[name][1]) for name, value in zip(shown, row, strict=True))
        for row in frame[shown].itertuples(index=False, name=None)
    )
    return Table(tuple(columns[name][0] for name in shown), rows)


def _cell(value: Any, unit: str) -> str:
    if value is None or isinstance(value, str):
        return value or ""
    if isinstance(value, int | np.integer):
        return quantity(int(value), unit)
    return quantity(float(value), unit, 4)
