"""Uncertain inputs of k_n: closed forms of products of powers, limits, and refusals."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import pytest

import kncal
from kncal.core.errors import InputError
from kncal.observe.impact_speeds import ImpactSpeeds
from kncal.physics.uncertainty import QUANTILES, distribution, propagate

GLASS = kncal.Material(young=70e9, poisson=0.22, density=2500.0)
#: k_n ~ k_h^(4/5) m_eff^(1/5) v_0^(2/5), with k_h ~ E sqrt(R) and m_eff ~ rho R³.
POWERS = {"young": 0.8, "density": 0.2, "radius": 1.0, "v_0": 0.4}


def nominal(**changes: float) -> float:
    values = {"v_0": 0.5, "e_n": 0.9} | changes
    return float(kncal.calibrate(kncal.pair(GLASS, 1e-3), **values).k_n)


def test_log_normal_inputs_give_a_log_normal_stiffness_and_shares_by_their_powers() -> None:
    percent = {"young": 20.0, "density": 10.0, "radius": 5.0, "v_0": 60.0}
    given = {name: f"{value:g}%" for name, value in percent.items()}
    found = propagate(given, material=GLASS, radius=1e-3, v_0=0.5, e_n=0.9)
    deviation = {n: POWERS[n] * math.sqrt(math.log1p((p / 100.0) ** 2)) for n, p in percent.items()}
    variance = sum(s**2 for s in deviation.values())
    for share in QUANTILES:
        exact = nominal() * math.exp(math.sqrt(variance) * NormalDist().inv_cdf(share))
        estimate = found.quantiles[share]
        # its own interval, doubled: eight scrambles are few
        half = 0.5 * (estimate.high - estimate.low)
        assert half < 0.02 * exact
        assert estimate.value == pytest.approx(exact, abs=2.0 * half + 1e-4 * exact)
    for name, s in deviation.items():
        for shares in (found.first_order, found.total):
            half = 0.5 * (shares[name].high - shares[name].low)
            assert half < 0.02
            assert shares[name].value == pytest.approx(s**2 / variance, abs=2.0 * half + 1e-3)
    assert found.most == "v_0"


def test_one_uncertain_speed_gives_the_stiffness_at_its_quantiles() -> None:
    found = propagate({"v_0": "0.1:0.5"}, material=GLASS, radius=1e-3, e_n=0.9)
    for share, estimate in found.quantiles.items():
        exact = nominal(v_0=0.1 + 0.4 * share)
        assert estimate.value == pytest.approx(exact, rel=2e-3)
    assert found.total["v_0"].value == 1.0
    log = propagate({"v_0": "log:0.1:0.5"}, material=GLASS, radius=1e-3, e_n=0.9)
    assert log.quantiles[0.5].value == pytest.approx(nominal(v_0=math.sqrt(0.05)), rel=2e-3)


def test_measured_speeds_are_a_distribution() -> None:
    edges = np.linspace(0.0, 1.0, 101)
    uniform = ImpactSpeeds(
        kind="particles", count=5000, speeds={}, edges=edges, counts=np.where(edges[1:] > 0.5, 100, 0)
    )
    found = propagate({"v_0": uniform}, material=GLASS, radius=1e-3, e_n=0.9)
    assert found.quantiles[0.25].value == pytest.approx(nominal(v_0=0.625), rel=2e-3)


def test_a_wall_has_twice_the_mass_and_radius_and_a_pair_of_its_own() -> None:
    uncertain = {"young": "10%"}
    pair = propagate(uncertain, material=GLASS, radius=1e-3, v_0=0.5, e_n=0.9)
    wall = propagate(uncertain, material=GLASS, radius=1e-3, v_0=0.5, e_n=0.9, pair_of=kncal.wall_pair)
    # rigid: E_eff, R_eff and m_eff are all twice those of two spheres
    assert wall.quantiles[0.5].value / pair.quantiles[0.5].value == pytest.approx(
        2.0**0.8 * 2.0**0.4 * 2.0**0.2, rel=1e-3
    )


def test_what_the_method_does_not_use_has_no_share() -> None:
    found = propagate(
        {"young": "5%", "v_0": "50%"}, material=GLASS, radius=1e-3, v_0=0.5, e_n=0.9, method="youngs_modulus"
    )
    assert found.most == "young"
    assert found.total["v_0"].value == pytest.approx(0.0, abs=1e-6)
    none = propagate({"v_0": "50%"}, material=GLASS, radius=1e-3, v_0=0.5, e_n=0.9, method="youngs_modulus")
    assert none.total["v_0"].value == 0.0
    assert "does not depend" in none.total["v_0"].why
    assert none.quantiles[0.05].value == pytest.approx(none.quantiles[0.95].value)


@pytest.mark.parametrize(("name", "value", "low", "high"), [("e_n", 0.97, 1e-3, 1.0), ("poisson", 0.45, 0.0, 0.5)])
def test_shares_stay_within_their_range(name: str, value: float, low: float, high: float) -> None:
    given = distribution(name, "20%", value)
    drawn = given.ppf(np.linspace(0.0, 1.0, 1001))
    assert low - 1e-12 <= drawn.min() < drawn.max() <= high


def test_percent_is_the_standard_deviation_about_the_median() -> None:
    given = distribution("young", "30%", 70e9)
    assert given.ppf(0.5) == pytest.approx(70e9)
    # of a log-normal: deviation/mean = 30 %
    drawn = given.ppf((np.arange(1_000_000) + 0.5) / 1e6)
    assert drawn.std() / drawn.mean() == pytest.approx(0.3, rel=1e-3)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({}, "nothing is uncertain"),
        ({"colour": "5%"}, "expected one of .*young"),
        ({"young": "5"}, "LOW:HIGH"),
        ({"young": "-5%"}, "young"),
        ({"young": "nan%"}, "young"),
        ({"v_0": "5%"}, "percentage of what"),
        ({"young": "5%"}, "v_0: missing"),
        ({"v_0": "0.5:0.1"}, "lower end"),
        ({"v_0": "log:0:0.1"}, "lower end"),
        ({"v_0": "normal:0.1:0.2"}, "expected 5%"),
        ({"v_0": "0.1:0.2", "e_n": "0.9:1.2"}, "e_n"),
    ],
)
def test_what_cannot_be_is_refused(given: dict[str, str], text: str) -> None:
    with pytest.raises(InputError, match=text):
        propagate(given, material=GLASS, radius=1e-3, e_n=0.9)
