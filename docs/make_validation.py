"""Make docs/validation.md anew: every number that is compared with something that kncal did not compute.

    python docs/make_validation.py                  # the quick ones (two minutes of CPU time)
    python docs/make_validation.py --all            # also the long ones
    python docs/make_validation.py chung_ooi_4 ...  # those of these cases

Runs are kept in runs/validation and not made twice. Each result is stored in docs/validation.json with its date, so
rows that are not made this time stay as they were. The entries are in `validation_entries.py`.
"""

from __future__ import annotations

import argparse
import datetime
import itertools
import json
import re
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from validation_entries import ENTRIES
from validation_entry import Entry

from kncal import __version__
from kncal.core.files import write_json
from kncal.core.shipped import folder
from kncal.core.units import quantity
from kncal.engines.registry import engine_for
from kncal.observe.estimate import Estimate, apart
from kncal.observe.row import Row, deciding_text, judge, row_of
from kncal.observe.run_data import RunData
from kncal.runs.workflow import complete, load, require_completed, run_case
from kncal.scene.case_file import load_case
from kncal.scene.metrics import METRICS, metric_unit, split_metric
from kncal.study.points import combine, grid_axis, read_points

HERE = Path(__file__).resolve().parent
PAGE, STORE = HERE / "validation.md", HERE / "validation.json"
RUNS = Path("runs/validation")
HEADS = ("what", "value", "reference", "deviation", "allowed", "predicted error", "verdict", "CPU s", "command")
_MARKED = re.compile(r"(<!-- begin validation -->\n).*?(<!-- end validation -->)", re.S)


def variants(entry: Entry) -> list[tuple[str, ...]]:
    """Return the overrides of each run of an entry: its grid, or the rows of its file of points."""
    axes = [grid_axis(text) for text in entry.sets]
    if entry.points:
        axes.append(read_points(folder("cases") / entry.case / entry.points))
    return [tuple(map(str, point)) for point in combine(axes)] if axes else [()]


def command(entry: Entry) -> str:
    """Return the command that makes the same runs."""
    series = bool(entry.points) or len(variants(entry)) > 1
    words = ["kncal", "sweep" if series else "run", entry.case]
    words += itertools.chain.from_iterable(("--set", text) for text in entry.sets)
    words += ["--points", f"cases/{entry.case}/{entry.points}"] if entry.points else []
    return shlex.join([*words, *(["--model", entry.models[0]] if len(entry.models) == 1 else [])])


def runs_of(entry: Entry) -> Iterator[RunData]:
    """Run an entry's variants where that was not done, and yield each run."""
    for number, sets in enumerate(variants(entry)):
        scene = load_case(entry.case, overrides=sets)
        if not entry.only(scene):
            continue
        name = Path(entry.points or "run").stem + "".join(f"-{text}" for text in entry.sets)
        out = RUNS / entry.case / re.sub(r"[^\w.=-]+", "_", name) / str(number)
        require_completed(run_case(scene, engine_for(scene), out, entry.models).values())
        yield from (complete(load(out / kind)) for kind in entry.models)


def reference_of(entry: Entry, run: RunData) -> tuple[float, float | None]:
    """Return what a run should show, and the allowed relative deviation: the entry's, or the case's expected.json's."""
    if entry.reference is not None:
        found = entry.reference
        return (found(run.model.scene) if callable(found) else found), entry.tolerance
    data = json.loads((folder("cases") / entry.case / "expected.json").read_text("utf-8"))
    item = data["metrics"][run.model.kind][entry.metric]
    return item["value"], item["rel_tol"] if entry.tolerance is None else entry.tolerance


def row(entry: Entry, run: RunData) -> Row:
    """Return one run's row."""
    found = run.estimate(entry.metric) if entry.value is None else Estimate(value=entry.value(run))
    value, tolerance = reference_of(entry, run)
    exact = Estimate(value=value, width=0.0)
    scale = abs(value) if entry.scale is None else entry.scale
    if found.value is None:
        return judge(row_of(entry.metric, found, exact, found), tolerance)
    # a width that is not known decides nothing
    known = found if found.width is not None else Estimate(value=found.value, width=0.0)
    difference = apart(known, exact, scale, ("run", "reference"))
    return judge(row_of(entry.metric, found, exact, difference, scale=scale), None if not entry.judged else tolerance)


def result(entry: Entry) -> dict[str, Any]:
    """Return what is stored of an entry: its worst run, and how many there are."""
    found = [(row(entry, run), run) for run in runs_of(entry)]
    worst, run = max(found, key=lambda pair: (pair[0].verdict == "missing", abs(pair[0].difference.value or 0.0)))
    unit = entry.unit if entry.value is not None else _unit(entry.metric)
    width = worst.run.width if entry.value is None else None
    return {
        "section": entry.section,
        "what": entry.what + (f", worst of {len(found)}" if len(found) > 1 else ""),
        "source": entry.source,
        "model": run.model.kind,
        "value": worst.run.value,
        "reference": worst.reference.value,
        "unit": unit,
        "deviation": worst.difference.value,
        "shown": deciding_text(worst),
        "allowed": worst.tolerance,
        "predicted": None if width is None or not worst.run.value else abs(width / worst.run.value),
        "verdict": worst.verdict,
        "cpu_seconds": round(sum(one.result.cpu_seconds for _, one in found), 2),
        "command": command(entry),
        "date": datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
        "kncal": __version__,
        "solver": f"{run.result.engine} {run.result.version}",
    }


def _unit(metric: str) -> str:
    base, _ = split_metric(metric)
    return metric_unit(base) if base in METRICS else ""


def number(value: float | None, unit: str) -> str:
    """Return a value with its unit."""
    if value is None:
        return "–"
    return f"{value:.5g}" if unit in ("", "–") else quantity(value, unit, 5)


def cells(item: dict[str, Any]) -> list[str]:
    """Return the cells of a stored result."""
    share = lambda x, digits: "–" if x is None else f"{100.0 * x:.{digits}g} %"  # noqa: E731
    said = f"{item['what']} ({item['model']})" if item["model"] else item["what"]
    return [
        f"{said}: {item['source']}",
        number(item["value"], item["unit"]),
        number(item["reference"], item["unit"]),
        share(item["deviation"], 2),
        share(item["allowed"], 3),
        share(item["predicted"], 2),
        {"-": "not judged"}.get(item["verdict"], item["verdict"]),
        f"{item['cpu_seconds']:.3g}",
        f"`{item['command']}`",
    ]


def page(stored: dict[str, Any]) -> str:
    """Return the tables of the page, a section each, in the order of the entries."""
    text, section = [], ""
    for item in (stored[entry.name] for entry in ENTRIES if entry.name in stored):
        if item["section"] != section:
            section = item["section"]
            text += ["", f"## {section}", "", f"| {' | '.join(HEADS)} |", "|---" * len(HEADS) + "|"]
        text.append(f"| {' | '.join(cells(item))} |")
    made = sorted({f"{item['date']}, kncal {item['kncal']}, {item['solver']}" for item in stored.values()})
    return "\n".join([*text, "", f"Made: {'; '.join(made)}.", ""])


def main(arguments: Sequence[str]) -> int:
    """Make the entries that are asked for, store them, and write the page; 1 if one is outside."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("cases", nargs="*", help="only those of these cases")
    parser.add_argument("--all", action="store_true", help="also the long ones")
    asked = parser.parse_args(arguments)
    made: dict[str, Any] = {}
    for entry in ENTRIES:
        if entry.case in asked.cases or (not asked.cases and (asked.all or not entry.long)):
            made[entry.name] = item = result(entry)
            print(f"{item['verdict']:10} {item['shown']:>24}  {item['what']} ({item['model']})", flush=True)
    stored = (json.loads(STORE.read_text("utf-8")) if STORE.is_file() else {}) | made
    names = [entry.name for entry in ENTRIES]
    write_json(STORE, {name: stored[name] for name in names if name in stored})
    PAGE.write_text(_MARKED.sub(lambda m: f"{m[1]}{page(stored)}{m[2]}", PAGE.read_text("utf-8")), "utf-8")
    return 1 if any(item["verdict"] in ("outside", "missing") for item in made.values()) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
