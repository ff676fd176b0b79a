"""Runs of a bed in parts: each goes on where it stopped, and what every part cost is kept.

FOLDER/runs/<name>/round-1/<model>/   the study of one candidate (`kncal.study.run_variants`), of one run
FOLDER/runs/<name>/parts.json         its parts: couplings and CPU times, for rates and the spread of costs

All runs have the case's own end time. One that was stopped by the clock holds a checkpoint, and its series so far is
as good as that of a shorter run; the same command goes on from there.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import os
from collections.abc import Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from threading import Event

import numpy as np

from kncal import __version__
from kncal.core.awake import awake
from kncal.core.errors import InterruptedRunError, ReadError
from kncal.core.files import write_json
from kncal.core.records import Count, Inside, Record, Seconds, read_record
from kncal.engines.checkpoint import last_checkpoint
from kncal.observe.bed_compare import BedRunData
from kncal.record.outcome import RunResult
from kncal.record.series import read_series
from kncal.runs.folder import read_model_folder, read_result
from kncal.runs.records import RESULT
from kncal.scene.bed_scene import BedScene
from kncal.scene.model import KINDS, BedModel
from kncal.scene.plan import plan
from kncal.study import VariantRun, run_variants
from kncal.study.trade.base import Candidate

PARTS = "parts.json"
#: Status of a run that a limit of time stopped, and of one that was never begun.
STOPPED, WAITING = "timed_out", "waiting"
#: Starting and stopping the solvers takes about so long, as long as nothing was measured [s].
OVERHEAD = 3.0
#: Parts with fewer couplings than this share of the longest one say little about the cost.
_LONG = 0.25
#: From so many couplings on a run's own rate is used to plan.
_OWN = 20


@dataclass(frozen=True, kw_only=True)
class Part:
    """One part of a run.

    Attributes
    ----------
    first, last : couplings done before and after it
    dem, gas, exchange : CPU time [s]
    wall : wall-clock time, starting and stopping the solvers included [s]
    load : load average of the last minute at its end
    """

    first: int
    last: int
    dem: float
    gas: float
    exchange: float
    wall: float
    load: float

    @property
    def cpu(self) -> float:
        """CPU time of all [s]."""
        return self.dem + self.gas + self.exchange

    @property
    def couplings(self) -> int:
        """Couplings done in it."""
        return self.last - self.first


@dataclass
class Track:
    """What is known of the run of one candidate; changes as it runs.

    Attributes
    ----------
    candidate, model : what is run, and its plan
    folder : of its study; key : a hash of all that the run depends on
    status, message : `WAITING`, `STOPPED`, "completed", "refused", "failed" ...
    run : its model's run folder, once there is one
    parts : what ran, in order
    """

    candidate: Candidate
    model: BedModel
    folder: Path
    key: str
    status: str = WAITING
    message: str = ""
    run: Path | None = None
    parts: list[Part] = field(default_factory=list)

    @property
    def name(self) -> str:
        """Name of the candidate."""
        return self.candidate.name

    @property
    def couplings(self) -> int:
        """Couplings done."""
        return self.parts[-1].last if self.parts else 0

    @property
    def done(self) -> float:
        """Simulated time [s]."""
        return self.couplings * self.model.coupling

    @property
    def length(self) -> float:
        """Simulated time of the whole run [s]."""
        return self.model.couplings * self.model.coupling

    @property
    def open(self) -> bool:
        """Whether it can go on."""
        return self.status in (WAITING, STOPPED)

    @property
    def cpu(self) -> float:
        """CPU time so far [s]."""
        return sum(part.cpu for part in self.parts)

    def whole(self) -> tuple[float, ...]:
        """Return the CPU time of the whole run [s] as each part gives it.

        The first, with the start-up of the bed, counts only if it is alone; short ones, mostly the solvers' start, do
        not.
        """
        parts = self._later() or self.parts
        long = _LONG * max((part.couplings for part in parts), default=0)
        parts = [part for part in parts if part.couplings > long]
        return tuple(part.cpu / part.couplings * self.model.couplings for part in parts)

    def held(self) -> float | None:
        """Return measured over predicted CPU time of what followed the first part [-]; None without enough of both."""
        later = self._later()
        if not later or self.parts[0].couplings < _OWN or not self.parts[0].cpu > 0.0:
            return None
        rate = self.parts[0].cpu / self.parts[0].couplings
        return sum(part.cpu for part in later) / (rate * sum(part.couplings for part in later))

    def _later(self) -> list[Part]:
        return [part for part in self.parts if part.first > 0]

    def add(self, run: VariantRun, wall: float) -> None:
        """Take note of how a part ended."""
        self.status, self.message, self.run = run.status, run.message, run.folder
        if run.folder is not None:
            self._note(*spent(run.folder, run.status, self.model.couplings), wall)
            record = {
                "key": self.key,
                "status": self.status,
                "run": run.folder.relative_to(self.folder).as_posix(),
                "parts": [asdict(part) for part in self.parts],
            }
            write_json(self.folder / PARTS, record)

    def _note(self, couplings: int, cost: Mapping[str, float], wall: float) -> None:
        if couplings <= self.couplings:
            return
        before = {name: sum(getattr(part, name) for part in self.parts) for name in ("dem", "gas", "exchange")}
        self.parts.append(
            Part(
                first=self.couplings,
                last=couplings,
                **{name: max(cost.get(name, 0.0) - value, 0.0) for name, value in before.items()},
                wall=wall,
                load=os.getloadavg()[0],
            )
        )

    def take_up(self) -> None:
        """Find what an earlier start left of this very run."""
        kept = self.folder / PARTS
        if not kept.exists():
            return
        try:
            record = read_record(_Parts, kept)
            parts = [Part(**part.model_dump()) for part in record.parts]
            marks = [0, *(part.last for part in parts)]
            if [part.first for part in parts] != marks[:-1] or any(a >= b for a, b in pairwise(marks)):
                raise ReadError(f"{kept}: parts: expected each to begin where the one before it ended")
        except ReadError as error:
            logging.getLogger("kncal").warning("%s; its CPU times are lost, the runs beside it stay", error)
            return
        run = self.folder / record.run
        if record.key == self.key and marks[-1] <= self.model.couplings and (run / RESULT).is_file():
            self.parts, self.run = parts, run
            self.status = "completed" if record.status == "completed" else STOPPED


class _Part(Record):
    first: Count
    last: Count
    dem: Seconds
    gas: Seconds
    exchange: Seconds
    wall: Seconds
    load: Seconds


class _Parts(Record):
    """``parts.json`` of a candidate."""

    key: str
    status: str
    run: Inside
    parts: list[_Part]


def key_of(case_text: str, candidate: Candidate) -> str:
    """Return a hash of what a candidate's run depends on."""
    variant = candidate.variant
    parts = [__version__, case_text, variant.model, [str(override) for override in variant.point]]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def spent(folder: Path, status: str, couplings: int) -> tuple[int, dict[str, float]]:
    """Return couplings done, of ``couplings``, and CPU times by name [s] of a run, from its result or checkpoint."""
    if status == "completed":
        extra = read_result(folder).extra
        try:
            return extra["couplings"], {name: extra[f"cpu_{name}"] for name in ("dem", "gas", "exchange")}
        except KeyError as error:
            raise ReadError(f"{folder / RESULT}: extra.{error.args[0]}: missing, expected it of a bed") from error
    checkpoint = last_checkpoint(folder, couplings)
    return (0, {}) if checkpoint is None else (checkpoint.coupling, dict(checkpoint.cost))


def load_part(folder: Path) -> BedRunData:
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
    result: RunResult = read_result(folder)
    return BedRunData(model=model, result=result, series=series)


@dataclass(frozen=True, kw_only=True)
class Rates:
    """What runs of a bed cost on this machine, from all parts so far.

    Attributes
    ----------
    step : model -> CPU time of a particle-step [s]
    coupling : CPU time per coupling whatever the number of steps: gas, exchange, LIGGGHTS' new start [s]
    wall : wall-clock over CPU time of a run [-]
    """

    step: Mapping[str, float]
    coupling: float
    wall: float

    def predict(self, model: BedModel) -> float:
        """Return CPU time per simulated second of a run of this model [-]."""
        other = sum(self.step.values()) / len(self.step)
        per_step = self.step.get(model.kind, other) * max(model.scene.particles.count, 1)
        return (per_step * model.steps_per_coupling + self.coupling) / model.coupling


def measured_rates(tracks: list[Track]) -> Rates | None:
    """Return the rates that all parts give together; None without any.

    Particles cost ``a + b steps`` per coupling, b by model: least squares over the parts, none below zero; a is 0
    while all have the same number of steps.
    """
    from scipy.optimize import nnls

    parts = [(track.model, part) for track in tracks for part in track.parts if part.couplings]
    if not parts:
        return None
    number = np.array([part.couplings for _, part in parts], dtype=np.float64)
    steps = np.array([m.steps_per_coupling * max(m.scene.particles.count, 1) for m, _ in parts], dtype=np.float64)
    kinds = [kind for kind in KINDS if any(m.kind == kind for m, _ in parts)]
    columns = [np.where([m.kind == kind for m, _ in parts], steps, 0.0) for kind in kinds]
    if len(set(steps)) > 1:
        columns.append(np.ones(len(parts)))
    dem = np.array([part.dem for _, part in parts])
    weight = np.sqrt(number) / dem.clip(min=1e-9) * number  # of relative errors, more certain the longer the part
    found, _ = nnls(np.stack(columns, axis=1) * weight[:, None], dem / number * weight)
    fixed = float(found[len(kinds)]) if len(columns) > len(kinds) else 0.0
    cpu = sum(part.cpu for _, part in parts)
    return Rates(
        step={kind: float(value) for kind, value in zip(kinds, found, strict=False)},
        coupling=fixed + sum(part.gas + part.exchange for _, part in parts) / float(number.sum()),
        wall=max(sum(part.wall for _, part in parts) / max(cpu, 1e-9), 0.5),
    )


def rate_of(track: Track, rates: Rates | None) -> float:
    """Return wall-clock seconds per simulated second of a run [-]: its own where it ran long enough, else predicted."""
    wall = 1.0 if rates is None else rates.wall
    if track.couplings >= _OWN:
        return track.cpu / track.done * wall
    if rates is None:  # before anything was measured: LIGGGHTS takes some tenths of a microsecond for a particle-step
        rates = Rates(step={"linear": 3e-7, "hertz": 4e-7}, coupling=5e-3, wall=1.0)
    return rates.predict(track.model) * wall


class Lanes:
    """Parts of runs side by side, one per worker; use as a context manager.

    Parameters
    ----------
    case : the case that all are variants of; transport : to the gas; workers : runs at a time
    """

    def __init__(self, case: Path, transport: str, workers: int) -> None:
        self._case, self._transport, self.workers = case, transport, workers
        self._stop = Event()
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="kncal-lane")
        self._going: dict[Future[tuple[VariantRun, float]], tuple[Track, float]] = {}
        #: Longest time that starting and stopping a part took beside its own time limit [s].
        self.overhead = OVERHEAD

    def __enter__(self) -> Lanes:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_rest: object) -> None:
        if kind is not None:
            self._stop.set()
        self._pool.shutdown(wait=True, cancel_futures=True)
        for future, (track, _) in list(self._going.items()):
            if future.done() and not future.cancelled() and future.exception() is None:
                track.add(*future.result())

    @property
    def going(self) -> dict[str, float]:
        """Name -> latest end [s, of `kncal.core.awake`] of what runs now; infinite without a limit."""
        return {track.name: end for track, end in self._going.values()}

    @property
    def free(self) -> int:
        """Workers that have nothing to do."""
        return self.workers - len(self._going)

    def start(self, track: Track, limit: float | None) -> None:
        """Run a track on for ``limit`` [s], or to its end."""
        ends = math.inf if limit is None else awake() + limit + self.overhead
        self._going[self._pool.submit(self._run, track, limit)] = (track, ends)

    def ended(self, seconds: float) -> list[Track]:
        """Wait up to ``seconds`` for a part to end; return the tracks of those that did.

        Raises
        ------
        InterruptedRunError
            If one was interrupted.
        """
        done, _ = wait(self._going, timeout=seconds, return_when=FIRST_COMPLETED)
        tracks = []
        for future in done:
            track, _latest = self._going.pop(future)
            track.add(*future.result())
            tracks.append(track)
            if track.status == "interrupted":
                raise InterruptedRunError("interrupted; run the same command again to go on")
        return tracks

    def _run(self, track: Track, limit: float | None) -> tuple[VariantRun, float]:
        began = awake()
        found = run_variants(
            self._case,
            [track.candidate.variant],
            track.folder,
            transport=self._transport,
            workers=1,
            timeout=limit,
            on_progress=partial(_look, self._stop),
        )
        wall = awake() - began
        run = found[track.name]
        if limit is not None and run.status == STOPPED:
            self.overhead = max(self.overhead, min(wall - limit, 30.0))
        return run, wall


def _look(stop: Event, *_: object) -> None:
    """Stop the sweep of this thread as Ctrl-C would, if the others are to stop."""
    if stop.is_set():
        raise KeyboardInterrupt
