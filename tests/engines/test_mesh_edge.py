"""The edge of stability at a mesh wall is that of one contact, wherever on its triangles a sphere lies."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kncal.engines.liggghts.library import LiggghtsDem
from kncal.physics.timestep import verlet_limit
from kncal.scene.case_file import load_case
from kncal.scene.contact_limits import sticking_limit
from kncal.scene.placement import Start
from kncal.scene.plan import plan

pytestmark = pytest.mark.solver

R = 1e-3
#: Corners of a fan of triangles about the origin.
RIM = [(0.04 * math.cos(0.2 + math.pi * i / 4.0), 0.04 * math.sin(0.2 + math.pi * i / 4.0)) for i in range(8)]
#: On a triangle, on the node of all of them, on the edge of two.
PLACES = ((0.02, 0.0), (0.0, 0.0), (0.5 * RIM[2][0], 0.5 * RIM[2][1]))
CASE = """
gravity = [0.0, 0.0, -9.81]
[materials.glass]
young = 5e6
poisson = 0.25
density = 2500.0
[particles.ball]
material = "glass"
diameter = {d}
positions = {positions}
[walls.fan]
shape = "mesh"
file = "fan.stl"
material = "glass"
[domain]
low = [-0.05, -0.05, -0.01]
high = [0.05, 0.05, 0.02]
[contact]
e_n = 0.5
v_0 = 0.1
friction = {friction}
tangential_damping = "liggghts"
[run]
until_time = 0.1
sample_every = 1e-3
"""


def fan() -> str:
    """The triangles as text."""
    lines = []
    for (x_1, y_1), (x_2, y_2) in zip(RIM, RIM[1:] + RIM[:1], strict=True):
        nodes = "".join(f"vertex {x:.9e} {y:.9e} 0\n" for x, y in ((0.0, 0.0), (x_1, y_1), (x_2, y_2)))
        lines.append(f"facet normal 0 0 1\nouter loop\n{nodes}endloop\nendfacet\n")
    return f"solid fan\n{''.join(lines)}endsolid fan\n"


@pytest.mark.parametrize(("kind", "friction"), [("hertz", 0.0), ("linear", 5.0)])
def test_a_sphere_at_rest_on_a_mesh_is_stable_up_to_the_limit_of_one_contact(
    kind: str, friction: float, tmp_path: Path
) -> None:
    (tmp_path / "fan.stl").write_text(fan())
    positions = [[x, y, 2.0 * R] for x, y in PLACES]
    (tmp_path / "case.toml").write_text(CASE.format(d=2.0 * R, positions=positions, friction=friction))
    model = plan(load_case(str(tmp_path / "case.toml")), (kind,))[kind]
    contact = next(c for names, c in model.named.items() if "fan" in names)
    delta = contact.overlap_under(contact.m_eff * 9.81)
    k, eta = contact.n * contact.k * delta ** (contact.n - 1.0), contact.c * delta**contact.p
    limit = min(float(verlet_limit(k, contact.m_eff, eta)), sticking_limit(contact, delta))
    x = np.array([[*place, R - delta] for place in PLACES])
    nudge = 1e-4 * delta * math.sqrt(k / contact.m_eff)
    v = np.array([[0.01 * nudge if friction else 0.0, 0.0, nudge]] * len(x))

    def grows(share: float) -> list[bool]:
        folder = tmp_path / f"{share:g}"
        with LiggghtsDem(replace(model, dt=share * limit), folder, Start.at(x, v)) as dem:
            energies = []
            for _ in range(20):  # an unstable swing alternates: an odd number of steps sees both signs
                dem.run(21)
                energies.append((dem.state().v ** 2).sum(axis=1))
        start, first, late = (v**2).sum(axis=1), np.max(energies[:10], axis=0), np.max(energies[10:], axis=0)
        # it grows, or has grown until the contact opened, after which a Hertz contact may come to rest again
        return [bool(grown) for grown in (late > 4.0 * np.maximum(first, 1e-8 * start)) | (first > 100.0 * start)]

    assert not any(grows(0.97))
    assert all(grows(1.05))
