"""Runs of candidates by one engine, kept and read; those of beds also as far as they came."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import Generic, TypeVar

from kncal.core.awake import awake
from kncal.core.errors import InputError, ReadError
from kncal.core.mpi import check_fit
from kncal.engines.checkpoint import last_checkpoint
from kncal.observe.run_data import RunData, observed
from kncal.record.series import read_series
from kncal.runs.folder import read_model_folder, read_result
from kncal.runs.records import RESULT
from kncal.runs.workflow import load
from kncal.scene.bed_scene import BedScene
from kncal.scene.plan import plan
from kncal.study.runs import VariantRun, run_variants
from kncal.study.states import WAITING
from kncal.study.trade.trade import Candidate

#: Status of a run that a limit of time stopped.
STOPPED = "timed_out"
#: Starting and stopping the solvers of a bed takes about so long, as long as nothing was measured [s].
OVERHEAD = 3.0
#: Spans of a run with less than this share of the longest one say little about its cost.
_LONG = 0.25
#: From so many couplings on a span says what the others will cost.
_OWN = 20

D = TypeVar("D")


@dataclass(kw_only=True)
class Runs(Generic[D]):
    """What was run by one engine.

    Attributes
    ----------
    case, folder, engine, transport, workers : as of `kncal.study.run_variants`
    ended : name of a candidate -> how its run ended
    data : name -> what was read, of those that completed (of beds: that came far enough)
    """

    case: str | Path
    folder: Path
    engine: str = "liggghts"
    transport: str = "auto"
    workers: int | None = None
    ended: dict[str, VariantRun] = field(default_factory=dict)
    data: dict[str, D] = field(default_factory=dict)

    @property
    def lanes(self) -> int:
        """Runs at a time."""
        return check_fit(self.workers, 1)

    def run(
        self,
        candidates: Sequence[Candidate],
        rounds: int = 1,
        limit: float | None = None,
        *,
        workers: int | None = None,
        stop: Event | None = None,
        look: bool = False,
    ) -> None:
        """Run candidates, each ``rounds`` times and for at most ``limit`` [s], and read them.

        ``look``: run nothing, read what is there. ``stop``, once set, ends the runs as Ctrl-C would.
        """
        found = run_variants(
            self.case,
            [candidate.variant for candidate in candidates],
            self.folder,
            rounds=rounds,
            engine=self.engine,
            transport=self.transport,
            workers=workers or self.workers,
            timeout=limit,
            on_progress=None if stop is None else partial(_look, stop),
            look=look,
        )
        self.ended |= found
        for name, run in found.items():
            if run.folder is not None:
                self.read(name, run, run.folder)

    def read(self, name: str, run: VariantRun, folder: Path) -> None:
        """Read what a run left."""
        raise NotImplementedError


class ContactRuns(Runs[RunData]):
    """Runs of single contacts."""

    def read(self, name: str, run: VariantRun, folder: Path) -> None:
        """See `Runs.read`."""
        if run.completed:
            self.data[name] = load(folder)


@dataclass(kw_only=True)
class BedRuns(Runs[RunData]):
    """Runs of a bed: one that a limit of time stopped goes on from its checkpoint when it is run again.

    Attributes
    ----------
    spans : name -> (couplings done, CPU time so far [s]) after each time that it ran
    couplings : name -> couplings of the whole run
    overhead : longest time that starting and stopping a run took beside its own limit [s]
    looking : longest time that reading and observing a run took [s]
    """

    spans: dict[str, list[tuple[int, float]]] = field(default_factory=dict)
    couplings: dict[str, int] = field(default_factory=dict)
    overhead: float = field(default_factory=lambda: OVERHEAD)
    looking: float = 0.5

    def read(self, name: str, run: VariantRun, folder: Path) -> None:
        """See `Runs.read`; a run that came to a part of its time is read so far."""
        stopped = run.status == STOPPED and last_checkpoint(folder) is not None
        if not (run.completed or stopped):
            return
        began = awake()
        part = load_part(folder)
        whole = plan(part.model.scene, (part.model.kind,))[part.model.kind].couplings
        self.couplings[name] = whole
        done = spent(folder, run.status, whole)
        spans = self.spans.setdefault(name, [])
        if done[0] > (spans[-1][0] if spans else 0):
            spans.append(done)
        with suppress(InputError):  # too short for any average
            self.data[name] = observed(part)
        self.looking = max(self.looking, awake() - began)

    def open(self, candidate: Candidate) -> bool:
        """Return whether a candidate can be run, or goes on."""
        ended = self.ended.get(candidate.name)
        return ended is None or ended.status in (WAITING, STOPPED)

    def share(self, name: str) -> float:
        """Return the share of its time that a run came to [-]."""
        return self.spans[name][-1][0] / self.couplings[name] if self.spans.get(name) else 0.0

    def whole(self, name: str) -> tuple[float, ...]:
        """Return the CPU time of the whole run [s] as each span of it gives it.

        The first, with the start-up of the bed, counts only if it is alone; short ones, mostly the solvers' start, do
        not. Of a run that completed it is known.
        """
        spans = self.spans.get(name, [])
        if not spans or spans[-1][0] == self.couplings[name]:
            return tuple(cpu for _, cpu in spans[-1:])
        steps = [(b[0] - a[0], b[1] - a[1]) for a, b in zip([(0, 0.0), *spans], spans, strict=False)]
        steps = steps[1:] or steps
        long = _LONG * max(couplings for couplings, _ in steps)
        return tuple(cpu / n * self.couplings[name] for n, cpu in steps if n > long)

    def rates(self, name: str) -> tuple[float, ...]:
        """Return the CPU time per coupling [s] of the first span of a run, and of what followed it."""
        spans = self.spans[name]
        if len(spans) < 2 or spans[0][0] < _OWN or not spans[0][1] > 0.0:
            return ()
        (n, cpu), (last, whole) = spans[0], spans[-1]
        return cpu / n, (whole - cpu) / (last - n)

    def run_beside(self, reference: Candidate, others: Sequence[Candidate], seconds: float, limit: float) -> None:
        """Run the others for ``limit`` each, and the reference on a worker of its own all the time, ``seconds``.

        With one worker, one after the other.
        """
        began, stop = awake(), Event()
        lanes = self.lanes_beside(reference)
        with ThreadPoolExecutor(1, thread_name_prefix="kncal-reference") as pool:
            try:
                if self.open(reference):
                    alone = max(seconds - self.overhead, 1.0)
                    beside = pool.submit(self.run, [reference], 1, alone, workers=1, stop=stop)
                    if self.lanes == 1:
                        beside.result()
                    self.run(others, 1, limit, workers=lanes)
                    beside.result()
                else:
                    self.run(others, 1, limit)
            except BaseException:
                stop.set()
                raise
        late = awake() - began - seconds * (2.0 if self.lanes == 1 and others else 1.0)
        self.overhead = min(max(self.overhead, self.overhead + late), 30.0)

    def lanes_beside(self, reference: Candidate) -> int:
        """Return how many of the others run at a time beside the reference."""
        return max(self.lanes - 1, 1) if self.open(reference) else self.lanes


def spent(folder: Path, status: str, couplings: int) -> tuple[int, float]:
    """Return couplings done, of ``couplings``, and CPU time [s] of a run of a bed, from its result or checkpoint."""
    if status == "completed":
        result = read_result(folder)
        try:
            return result.extra["couplings"], sum(result.extra[f"cpu_{name}"] for name in ("dem", "gas", "exchange"))
        except KeyError as error:
            raise ReadError(f"{folder / RESULT}: extra.{error.args[0]}: missing, expected it of a bed") from error
    checkpoint = last_checkpoint(folder, couplings)
    if checkpoint is None:
        return 0, 0.0
    return checkpoint.coupling, sum(checkpoint.cost.get(name, 0.0) for name in ("dem", "gas", "exchange"))


def load_part(folder: Path) -> RunData:
    """Read a run of a bed as far as it came.

    Raises
    ------
    ReadError
        If the folder is not one, or its files are damaged.
    """
    scene, kind, _ = read_model_folder(folder)
    if not isinstance(scene, BedScene):
        raise ReadError(f"{folder}: the run of a single contact, expected that of a bed")
    series = read_series(folder / "series")
    model = replace(plan(scene, (kind,))[kind], couplings=len(series.t))
    return RunData(model=model, result=read_result(folder), signals=series)


def _look(stop: Event, *_: object) -> None:
    """Stop the sweep of this thread as Ctrl-C would, if the others are to stop."""
    if stop.is_set():
        raise KeyboardInterrupt
