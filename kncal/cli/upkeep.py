"""``kncal status`` and ``kncal clean``: what became of runs, and what may go."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from kncal.cli import show
from kncal.cli.flags import Json
from kncal.core.errors import InputError

if TYPE_CHECKING:
    from kncal.runs.states import RunState

Folder = Annotated[Path, Parameter(help="a run folder, or a folder that holds run folders")]
#: What to do about a failure that has no name, or one that this kncal does not know.
_ELSE = "read its log, then run the same command again"
#: Runs that fit on one screen.
_ROWS = 30


def status(folder: Folder = Path("runs"), *, json: Json = False) -> None:
    """Show which runs are running, completed or failed; why they failed, and what to do."""
    from dataclasses import asdict

    from kncal.runs.states import case_states, command_of, find_run_folders
    from kncal.study.design import DESIGN

    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected one that holds runs")
    if (folder / DESIGN).is_file():
        _sweep(folder, json=json)
        return
    states = [state for out in find_run_folders(folder) for state in case_states(out)]
    if json:
        show.as_json([asdict(state) for state in states])
        return
    page = folder / "report" / "index.html"
    if command := command_of(folder):
        show.say(f"{folder}: made by {command}" + (f"; its report: {page}" if page.is_file() else ""))
    if not states:
        show.say(f"{folder}: no runs in it")
        return
    _print(folder, states)


def clean(
    folder: Folder = Path("runs"),
    *,
    yes: Annotated[bool, Parameter(name="--yes", help="do not ask")] = False,
) -> None:
    """Remove earlier attempts, and the working files of completed runs with gas. Asks first.

    Working files include the logs of the solvers. A case that is running is not touched.
    """
    from kncal.runs.cleaning import clean as remove
    from kncal.runs.cleaning import plan_cleaning

    removals, left = plan_cleaning(folder)
    for text in left:
        show.say(text)
    if not removals:
        show.say(f"{folder}: nothing to remove")
        return
    for removal in removals:
        show.say(f"{_megabytes(removal.size):>9}  {removal.path} ({removal.why})")
    total = _megabytes(sum(removal.size for removal in removals))
    if not yes and not _agreed(f"Remove these {len(removals)} folders, {total}?"):
        show.say("nothing removed")
        return
    freed, held = remove(removals)
    for text in held:
        show.say(text)
    show.say(f"removed {_megabytes(freed)}")


def _sweep(folder: Path, *, json: bool) -> None:
    from dataclasses import asdict

    from kncal.runs.states import ADVICE
    from kncal.study.states import sweep_status

    found = sweep_status(folder)
    if json:
        show.as_json(asdict(found))
        return
    counts = ", ".join(f"{number} {name.replace('_', ' ')}" for name, number in found.counts.items())
    show.say(f"{folder}: sweep of {found.name}, {found.total} runs: {counts}")
    if found.owner:
        show.say(f"run by {found.owner}")
    elif found.counts.get("completed", 0) < found.total:
        show.say("it is not running; the same command again runs what is missing")
    if found.failures:
        rows = [
            [name, str(number), ADVICE.get(name) or ADVICE.get(name.replace("-", "_"), "")]
            for name, number in found.failures.items()
        ]
        show.table("", ["failure", "runs", "what to do"], rows, text=(0, 2), fold=True)
    for run in found.running[:_ROWS]:
        show.say(f"running: {run.id} by pid {run.pid} on {run.host}")
    for failure in found.newest:
        show.say(f"{failure.folder}: {failure.message or failure.failure}")


def _agreed(question: str) -> bool:
    if not sys.stdin.isatty():
        raise InputError("there is no terminal to ask at: expected --yes")
    return input(f"{question} [y/N] ").strip().lower() in ("y", "yes")


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.1f} MB"


def _print(folder: Path, states: list[RunState]) -> None:
    from collections import Counter

    from kncal.runs.states import ADVICE, command_of

    counts = Counter(state.status for state in states)
    show.say(f"{folder}: " + ", ".join(f"{number} {name.replace('_', ' ')}" for name, number in counts.items()))
    order = {"running": 0, "failed": 1, "not_installed": 1, "timed_out": 2, "interrupted": 2, "rendered": 3}
    # of those of a sweep, which other commands make too, the completed ones are only counted
    place = {state: state.folder.absolute().parents[2] for state in states}
    sweeps = {folder for folder in set(place.values()) if command_of(folder)}
    listed = [state for state in states if state.status != "completed" or place[state] not in sweeps]
    if hidden := len(states) - len(listed):
        show.say(f"{hidden} of the completed runs belong to sweeps and are not listed")
    if not listed:
        return
    shown = sorted(listed, key=lambda state: order.get(state.status, 4))[:_ROWS]
    rows = [
        [
            str(state.folder.relative_to(folder)) if state.folder != folder else state.folder.name,
            state.status.replace("_", " ") + (f" ({state.failure})" if state.failure else ""),
            show.quantity(state.cpu_seconds, "s", 3) if state.cpu_seconds else "",
            state.owner if state.status == "running" else "",
        ]
        for state in shown
    ]
    show.table("", ["run", "state", "CPU", "by"], rows, text=(0, 1, 3))
    if len(listed) > _ROWS:
        show.say(f"... and {len(listed) - _ROWS} more; --json has all")
    for state in shown:
        if state.message and state.status != "completed":
            show.say(f"{state.folder}: {state.message}")
            show.say(f"  what to do: {ADVICE.get(state.failure or state.status, _ELSE)}")
