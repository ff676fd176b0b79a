"""A single particle in the gas: the velocity it ends with, and what the drag law says of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kncal.core.errors import InputError
from kncal.physics.fluidization import relaxation_time, settling_velocity, terminal_velocity
from kncal.record.series import BedSeries
from kncal.scene.gas import Gas

#: A force on a wall above this share of m g is a contact; below, it is what rounding leaves of the momentum balance.
TOUCHES = 1e-6


@dataclass(frozen=True, kw_only=True)
class FinalVelocity:
    """The end of the fall of one particle.

    Attributes
    ----------
    time : of the last coupling [s]
    velocity : of the particle, upwards [m/s]; slip : U_0 less it [m/s]
    uncertainty, slip_uncertainty : by how much they still varied in the last relaxation time [m/s]; a
        velocity that approaches its end exponentially is nearer to it than that
    relaxation : particle relaxation time at the final slip [s]
    terminal : slip of the force balance, see `kncal.physics.fluidization.terminal_velocity` [m/s]
    settling : velocity at ``time`` by the equation of motion, see `kncal.physics.fluidization.settling_velocity` [m/s];
        None where the inlet velocity changed
    """

    time: float
    velocity: float
    slip: float
    uncertainty: float
    slip_uncertainty: float
    relaxation: float
    terminal: float
    settling: float | None


def final_velocity(series: BedSeries, gas: Gas | None) -> FinalVelocity:
    """Return the final velocity of a run with one particle in ``gas``; the gas is taken as undisturbed, U_0.

    Raises
    ------
    InputError
        If there is not exactly one particle, no gas or a jet, if the particle touches something at the end, or if the
        run is shorter than its relaxation time.
    """
    facts = series.facts
    if facts.count != 1:
        raise InputError(f"{facts.count} particles: expected a single one")
    if gas is None or facts.jet:
        raise InputError("no gas: nothing brings it to a final velocity" if gas is None else "the gas is a jet")
    velocities = series.momentum_z / facts.mass
    slips = series.U_0 - velocities
    v, slip, end = float(velocities[-1]), float(slips[-1]), float(series.t[-1])
    tau = float(relaxation_time(facts.density, facts.diameter, gas.density, gas.viscosity, slip=abs(slip)))
    if tau > end:
        raise InputError(f"the run of {end:.3g} s is shorter than the relaxation time, {tau:.3g} s: run longer")
    last = series.t >= end - tau
    touch = TOUCHES * facts.mass * max(facts.gravity, 1.0)
    if np.any(np.abs(series.floor[last]) > touch) or np.any(np.abs(series.walls[last]) > touch):
        raise InputError(
            "the particle touches floor, wall or lid at the end: expected a higher column or a shorter run"
        )
    settling = None
    if facts.gravity > 0.0 and np.ptp(series.U_0) == 0.0:
        settling = float(
            settling_velocity(
                [end],
                facts.diameter,
                facts.density,
                gas.density,
                gas.viscosity,
                gravity=facts.gravity,
                U_gas=float(series.U_0[0]),
            )[0]
        )
    terminal = 0.0
    if facts.gravity > 0.0:
        terminal = float(terminal_velocity(facts.diameter, facts.density, gas.density, gas.viscosity, facts.gravity))
    return FinalVelocity(
        time=end,
        velocity=v,
        slip=slip,
        uncertainty=float(np.ptp(velocities[last])),
        slip_uncertainty=float(np.ptp(slips[last])),
        relaxation=tau,
        terminal=terminal,
        settling=settling,
    )
