"""What an engine is: it renders a model to a folder, runs that folder, and reads the result back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from kncal.model import Model
from kncal.trajectory import Trajectory

#: The states a run can end in.
STATUSES = ("completed", "failed", "timed_out", "interrupted", "not_installed")

#: Called while a run goes on with (steps done, steps in all).
Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class Profile:
    """What this machine has of an engine: ``program`` is None (and ``problem`` says why) if it is missing."""

    engine: str
    program: Path | None
    version: str
    problem: str = ""


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
    log: Path | None = None
    extra: dict[str, Any] = field(default_factory=dict)


class Engine(Protocol):
    """The interface of every engine; `render` writes files, `run` starts the solver, `read` parses."""

    name: str

    def profile(self) -> Profile:
        """Look for the solver on this machine."""
        ...

    def render(self, model: Model, folder: Path) -> None:
        """Write the solver's input for ``model`` into ``folder`` (exists, empty)."""
        ...

    def command(self, model: Model) -> tuple[str, ...]:
        """Return the command that `run` starts in the run's folder."""
        ...

    def run(
        self, model: Model, folder: Path, *, timeout: float | None = None, progress: Progress | None = None
    ) -> RunResult:
        """Run what `render` wrote; never raises for a failed run, the status says so."""
        ...

    def read(self, model: Model, folder: Path) -> Trajectory:
        """Read the recorded frames of a completed run."""
        ...
