"""Beds made by hand for tests: the numbers of a model straight from a material, without planning."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from kncal.core.checks import Array
from kncal.physics.impact import dimensionless_impact
from kncal.physics.material import Material, pair, wall_pair
from kncal.physics.timestep import contact_time
from kncal.scene.bed_scene import BedParticles, BedRun, BedScene, Column
from kncal.scene.model import BedModel, PairContact
from kncal.scene.needs import decide
from kncal.scene.scene import ContactChoice

D, G = 1.2e-3, 9.81
SOFT = Material(young=5e6, poisson=0.25, density=1000.0, name="soft")


def column(**changes: Any) -> Column:
    given: dict[str, Any] = {"width": 0.015, "depth": 0.006, "height": 0.06, "cells": (5, 2, 20)}
    return Column(**(given | {"wall_material": SOFT} | changes))


def scene(
    count: int = 400, box: Column | None = None, contact: ContactChoice | None = None, **changes: Any
) -> BedScene:
    particles = BedParticles(count=count, diameter=D, material=SOFT)
    given: dict[str, Any] = {
        "name": "bed",
        "column": column() if box is None else box,
        "particles": replace(
            particles, **{k: changes.pop(k) for k in ("packing", "positions", "seed") if k in changes}
        ),
        "gas": None,
        "gravity": G,
        "contact": ContactChoice(e_n=0.9, friction=0.3) if contact is None else contact,
        "run": BedRun(end_time=0.1, coupling=5e-4),
    }
    return BedScene(**(given | changes))


def model(bed: BedScene, kind: str = "linear", *, k_n: float = 100.0, dt: float = 1e-5) -> BedModel:
    """Linear with k_n, or Tsuji from the materials, with the damping of ``bed.contact``."""
    choice, radius = bed.contact, 0.5 * bed.particles.diameter
    contacts = {}
    for number, both in enumerate(
        (
            pair(bed.particles.material, radius),
            wall_pair(bed.particles.material, radius, bed.column.wall_material),
        )
    ):
        linear, m = kind == "linear", float(both.m_eff)
        k = k_n if linear else float(both.k_h)
        law = "linear" if linear else "tsuji"
        contacts[0, number] = PairContact(
            law=law,
            k=k,
            n=1.0 if linear else 1.5,
            c=float(dimensionless_impact(law, choice.e_n, choice.end).C) * math.sqrt(k * m),
            p=0.0 if linear else 0.25,
            end=choice.end,
            e_n=choice.e_n,
            v_0=None,
            t_c=float(contact_time(k_n, m, choice.e_n, choice.end)),
            delta_max=None,
            m_eff=m,
            R_eff=float(both.R_eff),
            E_eff=float(both.E_eff),
            G_eff=float(both.G_eff),
            friction=choice.friction,
            rolling_friction=choice.rolling_friction,
            k_t=float(both.k_t_ratio) * k if linear else 8.0 * float(both.G_eff) * math.sqrt(float(both.R_eff)),
        )
    steps = 50
    return BedModel(
        scene=bed,
        kind=kind,
        needs=decide(bed),
        contacts=contacts,
        dt=dt,
        steps_per_coupling=steps,
        couplings=100,
        frames_every=20,
    )


def mass(bed: BedScene) -> float:
    """Mass of one particle [kg]."""
    return float(bed.particles.material.density) * math.pi / 6.0 * bed.particles.diameter**3


def weight(bed: BedScene) -> float:
    """Weight of the bed [N]."""
    return bed.particles.count * mass(bed) * bed.gravity


def still(bed: BedScene) -> Array:
    """No force on any particle."""
    return np.zeros((bed.particles.count, 3))
