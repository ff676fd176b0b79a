"""The engine builtin: the small integrator in this process; runs wherever Python runs, for a few bodies."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from kncal import __version__
from kncal.core.awake import awake
from kncal.core.errors import KncalError, RenderError, failure_of
from kncal.engines.base import FRAMES, Profile, Progress, read_frames, run_result
from kncal.engines.builtin.integrator import check, integrate
from kncal.record.frames import Trajectory
from kncal.record.liggghts_dump import write_trajectory
from kncal.record.outcome import RunResult
from kncal.scene.model import Model

SCRIPT = "Allrun"


class _TimeoutError(Exception):
    """The time given to a run is over."""


class Builtin:
    """kncal's own integrator: velocity Verlet as in LIGGGHTS, spheres and plane walls, no rolling friction."""

    name = "builtin"
    ranks = 1

    def profile(self) -> Profile:
        """Always there: the program is the Python that runs kncal."""
        return Profile(engine=self.name, program=Path(sys.executable), version=__version__)

    def command(self, model: Model) -> tuple[str, ...]:
        """Return the command that repeats by hand, in the run's folder, what `run` does in this process."""
        return ("kncal", "run", "../case.toml", "--engine", self.name, "--model", model.kind, "--out", "by-hand")

    def render(self, model: Model, folder: Path) -> None:
        """Write ``Allrun`` into ``folder``; there is no other input than the case file.

        Raises
        ------
        RenderError
            If the model asks for something that the integrator does not have; nothing is written.
        """
        check(model)
        if not (folder.is_dir() and model.kind in ("linear", "hertz")):
            raise RenderError(f"{folder}: expected a folder, and a model 'linear' or 'hertz', not {model.kind!r}")
        script = folder / SCRIPT
        command = shlex.join(self.command(model))
        script.write_text(
            f"#!/bin/sh\n# Repeats this run by hand; frames go to by-hand/{model.kind}/{FRAMES}.\nset -eu\n"
            f'cd -- "$(dirname -- "$0")"\nexec {command}\n',
            encoding="ascii",
        )
        script.chmod(0o755)

    def run(
        self,
        model: Model,
        folder: Path,
        *,
        timeout: float | None = None,
        progress: Progress | None = None,
        pass_fds: Sequence[int] = (),
    ) -> RunResult:
        """Integrate the model and write its frames; never raises for a failed run, the status says so."""
        del pass_fds  # there is no other process
        started, cpu_started, begin = time.monotonic(), time.thread_time(), awake()

        def on_steps(done: int, total: int) -> None:
            if progress is not None:
                progress(done, total)
            if timeout is not None and awake() - begin > timeout:
                raise _TimeoutError(f"stopped at step {done} of {total}: not done within {timeout:g} s")

        status, message, failure = "completed", "", ""
        try:
            (folder / FRAMES).unlink(missing_ok=True)
            trajectory = integrate(model, on_steps)
            write_trajectory(folder / FRAMES, trajectory, range(1, len(trajectory.names) + 1))
        except _TimeoutError as stop:
            status, message = "timed_out", str(stop)
        except KeyboardInterrupt:
            status, message = "interrupted", "interrupted by the user"
        except (KncalError, OSError) as error:
            status, message, failure = "failed", str(error), failure_of(error)
        except MemoryError:
            status, message, failure = "failed", "out of memory: record fewer frames, or make the run shorter", "killed"
        return run_result(
            self.name,
            model,
            folder,
            status,
            cpu_seconds=time.thread_time() - cpu_started,
            wall_seconds=time.monotonic() - started,
            version=__version__,
            message=message,
            failure=failure,
        )

    def read(self, model: Model, folder: Path) -> Trajectory:
        """Read the recorded frames of a completed run; see `read_frames`."""
        return read_frames(model, folder)
