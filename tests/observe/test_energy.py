"""The energy balance: exact where it must be, and its error of the predicted order."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from models import with_bodies

from kncal.core.errors import ValidityError
from kncal.engines.builtin.integrator import integrate
from kncal.observe.contacts import observe
from kncal.observe.energy import balance_of, energy
from kncal.scene.case_file import load_case
from kncal.scene.plan import plan
from kncal.study.stability.accuracy import steps_of_impact
from kncal.study.stability.probes import at_step, impact_on_wall, ingredients

SPHERE = ingredients(load_case("wall_impact"))


def balance(kind: str, e_n: float, n: float) -> float:
    """Root mean square over sub-step phases of the balance error of an impact at n steps per contact [-]."""
    probe = impact_on_wall(SPHERE, kind, e_n)
    t_c = probe.model.between("s0", "floor").t_c
    model = at_step(probe.model, t_c / n, steps_of_impact(probe, t_c / n))
    frames = integrate(model)
    found = energy(model, frames)
    # the energy of all spheres is in the balance of each, and their contacts overlap in time: one at the end of all
    return abs(float(found.error[-1] / found.kinetic[0]))


@pytest.mark.parametrize("kind", ["linear", "hertz"])
@pytest.mark.parametrize(("e_n", "order"), [(0.9, 1.0), (0.5, 1.0), (1.0, 2.0)])
def test_balance_error_goes_to_zero_at_the_predicted_order(kind: str, e_n: float, order: float) -> None:
    """First order with a dashpot (its force lags by half a step), at least second without.

    Steps chosen without a common factor, and a range of 16: the sawtooth of the sub-step phases changes the error by a
    factor of two at most in a mean over eight phases, 0.25 of the order.
    """
    coarse, fine = balance(kind, e_n, 51.3), balance(kind, e_n, 16.0 * 51.3)
    measured = math.log2(coarse / fine) / 4.0
    assert measured > order - 0.25
    if order == 1.0:
        assert measured < order + 0.25
        assert coarse < 2.0 / 51.3


def test_each_form_of_energy_against_mechanics() -> None:
    """A ball falls on a floor: m g h, then ½ m v², then all in the spring; to second order of the step."""
    scene = load_case("falling_particle")
    scene = replace(scene, contact=replace(scene.contact, e_n=1.0), run=replace(scene.run, until_bounces=1))
    model = plan(scene, ("linear",))["linear"]
    frames = integrate(model)
    found = energy(model, frames)
    (ball,) = scene.spheres
    m = ball.material.density * 4.0 / 3.0 * math.pi * ball.radius**3
    touch = int(np.flatnonzero(frames.x[:, 0, 2] < ball.radius)[0]) - 1
    fallen = 0.5 - frames.x[touch, 0, 2]
    assert found.potential[touch] == pytest.approx(-m * 9.80665 * fallen, rel=1e-12)
    assert found.kinetic[touch] == pytest.approx(m * 9.80665 * fallen, rel=1e-9)
    deepest = int(np.argmin(frames.x[:, 0, 2]))
    c = model.between("ball", "floor")
    delta = ball.radius - frames.x[deepest, 0, 2]
    assert found.stored[deepest] == pytest.approx(0.5 * c.k * delta**2, rel=1e-12)
    # the shadow energy of velocity Verlet differs from the energy by (omega dt)²/4 at most, (pi/50)²/4 here
    assert abs(found.error).max() <= 0.3 * (math.pi / 50.0) ** 2 * found.kinetic.max()
    assert not found.dissipated.any()
    (event,) = observe(model, frames).contacts
    # each crossing of the surface within a step gives or takes (omega dt)² theta (1 - theta), theta its sub-step phase
    assert abs(balance_of(event, found)) <= 0.25 * (math.pi / 50.0) ** 2


def test_rotation_counts() -> None:
    scene = load_case("falling_particle")
    (ball,) = scene.spheres
    scene = with_bodies(scene, spheres=(replace(ball, spin=(0.0, 3.0, 4.0)),))
    model = plan(scene, ("linear",))["linear"]
    found = energy(model, integrate(model))
    m = ball.material.density * 4.0 / 3.0 * math.pi * ball.radius**3
    assert found.kinetic[0] == pytest.approx(0.5 * 0.4 * m * ball.radius**2 * 25.0, rel=1e-12)


def test_friction_is_refused() -> None:
    model = plan(load_case("oblique_impact"), ("linear",))["linear"]
    with pytest.raises(ValidityError, match="friction"):
        energy(model, integrate(model))
