"""What a run cost, and what the softer spring saves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kncal.core.checks import in_range
from kncal.core.errors import InputError, RunError
from kncal.record.outcome import RunResult
from kncal.scene.model import Plan

#: Below this CPU time [s] a ratio of costs is not to be trusted (starting LIGGGHTS alone takes about 0.1 s).
CPU_TRUSTED = 1.0

#: Below this CPU time [s] a run is mostly the solver's start: no ratio is given.
CPU_MEASURABLE = 0.2

#: What `RunResult.extra` of a run with gas must hold, CPU times in s.
EXTRA = ("transport", "cpu_dem", "cpu_gas", "cpu_exchange")


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What one run cost.

    Attributes
    ----------
    model : contact model
    engine, version : of the solver
    steps, dt : number of steps of the particles and time step [s]
    steps_per_contact : shortest planned contact duration over dt [-], None without contacts
    cpu_seconds, cpu_low, cpu_high : of the particles: median, smallest and largest CPU time of ``runs`` runs [s]
    gas, exchange : CPU time of the gas, and of all that is neither particles nor gas [s]
    wall_seconds : of the run that was read [s]
    transport : how gas and particles exchange, "" without gas
    couplings, coupling : their number, and the interval [s]
    """

    model: str
    engine: str
    version: str
    steps: int
    dt: float
    steps_per_contact: float | None
    cpu_seconds: float
    cpu_low: float
    cpu_high: float
    runs: int
    wall_seconds: float
    gas: float = 0.0
    exchange: float = 0.0
    transport: str = ""
    couplings: int = 0
    coupling: float = 0.0

    @property
    def cpu_per_step(self) -> float:
        """CPU time of the particles per step [s]."""
        return self.cpu_seconds / self.steps

    @property
    def has_gas(self) -> bool:
        """Whether a gas solver took part."""
        return self.transport not in ("", "none")

    @property
    def total(self) -> float:
        """CPU time of all processes together [s]."""
        return self.cpu_seconds + self.gas + self.exchange

    @property
    def simulated(self) -> float:
        """Simulated time [s]."""
        return self.couplings * self.coupling if self.couplings else self.steps * self.dt


@dataclass(frozen=True, kw_only=True)
class Speed:
    """What a run saves: reference over run, in steps and in CPU time of the particles (with its range) and in total.

    CPU times are None where they are too short to tell.
    """

    steps: float
    cpu: float | None
    cpu_low: float | None
    cpu_high: float | None
    total: float | None = None
    caveats: tuple[str, ...] = ()


def cost(model: Plan, result: RunResult, cpu_samples: Sequence[float] = ()) -> Cost:
    """Return the cost of a completed run of ``model``; ``cpu_samples`` of repeats [s].

    Raises
    ------
    InputError
        If the run has no steps, or a CPU time is negative or not finite.
    RunError
        If the result of a run with couplings lacks one of `EXTRA`.
    """
    if result.steps < 1:
        raise InputError(f"the {model.kind} run in {result.folder} has {result.steps} steps: expected at least 1")
    parts: dict[str, Any] = {}
    if model.couplings:
        if lacking := [name for name in EXTRA if name not in result.extra]:
            raise RunError(
                f"result of {result.folder}: {', '.join(lacking)} missing in 'extra'; expected the result of a bed run"
            )
        parts = {
            "gas": float(result.extra["cpu_gas"]),
            "exchange": float(result.extra["cpu_exchange"]),
            "transport": str(result.extra["transport"]),
            "couplings": model.couplings,
            "coupling": model.coupling,
        }
    particles = float(result.extra["cpu_dem"]) if parts else result.cpu_seconds
    samples = in_range(f"CPU seconds of the {model.kind} run", list(cpu_samples) or [particles], 0.0, np.inf)
    return Cost(
        model=model.kind,
        engine=result.engine,
        version=result.version,
        steps=result.steps,
        dt=float(result.dt),
        steps_per_contact=float(model.shortest / result.dt) if model.contacts else None,
        cpu_seconds=float(np.median(samples)),
        cpu_low=float(samples.min()),
        cpu_high=float(samples.max()),
        runs=int(samples.size),
        wall_seconds=float(result.wall_seconds),
        **parts,
    )


def speed(run: Cost, reference: Cost) -> Speed:
    """What ``run`` saves against ``reference``, with everything that makes the numbers doubtful."""
    caveats = []
    jumping = "builtin" in (run.engine, reference.engine)
    if jumping:
        caveats.append(
            "The builtin engine jumps over free flight in closed form: its CPU time says nothing about a solver's."
        )
    known = min(run.cpu_low, reference.cpu_low) >= CPU_MEASURABLE and not jumping
    if known and min(run.cpu_seconds, reference.cpu_seconds) < CPU_TRUSTED:
        caveats.append(
            f"A run below {CPU_TRUSTED:g} s of CPU is mostly the solver's start and the writing of frames:"
            " trust the ratio of steps, not the ratio of CPU times."
        )
    if known and min(run.runs, reference.runs) == 1:
        caveats.append("One run of each model was made: the spread of the CPU times is not known.")
    if run.engine != reference.engine or run.version != reference.version:
        caveats.append("The two runs are by different engines or versions: their CPU times don't compare.")
    n, n_reference = run.steps_per_contact, reference.steps_per_contact
    if n is not None and n_reference is not None and abs(n - n_reference) > 0.01 * n_reference:
        caveats.append(
            f"The runs differ in steps per contact ({n:.3g} {run.model}, {n_reference:.3g} {reference.model}):"
            " the ratio of steps is not the gain of the softer spring alone."
        )
    return Speed(
        steps=reference.steps / run.steps,
        cpu=reference.cpu_seconds / run.cpu_seconds if known else None,
        cpu_low=reference.cpu_low / run.cpu_high if known else None,
        cpu_high=reference.cpu_high / run.cpu_low if known else None,
        total=reference.total / run.total if known else None,
        caveats=tuple(caveats),
    )
