"""The table of a sweep: one row per run and model, with the values that the run was given and what came of it."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kncal.core.errors import InputError, ReadError
from kncal.core.scratch import replacing
from kncal.core.tables import csv_text, write_text
from kncal.scene.case_text import toml_value
from kncal.study.design import Sweep, keys_of, read_design, run_folder
from kncal.study.rows import Row, ended_rows, failed_rows
from kncal.study.states import WAITING, read_states, state_of

if TYPE_CHECKING:
    import pandas as pd

CSV, PARQUET = "sweep.csv", "sweep.parquet"
#: Columns behind the values of a run and its model, in this order; metrics, uncertainties, differences follow.
_FIXED = ("status", "class", "message", "cpu_seconds", "wall_seconds", "dt", "steps", "verdict")


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
