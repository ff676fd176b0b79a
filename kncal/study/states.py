"""How the runs of a sweep stand. The truth is each run's ``result.json``; ``states.jsonl`` saves reading them all.

A line of ``states.jsonl`` counts only as long as the results still have the times and sizes that it names, so a lost,
torn or outdated file changes nothing but the time that a look takes.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import stat
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kncal.core.checks import short
from kncal.core.errors import ReadError
from kncal.core.files import read_limited, write_text
from kncal.record.outcome import STATUSES
from kncal.runs.records import RESULT, STARTED
from kncal.runs.started import end_without_result
from kncal.runs.states import holder
from kncal.study.design import RUNS, Sweep, read_design

STATES = "states.jsonl"
#: What a run can be: these, and the statuses of `kncal.record.outcome.STATUSES`. "unfinished": started, without a
#: result, and nobody works on it any more (it was killed).
WAITING, RUNNING, UNFINISHED = "waiting", "running", "unfinished"
_NEWEST = 10
#: A larger ``result.json`` is no result [bytes].
_LARGEST = 16 * 1024**2
#: A larger ``states.jsonl`` is none: a line takes some hundred bytes, a sweep has at most some hundred thousand runs.
_MOST_NOTES = 512 * 1024**2
_KNOWN = (WAITING, RUNNING, UNFINISHED, "not_run", *STATUSES)

#: Why a run did not complete, by its status where that says it.
_CLASSES = {"timed_out": "timed-out", "interrupted": "interrupted", "not_installed": "not-installed"}
#: What reading a record, and values out of it, raises if it is none.
UNREADABLE = (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError)

Stamps = dict[str, list[int]]


def failure_class(status: str, failure: str) -> str:
    """Return why a run did not complete, in a word: its failure, or its status; "" if it did."""
    return "" if status == "completed" else _CLASSES.get(status, failure or "solver-error")


@dataclass(frozen=True, kw_only=True)
class Running:
    """A run that somebody works on: its id, folder, and the owner's process and host (None if the lock doesn't say)."""

    id: str
    folder: Path
    pid: int | None
    host: str | None


@dataclass(frozen=True, kw_only=True)
class Failure:
    """A run that did not complete: ``time`` is that of its result [s since 1970], None if it left none."""

    id: str
    folder: Path
    status: str
    failure: str
    message: str
    time: float | None


@dataclass(frozen=True, kw_only=True)
class SweepStatus:
    """How a sweep stands.

    Attributes
    ----------
    folder, name : of the sweep, and of its case
    total : number of runs
    counts : status -> number of runs, of "waiting", "running", "unfinished" and `kncal.record.outcome.STATUSES`
    failures : failure class -> number of runs
    running : the runs that somebody works on
    newest : the failures with the newest results first, at most ten
    owner : who runs the sweep ("pid 1 on host, started ..."), "" if nobody does
    """

    folder: Path
    name: str
    total: int
    counts: Mapping[str, int]
    failures: Mapping[str, int]
    running: tuple[Running, ...] = ()
    newest: tuple[Failure, ...] = field(default=())
    owner: str = ""


def sweep_status(folder: Path) -> SweepStatus:
    """Return how the sweep in ``folder`` stands, without changing anything there.

    Raises
    ------
    ReadError
        If the folder is not that of a sweep.
    """
    sweep = read_design(folder)
    known = read_states(folder)
    try:
        with os.scandir(folder / RUNS) as entries:
            there = {entry.name for entry in entries}
    except FileNotFoundError:
        there = set()
    counts: Counter[str] = Counter()
    failures: Counter[str] = Counter()
    running, failed = [], []
    runs = str(folder / RUNS)  # text: 1e4 Path objects would take half the time
    for run in sweep.runs:
        out = f"{runs}/{run}"
        state = state_of(sweep, out, known.get(run)) if run in there else _unwritten(known.get(run))
        open_end = state["status"] == UNFINISHED or (run in there and len(state["stamps"]) < len(sweep.models))
        if open_end and (owner := holder(Path(out))):
            state = state | {"status": RUNNING, "class": ""}
            running.append(_running(run, Path(out), owner))
        counts[state["status"]] += 1
        if state["class"]:
            failures[state["class"]] += 1
            ended = max((stamp[0] for stamp in state["stamps"].values()), default=None)
            failed.append(
                Failure(
                    id=run,
                    folder=Path(out),
                    status=state["status"],
                    failure=state["class"],
                    message=state["message"],
                    time=None if ended is None else ended / 1e9,
                )
            )
    failed.sort(key=lambda failure: failure.time or 0.0, reverse=True)
    return SweepStatus(
        folder=folder,
        name=sweep.name,
        total=len(sweep.runs),
        counts=dict(counts),
        failures=dict(failures.most_common()),
        running=tuple(running),
        newest=tuple(failed[:_NEWEST]),
        owner=holder(folder),
    )


def state_of(sweep: Sweep, out: Path | str, known: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return status, class, message and stamps of one run that has a folder, by what is known if that still holds."""
    stamps = stamps_of(sweep, out)
    if known is not None and known["stamps"] == stamps:
        return dict(known)
    return read_state(sweep, out, stamps)


def stamps_of(sweep: Sweep, out: Path | str) -> Stamps:
    """Return model -> [time of change in ns, size] of the ``result.json`` files that are there."""
    stamps: Stamps = {}
    for kind in sweep.models:
        with contextlib.suppress(OSError):
            found = os.stat(f"{out}/{kind}/{RESULT}")  # noqa: PTH116 - half the time of Path.stat, for 1e4 runs
            stamps[kind] = [found.st_mtime_ns, found.st_size]
    return stamps


def read_state(sweep: Sweep, out: Path | str, stamps: Stamps) -> dict[str, Any]:
    """Return the state of a run from its ``result.json`` files, without looking into the files they vouch for."""
    unfinished: dict[str, Any] = {"status": UNFINISHED, "class": "", "message": "", "stamps": stamps}
    state = dict(unfinished)
    for kind in sweep.models:
        if kind not in stamps:
            if Path(out, kind, STARTED).is_file():
                failure, message = end_without_result(Path(out, kind))
                if failure != "killed":  # that it is unfinished says it
                    return unfinished | {"status": "failed", "class": failure, "message": message}
            return unfinished
        try:
            data = read_quickly(f"{out}/{kind}/{RESULT}")
            if data["status"] not in STATUSES:
                raise ValueError(f"status = {short(data['status'])}")
            state["status"], state["message"] = data["status"], str(data["message"])
            state["class"] = failure_class(state["status"], str(data["failure"]))
        except UNREADABLE as error:
            message = f"{out}/{kind}/{RESULT}: damaged ({type(error).__name__}: {error}); run it again"
            state |= {"status": "failed", "class": "damaged-result", "message": message}
        if state["status"] != "completed":
            return state
    return state


def read_quickly(path: str) -> Any:
    """Read a record for a few of its values alone; as `kncal.core.files.read_json`, in a third of the time.

    What it raises is up to the reader: `UNREADABLE`.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    try:
        about = os.fstat(descriptor)
        if (size := about.st_size) > _LARGEST or not stat.S_ISREG(about.st_mode):
            raise ValueError(f"{size} bytes, expected a file of at most {_LARGEST}")
        return json.loads(os.read(descriptor, size))
    finally:
        os.close(descriptor)


def _unwritten(known: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the state of a run without a folder: waiting, or refused before anything was written."""
    if known is not None and not known["stamps"] and known["status"] != "completed":
        return dict(known)
    return {"status": WAITING, "class": "", "message": "", "stamps": {}}


def _running(run: str, out: Path, owner: str) -> Running:
    found = re.match(r"pid (\d+) on (\S+),", owner)
    return Running(id=run, folder=out, pid=int(found[1]) if found else None, host=found[2] if found else None)


def read_states(folder: Path) -> dict[str, dict[str, Any]]:
    """Return id -> the last that was noted of it; lines that are no notes (cut off by a crash) are left out."""
    try:
        data = read_limited(folder / STATES, _MOST_NOTES, "notes on a sweep")
    except ReadError:
        return {}
    states = {}
    for line in data.split(b"\n"):
        try:
            note = json.loads(line)
            texts = all(isinstance(note[key], str) for key in ("id", "class", "message"))
            if texts and isinstance(note["stamps"], dict) and note["status"] in _KNOWN:
                states[note["id"]] = note
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            continue
    return states


class StatesFile:
    """``states.jsonl`` while its sweep runs: rewritten at the start, then a line is added per run that ends."""

    def __init__(self, folder: Path, states: Iterable[Mapping[str, Any]]) -> None:
        write_text(folder / STATES, "".join(json.dumps(note) + "\n" for note in states))
        self._file = (folder / STATES).open("ab", buffering=0)

    def add(self, note: Mapping[str, Any]) -> None:
        """Add a line."""
        self._file.write(json.dumps(note).encode() + b"\n")

    def close(self) -> None:
        """Close the file."""
        self._file.close()
