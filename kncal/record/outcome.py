"""How a run ended, and what it cost."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

#: The states a run can end in.
STATUSES = ("completed", "failed", "timed_out", "interrupted", "not_installed")

#: What a failed run died of. "killed" also stands for a run whose kncal or machine was stopped before it could say so,
#: "peer-stopped" for a solver that a signal (SIGSTOP) held while kncal went on, "broken-invariant" for a coupled run
#: whose momentum or mass does not balance, "solver-error" for what a solver says.
FAILURES = (
    "lost-particles", "not-finite", "disk-full", "killed", "peer-died", "peer-stopped", "broken-invariant",
    "no-end-marker", "wrong-last-step", "empty-output", "truncated-output", "passed-through", "solver-error",
    "bad-input",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """How a run ended, and what it cost.

    Attributes
    ----------
    status : one of `STATUSES`
    engine, model : names
    folder : the run's folder (holds manifest.json, result.json, the log and the frames)
    steps, dt : steps asked for and time step [s]
    cpu_seconds, wall_seconds : cost of the solver process
    version : of the solver
    returncode : of the process, None for engines without one
    message : the decisive line(s) for a person, empty if completed
    failure : what kind of failure, one of `FAILURES`; empty if it did not fail
    log : path of the solver's log, or None
    """

    status: str
    engine: str
    model: str
    folder: Path
    steps: int
    dt: float
    cpu_seconds: float
    wall_seconds: float
    version: str
    returncode: int | None = None
    message: str = ""
    failure: str = ""
    log: Path | None = None
    extra: dict[str, Any] = field(default_factory=dict)
