"""Runs of candidates, kept and read; those that a limit of time stopped also as far as they came."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from threading import Event

from kncal.core.awake import awake
from kncal.core.errors import InputError, ReadError
from kncal.core.mpi import check_fit
from kncal.engines.checkpoint import Checkpoint, last_checkpoint
from kncal.observe.run_data import RunData
from kncal.record.series import read_series
from kncal.runs.folder import read_model_folder, read_result
from kncal.runs.workflow import load
from kncal.scene.plan import plan
from kncal.study.runs import VariantRun, run_variants
from kncal.study.states import WAITING
from kncal.study.trade.trade import Candidate

#: Status of a run that a limit of time stopped.
STOPPED = "timed_out"
#: Starting and stopping the solvers of a run with gas takes about so long, as long as nothing was measured [s].
OVERHEAD = 3.0
#: Spans of a run with less than this share of the longest one say little about its cost.
_LONG = 0.25
#: From so many couplings on a span says what the others will cost.
_OWN = 20


@dataclass(kw_only=True)
class Runs:
    """What was run by one engine; a run that a limit of time stopped continues from its checkpoint when run again.

    Attributes
    ----------
    case, folder, engine, transport, workers : as of `kncal.study.run_variants`
    apart : whether the reference has a folder of its own: two sweeps at a time cannot share one (see `run_beside`)
    ended : name of a candidate -> how its run ended
    data : name -> what was read, of those that completed, or came far enough for averages
    spans : name -> (couplings done, CPU time so far [s]) after each time that it ran, of runs that can be continued
    couplings : name -> couplings of the whole run
    overhead : longest time that starting and stopping a run took beside its own limit [s]
    looking : longest time that reading and observing a run took [s]
    """

    case: str | Path
    folder: Path
    engine: str = "liggghts"
    transport: str = "auto"
    workers: int | None = None
    apart: bool = False
    ended: dict[str, VariantRun] = field(default_factory=dict)
    data: dict[str, RunData] = field(default_factory=dict)
    spans: dict[str, list[tuple[int, float]]] = field(default_factory=dict)
    couplings: dict[str, int] = field(default_factory=dict)
    overhead: float = field(default_factory=lambda: OVERHEAD)
    looking: float = 0.5

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
        own = [c for c in candidates if self.apart and c.how == "reference"]
        for ours, folder in ((own, self.folder / "reference"), ([c for c in candidates if c not in own], self.folder)):
            found = run_variants(
                self.case,
                [candidate.variant for candidate in ours],
                folder,
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
                    self._read(name, run, run.folder)

    def _read(self, name: str, run: VariantRun, folder: Path) -> None:
        """Read what a run left; one that came to a part of its time is read so far."""
        checkpoint = last_checkpoint(folder) if run.status == STOPPED else None
        if not run.completed and checkpoint is None:
            return
        began = awake()
        data = load(folder) if checkpoint is None else load_part(folder)
        if whole := plan(data.model.scene, (data.model.kind,))[data.model.kind].couplings:
            done = (whole, run.cpu_seconds[0]) if checkpoint is None else (checkpoint.coupling, _spent(checkpoint))
            self.couplings[name] = whole
            spans = self.spans.setdefault(name, [])
            if done[0] > (spans[-1][0] if spans else 0):
                spans.append(done)
        with suppress(InputError):  # too short for any average
            _ = data.estimates
            self.data[name] = data
        self.looking = max(self.looking, awake() - began)

    def open(self, candidate: Candidate) -> bool:
        """Return whether a candidate can be run, or continues."""
        ended = self.ended.get(candidate.name)
        return ended is None or ended.status in (WAITING, STOPPED)

    def share(self, name: str) -> float:
        """Return the share of its time that a run came to [-]."""
        if (ended := self.ended.get(name)) is not None and ended.completed:
            return 1.0
        return self.spans[name][-1][0] / self.couplings[name] if self.spans.get(name) else 0.0

    def seconds(self, name: str) -> tuple[float, ...]:
        """Return the CPU times of a run [s]: one per round, or of the whole run as each span of a part gives it.

        The first span, with the start-up, counts only if it is alone; short ones, mostly the solvers' start, do not.
        """
        if (ended := self.ended.get(name)) is not None and ended.completed:
            return ended.cpu_seconds
        spans = self.spans.get(name)
        if not spans:
            return ()
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

        With one worker, one after the other. The reference must be `apart`.
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


def load_part(folder: Path) -> RunData:
    """Read a run with gas as far as it came.

    Raises
    ------
    ReadError
        If the folder is not one, or its files are damaged.
    """
    scene, kind, _ = read_model_folder(folder)
    if not scene.coupled:
        raise ReadError(f"{folder}: the run of a single contact, expected that of a bed")
    series = read_series(folder / "series")
    model = replace(plan(scene, (kind,))[kind], couplings=len(series.t))
    return RunData(model=model, result=read_result(folder), signals=series)


def _spent(checkpoint: Checkpoint) -> float:
    return sum(checkpoint.cost.get(name, 0.0) for name in ("dem", "gas", "exchange"))


def _look(stop: Event, *_: object) -> None:
    """Stop the sweep of this thread as Ctrl-C would, if the others are to stop."""
    if stop.is_set():
        raise KeyboardInterrupt
