"""The exchange loop: gas step, force, particle steps, and again; with invariants, frames and checkpoints.

Per coupling interval: positions and velocities go to the gas, the gas makes its steps and gives a force for each
particle, the particles run with that force held. Nothing here knows which transport or which solver is at work.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from kncal.core.awake import awake
from kncal.core.checks import Array
from kncal.core.errors import RunError
from kncal.core.stopping import stop_where_it_suits
from kncal.engines.checkpoint import write_checkpoint
from kncal.engines.coupling import Dem, GasSetup, GasTransport
from kncal.engines.interval import gas_interval
from kncal.record.facts import bed_facts
from kncal.record.series import SeriesWriter
from kncal.record.steps import NOT_PASSED_LIMIT, REACTION_LIMIT, GasStep
from kncal.scene.model import BedModel

#: Seconds of wall time between checkpoints.
CHECKPOINT_SECONDS = 60.0

#: Called after each coupling with (couplings done, couplings in all).
Progress = Callable[[int, int], None]


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


def gas_setup(model: BedModel) -> GasSetup | None:
    """Return what the gas side needs to know, None for a bed without gas."""
    scene, gas = model.scene, model.scene.gas
    if gas is None:
        return None
    column = scene.column
    return GasSetup(
        size=(column.width, column.depth, column.height),
        cells=column.cells,
        inlet=gas.inlet_at(0.0),
        jet=gas.jet,
        density=gas.density,
        viscosity=gas.viscosity,
        gravity=scene.gravity,
        step=model.gas_step,
        drag=gas.drag,
        walls=column.gas_walls,
        front_back=column.front_back,
        parcels_per_particle=gas.parcels_per_particle,
    )


class CoupledRun:
    """One bed at work.

    Parameters
    ----------
    model : BedModel
    folder : Path
        Gets ``series/`` (see `kncal.record.series`) and ``checkpoint/``.
    gas : GasTransport, or None for a bed without gas
    dem : Dem, or None for frozen particles
    positions : (n, 3) [m], of frozen particles; not used with ``dem``
    first : number of couplings done already (continuing from a checkpoint); before : what they cost
    histogram_edges : (bins + 1,) [m]
    """

    def __init__(
        self,
        model: BedModel,
        folder: Path,
        gas: GasTransport | None,
        dem: Dem | None,
        *,
        positions: Array,
        histogram_edges: Array,
        first: int = 0,
        before: Mapping[str, float] | None = None,
    ) -> None:
        self.model, self.folder, self.gas, self.dem = model, folder, gas, dem
        self._frozen = (positions, np.zeros_like(positions))
        self._first = first
        self._before = before or {}
        self._edges = histogram_edges
        particles = model.scene.particles
        self._diameter = np.full(particles.count, particles.diameter)
        self._density = np.full(particles.count, float(particles.material.density))
        mass = self._density * np.pi / 6.0 * self._diameter**3
        self._weight = float(mass.sum()) * model.scene.gravity

    def run(self, progress: Progress | None = None, *, time_limit: float | None = None) -> CoupledCost:
        """Run to the end of the model, or raise.

        Raises
        ------
        RunError
            If a solver ends, hangs, loses a particle or a parcel, or an invariant is broken; what was computed before
            is on disk.
        TimeoutError, KeyboardInterrupt
            If ``time_limit`` [s] is over, or it was asked to stop; it goes on from the last coupling, which is saved.
        """
        model, started, cpu, begin = self.model, time.monotonic(), time.thread_time(), awake()
        saved = started
        before = self._before

        def spent(number: int) -> CoupledCost:
            return CoupledCost(
                couplings=number,
                dem=before.get("dem", 0.0) + (0.0 if self.dem is None else self.dem.cpu_seconds),
                gas=before.get("gas", 0.0) + (0.0 if self.gas is None else self.gas.cpu_seconds),
                exchange=before.get("exchange", 0.0) + time.thread_time() - cpu,
                wall=before.get("wall", 0.0) + time.monotonic() - started,
            )

        facts = bed_facts(model, self._edges, None if self.dem is None else self.dem.impact_edges)
        with stop_where_it_suits() as stop, SeriesWriter(self.folder / "series", facts) as series:
            x, v = self._state()
            if self._first == 0 and self.gas is None:
                series.frame(0, x, v, None)  # with gas there are no fields before the first step
            for number in range(self._first + 1, model.couplings + 1):
                inlet = 0.0 if model.scene.gas is None else model.scene.gas.inlet_at((number - 0.5) * model.coupling)
                gas_step = self._gas_step(x, v, inlet, number)
                force = np.zeros_like(x) if gas_step is None else gas_step.force
                dem_step = None if self.dem is None else self.dem.run(model.steps_per_coupling, force)
                x, v = self._state()
                series.add(number, inlet, gas_step, dem_step, x, v)
                if number % model.frames_every == 0:
                    series.frame(number, x, v, None if self.gas is None else self.gas.fields())
                if stop():
                    self._keep(series, number, spent(number))
                    raise KeyboardInterrupt
                if progress is not None:
                    progress(number, model.couplings)
                now = time.monotonic()
                if now - saved > CHECKPOINT_SECONDS:
                    self._keep(series, number, spent(number))
                    saved = now
                if time_limit is not None and awake() - begin > time_limit and number < model.couplings:
                    self._keep(series, number, spent(number))
                    raise TimeoutError(
                        f"stopped after coupling {number} of {model.couplings}: {time_limit:g} s are over"
                    )
            return spent(model.couplings)

    def _state(self) -> tuple[Array, Array]:
        return self._frozen if self.dem is None else self.dem.state()

    def _gas_step(self, x: Array, v: Array, inlet: float, number: int) -> GasStep | None:
        if self.gas is None:
            return None
        gas = self.model.scene.gas
        if gas is not None and gas.ramp:
            self.gas.set_inlet(inlet)
        step = gas_interval(self.gas, x, v, self._diameter, self._density, self.model.gas_steps)
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
        return step

    def _keep(self, series: SeriesWriter, number: int, cost: CoupledCost) -> None:
        """Write the state after coupling ``number``."""
        series.flush()
        write_checkpoint(
            self.folder,
            number,
            asdict(cost),
            None if self.gas is None else self.gas.save,
            None if self.dem is None else self.dem.save,
        )
