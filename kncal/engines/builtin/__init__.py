"""The engine builtin: the small integrator in this process; runs wherever Python runs, for a few bodies."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kncal import __version__
from kncal.core.awake import awake
from kncal.core.errors import InputError, RenderError
from kncal.engines.base import FRAMES, Engine, Profile, Progress, guarded
from kncal.engines.builtin.integrator import check, integrate
from kncal.record.liggghts_dump import write_trajectory
from kncal.record.outcome import RunResult
from kncal.scene.model import Plan
from kncal.scene.placement import Start

SCRIPT = "Allrun"


class Builtin(Engine):
    """kncal's own integrator: velocity Verlet as in LIGGGHTS, spheres and plane walls, no rolling friction.

    Raises
    ------
    InputError
        For several ranks.
    """

    name = "builtin"

    def __init__(self, *, ranks: int = 1, oversubscribe: bool = False) -> None:
        del oversubscribe
        if ranks != 1:
            raise InputError(f"ranks = {ranks}: the engine builtin computes in kncal's own process; expected 1")

    def profile(self) -> Profile:
        """Always there: the program is the Python that runs kncal."""
        return Profile(engine=self.name, program=Path(sys.executable), version=__version__)

    def command(self, plan: Plan, *, by_hand: bool = False) -> tuple[str, ...]:
        """Return the command that repeats by hand, in the run's folder, what `run` does in this process."""
        return ("kncal", "run", "../case.toml", "--engine", self.name, "--model", plan.kind, "--out", "by-hand")

    def render(self, plan: Plan, folder: Path, *, start: Start | None = None, by_hand: bool = False) -> None:
        """Write ``Allrun`` into ``folder``; there is no other input than the case file.

        Raises
        ------
        RenderError
            If the model asks for something that the integrator does not have; nothing is written.
        """
        check(plan)
        if not (folder.is_dir() and plan.kind in ("linear", "hertz")):
            raise RenderError(f"{folder}: expected a folder, and a model 'linear' or 'hertz', not {plan.kind!r}")
        script = folder / SCRIPT
        command = shlex.join(self.command(plan))
        script.write_text(
            f"#!/bin/sh\n# Repeats this run by hand; frames go to by-hand/{plan.kind}/{FRAMES}.\nset -eu\n"
            f'cd -- "$(dirname -- "$0")"\nexec {command}\n',
            encoding="ascii",
        )
        script.chmod(0o755)

    def run(
        self,
        plan: Plan,
        folder: Path,
        *,
        start: Start | None = None,
        timeout: float | None = None,
        progress: Progress | None = None,
        resume: bool = False,
        pass_fds: Sequence[int] = (),
    ) -> RunResult:
        """Integrate the plan and write its frames; never raises for a failed run, the status says so."""
        begin = awake()

        def on_steps(done: int, total: int) -> None:
            if progress is not None:
                progress(done, total)
            if timeout is not None and awake() - begin > timeout:
                raise TimeoutError(f"stopped at step {done} of {total}: not done within {timeout:g} s")

        def work() -> Mapping[str, Any]:
            (folder / FRAMES).unlink(missing_ok=True)
            trajectory = integrate(plan, on_steps)
            write_trajectory(folder / FRAMES, trajectory, range(1, len(trajectory.names) + 1))
            return {}

        return guarded(self.name, plan, folder, work)
