"""Tangential damping, rolling friction and cohesion of a case: who has them, what they need, and where they end."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np
import pytest
from models import R, mass, model, on_wall

from kncal.cli import main
from kncal.core.errors import CaseFileError, ValidityError
from kncal.engines.builtin.integrator import integrate
from kncal.physics.material import Material
from kncal.scene.bodies import Particle, Wall
from kncal.scene.case_file import parse_case
from kncal.scene.contact import ContactChoice, PairChoice
from kncal.scene.contact_limits import sticking_limit
from kncal.scene.exact import solve
from kncal.scene.limits import check
from kncal.scene.model import KINDS
from kncal.scene.needs import decide
from kncal.scene.plan import plan
from kncal.scene.run_control import RunControl
from kncal.scene.scene import Scene
from kncal.study.trim.parts import parts_of

GLASS = Material(name="glass", young=5e6, poisson=0.25, density=2500.0)
STEEL = Material(name="steel", young=2e9, poisson=0.3, density=7800.0)


def scene(**contact: Any) -> Scene:
    """A sphere of glass and one of steel, thrown at a floor of steel."""
    bodies = tuple(
        Particle(name=name, material=m, radius=R, position=(4.0 * R * k, 0.0, 1.1 * R), velocity=(-0.2 * k, 0.0, -0.5))
        for k, (name, m) in enumerate((("one", GLASS), ("two", STEEL)))
    )
    return Scene.of(
        name="pairs",
        spheres=bodies,
        planes=(Wall(name="floor", axis="z", position=0.0, material=STEEL),),
        gravity=(0.0, 0.0, -9.81),
        contact=ContactChoice(**{"e_n": 0.8, "v_0": 0.5, "friction": 0.4} | contact),
        run=RunControl(until_time=1e-3),
    )


@pytest.mark.parametrize("kind", KINDS)
def test_every_pair_has_its_own_rolling_friction_and_cohesion(kind: str) -> None:
    pairs = (
        PairChoice(between=("glass", "floor"), rolling_friction=0.2),
        PairChoice(between=("one", "two"), rolling_friction=0.0, cohesion_energy_density=30.0, friction=0.1),
    )
    given = plan(scene(rolling_friction=0.05, cohesion_energy_density=10.0, pairs=pairs), [kind])[kind]
    found = {
        names: (c.friction, c.rolling_friction, c.cohesion)
        for names in (("one", "floor"), ("two", "floor"), ("one", "two"))
        for c in [given.between(*names)]
    }
    assert found == {
        ("one", "floor"): (0.4, 0.2, 10.0),
        ("two", "floor"): (0.4, 0.05, 10.0),
        ("one", "two"): (0.1, 0.0, 30.0),
    }


@pytest.mark.parametrize("kind", KINDS)
def test_tangential_damping_is_half_or_as_strong_for_its_spring_as_the_normal_one(kind: str) -> None:
    half, own, none = (
        plan(scene(tangential_damping=word), [kind])[kind].between("one", "floor")
        for word in ("half_normal", "liggghts", "none")
    )
    assert (half.c_t, none.c_t) == (0.5 * half.c, 0.0)
    # damping over twice the root of mass and tangent stiffness, at some overlap
    delta = 1e-6
    normal = own.c * delta**own.p / math.sqrt(own.n * own.k * delta ** (own.n - 1.0))
    along = own.c_t * delta**own.p / math.sqrt(own.k_t * delta ** (own.n - 1.0))
    assert along == pytest.approx(normal, rel=1e-12)


def test_needs_say_what_of_the_contact_acts() -> None:
    def used(**contact: Any) -> set[str]:
        asked = ("tangential", "tangential_damping", "history", "cohesion", "rolling")
        needs = decide(scene(**contact))
        return {name for name in asked if needs.uses(name)}

    assert used() == {"tangential", "history"}
    assert used(tangential_damping="liggghts") == {"tangential", "history", "tangential_damping"}
    assert used(tangential_damping="liggghts", friction=0.0) == set()
    assert used(tangential_damping="liggghts", e_n=1.0) == {"tangential", "history"}
    assert used(friction=0.0, cohesion_energy_density=1.0) == {"cohesion"}
    stuck = PairChoice(between=("one", "floor"), cohesion_energy_density=1.0, rolling_friction=0.1)
    assert used(pairs=(stuck,)) == {"tangential", "history", "cohesion", "rolling"}


def test_a_damped_contact_without_tangential_force_is_planned_without() -> None:
    asked = dataclasses.replace(scene(tangential_damping="liggghts"), needs={"tangential": False})
    assert {c.c_t for c in plan(asked, ["linear"])["linear"].contacts.values()} == {0.0}


def test_trim_tries_tangential_damping_and_cohesion() -> None:
    def tried(**contact: Any) -> dict[str, dict[str, Any]]:
        found = parts_of(scene(**contact), "linear", ["tangential_damping", "cohesion"])
        return {part.group: dict(part.changes) for part in found}

    assert tried()["tangential_damping"] == {"contact.tangential_damping": "liggghts"}
    assert tried(tangential_damping="half_normal")["tangential_damping"] == {"contact.tangential_damping": "none"}
    assert tried(friction=0.0)["tangential_damping"] == {}
    assert tried()["cohesion"] == {}
    sticky = PairChoice(between=("one", "two"), cohesion_energy_density=1.0)
    assert tried(pairs=(sticky,))["cohesion"] == {
        "contact.pairs.0.cohesion_energy_density": 0.0,
        "contact.cohesion_energy_density": 0.0,
    }


# --- limits


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_linear_contact_that_cohesion_pulls_shut_is_refused(share: float) -> None:
    smooth = plan(scene(), ["linear"])["linear"]
    weakest = min(smooth.contacts.values(), key=lambda c: c.k / c.R_eff)
    density = share * weakest.k / (2.0 * math.pi * weakest.R_eff)
    sticky = plan(scene(cohesion_energy_density=density), ["linear"])["linear"]
    assert (("cohesion", "refuse") in {(f.code, f.level) for f in check(sticky)}) == (share > 1.0)
    assert "cohesion" not in {f.code for f in check(plan(scene(cohesion_energy_density=density), ["hertz"])["hertz"])}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("e_n", "damping_t"), [(1.0, "none"), (0.5, "none"), (0.5, "same"), (0.1, "same")])
def test_a_sticking_contact_is_stable_up_to_its_own_limit(kind: str, e_n: float, damping_t: str) -> None:
    own = model(on_wall(), kind, t_end=1.0, e_n=e_n, damping_t=damping_t, friction=1e6).between("bead", "floor")
    delta = own.overlap_under(mass(on_wall().spheres[0]) * 9.81)
    limit = sticking_limit(own, delta)
    pushed = on_wall(gap=-delta, velocity=(1e-9, 0.0, 0.0), gravity=9.81)
    given = model(pushed, kind, t_end=1.0, e_n=e_n, damping_t=damping_t, friction=1e6)

    def swing(share: float) -> float:
        run = integrate(dataclasses.replace(given, dt=share * limit, n_steps=400))
        return float(np.abs(run.v[-40:, 0, 0] - R * run.spin[-40:, 0, 1]).max())

    # the velocities of whole steps swing wider than those between, the more the nearer the edge is
    assert swing(0.97) < 10e-9
    assert swing(1.03) > 1e-6


def test_a_step_beyond_the_limit_of_sticking_is_said() -> None:
    def codes(steps: float, **contact: Any) -> set[str]:
        tried = dataclasses.replace(scene(e_n=1.0, **contact), run=RunControl(until_time=1e-3, steps_per_contact=steps))
        return {f.code for f in check(plan(tried, ["linear"])["linear"])}

    # omega dt = pi/N below 2/sqrt(3 contacts) = 1.15 of the normal springs, but not below 1.15/sqrt(3.5 k_t/k_n)
    assert "dt-unstable" in codes(4.0, k_t_ratio=1.0)
    assert "dt-unstable" not in codes(4.0, k_t_ratio=1.0, friction=0.0)
    assert "dt-unstable" not in codes(6.0, k_t_ratio=1.0)


def test_cohesion_has_no_exact_motion() -> None:
    with pytest.raises(ValidityError, match="cohesion"):
        solve(plan(scene(friction=0.0, cohesion_energy_density=1.0), ["linear"])["linear"], 1e-3)


# --- the case file and the command

CASE = """
[materials.glass]
young = 5e6
poisson = 0.25
density = 2500.0
[particles.ball]
material = "glass"
diameter = 0.002
position = [0.0, 0.0, 0.0011]
velocity = [0.1, 0.0, -0.5]
[walls.floor]
axis = "z"
position = 0.0
material = "glass"
[contact]
e_n = 0.8
{contact}
[run]
until_time = 1e-3
"""


@pytest.mark.parametrize(
    ("line", "key"),
    [
        ("rolling_damping = 0.1", "rolling_damping"),
        ('rolling_model = "epsd3"', "rolling_model"),
        ('tangential_damping = "full"', "tangential_damping"),
        ("cohesion_energy_density = -1.0", "cohesion_energy_density"),
        ("pairs = [{ between = ['ball', 'floor'] }]", "cohesion_energy_density"),
        ("pairs = [{ between = ['ball', 'floor'], rolling_friction = 11.0 }]", "rolling_friction"),
    ],
)
def test_what_a_contact_cannot_be_is_refused_at_its_key(line: str, key: str) -> None:
    with pytest.raises(CaseFileError, match=key):
        parse_case(CASE.format(contact=line), name="x")


def test_kn_of_a_case_says_what_friction_and_cohesion_make_of_it(
    capsys: pytest.CaptureFixture[str], tmp_path: Any
) -> None:
    words = 'friction = 0.3\ntangential_damping = "liggghts"\ncohesion_energy_density = 30000.0'
    path = tmp_path / "case.toml"
    path.write_text(f"gravity = [0.0, 0.0, -9.81]\n{CASE.format(contact=words)}", "utf-8")
    with pytest.raises(SystemExit) as ended:
        main(["kn", str(path), "--json"])
    assert not ended.value.code
    (pair,) = json.loads(capsys.readouterr().out)["pairs"].values()
    linear, hertz = pair["contacts"]["linear"], pair["contacts"]["hertz"]
    own = plan(parse_case(path.read_text(), name="x"))
    assert linear["c_t"] == own["linear"].between("ball", "floor").c_t > 0.0
    assert -1.0 < linear["e_t"] < 1.0
    assert linear["bond_number"] == 0.0
    weight = mass(own["hertz"].scene.spheres[0]) * 9.81
    assert hertz["bond_number"] == pytest.approx(own["hertz"].between("ball", "floor").pull_off() / weight, rel=1e-12)


def test_friction_without_its_spring_needs_a_dashpot() -> None:
    without = "[needs]\nhistory = false\n"
    with pytest.raises(CaseFileError, match="tangential_damping"):
        parse_case(CASE.format(contact="friction = 0.3") + without, name="x")
    with pytest.raises(CaseFileError, match="rolling_model"):
        parse_case(CASE.format(contact='tangential_damping = "liggghts"\nrolling_model = "epsd2"') + without, name="x")
    given = parse_case(CASE.format(contact='friction = 0.3\ntangential_damping = "liggghts"') + without, name="x")
    linear = plan(given)["linear"].between("ball", "floor")
    assert not linear.spring
    # a dashpot alone never turns the surface round
    e_t = linear.stick_restitution()
    assert e_t is not None
    assert -1.0 < e_t < 0.0
