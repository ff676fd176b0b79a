"""Hertz without damping: x^(3/2), exact in closed form, e_n = 1 only."""

from __future__ import annotations

from dataclasses import dataclass
from math import gamma

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.physics.laws.base import ContactLaw, Impact

_BETA_TIME = gamma(0.4) * gamma(0.5) / gamma(0.9)  # B(2/5, 1/2)
_BETA_AREA = gamma(0.8) * gamma(0.5) / gamma(1.3)  # B(4/5, 1/2)

#: Elastic impact: (5/4)^(2/5), (4/5) x_max B(2/5, 1/2), x_max B(4/5, 1/2)/B(2/5, 1/2).
X_MAX = 1.25**0.4
TAU_C = 0.8 * X_MAX * _BETA_TIME
X_MEAN = X_MAX * _BETA_AREA / _BETA_TIME


@dataclass(frozen=True, kw_only=True)
class Hertz(ContactLaw):
    """The elastic sphere."""

    def impact(self, e_n: Array, end: str) -> Impact:
        """Energy conservation gives every number; both ends coincide.

        Raises
        ------
        InputError
            If an e_n is not exactly 1.
        """
        lossy = e_n != 1.0
        if lossy.any():
            raise InputError(
                f"e_n = {e_n[lossy][0]:g}: the law 'hertz' has no damping, expected e_n = 1 exactly; "
                "take 'tsuji' for a Hertz contact with restitution below 1"
            )
        zero, one = np.zeros_like(e_n), np.ones_like(e_n)
        return Impact(zero, X_MAX * one, TAU_C * one, X_MEAN * one, zero)


HERTZ = Hertz(
    name="hertz",
    title="Hertz, elastic",
    source="Hertz, J. reine angew. Math. 92 (1882) 156; Johnson, Contact Mechanics (1985), sections 4.2 and 11.4",
    note="Elastic smooth spheres, small overlap, impact far below the wave speed. e_n = 1 only.",
    elastic=True,
    liggghts="hertz",
)
