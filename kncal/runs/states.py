"""The state of a run as its folder tells it: only records and the lock count, so it is true whatever happened."""

from __future__ import annotations

import fcntl
import os
import stat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from kncal.core.errors import ReadError
from kncal.core.lock import LOCK, signed
from kncal.runs.folder import read_result
from kncal.runs.records import ATTEMPT, MANIFEST, RESULT, STARTED
from kncal.runs.started import end_without_result
from kncal.scene.model import KINDS

#: Every state of a run.
STATES = ("rendered", "running", "completed", "timed_out", "interrupted", "not_installed", "failed")

#: What the commands of many runs write last into their folders -> the command.
RECORDS: Mapping[str, str] = {f"{name}.json": f"kncal {name}" for name in ("sweep", "trade", "trim", "stability")}

#: What to do about a run that ended in this state, or of this failure.
ADVICE: Mapping[str, str] = {
    "timed_out": "run the same command again with more time (--timeout; kncal trade: --budget); a run with gas resumes",
    "interrupted": "run the same command again; a run with gas resumes at its last checkpoint",
    "not_installed": "kncal doctor shows what is missing and how to install it",
    "killed": "run the same command again; if memory was short, with fewer runs at the same time (--workers)",
    "disk-full": "free disk space (kncal clean), then run the same command again",
    "lost-particles": "they passed through a wall or each other: take a stiffer contact, or more run.steps_per_contact",
    "passed-through": "take a stiffer contact, or a smaller time step (more run.steps_per_contact)",
    "not-finite": "take a smaller time step (more run.steps_per_contact; for the gas a smaller run.gas_step)",
    "peer-stopped": "find what paused the solver (SIGSTOP); then the same command again resumes at its checkpoint",
    "peer-died": "read its log; the same command again resumes at the last checkpoint",
    "broken-invariant": "take a smaller run.coupling, or larger gas cells",
    "no-end-marker": "was the solver stopped by somebody? run the same command again",
    "wrong-last-step": "was the solver stopped, or the deck edited? run the same command again",
    "empty-output": "is there free disk space? run the same command again",
    "truncated-output": "a file was truncated or edited: run the same command again",
    "solver-error": "read the solver's message above, and its log",
    "bad-input": "change the input that the message names",
}


@dataclass(frozen=True, kw_only=True)
class RunState:
    """The state of one model's folder.

    Attributes
    ----------
    folder : Path; model : "linear" or "hertz"
    status : one of `STATES`
    failure : what it died of, one of `kncal.record.outcome.FAILURES`; empty if it did not fail
    message : for a person
    owner : who holds the folder, empty if no one does
    cpu_seconds : [s], 0 before the end
    """

    folder: Path
    model: str
    status: str
    failure: str = ""
    message: str = ""
    owner: str = ""
    cpu_seconds: float = 0.0


def run_state(folder: Path) -> RunState:
    """Return the state of one model's folder, e.g. ``runs/wall_impact/hertz``.

    Raises
    ------
    ReadError
        If it is not such a folder.
    """
    if not (folder / MANIFEST).is_file():
        raise ReadError(f"{folder}: no {MANIFEST}; expected a model's run folder, e.g. runs/wall_impact/hertz")
    owner = holder(folder.parent)
    if (folder / RESULT).is_file():
        try:
            result = read_result(folder)
        except ReadError as error:
            return _state(folder, "failed", "truncated-output", str(error), owner)
        return RunState(
            folder=folder,
            model=folder.name,
            status=result.status,
            failure=result.failure,
            message=result.message,
            owner=owner,
            cpu_seconds=result.cpu_seconds,
        )
    if not (folder / STARTED).is_file():
        return _state(folder, "rendered", "", "", owner)
    if owner:
        return _state(folder, "running", "", "", owner)
    return _state(folder, "failed", *end_without_result(folder), "")


def case_states(out: Path) -> tuple[RunState, ...]:
    """Return the states of the models in a run folder (empty if there are none)."""
    return tuple(run_state(out / kind) for kind in KINDS if (out / kind / MANIFEST).is_file())


def find_run_folders(root: Path) -> Iterator[Path]:
    """Find run folders of cases in ``root``, itself included; attempts and what links lead to are left out.

    A folder whose only models are links is none. One that a killed start left may hold nothing but attempts.
    """
    for path, folders, files in os.walk(root):
        attempts = [f for f in folders if ATTEMPT.fullmatch(f)]
        models = [kind for kind in KINDS if kind in folders and not Path(path, kind).is_symlink()]
        if (MANIFEST in files and models) or (attempts and (MANIFEST in files or LOCK in files)):
            yield Path(path)
            folders.clear()
        else:
            folders[:] = sorted(set(folders).difference(attempts))


def command_of(folder: Path) -> str:
    """Return the command of many runs whose folder this is, e.g. "kncal trade"; empty if it is none's."""
    return next((command for record, command in RECORDS.items() if (folder / record).is_file()), "")


def holder(out: Path) -> str:
    """Return who holds the run folder ``out`` ("pid 12 on host, started ..."), empty if no one does."""
    try:
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOCTTY
        descriptor = os.open(out / LOCK, flags)
    except OSError:  # never locked
        return ""
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):  # a stranger's pipe, or worse: no lock of kncal
            return ""
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return signed(descriptor) or "a run that is just starting"
    except OSError:  # a file system without locks
        return ""
    finally:
        os.close(descriptor)
    return ""


def _state(folder: Path, status: str, failure: str, message: str, owner: str) -> RunState:
    return RunState(folder=folder, model=folder.name, status=status, failure=failure, message=message, owner=owner)
