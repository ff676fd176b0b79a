"""The tangential side of a contact: damping of a contact that sticks, and the restitution that it gives.

Tangential force while the surfaces stick: F_t = -k_t delta^(n-1) s - c_t delta^p u, with the stretch s of the spring
and the velocity u of the contact point; cut at friction times the normal force, and then without damping, as LIGGGHTS
does. Exponents n and p are those of the normal law.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import KncalError

#: Mass of a solid sphere over that which its contact point has tangentially: 1 + m R²/I, I = (2/5) m R².
LIGHTER = 3.5

#: From c, n, k, k_t of a contact to its c_t [N s/m^(1+p)].
TANGENTIAL_DAMPING: Mapping[str, Callable[[float, float, float, float], float]] = {
    "none": lambda c, n, k, k_t: 0.0,
    # c_t/c = sqrt(S_t/S_n), S = dF/ddelta: 2 sqrt(5/6) beta sqrt(S m) for both directions (LIGGGHTS, model hertz)
    "liggghts": lambda c, n, k, k_t: c * math.sqrt(k_t / (n * k)),
    # MFIX: eta_t = eta_n/2
    "half_normal": lambda c, n, k, k_t: 0.5 * c,
}


def stick_restitution(
    *, n: float, p: float, k: float, c: float, k_t: float, c_t: float, m_eff: float, v_0: float, end: str
) -> float:
    """Return -u(t_c)/u(0), the restitution of the velocity u of the contact point if it never slips [-].

    m_eff u' = -3.5 (k_t delta^(n-1) s + c_t delta^p u), s' = u, along the normal motion of one impact between solid
    spheres (or with a wall), for overlaps small against the radii. *Derived here*; without damping Maw, Barber &
    Fawcett, Wear 38 (1976) 101. Between -1 and 1 for a linear contact. The tangential stiffness of a Hertz contact
    changes while it is stretched, which may give the spring a little energy or take it.

    Parameters
    ----------
    n, p, k, c : of the normal force k delta^n + c delta^p delta_dot (`kncal.scene.model.PairContact`)
    k_t, c_t : tangential stiffness [N/m^n] and damping [N s/m^(1+p)]
    m_eff : effective mass [kg]; v_0 : normal impact speed [m/s]
    end : "overlap" or "force"

    Raises
    ------
    KncalError
        If the impact has no end within the time that is looked at.
    """
    from scipy.integrate import solve_ivp

    # in units of the undamped linear or Hertz impact: length L, time L/v_0
    L = (m_eff * v_0**2 / k) ** (1.0 / (n + 1.0))
    force_scale = m_eff * v_0**2 / L
    C = c * L**p * v_0 / force_scale
    K_t, C_t = LIGHTER * k_t * L**n / force_scale, LIGHTER * c_t * L**p * v_0 / force_scale

    def rate(_: float, state: Array) -> list[float]:
        x, w, s, u = state
        x = max(x, 0.0)
        return [w, -(x**n) - C * x**p * w, u, -K_t * x ** (n - 1.0) * s - C_t * x**p * u]

    def over(_: float, state: Array) -> float:
        x, w = state[:2]
        return float(x if end == "overlap" or w > 0.0 else max(x, 0.0) ** n + C * max(x, 0.0) ** p * w)

    over.terminal, over.direction = True, -1.0  # type: ignore[attr-defined]
    found = solve_ivp(rate, (0.0, 1e4), [0.0, 1.0, 0.0, 1.0], method="DOP853", events=over, rtol=1e-10, atol=1e-13)
    if found.status != 1 or found.y_events is None:
        raise KncalError(f"n = {n:g}, C = {C:g}: the impact does not end: expected a larger e_n")
    return float(-np.ravel(found.y_events[0])[3])
