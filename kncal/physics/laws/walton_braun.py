"""Walton–Braun: one linear spring for loading, a stiffer one for unloading; the loss is plastic, not viscous."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.physics.laws.base import ContactLaw, Impact


@dataclass(frozen=True, kw_only=True)
class WaltonBraun(ContactLaw):
    """Two springs, k_2 = k_1/e_n^2, no adhesion. C = 1 - e_n^2 is the share of the kinetic energy that is lost.

    Loading takes a quarter period of k_1 to x_max = 1; unloading a quarter period of k_2 down to zero force at the
    permanent overlap 1 - e_n^2. There the contact ends for ``end="force"``. For ``end="overlap"`` the spheres, free
    of force, still coast at speed e_n until the overlap of their outlines is zero: (1 - e_n^2)/e_n more time, and
    (1 - e_n^2)^2/(2 e_n) more integral of x.
    """

    def impact(self, e_n: Array, end: str) -> Impact:
        """Closed form: x_max = 1, tau_c = (pi/2)(1 + e_n) at the force end."""
        C = (1.0 - e_n) * (1.0 + e_n)
        tau_c = 0.5 * np.pi * (1.0 + e_n)
        area = 1.0 + 0.5 * np.pi * C * e_n + e_n**3
        x_end = C
        if end == "overlap":
            tau_c = tau_c + C / e_n
            area = area + 0.5 * C * (C / e_n)
            x_end = np.zeros_like(e_n)
        return Impact(C, np.ones_like(e_n), tau_c, area / tau_c, x_end)

    def force(self, x: Array, x_dot: Array, C: Array | float) -> Array:
        """Loading (x_dot >= 0): x; unloading: max(0, (x - C)/(1 - C)).

        The law has memory; this is its force along one impact from x_dot = 1, whose largest overlap is 1. It is not
        defined for a reloading contact.
        """
        x, x_dot = np.asarray(x), np.asarray(x_dot)
        return np.maximum(0.0, np.where(x_dot >= 0.0, x, (x - C) / (1.0 - np.asarray(C))))

    def motion(self, C: float, e_n: float, tau: Array) -> tuple[Array, Array]:
        """Sine with frequency 1, sine with frequency 1/e_n about the permanent overlap, then free flight."""
        back = tau - 0.5 * np.pi
        angle = np.clip(back / e_n, 0.0, 0.5 * np.pi)
        free = np.maximum(back - 0.5 * np.pi * e_n, 0.0)
        loading = back < 0.0
        x = np.where(loading, np.sin(tau), C + e_n * e_n * np.cos(angle) - e_n * free)
        return np.maximum(x, 0.0), np.where(loading, np.cos(tau), -e_n * np.sin(angle))


WALTON_BRAUN = WaltonBraun(
    name="walton_braun",
    title="Walton–Braun (two springs, hysteretic)",
    source="Walton & Braun, J. Rheol. 30 (1986) 949",
    note=(
        "Plastic dissipation with linear springs: loses energy without a dashpot, also in slow motion. This is the "
        "form with constant e_n and k_1; real plastic contacts lose more at higher speed. LIGGGHTS' "
        "hooke/hysteresis is another law (its e_n falls with the speed), so no engine runs this one."
    ),
    stiffness_exponent=1.0,
)
