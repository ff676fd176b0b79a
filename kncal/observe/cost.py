"""What a run cost, and what the softer spring saves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kncal.core.checks import in_range
from kncal.core.errors import InputError
from kncal.record.outcome import RunResult

#: Below this CPU time [s] a ratio of costs is not to be trusted (starting LIGGGHTS alone takes about 0.1 s).
CPU_TRUSTED = 1.0

#: Below this CPU time [s] a run is mostly the solver's start: no ratio is given.
CPU_MEASURABLE = 0.2


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What one model's run cost.

    Attributes
    ----------
    model : "linear" or "hertz"
    engine, version : of the solver
    steps, dt : number of steps and time step [s]
    steps_per_contact : shortest planned contact duration over dt [-], None without contacts
    cpu_seconds, cpu_low, cpu_high : median, smallest and largest CPU time of ``runs`` runs [s]
    wall_seconds : of the run that was read [s]
    cpu_per_step : cpu_seconds/steps [s]
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
    cpu_per_step: float


@dataclass(frozen=True, kw_only=True)
class Speed:
    """What the linear run saves: Hertz over linear, in steps and in CPU time (with its range, or None)."""

    steps: float
    cpu: float | None
    cpu_low: float | None
    cpu_high: float | None
    caveats: tuple[str, ...] = ()


def cost(model: str, result: RunResult, durations: Sequence[float], cpu_samples: Sequence[float] = ()) -> Cost:
    """Return the cost of a completed run; planned contact ``durations`` and ``cpu_samples`` of repeats in s.

    Raises
    ------
    InputError
        If the run has no steps, or a CPU time is negative or not finite.
    """
    if result.steps < 1:
        raise InputError(f"the {model} run in {result.folder} has {result.steps} steps: expected at least 1")
    samples = in_range(f"CPU seconds of the {model} run", list(cpu_samples) or [result.cpu_seconds], 0.0, np.inf)
    median = float(np.median(samples))
    return Cost(
        model=model,
        engine=result.engine,
        version=result.version,
        steps=result.steps,
        dt=float(result.dt),
        steps_per_contact=float(min(durations) / result.dt) if durations else None,
        cpu_seconds=median,
        cpu_low=float(samples.min()),
        cpu_high=float(samples.max()),
        runs=int(samples.size),
        wall_seconds=float(result.wall_seconds),
        cpu_per_step=median / result.steps,
    )


def speed(linear: Cost, hertz: Cost) -> Speed:
    """What ``linear`` saves against ``hertz``, with everything that makes the numbers doubtful."""
    caveats = []
    jumping = "builtin" in (linear.engine, hertz.engine)
    if jumping:
        caveats.append(
            "The builtin engine jumps over free flight in closed form: its CPU time says nothing about a solver's."
        )
    known = min(linear.cpu_low, hertz.cpu_low) >= CPU_MEASURABLE and not jumping
    if known and min(linear.cpu_seconds, hertz.cpu_seconds) < CPU_TRUSTED:
        caveats.append(
            f"A run below {CPU_TRUSTED:g} s of CPU is mostly the solver's start and the writing of frames:"
            " trust the ratio of steps, not the ratio of CPU times."
        )
    if known and min(linear.runs, hertz.runs) == 1:
        caveats.append("One run of each model was made: the spread of the CPU times is not known.")
    if linear.engine != hertz.engine or linear.version != hertz.version:
        caveats.append("The two runs are by different engines or versions: their CPU times don't compare.")
    n_l, n_h = linear.steps_per_contact, hertz.steps_per_contact
    if n_l is not None and n_h is not None and abs(n_l - n_h) > 0.01 * n_h:
        caveats.append(
            f"The runs differ in steps per contact ({n_l:.3g} linear, {n_h:.3g} Hertz):"
            " the ratio of steps is not the gain of the softer spring alone."
        )
    return Speed(
        steps=hertz.steps / linear.steps,
        cpu=hertz.cpu_seconds / linear.cpu_seconds if known else None,
        cpu_low=hertz.cpu_low / linear.cpu_high if known else None,
        cpu_high=hertz.cpu_high / linear.cpu_low if known else None,
        caveats=tuple(caveats),
    )
