"""The restitution of a contact point that sticks, against closed forms and limits."""

from __future__ import annotations

import math

import pytest

from kncal import Material, wall_pair
from kncal.physics.impact import dimensionless_impact
from kncal.physics.tangential import TANGENTIAL_DAMPING, stick_restitution

GLASS = Material(young=5e6, poisson=0.25, density=2500.0)
M, K = 1e-5, 1e3


def linear(e_n: float, ratio: float, damping: str, v_0: float = 1.0, end: str = "overlap") -> float:
    c = float(dimensionless_impact("linear", e_n, end).C) * math.sqrt(K * M)
    c_t = TANGENTIAL_DAMPING[damping](c, 1.0, K, ratio * K)
    return stick_restitution(n=1.0, p=0.0, k=K, c=c, k_t=ratio * K, c_t=c_t, m_eff=M, v_0=v_0, end=end)


@pytest.mark.parametrize("ratio", [2.0 / 7.0, 0.5, 1.0])
@pytest.mark.parametrize("damping", ["none", "liggghts", "half_normal"])
@pytest.mark.parametrize("e_n", [0.5, 0.9])
def test_of_a_linear_contact_it_is_an_oscillator_after_t_c(e_n: float, ratio: float, damping: str) -> None:
    # u'' + 2 a u' + b² u = 0 with u(0) = 1, u'(0) = -2 a (the spring is still slack) for t_c = pi/omega_d
    zeta = math.log(1.0 / e_n) / math.hypot(math.pi, math.log(e_n))
    omega = math.sqrt(K / M)
    c = 2.0 * zeta * math.sqrt(K * M)
    c_t = {"none": 0.0, "half_normal": 0.5 * c, "liggghts": c * math.sqrt(ratio)}[damping]
    a, b, t = 1.75 * c_t / M, math.sqrt(3.5 * ratio) * omega, math.pi / (omega * math.sqrt(1.0 - zeta**2))
    d = math.sqrt(b * b - a * a)
    u = math.exp(-a * t) * (math.cos(d * t) - a / d * math.sin(d * t))
    assert linear(e_n, ratio, damping) == pytest.approx(-u, abs=1e-8)


def test_an_elastic_contact_at_two_sevenths_turns_the_surface_round() -> None:
    # both directions swing alike: after half a period of both u = -u_0
    assert linear(1.0, 2.0 / 7.0, "none") == pytest.approx(1.0, abs=1e-9)
    # without a spring the surface goes on as it was
    assert linear(1.0, 1e-9, "none") == pytest.approx(-1.0, abs=1e-6)


def test_one_damping_ratio_in_both_directions_gives_one_restitution() -> None:
    # k_t = 2/7 k_n and c_t = 2/7 c: the equations of both directions are the same but for the start
    e_n = 0.6
    c = float(dimensionless_impact("linear", e_n, "overlap").C) * math.sqrt(K * M)
    zeta = c / (2.0 * math.sqrt(K * M))
    share = 2.0 / 7.0
    found = stick_restitution(n=1.0, p=0.0, k=K, c=c, k_t=share * K, c_t=share * c, m_eff=M, v_0=1.0, end="overlap")
    assert found == pytest.approx(math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)), abs=1e-8)


@pytest.mark.parametrize("end", ["overlap", "force"])
def test_of_a_tsuji_contact_it_does_not_depend_on_the_speed(end: str) -> None:
    both = wall_pair(GLASS, 1e-3)
    k, m = float(both.k_h), float(both.m_eff)
    c = float(dimensionless_impact("tsuji", 0.8, end).C) * math.sqrt(k * m)
    k_t = 8.0 * float(both.G_eff) * math.sqrt(float(both.R_eff))
    c_t = TANGENTIAL_DAMPING["liggghts"](c, 1.5, k, k_t)
    found = [stick_restitution(n=1.5, p=0.25, k=k, c=c, k_t=k_t, c_t=c_t, m_eff=m, v_0=v, end=end) for v in (0.01, 1.0)]
    assert found[0] == pytest.approx(found[1], abs=1e-8)
    # 2 sqrt(5/6) beta sqrt(S m) with S = 8 G sqrt(R delta), as the manual of LIGGGHTS has it
    beta = c / math.sqrt(5.0 * k * m)
    assert c_t == pytest.approx(2.0 * math.sqrt(5.0 / 6.0) * beta * math.sqrt(k_t * m), rel=1e-12)
