"""Decks without a solver: what must be refused, what the numbers in a deck mean, and that it is safe text."""

from __future__ import annotations

import copy
import dataclasses
import math
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from models import with_bodies

from kncal import calibrate
from kncal.core.errors import InputError, RenderError, ValidityError
from kncal.core.shipped import folder as shipped_folder
from kncal.core.templating import NAME_PATTERN, checked_name, integer, number, render
from kncal.engines.liggghts.batch import Liggghts
from kncal.engines.liggghts.deck_tables import atom_types, contact_context, hertz_style
from kncal.physics.material import Material, pair
from kncal.scene.bodies import Particle, Vector, Wall
from kncal.scene.case_file import parse_case
from kncal.scene.contact import ContactChoice, PairChoice
from kncal.scene.model import Plan
from kncal.scene.plan import plan
from kncal.scene.run_control import RunControl
from kncal.scene.scene import Scene

GLASS = Material(young=5e7, poisson=0.25, density=2500.0, name="glass")
STEEL = Material(young=2e11, poisson=0.3, density=7800.0, name="steel")
DOWN = (0.0, 0.0, -1.0)


def bead(name: str, z: float, *, radius: float = 1e-3, material: Material = GLASS, v: Vector = DOWN) -> Particle:
    return Particle(name=name, material=material, radius=radius, position=(0.0, 0.0, z), velocity=v)


def scene(*particles: Particle, walls: tuple[Wall, ...] = (), **contact: Any) -> Scene:
    return Scene.of(
        name="test_scene",
        spheres=particles or (bead("a", 1.05e-3),),
        planes=walls if walls or len(particles) > 1 else (Wall(name="floor", axis="z", position=0.0),),
        contact=ContactChoice(**{"e_n": 0.9, "v_0": 1.0} | contact),
        run=RunControl(until_time=3e-4),
    )


def rendered(model: Plan, folder: Path, style: str = "hooke/stiffness") -> str:
    Liggghts(style).render(model, folder)
    return (folder / "in.liggghts").read_text(encoding="ascii")


def table(deck: str, name: str) -> np.ndarray:
    """The numbers of a property, as LIGGGHTS will read them: a matrix by types, or a vector."""
    joined = deck.replace("&\n", " ")
    line = re.search(rf"^fix +{name} all property/global {name} (\w+) (.*)$", joined, re.MULTILINE)
    assert line is not None, f"no property {name}"
    values = [float(word) for word in line[2].split()]
    if line[1] == "peratomtypepair":
        size = int(values[0])
        return np.array(values[1:]).reshape(size, size)
    return np.array(values)


@pytest.fixture(scope="module")
def models() -> dict[str, Plan]:
    return plan(scene())


# --- what the numbers mean -------------------------------------------------------------------------------------------


def test_linear_properties_are_the_models_numbers_and_symmetric(tmp_path: Path) -> None:
    both = scene(
        bead("a", 1.05e-3),
        bead("b", 8e-3, radius=3e-3, material=STEEL),
        walls=(Wall(name="floor", axis="z", position=0.0, material=STEEL),),
        pairs=(PairChoice(between=("a", "floor"), e_n=0.5),),
    )
    model = plan(both, ["linear"])["linear"]
    deck = rendered(model, tmp_path)
    kn, gamman = table(deck, "kn"), table(deck, "gamman_abs")
    types = {"a": 0, "b": 1, "floor": 2}
    assert np.array_equal(kn, kn.T)
    assert np.array_equal(gamman, gamman.T)
    for (one, two), contact in ((names, model.between(*names)) for names in (("a", "b"), ("a", "floor"))):
        assert kn[types[one], types[two]] == contact.k
        assert gamman[types[one], types[two]] == contact.c


def test_same_material_and_radius_share_a_type(tmp_path: Path) -> None:
    beads = [bead(f"b{i}", 1.05e-3 + 3e-3 * i) for i in range(5)]
    deck = rendered(plan(scene(*beads), ["linear"])["linear"], tmp_path)
    assert table(deck, "kn").shape == (1, 1)


def test_an_exception_makes_a_type_of_its_own(tmp_path: Path) -> None:
    beads = [bead(f"b{i}", 1.05e-3 + 3e-3 * i) for i in range(5)]
    choice = PairChoice(between=("b0", "b2"), e_n=0.4)
    model = plan(scene(*beads, pairs=(choice,)), ["linear"])["linear"]
    gamman = table(rendered(model, tmp_path), "gamman_abs")
    assert gamman.shape == (3, 3)  # b0, b2, and the others
    assert gamman[0, 2] == model.between("b0", "b2").c
    assert gamman[0, 1] == model.between("b0", "b1").c
    assert gamman[0, 2] > gamman[0, 1]


def test_pairs_that_never_meet_have_their_own_numbers(tmp_path: Path) -> None:
    both = scene(
        bead("small", 5e-3),
        bead("large", 40e-3, radius=1e-2, material=STEEL),
        walls=(Wall(name="w", axis="x", position=0.1),),
    )
    deck = rendered(plan(both, ["linear"])["linear"], tmp_path)
    kn, gamman = table(deck, "kn"), table(deck, "gamman_abs")
    for k, (material, radius) in enumerate(((GLASS, 1e-3), (STEEL, 1e-2))):
        alike = calibrate(pair(material, radius, material, radius), v_0=1.0, e_n=0.9)
        assert kn[k, k] == pytest.approx(alike.k_n, rel=1e-12)
        assert gamman[k, k] == pytest.approx(alike.eta_n, rel=1e-12)
    assert "NOT FOR FURTHER USE" not in deck


def test_a_pair_that_cannot_be_calibrated_and_never_meets_is_named(tmp_path: Path) -> None:
    # two rubber beads would overlap by more than their radius at this speed; rubber on steel does not
    rubber = Material(young=5e5, poisson=0.25, density=2500.0, name="rubber")
    one = scene(
        bead("soft", 1.5e-3, material=rubber, v=(0.0, 0.0, -3.0)),
        walls=(Wall(name="floor", axis="z", position=0.0, material=STEEL),),
        v_0=None,
        pairs=(PairChoice(between=("rubber", "rubber"), v_0=60.0),),
    )
    with pytest.raises(ValidityError):
        calibrate(pair(rubber, 1e-3, rubber, 1e-3), v_0=60.0, e_n=0.9)
    for kind, model in plan(one).items():
        (tmp_path / kind).mkdir()
        deck = rendered(model, tmp_path / kind)
        assert [line[:39] for line in deck.splitlines() if "NOT FOR FURTHER USE" in line] == [
            "# NOT FOR FURTHER USE: types 1 and 1 do"
        ]


def test_rigid_wall_leaves_the_particles_modulus(tmp_path: Path, models: dict[str, Plan]) -> None:
    deck = rendered(models["hertz"], tmp_path)
    young, poisson = table(deck, "youngsModulus"), table(deck, "poissonsRatio")
    E_eff = 1.0 / np.sum((1.0 - poisson**2) / young)
    assert E_eff == pytest.approx(GLASS.young / (1.0 - GLASS.poisson**2), rel=1e-15)
    assert "hard_particles yes" in deck


@pytest.mark.parametrize(("young", "switch"), [(1e6, "soft_particles yes"), (1e11, "hard_particles yes")])
def test_moduli_outside_the_usual_range_are_allowed_explicitly(tmp_path: Path, young: float, switch: str) -> None:
    material = Material(young=young, poisson=0.25, density=2500.0, name="grain")
    wall = Wall(name="floor", axis="z", position=0.0, material=material)
    deck = rendered(plan(scene(bead("a", 1.05e-3, material=material), walls=(wall,)), ["hertz"])["hertz"], tmp_path)
    assert [line for line in deck.splitlines() if line.endswith("_particles yes")] == [switch]


@pytest.mark.parametrize("end", ["overlap", "force"])
@pytest.mark.parametrize("e_n", [0.3, 0.7, 0.95, 1.0])
def test_restitution_of_the_hertz_deck_gives_the_models_damping(tmp_path: Path, end: str, e_n: float) -> None:
    model = plan(scene(e_n=e_n, end=end), ["hertz"])["hertz"]
    deck = rendered(model, tmp_path)
    e = table(deck, "coefficientRestitution")[0, 1]
    (contact,) = model.contacts.values()
    # LIGGGHTS' damping force over v, at any overlap
    beta, delta = math.log(e) / math.hypot(math.log(e), math.pi), 1e-5
    stiffness = 2.0 * contact.E_eff * math.sqrt(contact.R_eff * delta)
    damping = -2.0 * math.sqrt(5.0 / 6.0) * beta * math.sqrt(stiffness * contact.m_eff)
    assert damping == pytest.approx(contact.c * delta**0.25, rel=1e-12, abs=1e-300)
    assert ("limitForce on" in deck) == (end == "force")
    if end == "overlap" or e_n == 1.0:
        assert e == pytest.approx(e_n, rel=1e-12)
    else:
        assert e < e_n


def test_nothing_tangential_without_need_and_everything_with_it(tmp_path: Path) -> None:
    straight, oblique = tmp_path / "straight", tmp_path / "oblique"
    straight.mkdir()
    oblique.mkdir()
    deck = rendered(plan(scene(friction=0.3), ["linear"])["linear"], straight)
    assert "tangential off" in deck
    assert "coefficientFriction" not in deck
    slanted = scene(bead("a", 1.05e-3, v=(1.0, 0.0, -1.0)), friction=0.3)
    for kind, model in plan(slanted).items():
        (oblique / kind).mkdir()
        deck = rendered(model, oblique / kind)
        assert "tangential history" in deck
        assert "tangential_damping off" in deck
        assert np.all(table(deck, "coefficientFriction") == 0.3)
        if kind == "linear":
            assert table(deck, "kt")[0, 1] == model.between("a", "floor").k_t
            assert np.all(table(deck, "gammat_abs") == 0.0)


def test_allrun_is_executable(tmp_path: Path, models: dict[str, Plan]) -> None:
    Liggghts().render(models["linear"], tmp_path)
    assert os.access(tmp_path / "Allrun", os.X_OK)
    assert (tmp_path / "Allrun").read_bytes().startswith(b"#!/bin/sh\n")


# --- refusals --------------------------------------------------------------------------------------------------------


def altered(model: Plan, **change: Any) -> Plan:
    """The model with one number of its only contact replaced."""
    ((names, contact),) = model.contacts.items()
    return dataclasses.replace(model, contacts={names: dataclasses.replace(contact, **change)})


def unchecked(given: Scene, **values: Any) -> Scene:
    """The scene with values that it would refuse, put in behind its back."""
    changed = copy.copy(given)
    vars(changed).update(values)
    return changed


BAD = [math.nan, math.inf, -math.inf, -1.0]


@pytest.mark.parametrize("kind", ["linear", "hertz"])
@pytest.mark.parametrize(
    ("field", "value"),
    [("k", 0.0)]
    + [(field, bad) for field in ("k", "c", "m_eff", "friction", "k_t", "rolling_friction") for bad in BAD],
)
def test_bad_contact_numbers_never_reach_a_deck(
    tmp_path: Path, models: dict[str, Plan], kind: str, field: str, value: float
) -> None:
    with pytest.raises(RenderError, match=f"pair a, floor: {field} = "):
        Liggghts().render(altered(models[kind], **{field: value}), tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "change",
    [{"dt": bad} for bad in [0.0, *BAD]]
    + [{"n_steps": 0}, {"n_steps": 2**31}, {"record_every": 0}, {"flight_every": 0}, {"contacts": {}}],
)
def test_bad_run_numbers_never_reach_a_deck(tmp_path: Path, models: dict[str, Plan], change: dict[str, Any]) -> None:
    with pytest.raises(RenderError, match="test_scene"):
        Liggghts().render(dataclasses.replace(models["linear"], **change), tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("field", ["position", "velocity", "spin"])
@pytest.mark.parametrize("value", [math.nan, math.inf, "0.0\nshell touch ran", None])
def test_bad_vectors_never_reach_a_deck(tmp_path: Path, models: dict[str, Plan], field: str, value: Any) -> None:
    model = models["linear"]
    (particle,) = model.scene.spheres
    start = dataclasses.replace(particle, **{field: (0.0, value, 1.05e-3)})
    with pytest.raises(InputError, match=field):
        with_bodies(model.scene, spheres=(start,))
    with pytest.raises(RenderError, match=f"{field} = "):
        Liggghts().render(dataclasses.replace(model, scene=unchecked(model.scene, spheres=(start,))), tmp_path)
    assert not list(tmp_path.iterdir())


HOSTILE = [
    "a\nshell touch ran",
    "a&",
    "a; shell",
    'a"b',
    "a'b",
    "$a",
    "a b",
    "a\u2028b",
    "a\r",
    "a\n",
    "-a",
    ".a",
    "",
    "é",
    "a" * 65,
    "a\x00",
    "a#b",
    "{{ 7 }}",
]


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("where", ["scene", "particle", "wall"])
def test_hostile_names_never_reach_a_deck(tmp_path: Path, models: dict[str, Plan], where: str, name: str) -> None:
    model = models["linear"]
    (particle,), (wall,) = model.scene.spheres, model.scene.planes
    names = {"scene": "s", "particle": "p", "wall": "w"} | {where: name}
    bodies: dict[str, Any] = {
        "name": names["scene"],
        "spheres": (dataclasses.replace(particle, name=names["particle"]),),
        "planes": (dataclasses.replace(wall, name=names["wall"]),),
    }
    with pytest.raises(InputError, match="expected a name"):
        with_bodies(model.scene, **bodies)
    with pytest.raises(RenderError, match="rename it"):
        Liggghts().render(dataclasses.replace(model, scene=unchecked(model.scene, **bodies)), tmp_path)
    assert not list(tmp_path.iterdir())


def test_free_text_of_the_case_stays_out_of_the_deck(tmp_path: Path) -> None:
    said = "a title & more\nshell touch ran"
    with pytest.raises(InputError, match="one line"):
        dataclasses.replace(scene(), title=said)
    talkative = unchecked(scene(), title=said, source=said)
    deck = rendered(plan(talkative, ["linear"])["linear"], tmp_path)
    assert "shell" not in deck
    assert "title" not in deck


def test_centres_in_one_place_are_refused(tmp_path: Path, models: dict[str, Plan]) -> None:
    model = models["linear"]
    (particle,) = model.scene.spheres
    moved = dataclasses.replace(particle, position=(0.0, 0.0, 0.0))
    where = with_bodies(model.scene, spheres=(moved,))
    with pytest.raises(RenderError, match="centre in the same place"):
        Liggghts().render(dataclasses.replace(model, scene=where), tmp_path)


@pytest.mark.parametrize(("e_n", "end"), [(0.05, "overlap"), (0.02, "overlap"), (0.12, "force")])
def test_more_damping_than_liggghts_has_names_the_pair_and_the_way_out(tmp_path: Path, e_n: float, end: str) -> None:
    model = plan(scene(e_n=e_n, end=end, method="max_overlap"), ["hertz"])["hertz"]
    with pytest.raises(RenderError, match=r"pair a, floor: .*larger e_n.*builtin"):
        Liggghts().render(model, tmp_path)


def test_a_law_that_liggghts_does_not_have_is_sent_to_the_builtin_engine(tmp_path: Path) -> None:
    written = plan(scene(law="hunt_crossley"), ["hertz"])["hertz"]
    with pytest.raises(RenderError, match=r"hunt_crossley.*builtin"):
        Liggghts().render(written, tmp_path)


def test_a_stiffness_that_liggghts_would_not_take_is_refused(tmp_path: Path, models: dict[str, Plan]) -> None:
    (contact,) = models["hertz"].contacts.values()
    with pytest.raises(RenderError, match="k = "):
        Liggghts().render(altered(models["hertz"], k=contact.k * 1.001), tmp_path)


def test_hooke_is_only_for_strain_energy(tmp_path: Path, models: dict[str, Plan]) -> None:
    with pytest.raises(RenderError, match="strain_energy"):
        Liggghts("hooke").render(models["linear"], tmp_path)
    model = plan(scene(method="strain_energy"), ["linear"])["linear"]
    assert table(rendered(model, tmp_path, "hooke"), "characteristicVelocity") == [1.0]


def test_hooke_refuses_another_stiffness_and_two_speeds(tmp_path: Path) -> None:
    model = plan(scene(method="strain_energy"), ["linear"])["linear"]
    (contact,) = model.contacts.values()
    with pytest.raises(RenderError, match="k = "):
        Liggghts("hooke").render(altered(model, k=1.01 * contact.k), tmp_path)
    two = scene(
        bead("a", 1.05e-3),
        bead("b", 4e-3),
        walls=(Wall(name="floor", axis="z", position=0.0),),
        method="strain_energy",
        pairs=(PairChoice(between=("a", "b"), v_0=2.0),),
    )
    with pytest.raises(RenderError, match="one characteristicVelocity"):
        Liggghts("hooke").render(plan(two, ["linear"])["linear"], tmp_path)


def test_unknown_style_is_refused() -> None:
    with pytest.raises(InputError, match="linear_style"):
        Liggghts("hooke/stiff")


# --- the filters -----------------------------------------------------------------------------------------------------


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_number_reads_back_exactly(value: float) -> None:
    assert float(number(value)) == value
    assert number(np.float64(value)) == number(value)


@pytest.mark.parametrize("value", [math.nan, math.inf, "1.0", True, None, 1j, [1.0], 10**400, np.nan, b"1"])
def test_everything_else_is_no_number(value: object) -> None:
    with pytest.raises(RenderError):
        number(value)


@given(st.text())
def test_a_name_is_returned_unchanged_or_refused(text: str) -> None:
    if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}", text, re.ASCII):
        assert checked_name(text) == text
    else:
        with pytest.raises(RenderError):
            checked_name(text)


@given(st.from_regex(NAME_PATTERN, fullmatch=True))
def test_names_that_match_pass(text: str) -> None:
    assert checked_name(text) == text


@pytest.mark.parametrize("value", [-1, 1.0, True, "1", None])
def test_only_whole_numbers_count(value: object) -> None:
    with pytest.raises(RenderError):
        integer(value)


@pytest.mark.parametrize(
    "template",
    ["{{ missing }}", "{{ ''.__class__.__mro__ }}", "{{ x|num }}", "{% if %}", "{{ ''|attr('__class__') }}"],
)
def test_templates_cannot_reach_beyond_their_context(tmp_path: Path, template: str) -> None:
    (tmp_path / "t.j2").write_text(template, encoding="utf-8")
    with pytest.raises(RenderError):
        render(tmp_path, "t.j2", {"x": "1; shell"})


def test_missing_template_is_named() -> None:
    with pytest.raises(RenderError, match=r"nothing\.j2"):
        render(shipped_folder("templates"), "nothing.j2", {})


ROUGH_BASE = """
gravity = [0.0, 0.0, -9.81]
[materials.glass]
young = 5e6
poisson = 0.3
density = 2500
[particles.base]
material = "glass"
diameter = 2e-3
frozen = true
positions = [[0.01, 0.01, 1e-3], [0.014, 0.01, 1e-3]]
[particles.beads]
material = "glass"
diameter = 1e-3
positions = [[0.01, 0.01, 4e-3], [0.014, 0.01, 4e-3]]
[walls.box]
shape = "box"
material = "glass"
size = [0.02, 0.02, 0.02]
[contact]
e_n = 0.8
v_0 = 0.3
law = "{law}"
friction = 0.3
[run]
until_time = 0.01
sample_every = 1e-3
"""


@pytest.mark.parametrize("law", ["tsuji", "kuwabara_kono"])
def test_a_frozen_sphere_is_as_heavy_as_a_wall(law: str) -> None:
    made = plan(parse_case(ROUGH_BASE.format(law=law), name="chute"))["hertz"]
    types = atom_types(made.species)
    style = hertz_style(made.contacts.values())
    context = contact_context("chute", types, made.contacts, style, unmet=made.unmet)
    assert (style == "hertz/stiffness") == (law == "kuwabara_kono")
    base, bead = (next(i for i, t in enumerate(types) if t.name.startswith(name)) for name in ("base", "beads"))
    contact = made.contacts[base, bead]
    assert contact.m_eff == pytest.approx(2500 * math.pi / 6.0 * 1e-3**3, rel=1e-12)
    assert types[base].held
    assert style in str(context["selectors"])
