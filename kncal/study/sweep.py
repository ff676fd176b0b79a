"""A sweep from its design to its table: what is done already is kept, the rest is run, and how it stands is told."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from kncal import __version__
from kncal.core.awake import awake
from kncal.core.errors import InputError, InterruptedRunError, ReadError, SolverMissingError
from kncal.core.lock import LOCK, locked, sign
from kncal.engines.base import Profile
from kncal.engines.registry import get_engine
from kncal.scene.case_file import CASE
from kncal.scene.case_text import CaseText
from kncal.study.design import DESIGN, RUNS, Sweep, is_design, read_design, run_folder, write_design
from kncal.study.execute import Executor, Record, ThreadExecutor, ended, finished, present
from kncal.study.states import StatesFile
from kncal.study.table import Row, frame, write_table

#: The table is written about so often while the sweep runs [s], and in at most this share of the time.
TABLE_SECONDS, TABLE_SHARE = 10.0, 0.02
_TICK = 0.5  # s between two looks, where no run ends


@dataclass(frozen=True, kw_only=True)
class SweepProgress:
    """How far a sweep is: numbers of runs, and the time left [s] at the rate so far (None before the first run ended).

    ``kept`` of the ``completed`` ones were completed before this start.
    """

    total: int
    completed: int
    failed: int
    running: int
    kept: int
    left: float | None

    @property
    def done(self) -> int:
        """Completed and failed runs."""
        return self.completed + self.failed


@dataclass(frozen=True, kw_only=True)
class SweepResult:
    """What became of a sweep.

    Attributes
    ----------
    folder, table : of the sweep, and its ``sweep.csv``
    total, completed, kept : number of runs, of completed ones, and of those that were completed before this start
    failures : failure class -> ids of the runs, the most frequent first
    messages : id -> why a run failed
    """

    folder: Path
    table: Path
    total: int
    completed: int
    kept: int
    failures: Mapping[str, tuple[str, ...]]
    messages: Mapping[str, str]


OnProgress = Callable[[SweepProgress], None]


def run_sweep(
    sweep: Sweep,
    case_text: CaseText,
    folder: Path,
    executor: Executor | None = None,
    on_progress: OnProgress | None = None,
) -> SweepResult:
    """Run all runs of a design that have no valid results in ``folder`` yet, and write the table.

    Runs of an earlier design in the same folder stay; those that this one shares with it are not run again. An
    unfinished run starts again (what it left moves to its ``attempt-N``); one with gas continues from its checkpoint.
    Results of another version of kncal or of the solver count as none (runs elsewhere: of kncal alone, as the solver
    there is not known here).

    Parameters
    ----------
    sweep, case_text : from `kncal.study.design.design`
    folder : Path
        New, empty, or that of a sweep.
    executor : Executor, optional
        Default: a `ThreadExecutor` with a run per core. It is closed at the end.
    on_progress : callable, optional
        Called in this thread whenever a run has ended, and about every half second.

    Raises
    ------
    InputError
        If the folder is a file or a link, or holds other things.
    FolderInUseError
        If another process runs a sweep in the folder.
    SolverMissingError
        If the solver is not there; nothing is run then.
    InterruptedRunError
        After Ctrl-C (SIGTERM, SIGHUP): the runs were ended in order, and the table is written.
    """
    executor = ThreadExecutor(ranks=sweep.ranks, oversubscribe=sweep.oversubscribe) if executor is None else executor
    try:
        # other machines have solvers of their own
        profile = None if getattr(executor, "elsewhere", False) else _solver(sweep)
        with _sweep_folder(folder):
            _tell_version(folder)
            write_design(folder, sweep, case_text)
            return _Session(sweep, folder, executor, on_progress, present(sweep, profile)).run()
    finally:
        executor.close()


def prepare_sweep(sweep: Sweep, case_text: CaseText, folder: Path) -> list[str]:
    """Write a design into ``folder`` as `run_sweep` does, without running anything; return the ids left to be run.

    Raises
    ------
    InputError, FolderInUseError
        As `run_sweep`.
    """
    with _sweep_folder(folder):
        _tell_version(folder)
        write_design(folder, sweep, case_text)
        wanted = present(sweep, None)  # the solver is that of the machines that will run them
        return [run for run in sweep.runs if not finished(sweep, folder, run, wanted)]


def _solver(sweep: Sweep) -> Profile:
    engine = get_engine(sweep.engine, sweep.transport, ranks=sweep.ranks, oversubscribe=sweep.oversubscribe)
    profile = engine.profile()
    if profile.program is None:
        raise SolverMissingError(profile.problem)
    return profile


@contextmanager
def _sweep_folder(folder: Path) -> Iterator[None]:
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise InputError(f"{folder}: expected a folder (or nothing yet), not a file or a link; choose another --out")
    _check_ours(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder) as descriptor:
        _check_ours(folder)
        sign(descriptor)
        (folder / RUNS).mkdir(exist_ok=True)
        yield


def _check_ours(folder: Path) -> None:
    if (folder / DESIGN).exists() and not is_design(folder / DESIGN):
        raise InputError(
            f"{folder}: its {DESIGN} is not the design of a sweep of kncal; choose another --out, nothing was changed"
        )
    if folder.is_dir() and not (folder / DESIGN).is_file():
        # before sweep.json is whole, a start that was killed leaves at most these, and the lock in any case
        known = (LOCK, RUNS, CASE) if (folder / LOCK).exists() else ()
        names = [path.name for path in folder.iterdir() if path.name not in known]
        if any(not (known and name.startswith(".") and name.endswith(".part")) for name in names):
            raise InputError(
                f"{folder}: the folder holds files and no {DESIGN}; choose an empty folder with --out, nothing was "
                "changed"
            )


def _tell_version(folder: Path) -> None:
    try:
        before = read_design(folder).kncal
    except ReadError:
        return  # a new sweep, or a design that is replaced now
    if before != __version__:
        logging.getLogger("kncal").warning(
            "kncal: results of kncal %s here are computed again by kncal %s; the old ones stay in attempt-N",
            before,
            __version__,
        )


class _Session:
    """One start of a sweep."""

    def __init__(
        self,
        sweep: Sweep,
        folder: Path,
        executor: Executor,
        on_progress: OnProgress | None,
        wanted: Mapping[str, Any],
    ) -> None:
        self._wanted = wanted
        self._sweep, self._folder, self._executor, self._tell = sweep, folder, executor, on_progress
        self._records: dict[str, Record] = {}
        self._rows: dict[str, list[Row]] = {}
        self._count: Counter[bool] = Counter()  # of runs that completed (True) and did not (False)
        self._kept = 0
        self._started = awake()
        self._next_table = time.monotonic() + TABLE_SECONDS

    def run(self) -> SweepResult:
        todo = [run for run in self._sweep.runs if not self._keep(run)]
        self._kept = len(self._records)
        self._started = awake()
        states = StatesFile(self._folder, [_note(record) for record in self._records.values()])
        try:
            self._run_all(todo, states)
        except KeyboardInterrupt:
            self._write_table()
            done = self._count[True]
            raise InterruptedRunError(
                f"interrupted: {done} of {len(self._sweep.runs)} runs are completed, the table is in "
                f"{self._folder}; run the same command again to continue"
            ) from None
        finally:
            states.close()
        return self._result()

    def _keep(self, run: str) -> bool:
        """Take over a run that has its results already."""
        if not run_folder(self._folder, run).is_dir():
            return False
        if not finished(self._sweep, self._folder, run, self._wanted):
            return False
        self._take(ended(self._sweep, self._folder, run))
        self._progress()
        return True

    def _run_all(self, todo: list[str], states: StatesFile) -> None:
        ended_runs: SimpleQueue[Future[Record]] = SimpleQueue()
        futures: list[Future[Record]] = []
        left = len(todo)
        try:
            for run in todo:
                futures.append(self._executor.submit(self._folder, run))
                futures[-1].add_done_callback(ended_runs.put)
            self._progress()
            while left:
                try:
                    future = ended_runs.get(timeout=_TICK)
                except Empty:
                    pass
                else:
                    left -= 1
                    self._note(future, states)
                self._progress()
                if time.monotonic() > self._next_table:
                    self._write_table()
        except BaseException:
            _without_signals(self._executor.stop)
            while not ended_runs.empty():
                self._note(ended_runs.get(), states)
            raise

    def _note(self, future: Future[Record], states: StatesFile) -> None:
        if not future.cancelled():
            record = future.result()
            self._take(record)
            states.add(_note(record))

    def _take(self, record: Record) -> None:
        self._records[record["id"]] = {key: value for key, value in record.items() if key != "rows"}
        self._rows[record["id"]] = record["rows"]
        self._count[record["status"] == "completed"] += 1

    def _progress(self) -> None:
        if self._tell is None:
            return
        completed, failed = self._count[True], self._count[False]
        new = completed + failed - self._kept
        total = len(self._sweep.runs)
        rate = (awake() - self._started) / new if new else None
        self._tell(
            SweepProgress(
                total=total,
                completed=completed,
                failed=failed,
                running=self._executor.running,
                kept=self._kept,
                left=None if rate is None else rate * (total - completed - failed),
            )
        )

    def _write_table(self) -> Path:
        begin = time.monotonic()
        path = write_table(self._folder, frame(self._sweep, self._rows))
        end = time.monotonic()
        self._next_table = end + max(TABLE_SECONDS, (end - begin) / TABLE_SHARE)
        return path

    def _result(self) -> SweepResult:
        failures: dict[str, list[str]] = {}
        for run, record in self._records.items():
            if record["class"]:
                failures.setdefault(record["class"], []).append(run)
        return SweepResult(
            folder=self._folder,
            table=self._write_table(),
            total=len(self._sweep.runs),
            completed=self._count[True],
            kept=self._kept,
            failures={name: tuple(ids) for name, ids in sorted(failures.items(), key=lambda item: -len(item[1]))},
            messages={run: record["message"] for run, record in self._records.items() if record["class"]},
        )


def _note(record: Record) -> dict[str, object]:
    return {key: record[key] for key in ("id", "status", "class", "message", "stamps")}


def _without_signals(action: Callable[[], None]) -> None:
    """Do what must come to its end: another Ctrl-C does not hurry it (it takes a few seconds at most)."""
    while True:
        try:
            return action()
        except KeyboardInterrupt:
            continue
