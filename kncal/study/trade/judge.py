"""What points of single contacts are judged by: the reference, and each contact converged in N."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from kncal.observe.run_data import RunData
from kncal.study.trade.errors import Reference, metric_errors, split_errors, worst_errors
from kncal.study.trade.trade import Candidate, ErrorSplit, MetricError


@dataclass(kw_only=True)
class ContactJudge:
    """What points of single contacts are judged by.

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

    def errors(self, candidate: Candidate) -> dict[str, MetricError]:
        """Return the errors of a candidate that completed."""
        run, converged = self.data[candidate.name], self.data.get(self.converged[candidate.name].name)
        return metric_errors(self.truth, run, converged, self.worst(run), self.asked)

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
    return float(run.model.scene.run.steps_per_contact)
