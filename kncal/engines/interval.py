"""Several gas steps in one coupling interval, taken together as if they were one."""

from __future__ import annotations

import numpy as np

from kncal.core.checks import Array
from kncal.engines.coupling import GasTransport
from kncal.record.steps import GasStep


def gas_interval(gas: GasTransport, x: Array, v: Array, diameter: Array, density: Array, steps: int) -> GasStep:
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
        As the transport does.
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
