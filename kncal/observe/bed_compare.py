"""Linear against Hertz in a bed: two chaotic runs, so averages with uncertainties are compared, never histories."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.core.errors import InputError, RunError
from kncal.observe.averages import BedObservations, observe_bed, voidage_difference
from kncal.observe.bed_cost import BedCost, bed_cost, bed_speed
from kncal.observe.bed_rows import BedRow, judge, judge_field, row_order
from kncal.observe.bed_verdict import sentences
from kncal.observe.cost import Speed
from kncal.observe.invariants import Invariant, invariants
from kncal.observe.known import KnownAnswer, known_answers
from kncal.observe.quantities import Quantities, quantities
from kncal.record.outcome import RunResult
from kncal.record.series import BedSeries
from kncal.scene.model import BedModel

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, kw_only=True)
class BedRunData:
    """One completed bed run.

    Attributes
    ----------
    model : BedModel
    result : RunResult; ``extra`` holds what `kncal.observe.bed_cost.EXTRA` names
    series : BedSeries
    """

    model: BedModel
    result: RunResult
    series: BedSeries


@dataclass(frozen=True, kw_only=True)
class ObservedRun:
    """A bed run and what was seen of it; made by `observed`."""

    data: BedRunData
    seen: BedObservations
    found: Quantities


def observed(data: BedRunData) -> ObservedRun:
    """Observe a run after its start-up: ``run.discard`` of its scene, or as detected.

    Raises
    ------
    InputError
        If it is too short for any average.
    """
    scene = data.model.scene
    seen = observe_bed(data.series, scene.run.discard, scene.gas)
    return ObservedRun(data=data, seen=seen, found=quantities(data.series, seen))


def rows_between(
    a: ObservedRun, b: ObservedRun, limits: Mapping[str, float], names: tuple[str, str] = ("linear", "hertz")
) -> tuple[BedRow, ...]:
    """Return one row per quantity of two runs of a bed; ``b`` is the reference, ``names`` are theirs in texts.

    ``limits``: metric -> largest allowed abs(difference) [-].
    """
    fields = {"eps_g"} if not b.found.why_not("eps_g") else set()
    metrics = sorted({*a.found.sides, *b.found.sides, *limits, *fields}, key=row_order)
    return tuple(
        _field_row(a, b, limits.get(name))
        if name in fields
        else judge(name, a.found.side(name), b.found.side(name), limits.get(name), names)
        for name in metrics
    )


@dataclass(frozen=True, kw_only=True)
class BedComparison:
    """The verdict on two bed runs; made by `compare_beds`.

    Attributes
    ----------
    linear, hertz : BedRunData
    observations : (linear, hertz)
    rows : one BedRow per quantity
    invariants : what must hold in each run, with its limit
    known : each run against the answers that theory gives, where it gives any
    costs : (linear, hertz)
    speed : of the particle side, Hertz over linear
    total_speed : CPU time of all processes, Hertz over linear; None if too short to tell
    """

    linear: BedRunData
    hertz: BedRunData
    observations: tuple[BedObservations, BedObservations]
    rows: tuple[BedRow, ...]
    invariants: tuple[Invariant, ...]
    known: tuple[KnownAnswer, ...]
    costs: tuple[BedCost, BedCost]
    speed: Speed
    total_speed: float | None

    @property
    def judged(self) -> tuple[BedRow, ...]:
        """The rows with a tolerance."""
        return tuple(r for r in self.rows if r.tolerance is not None)

    @property
    def _verdicts(self) -> set[str]:
        return {r.verdict for r in self.judged} | {k.verdict for k in self.known}

    @property
    def within(self) -> bool:
        """Whether every row with a tolerance is within it for certain, and every known answer is met."""
        return self._verdicts <= {"ok"}

    @property
    def state(self) -> str:
        """The verdict in a word: "outside", "undecided", "within", or "open" if no row has a tolerance.

        A known answer that is missed, or perhaps missed, makes it "outside" or "undecided" whatever the rows say.
        """
        verdicts = self._verdicts
        if verdicts & {"outside", "missing"}:
            return "outside"
        if "undecided" in verdicts:
            return "undecided"
        return "within" if self.judged else "open"

    @property
    def needed_end_time(self) -> float | None:
        """run.end_time that would decide all undecided rows [s]; None if there is none, or it is out of reach."""
        times = [r.needed_end_time for r in self.rows if r.verdict == "undecided"]
        known = [t for t in times if t is not None]
        return max(known) if known and len(known) == len(times) else None

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict in words: the judgement, what was saved, then what to keep in mind."""
        return sentences(
            (self.linear.model, self.hertz.model),
            self.rows,
            self.invariants,
            self.known,
            self.costs,
            (self.speed, self.total_speed),
            self.observations,
        )

    def row(self, metric: str) -> BedRow:
        """Return the row of ``metric``; raises `InputError` if there is none."""
        for row in self.rows:
            if row.metric == metric:
                return row
        raise InputError(f"metric = {metric!r}: expected one of {', '.join(r.metric for r in self.rows)}")

    def to_dict(self) -> dict[str, Any]:
        """Everything but the series, as plain JSON types (no NaN)."""
        scene = self.hertz.model.scene
        runs = zip((self.linear, self.hertz), self.observations, strict=True)
        return {
            "case": scene.name,
            "title": scene.title,
            "within": self.within,
            "state": self.state,
            "needed_end_time": self.needed_end_time,
            "verdict": list(self.sentences),
            "rows": [asdict(r) for r in self.rows],
            "invariants": [asdict(i) for i in self.invariants],
            "known": [asdict(k) for k in self.known],
            "theory": {
                data.model.kind: _theory(seen)
                for data, seen in zip((self.linear, self.hertz), self.observations, strict=True)
            },
            "costs": [asdict(c) for c in self.costs],
            "speed": {**asdict(self.speed), "caveats": list(self.speed.caveats), "total": self.total_speed},
            "averaged": {
                data.model.kind: {"begin": seen.begin, "begin_by": seen.begin_by, "end": float(data.series.t[-1])}
                for data, seen in runs
            },
            "models": {
                data.model.kind: {"–".join(pair): asdict(c) for pair, c in data.model.named.items()}
                for data in (self.linear, self.hertz)
            },
        }

    def to_frame(self) -> pd.DataFrame:
        """One row per quantity; the columns are the fields of `BedRow`."""
        import pandas as pd

        return pd.DataFrame([asdict(r) for r in self.rows], columns=list(BedRow.__dataclass_fields__))


def compare_beds(linear: BedRunData, hertz: BedRunData, tolerances: Mapping[str, float] | None = None) -> BedComparison:
    """Compare a linear run with a Hertz run of the same bed.

    Each run is averaged after its own start-up (``run.discard`` of its scene, or as detected). A difference is called
    one if it is larger than its uncertainty, the half-width of its 95 % confidence interval. A tolerance is met if
    the whole interval is within it; see `kncal.observe.bed_rows.judge`.

    Parameters
    ----------
    linear, hertz : BedRunData
    tolerances : metric -> largest allowed abs(difference) [-]; None: those of the Hertz run's scene. One for a
        metric that cannot be computed makes the comparison fail.

    Raises
    ------
    RunError
        If a run did not complete, or its result has no split of the cost.
    InputError
        If the runs are not of the same bed, too short for any average, or a tolerance is not a finite number >= 0.
    """
    for kind, data in (("linear", linear), ("hertz", hertz)):
        if data.result.status != "completed":
            raise RunError(
                f"the {kind} run in {data.result.folder} ended as {data.result.status!r}"
                f" ({data.result.message or 'no message'}): only completed runs can be compared; run it again"
            )
    _same_bed(linear, hertz)
    limits = dict(hertz.model.scene.tolerances if tolerances is None else tolerances)
    for name, limit in limits.items():
        if isinstance(limit, bool) or not isinstance(limit, int | float) or not 0.0 <= limit < np.inf:
            raise InputError(f"tolerances: {name} = {limit!r}: expected a finite number >= 0, 0.05 means 5 %")
    seen_l, seen_h = observed(linear), observed(hertz)
    costs = (bed_cost(linear.model, linear.result), bed_cost(hertz.model, hertz.result))
    saved, total = bed_speed(*costs)
    return BedComparison(
        linear=linear,
        hertz=hertz,
        observations=(seen_l.seen, seen_h.seen),
        rows=rows_between(seen_l, seen_h, limits),
        invariants=invariants((linear.series, hertz.series), (seen_l.found, seen_h.found)),
        known=tuple(
            answer
            for data, run in ((linear, seen_l), (hertz, seen_h))
            for answer in known_answers(data.model.kind, run.seen, data.model.scene.gas)
        ),
        costs=costs,
        speed=saved,
        total_speed=total,
    )


def _theory(seen: BedObservations) -> dict[str, Any]:
    """What is compared with a theory, as plain numbers: of single particles, frozen beds and ramps."""
    curve = None
    if seen.curve is not None:
        curve = asdict(seen.curve)
        for branch in (curve["rising"], curve["falling"]):
            branch |= {name: branch[name].tolist() for name in ("U_0", "drop")}
    return {
        "final": None if seen.final is None else asdict(seen.final),
        "plateaus": [asdict(p) for p in seen.plateaus],
        "curve": curve,
    }


def _field_row(a: ObservedRun, b: ObservedRun, tolerance: float | None) -> BedRow:
    first, second = a.data.series, b.data.series
    end = float(max(first.t[-1], second.t[-1]))
    try:
        rms, noise = voidage_difference(first, second, a.seen.begin, b.seen.begin)
    except InputError as error:
        return judge_field("eps_g", None, 0.0, tolerance, end, str(error))
    return judge_field("eps_g", rms, noise, tolerance, end)


def _same_bed(linear: BedRunData, hertz: BedRunData) -> None:
    a, b = linear.model.scene, hertz.model.scene
    differing = [name for name in ("column", "particles", "gas", "gravity") if getattr(a, name) != getattr(b, name)]
    if differing:
        raise InputError(
            f"the runs in {linear.result.folder} and {hertz.result.folder} differ in their {', '.join(differing)}:"
            " only runs of the same bed can be compared"
        )
