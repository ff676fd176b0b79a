"""The engine LIGGGHTS: renders a deck from a model, runs it as a child process, reads its frames."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kncal.core.checks import one_of
from kncal.core.errors import SolverMissingError
from kncal.core.installed import found_once
from kncal.core.mpi import MISSING as NO_MPIRUN
from kncal.core.mpi import MPIRUN, check_ranks, mpi_command, mpi_environment, run_ranks
from kncal.core.process import solver_environment
from kncal.engines.base import FRAMES, Engine, Profile, Progress, guarded
from kncal.engines.liggghts.deck import DECK, scene_deck, write_deck
from kncal.engines.liggghts.diagnose import Diagnosis, diagnose_liggghts
from kncal.engines.liggghts.installed import VERSION, look
from kncal.engines.tunnelling import PASSED_THROUGH, passages
from kncal.record.liggghts_log import step_of_line
from kncal.record.outcome import RunResult
from kncal.scene.model import Plan
from kncal.scene.placement import Start

PROGRAM = "liggghts"
LOG = "log.liggghts"
LINEAR_STYLES = ("hooke/stiffness", "hooke")
#: Line-buffered: the text of some errors would be lost otherwise. The runner writes the log.
_COMMAND = ("stdbuf", "-oL", PROGRAM, "-in", DECK, "-log", "none")


class Liggghts(Engine):
    """LIGGGHTS-PUBLIC 3.8.0 as packaged by Debian.

    Parameters
    ----------
    linear_style : str
        How a linear model is written: "hooke/stiffness" takes any k_n and eta_n; "hooke" lets LIGGGHTS find
        k_n by strain energy at the impact speed (only for cases with that method).
    ranks : int
        Processes that share one run, each a part of the box; the frames are the same.
    oversubscribe : bool
        Allow more ranks than cores.

    Raises
    ------
    InputError
        For another style, or a number of ranks that `kncal.core.mpi.check_ranks` refuses.
    """

    def __init__(self, linear_style: str = "hooke/stiffness", *, ranks: int = 1, oversubscribe: bool = False) -> None:
        self.linear_style = one_of("linear_style", linear_style, LINEAR_STYLES)
        self.ranks = check_ranks(ranks, oversubscribe=oversubscribe)
        self._oversubscribe = oversubscribe
        #: as in `kncal.engines.registry.ENGINES`
        self.name = "liggghts" if linear_style == "hooke/stiffness" else "liggghts-hooke"

    def profile(self) -> Profile:
        """Look for the solver on this machine; starts it once to learn its version."""
        found = found_once(look, PROGRAM)
        needed = [("stdbuf", "no program stdbuf on PATH: apt-get install coreutils")]
        needed += [(MPIRUN, NO_MPIRUN)] if self.ranks > 1 else []
        problem = next((hint for program, hint in needed if shutil.which(program) is None), "")
        if not found.version:
            problem = f"LIGGGHTS: {found.found}: {found.hint}, or use the builtin engine"
        warning = f"{found.program} is LIGGGHTS {found.version}; kncal knows {VERSION}: look at the results twice"
        return Profile(
            engine=self.name,
            program=None if problem else found.program,
            version="" if problem else found.version,
            problem=problem,
            warning="" if problem or found.ok else warning,
            environment=mpi_environment(solver_environment(), self.ranks),
        )

    def command(self, plan: Plan, *, by_hand: bool = False) -> tuple[str, ...]:
        """Return the command that `run` starts in the run's folder; it is the same for every plan."""
        return mpi_command(_COMMAND, self.ranks, oversubscribe=self._oversubscribe)

    def render(self, plan: Plan, folder: Path, *, start: Start | None = None, by_hand: bool = False) -> None:
        """Write ``in.liggghts`` and ``Allrun`` into ``folder``.

        Raises
        ------
        RenderError
            If LIGGGHTS cannot simulate the model, or would do it wrongly without a word; nothing is written.
        """
        deck = scene_deck(plan, self.linear_style)
        write_deck(deck, folder, ranks=self.ranks, oversubscribe=self._oversubscribe)

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
        """Run the deck in ``folder``; never raises for a failed run, the status says so."""
        profile = self.profile()
        log = folder / LOG

        def on_line(line: str) -> None:
            step = step_of_line(line)
            if progress is not None and step is not None:
                progress(step, plan.n_steps)

        def work() -> Mapping[str, Any]:
            if profile.program is None:
                raise SolverMissingError(profile.problem)
            (folder / FRAMES).unlink(missing_ok=True)
            process = run_ranks(
                _COMMAND,
                self.ranks,
                oversubscribe=self._oversubscribe,
                cwd=folder,
                log=log,
                env=profile.environment,
                timeout=timeout,
                on_line=on_line,
                pass_fds=pass_fds,
            )
            problem = diagnose_liggghts(process, log, folder / FRAMES, plan.n_steps, len(plan.scene.spheres))
            if problem is None and (through := passages(plan, self.read(plan, folder))):
                problem = Diagnosis(code=PASSED_THROUGH, message=through[0])
            status = process.status
            if status == "exited":
                status = "completed" if problem is None else "failed"
            return {
                "status": status,
                "cpu_seconds": process.cpu_seconds,
                "wall_seconds": process.wall_seconds,
                "returncode": process.returncode,
                "message": "" if problem is None else problem.message,
                "failure": problem.code if problem is not None and status == "failed" else "",
                "log": log,
            }

        return guarded(self.name, plan, folder, work, cpu_seconds=0.0, version=profile.version)
