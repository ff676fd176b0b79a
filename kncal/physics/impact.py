"""One normal impact of any contact law, without dimensions: what the law does between touch and separation.

Units of every law, and the meaning of C, are in `kncal.physics.laws.base`. With a pair's L and T: delta_max = x_max L,
t_c = tau_c T, delta_mean = x_mean L, the overlap at the end of the contact is x_end L.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from kncal.core.checks import MOST_VALUES, Array, in_range, one_of, single, whole
from kncal.physics.laws import LAWS
from kncal.physics.laws.base import ENDS, ContactLaw
from kncal.physics.material import FloatOrArray, plain

#: What an e_n out of range is told.
NO_REBOUND = (
    "a restitution is rebound speed over impact speed; e_n = 0 has no finite solution: take the smallest that N steps "
    "per contact resolve, kncal.smallest_restitution(N)"
)


@dataclass(frozen=True, eq=False)
class DimensionlessImpact:
    """The impact of one law; floats for a scalar e_n, else arrays of its shape.

    Attributes
    ----------
    law : the law's name
    e_n : normal coefficient of restitution [-]
    end : contact end, "overlap" or "force"
    C : damping number (2 zeta for linear, 1 - e_n^2 for walton_braun)
    x_max : largest overlap
    tau_c : duration of the contact
    x_mean : time mean of the overlap over the contact
    x_end : overlap at the end of the contact (0 for end = "overlap")
    """

    law: str
    e_n: FloatOrArray
    end: str
    C: FloatOrArray
    x_max: FloatOrArray
    tau_c: FloatOrArray
    x_mean: FloatOrArray
    x_end: FloatOrArray


@dataclass(frozen=True, eq=False)
class ImpactPath:
    """One impact over time, from touch (tau = 0) to the end of the contact; arrays of shape (n,)."""

    law: str
    e_n: float
    end: str
    C: float
    tau: Array
    x: Array
    x_dot: Array
    force: Array


def dimensionless_impact(law: str | ContactLaw, e_n: ArrayLike, end: str = "overlap") -> DimensionlessImpact:
    """Solve the dimensionless impact exactly: relative error below 1e-10 for 0.01 <= e_n <= 1.

    Parameters
    ----------
    law : registry name, or a law object of your own (for instance `kncal.physics.laws.polar.HertzDashpot`)
    e_n : float or array
        Normal coefficient of restitution, 1e-12 to 1; at least 1e-3 where the law has no closed form, exactly 1
        for "hertz".
    end : "overlap" (the contact ends when the overlap returns to zero) or "force" (when the force does)

    Raises
    ------
    InputError
        If the law or the end is unknown, or an e_n is out of range.
    """
    chosen = LAWS.find(law)
    end = one_of("end", end, ENDS)
    e = _restitution(chosen, e_n, end)
    return _one(chosen, float(e), end) if e.ndim == 0 else _solve(chosen, e, end)


@lru_cache(maxsize=4096)  # the pairs of a scene share few e_n
def _one(law: ContactLaw, e_n: float, end: str) -> DimensionlessImpact:
    return _solve(law, np.asarray(e_n), end)


def _solve(chosen: ContactLaw, e: Array, end: str) -> DimensionlessImpact:
    found = chosen.impact(e.ravel(), end)
    fields = (found.C, found.x_max, found.tau_c, found.x_mean, found.x_end)
    C, x_max, tau_c, x_mean, x_end = (plain(np.asarray(field).reshape(e.shape)) for field in fields)
    return DimensionlessImpact(chosen.name, plain(e), end, C, x_max, tau_c, x_mean, x_end)


def impact_path(law: str | ContactLaw, e_n: float, end: str = "overlap", n: int = 400) -> ImpactPath:
    """Time series of one impact, at ``n`` uniform times; closed form or DOP853 at rtol 1e-12.

    Raises
    ------
    InputError
        As `dimensionless_impact`; also if e_n is not a single number or n is not a whole number from 2 to a million.
    """
    e_n = single("e_n", e_n)
    n = whole("n", n, 2, MOST_VALUES)
    chosen = LAWS.find(law)
    impact = dimensionless_impact(chosen, e_n, end)
    C, e = float(impact.C), float(impact.e_n)
    tau = np.linspace(0.0, float(impact.tau_c), n)
    x, x_dot = chosen.motion(C, e, tau)
    return ImpactPath(chosen.name, e, end, C, tau, x, x_dot, chosen.force(x, x_dot, C))


def _restitution(law: ContactLaw, e_n: ArrayLike, end: str) -> Array:
    e = in_range("e_n", e_n, 0.0, 1.0, low_open=True, hint=NO_REBOUND)
    lowest = law.e_min(end)
    hint = f"the smallest supported e_n of law {law.name!r} with end {end!r} is {lowest:g}"
    return in_range("e_n", e, lowest, 1.0, hint=hint)
