"""Tsuji: Hertz with the dashpot C x^(1/4) x_dot, whose e_n does not depend on the impact speed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from kncal.core.checks import Array
from kncal.physics.laws.base import E_MIN, E_MIN_CLOSED, Impact, log_loss
from kncal.physics.laws.linear import overlap_end
from kncal.physics.laws.polar import HertzDashpot
from kncal.physics.laws.table import Table, nodes


@dataclass(frozen=True, kw_only=True)
class Tsuji(HertzDashpot):
    """In y = (2/sqrt 5) x^(5/4) this contact is the linear oscillator with zeta = C/sqrt(5)."""

    def e_min(self, end: str) -> float:
        """1e-12 at the overlap end, which is a closed form, and 1e-3 at the force end."""
        return E_MIN_CLOSED if end == "overlap" else E_MIN

    def impact(self, e_n: Array, end: str) -> Impact:
        """Closed form at the overlap end (gamma functions through a table), polar form at the force end."""
        if end == "force":
            return super().impact(e_n, end)
        zeta, M, _ = overlap_end(e_n)
        lam = log_loss(e_n)
        low = e_n < E_MIN
        times = np.empty((2, e_n.size))
        times[:, ~low] = _overlap_table()(lam[~low])
        times[:, low] = _times(lam[low])
        return Impact(np.sqrt(5.0) * zeta, 1.25**0.4 * M**0.8, times[0], times[1], np.zeros_like(e_n))


def _times(lam: Array) -> tuple[Array, Array]:
    """tau_c and x_mean at the overlap end for Lambda = -ln(e_n)."""
    a = lam / np.pi
    w = 1.0 / np.sqrt(1.0 + a * a)
    tau_c = 0.8**0.6 * w**-0.8 * _sine_integral(-0.2, -0.2 * a)
    return tau_c, 0.8**0.2 * w**-1.6 * _sine_integral(0.6, 0.6 * a) / tau_c


def _sine_integral(mu: float, b: Array) -> Array:
    """Integral of sin(t)^mu exp(-b t) over (0, pi): Gradshteyn & Ryzhik 3.892, in complex gamma functions."""
    from scipy.special import gammaln, loggamma

    size = 2.0 * loggamma(0.5 * (mu + 2.0 + 1j * b)).real
    exponent = -0.5 * np.pi * b - mu * np.log(2.0) - np.log(mu + 1.0) + gammaln(mu + 2.0) - size
    return np.asarray(np.pi * np.exp(exponent))


@cache
def _overlap_table() -> Table:
    lam = nodes(260)
    return Table(lam, *_times(lam))


TSUJI = Tsuji(
    name="tsuji",
    title="Tsuji (Hertz, constant restitution)",
    source="Tsuji, Tanaka & Ishida, Powder Technol. 71 (1992) 239; exact map: Antypov & Elliott, EPL 94 (2011) 50004",
    note=(
        "The usual damped Hertz contact of DEM codes: e_n is a property of the material, the same at every speed. "
        "The damping is fitted to e_n, not derived from a mechanism."
    ),
    damping_exponent=0.25,
    liggghts="hertz",
)
