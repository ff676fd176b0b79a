"""A completed run with everything that is read from it: its record, its metrics with their widths, and its cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.observe.averages import BedObservations, observe_bed
from kncal.observe.contacts import Observations
from kncal.observe.cost import Cost, cost
from kncal.observe.estimate import Estimate, missing
from kncal.observe.grain_metrics import GRAIN_METRICS, grain_estimate, one_packing
from kncal.observe.granular import GrainObservations
from kncal.record.frames import Trajectory
from kncal.record.outcome import RunResult
from kncal.record.series import BedSeries
from kncal.scene.metrics import FEW_PARTICLES, METRICS
from kncal.scene.model import Plan

_T = TypeVar("_T")


class ExactMotion(Protocol):
    """The exact motion of a model, as `kncal.scene.exact.solve` returns it."""

    def at(self, times: Array) -> tuple[Array, Array]:
        """Positions [m] and velocities [m/s], each (times, particles, 3), at ``times`` [s]."""
        ...


@dataclass(frozen=True, kw_only=True)
class RunData:
    """One completed run: what it recorded, and what is read from that.

    Attributes
    ----------
    model, result : what was run, and how it ended; ``result.extra`` of a run with couplings holds what
        `kncal.observe.cost.EXTRA` names
    frames, contacts : the motion of a few particles, dense in time during each contact, and what it shows; or None
    signals : what was recorded per coupling, with its frames; or None
    exact : metric -> value of the exact solution of the same model [SI], or None
    predicted : metric -> predicted relative discretisation error at this dt (worst phase) [-], or None
    motion : the exact motion of the same model, for figures, or None
    cpu_samples : CPU seconds of repeated runs of the same input; empty: only ``result.cpu_seconds``
    """

    model: Plan
    result: RunResult
    frames: Trajectory | None = None
    contacts: Observations | None = None
    signals: BedSeries | None = None
    exact: Mapping[str, float] | None = None
    predicted: Mapping[str, float] | None = None
    motion: ExactMotion | None = None
    cpu_samples: tuple[float, ...] = ()

    @property
    def trajectory(self) -> Trajectory:
        """``frames``; `InputError` without."""
        return self._recorded(self.frames, "frames during contacts")

    @property
    def observations(self) -> Observations:
        """``contacts``; `InputError` without."""
        return self._recorded(self.contacts, "single contacts")

    @property
    def series(self) -> BedSeries:
        """``signals``; `InputError` without."""
        return self._recorded(self.signals, "numbers per coupling")

    def _recorded(self, found: _T | None, what: str) -> _T:
        if found is None:
            raise InputError(f"{self.result.folder}: the run recorded no {what}: expected a run that does")
        return found

    @cached_property
    def recorded(self) -> tuple[str, ...]:
        """Names of `kncal.scene.metrics.RECORDS` that the run has."""
        few = () if self.frames is None else FEW_PARTICLES
        if (series := self.signals) is None:
            return few
        has = {
            "frames": len(series.t_frame) > 0,
            "series:pressure": series.facts.gas_density > 0.0,
            "series:forces": self.model.scene.run.coupling is not None and bool(np.isfinite(series.floor).any()),
            "series:particles": True,
            "series:overlaps": bool(np.isfinite(series.overlap_max).any()),
            "fields:eps_g": len(series.eps_g) > 0,
        }
        facts, grains = series.facts, self._granular
        has |= {
            "frames:grains": grains and has["frames"],
            "frames:kinds": grains and has["frames"] and self._loose_kinds > 1,
            "frames:surface": grains and has["frames"] and self.model.scene.observe.surface is not None,
            "series:outlets": len(facts.outlets) > 0,
            "series:grains": grains,
            "series:walls": grains and len(facts.walls) > 0,
        }
        return (*few, *(name for name, there in has.items() if there))

    @cached_property
    def seen(self) -> BedObservations:
        """What the signals show after the start-up: after ``run.discard`` of the scene, or as detected.

        Raises
        ------
        InputError
            If there are none, or the run is too short for any average.
        """
        scene = self.model.scene
        return observe_bed(self.series, scene.run.discard, scene.gas)

    @cached_property
    def grains(self) -> GrainObservations | None:
        """What is seen of many particles that move without gas; None of other runs.

        Raises
        ------
        InputError
            As `seen`.
        """
        if not self._granular:
            return None
        return GrainObservations(series=self.series, scene=self.model.scene, window=self.seen.window)

    @property
    def _loose_kinds(self) -> int:
        """Number of kinds of particles that are not held in place."""
        groups = self.model.scene.particles
        return sum(not groups[name].frozen for name in self.series.facts.groups if name in groups)

    @property
    def _granular(self) -> bool:
        """Whether many particles move without gas."""
        series = self.signals
        if series is None or series.facts.gas_density > 0.0 or series.facts.count < 2:
            return False
        return bool(np.isfinite(series.contacts).any())

    @cached_property
    def estimates(self) -> Mapping[str, Estimate]:
        """Every metric of the run, also those of installed packages; what means nothing for it is not among them."""
        found: dict[str, Estimate] = {}
        if self.contacts is not None:
            found |= {name: self._estimate(name, value) for name, value in self.contacts.metrics.items()}
        if self.signals is not None:
            found |= {name: one for name, one in self.seen.estimates.items() if self._recorded_for(name)}
        if (grains := self.grains) is not None:
            names = [name for name in GRAIN_METRICS if self.measures(name)]
            found |= {name: grain_estimate(grains, name) for name in names}
            if grains.resting:
                found |= {name: one_packing(name, one, found) for name, one in found.items()}
        return found | added(self)

    def measures(self, name: str) -> bool:
        """Whether such a run has a metric: it means something for it, and what it needs was recorded."""
        return self._recorded_for(name) and not self.why_not(name)

    def _recorded_for(self, name: str) -> bool:
        return set(METRICS[name].needs) <= set(self.recorded)

    def _estimate(self, name: str, value: float) -> Estimate:
        if not np.isfinite(value):
            return missing(f"{name} is not finite")
        share = (self.predicted or {}).get(name)
        return Estimate(value=float(value), width=None if share is None else abs(share * value))

    def estimate(self, name: str) -> Estimate:
        """Return a metric; one without a value, and why, if the run does not have it."""
        return self.estimates.get(name) or missing(self.why_not(name) or f"no {name} in the run")

    def why_not(self, name: str) -> str:
        """Return why a metric means nothing for such a run; "" if it may have it."""
        return self.seen.why_not(name) if self.signals is not None else ""

    @cached_property
    def cost(self) -> Cost:
        """What the run cost, with its parts.

        Raises
        ------
        RunError
            If the result does not say.
        """
        return cost(self.model, self.result, self.cpu_samples)


def added(run: RunData) -> dict[str, Estimate]:
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
