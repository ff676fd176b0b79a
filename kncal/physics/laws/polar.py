"""Impact of a Hertz spring with a dashpot c delta^p delta_dot, for 1/4 <= p <= 5/4, in polar form.

x'' + C x^p x' + x^(3/2) = 0 becomes y'' + D y^q y' + y = 0 in y = (2/sqrt 5) x^(5/4), dy/ds = dx/dtau, with
q = (4/5)(p - 1/4) and D = C (2/sqrt 5)(5/4)^(2/5 (p-1/4)); the map generalises Antypov & Elliott, EPL 94 (2011)
50004. With y = r sin(phi), dy/ds = r cos(phi) and lambda = -ln(r)/D,

    g = dphi/ds = 1 + D r^q sin^(q+1)(phi) cos(phi),         dlambda/dphi = r^q sin^q(phi) cos^2(phi)/g,
    dtau/dphi = (4/5)^(3/5) (r sin(phi))^(-1/5)/g,           d(int x dtau)/dphi = (4/5)^(1/5) (r sin(phi))^(3/5)/g.

phi = 0 is the start (r = 1), pi/2 the maximum overlap, pi the overlap end with e_n = r. For the force end the angle
psi of (force, velocity), tan(psi) = (sin + D r^q sin^q cos)/cos, takes the place of phi on the way back: it runs from
pi/2 to pi, where the force is zero, for every C, because dpsi/dphi >= (1-q)/(a^2+b^2) > 0. So no end needs an event
search, and all C are integrated together as one system. phi = t^5 and pi - phi = t^5 (pi - psi = t^5) remove the
singularity of the time at zero overlap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from kncal.core.checks import Array, in_range, instance, single
from kncal.core.errors import InputError, KncalError
from kncal.physics.laws.base import E_MIN, ContactLaw, Impact, log_loss
from kncal.physics.laws.table import POWER, Table, nodes

_HALF = (0.5 * np.pi) ** 0.2
_TINY = 1e-300
_FLOOR = 1e-9
_NODES = 200
#: the layers near the force end, at another place for every D, need the tighter one
_RTOL = {"overlap": 1e-13, "force": 3e-14}


@dataclass(frozen=True, kw_only=True)
class HertzDashpot(ContactLaw):
    """Hertz spring with the dashpot C x^p x_dot; give ``name`` and ``damping_exponent`` p, 1/4 <= p <= 5/4.

    Raises
    ------
    InputError
        If p is outside that range (below it an impact may never end; towards 3/2 the equations become stiff), or
        the stiffness exponent is not 1.5.
    """

    def __post_init__(self) -> None:
        instance("name", self.name, str, "a short text")
        hint = "derive from ContactLaw for another dashpot"
        given: Any = self.damping_exponent  # None, too, is refused
        p = single("damping_exponent", in_range("damping_exponent", given, 0.25, 1.25, hint=hint))
        object.__setattr__(self, "damping_exponent", p)
        if self.stiffness_exponent != 1.5:
            raise InputError(
                f"stiffness_exponent = {self.stiffness_exponent!r} of law {self.name!r}: expected 1.5 (Hertz); "
                "derive from ContactLaw for another spring"
            )

    @property
    def p(self) -> float:
        """The damping exponent as a number."""
        assert self.damping_exponent is not None  # noqa: S101 - checked in __post_init__
        return self.damping_exponent

    def e_min(self, end: str) -> float:
        """1e-3: the solution is not a closed form."""
        return E_MIN

    def impact(self, e_n: Array, end: str) -> Impact:
        """Solution from the table of this p and end; x_end = (C e_n)^(1/(3/2-p)) at the force end."""
        lam = log_loss(e_n)
        C_over_lam, x_max, tau_c, x_mean = polar_table(self.p, end)(lam)
        C = lam * C_over_lam
        return Impact(C, x_max, tau_c, x_mean, self.x_end(C, e_n, end))

    def x_end(self, C: Array, e_n: Array, end: str) -> Array:
        """Overlap at the end of the contact: x^(3/2) = C x^p e_n at the force end, exactly."""
        if end == "overlap":
            return np.zeros_like(e_n)
        return np.asarray((C * e_n) ** (1.0 / (1.5 - self.p)))


@cache
def polar_table(p: float, end: str) -> Table:
    """C/Lambda, x_max, tau_c, x_mean for the damping exponent ``p`` and ``end``; built at first use."""
    q = 0.8 * (p - 0.25)
    D = _damping_numbers(q, end)
    lam_over_D, r_max, tau_c, area = _solve(D, q, end, _RTOL[end])
    D_over_C = 2.0 / np.sqrt(5.0) * 1.25 ** (0.5 * q)
    x_max = 1.25**0.4 * r_max**0.8
    return Table(D * lam_over_D, 1.0 / (lam_over_D * D_over_C), x_max, tau_c, area / tau_c)


def _damping_numbers(q: float, end: str) -> Array:
    """D at `_NODES` nodes, nearly uniform in the table's variable: 0 first, the last with e_n just below `E_MIN`."""
    from scipy.interpolate import PchipInterpolator

    wanted = nodes(_NODES)
    pilot, lam = np.zeros(1), np.zeros(1)
    # Large D makes the equations stiff, so a coarse pass goes up only as far as it must.
    growth = 3.0 if end == "overlap" else 6.0
    while lam[-1] < wanted[-1]:
        low, high = (0.01, 1.9) if pilot.size == 1 else (1.01 * pilot[-1], growth * pilot[-1])
        more = np.geomspace(low, high, 50)
        pilot = np.concatenate([pilot, more])
        lam = np.concatenate([lam, more * _solve(more, q, end, 1e-6)[0]])
    D = np.asarray(PchipInterpolator(lam**POWER, pilot**POWER)(wanted**POWER)) ** (1.0 / POWER)
    D[-1] += 0.5 * (D[-1] - D[-2])  # interpolated, so it must not stop short of E_MIN
    return np.asarray(D)


def _solve(D: Array, q: float, end: str, rtol: float) -> tuple[Array, Array, Array, Array]:
    """(-ln e_n)/D, r at the maximum overlap, tau_c and the integral of x dtau, for every D (n,)."""
    state = _integrate(lambda t, y: _by_phi(t, y, D, q, 1.0), 0.0, _HALF, np.zeros((3, D.size)), rtol)
    r_max = np.exp(-D * state[0])
    if end == "overlap":
        state = _integrate(lambda t, y: _by_phi(t, y, D, q, -1.0), _HALF, 0.0, state, rtol)
        lam_over_D = state[0]
    else:
        state = np.vstack([state, np.zeros(D.size)])
        state = _integrate(lambda t, y: _by_psi(t, y, D, q), _HALF, 0.0, state, rtol)
        # e_n = r |cos(phi)|, where pi - phi = state[3] at psi = pi
        fall = -0.5 * np.log1p(-(np.sin(state[3]) ** 2))
        lam_over_D = state[0] + np.divide(fall, D, out=np.zeros_like(D), where=D > 0.0)
    return lam_over_D, r_max, 0.8**0.6 * state[1], 0.8**0.2 * state[2]


def _by_phi(t: float, state: Array, D: Array, q: float, side: float) -> Array:
    """d(lambda, tau, area)/dt with phi = t^5 (side = 1) or pi - phi = t^5 (side = -1, t runs down)."""
    s, c = max(np.sin(t**5), _TINY), side * np.cos(t**5)
    k = _root(D, state[0], s)
    y_q = k ** (-5.0 * q)
    speed = side * 5.0 * t**4 / np.maximum(1.0 + D * (y_q * (s * c)), _FLOOR)
    out = np.empty_like(state)
    out[0], out[1], out[2] = speed * (y_q * (c * c)), speed * k, speed / (k * k * k)
    return out


def _by_psi(t: float, state: Array, D: Array, q: float) -> Array:
    """d(lambda, tau, area, shift)/dt with pi - psi = t^5, t running down; pi - phi = t^5 + shift."""
    angle = np.minimum(np.maximum(t**5 + state[3], 0.0), 0.5 * np.pi)
    s, c = np.maximum(np.sin(angle), _TINY), np.cos(angle)
    k = _root(D, state[0], s)
    y_q = k ** (-5.0 * q)
    Bc = D * y_q * c
    g = np.maximum(1.0 - Bc * s, _FLOOR)
    spread = np.minimum(q * Bc * c * c * (1.0 / s + Bc / g), 0.5 * (1.0 + q))
    excess = (Bc * (Bc - 2.0 * s) + spread) / (1.0 - spread)  # dphi/dpsi - 1, without cancellation
    dxi = 5.0 * t**4
    speed = -dxi * (1.0 + excess) / g
    out = np.empty_like(state)
    out[0], out[1], out[2], out[3] = speed * (y_q * c * c), speed * k, speed / (k * k * k), dxi * excess
    return out


def _root(D: Array, lam: Array, s: Array | float) -> Array:
    """y^(-1/5) with y = r s and r = exp(-D lambda).

    Like `_FLOOR`, the bounds act only in trial steps that the integrator will reject.
    """
    return np.asarray(np.exp(np.minimum(np.maximum(0.2 * D * lam, -1.0), 10.0)) * s**-0.2)


def _integrate(rate: Callable[[float, Array], Array], start: float, stop: float, state: Array, rtol: float) -> Array:
    """Integrate the (k, n) system from ``start`` to ``stop`` with DOP853."""
    from scipy.integrate import solve_ivp

    shape = state.shape

    def flat(t: float, y: Array) -> Array:
        return rate(t, y.reshape(shape)).ravel()

    done = solve_ivp(flat, (start, stop), state.ravel(), method="DOP853", rtol=rtol, atol=0.1 * rtol)
    if not done.success:
        raise KncalError(f"impact of a Hertz spring with a dashpot: the integrator stopped: {done.message}")
    return np.asarray(done.y[:, -1]).reshape(shape)
