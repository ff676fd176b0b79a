"""The table of a sweep: one row per run and model, with the values that the run was given and what came of it.

What a completed run's numbers are is kept in ``row.json`` in its folder, tied to its results by their SHA-256 and to
the version of kncal that made them.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from kncal import __version__
from kncal.core.errors import InputError, KncalError, ReadError
from kncal.core.files import MAX_JSON_BYTES, csv_text, replacing, sha256, write_text
from kncal.core.records import Record, Sha256, read_record
from kncal.record.outcome import RunResult
from kncal.runs.folder import ROW, read_result
from kncal.runs.records import RESULT
from kncal.scene.case_text import toml_value
from kncal.study.design import Sweep, keys_of, read_design, run_folder
from kncal.study.states import WAITING, failure_class, read_states, state_of

if TYPE_CHECKING:
    import pandas as pd

    from kncal.observe.compare import Comparison
    from kncal.observe.run_data import RunData

CSV, PARQUET = "sweep.csv", "sweep.parquet"
#: Columns behind the values of a run and its model, in this order; metrics, uncertainties, differences follow.
_FIXED = ("status", "class", "message", "cpu_seconds", "wall_seconds", "dt", "steps", "verdict")

Row = dict[str, Any]


class _Rows(Record):
    kncal: str
    results: dict[str, Sha256]
    rows: list[dict[Annotated[str, Field(max_length=200)], str | int | float | bool | None]]


def ended_rows(sweep: Sweep, folder: Path, run: str) -> list[Row]:
    """Return the rows of a run that has ended, one per model of the sweep, from its folder.

    A model that has no result was not run, because the one before it did not complete.

    Raises
    ------
    ReadError
        If a result cannot be read.
    """
    out = run_folder(folder, run)
    digests = _digests(sweep, out)
    if (kept := _kept(out, digests)) is not None:
        return kept
    results = {kind: read_result(out / kind) for kind in digests}
    rows = [_row(run, kind, results.get(kind)) for kind in sweep.models]
    if not all(row["status"] == "completed" for row in rows) or _add_numbers(out, rows):
        _keep(out, digests, rows)
    return rows


def failed_rows(sweep: Sweep, run: str, status: str, failure: str, message: str) -> list[Row]:
    """Return the rows of a run that left no result: an error before the solver started, or it was not run yet."""
    return [{"id": run, "model": kind, "status": status, "class": failure, "message": message} for kind in sweep.models]


def _row(run: str, kind: str, result: RunResult | None) -> Row:
    if result is None:
        message = "the model before it did not complete"
        return {"id": run, "model": kind, "status": "not_run", "class": "", "message": message}
    return {
        "id": run,
        "model": kind,
        "status": result.status,
        "class": failure_class(result.status, result.failure),
        "message": result.message,
        "cpu_seconds": result.cpu_seconds,
        "wall_seconds": result.wall_seconds,
        "dt": result.dt,
        "steps": result.steps,
    }


def _add_numbers(out: Path, rows: list[Row]) -> bool:
    """Add metrics and comparison; where they cannot be had, the message says why and False is returned."""
    by_kind = {row["model"]: row for row in rows}
    try:
        _numbers(out, by_kind)
    except KncalError as error:
        for row in rows:
            row["message"] = f"no numbers: {error}"
        return False
    return True


def _numbers(out: Path, rows: Mapping[str, Row]) -> None:
    from kncal.observe.compare import compare
    from kncal.runs.workflow import load

    runs: dict[str, Any] = {kind: load(out / kind) for kind in rows}
    for kind, data in runs.items():
        rows[kind] |= _metrics(data)
    if len(runs) == 2:
        rows["linear"] |= _differences(compare(runs["linear"], runs["hertz"]))


def _metrics(run: RunData) -> Row:
    values = {name: found.value for name, found in run.estimates.items()}
    return _finite(values | {f"uncertainty.{name}": found.width for name, found in run.estimates.items()})


def _differences(comparison: Comparison) -> Row:
    found = {row.metric: row.difference for row in comparison.rows}
    values = {f"difference.{name}": each.value for name, each in found.items()}
    values |= {f"difference_uncertainty.{name}": each.width for name, each in found.items()}
    return {"verdict": comparison.state, **_finite(values)}


def _finite(values: Mapping[str, float | None]) -> Row:
    return {name: float(value) for name, value in values.items() if value is not None and math.isfinite(value)}


def _digests(sweep: Sweep, out: Path) -> dict[str, str]:
    """Return model -> SHA-256 of its ``result.json``, of those that have one."""
    digests: dict[str, str] = {}
    for kind in sweep.models:
        if (out / kind / RESULT).exists():
            digests[kind] = sha256(out / kind / RESULT, MAX_JSON_BYTES)
    if not digests:
        raise ReadError(f"{out}: no {RESULT}, so this run has not ended")
    return digests


def _kept(out: Path, digests: Mapping[str, str]) -> list[Row] | None:
    """Return the rows that this kncal kept in the run's folder, None if there are none of these very results."""
    try:
        found = read_record(_Rows, out / ROW)
    except ReadError:
        return None  # made anew from the results
    ours = found.kncal == __version__ and found.results == digests
    return [dict(row) for row in found.rows] if ours else None


def _keep(out: Path, digests: Mapping[str, str], rows: list[Row]) -> None:
    """Keep the rows beside the results. Not brought to the disk: a lost or torn file is made again."""
    text = json.dumps({"kncal": __version__, "results": digests, "rows": rows})
    # read-only or full: the rows are made anew each time
    with contextlib.suppress(OSError), replacing(out / ROW, durable=False) as file:
        file.write(text.encode("ascii"))


def read_sweep(folder: str | Path) -> pd.DataFrame:
    """Return the table of a sweep as its run folders say now, also while it runs or after it was stopped.

    Returns
    -------
    pandas.DataFrame
        One row per run and model: ``id``, one column per varied key, ``model``, ``status`` ("waiting": no result
        yet), ``class`` and ``message`` of a failure, ``cpu_seconds`` and ``wall_seconds`` [s], ``dt`` [s], ``steps``,
        ``verdict``, and the metrics in SI units. In the row of the linear model of a run with both:
        ``difference.<metric>``, linear against Hertz [-]. Of beds also ``uncertainty.<metric>``, the half-width of
        the 95 % confidence interval, and ``difference_uncertainty.<metric>``.

    Raises
    ------
    ReadError
        If the folder is not that of a sweep.
    """
    folder = Path(folder)
    sweep = read_design(folder)
    known = read_states(folder)
    rows: dict[str, list[Row]] = {}
    for run in sweep.runs:
        state = state_of(sweep, run_folder(folder, run), known.get(run))
        if state["stamps"]:
            try:
                rows[run] = ended_rows(sweep, folder, run)
                continue
            except ReadError as error:
                state |= {"status": "failed", "class": "damaged-result", "message": str(error)}
        if state["class"]:
            rows[run] = failed_rows(sweep, run, state["status"], state["class"], state["message"])
    return frame(sweep, rows)


def frame(sweep: Sweep, rows: Mapping[str, Sequence[Row]]) -> pd.DataFrame:
    """Return the table of `read_sweep` from the rows of the runs that have some; the others are waiting."""
    import pandas as pd

    keys = keys_of(sweep)
    data: list[Row] = []
    names: dict[str, None] = {}
    for run in sweep.runs:
        values = {key: _cell(value) for key, value in sweep.values(run).items()}
        for row in rows.get(run) or failed_rows(sweep, run, WAITING, "", ""):
            data.append({**row, **values})
            names |= dict.fromkeys(row)
    fixed = [name for name in _FIXED if name in names]
    rest = [name for name in names if name not in {"id", "model", *fixed}]
    rest.sort(key=lambda name: name.startswith(("difference.", "difference_", "uncertainty.")))  # the metrics first
    return pd.DataFrame(data, columns=["id", *keys, "model", *fixed, *rest])


def write_table(folder: Path, table: pd.DataFrame) -> Path:
    """Write ``sweep.csv`` (whole or not at all) and return its path."""
    text = table.assign(message=[" ".join(str(m).split()) for m in table["message"]])
    write_text(folder / CSV, csv_text(text))
    return folder / CSV


def write_parquet(folder: Path, table: pd.DataFrame) -> Path:
    """Write ``sweep.parquet`` (whole or not at all) and return its path.

    Raises
    ------
    InputError
        If the extra that can is not installed.
    """
    check_parquet()
    with replacing(folder / PARQUET) as file:
        file.write(_uniform(table).to_parquet(None, engine="pyarrow", index=False))
    return folder / PARQUET


def check_parquet() -> None:
    """Raise `InputError` if no Parquet can be written here."""
    if importlib.util.find_spec("pyarrow") is None:
        raise InputError("--parquet needs pyarrow, which is not installed: pip install 'kncal[parquet]'")


def _uniform(table: pd.DataFrame) -> pd.DataFrame:
    """Return the table with columns of mixed kinds as text: Parquet has one type per column."""
    mixed = [
        name
        for name in table.columns
        if table[name].dtype == object and len({type(value) for value in table[name].dropna()}) > 1
    ]
    return table.assign(**{name: table[name].map(lambda v: v if v is None else str(v)) for name in mixed})


def _cell(value: Any) -> Any:
    """Return a value of the case as a cell: numbers, truth values and text as they are, the rest as TOML writes it."""
    if isinstance(value, bool | int | float | str):
        return value
    return toml_value(value) if isinstance(value, list) else str(value)
