"""Beds made by hand for tests: the numbers of a model straight from a material, without planning."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from kncal.core.checks import Array
from kncal.physics.impact import dimensionless_impact
from kncal.physics.material import Material, pair, wall_pair
from kncal.physics.timestep import contact_time
from kncal.scene.contact import ContactChoice
from kncal.scene.groups import Particles
from kncal.scene.model import PairContact, Plan
from kncal.scene.needs import decide
from kncal.scene.run_control import RunControl
from kncal.scene.scene import MaterialData, Scene
from kncal.scene.walls import BoxWall

D, G = 1.2e-3, 9.81
SOFT = Material(young=5e6, poisson=0.25, density=1000.0, name="soft")
BOX = BoxWall(shape="box", size=(0.015, 0.006, 0.06), material="soft")
CELLS = (5, 2, 20)


def scene(count: int = 400, *, box: BoxWall = BOX, contact: ContactChoice | None = None, **changes: Any) -> Scene:
    """Particles in a box without gas; ``changes`` of the group (place, positions, seed, ...) or of the scene."""
    own = {key: changes.pop(key) for key in [*changes] if key in ("place", "positions", "seed", "frozen")}
    group = Particles(count=count, diameter=D, material="soft", **({"place": "settled"} | own))
    given: dict[str, Any] = {
        "name": "bed",
        "materials": {"soft": MaterialData(young=5e6, poisson=0.25, density=1000.0)},
        "walls": {"column": box},
        "particles": {"beads": group},
        "gravity": (0.0, 0.0, -G),
        "contact": ContactChoice(e_n=0.9, friction=0.3) if contact is None else contact,
        "run": RunControl(until_time=0.1, coupling=5e-4),
    }
    return Scene(**(given | changes))


def model(bed: Scene, kind: str = "linear", *, k_n: float = 100.0, dt: float = 1e-5) -> Plan:
    """Linear with k_n, or Tsuji from the materials, with the damping of ``bed.contact``."""
    choice, bead = bed.contact, bed.spheres[0]
    contacts = {}
    for number, both in enumerate(
        (
            pair(bead.material, bead.radius),
            wall_pair(bead.material, bead.radius, bed.planes[0].material),
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
    return Plan(
        scene=bed,
        kind=kind,
        needs=decide(bed),
        contacts=contacts,
        dt=dt,
        steps_per_coupling=steps,
        couplings=100,
        frames_every=20,
    )


def mass(bed: Scene) -> float:
    """Mass of one particle [kg]."""
    return bed.density * math.pi / 6.0 * bed.diameter**3


def weight(bed: Scene) -> float:
    """Weight of the bed [N]."""
    return bed.number * mass(bed) * bed.g


def still(bed: Scene) -> Array:
    """No force on any particle."""
    return np.zeros((bed.number, 3))
