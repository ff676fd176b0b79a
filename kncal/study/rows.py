"""The rows of one run in the table of a sweep: how each model ended, its numbers, and linear against Hertz.

What a completed run's numbers are is kept in ``row.json`` in its folder, tied to its results by their SHA-256 and to
the version of kncal that made them.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from kncal import __version__
from kncal.core.errors import KncalError, ReadError
from kncal.core.files import sha256
from kncal.core.records import Record, Sha256, read_record
from kncal.core.scratch import replacing
from kncal.core.tables import MAX_JSON_BYTES
from kncal.record.outcome import RunResult
from kncal.runs.folder import ROW, read_result
from kncal.runs.records import RESULT
from kncal.study.design import Sweep, run_folder

#: Why a run did not complete, by its status where that says it.
_CLASSES = {"timed_out": "timed-out", "interrupted": "interrupted", "not_installed": "not-installed"}

Row = dict[str, Any]


class _Rows(Record):
    kncal: str
    results: dict[str, Sha256]
    rows: list[dict[Annotated[str, Field(max_length=200)], str | int | float | bool | None]]


def failure_class(status: str, failure: str) -> str:
    """Return why a run did not complete, in a word: its failure, or its status; "" if it did."""
    return "" if status == "completed" else _CLASSES.get(status, failure or "solver-error")


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
    if not all(row["status"] == "completed" for row in rows) or _add_numbers(sweep, out, rows):
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


def _add_numbers(sweep: Sweep, out: Path, rows: list[Row]) -> bool:
    """Add metrics and comparison; where they cannot be had, the message says why and False is returned."""
    by_kind = {row["model"]: row for row in rows}
    try:
        (_bed_numbers if sweep.bed else _contact_numbers)(out, by_kind)
    except KncalError as error:
        for row in rows:
            row["message"] = f"no numbers: {error}"
        return False
    return True


def _contact_numbers(out: Path, rows: Mapping[str, Row]) -> None:
    from kncal.observe.compare import compare
    from kncal.runs.workflow import load_run

    runs = {kind: load_run(out / kind) for kind in rows}
    for kind, data in runs.items():
        rows[kind] |= _finite(data.observations.metrics)
    if len(runs) == 2:
        comparison = compare(runs["linear"], runs["hertz"])
        verdict = "open" if not comparison.judged else "within" if comparison.within else "outside"
        rows["linear"] |= {"verdict": verdict}
        rows["linear"] |= _finite({f"difference.{r.metric}": r.difference for r in comparison.rows})


def _bed_numbers(out: Path, rows: Mapping[str, Row]) -> None:
    from kncal.observe.averages import observe_bed
    from kncal.observe.bed_compare import compare_beds
    from kncal.observe.quantities import quantities
    from kncal.runs.bed_workflow import load_bed_run

    runs = {kind: load_bed_run(out / kind) for kind in rows}
    if len(runs) == 2:
        comparison = compare_beds(runs["linear"], runs["hertz"])
        for r in comparison.rows:
            rows["linear"] |= _finite({r.metric: r.linear, f"uncertainty.{r.metric}": r.linear_uncertainty})
            rows["hertz"] |= _finite({r.metric: r.hertz, f"uncertainty.{r.metric}": r.hertz_uncertainty})
            rows["linear"] |= _finite({f"difference.{r.metric}": r.difference})
            rows["linear"] |= _finite({f"difference_uncertainty.{r.metric}": r.uncertainty})
        rows["linear"] |= {"verdict": comparison.state}
        return
    for kind, data in runs.items():
        scene = data.model.scene
        found = quantities(data.series, observe_bed(data.series, scene.run.discard, scene.gas))
        for name, side in found.sides.items():
            if side.average is not None:
                both = {name: side.average.mean, f"uncertainty.{name}": side.average.uncertainty}
                rows[kind] |= _finite(both)


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
