"""Drag laws of particles in a gas, by the names that a case uses.

All in OpenFOAM's way: the force on a particle of volume V is ``V * per_slip(...) * (u_gas - u_particle)``, with the
pressure gradient of the flow in it (model B, see `kncal.physics.fluidization`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.core.registry import Registry
from kncal.physics.fluidization import drag_per_slip


@dataclass(frozen=True, kw_only=True)
class Drag:
    """One drag law.

    Attributes
    ----------
    name, title, source : identification
    openfoam : what DPMFoam calls it (without its suffix Drag); kncal computes with the same formula
    per_slip : (eps_g [-], slip [m/s], diameter [m], density of the gas [kg/m³], viscosity [Pa s]) -> drag on a
        particle per its volume and per slip velocity [kg/(m³ s)]; the first three arrays of one shape, in range
    """

    name: str
    title: str
    source: str
    openfoam: str
    per_slip: Callable[[Array, Array, Array, float, float], Array]


def _plessis_masliyah(eps_g: Array, slip: Array, diameter: Array, density_gas: float, viscosity: float) -> Array:
    Re = density_gas * slip * diameter / viscosity
    s = np.cbrt(1.0 - eps_g)  # the side of the cube that stands for the grain in a unit cell
    # f = A (1 - eps)/eps + B Re, with the (1 - eps) of A's denominator cancelled: it has a limit at eps = 1.
    viscous = 26.8 * eps_g**2 * s / ((1.0 - s) * (1.0 - s**2) ** 2)
    inertial = eps_g**2 * Re / (1.0 - s**2) ** 2
    return np.asarray((viscous + inertial) * viscosity / (eps_g * diameter**2))


#: The drag laws by name; packages add theirs by entry points of the group ``kncal.drags``.
DRAGS = Registry(
    "drag",
    Drag,
    Drag(
        name="ErgunWenYu",
        title="Ergun below a void fraction of 0.8, Wen and Yu above (Gidaspow's combination)",
        source="Gidaspow, Multiphase Flow and Fluidization (1994), section 2.4",
        openfoam="ErgunWenYu",
        per_slip=drag_per_slip,
    ),
    Drag(
        name="PlessisMasliyah",
        title="Du Plessis and Masliyah: flow through grains from dense to dilute, with the constant 26.8",
        source="du Plessis and Masliyah, Transport in Porous Media 3 (1988) 145-161",
        openfoam="PlessisMasliyah",
        per_slip=_plessis_masliyah,
    ),
    group="kncal.drags",
)
