"""Linear spring and dashpot: x + C x_dot with C = 2 zeta, exact in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from kncal.core.checks import Array
from kncal.physics.laws.base import E_MIN, ContactLaw, Impact, log_loss
from kncal.physics.laws.table import Table, nodes


@dataclass(frozen=True, kw_only=True)
class LinearDashpot(ContactLaw):
    """The damped harmonic oscillator; units v_0/omega and 1/omega."""

    def impact(self, e_n: Array, end: str) -> Impact:
        """Closed forms in zeta: Schäfer et al. 1996 (overlap end), Schwager & Pöschel 2007 (force end)."""
        if end == "overlap":
            zeta, M, Tc = overlap_end(e_n)
            return Impact(2.0 * zeta, M, Tc, (1.0 + e_n) / Tc, np.zeros_like(e_n))
        Tc = _force_end_duration(e_n)
        zeta = log_loss(e_n) / Tc
        x_end = 2.0 * zeta * e_n
        return Impact(2.0 * zeta, np.sqrt(e_n), Tc, _force_end_area(zeta, e_n, x_end) / Tc, x_end)

    def motion(self, C: float, e_n: float, tau: Array) -> tuple[Array, Array]:
        """x = exp(-zeta tau) sin(w tau)/w, w = sqrt(1 - zeta^2), or its limit or continuation for zeta >= 1."""
        zeta = 0.5 * C
        w = np.sqrt(abs((1.0 - zeta) * (1.0 + zeta)))
        fade = np.exp(-zeta * tau)
        if zeta < 1.0:
            ratio, even = tau * np.sinc(w * tau / np.pi), np.cos(w * tau)
        else:
            ratio, even = (np.sinh(w * tau) / w if w > 0.0 else tau), np.cosh(w * tau)
        return np.maximum(fade * ratio, 0.0), fade * (even - zeta * ratio)


def overlap_end(e_n: Array) -> tuple[Array, Array, Array]:
    """zeta, largest overlap, duration of the linear contact that ends at zero overlap, in units v/omega, 1/omega.

    zeta = Lambda/sqrt(pi^2 + Lambda^2) with Lambda = -ln(e_n), duration pi/sqrt(1 - zeta^2).
    """
    lam = log_loss(e_n)
    root = np.hypot(np.pi, lam)
    return lam / root, np.exp(-lam / np.pi * np.arctan2(np.pi, lam)), root


def _force_end_duration(e_n: Array) -> Array:
    """Duration of the contact that ends at zero force, from e_n; zeta times it is -ln(e_n)."""
    lam = log_loss(e_n)
    low = e_n < E_MIN
    Tc = np.empty_like(e_n)
    Tc[~low] = _force_table()(lam[~low])[0]
    if low.any():
        # Overdamped: zeta = cosh(h) with 2 h coth(h) = Lambda, nearly h = Lambda/2.
        half = 0.5 * lam[low]
        h = half
        for _ in range(8):
            # coth(h) = 1 + 2/(exp(2h) - 1); the second term is below 0.003, so this gains two digits each time
            h = half / (1.0 + 2.0 / np.expm1(2.0 * h))
        Tc[low] = lam[low] / np.cosh(h)
    return Tc


def _force_end_area(zeta: Array, e_n: Array, x_end: Array) -> Array:
    """Integral of x over the contact, 1 + e_n - 2 zeta x_end, without its cancellation for strong damping."""
    area = 1.0 + e_n - 2.0 * zeta * x_end
    over = zeta > 1.5
    if over.any():
        h = np.arccosh(zeta[over])
        # (2 zeta)^2 e_n = (1 + exp(-2h))^2 exp(-4h/(exp(2h) - 1))
        log_product = 2.0 * np.log1p(np.exp(-2.0 * h)) - 4.0 * h / np.expm1(2.0 * h)
        area[over] = e_n[over] - np.expm1(log_product)
    return area


@cache
def _force_table() -> Table:
    """The duration 2 arccos(zeta)/sqrt(1 - zeta^2), continued to zeta >= 1, over -ln(e_n)."""
    zeta = 1.02 * np.sinh(0.5 * nodes(260))  # evenly spread: Lambda = pi zeta for small, 2 ln(2 zeta) for large zeta
    w = np.sqrt(np.abs((1.0 - zeta) * (1.0 + zeta)))
    angle = np.where(zeta < 1.0, np.arccos(np.minimum(zeta, 1.0)), np.arccosh(np.maximum(zeta, 1.0)))
    Tc = 2.0 * np.divide(angle, w, out=np.ones_like(w), where=w > 0.0)
    return Table(zeta * Tc, Tc)


LINEAR = LinearDashpot(
    name="linear",
    title="Linear spring and dashpot",
    source="Cundall & Strack, Géotechnique 29 (1979) 47; Schäfer, Dippel & Wolf, J. Phys. I France 6 (1996) 5",
    note=(
        "The law to be calibrated. Stiffness and contact time do not depend on the impact speed; the largest "
        "overlap is proportional to it."
    ),
    stiffness_exponent=1.0,
    damping_exponent=0.0,
    liggghts="hooke/stiffness",
)
