"""Several ranks of one solver on this machine: how many are allowed, the command, the environment, what is left behind.

Open MPI's ``mpirun`` starts the ranks. It is started, watched and ended like any other solver (`kncal.core.process`);
here is what is special about it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from kncal.core.errors import InputError
from kncal.core.process import ALONE, ProcessResult, death_guard, run_process, solver_environment
from kncal.core.scratch import held_scratch

MPIRUN = "mpirun"
MISSING = "several ranks need Open MPI (no program 'mpirun' on PATH): apt-get install openmpi-bin, or one rank"
#: More ranks on one machine are refused, whatever is said about cores.
MOST_RANKS = 1024

_SHARED = Path("/dev/shm")  # noqa: S108 - where Open MPI itself keeps the memory that ranks share
_PREFIX = "kncal-mpi-"
#: mpirun hands SIGTERM on, gives its ranks a second, kills them, and has ended after two [s]; a second signal within
#: that time would make it run away from its ranks.
_GRACE = 5.0


def cores() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0))


def check_ranks(ranks: int, *, oversubscribe: bool = False) -> int:
    """Return ``ranks``, refused if there are not as many cores for them.

    Raises
    ------
    InputError
        If it is no whole number from 1 to `MOST_RANKS`, or larger than the number of cores without ``oversubscribe``.
    """
    if isinstance(ranks, bool) or not isinstance(ranks, int) or not 1 <= ranks <= MOST_RANKS:
        raise InputError(f"ranks = {ranks!r}: expected a whole number from 1 to {MOST_RANKS}")
    if ranks > cores() and not oversubscribe:
        raise InputError(
            f"ranks = {ranks}: this process may use {cores()} core(s), and ranks without a core of their own wait for "
            f"each other; expected at most {cores()}, or --oversubscribe to have them all the same"
        )
    return ranks


def check_fit(workers: int | None, ranks: int, *, oversubscribe: bool = False) -> int:
    """Return how many runs of ``ranks`` ranks go on at a time: ``workers``; by default as many as have cores.

    Raises
    ------
    InputError
        If runs of several ranks would be more ranks than cores, without ``oversubscribe``; also as `check_ranks`.
    """
    fitting = max(1, cores() // check_ranks(ranks, oversubscribe=oversubscribe))
    if workers is None:
        return fitting
    if ranks > 1 and workers > fitting and not oversubscribe:
        raise InputError(
            f"workers = {workers} runs of {ranks} ranks each: that is {workers * ranks} ranks on {cores()} core(s); "
            f"expected at most {fitting} worker(s), or --oversubscribe to have them all the same"
        )
    return workers


def mpi_command(command: Sequence[str], ranks: int, *, oversubscribe: bool = False) -> tuple[str, ...]:
    """Return the command that runs ``command`` on ``ranks`` ranks; one rank needs no ``mpirun``."""
    return tuple(command) if ranks == 1 else (*_start(ranks, oversubscribe), *command)


def mpi_environment(environment: Mapping[str, str], ranks: int) -> dict[str, str]:
    """Return the environment of a solver on ``ranks`` ranks, from that on one."""
    # With these each rank would take itself for a program of one rank, or could talk to none but itself.
    return {key: value for key, value in environment.items() if ranks == 1 or key not in ALONE}


def run_ranks(
    command: Sequence[str],
    ranks: int,
    *,
    cwd: Path,
    log: Path,
    oversubscribe: bool = False,
    env: Mapping[str, str] | None = None,
    timeout: float | None = None,
    on_line: Callable[[str], None] | None = None,
    pass_fds: Sequence[int] = (),
) -> ProcessResult:
    """Run one program on ``ranks`` ranks to its end; everything else as `kncal.core.process.run_process`.

    ``cpu_seconds`` are those of all ranks. A rank that a signal ended gives ``signal``, as of a program of one rank
    (``mpirun`` itself then ends the others, within two seconds). All ranks end with ``mpirun``, also if it is killed
    (where ``setpriv`` exists), and nothing stays behind in the machine's shared memory.
    """
    environment = solver_environment() if env is None else env
    if ranks == 1:
        return run_process(
            command, cwd=cwd, log=log, env=environment, timeout=timeout, on_line=on_line, pass_fds=pass_fds
        )
    with started_as(command, ranks, environment, oversubscribe=oversubscribe) as how:
        process = run_process(
            how.command,
            cwd=cwd,
            log=log,
            env=how.environment,
            timeout=timeout,
            on_line=on_line,
            pass_fds=(*pass_fds, *how.descriptors),
            grace=_GRACE,
        )
    code = process.returncode
    if process.status == "exited" and code is not None and 128 < code < 128 + 65:  # as a shell counts signals
        process = replace(process, returncode=None, signal=code - 128)
    return replace(process, command=mpi_command(command, ranks, oversubscribe=oversubscribe))


class Start(NamedTuple):
    """How a program is started: command, environment, and descriptors that it inherits."""

    command: tuple[str, ...]
    environment: dict[str, str]
    descriptors: tuple[int, ...]


@contextmanager
def started_as(
    command: Sequence[str], ranks: int, environment: Mapping[str, str], *, oversubscribe: bool = False
) -> Iterator[Start]:
    """Give the way to start ``command`` on ``ranks`` ranks, from its way on one; what they share goes at the end."""
    own = mpi_environment(environment, ranks)
    if ranks == 1:
        yield Start(tuple(command), own, ())
        return
    # mpirun puts each rank into a process group of its own, where no signal to ours reaches it.
    with _shared_memory() as (folder, descriptors):
        if folder is not None:
            own["OMPI_MCA_btl_vader_backing_directory"] = str(folder)
        yield Start((*_start(ranks, oversubscribe), *death_guard(), *command), own, descriptors)


def _start(ranks: int, oversubscribe: bool) -> tuple[str, ...]:
    # Not bound: the ranks of another run would be bound to the same cores. Yielding: a rank that waits looks for its
    # message all the time, and must leave its core to whoever has work. Hardware threads are what `cores` counts.
    flags = ("--bind-to", "none", "--mca", "mpi_yield_when_idle", "1", "--use-hwthread-cpus")
    return (MPIRUN, *flags, *(("--oversubscribe",) if oversubscribe else ()), "-np", str(ranks))


@contextmanager
def _shared_memory() -> Iterator[tuple[Path | None, tuple[int, ...]]]:
    """Give a folder for the memory that ranks share, and descriptors that hold it; it is removed whatever happens.

    Open MPI leaves its files behind if it is killed; see `kncal.core.scratch`.
    """
    if not os.access(_SHARED, os.W_OK):
        yield None, ()
        return
    with held_scratch(_SHARED, _PREFIX) as held:
        yield held
