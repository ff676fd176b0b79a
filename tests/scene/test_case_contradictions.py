"""Case files whose values contradict each other, or that would run as something else than they say."""

from __future__ import annotations

from dataclasses import replace

import pytest

from kncal.core.errors import CaseFileError, InputError
from kncal.physics.material import Material
from kncal.scene.bodies import Particle, Wall
from kncal.scene.case_file import MOST_BYTES, dump_case, parse_case
from kncal.scene.run_control import RunControl
from kncal.scene.scene import Scene

ROW = """\
[materials.glass]
young = 5e7
poisson = 0.25
density = 2500.0

[particles.row]
material = "glass"
diameter = 0.002
positions = [[0.0, 0.0, 0.0011], [0.0, 0.0, 0.0032]]
velocity = [0.0, 0.0, -0.5]

[walls.floor]
axis = "z"
position = 0.0
material = "rigid"

[run]
until_time = 2e-3
"""
BED = """\
gravity = [0.0, 0.0, -9.81]
periodic = ["y"]

[materials.soft]
young = 5e6
poisson = 0.3
density = 1000.0

[particles.beads]
material = "soft"
diameter = 1e-3
positions = [[0.005, 0.002, 0.005], [0.005, 0.004, 0.005]]

[walls.column]
shape = "box"
size = [0.01, 0.006, 0.02]

[contact]
v_0 = 0.2

[run]
until_time = 0.01
coupling = 1e-3
"""


def refused(text: str) -> str:
    with pytest.raises(CaseFileError) as caught:
        parse_case(text, name="sample", where="case.toml")
    return str(caught.value)


def changed(text: str, old: str, new: str) -> str:
    assert text.count(old) == 1
    return text.replace(old, new)


def test_the_samples_are_good() -> None:
    assert len(parse_case(ROW, name="row").spheres) == 2
    assert parse_case(BED, name="bed").number == 2


@pytest.mark.parametrize("header", ['[particles."row.1"]', '[walls."row.2"]', '[materials."row.1"]'])
def test_no_other_name_is_that_of_a_particle_of_a_group(header: str) -> None:
    tables = {
        "particles": "material = 'glass'\ndiameter = 1e-3\nposition = [1.0, 0.0, 1.0]\n",
        "walls": "axis = 'x'\nposition = -1.0\nmaterial = 'rigid'\n",
    }
    tables["materials"] = "young = 1e7\npoisson = 0.3\ndensity = 1e3\n"
    message = refused(f"{header}\n{tables[header[1:].partition('.')[0]]}\n{ROW}")
    assert "row." in message
    assert "a name of its own" in message


def test_the_names_of_the_particles_of_a_group_are_names() -> None:
    assert "at most 61 letters" in refused(changed(ROW, "[particles.row]", f"[particles.{'r' * 64}]"))


@pytest.mark.parametrize(
    ("text", "old", "new", "key"),
    [
        (ROW, "velocity =", "count = 5\nvelocity =", "particles.row.count"),
        (ROW, "velocity =", "count = 0\nvelocity =", "particles.row.count"),
        (ROW, "velocity =", "seed = 7\nvelocity =", "particles.row.seed"),
        (ROW, "velocity =", "position = [0.0, 0.0, 0.0]\nvelocity =", "particles.row.position"),
        (BED, "diameter =", "position = [0.005, 0.001, 0.005]\ndiameter =", "particles.beads.position"),
        (BED, "positions = [[0.005, 0.002, 0.005], [0.005, 0.004, 0.005]]", "", "particles.beads.count"),
        (BED, "[0.005, 0.002, 0.005], [0.005, 0.004", "[0.005, 1e-6, 0.005], [0.005, 5.999e-3", "positions[1]"),
        (BED, "diameter =", "frozen = true\ndiameter =", "particles.beads.frozen"),
        (ROW, "until_time", "dt = 1e160\nuntil_time", "run.dt"),
        (ROW, "[run]", "[walls.plate]\nshape = 3\n[run]", "walls.plate.shape"),
    ],
)
def test_what_would_be_ignored_is_refused_at_its_key(text: str, old: str, new: str, key: str) -> None:
    message = refused(changed(text, old, new))
    assert key in message
    assert "expected" in message


def test_a_wall_that_is_no_table_is_told_so() -> None:
    for wall in ("[walls]\nplate = 3", "[[walls.plate]]\nposition = 0.0"):
        assert "expected a table" in refused(f"{wall}\n{ROW.replace('[walls.floor]', '[walls_floor]')}")


def test_many_particles_in_one_place_are_refused_without_looking_at_pairs() -> None:
    """Their pairs are 8 million."""
    positions = "positions = [" + "[0.0, 0.0, 1.0], " * 4000 + "]"
    rows = refused(changed(ROW, "positions = [[0.0, 0.0, 0.0011], [0.0, 0.0, 0.0032]]", positions)).splitlines()
    assert ["4000 particles" in row for row in rows] == [True]


@pytest.mark.parametrize("value", ["1" + "0" * 400, "1e400", "inf"])
def test_a_gravity_that_is_no_number_is_no_old_file(value: str) -> None:
    assert "kncal 0.1" not in refused(f"gravity = {value}\n{ROW}")


def test_a_group_may_be_called_as_a_key_is() -> None:
    scene = parse_case(ROW.replace("particles.row", "particles.diameter"), name="x")
    assert scene.spheres[1].name == "diameter.2"


def test_a_title_and_a_comment_may_have_many_dots() -> None:
    dots = ".".join(map(str, range(30)))
    assert parse_case(f'title = "{dots}"\n# {dots}\n{ROW}', name="x").title == dots


def test_a_choice_of_numbers_is_listed() -> None:
    gas = "[gas]\ncells = [2, 1, 4]\ndensity = 1.2\nviscosity = 1.8e-5\nparcels_per_particle = 4\n\n[contact]"
    assert "expected one of 1, 8, 27" in refused(changed(BED, "[contact]", gas))


def test_a_fault_is_told_once() -> None:
    assert len(refused(changed(ROW, "velocity = [0.0, 0.0, -0.5]", "velocity = [0.0]")).splitlines()) == 1
    assert len(refused(f"{ROW}\n[contact.options]\nk = true\n").splitlines()) == 1


def test_no_number_is_minus_zero() -> None:
    scene = parse_case(changed(ROW, "velocity = [0.0, 0.0, -0.5]", "velocity = [-0.0, 0.0, -0.5]"), name="x")
    assert str(scene.spheres[0].velocity[0]) == "0.0"


def test_a_scene_made_of_bodies_loses_none_of_them() -> None:
    glass = Material(name="glass", young=5e7, poisson=0.25, density=2500.0)
    ball = Particle(name="ball", material=glass, radius=1e-3, position=(0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="'ball'"):
        Scene.of((ball, replace(ball, position=(0.1, 0.0, 0.0))), name="twins")
    hard = Wall(name="floor", axis="z", position=0.0, material=replace(glass, name="rigid"))
    with pytest.raises(InputError, match="rigid"):
        Scene.of((ball,), (hard,), name="rigid")


def test_an_unknown_material_is_named() -> None:
    scene = parse_case(ROW, name="x")
    wrong = replace(scene, particles={"row": replace(scene.particles["row"], material="gold")})
    with pytest.raises(InputError, match="gold"):
        _ = wrong.spheres


def test_a_scene_too_large_for_a_case_file_is_not_written() -> None:
    bed = parse_case(BED, name="bed")
    grid = tuple((5e-4 * (i + 1), 1e-3, 1e-3 * (k + 1)) for k in range(450) for i in range(10))
    large = replace(
        bed.with_box(size=(0.01, 0.006, 1.0)).with_group(positions=grid, diameter=2e-4),
        run=RunControl(until_time=0.01, coupling=1e-3),
    )
    assert len(str(grid)) < MOST_BYTES
    digits = tuple((x + 1e-5 / 3.0, y + 1e-5 / 3.0, z + 1e-5 / 3.0) for x, y, z in grid)
    with pytest.raises(InputError, match="bytes"):
        dump_case(large.with_group(positions=digits))
