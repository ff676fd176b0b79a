"""One solver process that is talked to through a socket: start, command and answer, end. No wait without a limit."""

from __future__ import annotations

import os
import secrets
import shutil
import signal
import socket
import struct
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

from kncal.core.awake import LOOK, awake
from kncal.core.errors import RunError, SolverMissingError
from kncal.core.files import decode_line
from kncal.core.mpi import started_as
from kncal.core.process import ProcessResult, is_stopped, open_log, reap, result, signal_group, start, wait_for
from kncal.core.scratch import held_scratch
from kncal.core.stopping import check_stop

#: Longest message [bytes].
MAX_MESSAGE = 1 << 16
_CONNECT = 120.0  # s that ranks may take to start
_GRACE = 10.0  # s that a solver may take to end once it was asked, or once its socket has closed
_CLOCK = os.sysconf("SC_CLK_TCK")
_LOG_LIMIT = 16 << 20  # bytes; a long run would write gigabytes
_KEPT, _KEPT_LINES = 1 << 15, 50  # bytes and lines from the end of the log that are searched for last words


class PeerLostError(RunError):
    """The solver has ended without an answer; ``result`` says how."""

    def __init__(self, result: ProcessResult) -> None:
        super().__init__(f"{result.command[0]} did not answer")
        self.result = result


class SolverProcess:
    """A child that answers messages: commands go to it, one answer comes back for each.

    It dies with the thread that started it, also if that is killed (where ``setpriv`` exists), and sees the end of
    the socket otherwise. Its log is cut when it becomes too long: the part before is kept in ``<log>.before``.

    Parameters
    ----------
    name : of the program, for errors
    command : sequence of str
    cwd, log : Path
        Folder to run in; file that gets its output (replaced; a symbolic link is refused).
    environment : mapping
        The whole environment, but for ``variable``.
    variable : str
        Set to "<descriptor of the socket> <descriptor>".
    descriptor : int
        Of the shared memory, inherited.
    pass_fds : sequence of int
        More descriptors that it inherits.
    ranks : int
        Processes that share the work; of several the first talks for all. Their launcher hands no descriptor on, so
        ``variable`` then is "<name of a socket> <path of the memory>".
    oversubscribe : bool
        Allow more ranks than cores.

    Raises
    ------
    SolverMissingError
        If there is no such program.
    RunError
        If the log cannot be opened or the program cannot be started.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        *,
        cwd: Path,
        log: Path,
        environment: Mapping[str, str],
        variable: str,
        descriptor: int,
        pass_fds: Sequence[int] = (),
        ranks: int = 1,
        oversubscribe: bool = False,
    ) -> None:
        self.log, self._name, self._command = log, name, tuple(command)
        self._begin = time.monotonic()
        self._result: ProcessResult | None = None
        self._cpu = 0.0
        with ExitStack() as held:
            self._log = open_log(log)
            held.callback(os.close, self._log)
            session, holding = held.enter_context(held_scratch())  # see `kncal.core.process.run_process`
            how = held.enter_context(started_as(command, ranks, environment, oversubscribe=oversubscribe))
            own = how.environment | {"OMPI_MCA_orte_tmpdir_base": str(session)}
            descriptors = (*holding, *how.descriptors, *pass_fds)
            if ranks == 1:
                self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                held.enter_context(self._socket)
                with theirs:
                    inherited = (theirs.fileno(), descriptor)
                    own[variable] = f"{inherited[0]} {inherited[1]}"
                    child = start(how.command, cwd, own, self._log, (*inherited, *descriptors))
            else:
                # Abstract: no file that could be left, or be in the way.
                listener = held.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
                listener.bind(f"\0kncal-{secrets.token_hex(16)}")
                listener.listen(1)
                own[variable] = f"{listener.getsockname()[1:].decode()} /proc/{os.getpid()}/fd/{descriptor}"
                child = start(how.command, cwd, own, self._log, descriptors)
                if child is not None:
                    self._socket = held.enter_context(_accepted(listener, child.pid))
            if child is None:
                raise SolverMissingError(f"{how.command[0]} is not installed (no such program on PATH)")
            self._child, self._held = child, held.pop_all()

    @property
    def pid(self) -> int:
        """Process number of the solver."""
        return self._child.pid

    @property
    def ended(self) -> bool:
        """Whether the solver has been collected."""
        return self._result is not None

    @property
    def cpu_seconds(self) -> float:
        """User and system time so far [s]; while it lives in steps of the kernel's clock (10 ms)."""
        if self._result is not None:
            return self._result.cpu_seconds
        try:
            # Behind the name, which may hold anything: state is field 3, user and system time 14 and 15.
            fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return self._cpu
        self._cpu = (int(fields[11]) + int(fields[12])) / _CLOCK
        return self._cpu

    def send(self, message: bytes) -> None:
        """Send a message; a solver that has gone is noticed by `receive`."""
        self._bound_log()
        with suppress(OSError):  # it has gone: waiting for the answer says how
            self._socket.sendall(message)

    def receive(self, limit: float) -> bytes:
        """Wait for the answer, at most ``limit`` seconds; whatever goes wrong, the solver is ended.

        Raises
        ------
        PeerLostError
            If it ended.
        RunError
            If it did not answer in time: "peer-stopped" if a signal had stopped it, "peer-died" if not.
        """
        try:
            if answer := self._answer(limit):
                return answer
        except ConnectionError:
            pass  # the same as the end of what is to be received: it has gone
        except TimeoutError as late:
            try:
                raise self._silent(limit) from late
            finally:
                self.kill()
        except BaseException:  # Ctrl-C: the answer would be taken for that to another command
            self.kill()
            raise
        raise PeerLostError(self.end())

    def _answer(self, limit: float) -> bytes:
        """Return one message, empty if it has closed its end; `TimeoutError` after ``limit`` [s] in which kncal ran."""
        deadline = awake() + limit
        while True:
            self._socket.settimeout(min(max(deadline - awake(), 1e-3), LOOK))
            try:
                return self._socket.recv(MAX_MESSAGE)
            except TimeoutError:
                if awake() >= deadline:
                    raise
                check_stop()

    def _silent(self, limit: float) -> RunError:
        if is_stopped(self.pid):
            return RunError(
                f"{self._name} (process {self.pid}) was stopped from outside (SIGSTOP, or a debugger) and did not go "
                f"on within {limit:.3g} s while kncal ran; kncal has ended it; log: {self.log}",
                "peer-stopped",
            )
        text = f"{self._name} did not answer within {limit:.3g} s, and was ended; log: {self.log}"
        return RunError(text, "peer-died")

    def kill(self) -> ProcessResult:
        """End the solver at once."""
        if self._result is None:
            signal_group(self.pid, signal.SIGKILL)
        return self.end()

    def end(self) -> ProcessResult:
        """Close the socket, which ends the solver, and collect it; one that lingers is killed. May be called twice."""
        if self._result is None:
            self._socket.close()
            try:
                wait_for(self.pid, awake() + _GRACE, None)
            finally:
                code, cpu = reap(self._child)
                self._result = result("exited", code, cpu, self._begin, self.last_lines(), self._command)
                self._held.close()
        return self._result

    def finish(self, message: bytes) -> ProcessResult:
        """Ask the solver to end by itself and collect it; one that does not is killed."""
        if self._result is None:
            self.send(message)
            wait_for(self.pid, awake() + _GRACE, None)
        return self.end()

    def last_lines(self) -> tuple[str, ...]:
        """Return the last lines of the log (at most `_KEPT_LINES`)."""
        size = os.fstat(self._log).st_size
        block = os.pread(self._log, _KEPT, max(size - _KEPT, 0))
        return tuple(decode_line(line) for line in block.rstrip(b"\n").split(b"\n")[-_KEPT_LINES:])

    def _bound_log(self) -> None:
        """Cut the log when it is too long; only while the solver waits, and it appends, so no line is torn."""
        if os.fstat(self._log).st_size > _LOG_LIMIT:
            shutil.copyfile(self.log, self.log.with_name(f"{self.log.name}.before"))
            os.ftruncate(self._log, 0)


def _accepted(listener: socket.socket, pid: int) -> socket.socket:
    """Return the socket of the first rank of ``mpirun``, process ``pid``; one without a peer if there is none."""
    deadline = awake() + _CONNECT
    while awake() < deadline and not os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT):
        listener.settimeout(LOOK)
        try:
            found, _ = listener.accept()
        except TimeoutError:
            check_stop()
            continue
        _, user, _ = struct.unpack("3i", found.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        if user == os.getuid():
            return found
        found.close()
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    theirs.close()
    return ours
