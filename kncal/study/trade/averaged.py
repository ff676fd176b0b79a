"""Trials of many particles: chaotic, so that averages are compared, by runs that can be stopped and continued.

FOLDER/start/       the case that all candidates are variants of: one start for all
FOLDER/runs/        the runs, as far as they came; runs/reference: that of the reference
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kncal.core.errors import CaseFileError, KncalError
from kncal.observe.difference import rows_between
from kncal.observe.row import Row
from kncal.observe.softness import model_signs
from kncal.runs.solving import plan_checked
from kncal.scene.case_file import load_case
from kncal.study.trade.budget import FEWEST, affordable, limit_of, rounds_of, spread
from kncal.study.trade.candidates import Contact, contacts, shared_case
from kncal.study.trade.errors import NAMES, average_splits
from kncal.study.trade.front import verdict, worst_ratio
from kncal.study.trade.reference import reference_steps
from kncal.study.trade.runs import Runs
from kncal.study.trade.trade import Candidate, ErrorSplit, TradePoint
from kncal.study.trade.trials import Trials

#: No run is begun, or continues, for less than this [s].
SHORTEST = 5.0


class Averaged(Trials):
    """All candidates run to their end, or under a budget in rounds of growing length, from which the worst drop out.

    Every run has the case's end time. Runs that the clock stops are averaged over the time that was simulated, with
    the wider intervals of that; their CPU times are extrapolated to the whole time.
    """

    cost = "cpu_seconds"

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.fixed = "gas and exchange" if self.scene.gas is not None else "recording"
        options = self.options
        smallest = min(options.tolerances.values(), default=0.05)
        self.steps, self._left = reference_steps(self.scene, options.steps, smallest)
        top, tried = contacts(self.case, options)
        shared, self._notes = shared_case(self.scene, self.folder)
        where: dict[str, Any] = {"case": shared, "folder": self.folder / "runs", "transport": options.transport}
        self.runs = Runs(**where, workers=options.workers, apart=True)
        self.reference = top.at(self.steps)
        self._plan(shared, self.reference)
        if self.reference.name in self.refused:
            raise CaseFileError(f"the reference: {self.refused[self.reference.name].message}")
        self.candidates = list(self._ordered(tried))
        for candidate in self.candidates:
            self._plan(shared, candidate)

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

    def _plan(self, case: Path, candidate: Candidate) -> None:
        """Plan a candidate, or note why a limit refuses it."""
        try:
            scene = load_case(case, overrides=candidate.variant.overrides)
            self.models[candidate.name] = plan_checked(scene, (candidate.model,))[candidate.model]
        except KncalError as error:
            text = str(error).partition("\n(with ")[0]  # the values stand beside it anyway
            point = TradePoint(candidate=candidate, status="refused", message=text, ran_share=0.0)
            self.refused[candidate.name] = point

    def run(self) -> None:
        """See `Trials.run`."""
        runs, budget = self.runs, self.budget
        wanted = [c for c in self.candidates if c.name not in self.refused]
        self.tell("one start for all runs")
        runs.run([self.reference, *wanted], look=True)
        waiting = [c for c in wanted if runs.open(c)]
        if budget.seconds is None:
            if number := len(waiting) + runs.open(self.reference):
                self.tell(f"{number} runs, each to its end")
                runs.run([self.reference, *wanted])
            return
        alive: list[Candidate] = []
        rounds = 1
        while True:
            left = budget.left() - (len(alive) + 1) * runs.looking
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
        points = {c.name: self.point(c) for c in self.candidates}
        verdicts = {name: verdict(point) for name, point in points.items()}
        price = {n: min(p.cpu_seconds, default=math.inf) for n, p in points.items()}
        best = min((price[n] for n, found in verdicts.items() if found == "inside"), default=math.inf)

        def key(c: Candidate) -> tuple[bool, float]:
            point = points[c.name]
            if worst_ratio(point) == math.inf:
                return True, math.inf  # too short to tell
            ratio = max(abs(r.difference.value or 0.0) / (r.tolerance or math.inf) for r in point.judged.values())
            return ratio > 1.0, ratio if ratio > 1.0 else price[c.name]

        hard = [c for c in alive if c.factor == 1.0 and c.steps_per_contact == self.steps]
        others = [c for c in alive if c not in hard and verdicts[c.name] != "outside" and not price[c.name] > best]
        return [*hard, *sorted(others, key=key)[: max((len(alive) + 1) // 2, FEWEST) - len(hard)]]

    def point(self, candidate: Candidate) -> TradePoint:
        """See `Trials.point`; the plan of one that was not run tells some signs of softness."""
        if candidate.name in self.refused:
            return self.refused[candidate.name]
        found = super().point(candidate)
        return found if found.signs else replace(found, signs=model_signs(self.models[candidate.name]))

    def errors(self, candidate: Candidate) -> Mapping[str, Row]:
        """See `Trials.errors`: of every metric that one of the two runs has, or that has a tolerance."""
        run, top = (self.runs.data[name] for name in (candidate.name, self.reference.name))
        return {row.metric: row for row in rows_between(run, top, self.options.tolerances, NAMES)}

    def splits(self, points: Sequence[TradePoint]) -> Mapping[str, tuple[ErrorSplit, ...]]:
        """See `Trials.splits`."""
        data: Mapping[str, Any] = self.runs.data
        judged = [(p.candidate, data[p.candidate.name], p.errors) for p in points]
        top = data.get(self.reference.name)
        return {} if top is None else average_splits(judged, top, self.steps)

    def caveats(self, reference: TradePoint, points: Sequence[TradePoint], load: float) -> Sequence[str]:
        """See `Trials.caveats`."""
        ran = [p.ran_share for p in points if p.status != "refused"]
        return [*self._notes, *self._of_reference(reference.ran_share, ran), *self._of_times(ran, load)]

    def _of_reference(self, top: float, ran: Sequence[float]) -> Iterator[str]:
        yield (
            f"The reference, Hertz at the real modulus, has N = {self.steps:g}: there the step changes its contacts by"
            f" {100.0 * self._left:.2g} % in the mean, by prediction. What the step does to averages is known only if"
            " another N is among the points."
        )
        if top < 1.0:
            yield (
                f"The reference was run in part: {100.0 * top:.3g} % of its time. Averages are over that time,"
                " with the wider intervals of it; CPU times are extrapolated to the whole time."
            )
        if part := sum(0.0 < share < 1.0 for share in ran):
            yield f"{part} more runs came to a part of their time (ran_share): the same holds for them."

    def _of_times(self, ran: Sequence[float], load: float) -> Iterator[str]:
        runs, options = self.runs, self.options
        held = [later / first for name in runs.spans if (rates := runs.rates(name))[1:] for first, later in [rates]]
        if held:
            worst = max(held, key=lambda ratio: abs(math.log(ratio)))
            yield (
                f"Extrapolation of CPU times, checked on {len(held)} runs: what followed the first part took"
                f" {float(np.median(held)):.3g} times as long as that predicted (median; farthest: {worst:.3g})."
            )
        yield (
            f"{runs.lanes} runs at a time on {os.cpu_count()} cores; load average {load:.2f} at the start,"
            f" {os.getloadavg()[0]:.2f} at the end. Other work on the machine makes CPU times longer."
        )
        if options.budget is not None:
            yield (
                f"Budget {options.budget:g} s, used {self.budget.spent():.0f} s; {ran.count(0.0)} candidates had no"
                " turn. The same command with a larger budget continues these runs; with another run.until_time it"
                " begins others."
            )
