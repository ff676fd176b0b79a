"""The trade of a case of single contacts: the builtin engine on every point first, then the solver for the cost.

FOLDER/screening/   builtin engine: every point, and each contact converged in N (the same iteration as LIGGGHTS)
FOLDER/runs/        the solver, in interleaved rounds: the CPU times
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from kncal.core.errors import RenderError
from kncal.observe.compare import RunData
from kncal.observe.softness import secant, signs
from kncal.scene.case_file import load_scene
from kncal.scene.model import KINDS, Model
from kncal.scene.plan import plan
from kncal.scene.scene import Scene
from kncal.study.trade.base import Candidate, ErrorSplit, Tell, Trade, TradeOptions, TradePoint
from kncal.study.trade.budget import Budget
from kncal.study.trade.errors import Reference, metric_errors, split_errors, worst_errors
from kncal.study.trade.points import Contact, contacts
from kncal.study.trade.reference import REFERENCE_STEPS, Ends, converged_steps, ends_of, find_reference
from kncal.study.trade.runs import Runs
from kncal.study.trade.timing import agreement, time_points, time_sentences, timed

#: Of a budget, what screening may take; and runs that are started together under one.
_SCREENING_SHARE, _BATCH = 0.5, 16
#: Kept of a budget for the report: seconds, but at most this share.
_REST, _REST_SHARE = 5.0, 0.1


def trade_contacts(case: str | Path, scene: Scene, folder: Path, options: TradeOptions, tell: Tell) -> Trade:
    """Trade speed for accuracy in a case of single contacts.

    Parameters
    ----------
    case, scene : the case, and what it describes
    folder : of the runs; what it holds already is not run again
    options : with the tolerances to judge by
    tell : told what is done now

    Raises
    ------
    CaseFileError, InputError
        If the case cannot be planned, or its stiffness not be softened.
    RunError
        If the reference does not complete.
    """
    started, load = time.monotonic(), os.getloadavg()[0]
    budget = Budget(None if options.budget is None else options.budget - min(_REST, _REST_SHARE * options.budget))
    reference, tried = contacts(case, options)
    ends = ends_of(case, scene, reference, tried)
    engine = _screening_engine(case, ends, options.engine)
    screened = Runs(case=case, folder=folder / "screening", engine=engine, workers=options.workers)
    tell(f"reference: Hertz, N doubled from {REFERENCE_STEPS[0]:g} on, until it converges")
    found = find_reference(screened, reference, ends, options.tolerances)
    n = found.candidate.steps_per_contact
    candidates = [contact.at(steps, *ends.overrides) for contact in tried for steps in options.steps]
    finest = {kind: converged_steps(_planned(case, kind, ends), found.convergence.threshold, n) for kind in KINDS}
    converged = {contact.name: contact.at(finest[contact.model], *ends.overrides) for contact in tried}
    tell(f"reference: N = {n:g}; screening {len(candidates)} points with the engine {engine}")
    # what tells most first; without the converged contacts there are points, only without the split of their errors
    ranked = [contact.at(steps, *ends.overrides) for contact in sorted(tried, key=_rank) for steps in options.steps]
    _screen(screened, [*ranked, *converged.values()], budget)

    judge = _Judge(
        truth=found.truth,
        data=screened.data,
        converged={c.name: converged[contact.name] for contact in tried for c in _all(contact, options, ends)},
        unsoftened=converged[tried[0].name].name,
        asked=tuple(options.tolerances),
    )
    points = [_point(c, screened, judge) for c in candidates]
    solved = screened
    if engine != options.engine:
        solved = Runs(case=case, folder=folder / "runs", engine=options.engine, workers=options.workers)
    time_points(solved, found.candidate, points, options, scene.run.steps_per_contact, budget, tell)
    why_not = "not timed: the budget was used"
    points = [timed(point, solved, why_not) for point in points]
    top = replace(_bare(found.candidate, found.truth.run), signs=signs(found.truth.run))
    top = timed(top, solved, why_not)
    caveats = [*ends.sentences, *found.sentences, *time_sentences(points, top, options.engine, load)]
    apart = None if solved is screened else agreement(screened, solved, found.truth.names())
    if apart is not None:
        far = "" if apart <= found.convergence.threshold else ", which is too much to judge by: please report it"
        caveats.append(f"Errors are by the engine {engine}; {options.engine} differs by {apart:.1e} at most{far}.")
    return Trade(
        case=scene.name,
        title=scene.title,
        bed=False,
        reference=top,
        convergence=found.convergence,
        points=tuple(points),
        tolerances=dict(options.tolerances),
        splits={p.candidate.name: judge.split(p.candidate) for p in points if p.completed},
        caveats=tuple(caveats),
        options=options,
        wall_seconds=time.monotonic() - started,
    )


def _all(contact: Contact, options: TradeOptions, ends: Ends) -> Iterator[Candidate]:
    for steps in options.steps:
        yield contact.at(steps, *ends.overrides)


def _rank(contact: Contact) -> tuple[bool, float]:
    """Order contacts by what they tell: the unsoftened ones, then those softened step by step, then other methods."""
    ours = contact.how in ("softened", "reduced_modulus") or contact.factor == 1.0
    return not ours, -(contact.factor or 0.0)


def _screening_engine(case: str | Path, ends: Ends, engine: str) -> str:
    """Return "builtin", or the solver for physics that the builtin engine does not have."""
    from kncal.engines.builtin.integrator import check

    try:
        check(_planned(case, "hertz", ends))
    except RenderError:
        return engine
    return "builtin"


def _planned(case: str | Path, kind: str, ends: Ends) -> Model:
    """Return a model of the case itself, whose law, e_n and physics all of its contacts share."""
    return plan(load_scene(case, overrides=ends.overrides), (kind,))[kind]


def _screen(runs: Runs, candidates: Sequence[Candidate], budget: Budget) -> None:
    """Run all, or as many as a share of the budget allows."""
    if budget.seconds is None:
        runs.run(candidates)
        return
    for k in range(0, len(candidates), _BATCH):
        if k > 0 and budget.spent() > _SCREENING_SHARE * budget.seconds:
            return
        runs.run(candidates[k : k + _BATCH], timeout=max(budget.left(), 1.0))


@dataclass(kw_only=True)
class _Judge:
    """What the points are judged by.

    Attributes
    ----------
    truth : Reference
    data : name of a candidate -> its run
    converged : name of a candidate -> the same contact, converged in N
    unsoftened : name of the case's own linear contact, converged
    asked : metrics with a tolerance
    """

    truth: Reference
    data: Mapping[str, RunData]
    converged: Mapping[str, Candidate]
    unsoftened: str
    asked: tuple[str, ...]
    _worst: dict[tuple[object, ...], Mapping[str, float]] = field(default_factory=dict)

    def worst(self, run: RunData) -> Mapping[str, float]:
        """Return the predicted worst errors of a run; they depend on law, e_n and N, not on stiffness."""
        pairs = tuple(event.pair for event in run.observations.contacts)
        key = (run.model.kind, run.model.scene.run.steps_per_contact, pairs)
        if key not in self._worst:
            self._worst[key] = worst_errors(run)
        return self._worst[key]

    def worst_converged(self, run: RunData) -> Mapping[str, float]:
        """Return bounds on the errors of a converged run: those of the finest point, which fall with 1/N at least."""
        points = (self.data[name] for name in self.converged if name in self.data)
        same = [data for data in points if data.model.kind == run.model.kind]
        if not same:
            return {}
        finest = max(same, key=_steps)
        share = min(_steps(finest) / _steps(run), 1.0)
        return {metric: share * worst for metric, worst in self.worst(finest).items()}

    def point(self, candidate: Candidate, run: RunData) -> TradePoint:
        """Return a point with its errors, without its cost."""
        converged = self.data.get(self.converged[candidate.name].name)
        return replace(
            _bare(candidate, run),
            errors=metric_errors(self.truth, run, converged, self.worst(run), self.asked),
            signs=signs(run, self.truth.run),
        )

    def split(self, candidate: Candidate) -> tuple[ErrorSplit, ...]:
        """Return the split of every error of a candidate that completed."""
        run = self.data[candidate.name]
        converged = self.data.get(self.converged[candidate.name].name)
        hertz = candidate.model == "hertz"
        unsoftened = self.truth.run if hertz else self.data.get(self.unsoftened)
        if candidate.how not in ("softened", "limited_overlap", "reduced_modulus"):
            unsoftened = converged  # a method has a stiffness of its own: all of its error is the model's
        if hertz and candidate.factor == 1.0:
            converged = unsoftened  # the reference itself
        known = (self.truth.run, unsoftened, converged)
        worst = {data.model.kind: self.worst_converged(data) for data in known if data is not None}
        return split_errors(self.truth, run, converged, unsoftened, worst, self.asked)


def _steps(run: RunData) -> float:
    return run.model.scene.run.steps_per_contact


def _point(candidate: Candidate, runs: Runs, judge: _Judge) -> TradePoint:
    ended = runs.ended.get(candidate.name)
    if ended is None:
        return TradePoint(candidate=candidate, status="skipped", message="the budget was used before")
    if candidate.name not in runs.data:
        return TradePoint(candidate=candidate, status=ended.status, message=ended.message or ended.failure)
    return judge.point(candidate, runs.data[candidate.name])


def _bare(candidate: Candidate, run: RunData) -> TradePoint:
    shortest = min(run.model.contacts.values(), key=lambda contact: contact.t_c)
    return TradePoint(
        candidate=candidate,
        status="completed",
        k_n=secant(shortest),
        steps=run.model.n_steps,
        dt=run.model.dt,
    )
