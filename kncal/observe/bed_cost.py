"""What a bed run cost: particles, gas, exchange; and what the softer spring saves of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from kncal.core.errors import RunError
from kncal.observe.cost import Cost, Speed, cost, speed
from kncal.record.outcome import RunResult
from kncal.scene.model import BedModel

#: What `RunResult.extra` of a bed run must hold, CPU times in s.
EXTRA = ("transport", "cpu_dem", "cpu_gas", "cpu_exchange")


@dataclass(frozen=True, kw_only=True)
class BedCost:
    """CPU time [s] of one run and its parts.

    Attributes
    ----------
    dem : Cost of the particle side alone (its ``cpu_seconds`` are LIGGGHTS')
    transport : "live", "restart", ... as the run says
    gas, exchange : CPU time of DPMFoam, and of everything that is neither solver
    total : of all processes together
    wall : wall-clock time
    couplings : number; coupling : interval [s]; simulated : time [s]
    """

    dem: Cost
    transport: str
    gas: float
    exchange: float
    total: float
    wall: float
    couplings: int
    coupling: float
    simulated: float

    @property
    def exchange_share(self) -> float | None:
        """Share of the total that is neither solver [-]; None for a run that took no time."""
        return self.exchange / self.total if self.total > 0.0 else None


def bed_cost(model: BedModel, result: RunResult) -> BedCost:
    """Return the cost of a completed run.

    Raises
    ------
    RunError
        If the result lacks one of `EXTRA`.
    """
    if missing := [name for name in EXTRA if name not in result.extra]:
        raise RunError(
            f"result of {result.folder}: {', '.join(missing)} missing in 'extra'; expected the result of a bed run"
        )
    gas, exchange, dem = (float(result.extra[name]) for name in ("cpu_gas", "cpu_exchange", "cpu_dem"))
    durations = [contact.t_c for contact in model.contacts.values()]
    return BedCost(
        dem=cost(model.kind, replace(result, cpu_seconds=dem), durations),
        transport=str(result.extra["transport"]),
        gas=gas,
        exchange=exchange,
        total=dem + gas + exchange,
        wall=float(result.wall_seconds),
        couplings=model.couplings,
        coupling=model.coupling,
        simulated=model.couplings * model.coupling,
    )


def bed_speed(linear: BedCost, hertz: BedCost) -> tuple[Speed, float | None]:
    """What the linear run saves: of the particle side, and Hertz over linear in total CPU time (None if too short)."""
    saved = speed(linear.dem, hertz.dem)
    return saved, hertz.total / linear.total if saved.cpu is not None else None
