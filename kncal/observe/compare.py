"""A run against its reference, linear against Hertz: the differences, and whether they are within the tolerances.

What belongs to the contact model and what belongs to the time step are kept apart: a single contact has its predicted
discretisation error beside each difference, and the difference of the two exact solutions where they are known. Two
beds are chaotic: their averages are compared, with confidence intervals, never their histories.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.core.errors import InputError, RunError
from kncal.observe.averages import BedObservations
from kncal.observe.cost import Cost, Speed, speed
from kncal.observe.difference import finite, rows_between, scale_of
from kncal.observe.estimate import Estimate
from kncal.observe.invariants import Invariant, invariants
from kncal.observe.known import known_answers
from kncal.observe.row import COLUMNS, Row, needed_end, row_of
from kncal.observe.run_data import RunData
from kncal.observe.verdict import Verdict, verdict
from kncal.scene.limits import no_contact
from kncal.scene.metrics import metric_order
from kncal.scene.model import Plan
from kncal.scene.species import listed

if TYPE_CHECKING:
    import pandas as pd

#: A deviation up to this many times the predicted error counts as explained: the prediction is the worst of
#: sampled sub-step phases, the run has a phase of its own.
PREDICTION_MARGIN = 1.1
#: What two runs of one scene share.
_SCENE = ("materials", "particles", "walls", "gas", "gravity", "periodic", "layer")


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """The verdict on a run and its reference; made by `compare`.

    Attributes
    ----------
    run, reference : RunData of one scene
    rows : one Row per metric
    exact : each run against the exact solution of its own model, where it is known: ``reference`` is exact, the
        width of its ``difference`` the predicted discretisation error, its verdict "ok" if that explains it
    known : each run against the answers that theory gives, where it gives any
    invariants : what must hold in each run, with its limit
    speed : reference over run
    verdict : in words
    """

    run: RunData
    reference: RunData
    rows: tuple[Row, ...]
    exact: tuple[Row, ...]
    known: tuple[Row, ...]
    invariants: tuple[Invariant, ...]
    speed: Speed
    verdict: Verdict

    @property
    def runs(self) -> tuple[RunData, RunData]:
        """The run and its reference."""
        return self.run, self.reference

    @property
    def costs(self) -> tuple[Cost, Cost]:
        """Of the run and its reference."""
        return self.run.cost, self.reference.cost

    @property
    def state(self) -> str:
        """The verdict in a word: "within", "outside", "undecided", or "open" if nothing is judged."""
        return self.verdict.state

    @property
    def within(self) -> bool:
        """Whether every metric with a tolerance is within it for certain, and every known answer is met."""
        return self.state in ("within", "open")

    @property
    def judged(self) -> tuple[Row, ...]:
        """The rows with a tolerance."""
        return tuple(r for r in self.rows if r.tolerance is not None)

    @property
    def needed_end(self) -> float | None:
        """run.until_time that would decide all undecided rows [s]; None if there is none, or it is out of reach."""
        return needed_end(self.rows)

    @property
    def limits(self) -> tuple[str, ...]:
        """What limits the contacts that happened: sentences with their pairs, each once.

        Attraction, which nearly every damped contact has at its end, is none of them.
        """
        return _limits(self.runs)

    def row(self, metric: str) -> Row:
        """Return the row of ``metric``; raises `InputError` if there is none."""
        for row in self.rows:
            if row.metric == metric:
                return row
        raise InputError(f"metric = {metric!r}: expected one of {', '.join(r.metric for r in self.rows)}")

    def to_dict(self) -> dict[str, Any]:
        """Everything but frames and series, as plain JSON types (no NaN); the same keys for every kind of run."""
        scene = self.reference.model.scene
        return {
            "case": scene.name,
            "title": scene.title,
            "within": self.within,
            "state": self.state,
            "needed_end": self.needed_end,
            "verdict": self.verdict.sentence,
            "points": list(self.verdict.points),
            "details": list(self.verdict.details),
            "rows": [r.to_dict() for r in self.rows],
            "exact": [r.to_dict() for r in self.exact],
            "known": [r.to_dict() for r in self.known],
            "invariants": [asdict(i) for i in self.invariants],
            "theory": {r.model.kind: _theory(r.seen) for r in self.runs if r.signals is not None},
            "costs": [{**asdict(c), "total": c.total} for c in self.costs],
            "speed": {**asdict(self.speed), "caveats": list(self.speed.caveats)},
            "windows": {r.model.kind: _window(r) for r in self.runs},
            "models": {r.model.kind: _contacts(r.model) for r in self.runs},
        }

    def to_frame(self) -> pd.DataFrame:
        """One row per metric; the columns are `kncal.observe.row.COLUMNS`."""
        import pandas as pd

        return pd.DataFrame([r.to_dict() for r in self.rows], columns=list(COLUMNS))


def compare(run: RunData, reference: RunData, tolerances: Mapping[str, float] | None = None) -> Comparison:
    """Compare a run, the linear one, with its reference, the Hertz run of the same scene.

    Differences are relative to the reference. Where that is zero (for single contacts: below 1e-12 of the metric's
    natural scale: 1 for ratios, the largest speed for speeds, the extent of the motion for heights, ...) the difference
    is absolute, divided by that scale; ``basis`` says which. ``trajectory`` is the largest distance between the same
    particle in the two runs at equal times, ``trajectory_rms`` its root mean square over time and particles, both
    divided by the extent of the motion: the largest diagonal of a box that holds the path of one particle's centre in
    the reference (by the smallest radius if nothing moves). Between frames the motion is the cubic Hermite interpolant
    of positions and velocities, exact in flight.

    Signals are averaged after the start-up of their run (``run.discard`` of its scene, or as detected). A tolerance is
    met if the whole interval of the difference is within it, see `kncal.observe.row.judge`.

    Parameters
    ----------
    run, reference : of one scene
    tolerances : metric -> largest allowed abs(difference) [-]; None: those of the reference's scene. One for a metric
        that cannot be computed makes the comparison fail.

    Raises
    ------
    RunError
        If a run did not complete, or that of a bed has no split of the cost.
    InputError
        If the runs are not of the same scene, too short for any average, or a tolerance is not a finite number >= 0.
    """
    same = run.model.kind == reference.model.kind
    names = ("run", "reference") if same else (run.model.kind, reference.model.kind)
    for name, data in zip(names, (run, reference), strict=True):
        if data.result.status != "completed":
            raise RunError(
                f"the {name} run in {data.result.folder} ended as {data.result.status!r}"
                f" ({data.result.message or 'no message'}): only completed runs can be compared; run it again"
            )
    _same_scene(run, reference)
    limits = dict(reference.model.scene.tolerances if tolerances is None else tolerances)
    for name, limit in limits.items():
        if isinstance(limit, bool) or not isinstance(limit, int | float) or not 0.0 <= limit < np.inf:
            raise InputError(f"tolerances: {name} = {limit!r}: expected a finite number >= 0, 0.05 means 5 %")
    rows = rows_between(run, reference, limits, names)
    saved = speed(run.cost, reference.cost)
    exact = tuple(row for each in (run, reference) for row in _exact_rows(each))
    known = tuple(answer for each in (run, reference) for answer in known_answers(each))
    kept = invariants(run, reference)
    return Comparison(
        run=run,
        reference=reference,
        rows=rows,
        exact=exact,
        known=known,
        invariants=kept,
        speed=saved,
        verdict=verdict((run, reference), rows, exact, known, kept, saved, _limits((run, reference))),
    )


def _same_scene(run: RunData, reference: RunData) -> None:
    a, b = run.model.scene, reference.model.scene
    differing = [name for name in _SCENE if getattr(a, name) != getattr(b, name)]
    if differing:
        raise InputError(
            f"the runs in {run.result.folder} and {reference.result.folder} differ in their {', '.join(differing)}:"
            " only runs of the same scene can be compared"
        )
    names = [None if each.frames is None else each.frames.names for each in (run, reference)]
    if names[0] != names[1]:
        raise InputError(f"the recorded particles differ: {names[0]} and {names[1]}; expected the same in both runs")


def _exact_rows(data: RunData) -> list[Row]:
    rows, values = [], data.exact or {}
    for name in sorted(values, key=metric_order):
        exact, found = finite(values[name]), data.estimate(name)
        if exact is None:
            kind = data.model.kind
            raise InputError(f"exact solution of the {kind} model: {name} = {values[name]}: expected a finite number")
        scale, basis = scale_of(name, exact, "exact", data)
        deviation = None if found.value is None or scale is None else (found.value - exact) / scale
        predicted = finite((data.predicted or {}).get(name))
        explained = "-"
        if deviation is not None and predicted is not None:
            explained = "ok" if abs(deviation) <= PREDICTION_MARGIN * predicted else "outside"
        row = row_of(
            name,
            found,
            Estimate(value=exact, width=0.0),
            Estimate(value=deviation, width=predicted),
            scale=scale,
            basis=basis,
            verdict=explained,
            model=data.model.kind,
        )
        rows.append(row)
    return rows


def _limits(runs: tuple[RunData, ...]) -> tuple[str, ...]:
    few = [run for run in runs if run.contacts is not None]
    met = {event.pair for data in few for event in data.observations.contacts}
    pairs: dict[str, dict[str, None]] = {}
    for data in few:
        for pair in sorted(met):
            for code, text in data.model.between(*pair).warnings.items():
                if code != "attraction":
                    pairs.setdefault(text, {})["–".join(pair)] = None
    texts = [f"{listed(list(names))}: {text}" for text, names in pairs.items()]
    return (*texts, *([no_contact(*(data.model for data in few))] if few and not met else []))


def _window(run: RunData) -> dict[str, Any]:
    """The times [s] that the numbers of a run are of."""
    if run.signals is not None:
        return {"begin": run.seen.begin, "begin_by": run.seen.window.by, "end": float(run.signals.t[-1])}
    return {"begin": float(run.trajectory.t[0]), "begin_by": "given", "end": float(run.trajectory.t[-1])}


def _theory(seen: BedObservations) -> dict[str, Any]:
    """What is compared with a theory, as plain numbers: of single particles, frozen beds and ramps."""
    final, curve = seen.get("final"), seen.get("curve")
    if curve is not None:
        curve = asdict(curve)
        for branch in (curve["rising"], curve["falling"]):
            branch |= {name: branch[name].tolist() for name in ("U_0", "drop")}
    return {
        "final": None if final is None else asdict(final),
        "plateaus": [asdict(p) for p in seen.get("plateaus") or ()],
        "curve": curve,
    }


def _contacts(model: Plan) -> list[dict[str, Any]]:
    """The contacts for the JSON file; pairs that are alike once, with their number."""
    return [
        {
            "pair": list(model.species.names(pair)),
            "pairs_of_bodies": model.species.meetings(pair),
            **{**asdict(contact), "warnings": dict(contact.warnings)},
        }
        for pair, contact in model.contacts.items()
    ]
