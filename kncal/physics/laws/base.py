"""What a normal-contact law is: a dimensionless force, and the exact solution of one normal impact.

With the length L and the time T of the law, x = delta/L, tau = t/T and x_dot = d(x)/d(tau), every impact starts
at x = 0 with x_dot = 1 and obeys x'' = -force(x, x'):

===================  ==========================  =============  ====================================
law                  length L                    time T         damping number C
===================  ==========================  =============  ====================================
Hertz-type (n=3/2)   (m_eff v_0^2/k_h)^(2/5)     L/v_0          c L^(p+1)/(m_eff v_0)
linear (n=1)         v_0/omega                   1/omega        2 zeta = eta_n/sqrt(m_eff k_n)
walton_braun (n=1)   v_0/omega                   1/omega        1 - e_n^2, the share of energy lost
===================  ==========================  =============  ====================================

with omega = sqrt(k/m_eff) (walton_braun: k is the loading stiffness) and the dashpot force c delta^p delta_dot.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import KncalError

#: How a contact ends: the overlap returns to zero, or the force returns to zero (attraction is cut off).
ENDS = ("overlap", "force")

#: Smallest e_n served where the solution is not a closed form, and where it is.
E_MIN, E_MIN_CLOSED = 1e-3, 1e-12


def log_loss(e_n: Array) -> Array:
    """-ln(e_n), and 0 (not -0) at e_n = 1: a sign would reach decks as a damping of -0.0."""
    return 0.0 - np.log(e_n)


@dataclass(frozen=True, eq=False)
class Impact:
    """The solution of the dimensionless impact for an array of e_n; every field has that array's shape (n,)."""

    C: Array
    x_max: Array
    tau_c: Array
    x_mean: Array
    x_end: Array


@dataclass(frozen=True, kw_only=True)
class ContactLaw(ABC):
    """A normal-contact law. Instances are immutable and hashable; tables are cached per law.

    Attributes
    ----------
    name : registry name
    title : name for people
    source : publication
    note : when to use it, and when not
    stiffness_exponent : n of the elastic force x^n, 1 or 1.5
    damping_exponent : p of the dashpot force C x^p x_dot; None without a dashpot
    e_depends_on_speed : whether one damping coefficient gives another e_n at another impact speed
    elastic : whether it has no damping at all: e_n = 1 only
    liggghts : what LIGGGHTS 3.8 calls its normal model of this force; "" if it has none
    """

    name: str
    title: str = ""
    source: str = ""
    note: str = ""
    stiffness_exponent: float = 1.5
    damping_exponent: float | None = None
    e_depends_on_speed: bool = False
    elastic: bool = False
    liggghts: str = ""

    @abstractmethod
    def impact(self, e_n: Array, end: str) -> Impact:
        """Solve the impact for ``e_n`` of shape (n,), each in (0, 1] and not below `e_min`; ``end`` is of `ENDS`."""

    def e_min(self, end: str) -> float:
        """Smallest e_n that `impact` serves; 1e-12 for a closed form."""
        return E_MIN_CLOSED

    def force(self, x: Array, x_dot: Array, C: Array | float) -> Array:
        """Dimensionless force x^n + C x^p x_dot (positive: repulsion), zero for x < 0; arguments broadcast.

        The attraction of a dashpot in restitution is not cut off; for ``end="force"`` the caller ends the
        contact where this force reaches zero.
        """
        inside = np.maximum(x, 0.0)
        total = inside if self.stiffness_exponent == 1.0 else inside * np.sqrt(inside)
        if self.damping_exponent is not None:
            total = total + C * inside**self.damping_exponent * np.asarray(x_dot)
        return np.where(np.asarray(x) >= 0.0, total, 0.0)

    def motion(self, C: float, e_n: float, tau: Array) -> tuple[Array, Array]:
        """Overlap and its rate at the times ``tau`` (n,), increasing from 0, within one contact.

        Integrates the equation of motion with DOP853 (rtol 1e-12) unless a law overrides it with a closed form.
        """
        from scipy.integrate import solve_ivp

        def rate(_: float, state: Array) -> Array:
            return np.array([state[1], -self.force(state[0], state[1], C).item()])

        done = solve_ivp(rate, (0.0, float(tau[-1])), [0.0, 1.0], method="DOP853", t_eval=tau, rtol=1e-12, atol=1e-14)
        if not done.success:
            raise KncalError(f"law {self.name!r}, C = {C:g}: the integrator stopped: {done.message}")
        return np.maximum(done.y[0], 0.0), done.y[1]
