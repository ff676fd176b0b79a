"""A table of exact impact solutions over e_n, evaluated by a spline of degree 7.

Solutions are smooth in the logarithms of C/Lambda, x_max, tau_c and x_mean, with Lambda = -ln(e_n), as functions of
u = Lambda^(1/10): at the force end they contain powers Lambda^(1/(3/2-p)) besides the integer ones, and each of
these has at least eight derivatives in u. Lambda = 0 (e_n = 1) is a node, so the elastic limit is met exactly, and
C = Lambda (C/Lambda) keeps its relative accuracy up to it.
"""

from __future__ import annotations

from math import factorial

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import KncalError
from kncal.physics.laws.base import E_MIN

#: exponent of u = Lambda**POWER
POWER = 0.1
WEIGHT = 0.25
DEGREE = 7
#: 8192 values and their four results stay in a core's cache
CHUNK = 8192


def nodes(count: int) -> Array:
    """Lambda at ``count`` nodes from 0 to slightly beyond -ln(`E_MIN`): even in u at first, later in Lambda."""
    top = 1.0001 * -np.log(E_MIN)
    fine = np.linspace(0.0, top**POWER, 4000) ** (1.0 / POWER)
    mixed = fine**POWER + WEIGHT * fine
    return np.asarray(np.interp(np.linspace(0.0, mixed[-1], count), mixed, fine))


class Table:
    """Interpolates positive quantities over e_n.

    Parameters
    ----------
    lam : (n,) -ln(e_n) at the nodes, increasing from 0 to at least -ln(`E_MIN`)
    columns : (n,) each, exact values there, with their limits at lam = 0; all positive
    """

    def __init__(self, lam: Array, *columns: Array) -> None:
        from scipy.interpolate import PPoly, make_interp_spline

        if not lam[-1] >= -np.log(E_MIN):
            raise KncalError(f"impact table ends at e_n = {np.exp(-lam[-1]):g}, expected {E_MIN:g} or less")
        spline = make_interp_spline(lam**POWER, np.log(np.column_stack(columns)), k=DEGREE)
        breaks = np.unique(spline.t)
        taylor = [spline(breaks[:-1], nu) / factorial(nu) for nu in range(DEGREE, -1, -1)]
        self._poly = PPoly(np.array(taylor), breaks)
        self._count = len(columns)

    def __call__(self, lam: Array) -> Array:
        """The quantities (columns, n) at ``lam`` = -ln(e_n) (n,), each in [0, -ln(`E_MIN`)]."""
        out = np.empty((self._count, lam.size))
        for start in range(0, lam.size, CHUNK):
            part = slice(start, start + CHUNK)
            out[:, part] = self._poly(lam[part] ** POWER).T
        return np.exp(out, out=out)
