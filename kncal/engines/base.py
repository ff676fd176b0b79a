"""What an engine is: it renders a model to a folder, runs that folder, and reads the result back."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from kncal.core.errors import ReadError
from kncal.record.frames import Trajectory
from kncal.record.liggghts_dump import read_trajectory
from kncal.record.outcome import RunResult
from kncal.scene.model import Model

#: The recorded frames of a run, in its folder.
FRAMES = "particles.dump"

#: Called while a run goes on with (steps done, steps in all).
Progress = Callable[[int, int], None]
#: Called with a sentence about what is done.
Tell = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Profile:
    """What this machine has of an engine: ``program`` is None (and ``problem`` says why) if it is missing.

    ``warning`` says what is unusual about one that is there; ``environment`` is all that its process is given.
    """

    engine: str
    program: Path | None
    version: str
    problem: str = ""
    warning: str = ""
    environment: Mapping[str, str] = field(default_factory=dict)


class Engine(Protocol):
    """The interface of every engine; `render` writes files, `run` starts the solver, `read` parses.

    ``ranks`` is the number of processes that share one run.
    """

    name: str
    ranks: int

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
        self,
        model: Model,
        folder: Path,
        *,
        timeout: float | None = None,
        progress: Progress | None = None,
        pass_fds: Sequence[int] = (),
    ) -> RunResult:
        """Run what `render` wrote; never raises for a failed run, the status says so.

        A solver process inherits the descriptors ``pass_fds`` (the lock of the run folder).
        """
        ...

    def read(self, model: Model, folder: Path) -> Trajectory:
        """Read the recorded frames of a completed run."""
        ...


def run_result(engine: str, model: Model, folder: Path, status: str, **fields: Any) -> RunResult:
    """Return the result of a run of ``model``; what is not in ``fields`` is empty or zero."""
    rest: dict[str, Any] = {"cpu_seconds": 0.0, "wall_seconds": 0.0, "version": ""} | fields
    return RunResult(
        status=status, engine=engine, model=model.kind, folder=folder, steps=model.n_steps, dt=model.dt, **rest
    )


def read_frames(model: Model, folder: Path) -> Trajectory:
    """Read the recorded frames of a completed run of ``model``.

    Raises
    ------
    ReadError
        If the frames are missing, truncated, not those of the model's particles, or do not span the model's steps.
    """
    particles = model.scene.particles
    path = folder / FRAMES
    frames = read_trajectory(path, tuple(p.name for p in particles), [p.radius for p in particles], model.dt)
    first, last = int(frames.step[0]), int(frames.step[-1])
    if (first, last) != (0, model.n_steps):
        raise ReadError(f"{path}: frames of step {first} to {last}, expected 0 to {model.n_steps}: not of this run")
    return frames
