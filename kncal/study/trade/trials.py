"""What a trade needs to know of the runs of a scene: which there are, how they are run, and what each tells."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from kncal.observe.row import Row
from kncal.observe.softness import secant, signs
from kncal.scene.model import Plan
from kncal.scene.scene import Scene
from kncal.study.trade.budget import Budget
from kncal.study.trade.runs import Runs
from kncal.study.trade.trade import Candidate, Convergence, ErrorSplit, Tell, TradeOptions, TradePoint

SKIPPED = "the budget ended before its turn"


class Trials(ABC):
    """The candidates of a scene, their runs, and what is known of each.

    Attributes
    ----------
    cost, fixed : as of `kncal.study.trade.trade.Trade`
    runs : that errors are computed from
    reference : what all others are compared with; known once `run` has found it
    convergence : how its step was found; None: by prediction
    candidates : what is tried
    models : name -> its plan, of those that were planned before they run
    refused : name -> the point of one that cannot run
    """

    cost: ClassVar[str]
    fixed: str
    runs: Runs
    reference: Candidate
    convergence: Convergence | None = None
    candidates: Sequence[Candidate]

    def __init__(
        self, case: str | Path, scene: Scene, folder: Path, options: TradeOptions, budget: Budget, tell: Tell
    ) -> None:
        self.case, self.scene, self.folder = case, scene, folder
        self.options, self.budget, self.tell = options, budget, tell
        self.models: dict[str, Plan] = {}
        self.refused: dict[str, TradePoint] = {}

    @abstractmethod
    def run(self) -> None:
        """Run what there is time for."""

    @abstractmethod
    def errors(self, candidate: Candidate) -> Mapping[str, Row]:
        """Return the judged errors of a candidate that was read."""

    @abstractmethod
    def splits(self, points: Sequence[TradePoint]) -> Mapping[str, tuple[ErrorSplit, ...]]:
        """Return where the errors of completed points come from, by the names of their candidates."""

    @abstractmethod
    def caveats(self, reference: TradePoint, points: Sequence[TradePoint], load: float) -> Sequence[str]:
        """Say what to keep in mind; ``load``: load average of the machine before the runs."""

    def point(self, candidate: Candidate) -> TradePoint:
        """Return what is known of a candidate: its plan, and the errors and the cost of its run as far as it came."""
        name, runs = candidate.name, self.runs
        run, ended, share = runs.data.get(name), runs.ended.get(name), runs.share(name)
        found = TradePoint(candidate=candidate, status="skipped", message=SKIPPED, ran_share=share)
        model = self.models.get(name) or (run and run.model)
        if model:
            steps = model.n_steps or model.couplings * model.steps_per_coupling
            t_end = steps * model.dt
            shortest = min(model.contacts.values(), key=lambda contact: contact.t_c)
            found = replace(found, k_n=secant(shortest), steps=steps, dt=model.dt)
        if ended is None or run is None:
            if share:
                return replace(found, message=f"run for {share * t_end:.3g} s, too short for any average")
            if ended is not None and not runs.open(candidate):
                return replace(found, status=ended.status, message=ended.message or ended.failure)
            return found
        top = None if candidate is self.reference else runs.data.get(self.reference.name)
        return replace(
            found,
            status="completed",
            message="" if ended.completed else f"run for {share * t_end:.3g} of {t_end:.3g} s",
            cpu_seconds=runs.seconds(name),
            errors={} if top is None else self.errors(candidate),
            signs=signs(run, top),
        )
