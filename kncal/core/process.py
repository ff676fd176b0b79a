"""One solver process: its environment, its limits, its signals, its log, its cost.

Whether the result can be trusted is not decided here: see `kncal.engines.liggghts.diagnose`.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from kncal.core.awake import awake
from kncal.core.checks import positive
from kncal.core.errors import InputError, RunError
from kncal.core.files import MAX_LINE, decode_line
from kncal.core.scratch import held_scratch
from kncal.core.stopping import check_stop, shielded_start

#: The states a process can end in.
PROCESS_STATUSES = ("exited", "timed_out", "interrupted", "not_installed")

_GRACE = 2.0  # s between the signals that end a child
_KEPT_LINES = 20
_BLOCK = 1 << 16
_NOT_FOUND = 127  # exit code of setpriv, stdbuf and env if the program behind them does not exist
_OPENFOAM = Path("/usr/share/openfoam")  # where Debian puts it


@dataclass(frozen=True, kw_only=True)
class ProcessResult:
    """How a process ended, and what it cost.

    Attributes
    ----------
    status : one of `PROCESS_STATUSES`; "exited" also where a signal from elsewhere ended it
    returncode : exit code, None if a signal ended it or if it never ran. After a timeout or an interruption it
        means nothing: LIGGGHTS answers the first SIGTERM with 0
    signal : number of the signal that ended it, or None
    cpu_seconds : user and system time of this child and of those it waited for [s]
    wall_seconds : [s]
    last_lines : the last lines of its output (at most 20), without control characters
    command : what was asked for, without the wrapper that kncal adds
    stopped : a signal had stopped it (SIGSTOP; it did nothing, and had not ended) when its time was over
    """

    status: str
    returncode: int | None
    signal: int | None
    cpu_seconds: float
    wall_seconds: float
    last_lines: tuple[str, ...]
    command: tuple[str, ...] = ()
    stopped: bool = False


#: Of a program of one rank, not under mpirun. Otherwise it starts Open MPI's daemon, in a session of its own where no
#: signal to our group reaches it, and waits a quarter of a second for it; and as long again for networks to answer,
#: though there is nobody to talk to but itself.
ALONE = {"OMPI_MCA_ess_singleton_isolated": "1", "OMPI_MCA_pml": "ob1", "OMPI_MCA_btl": "self"}


def solver_environment() -> dict[str, str]:
    """Return the environment of every solver: a few variables of the user's, the rest decided here.

    What batch systems set (``SLURM_*``, ``PMI*``) is left out: with it a single LIGGGHTS inside a job step takes
    itself for one rank of many and dies in MPI_Init.
    """
    environment = {"PATH": os.environ.get("PATH", os.defpath), "LC_ALL": "C", "OMP_NUM_THREADS": "1"}
    environment |= ALONE
    if home := os.environ.get("HOME"):
        environment["HOME"] = home
    temporary = os.environ.get("TMPDIR")
    if temporary and Path(temporary).is_dir():
        environment["TMPDIR"] = temporary
    openfoam = os.environ.get("WM_PROJECT_DIR") or (str(_OPENFOAM) if _OPENFOAM.is_dir() else "")
    if openfoam:
        environment["WM_PROJECT_DIR"] = openfoam
    if os.geteuid() == 0:  # mpirun refuses root, the only user of many containers, without both
        environment |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    return environment


def run_process(
    command: Sequence[str],
    *,
    cwd: Path,
    log: Path,
    env: Mapping[str, str] | None = None,
    timeout: float | None = None,
    on_line: Callable[[str], None] | None = None,
    pass_fds: Sequence[int] = (),
    grace: float = _GRACE,
) -> ProcessResult:
    """Run one program to its end, in its own process group, with no shell and no input.

    The child dies with the thread that called this, also if that is killed (where ``setpriv`` exists).
    Ctrl-C ends the child and returns, as does `kncal.core.stopping`; a second one kills it at once. Any other exception
    ends it and is passed on.

    Parameters
    ----------
    command : sequence of str
        Program and arguments. A solver that buffers its output needs ``stdbuf -oL`` in front for live lines.
    cwd : Path
        Folder to run in.
    log : Path
        Gets standard output and standard error; replaced if it exists. A symbolic link is refused.
    env : mapping, optional
        The whole environment; None: `solver_environment`.
    timeout : float, optional
        Wall-clock limit [s], but for time in which kncal itself was stopped (see `kncal.core.awake`). After it the
        child gets SIGTERM twice, then SIGKILL, ``grace`` apart.
    on_line : callable, optional
        Called in this thread with each line of output, soon after it is written (see `decode_line`).
    pass_fds : sequence of int
        Open descriptors that the child inherits, e.g. the lock of its folder.
    grace : float
        Time that the child may take to end after each signal [s].

    Returns
    -------
    ProcessResult

    Raises
    ------
    InputError
        If the command is empty, the folder does not exist, or the timeout is not positive.
    RunError
        If the log cannot be opened, or the child cannot be started though its program exists.
    """
    if not command:
        raise InputError("command: empty, expected a program and its arguments")
    if not cwd.is_dir():
        raise InputError(f"cwd = {cwd}: not a folder")
    if timeout is not None:
        positive("timeout", timeout, unit="s")
    begin, deadline = time.monotonic(), None if timeout is None else awake() + timeout
    descriptor = open_log(log)
    try:
        # Isolated programs of one rank share the name of Open MPI's session folder: the first that ends would remove
        # it under another that is just starting.
        with held_scratch() as (session, holding):
            environment = {**(solver_environment() if env is None else env), "OMPI_MCA_orte_tmpdir_base": str(session)}
            output = _Output(descriptor, on_line)
            child = start(command, cwd, environment, descriptor, (*pass_fds, *holding))
            if child is None:
                return result("not_installed", None, 0.0, begin, (), command)
            status, code, cpu, stopped = _watch(child, output, deadline, grace)
            output.finish()
    finally:
        os.close(descriptor)
    if code == _NOT_FOUND:
        status = "not_installed"
    return replace(result(status, code, cpu, begin, output.last, command), stopped=stopped)


class _Output:
    """Follows the log that the child writes: no pipe, so the child never waits for kncal, nor dies with a pipe."""

    def __init__(self, descriptor: int, on_line: Callable[[str], None] | None) -> None:
        self.last: deque[str] = deque(maxlen=_KEPT_LINES)
        self._descriptor = descriptor
        self._on_line = on_line
        self._offset = 0
        self._rest = b""
        self._skipping = False  # inside a line whose beginning was already handed on

    def poll(self) -> bool:
        """Hand on what was written since; return whether there may be more."""
        block = os.pread(self._descriptor, _BLOCK, self._offset)
        self._offset += len(block)
        *lines, rest = (self._rest + block).split(b"\n")
        self._rest = b""
        for line in lines:
            self._emit(line)
            self._skipping = False
        if len(rest) > MAX_LINE:
            self._emit(rest)
            self._skipping = True
        elif not self._skipping:
            self._rest = rest
        return len(block) == _BLOCK

    def finish(self) -> None:
        while self.poll():
            pass
        if self._rest:
            self._emit(self._rest)

    def _emit(self, line: bytes) -> None:
        if self._skipping:
            return
        text = decode_line(line)
        self.last.append(text)
        if self._on_line is not None:
            self._on_line(text)


def open_log(log: Path) -> int:
    """Open the file that gets a child's output, emptied; `RunError` if it cannot be."""
    flags = os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        return os.open(log, flags, 0o644)
    except OSError as error:
        hint = "it is a symbolic link; remove it" if log.is_symlink() else error.strerror
        raise RunError(f"{log}: cannot be opened as the log ({hint})") from error


def death_guard() -> tuple[str, ...]:
    """Return the words before a command that make it die with the thread that starts it, where ``setpriv`` exists."""
    # Without it a killed kncal leaves an orphan that goes on writing into the folder. A signal on the parent's
    # death can only be asked for in the child itself, and code run there between fork and exec (preexec_fn) is
    # unsafe in a program with threads; setpriv does it after the exec.
    setpriv = shutil.which("setpriv")
    return (setpriv, "--pdeathsig", "KILL", "--") if setpriv else ()


def start(
    command: Sequence[str], cwd: Path, environment: Mapping[str, str], output: int, pass_fds: Sequence[int]
) -> subprocess.Popen[bytes] | None:
    """Start a child in a process group of its own, with no shell and no input; None if there is no such program.

    Raises
    ------
    RunError
        If it cannot be started though its program exists.
    """
    program = command[0]
    if os.sep in program:
        program = str((cwd / program).absolute())
    found = shutil.which(program, path=environment.get("PATH", os.defpath))
    if found is None:
        return None
    try:
        with shielded_start():
            return subprocess.Popen(  # noqa: S603 - a list of arguments, no shell
                [*death_guard(), found, *command[1:]],
                cwd=cwd,
                env=dict(environment),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                process_group=0,
                pass_fds=pass_fds,
            )
    except (OSError, ValueError) as error:
        raise RunError(f"{found}: cannot be started ({error})") from error


def _watch(
    child: subprocess.Popen[bytes], output: _Output, deadline: float | None, grace: float
) -> tuple[str, int, float, bool]:
    """Wait for the end, ending the child if need be: status, code as of `Popen.returncode`, CPU seconds, stopped."""
    status, stopped = "exited", False
    try:
        if not wait_for(child.pid, deadline, output):
            stopped = is_stopped(child.pid)
            status = "interrupted" if _end(child.pid, grace) else "timed_out"
    except KeyboardInterrupt:
        status = "interrupted"
        _end(child.pid, grace)
    except BaseException:
        _end(child.pid, grace)
        reap(child)
        raise
    code, cpu = reap(child)
    return status, code, cpu, stopped


def wait_for(pid: int, deadline: float | None, output: _Output | None) -> bool:
    """Wait until the child has ended (it stays a zombie, so its number stays its own) or the deadline is over."""
    pause = 0.002
    while True:
        ended = os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
        more = False
        if output is not None:
            more = output.poll()
            check_stop()
        if ended:
            return True
        if deadline is not None and awake() >= deadline:
            return False
        if not more:
            left = pause if deadline is None else min(pause, max(deadline - awake(), 0.0))
            time.sleep(left)
            pause = min(1.5 * pause, 0.05)


def _end(pid: int, grace: float) -> bool:
    """End the group; return whether Ctrl-C cut the waiting short.

    TERM lets LIGGGHTS finish its step and close its files, the second TERM ends it at once.
    """
    hurried = False
    try:
        for _ in range(2):
            signal_group(pid, signal.SIGTERM)
            signal_group(pid, signal.SIGCONT)  # one that is stopped would not see it
            if wait_for(pid, awake() + grace, None):
                break
    except KeyboardInterrupt:
        hurried = True
    signal_group(pid, signal.SIGKILL)
    return hurried


def reap(child: subprocess.Popen[bytes]) -> tuple[int, float]:
    """Collect the ended child, after killing what it may have left in its group."""
    signal_group(child.pid, signal.SIGKILL)
    _, state, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(state)
    return child.returncode, usage.ru_utime + usage.ru_stime


def signal_name(number: int) -> str:
    """Return what a signal is called."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def signal_group(pid: int, number: int) -> None:
    """Send a signal to a child and all in its group."""
    try:
        os.killpg(pid, number)
    except ProcessLookupError:
        return  # all of it has gone


def is_stopped(pid: int) -> bool:
    """Return whether a process, or one that it started, is stopped (SIGSTOP, a debugger) without having ended."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()[0]
        threads = list(Path(f"/proc/{pid}/task").glob("*/children"))
        children = [int(child) for path in threads for child in path.read_text(encoding="ascii").split()]
    except OSError:
        return False  # it has gone
    return state in "Tt" or any(map(is_stopped, children))


def result(
    status: str, code: int | None, cpu: float, begin: float, last: Iterable[str], command: Sequence[str]
) -> ProcessResult:
    """Return how a child ended that began at ``begin`` (`time.monotonic`), its code as of `Popen.returncode`."""
    by_signal = code is not None and code < 0
    return ProcessResult(
        status=status,
        returncode=None if by_signal else code,
        signal=-code if code is not None and by_signal else None,
        cpu_seconds=cpu,
        wall_seconds=time.monotonic() - begin,
        last_lines=tuple(last),
        command=tuple(command),
    )
