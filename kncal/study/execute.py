"""Running the runs of a sweep: what one run is, and the executor that runs many at a time in this machine's threads.

An executor takes ids and gives futures; a run gets the sweep's folder and its id and returns plain data, so that
another machine can do it as well.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from threading import Event, Lock
from typing import Any, Protocol

from kncal import __version__
from kncal.core.awake import awake
from kncal.core.errors import CaseFileError, InputError, KncalError, ReadError, RunError, SolverMissingError, failure_of
from kncal.core.files import sha256
from kncal.core.lock import FolderInUseError
from kncal.core.mpi import check_fit
from kncal.core.stopping import check_stop, stoppable
from kncal.engines.base import Profile
from kncal.engines.registry import get_engine
from kncal.runs.folder import read_result
from kncal.runs.records import MANIFEST
from kncal.runs.workflow import run_case
from kncal.scene.case_file import kept_identity
from kncal.scene.scene import Scene
from kncal.study.design import Sweep, identity, read_design, run_folder, scene_of
from kncal.study.states import UNREADABLE, read_quickly, read_state, stamps_of
from kncal.study.table import Row, ended_rows, failed_rows

#: A folder that is still taken when its run starts (by a solver that is just ending) is waited for so long [s].
PATIENCE = 15.0

#: What a run returns: ``id``, ``status``, ``class``, ``message``, ``stamps`` (see `kncal.study.states`), ``rows``.
Record = dict[str, Any]


class Executor(Protocol):
    """What a sweep needs of whatever runs its runs."""

    @property
    def running(self) -> int:
        """Number of runs that are going on."""
        ...

    def submit(self, folder: Path, run: str) -> Future[Record]:
        """Take on `execute_run` of one run; its future never holds an error of the run itself."""
        ...

    def stop(self) -> None:
        """Drop what waits, end what goes on (in order: results are kept), and return when all has ended."""
        ...

    def close(self) -> None:
        """Free what the executor holds, after its last run."""
        ...


class ThreadExecutor:
    """Runs in threads of this process, each waiting for its solver to the end (the solver dies with its thread).

    Parameters
    ----------
    workers : int, optional
        Runs at a time; default: as many as there are cores for.
    ranks, oversubscribe :
        Of each run; see `kncal.core.mpi.check_fit`.
    """

    def __init__(self, workers: int | None = None, *, ranks: int = 1, oversubscribe: bool = False) -> None:
        if workers is not None and not 1 <= workers <= 4096:
            raise InputError(f"workers = {workers}: expected 1 to 4096")
        self.workers = check_fit(workers, ranks, oversubscribe=oversubscribe)
        self._pool = ThreadPoolExecutor(self.workers, thread_name_prefix="kncal-run")
        self._stop, self._lock, self._running = Event(), Lock(), 0

    @property
    def running(self) -> int:
        """Number of runs that are going on."""
        return self._running

    def submit(self, folder: Path, run: str) -> Future[Record]:
        """See `Executor.submit`."""
        return self._pool.submit(self._execute, folder, run)

    def stop(self) -> None:
        """See `Executor.stop`."""
        self._stop.set()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def close(self) -> None:
        """See `Executor.close`."""
        self._pool.shutdown(wait=True)

    def _execute(self, folder: Path, run: str) -> Record:
        self._count(1)
        try:
            return execute_run(folder, run, self._stop)
        finally:
            self._count(-1)

    def _count(self, change: int) -> None:
        with self._lock:
            self._running += change


def execute_run(folder: Path, run: str, stop: Event | None = None) -> Record:
    """Run one run of the sweep in ``folder`` and return what became of it, as plain data.

    A model that has its result already is not run again. Nothing is raised: an error is this run's failure.
    ``stop``, once set, ends the run as Ctrl-C would.
    """
    folder = Path(folder)
    try:
        sweep = read_design(folder)
    except KncalError as error:
        return {"id": run, "status": "failed", "class": "bad-input", "message": str(error), "stamps": {}, "rows": []}
    try:
        with stoppable(stop):
            scene = scene_of(folder, sweep, run)
            _run(sweep, scene, run_folder(folder, run))
        return ended(sweep, folder, run)
    except KeyboardInterrupt:
        failure = ("interrupted", "interrupted", "stopped by the user before its solver started")
    except Exception as error:  # whatever it is, it is the failure of this run, and of no other
        failure = _failure(error)
    return failed(sweep, folder, run, *failure)


def ended(sweep: Sweep, folder: Path, run: str) -> Record:
    """Return the record of a run that left results.

    Raises
    ------
    ReadError
        If they cannot be read.
    """
    rows = ended_rows(sweep, folder, run)
    out = run_folder(folder, run)
    return {"id": run, **read_state(sweep, out, stamps_of(sweep, out)), "rows": rows}


def failed(sweep: Sweep, folder: Path, run: str, status: str, failure: str, message: str) -> Record:
    """Return the record of a run that ended by an error, not by a result."""
    rows: list[Row] = failed_rows(sweep, run, status, failure, message)
    stamps = stamps_of(sweep, run_folder(folder, run))
    return {"id": run, "status": status, "class": failure, "message": message, "stamps": stamps, "rows": rows}


def present(sweep: Sweep, profile: Profile | None) -> dict[str, Any]:
    """Return what the manifests of a sweep's runs must say, if they are of this kncal and of the solver here.

    ``profile`` is that of the sweep's engine; None if the runs are done elsewhere, by whatever solver is there.
    """
    wanted: dict[str, Any] = {"kncal": __version__, "engine": sweep.engine, "ranks": sweep.ranks}
    if profile is not None:
        digest = sha256(profile.program) if profile.program else ""
        wanted["solver"] = {"version": profile.version, "sha256": digest}
    return wanted


def finished(sweep: Sweep, folder: Path, run: str, wanted: Mapping[str, Any]) -> bool:
    """Return whether a run has valid results of all its models: completed, of these inputs, with its files intact.

    ``wanted`` is from `present`. It is what `kncal.runs.resume.look_back` asks for, but without rendering: the case,
    the engine and the version of kncal give the solver's input.
    """
    out = run_folder(folder, run)
    if len(stamps_of(sweep, out)) < len(sweep.models):
        return False
    try:
        if identity(sweep, kept_identity(out)) != run:
            return False
        if not all(_holds(wanted, read_quickly(f"{out}/{kind}/{MANIFEST}")) for kind in sweep.models):
            return False
        return all(read_result(out / kind).status == "completed" for kind in sweep.models)
    except UNREADABLE:  # ReadError is a ValueError
        return False


def _holds(wanted: Mapping[str, Any], found: Mapping[str, Any]) -> bool:
    return all(
        _holds(value, found[key]) if isinstance(value, Mapping) else found[key] == value
        for key, value in wanted.items()
    )


def _run(sweep: Sweep, scene: Scene, out: Path) -> None:
    out.parent.mkdir(exist_ok=True)
    deadline = awake() + PATIENCE
    while True:
        try:
            _run_case(sweep, scene, out)
        except FolderInUseError:
            if awake() > deadline:
                raise
            check_stop()
            time.sleep(0.05)
        else:
            return


def _run_case(sweep: Sweep, scene: Scene, out: Path) -> None:
    run_case(
        scene,
        get_engine(sweep.engine, sweep.transport, ranks=sweep.ranks, oversubscribe=sweep.oversubscribe),
        out,
        sweep.models,
        timeout=sweep.timeout,
        beyond=sweep.beyond,
        progress_for=lambda _: _look_for_stop,
    )


def _look_for_stop(_done: int, _total: int) -> None:
    check_stop()


#: Error -> (status, class), the special before the general.
_CLASSES: tuple[tuple[type[Exception], str, str], ...] = (
    (SolverMissingError, "not_installed", "not-installed"),
    (FolderInUseError, "failed", "in-use"),
    (CaseFileError, "failed", "bad-input"),
    (InputError, "failed", "bad-input"),
    (ReadError, "failed", "damaged-result"),
    (OSError, "failed", "os-error"),
    (KncalError, "failed", "run-failed"),
    (MemoryError, "failed", "out-of-memory"),
    (Exception, "failed", "internal-error"),
)


def _failure(error: Exception) -> tuple[str, str, str]:
    """Return status, class and message of an error."""
    status, failure = next((status, name) for kind, status, name in _CLASSES if isinstance(error, kind))
    if failure_of(error) == "disk-full" or (isinstance(error, RunError) and failure == "run-failed"):
        failure = failure_of(error)
    text = str(error) or type(error).__name__
    if failure == "internal-error":
        text = f"{type(error).__name__}: {text}"
    return status, failure, text
