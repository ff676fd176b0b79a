"""The block of a case: types, and the numbers of every two of them, also of those that never meet in the case."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from models import with_bodies

from kncal import Material, RenderError
from kncal.engines.liggghts.deck_block import case_block, liggghts_block
from kncal.engines.liggghts.deck_tables import AtomType
from kncal.scene.bodies import Particle, Wall
from kncal.scene.case_file import load_case
from kncal.scene.contact import ContactChoice, PairChoice
from kncal.scene.plan import plan
from kncal.scene.scene import Scene

GLASS = Material(young=7e9, poisson=0.22, density=2500.0, name="glass")
STEEL = Material(young=2.1e11, poisson=0.3, density=7800.0, name="steel")


def bead(name: str, z: float, radius: float = 1e-3) -> Particle:
    return Particle(
        name=name, material=GLASS, radius=radius, position=(0.0, 0.0, z), velocity=(0.0, 0.0, -1.0 if z > 0.02 else 0.0)
    )


SCENE = Scene.of(
    name="s",
    spheres=(bead("a", 0.01), bead("b", 0.05, 5e-3), bead("c", 0.04), bead("odd", 0.06)),
    planes=(Wall(name="floor", axis="z", position=0.0, material=STEEL), Wall(name="lid", axis="z", position=0.1)),
    contact=ContactChoice(e_n=0.9, v_0=1.0, friction=0.3, pairs=(PairChoice(between=("odd", "steel"), e_n=0.5),)),
)


def tables(block: str) -> tuple[list[str], dict[str, np.ndarray]]:
    """Names of the types, and each property as a matrix."""
    line = next(x for x in block.splitlines() if x.startswith("# atom types: "))
    names = [part.split(" = ")[1] for part in line.removeprefix("# atom types: ").split(", ")]
    found = {}
    for words in map(str.split, block.splitlines()):
        if words[0] == "fix" and words[5] == "peratomtypepair":
            found[words[1]] = np.array([float(x) for x in words[7:]]).reshape(len(names), len(names))
    return names, found


def test_like_bodies_are_one_type_and_those_of_exceptions_are_their_own():
    names, table = tables(case_block(SCENE))
    assert names == ["a", "b", "odd", "floor", "lid"]
    assert all(np.array_equal(matrix, matrix.T) for matrix in table.values())
    assert (table["coefficientFriction"] == 0.3).all()
    # every pair of the scene has what a run of it has
    models = plan(SCENE, ["linear"])
    index = {"a": 0, "c": 0, "b": 1, "odd": 2, "floor": 3, "lid": 4}
    for (one, other), c in models["linear"].named.items():
        i, j = index[one], index[other]
        assert table["kn"][i, j] == pytest.approx(c.k, rel=1e-14)
        assert table["gamman"][i, j] == pytest.approx(c.c / c.m_eff, rel=1e-14)


def test_pairs_that_never_meet_in_the_case_have_their_own_numbers():
    names, table = tables(case_block(SCENE))
    radius = {"a": 1e-3, "b": 5e-3, "odd": 1e-3}
    for name, r in radius.items():
        i = names.index(name)
        m_eff = 0.5 * GLASS.density * 4.0 / 3.0 * math.pi * r**3
        zeta = table["gamman"][i, i] * math.sqrt(m_eff / table["kn"][i, i]) / 2.0
        assert math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)) == pytest.approx(0.9, rel=1e-10)
    small, large = table["kn"][0, 0], table["kn"][1, 1]
    assert large / small == pytest.approx(5.0, rel=1e-10)  # k_n of like spheres goes with R at one speed


def test_the_block_of_a_bed_has_its_particles_and_walls():
    scene = load_case("bubbling_bed_mini")
    names, table = tables(case_block(scene))
    assert names == ["beads", "column"]
    assert table["kt"][0, 0] == pytest.approx(table["kn"][0, 0] * 2.0 / 7.0, rel=1e-5)
    assert (table["coefficientFriction"] == 0.1).all()
    # a wall of the same material: k_n 2^0.6 times, gamman (2 zeta sqrt(k/m)) 2^(-0.2) times that of two particles
    assert table["kn"][0, 1] / table["kn"][0, 0] == pytest.approx(2.0**0.6, rel=1e-10)
    assert table["gamman"][0, 1] / table["gamman"][0, 0] == pytest.approx(2.0**-0.2, rel=1e-10)
    assert "rolling_friction" not in case_block(scene)


def test_rolling_friction_comes_with_its_model():
    block = case_block(load_case("oblique_impact", overrides=["contact.rolling_friction=0.02"]))
    assert (tables(block)[1]["coefficientRollingFriction"] == 0.02).all()
    assert all("rolling_friction cdt" in line for line in block.splitlines() if "gran model" in line)


def test_a_pair_without_numbers_is_named_and_a_contact_of_another_kind_refused():
    types = [AtomType(name="ball", material=GLASS), AtomType(name="w", material=None, is_wall=True)]
    given = plan(SCENE, ["linear"])["linear"]
    block = liggghts_block(types, {("ball", "w"): given.between("a", "floor")})
    assert "ball with ball" in block
    assert "ball with w" not in block
    with pytest.raises(RenderError, match="no contact"):
        liggghts_block(types, {})
    with pytest.raises(RenderError, match="hertz"):
        liggghts_block(types, dict.fromkeys([("ball", "ball"), ("w", "ball")], given.between("a", "b")), "hertz")
    # alone with a wall that it is at rest on, k_n for that pair only
    resting = with_bodies(
        SCENE,
        spheres=(replace(SCENE.spheres[0], position=(0.0, 0.0, 1e-3), velocity=(0.0, 0.0, 0.0)),),
        contact=ContactChoice(e_n=0.9, pairs=tuple(PairChoice(between=("a", w), k_n=1e5) for w in ("floor", "lid"))),
    )
    _, table = tables(case_block(resting))
    assert (table["kn"][:, 1:] == 1e5).all()
    assert "a with a" in case_block(resting)


@pytest.mark.parametrize("key", ["k", "c", "k_t", "friction"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_bad_numbers_never_reach_a_block(key, value):
    contact = replace(plan(SCENE, ["linear"])["linear"].between("a", "b"), **{key: value})
    with pytest.raises(RenderError, match=f"{key} = "):
        liggghts_block([AtomType(name="a", material=GLASS)], {("a", "a"): contact})
