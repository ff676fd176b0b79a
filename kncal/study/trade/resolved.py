"""Trials of scenes whose motion is resolved: errors are exact but for the step, which is converged.

FOLDER/screening/   by the builtin engine: every point, and each contact converged in N
FOLDER/runs/        by the solver, in rounds, for the CPU times
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from kncal.core.errors import RenderError
from kncal.engines.builtin.integrator import check
from kncal.observe.cost import CPU_TRUSTED
from kncal.observe.row import Row
from kncal.observe.run_data import RunData
from kncal.scene.case_file import load_case
from kncal.scene.model import KINDS, Plan
from kncal.scene.plan import plan
from kncal.study.trade.candidates import Contact, contacts
from kncal.study.trade.errors import Reference, contact_rows, split_errors, worst_errors
from kncal.study.trade.front import USUAL_STEPS, pareto, worst_ratio
from kncal.study.trade.reference import REFERENCE_STEPS, converged_steps, ends_of, find_reference
from kncal.study.trade.runs import Runs
from kncal.study.trade.trade import Candidate, Convergence, ErrorSplit, TradePoint
from kncal.study.trade.trials import Trials

#: Of a budget, what screening may take; and runs that are started together under one: screened, timed.
_SCREENING_SHARE, _SCREENED, _TIMED = 0.5, 16, 8
#: Contacts that differ in stiffness alone.
_SOFTENED = ("softened", "reduced_modulus")


class Resolved(Trials):
    """Errors by the builtin engine, cost by the solver."""

    cost, fixed = "steps", "the start of the solver"
    truth: Reference
    convergence: Convergence
    solved: Runs

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._first, self._tried = contacts(self.case, self.options)
        self.ends = ends_of(self.case, self.scene, self._first, self._tried)
        engine, wanted = self._screening_engine(), self.options.engine
        self.runs = self._runs("screening", engine)
        self.solved = self.runs if engine == wanted else self._runs("runs", wanted)
        steps = self.options.steps
        self._contact_of = {c.at(n, self.ends.changes).name: c for c in self._tried for n in steps}
        self.candidates = [c.at(n, self.ends.changes) for c in self._tried for n in steps]
        self._converged: dict[str, Candidate] = {}
        self._worst: dict[tuple[object, ...], Mapping[str, float]] = {}
        self._errors: dict[str, Mapping[str, Row]] = {}

    def _runs(self, name: str, engine: str) -> Runs:
        return Runs(case=self.case, folder=self.folder / name, engine=engine, workers=self.options.workers)

    def _screening_engine(self) -> str:
        """Return "builtin", or the solver for physics that the builtin engine does not have."""
        try:
            check(self._planned("hertz"))
        except RenderError:
            return self.options.engine
        return "builtin"

    def _planned(self, kind: str) -> Plan:
        """Return a model of the case itself, whose law, e_n and physics all of its contacts share."""
        return plan(load_case(self.case, overrides=self.ends.overrides), (kind,))[kind]

    def run(self) -> None:
        """See `Trials.run`; what tells most first."""
        self.tell(f"reference: Hertz, N doubled from {REFERENCE_STEPS[0]:g} until it converges")
        found = find_reference(self.runs, self._first, self.ends, self.options.tolerances)
        self.reference, self.truth, self.convergence = found
        n, threshold = self.reference.steps_per_contact, self.convergence.threshold
        finest = {kind: converged_steps(self._planned(kind), threshold, n) for kind in KINDS}
        self._converged = {c.name: c.at(finest[c.model], self.ends.changes) for c in self._tried}
        self.tell(f"reference: N = {n:g}; screening {len(self.candidates)} points with the engine {self.runs.engine}")
        # without the converged contacts there are points, only without the split of their errors
        ranked = sorted(self.candidates, key=lambda c: _rank(self._contact_of[c.name]))
        for batch in self._batches([*ranked, *self._converged.values()], _SCREENED, _SCREENING_SHARE):
            self.runs.run(batch, limit=self._limit)
        wanted = [p.candidate for p in timing_order([*map(self.point, self.candidates)], self._usual_steps)]
        rounds = self.options.rounds
        self.tell(f"timing {len(wanted) + 1} runs in {rounds} rounds with {self.solved.engine}")
        for batch in self._batches([self.reference, *wanted], _TIMED, 1.0):
            self.solved.run(batch, rounds, limit=self._limit)

    @property
    def _usual_steps(self) -> float:
        return float(self.scene.run.steps_per_contact)

    @property
    def _limit(self) -> float | None:
        return None if self.budget.seconds is None else max(self.budget.left(), 1.0)

    def _batches(self, candidates: Sequence[Candidate], size: int, share: float) -> Iterator[Sequence[Candidate]]:
        """Give all at once; with a budget batches, until a ``share`` of it is used or no other fits."""
        if self.budget.seconds is None:
            yield candidates
            return
        longest = 0.0
        for k in range(0, len(candidates), size):
            before = self.budget.spent()
            if k > 0 and (before > share * self.budget.seconds or longest > self.budget.left()):
                self.tell(f"the budget is used: {len(candidates) - k} runs are left")
                return
            yield candidates[k : k + size]
            longest = max(longest, self.budget.spent() - before)

    def point(self, candidate: Candidate) -> TradePoint:
        """See `Trials.point`; CPU times are those of the solver."""
        found, ended = super().point(candidate), self.solved.ended.get(candidate.name)
        if not found.completed:
            return found
        if ended is None:
            return replace(found, cpu_seconds=(), message="not timed: the budget was used")
        if not ended.completed:
            return replace(found, status=ended.status, message=ended.message or ended.failure)
        return replace(found, cpu_seconds=ended.cpu_seconds)

    def errors(self, candidate: Candidate) -> Mapping[str, Row]:
        """See `Trials.errors`."""
        if candidate.name not in self._errors:
            run = self._data(candidate)
            tolerances, converged = self.options.tolerances, self._data(self._fine(candidate))
            rows = contact_rows(self.truth, run, converged, self._worst_of(run), tolerances)
            self._errors[candidate.name] = rows
        return self._errors[candidate.name]

    def splits(self, points: Sequence[TradePoint]) -> Mapping[str, tuple[ErrorSplit, ...]]:
        """See `Trials.splits`."""
        return {p.candidate.name: self._split(p.candidate) for p in points}

    def _split(self, candidate: Candidate) -> tuple[ErrorSplit, ...]:
        truth = self.truth
        run, converged = self._data(candidate), self._data(self._fine(candidate))
        hertz = candidate.model == "hertz"
        unsoftened = truth.run if hertz else self._data(self._converged[self._tried[0].name])
        if candidate.how not in (*_SOFTENED, "limited_overlap"):
            unsoftened = converged  # a method has a stiffness of its own: all of its error is the model's
        if hertz and candidate.factor == 1.0:
            converged = unsoftened  # the reference itself
        known = (truth.run, unsoftened, converged)
        worst = {data.model.kind: self._worst_converged(data) for data in known if data is not None}
        return split_errors(truth, run, converged, unsoftened, worst, tuple(self.options.tolerances))

    def _data(self, candidate: Candidate) -> Any:
        return self.runs.data.get(candidate.name)

    def _fine(self, candidate: Candidate) -> Candidate:
        """Return the same contact, converged in N."""
        return self._converged[self._contact_of[candidate.name].name]

    def _worst_of(self, run: RunData) -> Mapping[str, float]:
        """Return the predicted worst errors of a run; they depend on law, e_n and N, not on stiffness."""
        pairs = tuple(event.pair for event in run.observations.contacts)
        key = (run.model.kind, run.model.scene.run.steps_per_contact, pairs)
        if key not in self._worst:
            self._worst[key] = worst_errors(run)
        return self._worst[key]

    def _worst_converged(self, run: RunData) -> Mapping[str, float]:
        """Return bounds on the errors of a converged run: those of the finest point, which fall with 1/N at least."""
        points = (data for c in self.candidates if (data := self._data(c)) is not None)
        finest = max((d for d in points if d.model.kind == run.model.kind), key=_steps, default=None)
        if finest is None:
            return {}
        share = min(_steps(finest) / _steps(run), 1.0)
        return {metric: share * worst for metric, worst in self._worst_of(finest).items()}

    def caveats(self, reference: TradePoint, points: Sequence[TradePoint], load: float) -> Sequence[str]:
        """See `Trials.caveats`."""
        told = [*self.ends.sentences, self.convergence.sentence, *self._of_times(reference, points, load)]
        off = None if self.solved is self.runs else self._agreement()
        if off is not None:
            far = "" if off <= self.convergence.threshold else ", too much to judge by: please report it"
            engines = f"Errors are by the engine {self.runs.engine}; {self.solved.engine} differs by"
            told.append(f"{engines} {off:.1e} at most{far}.")
        return told

    def _of_times(self, reference: TradePoint, points: Sequence[TradePoint], load: float) -> Iterator[str]:
        """Say what the CPU times are worth."""
        if skipped := sum(p.status == "skipped" for p in points):
            yield f"{skipped} of {len(points)} points were not run: a larger --budget continues with them."
        times = [c for p in (reference, *points) for c in p.cpu_seconds]
        if not times:
            yield "No run was timed: costs are numbers of steps."
            return
        if self.solved.engine == "builtin":
            yield "The builtin engine jumps over free flight: its CPU time says nothing about a solver's."
        elif float(np.median(times)) < CPU_TRUSTED:
            yield (
                f"Most runs take less than {CPU_TRUSTED:g} s of CPU, mostly to start the solver: points are ordered by"
                " their steps. In a long run the ratio of steps is the speed-up."
            )
        if untimed := sum(p.completed and not p.cpu_seconds for p in points):
            yield f"{untimed} of {len(points)} points were not timed: the budget was used."
        yield f"Load of the machine before the runs: {load:.1f}."

    def _agreement(self) -> float | None:
        """Return the largest relative difference of metrics between the two engines [-]; None: nothing in common."""
        names = self.truth.names()
        both = [(self.runs.data[n], solved) for n, solved in self.solved.data.items() if n in self.runs.data]
        pairs = [(a.estimate(name).value, b.estimate(name).value) for a, b in both for name in names]
        return max((abs(b - a) / abs(b) for a, b in pairs if a is not None and b), default=None)


def _rank(contact: Contact) -> tuple[bool, float]:
    """Order contacts by what they tell: the unsoftened ones, then those softened step by step, then other methods."""
    ours = contact.how in _SOFTENED or contact.factor == 1.0
    return not ours, -(contact.factor or 0.0)


def _steps(run: RunData) -> float:
    return float(run.model.scene.run.steps_per_contact)


def timing_order(points: Iterable[TradePoint], usual_steps: float) -> Iterator[TradePoint]:
    """Give the completed points in the order in which their CPU time tells most.

    Usual practice and the front first, nearest to the tolerances, then what the law of cost needs, then the rest.
    """
    done = {p.candidate.name: p for p in points if p.completed}
    ratio = {name: worst_ratio(p) for name, p in done.items()}
    names = [name for name in done if ratio[name] < math.inf]
    front = [names[i] for i in pareto([done[n].steps or 0 for n in names], [ratio[n] for n in names])]
    tried = {name: p.candidate for name, p in done.items()}
    at = min({c.steps_per_contact for c in tried.values()}, key=lambda n: abs(n - usual_steps), default=0.0)
    usual = [n for n, c in tried.items() if (c.model, c.factor, c.steps_per_contact) == ("hertz", 1.0, USUAL_STEPS)]
    law = [n for n, c in tried.items() if c.steps_per_contact == at and (c.how in _SOFTENED or c.factor == 1.0)]

    def off(name: str) -> float:
        return abs(math.log(max(min(ratio[name], 1e9), 1e-9)))

    for name in dict.fromkeys([*usual, *sorted(front, key=off), *law, *sorted(done, key=off)]):
        yield done[name]
