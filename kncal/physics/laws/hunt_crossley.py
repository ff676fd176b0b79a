"""Hunt–Crossley: Hertz with the dashpot C x^(3/2) x_dot, whose force starts and ends at zero.

Between e_n and C stands the Langevin function Lv(a) = coth(a) - 1/a: in the closed form (1+e) C = ln((1+C)/(1-Ce))
put (1+e) C = 2a, then C = a (1 + Lv(a)), C e = a (1 - Lv(a)) and -ln(e) = 2 artanh(Lv(a)). With the velocity v,
dtau = -dv/(x^(3/2) (1 + C v)), and sigma = ln((1+C)/(1+Cv)) running from 0 to d = 2a,

    (2/5) C^2 x^(5/2) = X(sigma) = d (1 - exp(-sigma))/(1 - exp(-d)) - sigma,
    tau_c = (1/C) int_0^d x^(-3/2) dsigma,        int x dtau = (1/C) int_0^d x^(-1/2) dsigma.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from kncal.core.checks import Array
from kncal.physics.laws.base import E_MIN, ContactLaw, Impact, log_loss
from kncal.physics.laws.table import Table, nodes


@dataclass(frozen=True, kw_only=True)
class HuntCrossley(ContactLaw):
    """The force never changes sign, so both ends coincide."""

    def e_min(self, end: str) -> float:
        """1e-3: duration and mean are not closed forms."""
        return E_MIN

    def impact(self, e_n: Array, end: str) -> Impact:
        """From a table of the exact solution over -ln(e_n)."""
        lam = log_loss(e_n)
        C_over_lam, x_max, tau_c, x_mean = _table()(lam)
        return Impact(lam * C_over_lam, x_max, tau_c, x_mean, np.zeros_like(e_n))


@cache
def _table() -> Table:
    # -ln(e_n) = 2a/3 for small, ln(2a) for large a
    return Table(*solve(1.5 * np.sinh(nodes(260))))


def solve(a: Array) -> tuple[Array, Array, Array, Array, Array]:
    """-ln(e_n), C/(-ln e_n), x_max, tau_c, x_mean for the parameter ``a`` (n,) >= 0; exact, by quadrature."""
    d = 2.0 * a
    big = np.maximum(a, 1.0)
    # Lv(a) and its complement 1 - Lv(a), each where it loses no digits
    lv = np.where(a <= 1.0, a * _series(np.minimum(a, 1.0))[1], 1.0 / np.tanh(big) - 1.0 / big)
    rest = np.where(a <= 1.0, 1.0 - lv, 1.0 / big - 2.0 / np.expm1(2.0 * np.minimum(big, 300.0)))
    lam = np.where(lv < 0.5, 2.0 * np.arctanh(np.minimum(lv, 0.5)), np.log1p(lv) - np.log(rest))
    lam_by_a = np.divide(lam, a, out=np.full_like(a, 2.0 / 3.0), where=a > 0.0)
    C = a * (1.0 + lv)

    peak = np.divide(np.log1p(C), d, out=np.full_like(a, 0.5), where=a > 0.0)
    d_by_C = 2.0 / (1.0 + lv)
    x_max = (2.5 * d_by_C**2 * _hump(peak, 1.0 - peak, d)) ** 0.4
    q, weight = _tanh_sinh()
    sides = [_hump(q, 1.0 - q, d[:, None]), _hump(1.0 - q, q, d[:, None])]
    tau_c = 2.5**-0.6 * d_by_C**-0.2 * sum(side**-0.6 @ weight for side in sides)
    area = 2.5**-0.2 * d_by_C**0.6 * sum(side**-0.2 @ weight for side in sides)
    return lam, (1.0 + lv) / lam_by_a, x_max, tau_c, area / tau_c


def _hump(t: Array, rest: Array, d: Array) -> Array:
    """X(sigma)/d^2 at sigma = t d, with ``rest`` = 1 - t exact near t = 1; t (1-t)/2 for d = 0.

    With E(s) = (1 - exp(-s))/s: X = sigma (E(sigma)/E(d) - 1), and seen from the far end, rho = d - sigma,
    X = rho (1 - F(rho)/F(d)) with F(s) = exp(s) E(s).
    """
    sigma, rho = t * d, rest * d
    safe = np.maximum(d, 1e-300)
    log_left = 0.5 * rho + _log_shift(sigma) - _log_shift(d)
    log_right = 0.5 * sigma - _log_shift(rho) + _log_shift(d)
    left = np.where(d > 0.0, np.expm1(np.minimum(log_left, 600.0)) / safe, 0.5 * rest)
    right = np.where(d > 0.0, -np.expm1(-log_right) / safe, 0.5 * t)
    return np.where(t < 0.5, t * left, rest * right)


def _log_shift(s: Array) -> Array:
    """ln(E(s)) + s/2 = ln(sinh(s/2)/(s/2))."""
    half = 0.5 * s
    big = np.maximum(half, 1.0)
    far = big + np.log1p(-np.exp(-2.0 * big)) - np.log(2.0 * big)
    return np.asarray(np.where(half <= 1.0, _series(np.minimum(half, 1.0))[0], far))


def _series(t: Array) -> tuple[Array, Array]:
    """ln(sinh(t)/t) and its derivative over t, (coth(t) - 1/t)/t, for 0 <= t <= 1.

    Euler's product gives ln(sinh(t)/t) = sum over k of (-1)^(k+1) zeta(2k)/k (t/pi)^(2k).
    """
    from scipy.special import zeta

    k = np.arange(1, 17)
    signed = np.where(k % 2 == 1, 1.0, -1.0) * zeta(2.0 * k) / np.pi ** (2.0 * k)
    square = t * t
    value = square * np.polynomial.polynomial.polyval(square, signed / k)
    return value, np.asarray(np.polynomial.polynomial.polyval(square, 2.0 * signed))


def _tanh_sinh() -> tuple[Array, Array]:
    """Distances (k,) to the nearer end of (0, 1) and weights (k,) for either half (Takahasi & Mori 1974)."""
    step = 1.0 / 28.0
    s = np.arange(0.0, 4.3, step)
    q = 1.0 / (1.0 + np.exp(np.pi * np.sinh(s)))
    weight = step * np.pi * np.cosh(s) * q * (1.0 - q)
    weight[0] *= 0.5  # the middle belongs to both halves
    return q, weight


HUNT_CROSSLEY = HuntCrossley(
    name="hunt_crossley",
    title="Hunt–Crossley (damping proportional to the Hertz force)",
    source="Hunt & Crossley, J. Appl. Mech. 42 (1975) 440",
    note=(
        "No attraction and no jump of the force at either end. e_n belongs to one impact speed: 1 - e_n grows "
        "in proportion to v_0 for nearly elastic impacts."
    ),
    damping_exponent=1.5,
    e_depends_on_speed=True,
)
