"""Closed forms, identities and asymptotes of single laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kncal.physics.impact import dimensionless_impact
from kncal.physics.laws.base import ENDS
from kncal.physics.laws.hunt_crossley import solve

E_N = np.concatenate([np.linspace(0.01, 1.0, 400), 1.0 - np.geomspace(1e-12, 1e-3, 40)])


@pytest.mark.parametrize("end", ENDS)
def test_tsuji_is_the_linear_oscillator_in_another_coordinate(end: str) -> None:
    tsuji, linear = (dimensionless_impact(law, E_N, end) for law in ("tsuji", "linear"))
    np.testing.assert_allclose(tsuji.C / np.sqrt(5.0), linear.C / 2.0, rtol=1e-12)
    np.testing.assert_allclose(tsuji.x_max, 1.25**0.4 * linear.x_max**0.8, rtol=1e-12)


def test_tsuji_force_end_has_a_closed_maximum() -> None:
    np.testing.assert_allclose(dimensionless_impact("tsuji", E_N, "force").x_max, (1.25 * E_N) ** 0.4, rtol=1e-12)


@pytest.mark.parametrize(("law", "n", "p"), [("linear", 1, 0), ("tsuji", 1.5, 0.25), ("kuwabara_kono", 1.5, 0.5)])
def test_spring_and_dashpot_balance_at_the_force_end(law: str, n: float, p: float) -> None:
    impact = dimensionless_impact(law, E_N, "force")
    np.testing.assert_allclose(impact.x_end**n, impact.C * impact.x_end**p * E_N, rtol=1e-12)


def test_linear_overlap_end() -> None:
    impact = dimensionless_impact("linear", E_N, "overlap")
    zeta = impact.C / 2.0
    np.testing.assert_allclose(np.exp(-np.pi * zeta / np.sqrt(1.0 - zeta**2)), E_N, rtol=1e-12)
    np.testing.assert_allclose(impact.tau_c * np.sqrt(1.0 - zeta**2), np.pi, rtol=1e-12)


@given(e_n=st.floats(1e-12, 1.0))
def test_linear_momentum_balance(e_n: float) -> None:
    """Impulse: 1 + e = int x dtau + C x_end."""
    for end in ENDS:
        i = dimensionless_impact("linear", e_n, end)
        assert i.x_mean * i.tau_c + i.C * i.x_end == pytest.approx(1.0 + e_n, rel=1e-12)


def test_linear_force_end_is_critically_damped_at_exp_minus_two() -> None:
    impact = dimensionless_impact("linear", np.exp(-2.0), "force")
    assert (impact.C, impact.tau_c) == pytest.approx((2.0, 2.0), rel=1e-12)


@pytest.mark.parametrize("e_n", [1e-4, 1e-8, 1e-12])
def test_strong_damping_of_closed_forms(e_n: float) -> None:
    linear = dimensionless_impact("linear", e_n, "force")
    # 2 zeta -> 1/sqrt(e), with the next term of order e ln(1/e)
    assert linear.C * np.sqrt(e_n) == pytest.approx(1.0, rel=2.0 * e_n * (1.0 - np.log(e_n)))
    assert linear.tau_c * linear.C / 2.0 == pytest.approx(-np.log(e_n), rel=1e-12)
    tsuji = dimensionless_impact("tsuji", e_n, "overlap")
    assert np.sqrt(5.0) * (1 + 1e-15) > tsuji.C and np.isfinite(tsuji.tau_c) and tsuji.x_mean < tsuji.x_max


@pytest.mark.parametrize(("law", "end"), [("linear", "overlap"), ("linear", "force"), ("tsuji", "overlap")])
def test_the_tables_join_what_lies_below_them(law: str, end: str) -> None:
    low, high = (dimensionless_impact(law, 1e-3 * (1.0 + side * 1e-13), end) for side in (-1, 1))
    for quantity in ("C", "x_max", "tau_c", "x_mean"):
        assert getattr(low, quantity) == pytest.approx(getattr(high, quantity), rel=1e-11)


def test_kuwabara_kono_asymptote_of_strong_damping() -> None:
    """e C^5 -> 5.1583817 at the overlap end (the speed of rebound forgets the impact)."""
    e_n = np.array([0.1, 0.03, 0.01, 0.003, 0.001])
    distance = np.abs(e_n * dimensionless_impact("kuwabara_kono", e_n, "overlap").C ** 5 / 5.1583817 - 1.0)
    assert (np.diff(distance) < 0.0).all()
    assert distance[-1] < 0.01


def test_kuwabara_kono_force_end_is_later_than_the_overlap_end_by_a_known_order() -> None:
    """At equal C, e(force) - e(overlap) = (4/15) C^(5/2) + ...; here seen through C(e) and the slope c1."""
    e_n = 1.0 - np.array([1e-3, 1e-4, 1e-5])
    force, overlap = (dimensionless_impact("kuwabara_kono", e_n, end).C for end in ("force", "overlap"))
    ratio = 1.15344885809529 * (force - overlap) / (4.0 / 15.0 * overlap**2.5)
    assert (np.abs(np.diff(np.abs(ratio - 1.0))) > 0.0).all()
    assert ratio[-1] == pytest.approx(1.0, rel=0.02)
    assert abs(ratio[-1] - 1.0) < abs(ratio[0] - 1.0)


@given(e_n=st.floats(0.01, 0.98))
def test_hunt_crossley_energy_equation(e_n: float) -> None:
    impact = dimensionless_impact("hunt_crossley", e_n)
    C = impact.C
    if C < 20.0:  # beyond, 1 - C e loses its digits: it tends to exp(-1 - C)
        tolerance = 1e-13 * (1.0 + 1.0 / (1.0 - C * e_n))
        assert np.log1p(C) - np.log1p(-C * e_n) == pytest.approx((1.0 + e_n) * C, rel=1e-10, abs=tolerance)
    energy = 0.4 * C**2 * impact.x_max**2.5
    assert energy == pytest.approx(C - np.log1p(C), rel=1e-9)


def test_hunt_crossley_strong_damping() -> None:
    e_n = np.array([0.02, 0.005, 0.001])
    impact = dimensionless_impact("hunt_crossley", e_n)
    np.testing.assert_allclose(impact.C * e_n, 1.0, rtol=1e-12)
    tends = np.array([impact.x_max / (2.5 / impact.C) ** 0.4, impact.x_mean / impact.x_max * 2.0])
    assert (np.diff(np.abs(tends - 1.0), axis=1) < 0.0).all()
    np.testing.assert_allclose(tends[:, -1], 1.0, atol=5e-3)


def test_hunt_crossley_both_ends_coincide() -> None:
    overlap, force = (dimensionless_impact("hunt_crossley", E_N, end) for end in ENDS)
    for quantity in ("C", "x_max", "tau_c", "x_mean", "x_end"):
        np.testing.assert_array_equal(getattr(overlap, quantity), getattr(force, quantity))


def test_hunt_crossley_elastic_limit_of_the_quadrature() -> None:
    _, _, x_max, tau_c, x_mean = solve(np.array([0.0, 1e-14]))
    hertz = dimensionless_impact("hertz", 1.0)
    np.testing.assert_allclose(x_max, hertz.x_max, rtol=1e-13)
    np.testing.assert_allclose(tau_c, hertz.tau_c, rtol=1e-13)
    np.testing.assert_allclose(x_mean, hertz.x_mean, rtol=1e-13)


def test_hertz_known_digits() -> None:
    """25-digit values of the elastic sphere."""
    impact = dimensionless_impact("hertz", 1.0)
    assert (impact.C, impact.x_end) == (0.0, 0.0)
    assert (impact.x_max, impact.tau_c, impact.x_mean) == pytest.approx(
        (1.093362073943278, 3.218065459719038, 0.683307931561303), rel=1e-14
    )


@given(e_n=st.floats(1e-3, 1.0))
def test_walton_braun_work_and_momentum(e_n: float) -> None:
    """The loop's area is the lost energy; the impulse of two quarter sines is 1 + e."""
    force, overlap = (dimensionless_impact("walton_braun", e_n, end) for end in ("force", "overlap"))
    k_2 = 1.0 / e_n**2
    lost = 0.5 * force.x_max**2 - 0.5 * k_2 * (force.x_max - force.x_end) ** 2
    assert lost == pytest.approx(0.5 * force.C, rel=1e-9, abs=1e-15)
    # int F dtau = int x (loading: int x = 1) and k_2 int (x - x_end) (unloading)
    area = force.x_mean * force.tau_c
    unloading = area - 1.0 - force.x_end * 0.5 * np.pi * e_n
    assert 1.0 + k_2 * unloading == pytest.approx(1.0 + e_n, rel=1e-9)
    assert overlap.tau_c - force.tau_c == pytest.approx(force.x_end / e_n, rel=1e-9, abs=1e-14)
    coasting = overlap.x_mean * overlap.tau_c - area
    assert coasting == pytest.approx(0.5 * force.x_end**2 / e_n, rel=1e-9, abs=1e-14)
