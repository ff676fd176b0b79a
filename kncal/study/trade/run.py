"""The runs of a trade, and what they tell: all candidates in rounds, under a budget of growing length.

FOLDER/screening/   single contacts by the builtin engine: every point, and each contact converged in N
FOLDER/start/       of a bed: the case that all candidates are variants of
FOLDER/runs/        the solver: of single contacts in rounds, for the CPU times; of beds as far as they came
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from kncal.core.errors import CaseFileError, InterruptedRunError, KncalError, RenderError
from kncal.observe.run_data import RunData
from kncal.observe.softness import model_signs, secant, signs
from kncal.runs.solving import plan_checked
from kncal.scene.bed_scene import BedScene
from kncal.scene.case_file import load_case, load_scene
from kncal.scene.model import KINDS, BedModel, Model
from kncal.scene.plan import plan
from kncal.scene.scene import Scene
from kncal.study.trade.budget import FEWEST, Budget, affordable, limit_of, rounds_of, spread
from kncal.study.trade.candidates import Contact, contacts, shared_case
from kncal.study.trade.errors import bed_errors, bed_splits
from kncal.study.trade.front import verdict
from kncal.study.trade.judge import ContactJudge
from kncal.study.trade.reference import REFERENCE_STEPS, Ends, converged_steps, ends_of, find_reference, reference_steps
from kncal.study.trade.runs import BedRuns, ContactRuns
from kncal.study.trade.timing import agreement, bed_sentences, time_points, time_sentences, timed
from kncal.study.trade.trade import Candidate, Tell, Trade, TradeOptions, TradePoint

#: Of a budget, what screening may take; and runs that are started together under one.
_SCREENING_SHARE, _BATCH = 0.5, 16
#: Kept of a budget for what follows the runs (files, pictures): share, and seconds.
REST_SHARE, REST = 0.02, 5.0
#: No run of a bed is begun, or goes on, for less than this [s].
SHORTEST = 5.0


def trade_contacts(case: str | Path, scene: Scene, folder: Path, options: TradeOptions, tell: Tell) -> Trade:
    """Trade speed for accuracy in a case of single contacts: errors by the builtin engine, cost by the solver.

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
    budget = Budget(None if options.budget is None else options.budget - _rest(options.budget))
    load = os.getloadavg()[0]
    reference, tried = contacts(case, options)
    ends = ends_of(case, scene, reference, tried)
    engine = _screening_engine(case, ends, options.engine)
    screened = ContactRuns(case=case, folder=folder / "screening", engine=engine, workers=options.workers)
    tell(f"reference: Hertz, N doubled from {REFERENCE_STEPS[0]:g} on, until it converges")
    found = find_reference(screened, reference, ends, options.tolerances)
    n = found.candidate.steps_per_contact
    points_of = {contact.name: [contact.at(steps, ends.changes) for steps in options.steps] for contact in tried}
    candidates = [c for each in points_of.values() for c in each]
    finest = {kind: converged_steps(_planned(case, kind, ends), found.convergence.threshold, n) for kind in KINDS}
    converged = {contact.name: contact.at(finest[contact.model], ends.changes) for contact in tried}
    tell(f"reference: N = {n:g}; screening {len(candidates)} points with the engine {engine}")
    # what tells most first; without the converged contacts there are points, only without the split of their errors
    ranked = [c for contact in sorted(tried, key=_rank) for c in points_of[contact.name]]
    _screen(screened, [*ranked, *converged.values()], budget)

    judge = ContactJudge(
        truth=found.truth,
        data=screened.data,
        converged={c.name: converged[name] for name, each in points_of.items() for c in each},
        unsoftened=converged[tried[0].name].name,
        asked=tuple(options.tolerances),
    )
    points = [_contact_point(c, screened, judge) for c in candidates]
    solved = screened
    if engine != options.engine:
        solved = ContactRuns(case=case, folder=folder / "runs", engine=options.engine, workers=options.workers)
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
        wall_seconds=budget.spent(),
    )


def _rest(budget: float) -> float:
    """Time of a budget to keep for what follows the runs [s]."""
    return min(max(REST_SHARE * budget, REST), 0.1 * budget)


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


def _screen(runs: ContactRuns, candidates: Sequence[Candidate], budget: Budget) -> None:
    """Run all, or as many as a share of the budget allows."""
    if budget.seconds is None:
        runs.run(candidates)
        return
    for k in range(0, len(candidates), _BATCH):
        if k > 0 and budget.spent() > _SCREENING_SHARE * budget.seconds:
            return
        runs.run(candidates[k : k + _BATCH], limit=max(budget.left(), 1.0))


def _contact_point(candidate: Candidate, runs: ContactRuns, judge: ContactJudge) -> TradePoint:
    ended = runs.ended.get(candidate.name)
    if ended is None:
        return TradePoint(candidate=candidate, status="skipped", message="the budget was used before")
    if candidate.name not in runs.data:
        return TradePoint(candidate=candidate, status=ended.status, message=ended.message or ended.failure)
    run = runs.data[candidate.name]
    return replace(_bare(candidate, run), errors=judge.errors(candidate), signs=signs(run, judge.truth.run))


def _bare(candidate: Candidate, run: RunData) -> TradePoint:
    shortest = min(run.model.contacts.values(), key=lambda contact: contact.t_c)
    return TradePoint(
        candidate=candidate,
        status="completed",
        k_n=secant(shortest),
        steps=run.model.n_steps,
        dt=run.model.dt,
    )


# --- beds ---------------------------------------------------------------------


def trade_bed(case: str | Path, scene: BedScene, folder: Path, options: TradeOptions, tell: Tell) -> Trade:
    """Trade speed for accuracy in a bed; what ``folder`` holds already is used, and goes on where it stopped.

    Every run has the case's end time. Without a budget all come to it. With one, runs are stopped by the clock: then
    averages are over the time that was simulated, with the wider intervals of that, and CPU times are extrapolated to
    the whole time.

    Parameters
    ----------
    case, scene : the case, and what it describes
    folder : of the runs
    options : ``rounds`` and ``engine`` are of single contacts
    tell : told what is done now

    Raises
    ------
    CaseFileError, InputError
        If the case cannot be planned or has no contacts.
    RunError
        If the packing fails.
    InterruptedRunError
        After Ctrl-C; the same call again goes on.
    """
    budget, load = Budget(options.budget), os.getloadavg()[0]
    if not options.tolerances:
        options = replace(options, tolerances=dict(scene.tolerances))
    found = _Bed(case, scene, folder, options, budget, tell)
    try:
        found.run()
    except KeyboardInterrupt:
        raise InterruptedRunError("interrupted; run the same command again to go on") from None
    return found.trade(load)


class _Bed:
    """The candidates of a bed, their runs, and what is known of each."""

    def __init__(
        self, case: str | Path, scene: BedScene, folder: Path, options: TradeOptions, budget: Budget, tell: Tell
    ) -> None:
        self.scene, self.options, self.budget, self.tell = scene, options, budget, tell
        smallest = min(options.tolerances.values(), default=0.05)
        self.steps, self.left = reference_steps(scene, options.steps, smallest)
        top, tried = contacts(case, options)
        shared, self.notes = shared_case(scene, folder)
        self.runs = BedRuns(case=shared, folder=folder / "runs", transport=options.transport, workers=options.workers)
        self.reference = top.at(self.steps)
        self.models: dict[str, BedModel] = {}
        self.refused: dict[str, TradePoint] = {}
        self.candidates = [c for c in [self.reference, *self._ordered(tried)] if self._planned(shared, c) is not None]
        if self.reference.name in self.refused:
            raise CaseFileError(f"the reference: {self.refused[self.reference.name].message}")

    def _ordered(self, tried: Sequence[Contact]) -> Iterator[Candidate]:
        """Give all candidates, those first that tell most: softened at the N of the reference, then other ways."""
        first, rest = tried[0], tried[1:]
        soft = [[c for c in rest if c.how == how] for how in ("softened", "reduced_modulus")]
        others = [c for c in rest if c.how not in ("softened", "reduced_modulus")]
        ordered = [first, *(part[i] for part in soft for i in spread(len(part))), *others]
        for steps in (self.steps, *(n for n in sorted(self.options.steps) if n != self.steps)):
            for contact in ordered:
                # Hertz at the real modulus and this N is the reference itself
                if not (steps == self.steps and (contact.how, contact.factor) == ("reduced_modulus", 1.0)):
                    yield contact.at(steps)

    def _planned(self, case: Path, candidate: Candidate) -> BedModel | None:
        """Plan a candidate; None, with a point that says why, if a limit refuses it."""
        try:
            scene = load_case(case, overrides=candidate.variant.overrides)
            if not isinstance(scene, BedScene):
                raise CaseFileError(f"{case}: expected a bed")
            model: BedModel = plan_checked(scene, (candidate.model,))[candidate.model]
        except KncalError as error:
            text = str(error).partition("\n(with ")[0]  # the values stand beside it anyway
            self.refused[candidate.name] = TradePoint(
                candidate=candidate, status="refused", message=text, ran_share=0.0
            )
            return None
        self.models[candidate.name] = model
        return model

    def run(self) -> None:
        """Run what there is time for."""
        runs, budget, tried = self.runs, self.budget, self.candidates[1:]
        self.tell("one start for all runs")
        runs.run(self.candidates, look=True)
        if budget.seconds is None:
            if number := sum(map(runs.open, self.candidates)):
                self.tell(f"{number} runs, each to its end")
                runs.run(self.candidates)
            return
        waiting = [c for c in tried if runs.open(c)]
        alive: list[Candidate] = []
        rounds = 1
        while True:
            left = budget.left() - _rest(budget.seconds) - (len(alive) + 1) * runs.looking
            lanes, shortest = runs.lanes_beside(self.reference), max(SHORTEST, runs.overhead)
            share = 0.5 if runs.lanes == 1 and runs.open(self.reference) else 1.0
            if not alive:
                models = [c.model for c in waiting]
                number = affordable(models, share * left, lanes, runs.overhead, shortest)
                alive, waiting = waiting[:number], waiting[number:]
                rounds = rounds_of(number)
            seconds = share * left / rounds
            limit = limit_of([c.model for c in alive], seconds, lanes, runs.overhead)
            if limit < shortest or not (alive or runs.open(self.reference)):
                return
            self.tell(f"{len(alive)} candidates for {limit:.0f} s each, the reference beside them")
            runs.run_beside(self.reference, alive, seconds, limit)
            rounds = max(rounds - 1, 1)
            alive = self._better([c for c in alive if runs.open(c)])

    def _better(self, alive: Sequence[Candidate]) -> list[Candidate]:
        """Return the half that goes on: those that may be the answer, by the face value of their errors, then cost.

        What is surely outside is out, and what costs more than one that is surely inside; the unsoftened contact goes
        on, since the others are told apart by it.
        """
        points = {c.name: self._point(c) for c in self.candidates}
        limits = self.options.tolerances
        verdicts = {name: verdict(point, limits) for name, point in points.items()}
        price = {n: min(p.cpu_seconds, default=float("inf")) for n, p in points.items()}
        best = min((price[n] for n, found in verdicts.items() if found == "inside"), default=float("inf"))

        def key(c: Candidate) -> tuple[bool, float]:
            errors = points[c.name].errors
            known = [errors[m].error for m in limits if m in errors]
            if not known or any(e is None for e in known):
                return True, float("inf")  # too short to tell
            ratio = max(abs(errors[m].error or 0.0) / limit for m, limit in limits.items())
            return ratio > 1.0, ratio if ratio > 1.0 else price[c.name]

        hard = [c for c in alive if c.factor == 1.0 and c.steps_per_contact == self.steps]
        others = [c for c in alive if c not in hard and verdicts[c.name] != "outside" and not price[c.name] > best]
        return [*hard, *sorted(others, key=key)[: max((len(alive) + 1) // 2, FEWEST) - len(hard)]]

    def trade(self, load: float) -> Trade:
        """Return what was found."""
        top = self.runs.data.get(self.reference.name)
        points = {c.name: self._point(c) for c in self.candidates[1:]} | {
            name: point for name, point in self.refused.items()
        }
        judged = [(p.candidate, self.runs.data[name], p.errors) for name, p in points.items() if p.completed]
        return Trade(
            case=self.scene.name,
            title=self.scene.title,
            bed=True,
            reference=self._point(self.reference),
            convergence=None,
            points=tuple(points.values()),
            tolerances=dict(self.options.tolerances),
            splits={} if top is None else bed_splits(judged, top, self.steps),
            caveats=(
                *self.notes,
                *bed_sentences(self.runs, self.candidates, (self.steps, self.left), self.budget, load),
            ),
            options=self.options,
            wall_seconds=self.budget.spent(),
        )

    def _point(self, candidate: Candidate) -> TradePoint:
        """Return what is known of a candidate: its plan, and the errors and the cost of its run as far as it came."""
        name, runs = candidate.name, self.runs
        model, ended = self.models[name], runs.ended.get(name)
        length, share = model.couplings * model.coupling, runs.share(name)
        bare = TradePoint(
            candidate=candidate,
            status="skipped",
            message="the budget ended before its turn",
            k_n=secant(min(model.contacts.values(), key=lambda contact: contact.t_c)),
            steps=model.couplings * model.steps_per_coupling,
            dt=model.dt,
            ran_share=share,
            signs=model_signs(model),
        )
        run = runs.data.get(name)
        if ended is None or run is None:
            if share:
                return replace(bare, message=f"run for {share * length:.3g} s, too short for any average")
            if ended is not None and not runs.open(candidate):
                return replace(bare, status=ended.status, message=ended.message or ended.failure)
            return bare
        top = None if candidate is self.reference else runs.data.get(self.reference.name)
        return replace(
            bare,
            status="completed",
            message="" if ended.completed else f"run for {share * length:.3g} of {length:.3g} s",
            cpu_seconds=runs.whole(name),
            errors={} if top is None else bed_errors(run, top, self.options.tolerances),
            signs=signs(run, top),
        )
