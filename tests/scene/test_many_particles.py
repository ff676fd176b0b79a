"""Scenes of many particles without gas: groups, sizes, regions, walls of any shape, files of the case, their start."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from kncal.core.errors import CaseFileError, InputError
from kncal.engines.settle import to_settle
from kncal.scene.case_file import FILES, dump_case, identity_text, kept_identity, load_case, parse_case, write_case
from kncal.scene.limits import check
from kncal.scene.model import KINDS
from kncal.scene.needs import decide
from kncal.scene.plan import plan
from kncal.scene.scene import Scene
from kncal.scene.shapes import distance_to
from kncal.scene.start import start_of

HEAD = """
gravity = [0.0, 0.0, -9.81]
materials.glass = {young = 5e6, poisson = 0.3, density = 2500}
materials.steel = {young = 5e7, poisson = 0.3, density = 7800}
contact = {e_n = 0.5, v_0 = 0.3, friction = 0.5}
run = {until_time = 0.1, sample_every = 1e-3}
"""
CONE = """
[walls.cone]
shape = "cone"
material = "steel"
radius_low = 0.01
radius_high = 0.03
low = 0.0
high = 0.03
"""
BEADS = """
[particles.beads]
material = "glass"
sizes = {shares = [[2e-3, 0.25], [3e-3, 0.75]], by = "number"}
count = 401
place = "lattice"
region = {shape = "cylinder", radius = 0.02, low = 0.02, high = 0.2}
"""


def scene(text: str = CONE + BEADS, head: str = HEAD, folder: Path | None = None) -> Scene:
    return parse_case(head + text, name="many", folder=folder)


def test_a_group_of_sizes_has_classes_that_add_up() -> None:
    made = scene()
    assert [(c.name, c.group, c.diameter) for c in made.classes] == [
        ("beads.1", "beads", 2e-3),
        ("beads.2", "beads", 3e-3),
    ]
    assert made.number == 401
    assert abs(made.classes[0].number - 100.25) < 1.0
    d, n = np.array([(c.diameter, c.number) for c in made.classes]).T
    assert made.diameter == pytest.approx((n * d**3).sum() / (n * d**2).sum(), rel=1e-14)
    assert made.mass == pytest.approx(2500 * np.pi / 6.0 * (n * d**3).sum(), rel=1e-14)


@pytest.mark.parametrize(
    ("key", "volume"), [("mass = 0.05", 0.05 / 2500), ("fill = 0.2", 0.2 * np.pi * 0.02**2 * 0.18)]
)
def test_a_mass_or_a_share_of_the_region_is_met_within_half_a_particle(key: str, volume: float) -> None:
    made = scene(CONE + BEADS.replace("count = 401", key))
    assert abs(made.volume - volume) < np.pi / 6.0 * 3e-3**3


def test_particles_start_in_their_region_clear_of_walls_and_of_each_other() -> None:
    made = scene()
    start = start_of(made)
    radii = 0.5 * np.array([c.diameter for c in made.classes])[start.kind]
    region = made.particles["beads"].region
    assert region is not None
    assert region.inside(start.x, radii * (1.0 - 1e-12)).all()
    assert (distance_to(made.walls["cone"], start.x, path_of=made.path_of) >= radii * (1.0 - 1e-12)).all()
    for i, j in cKDTree(start.x).query_pairs(3e-3):
        assert np.linalg.norm(start.x[i] - start.x[j]) >= radii[i] + radii[j] - 1e-15
    assert np.bincount(start.kind).tolist() == [c.number for c in made.classes]
    again = start_of(replace(made, name="other"))
    assert np.array_equal(again.x, start.x)


def test_every_pair_of_sizes_and_walls_has_a_contact_of_its_own_e_n() -> None:
    made = scene()
    for kind in KINDS:
        model = plan(made, (kind,))[kind]
        assert set(model.named) == {
            ("beads.1", "beads.1"), ("beads.1", "beads.2"), ("beads.2", "beads.2"),
            ("beads.1", "cone"), ("beads.2", "cone"),
        }  # fmt: skip
        assert all(c.e_n == 0.5 for c in model.contacts.values())
        masses = {pair: c.m_eff for pair, c in model.named.items()}
        m = [2500 * np.pi / 6.0 * c.diameter**3 for c in made.classes]
        assert masses["beads.1", "beads.2"] == pytest.approx(m[0] * m[1] / (m[0] + m[1]), rel=1e-12)
        assert masses["beads.2", "cone"] == pytest.approx(m[1], rel=1e-12)


def test_two_groups_of_one_kind_stay_apart() -> None:
    other = BEADS.replace("particles.beads", "particles.more").replace("high = 0.2}", "high = 0.4}")
    made = scene(CONE + BEADS + other)
    assert [c.group for c in made.classes] == ["beads", "beads", "more", "more"]
    model = plan(made, ("linear",))["linear"]
    assert len(model.species.members) == 5
    assert [bodies[0].name for bodies in model.species.members[:4]] == [c.name for c in made.classes]


def test_what_changes_during_a_run_is_an_event() -> None:
    motion = 'motion = [{kind = "rotate", axis = [0.0, 0.0, 1.0], period = 1.0, start = 0.02, stop = 0.05}]\n'
    made = scene(CONE + motion + "remove_at = 0.03\n" + BEADS)
    assert [(e.time, e.what, e.wall) for e in made.events] == [
        (0.02, "start", "cone"), (0.03, "remove", "cone"), (0.05, "stop", "cone"),
    ]  # fmt: skip
    needs = decide(made)
    assert needs.uses("wall_motion")
    assert needs.uses("wall_removal")
    assert not needs.uses("insertion")


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("count = 401", "count = 401\nmass = 0.1", "particles.beads"),
        ("count = 401", "", "particles.beads"),
        ("count = 401", "count = 401\nrate = 0.1", "particles.beads.rate"),
        ("count = 401", "count = 401\ndiameter = 1e-3", "particles.beads.diameter"),
        ('"lattice"', '"stream"', "particles.beads.rate"),
        ('"lattice"', '"given"', "particles.beads"),
        ("low = 0.02,", "low = 0.3,", "particles.beads.region"),
        ("v_0 = 0.3", "v_0 = 0.3", "periodic"),
        ("sample_every = 1e-3", "sample_every = 1.0", "run.sample_every"),
        ("sample_every = 1e-3", "sample_every = 1e-3, coupling = 1e-3", "run.sample_every"),
        ("radius_high = 0.03", "radius_high = 0.01", "walls.cone.radius_high"),
    ],
)
def test_contradictions_name_their_key(old: str, new: str, key: str) -> None:
    text = HEAD + CONE + BEADS
    assert old in text
    if key == "periodic":
        text = 'periodic = ["x"]\n' + text
    with pytest.raises(CaseFileError) as told:
        parse_case(text.replace(old, new), name="many")
    assert key in str(told.value)


def test_given_particles_may_not_be_in_one_place_nor_outside() -> None:
    given = BEADS[: BEADS.index("sizes")] + "diameter = 2e-3\npositions = [[0.0, 0.0, 0.05], [0.0, 0.0, 0.0505]]\n"
    with pytest.raises(InputError, match="one another"):
        start_of(scene(CONE + given))
    box = "[domain]\nlow = [-0.1, -0.1, -0.1]\nhigh = [0.1, 0.1, 0.05]\n"
    with pytest.raises(InputError, match="outside the domain"):
        start_of(scene(CONE + given.replace("0.0505", "0.07") + box))


def test_files_of_a_case_go_with_it(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    (tmp_path / "a" / "beads.csv").write_text("x,y,z,diameter\n0,0,0.05,0.002\n0,0,0.06,0.003\n")
    group = '[particles.beads]\nmaterial = "glass"\nfile = "beads.csv"\n'
    made = scene(CONE + group, folder=tmp_path / "a")
    assert made.number == 2
    assert [c.diameter for c in made.classes] == [2e-3, 3e-3]
    write_case(made, tmp_path / "b" / "case.toml")
    assert (tmp_path / "b" / FILES / "beads.csv").is_file()
    back = load_case(tmp_path / "b", name="many")
    assert back == made
    assert np.array_equal(start_of(back).x, start_of(made).x)
    assert kept_identity(tmp_path / "b") == identity_text(made)
    (tmp_path / "a" / "beads.csv").write_text("x,y,z,diameter\n0,0,0.05,0.002\n0,0,0.061,0.003\n")
    assert kept_identity(tmp_path / "b") != identity_text(made)  # the same text, another content
    assert dump_case(made) == dump_case(back)


@pytest.mark.parametrize("name", ["../beads.csv", "/etc/passwd", "nothing.csv", "link.csv"])
def test_a_case_names_no_file_outside_of_its_folder(name: str, tmp_path: Path) -> None:
    (tmp_path / "case").mkdir()
    (tmp_path / "beads.csv").write_text("x,y,z,diameter\n0,0,0.05,0.002\n")
    (tmp_path / "case" / "link.csv").symlink_to(tmp_path / "beads.csv")
    group = f'[particles.beads]\nmaterial = "glass"\nfile = "{name}"\n'
    with pytest.raises(CaseFileError, match="file"):
        scene(CONE + group, folder=tmp_path / "case")


def test_a_frozen_particle_has_no_finite_mass_for_those_that_move() -> None:
    base = (
        BEADS.replace("particles.beads", "particles.base").replace("low = 0.02,", "low = 0.21,").replace("0.2}", "0.3}")
    )
    made = scene(CONE + BEADS + base + "frozen = true\n")
    contacts = plan(made, ("linear",))["linear"].named
    m = 2500 * np.pi / 6.0 * 3e-3**3
    assert contacts["beads.2", "base.2"].m_eff == pytest.approx(m, rel=1e-12)
    assert contacts["beads.2", "beads.2"].m_eff == pytest.approx(m / 2.0, rel=1e-12)
    assert contacts["beads.2", "base.2"].R_eff == contacts["beads.2", "beads.2"].R_eff
    with pytest.raises(CaseFileError, match="frozen"):
        scene(CONE + BEADS + "frozen = true\n")


def test_a_fall_that_a_soft_contact_cannot_take_is_said_before_the_run() -> None:
    """The overlap of a linear contact is v sqrt(m_eff/k_n) without damping."""
    soft = HEAD.replace("e_n = 0.5", "e_n = 1.0").replace("v_0 = 0.3", "v_0 = 0.3, k_n = 20.0")
    made = scene(head=soft)
    model = plan(made, ("linear",))["linear"]
    low, high = made.extent
    speed = np.sqrt(2.0 * 9.81 * (high - low)[2])
    heavy = max(model.named.values(), key=lambda c: c.m_eff)
    share = speed * np.sqrt(heavy.m_eff / 20.0) / 1e-3
    (found,) = (f for f in check(model) if f.code == "fast-impact")
    assert f"{speed:.3g} m/s" in found.message
    assert f"{share:.2g} of the smallest" in found.message


@pytest.mark.parametrize(("rate", "refused"), [(0.05, False), (5.0, True)])
def test_a_stream_denser_than_particles_can_be_inserted_is_refused(rate: float, refused: bool) -> None:
    flowing = f'place = "stream"\nrate = {rate}\nvelocity = [0.0, 0.0, -0.5]'
    made = scene(CONE + BEADS.replace('place = "lattice"', flowing))
    found = [f for f in check(plan(made, ("linear",))["linear"]) if f.code == "stream-dense"]
    assert bool(found) == refused


def test_particles_that_start_in_a_wall_are_refused_at_its_name() -> None:
    """Not those at a periodic side of a box, where it has none, and not those that cannot move."""
    bead = '[particles.bead]\nmaterial = "glass"\ndiameter = 2e-3\nposition = [0.0004, 0.005, 0.005]\n'
    box = '[walls.box]\nshape = "box"\nsize = [0.01, 0.01, 0.01]\n'
    with pytest.raises(InputError, match=r"walls\.box by more than half"):
        start_of(scene(bead + box))
    assert len(start_of(scene(bead.replace("0.0004", "0.0006") + box)).x) == 1
    assert len(start_of(scene(bead + box, head='periodic = ["x"]\n' + HEAD)).x) == 1


def test_a_size_without_any_particle_makes_no_contact() -> None:
    made = scene(
        CONE + BEADS.replace("[2e-3, 0.25], [3e-3, 0.75]", "[2e-3, 0.001], [3e-3, 0.999]").replace("401", "10")
    )
    assert [(c.name, c.number) for c in made.classes] == [("beads.2", 10)]
    assert made.d_min == 3e-3
    for empty in ("count = 0", "mass = 1e-9"):
        with pytest.raises(CaseFileError, match=r"particles\.beads"):
            scene(CONE + BEADS.replace("count = 401", empty))


def test_those_that_have_settled_keep_their_kind_and_others_join_them_as_the_case_says() -> None:
    ball = '[particles.ball]\nmaterial = "steel"\ndiameter = 4e-3\nposition = [0.0, 0.0, 0.19]\n'
    ball += "velocity = [0.0, 0.0, -2.0]\n"
    rain = BEADS.replace("particles.beads", "particles.rain").replace('"lattice"', '"stream"\nrate = 0.01')
    bed = BEADS.replace("particles.beads", "particles.bed").replace('"lattice"', '"settled"')
    made = scene(CONE + rain + ball + bed)
    settling = to_settle(made)
    assert list(settling.particles) == ["bed"]
    placed = start_of(settling)
    first = next(i for i, c in enumerate(made.classes) if c.group == "bed")
    whole = start_of(made, replace(placed, kind=placed.kind + first))
    names = [made.classes[k].group for k in whole.kind]
    assert names == ["ball"] + ["bed"] * 401
    assert whole.v[0].tolist() == [0.0, 0.0, -2.0]
    assert np.array_equal(whole.x[1:], placed.x)
    with pytest.raises(CaseFileError, match="velocity"):
        scene(CONE + bed + "velocity = [0.1, 0.0, 0.0]\n")


def test_a_stream_may_not_begin_in_a_wall_and_a_box_fills_its_period() -> None:
    flowing = BEADS.replace('"lattice"', '"stream"\nrate = 0.01').replace("low = 0.02,", "low = {low},")
    for low, hit in (("0.035", False), ("0.005", True)):
        made = scene(CONE + flowing.replace("{low}", low))
        found = [f for f in check(plan(made, ("linear",))["linear"]) if f.code == "stream-wall"]
        assert bool(found) == hit
    box = '[walls.box]\nshape = "box"\nsize = [0.04, 0.05, 0.3]\nmaterial = "steel"\n'
    domain = "[domain]\nlow = [-0.03, -0.01, -0.01]\nhigh = [0.03, 0.06, 0.31]\n"
    with pytest.raises(CaseFileError, match=r"walls\.box\.size"):
        scene('periodic = ["x"]\n' + HEAD + box + domain + BEADS, head="")


PLANE = '[walls.{}]\naxis = "z"\nposition = 0.0\nmaterial = "steel"\n'


@pytest.mark.parametrize(
    ("text", "key"),
    [
        (PLANE.format("a") + PLANE.format("b"), "walls.b"),
        (PLANE.format("a") + "surface_velocity = [0.1, 0.0, 1.0]\n", "walls.a"),
        ("[outlets.beads]\nposition = -0.01\n", "outlets.beads"),
        (PLANE.format('"beads.1"'), "particles.beads"),
    ],
)
def test_what_is_there_twice_is_refused(text: str, key: str) -> None:
    with pytest.raises(CaseFileError, match=key.replace(".", r"\.")):
        scene(CONE + BEADS + text)


def test_what_lies_outside_of_the_domain_is_refused() -> None:
    domain = "[domain]\nlow = [-0.05, -0.05, -0.05]\nhigh = [0.05, 0.05, 0.25]\n"
    with pytest.raises(CaseFileError, match=r"outlets\.out\.position"):
        scene(CONE + BEADS + domain + "[outlets.out]\nposition = -0.06\n")
    made = scene(CONE + BEADS + domain + PLANE.format("far").replace("0.0", "1.0"))
    assert [f.level for f in check(plan(made, ("linear",))["linear"]) if f.code == "wall-outside"] == ["refuse"]
    still = BEADS.replace('"lattice"', '"stream"\nrate = 0.01')
    made = scene(CONE + still, head=HEAD.replace("-9.81", "0.0"))
    assert [f.code for f in check(plan(made, ("linear",))["linear"]) if f.level == "refuse"] == ["stream-dense"]


def test_particles_larger_than_their_region_are_refused() -> None:
    with pytest.raises(CaseFileError, match=r"particles\.beads\.sizes"):
        scene(CONE + BEADS.replace("3e-3", "3.0"))
