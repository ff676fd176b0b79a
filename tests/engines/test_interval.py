"""Several gas steps in one coupling interval."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from gas_columns import alike, needs_openfoam, packing, setup, weight

from kncal.engines.base import GasSetup, GasSolver
from kncal.engines.dpmfoam.restart import RestartGas
from kncal.engines.drive import gas_interval
from kncal.record.steps import NOT_PASSED_LIMIT, REACTION_LIMIT

pytestmark = needs_openfoam


def bed():
    """A loose packing over the lower third of the column, clear of the walls."""
    x = packing((0.015, 0.006, 0.015))
    return x, *alike(x)


def test_steps_of_an_interval_are_single_steps_of_the_same_length(tmp_path: Path) -> None:
    x, d, rho = bed()
    v = np.zeros_like(x)
    together, apart = RestartGas(setup(), tmp_path / "a"), RestartGas(setup(), tmp_path / "b")
    interval = gas_interval(together, x, v, d, rho, 3)
    single = [apart.step(x, v, d, rho) for _ in range(3)]
    np.testing.assert_array_equal(interval.force, np.mean([s.force for s in single], axis=0))
    assert interval.p_in == np.mean([s.p_in for s in single])
    assert interval.courant_max == max(s.courant_max for s in single)
    np.testing.assert_array_equal(together.fields().U, apart.fields().U)


def test_particles_fly_on_between_the_steps_of_an_interval(tmp_path: Path) -> None:
    """A block that sinks evenly as a whole pushes as much gas out below in each step as it lets in above."""
    x, d, rho = bed()
    x[:, 2] += 0.012
    v = np.tile([0.0, 0.0, -0.5], (len(x), 1))
    step, steps = 5e-4, 4
    together, apart = RestartGas(setup(step=step), tmp_path / "a"), RestartGas(setup(step=step), tmp_path / "b")
    interval = gas_interval(together, x, v, d, rho, steps)
    single = [apart.step(x + k * step * v, v, d, rho) for k in range(steps)]
    np.testing.assert_array_equal(interval.force, np.mean([s.force for s in single], axis=0))
    assert interval.solids_error < 1e-14
    assert interval.reaction_error < REACTION_LIMIT * weight(x)
    assert interval.not_passed < NOT_PASSED_LIMIT * weight(x)


def test_particles_stop_at_the_boundary_instead_of_flying_out(tmp_path: Path) -> None:
    x = np.array([[0.0075, 0.003, 0.0006]])
    v = np.array([[0.0, 0.0, -2.0]])  # 1 mm per step: out of the floor in the second
    d, rho = alike(x)
    gas = RestartGas(setup(), tmp_path / "case")
    result = gas_interval(gas, x, v, d, rho, 3)
    assert np.isfinite(result.force).all()
    assert result.force[0, 2] > 0.0  # drag on a falling particle, and buoyancy
    assert result.solids_error < 1e-14


@pytest.mark.parametrize("depth", ["walls", "periodic"])
def test_shorter_gas_steps_converge(quick: Callable[[GasSetup], GasSolver], depth: str) -> None:
    """The force on particles at rest tends to that of a steady flow whatever the step; first order in between."""
    x, d, rho = bed()
    v = np.zeros_like(x)
    total = 2e-3
    forces = {}
    for steps in (1, 2, 4, 8):
        gas = quick(setup(step=total / steps, front_back=depth))
        forces[steps] = gas_interval(gas, x, v, d, rho, steps).force[:, 2].sum()
    first, second, third = (abs(forces[2 * n] - forces[n]) for n in (1, 2, 4))
    assert second < first
    assert third < second
    assert forces[8] > 0.0
