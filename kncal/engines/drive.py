"""The one time loop: gas step, force, particle steps, and again; with invariants, frames and checkpoints.

Per coupling interval: positions and velocities go to the gas, the gas makes its steps and gives a force for each
particle, the particles run with that force held. Nothing here knows which solver is at work, or how it is reached.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from kncal.core.awake import awake
from kncal.core.checks import Array
from kncal.core.errors import RunError
from kncal.core.stopping import stop_where_it_suits
from kncal.engines.base import GasSolver, ParticleSolver, Progress
from kncal.engines.checkpoint import write_checkpoint
from kncal.record.facts import bed_facts
from kncal.record.series import PIECES, SeriesWriter
from kncal.record.steps import NOT_PASSED_LIMIT, REACTION_LIMIT, GasStep
from kncal.scene.model import Plan

#: Seconds of wall time between checkpoints.
CHECKPOINT_SECONDS = 60.0


@dataclass(frozen=True, kw_only=True)
class CoupledCost:
    """What a coupled run cost.

    Attributes
    ----------
    couplings : done, the parts before a stop included, as in all other numbers
    dem, gas, exchange : CPU seconds of LIGGGHTS, of DPMFoam, and of this process (everything else)
    wall : wall-clock seconds
    """

    couplings: int
    dem: float
    gas: float
    exchange: float
    wall: float


class _Meter:
    """What a run has cost so far; ``before``: its parts before a stop (numbers of `CoupledCost`, by name)."""

    def __init__(self, particles: ParticleSolver, gas: GasSolver | None, before: Mapping[str, float]) -> None:
        self._particles, self._gas, self._before = particles, gas, before
        self._wall, self._cpu = time.monotonic(), time.thread_time()

    def __call__(self, couplings: int) -> CoupledCost:
        parts = {
            "dem": self._particles.cpu_seconds,
            "gas": 0.0 if self._gas is None else self._gas.cpu_seconds,
            "exchange": time.thread_time() - self._cpu,
            "wall": time.monotonic() - self._wall,
        }
        return CoupledCost(couplings=couplings, **{k: self._before.get(k, 0.0) + part for k, part in parts.items()})


def drive(
    plan: Plan,
    particles: ParticleSolver,
    gas: GasSolver | None,
    folder: Path,
    *,
    first: int = 0,
    before: Mapping[str, float] | None = None,
    progress: Progress | None = None,
    time_limit: float | None = None,
) -> CoupledCost:
    """Run to the end of the plan, or raise.

    Parameters
    ----------
    plan : Plan
    particles : at the state after coupling ``first``
    gas : likewise; None for a scene without gas
    folder : Path
        Gets ``series/`` (see `kncal.record.series`) and checkpoints.
    first : number of couplings done already; before : what they cost
    time_limit : wall-clock limit [s]

    Raises
    ------
    RunError
        If a solver ends, hangs, loses a particle or a parcel, or an invariant is broken; what was computed before
        is on disk.
    TimeoutError, KeyboardInterrupt
        If ``time_limit`` [s] is over, or it was asked to stop; it goes on from the last coupling, which is saved.
    """
    begin, saved = awake(), time.monotonic()
    spent, flow = _Meter(particles, gas, before or {}), None if gas is None else _GasSide(plan, gas)
    facts = bed_facts(plan, particles.histogram_edges, particles.impact_edges, particles.walls)
    with stop_where_it_suits() as stop, SeriesWriter(folder / PIECES, facts) as series:

        def keep(number: int) -> None:
            series.flush()
            save_gas = None if gas is None else gas.save
            write_checkpoint(folder, number, asdict(spent(number)), save_gas, particles.save)

        state = particles.state()
        if first == 0 and gas is None:
            series.frame(0, state, None)  # with gas there are no fields before the first step
        for number in range(first + 1, plan.couplings + 1):
            inlet, gas_step = (0.0, None) if flow is None else flow(state.x, state.v, number)
            dem_step = particles.run(plan.steps_per_coupling, None if gas_step is None else gas_step.force)
            state = particles.state()
            series.add(number, inlet, gas_step, dem_step, state)
            if number % plan.frames_every == 0:
                series.frame(number, state, None if gas is None else gas.fields())
            particles.end_interval(number)
            if stop():
                keep(number)
                raise KeyboardInterrupt
            if progress is not None:
                progress(number, plan.couplings)
            if (now := time.monotonic()) - saved > CHECKPOINT_SECONDS:
                keep(number)
                saved = now
            if time_limit is not None and awake() - begin > time_limit and number < plan.couplings:
                keep(number)
                raise TimeoutError(f"stopped after coupling {number} of {plan.couplings}: {time_limit:g} s are over")
        return spent(plan.couplings)


class _GasSide:
    """The gas of one scene: its inlet velocity by time, and its step with the particles of the scene."""

    def __init__(self, plan: Plan, gas: GasSolver) -> None:
        self._plan, self._gas = plan, gas
        self._diameter = np.full(plan.scene.number, plan.scene.diameter)
        self._density = np.full(plan.scene.number, plan.scene.density)
        mass = self._density * np.pi / 6.0 * self._diameter**3
        self._weight = float(mass.sum()) * plan.scene.g

    def __call__(self, x: Array, v: Array, number: int) -> tuple[float, GasStep]:
        """Return the inlet velocity of coupling ``number`` [m/s], and what the gas did; RunError if it is not right."""
        plan, setting = self._plan, self._plan.scene.gas
        inlet = 0.0 if setting is None else setting.inlet_at((number - 0.5) * plan.coupling)
        if setting is not None and setting.ramp:
            self._gas.set_inlet(inlet)
        step = gas_interval(self._gas, x, v, self._diameter, self._density, plan.gas_steps)
        for name, value, limit in (
            ("reaction error", step.reaction_error, REACTION_LIMIT),
            ("momentum not passed on", step.not_passed, NOT_PASSED_LIMIT),
        ):
            if self._weight > 0.0 and value > limit * self._weight:
                raise RunError(
                    f"coupling {number}: {name} {value / self._weight:.3g} of the bed's weight, expected at most "
                    f"{limit:g}: particles move too far in one gas step; take a smaller run.coupling or larger cells",
                    "broken-invariant",
                )
        return inlet, step


def gas_interval(gas: GasSolver, x: Array, v: Array, diameter: Array, density: Array, steps: int) -> GasStep:
    """Advance the gas by ``steps`` steps with particles that fly straight on from ``x``, ``v`` (n, 3) meanwhile.

    Were they held where they are, the first step would see the way of the whole interval at once, and the gas
    would be pressed out of their new places ``steps`` times too fast. One that would fly out stops at the boundary.

    Returns
    -------
    GasStep
        Force and pressure are means over the steps, so the momentum of all steps is passed on. ``reaction_error`` and
        ``not_passed`` are means of the steps' sizes, no less than the size of their mean; the others are the worst.

    Raises
    ------
    RunError
        As the gas solver does.
    """
    if steps == 1:
        return gas.step(x, v, diameter, density)
    low, high = np.zeros(3), np.array(gas.setup.size)
    if gas.setup.front_back == "periodic":
        low[1], high[1] = -np.inf, np.inf
    # A centre on the boundary, or outside by rounding, stays what it is: the transport judges it.
    low, high = np.minimum(low, x), np.maximum(high, x)
    done = [
        gas.step(np.clip(x + number * gas.setup.step * v, low, high), v, diameter, density) for number in range(steps)
    ]
    return GasStep(
        force=np.mean([step.force for step in done], axis=0),
        p_in=float(np.mean([step.p_in for step in done])),
        reaction_error=float(np.mean([step.reaction_error for step in done])),
        not_passed=float(np.mean([step.not_passed for step in done])),
        solids_error=max(step.solids_error for step in done),
        eps_g_min=min(step.eps_g_min for step in done),
        courant_max=max(step.courant_max for step in done),
    )
