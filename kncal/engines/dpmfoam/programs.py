"""Programs of OpenFOAM: their environment, how one runs in a case folder, and why one failed, in its own words."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from kncal.core.disk import blame
from kncal.core.errors import RunError, SolverMissingError
from kncal.core.mpi import run_ranks
from kncal.core.process import ProcessResult, solver_environment
from kncal.record.openfoam import fatal_error

SOLVER, MESHER = "DPMFoam", "blockMesh"

#: Linux' name for the working folder of any process; see `case_environment`.
_CWD = "/proc/self/cwd"
_MESH_LIMIT = 600.0  # s


def case_environment(folder: Path) -> dict[str, str]:
    """Return the environment of a solver that runs in ``folder``; without its PWD OpenFOAM warns at each start.

    OpenFOAM takes its own name for the folder from PWD and refuses one with spaces or quotes; such a folder gets the
    name that Linux has for the working folder of any process.
    """
    here = str(folder.absolute())
    awkward = any(sign.isspace() or sign in "\"'" for sign in here)
    return {**solver_environment(), "PWD": _CWD if awkward else here}


def run_program(
    command: Sequence[str],
    folder: Path,
    *,
    time_limit: float,
    ranks: int = 1,
    oversubscribe: bool = False,
    pass_fds: Sequence[int] = (),
) -> float:
    """Run one program of OpenFOAM in ``folder``, its log beside it; return its CPU time [s].

    Raises
    ------
    SolverMissingError
        If OpenFOAM is not installed.
    RunError
        If it fails, with its own error text, or does not end within ``time_limit`` [s].
    """
    log = folder / f"log.{command[0]}"
    environment = case_environment(folder)
    with _held(folder) as descriptor:
        prefix = []
        if environment["PWD"] == _CWD and ranks == 1:
            # decomposePar goes into another folder for a moment, and its working folder is no longer the case
            environment["PWD"] = f"/proc/self/fd/{descriptor}"
        elif environment["PWD"] == _CWD:
            prefix = ["env", f"PWD={_CWD}"]  # mpirun gives its ranks the real name
        # The log holds the last start only, so it cannot grow without end.
        result = run_ranks(
            [*prefix, *command],
            ranks,
            oversubscribe=oversubscribe,
            cwd=folder,
            log=log,
            env=environment,
            timeout=time_limit,
            pass_fds=(descriptor, *pass_fds),
        )
    if result.status == "interrupted":
        raise KeyboardInterrupt  # which the runner took for us: the run is interrupted, it did not fail
    if result.status != "exited" or result.returncode != 0:
        raise process_error(command[0], result, log)
    if "End" not in result.last_lines:
        raise RunError(f"{command[0]} ended without its end marker; see {log}", "no-end-marker")
    return result.cpu_seconds


def make_mesh(folder: Path) -> float:
    """Run blockMesh in a case folder; return its CPU time [s]. Errors: see `run_program`."""
    return run_program([MESHER], folder, time_limit=_MESH_LIMIT)


@contextmanager
def _held(folder: Path) -> Iterator[int]:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def process_error(program: str, result: ProcessResult, log: Path) -> RunError:
    """Return the error that says why an OpenFOAM program did not end as it should, with its own words."""
    if result.status == "not_installed":
        return SolverMissingError(f"{program} is not installed (no such program on PATH): apt-get install openfoam")
    if result.status == "timed_out":
        if result.stopped:
            text = (
                f"{program} was stopped from outside (SIGSTOP, or a debugger) and did not go on within its time limit"
            )
            return RunError(f"{text}; kncal has ended it; log: {log}", "peer-stopped")
        return RunError(f"{program} did not end within its time limit and was ended; see {log}", "peer-died")
    if result.status == "interrupted":
        return RunError(f"{program} was interrupted; see {log}")
    words = fatal_error(log) or " / ".join(line for line in result.last_lines[-3:] if line)
    how = f"signal {result.signal}" if result.signal is not None else f"exit code {result.returncode}"
    failure = "solver-error" if result.signal is None else "peer-died"
    if result.signal == signal.SIGFPE or "sigFpe" in words:
        how += " (floating-point exception: the gas flow diverged; try a shorter gas step)"
        failure = "not-finite"
    failure, text = blame(failure, f"{program} failed, {how}: {words or 'no message'}; see {log}", log.parent)
    return RunError(text, failure)
