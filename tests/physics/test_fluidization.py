"""Gas through particles: closed forms, limits, conservation of force between the formulas, published numbers."""

import doctest
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kncal.core.errors import InputError
from kncal.physics import fluidization
from kncal.physics.fluidization import (
    archimedes,
    drag_coefficient,
    ergun_gradient,
    expanded_voidage,
    minimum_fluidization_velocity,
    minimum_fluidization_velocity_wen_yu,
    particle_drag,
    relaxation_time,
    reynolds,
    settling_velocity,
    terminal_velocity,
)

AIR = (1.2, 1.8e-5)
G = 9.81
diameters = st.floats(2e-5, 2e-2)
densities = st.floats(100.0, 1e4)
gases = st.tuples(st.floats(0.1, 50.0), st.floats(1e-6, 1e-2))
packed = st.floats(0.3, 0.6)


def test_examples_in_the_docstrings():
    assert doctest.testmod(fluidization).failed == 0


# --- published numbers ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("diameter", "density", "density_gas", "eps", "U_mf"),
    [
        (4e-3, 2700.0, 1.205, 0.40, 1.70),  # Tsuji's bed
        (4e-3, 2700.0, 1.205, 0.42, 1.84),
        (2.5e-3, 2526.0, 1.2, 0.40, 1.23),  # Goldschmidt's
        (3.256e-3, 1131.0, 1.21, 0.40, 0.93),  # NETL's small-scale challenge problem I
        (3.256e-3, 1131.0, 1.21, 0.42, 1.02),
        (1.2e-3, 1000.0, 1.2, 0.38, 0.31),  # Müller's
    ],
)
def test_minimum_fluidisation_of_known_beds(diameter, density, density_gas, eps, U_mf):
    found = minimum_fluidization_velocity(diameter, density, density_gas, 1.8e-5, eps)
    assert found == pytest.approx(U_mf, abs=0.006)


def test_dem06_of_mfix():
    """The stored reference of MFIX's verification case DEM06 (its own integration by RK4 with dt = 1e-8 s)."""
    v = settling_velocity([0.01, 0.1, 0.35], 1e-4, 2000.0, *AIR, gravity=9.80665, U_gas=0.4)
    assert v == pytest.approx([-0.01255261, -0.05263133, -0.05739251], abs=6e-9)
    assert terminal_velocity(1e-4, 2000.0, *AIR, 9.80665) == pytest.approx(0.457402, abs=6e-7)


# --- packed bed -----------------------------------------------------------------------------------------------


@given(diameters, densities, gases, packed)
def test_minimum_fluidisation_is_where_ergun_carries_the_bed(d, rho, gas, eps):
    U_mf = minimum_fluidization_velocity(d, rho, *gas, eps)
    weight = (1.0 - eps) * (rho - gas[0]) * G
    assert ergun_gradient(U_mf, eps, d, *gas) == pytest.approx(weight, rel=1e-12)


def test_ergun_has_its_two_limits():
    slow, twice = ergun_gradient([1e-9, 2e-9], 0.4, 1e-4, *AIR)
    assert twice == pytest.approx(2.0 * slow, rel=1e-6)  # viscous
    fast, twice = ergun_gradient([1e3, 2e3], 0.4, 1e-2, *AIR)
    assert twice == pytest.approx(4.0 * fast, rel=1e-3)  # inertial
    assert ergun_gradient(0.0, 0.4, 1e-3, *AIR) == 0.0
    assert ergun_gradient(1.0, 1.0, 1e-3, *AIR) == 0.0  # nothing in the way


def test_wen_yu_correlation_has_its_two_limits():
    # sqrt(a² + x) - a -> x/(2a), and -> sqrt(x)
    small = reynolds(minimum_fluidization_velocity_wen_yu(1e-6, 1000.0, *AIR), 1e-6, *AIR)
    assert small == pytest.approx(0.0408 * archimedes(1e-6, 1000.0, *AIR) / 67.4, rel=1e-6)
    large = reynolds(minimum_fluidization_velocity_wen_yu(1.0, 1000.0, *AIR), 1.0, *AIR)
    assert large == pytest.approx(math.sqrt(0.0408 * archimedes(1.0, 1000.0, *AIR)), rel=1e-2)


def test_the_two_ways_to_u_mf_agree_within_the_scatter_of_the_correlation():
    d = np.geomspace(5e-5, 5e-3, 20)
    ratio = minimum_fluidization_velocity_wen_yu(d, 2500.0, *AIR) / minimum_fluidization_velocity(d, 2500.0, *AIR, 0.42)
    assert np.all(np.abs(ratio - 1.0) < 0.34)


# --- drag -----------------------------------------------------------------------------------------------------


@given(packed, st.floats(1e-3, 10.0), diameters, gases)
def test_drag_in_a_packed_bed_is_the_pressure_gradient(eps, U_0, d, gas):
    """Model B: per volume of bed, drag on the particles equals the whole pressure gradient times their share."""
    drag = (1.0 - eps) * particle_drag(eps, U_0 / eps, d, *gas) * U_0 / eps
    assert drag == pytest.approx(ergun_gradient(U_0, eps, d, *gas), rel=1e-12)


@given(st.floats(0.2, 0.999), st.floats(1e-4, 40.0), diameters, gases)
def test_beta_is_gidaspows(eps, slip, d, gas):
    rho, mu = gas
    if eps < 0.8:
        beta = 150.0 * mu * (1.0 - eps) ** 2 / (eps * d**2) + 1.75 * rho * (1.0 - eps) * slip / d
    else:
        Re = eps * rho * slip * d / mu
        C_d = 24.0 / Re * (1.0 + 0.15 * Re**0.687) if Re < 1000.0 else 0.44
        beta = 0.75 * C_d * rho * eps * (1.0 - eps) * slip / d * eps**-2.65
    assert eps * (1.0 - eps) * particle_drag(eps, slip, d, rho, mu) == pytest.approx(beta, rel=1e-12)


@given(diameters, gases)
def test_a_single_sphere_at_rest_has_stokes_drag(d, gas):
    assert particle_drag(1.0, 0.0, d, *gas) == pytest.approx(18.0 * gas[1] / d**2, rel=1e-14)
    assert relaxation_time(1000.0, d, *gas) == pytest.approx(1000.0 * d**2 / (18.0 * gas[1]), rel=1e-14)


def test_drag_coefficient_limits_and_step():
    assert drag_coefficient(1e-6) == pytest.approx(24e6, rel=1e-4)
    assert drag_coefficient(1e4) == 0.44
    below, above = drag_coefficient([1000.0 * (1.0 - 1e-12), 1000.0])
    assert above / below == pytest.approx(1.0, abs=0.005)


# --- one sphere -----------------------------------------------------------------------------------------------


@given(diameters, densities, gases)
def test_weight_equals_drag_at_terminal_velocity(d, rho, gas):
    v = terminal_velocity(d, rho, *gas)
    Re = reynolds(v, d, *gas)
    weight = (rho - gas[0]) * G
    drag = particle_drag(1.0, v, d, *gas) * v
    # the step of the drag coefficient at Re = 1000 has no root of its own
    assert drag == pytest.approx(weight, rel=5e-3 if abs(Re - 1000.0) < 1.0 else 1e-12)


@given(st.floats(1e-3, 1e8))
def test_terminal_reynolds_number_depends_on_archimedes_only(Ar):
    speeds = []
    for rho_g, mu in (AIR, (3.0, 4e-5)):
        d = 1e-3
        rho = rho_g + Ar * mu**2 / (rho_g * G * d**3)
        if rho - rho_g < 1e-3 * rho_g:
            return  # rounding of the difference of densities would be tested
        speeds.append(reynolds(terminal_velocity(d, rho, rho_g, mu), d, rho_g, mu))
    assert speeds[0] == pytest.approx(speeds[1], rel=1e-9)


def test_terminal_velocity_limits_and_monotony():
    assert terminal_velocity(1e-6, 1000.0, *AIR) == pytest.approx(998.8 * G * 1e-12 / (18.0 * 1.8e-5), rel=1e-3)
    newton = math.sqrt(4.0 / 3.0 * 7798.8 * G * 0.05 / (0.44 * 1.2))
    assert terminal_velocity(0.05, 7800.0, *AIR) == pytest.approx(newton, rel=1e-12)
    assert np.all(np.diff(terminal_velocity(np.geomspace(1e-6, 0.1, 2000), 2500.0, *AIR)) > 0.0)


def test_a_mist_droplet_relaxes_as_stokes_says():
    d, rho = 5e-6, 1000.0
    tau = relaxation_time(rho, d, *AIR)
    t = np.linspace(0.0, 5.0 * tau, 9)
    exact = -G * (1.0 - 1.2 / rho) * tau * (1.0 - np.exp(-t / tau))
    assert settling_velocity(t, d, rho, *AIR) == pytest.approx(exact, rel=2e-3, abs=1e-15)


def test_settling_ends_at_terminal_velocity_and_starts_from_rest():
    tau = 0.4
    v = settling_velocity([[0.0, 1e-5], [30.0 * tau, 0.1]], 1e-3, 1000.0, *AIR, U_gas=1.0)
    assert v.shape == (2, 2)
    assert v[0, 0] == 0.0
    start = particle_drag(1.0, 1.0, 1e-3, *AIR) / 1000.0 - G * (1.0 - 1.2 / 1000.0)
    assert v[0, 1] == pytest.approx(1e-5 * start, rel=1e-3)
    assert v[1, 0] == pytest.approx(1.0 - terminal_velocity(1e-3, 1000.0, *AIR), rel=1e-8)


# --- expansion ------------------------------------------------------------------------------------------------


@given(st.floats(0.35, 0.75), st.floats(2e-4, 5e-3))
def test_expansion_is_the_inverse_of_minimum_fluidisation(eps, d):
    speed = minimum_fluidization_velocity(d, 1500.0, *AIR, eps)
    if speed < terminal_velocity(d, 1500.0, *AIR):
        found = expanded_voidage(speed, d, 1500.0, *AIR)
        # near 0.8 the drag steps down, and more than one void fraction may hover
        assert found == pytest.approx(eps, rel=1e-9) or found > 0.79


def test_expansion_grows_with_the_gas():
    found = [expanded_voidage(U, 1.2e-3, 1000.0, *AIR) for U in np.linspace(0.2, 4.0, 20)]
    assert np.all(np.diff(found) > -1e-11)  # constant where the drag steps down, at 0.8
    assert expanded_voidage(5.0, 1.2e-3, 1000.0, *AIR) == 1.0
    assert expanded_voidage(1e-4, 1.2e-3, 1000.0, *AIR) == 0.2


# --- form -----------------------------------------------------------------------------------------------------


def test_arrays_broadcast_and_scalars_stay_scalars():
    eps, U = np.array([[0.4], [0.5]]), np.array([0.1, 0.2, 0.3])
    table = ergun_gradient(U, eps, 1e-3, *AIR)
    assert table.shape == (2, 3)
    assert table[1, 2] == ergun_gradient(0.3, 0.5, 1e-3, *AIR)
    assert isinstance(terminal_velocity(1e-3, 1000.0, *AIR), float)
    assert isinstance(relaxation_time(1000.0, 1e-3, *AIR), float)
    assert particle_drag(eps, U, 1e-3, *AIR).shape == (2, 3)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: ergun_gradient(0.1, 1.2, 1e-3, *AIR), "eps_g = 1.2"),
        (lambda: ergun_gradient(-0.1, 0.4, 1e-3, *AIR), "U_0 = -0.1"),
        (lambda: terminal_velocity(1e-3, 1.0, *AIR), "heavier than the gas"),
        (lambda: terminal_velocity(float("nan"), 1000.0, *AIR), "diameter = nan"),
        (lambda: minimum_fluidization_velocity(1e-3, 1000.0, 1.2, 0.0, 0.4), "viscosity = 0"),
        (lambda: reynolds(1.0, 0.0, *AIR), "diameter = 0"),
        (lambda: settling_velocity([-1.0], 1e-3, 1000.0, *AIR), "times = -1"),
    ],
)
def test_bad_numbers_are_named(call, text):
    with pytest.raises(InputError, match=text):
        call()
