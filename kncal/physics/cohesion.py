"""Cohesion by contact area (LIGGGHTS' sjkr): F_c = kappa A, without memory, so it costs no energy by itself.

A is the area of the circle in which the outlines of two spheres cut each other, for small overlaps 2 pi R_eff delta.
All formulas *derived here* from it.
"""

from __future__ import annotations

import math


def slope(density: float, R_eff: float) -> float:
    """Return F_c/delta = 2 pi R_eff kappa [N/m] for the energy density kappa [J/m³] and small overlaps."""
    return 2.0 * math.pi * R_eff * density


def share(k: float, n: float, density: float, R_eff: float, delta: float) -> float:
    """Return the cohesive force over the elastic one, k delta^n, at an overlap [m]; of a linear contact one number.

    From 1 on a linear contact has no spring left that holds the bodies apart.
    """
    return slope(density, R_eff) / (k * float(delta ** (n - 1.0)))


def resting_overlap(k: float, n: float, density: float, R_eff: float) -> float:
    """Return the overlap [m] at which cohesion alone holds a Hertz contact, (F_c/delta/k)²; 0 for a linear one."""
    return 0.0 if n == 1.0 else float((slope(density, R_eff) / k) ** (1.0 / (n - 1.0)))


def pull_off(k: float, n: float, density: float, R_eff: float) -> float:
    """Return the largest force [N] that a contact at rest resists when it is pulled.

    Hertz: (4/27) (2 pi R_eff kappa)³/k_h², at 4/9 of `resting_overlap`. A linear contact with ``share`` below 1 has
    none: its attraction is nowhere larger than its spring's repulsion.
    """
    return 0.0 if n == 1.0 else 4.0 / 27.0 * slope(density, R_eff) ** 3 / k**2


def same_force(density: float, delta: float, delta_soft: float) -> float:
    """Return the energy density [J/m³] whose force at ``delta_soft`` is that of ``density`` at ``delta`` [m].

    For one method of calibration that is a factor (E_soft/E)^(2/5): the exponent that Hærvig et al., Powder Technol.
    319 (2017) 472, give for the surface energy of softened JKR contacts.
    """
    return density * delta / delta_soft
