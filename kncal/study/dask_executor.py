"""Runs of a sweep as Dask tasks. A task is told the sweep's folder and an id; results are files in that folder.

The workers must see the folder under the same name. Only a run whose worker died is tried again, after the others, and
no worker is sent more than it can begin at once: a run that kills its worker takes no other run with it.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import dataclass
from pathlib import Path
from threading import Event, RLock, Thread
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from kncal import __version__
from kncal.core.awake import awake
from kncal.core.errors import InputError
from kncal.core.mpi import cores
from kncal.study.dask_workers import DETACHED, GivenScheduler, LocalWorkers, SlurmWorkers, Workers
from kncal.study.design import DESIGN, read_design
from kncal.study.execute import Record, execute_run, failed
from kncal.study.slurm_script import SlurmOptions

if TYPE_CHECKING:
    from distributed import Future as Handle

#: Seconds between two looks at how many workers there are.
_LOOK = 0.5
#: Runs that are told to stop have so long to end (TERM, 2 s, TERM, 2 s, KILL, and what a slow disk takes) [s].
_STOP = 30.0
#: A worker that does not answer is waited for so long [s].
_ANSWER = 5.0
_LOST = "Dask's scheduler was lost; run the same command again"

#: Session -> what stops its runs.
_stops: dict[str, Event] = {}


def perform(folder: str, run: str, version: str, session: str) -> Record | str:
    """Do one run, in a worker; a text says why this worker cannot."""
    here = socket.gethostname()
    if version != __version__:
        return f"the worker on {here} has kncal {__version__}, this is {version}: install the same there"
    place = Path(folder)
    if not (place / DESIGN).is_file():
        return f"the worker on {here} does not see {folder}: a sweep needs a folder that all workers share"
    return execute_run(place, run, _stops.setdefault(session, Event()))


def halt(session: str) -> None:
    """Stop, in a worker, the runs of a session, and let it begin no others."""
    _stops.setdefault(session, Event()).set()


def dask_setup(dask_worker: object) -> None:
    """Take a worker on this machine out of the group that Ctrl-C reaches: the sweep itself ends its runs in order.

    Dask calls it at the start of each worker.
    """
    if os.environ.get(DETACHED):
        os.setpgid(0, 0)


def dask_teardown(dask_worker: object) -> None:
    """End the runs of a worker that closes, in order: its scheduler is gone, or its time is over."""
    for stop in _stops.values():
        stop.set()


@dataclass(eq=False)
class _Task:
    future: Future[Record]
    folder: Path
    run: str
    sent: int = 0

    def fail(self, status: str, failure: str, message: str) -> None:
        self.future.set_result(failed(read_design(self.folder), self.folder, self.run, status, failure, message))


class DaskExecutor:
    """Runs on the workers of a Dask scheduler; see `dask_executor`.

    Nothing is started before the first run is submitted. With one thread per worker a run's memory and its crashes are
    its own.
    """

    def __init__(self, workers: Workers) -> None:
        #: Whether the solver has to be there on other machines than this one.
        self.elsewhere = not workers.here
        self._workers = workers
        self._client: Any = None  # distributed.Client
        self._session = uuid4().hex
        self._lock = RLock()
        self._waiting: deque[_Task] = deque()
        self._live: dict[str, tuple[Handle, _Task]] = {}
        self._slots = 0
        self._stopping, self._closing = False, Event()
        self._watcher = Thread(target=self._watch, name="kncal-dask", daemon=True)

    @property
    def running(self) -> int:
        """Number of runs that were sent to workers and have not ended."""
        return len(self._live)

    def submit(self, folder: Path, run: str) -> Future[Record]:
        """See `kncal.study.execute.Executor.submit`.

        Raises
        ------
        InputError, RunError
            With the first run, if the workers cannot be had.
        """
        folder = folder.absolute()
        if self._client is None:
            self._client = self._workers.start(folder)
            self._watcher.start()
        task = _Task(Future(), folder, run)
        with self._lock:
            self._waiting.append(task)
            self._fill()
        return task.future

    def stop(self) -> None:
        """See `kncal.study.execute.Executor.stop`."""
        with self._lock:
            self._stopping = True
            while self._waiting:
                task = self._waiting.popleft()
                if not task.future.cancel():  # its worker died before
                    task.fail("interrupted", "interrupted", "stopped by the user")
            live = {key: task for key, (_, task) in self._live.items()}
        deadline = awake() + _STOP
        left = {task.future for task in live.values()}
        while left and awake() < deadline and self._connected():
            # again and again: a worker may have been replaced
            _within(_ANSWER, lambda: self._client.run(halt, self._session, on_error="ignore"))
            left = wait(left, timeout=1.0).not_done
        for key, task in live.items():
            if task.future in left:
                self._fail(key, "stopped by the user; its worker did not say how it ended", "interrupted")

    def close(self) -> None:
        """See `kncal.study.execute.Executor.close`."""
        self._closing.set()
        if self._watcher.is_alive():
            self._watcher.join(2 * _ANSWER)
        self._workers.close()

    def _connected(self) -> bool:
        return self._client is not None and self._client.status == "running"

    def _watch(self) -> None:
        """Follow how many workers there are, and whether there is a scheduler still."""
        while not self._closing.wait(_LOOK if self._slots else 0.05):
            if not self._connected():
                self._give_up()
                return
            with contextlib.suppress(OSError, RuntimeError, TimeoutError):  # the next look finds out
                self._workers.mend()
                found, limit = sum(self._client.nthreads().values()), self._workers.limit
                with self._lock:
                    self._slots = found if limit is None else min(found, limit)
                    self._fill()

    def _fill(self) -> None:
        """Send as many runs as the workers can begin now."""
        while self._waiting and not self._stopping and len(self._live) < self._slots and self._connected():
            task = self._waiting.popleft()
            if not task.sent and not task.future.set_running_or_notify_cancel():
                continue
            task.sent += 1
            what = (str(task.folder), task.run, __version__, self._session)
            key = f"kncal-{task.run}-{uuid4().hex}"
            handle = self._client.submit(perform, *what, pure=False, retries=0, key=key)
            self._live[handle.key] = (handle, task)
            handle.add_done_callback(self._ended)

    def _ended(self, handle: Handle) -> None:
        """Take what a task left; called by Dask in a thread of its own."""
        if handle.key not in self._live:
            return
        if handle.status == "finished":
            try:
                found = handle.result(timeout=_STOP)
            except Exception as error:  # whatever it is, it is this run's failure
                self._fail(handle.key, f"its result cannot be had: {_text(error)}")
            else:
                if isinstance(found, str):
                    self._fail(handle.key, found, "worker-unfit")
                elif (task := self._taken(handle.key)) is not None:
                    task.future.set_result(found)
        elif handle.status == "error":
            self._failed(handle)
        else:  # cancelled or lost
            self._fail(handle.key, _LOST)
        with self._lock:
            self._fill()

    def _failed(self, handle: Handle) -> None:
        from distributed.scheduler import KilledWorker

        error = handle.exception(timeout=_STOP)
        if not isinstance(error, KilledWorker):
            text = f"a worker could not run it ({_text(error)}): is the same kncal installed there?"
            self._fail(handle.key, text, "worker-unfit")
            return
        with self._lock:
            _, task = self._live[handle.key]
            if task.sent <= self._workers.retries and not self._stopping:
                del self._live[handle.key]
                self._waiting.append(task)
                self._slots = 0  # until the next look: there is a worker less
                return
        text = f"the worker that ran it died {task.sent + error.allowed_failures} times (memory? time limit?)"
        self._fail(handle.key, text, "killed")

    def _give_up(self) -> None:
        """Let every run that has not ended fail: there is no scheduler any more."""
        with self._lock:
            waiting, self._waiting = list(self._waiting), deque()
        for key in list(self._live):
            self._fail(key, _LOST)
        for task in waiting:
            if task.sent or task.future.set_running_or_notify_cancel():
                task.fail("failed", "peer-died", _LOST)

    def _fail(self, key: str, message: str, failure: str = "peer-died") -> None:
        if (task := self._taken(key)) is not None:
            task.fail("interrupted" if failure == "interrupted" else "failed", failure, message)

    def _taken(self, key: str) -> _Task | None:
        """Return a task that has not ended, once."""
        with self._lock:
            found = self._live.pop(key, None)
        return None if found is None else found[1]


def dask_executor(
    kind: str,
    workers: int | None = None,
    *,
    scheduler: str | None = None,
    options: SlurmOptions | None = None,
) -> DaskExecutor:
    """Return an executor of the usual kinds.

    Parameters
    ----------
    kind : str
        "dask" (workers on this machine, or those of ``scheduler``) or "slurm" (workers in Slurm jobs).
    workers : int, optional
        Runs at a time. Default: a run per core; as many as the workers of ``scheduler`` take.
    scheduler : str, optional
        Address of a Dask scheduler, ``tcp://host:port`` or ``tls://host:port``.
    options : SlurmOptions, optional
        Of the jobs.

    Raises
    ------
    InputError
        If a value is out of range, or the extra (or sbatch) is not installed.
    """
    if workers is not None and not 1 <= workers <= 4096:
        raise InputError(f"workers = {workers}: expected 1 to 4096")
    if kind == "slurm":
        if workers is None:
            raise InputError("--executor slurm needs --workers N, the number of jobs that do runs")
        return DaskExecutor(SlurmWorkers(workers, options or SlurmOptions()))
    if kind != "dask":
        raise InputError(f"executor = {kind!r}: expected dask or slurm")
    if scheduler is not None:
        return DaskExecutor(GivenScheduler(scheduler, workers))
    return DaskExecutor(LocalWorkers(cores() if workers is None else workers))


def _text(error: Any) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"


def _within(seconds: float, action: Callable[[], object]) -> None:
    """Do something that may hang, and wait no longer than so many seconds."""

    def quietly() -> None:
        with contextlib.suppress(Exception):  # the caller sees by the runs themselves what came of it
            action()

    thread = Thread(target=quietly, daemon=True)
    thread.start()
    thread.join(seconds)
