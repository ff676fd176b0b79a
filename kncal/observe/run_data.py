"""A completed run with everything that is read from it: its record, its metrics with their widths, and its cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.observe.averages import BedObservations, observe_bed
from kncal.observe.contacts import Observations
from kncal.observe.cost import Cost, cost, coupled_cost
from kncal.observe.estimate import Estimate, missing
from kncal.observe.quantities import quantities
from kncal.record.frames import Trajectory
from kncal.record.outcome import RunResult
from kncal.record.series import BedSeries
from kncal.scene.metrics import FEW_PARTICLES, METRICS, why_not
from kncal.scene.model import BedModel, Model


class ExactMotion(Protocol):
    """The exact motion of a model, as `kncal.scene.exact.solve` returns it."""

    def at(self, times: Array) -> tuple[Array, Array]:
        """Positions [m] and velocities [m/s], each (times, particles, 3), at ``times`` [s]."""
        ...


@dataclass(frozen=True, kw_only=True)
class RunData:
    """One completed run of a few particles.

    Attributes
    ----------
    model, result, trajectory, observations : what was run, how it ended, its frames, its numbers
    exact : metric -> value of the exact solution of the same model [SI], or None
    predicted : metric -> predicted relative discretisation error at this dt (worst phase) [-], or None
    motion : the exact motion of the same model, for figures, or None
    cpu_samples : CPU seconds of repeated runs of the same input; empty: only ``result.cpu_seconds``
    """

    model: Model
    result: RunResult
    trajectory: Trajectory
    observations: Observations
    exact: Mapping[str, float] | None = None
    predicted: Mapping[str, float] | None = None
    motion: ExactMotion | None = None
    cpu_samples: tuple[float, ...] = ()

    @property
    def recorded(self) -> tuple[str, ...]:
        """Names of `kncal.scene.metrics.RECORDS` that the run has."""
        return FEW_PARTICLES

    @cached_property
    def estimates(self) -> Mapping[str, Estimate]:
        """Every metric of the run, with its predicted discretisation error where there is one."""
        found = {name: self._estimate(name, value) for name, value in self.observations.metrics.items()}
        return found | added(self)

    def _estimate(self, name: str, value: float) -> Estimate:
        if not np.isfinite(value):
            return missing(f"{name} is not finite")
        share = (self.predicted or {}).get(name)
        return Estimate(value=float(value), width=None if share is None else abs(share * value))

    def estimate(self, name: str) -> Estimate:
        """Return a metric; one without a value, and why, if the run does not have it."""
        return self.estimates.get(name) or missing(f"no {name} in the run")

    @cached_property
    def cost(self) -> Cost:
        """What the run cost."""
        durations = [contact.t_c for contact in self.model.contacts.values()]
        return cost(self.model.kind, self.result, durations, self.cpu_samples)


@dataclass(frozen=True, kw_only=True)
class BedRunData:
    """One completed run of a bed.

    Attributes
    ----------
    model : BedModel
    result : RunResult; ``extra`` holds what `kncal.observe.cost.EXTRA` names
    series : BedSeries
    """

    model: BedModel
    result: RunResult
    series: BedSeries

    @property
    def recorded(self) -> tuple[str, ...]:
        """Names of `kncal.scene.metrics.RECORDS` that the run has."""
        has = {
            "frames": len(self.series.t_frame) > 0,
            "series:pressure": self.series.facts.gas_density > 0.0,
            "series:forces": bool(np.isfinite(self.series.floor).any()),
            "series:particles": True,
            "series:overlaps": bool(np.isfinite(self.series.overlap_max).any()),
            "fields:eps_g": len(self.series.eps_g) > 0,
        }
        return tuple(name for name, there in has.items() if there)

    @cached_property
    def seen(self) -> BedObservations:
        """What was observed after the start-up: after ``run.discard`` of the scene, or as detected.

        Raises
        ------
        InputError
            If the run is too short for any average.
        """
        scene = self.model.scene
        return observe_bed(self.series, scene.run.discard, scene.gas)

    @cached_property
    def estimates(self) -> Mapping[str, Estimate]:
        """Every metric of the run; what means nothing for such a bed is not among them."""
        return quantities(self.series, self.seen) | added(self)

    def may_have(self, name: str) -> bool:
        """Whether a metric means something for such a bed."""
        return not why_not(name, self.seen.kind, self.seen.changes)

    def estimate(self, name: str) -> Estimate:
        """Return a metric; one without a value, and why, if the run does not have it."""
        return self.estimates.get(name) or missing(why_not(name, self.seen.kind, self.seen.changes) or "not observed")

    @cached_property
    def cost(self) -> Cost:
        """What the run cost, with its parts.

        Raises
        ------
        RunError
            If the result does not say.
        """
        model = self.model
        durations = [contact.t_c for contact in model.contacts.values()]
        return coupled_cost(model.kind, self.result, durations, model.couplings, model.coupling)

    @property
    def exact(self) -> Mapping[str, float] | None:
        """None: of a bed there is no exact solution."""
        return None

    @property
    def predicted(self) -> Mapping[str, float] | None:
        """None: nor is its discretisation error predicted."""
        return None


def added(run: RunData | BedRunData) -> dict[str, Estimate]:
    """Return the metrics that installed packages add, of those that need no more than the run recorded."""
    found = {}
    for name, metric in METRICS.items():
        if metric.function is None or not set(metric.needs) <= set(run.recorded):
            continue
        try:
            value = metric.function(run)
        except InputError as error:
            found[name] = missing(str(error))
            continue
        found[name] = value if isinstance(value, Estimate) else Estimate(value=float(value))
    return found


def observed(run: BedRunData) -> BedRunData:
    """Return the run of a bed, observed.

    Raises
    ------
    InputError
        If it is too short for any average.
    """
    if not run.estimates:
        raise InputError(f"{run.result.folder}: nothing was recorded that could be observed")
    return run
