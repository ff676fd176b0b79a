"""Packings at rest: they are in equilibrium, and their edge of stability is that of their eigenvalues."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kncal.physics.material import sphere_mass
from kncal.scene.case_file import load_case
from kncal.scene.limits import check
from kncal.study.stability.edges import STEPS, find_edge, liggghts_runner, run_builtin
from kncal.study.stability.limits import advised_limit, arrangement_limit, touching
from kncal.study.stability.packings import packing
from kncal.study.stability.probes import Ingredients, Probe, at_step, ingredients

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def given() -> Ingredients:
    made = ingredients(load_case("wall_impact"))
    return replace(made, contact=replace(made.contact, tangential_damping="liggghts"))


def forces(probe: Probe) -> np.ndarray:
    """What the springs of the contacts leave of each weight, over the smallest weight."""
    model = probe.model
    m = np.array([float(sphere_mass(p.material, p.radius)) for p in model.scene.spheres])
    total = m[:, None] * np.array(model.scene.gravity)
    for t in touching(model):
        # F = k delta^n = S delta/n with the tangent stiffness S
        names = [s.name for s in model.scene.spheres]
        first = model.scene.spheres[t.first]
        if t.second is None:
            axis = int(np.argmax(np.abs(t.normal)))
            wall = next(
                w for w in model.scene.planes if w.axis == "xyz"[axis] and (w.position == 0) == (t.normal[axis] > 0)
            )
            c, delta = model.between(first.name, wall.name), first.radius - abs(first.position[axis] - wall.position)
        else:
            second = model.scene.spheres[t.second]
            c = model.between(first.name, names[t.second])
            delta = first.radius + second.radius - float(np.linalg.norm(np.subtract(first.position, second.position)))
            total[t.second] -= c.k * delta**c.n * t.normal
        total[t.first] += c.k * delta**c.n * t.normal
    return np.abs(total) / (m.min() * abs(model.scene.gravity[2]))


@pytest.mark.parametrize(("kind", "ratio"), [("linear", 1.0), ("hertz", 1.0), ("linear", 3.0)])
def test_every_sphere_of_a_packing_is_in_equilibrium(kind: str, ratio: float, given: Ingredients) -> None:
    probe = packing(given, kind, 0.6, size_ratio=ratio)
    radii = [p.radius for p in probe.scene.spheres]
    assert max(radii) / min(radii) == pytest.approx(ratio, rel=1e-12)
    assert forces(probe).max() < 1e-5
    # at least three contacts hold a sphere, and a frictionless packing of many is held by some six each
    assert len(touching(probe.model)) > 2 * len(radii)


@pytest.mark.long
@pytest.mark.parametrize(("kind", "sticks"), [("linear", False), ("hertz", True)])
def test_the_edge_of_a_packing_is_that_of_its_eigenvalues(kind: str, sticks: bool, given: Ingredients) -> None:
    probe = packing(given, kind, 0.6, sticks=sticks)
    limit = arrangement_limit(probe.model)
    found = find_edge(run_builtin, probe, 0.9 * limit, 1.1 * limit, resolution=0.02)
    assert found.middle == pytest.approx(limit, rel=0.02)
    # the advice is for the densest packing and safe here, also for springs that stick
    assert advised_limit(probe.model, 12.0) < found.low
    assert advised_limit(probe.model, 1.0) > found.high
    assert "dt-unstable" in {f.code for f in check(at_step(probe.model, found.high, 10))}


@pytest.mark.long
@pytest.mark.solver
def test_liggghts_has_the_same_edge_of_a_packing_that_sticks(given: Ingredients, tmp_path: Path) -> None:
    probe = packing(given, "linear", 0.6, sticks=True)
    limit = arrangement_limit(probe.model)
    below, beyond = liggghts_runner(tmp_path)(probe, [(0.98 * limit, STEPS), (1.02 * limit, STEPS)])
    assert (below.stable, beyond.stable) == (True, False)
