"""The case file: what it refuses, and in which words: where, what, what was expected."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sample_case import GOOD, changed, refused

from kncal.core.errors import CaseFileError, KncalError
from kncal.scene.case_file import MOST_BYTES, dump_case, load_case, parse_case
from kncal.scene.scene import Scene

HOSTILE = ["a\nshell", "a&", "a;b", "$a", "a'b", 'a"b', "a\u2028b", "../a", "/a", "a b", "", "-a", ".a", "é", "a" * 65]


@pytest.mark.parametrize("bad", HOSTILE)
def test_hostile_names(bad: str) -> None:
    import json

    quoted = json.dumps(bad)
    for kind, name in (("particles", "b"), ("walls", "floor")):
        message = refused(changed(f"[{kind}.{name}]", f"[{kind}.{quoted}]"))
        assert kind in message
        assert "expected a name of 1 to 64 letters" in message
        assert re.search(r", line \d+: ", message)
    message = refused(changed("[materials.glass]", f"[materials.{quoted}]"))
    assert "expected a name of 1 to 64 letters" in message
    message = refused(changed("friction = 0.3", f"[contact.options]\n{quoted} = 1.0"))
    assert "contact.options" in message
    with pytest.raises(CaseFileError, match="name of the case"):
        parse_case(GOOD, name=bad)


@pytest.mark.parametrize(("kind", "most"), [("particles", 100), ("walls", 20), ("contact.pairs", 200)])
def test_more_bodies_than_a_scene_may_have_are_refused_with_the_number(kind: str, most: int) -> None:
    rows = {
        "particles": '[particles.p{i}]\nmaterial = "glass"\ndiameter = 0.1\nposition = [0, {i}, 1]\n',
        "walls": '[walls.w{i}]\naxis = "x"\nposition = {i}.5\nmaterial = "rigid"\n',
        "contact.pairs": '[[contact.pairs]]\nbetween = ["glass", "rigid"]\ne_n = 0.5\n',
    }

    def number(scene: Scene) -> int:
        return len({"particles": scene.particles, "walls": scene.walls, "contact.pairs": scene.contact.pairs}[kind])

    more = "".join(rows[kind].replace("{i}", str(i)) for i in range(most - number(parse_case(GOOD, name="sample"))))
    assert number(parse_case(GOOD + more, name="sample")) == most
    message = refused(GOOD + more + rows[kind].replace("{i}", str(most)))
    assert f"{kind} = " in message
    assert f"{most + 1} entries" in message
    assert f"expected at most {most}" in message


def test_particles_of_a_group_count_one_by_one() -> None:
    rows = "".join(f"[0, {i}, 1], " for i in range(100))
    group = f'[particles.row]\nmaterial = "glass"\ndiameter = 0.1\npositions = [{rows}]\n'
    assert "102 particles" in refused(GOOD + group)
    scene = parse_case(
        GOOD + group.replace("[0, 99, 1], [0, 98, 1], ", "").replace("[0, 0, 1], [0, 1, 1], ", ""), name="s"
    )
    assert [sphere.name for sphere in scene.spheres[2:4]] == ["row.1", "row.2"]


@pytest.mark.parametrize("bad", ["a\nb", "a\u2028b", "a\x1b[31m", "x" * 301])
def test_text_that_could_leave_its_line(bad: str) -> None:
    import json

    message = refused(changed('"two beads"', json.dumps(bad)))
    assert "line 1: title = " in message
    assert "one line of at most 300 printable characters" in message
    assert bad not in message


@pytest.mark.parametrize(
    "bad",
    [
        '"1e-3"',
        '"1e-3 m"',
        "true",
        "nan",
        "inf",
        "-inf",
        "1e400",
        "0.0",
        "-1e-3",
        "[1e-3]",
        "{}",
        "2e3",
        "1" + "0" * 400,
        "0x1p3",
        "1e-3 m",
        "1,5",
        "1e-3; shell",
    ],
)
def test_numbers_that_are_none(bad: str) -> None:
    message = refused(changed("diameter = 1e-3", f"diameter = {bad}"))
    assert "line 11" in message
    assert "diameter" in message
    assert "expected" in message


@pytest.mark.parametrize("bad", ["1.5", "true", '"3"', "0", "-1", "1001"])
def test_counts_that_are_none(bad: str) -> None:
    message = refused(changed("until_time = 1e-3", f"until_bounces = {bad}"))
    assert f"run.until_bounces = {bad.replace(chr(34), chr(39)).replace('true', 'True')}" in message


@pytest.mark.parametrize(
    ("old", "new", "line", "wanted"),
    [
        ("young = 70e9", "young = 70", 5, "materials.glass.young = 70: expected a value in [1000, 1e+13] Pa"),
        ("poisson = 0.22", "poisson = 0.6", 6, "materials.glass.poisson = 0.6: expected"),
        ("density = 2500.0", "density = 2.5", 7, "materials.glass.density = 2.5: expected"),
        ("young = 70e9", "yuong = 70e9", 4, "materials.glass.young: missing: expected Young's modulus [Pa]"),
        ("young = 70e9", "yuong = 70e9", 5, "materials.glass.yuong: unknown key"),
        ("young = 70e9", "yuong = 70e9", 5, "did you mean 'young'?"),
        ("gravity =", "gravitiy =", 2, "gravitiy: unknown key"),
        ("gravity =", "gravitiy =", 2, "did you mean 'gravity'?"),
        ("diameter = 2e-3", "radius = 2e-3", 17, "particles.b.radius: unknown key: expected one of material, diameter"),
        ("[0, 0, -9.81]", "[0, -9.81]", 2, "gravity"),
        ("[0, 0, -9.81]", "[0, 0, 0, -9.81]", 2, "gravity"),
        ("[0, 0, -9.81]", "[0, 0, nan]", 2, "gravity[2] = nan: expected a finite number"),
        ("[0, 0, -9.81]", "-9.81", 2, "gravity = -9.81: expected a list"),
        ('axis = "z"', 'axis = "w"', 21, "walls.floor.axis = 'w': "),
        ('material = "rigid"', 'material = "gls"', 23, "walls.floor.material = 'gls': expected one of glass, rigid"),
        ("[walls.floor]", "[walls.glass]", 20, "walls.glass: name = 'glass' is taken by [materials.glass]"),
        ("[walls.floor]", "[walls.b]", 20, "walls.b: name = 'b' is taken by [particles.b]"),
        (
            'axis = "z"',
            'shape = "plain"\naxis = "z"',
            21,
            "walls.floor.shape = 'plain': expected one of plane, box, cylinder, cone, plate, disc, mesh; did you mean",
        ),
        ('axis = "z"', 'shape = "box"\naxis = "z"', 22, "walls.floor.axis: unknown key: expected one of shape"),
        ('law = "tsuji"', 'law = "tsujii"', 26, "contact.law = 'tsujii': expected one of"),
        ('law = "tsuji"', 'law = "tsujii"', 26, "did you mean 'tsuji'?"),
        ('law = "tsuji"', 'law = "hertz"', 27, 'contact.e_n = 0.9 with law "hertz"'),
        ('"max_overlap"', '"max"', 28, "contact.method = 'max': expected one of"),
        ('"max_overlap"', '"contact_time"', 25, "contact.options: method 'contact_time' needs the option 't_c'"),
        ("friction = 0.3", "k_n = 1e5", 28, "contact.method: given together with k_n"),
        ("friction = 0.3", "k_n = 0", 29, "contact.k_n = 0"),
        ("friction = 0.3", "friction = -0.1", 29, "contact.friction = -0.1: expected a value in [0, 10]"),
        ("friction = 0.3", 'end = "both"', 29, "contact.end = 'both'"),
        ("e_n = 0.9", "e_n = 0.0", 27, "contact.e_n = 0.0: expected a value in [0.001, 1]"),
        ("e_n = 0.9", "e_n = 1.1", 27, "contact.e_n = 1.1: expected a value in [0.001, 1]"),
        ("e_n = 0.5", "e_n = 2.0", 33, "contact.pairs[0].e_n = 2.0: expected a value in [0.001, 1]"),
        ("e_n = 0.5", "", 31, "contact.pairs[0]: changes nothing"),
        ('["a", "floor"]', '["a", "flor"]', 32, "did you mean 'floor'?"),
        ('["a", "floor"]', '["a", "a"]', 32, "contact.pairs[0].between"),
        ('["a", "floor"]', '["floor", "rigid"]', 32, "expected names of two bodies that can touch"),
        ('["a", "floor"]', '["a"]', 32, "contact.pairs[0].between"),
        ("until_time = 1e-3", "", 35, "neither is given: expected exactly one of until_time"),
        ("until_time = 1e-3", "until_time = 1.0\nuntil_bounces = 2", 37, "both are given: expected exactly one"),
        ("until_time = 1e-3", "until_time = 1.0\nsteps_per_contact = 1", 37, "run.steps_per_contact = 1: expected"),
        ("until_time = 1e-3", "until_time = 1.0\ndt = 0", 37, "run.dt = 0: expected a value in (0, 1000] s"),
        ("delta_max = 0.05", "delta_maks = 0.05", 39, "did you mean 'delta_max'?"),
        ("delta_max = 0.05", "delta_max = 0", 39, "tolerances.delta_max = 0: expected a value in (0, inf)"),
        ("t_c_2 = 0.1", "t_c_1 = 0.1", 40, "tolerances.t_c_1"),
        ("t_c_2 = 0.1", "trajectory_2 = 0.1", 40, "tolerances.trajectory_2"),
        ("tangential = true", "tangential = 1", 43, "needs.tangential = 1: expected true or false"),
        (
            "tangential = true",
            "gas = true",
            43,
            "needs.gas: physics = 'gas': expected one of history, rolling, tangential",
        ),
    ],
)
def test_refusal_says_where_what_and_what_is_expected(old: str, new: str, line: int, wanted: str) -> None:
    message = refused(changed(old, new))
    assert wanted in message
    assert any(f"here/case.toml, line {line}: " in row for row in message.splitlines() if wanted in row)


@pytest.mark.parametrize(
    ("x", "what"),
    [
        ("[-0.001, 0.0, 0.0]", "overlaps 'a' by 0.0015 m"),
        ("[-0.0015, 0.0, 0.0]", "overlaps 'a' by 0.001 m: expected less than the smaller radius, 0.0005 m"),
        ("[0.002, 0.0, -0.01]", "the centre lies on the plane of wall 'floor'"),
    ],
)
def test_bodies_inside_each_other(x: str, what: str) -> None:
    message = refused(changed("[0.002, 0.0, 0.0]", x))
    assert what in message
    assert "line 18: particles.b.position" in message


def test_overlap_below_the_smaller_radius_is_a_start() -> None:
    parse_case(changed("[0.002, 0.0, 0.0]", "[0.0001, 0.0, 0.0]"), name="sample")  # overlap 0.4 mm of 0.5 mm
    parse_case(changed("[0.002, 0.0, 0.0]", "[0.002, 0.0, -0.0098]"), name="sample")  # into the floor by 0.8 mm


@pytest.mark.parametrize(
    ("case", "override", "meant"),
    [
        ("wall_impact", "contact.en=0.5", "e_n"),
        ("wall_impact", "contact.restitution=0.5", "e_n"),
        ("wall_impact", "contact.kn=1e5", "k_n"),
        ("wall_impact", "contact.v0=1.0", "v_0"),
        ("wall_impact", "contact.law=hunt-crossley", "hunt_crossley"),
        ("bubbling_bed_mini", "gas.u0=0.5", "U_0"),
        ("bubbling_bed_mini", "gas.drag=gidaspow", "ErgunWenYu"),
        ("bubbling_bed_mini", "gas.drag=plessismasliyah", "PlessisMasliyah"),
        ("bubbling_bed_mini", "contact.coefficient_of_restitution=0.9", "e_n"),
    ],
)
def test_another_word_for_a_key_or_a_value_is_understood(case: str, override: str, meant: str) -> None:
    with pytest.raises(CaseFileError, match=f"did you mean '{meant}'"):
        load_case(case, overrides=[override])


FOREIGN = {
    "in.liggghts": ("LIGGGHTS", b"# hopper\natom_style granular\nunits si\nfix m1 all property/global x\n"),
    "hopper": ("LIGGGHTS", b"# a comment\n\n  pair_style gran model hertz tangential history\n"),
    "hopper.stl": ("STL", b"solid hopper\n facet normal 0 0 1\n"),
    "binary.stl": ("STL", b"\x80\xff" * 50 + b"\x01"),
    "large.stl": ("STL", b"\x00\xff" * MOST_BYTES),
    "x.mfx": ("MFiX", b"RUN_NAME = 'x'\n# a comment\nTSTOP = 2.0 5\n"),
    "valid.mfx": ("MFiX", b"run_name = 'x'\n"),
    "project": ("MFiX", b"! a project\nRUN_NAME = 'x'\nTSTOP 2.0\n"),
    "controlDict": ("OpenFOAM", b"FoamFile\n{\n version 2.0;\n}\n"),
    "post.dump": ("dump", b"ITEM: TIMESTEP\n0\n"),
    "spheres.vtk": ("VTK", b"# vtk DataFile Version 3.0\nspheres\n"),
    "scene.py": ("Python", b"from yade import pack\nO.bodies.append(sphere((0, 0, 0), 1))\n"),
    "case.json": ("JSON", b'{"materials": {}}'),
}


@pytest.mark.parametrize("name", FOREIGN)
def test_a_file_of_another_kind_is_named(tmp_path: Path, name: str) -> None:
    what, data = FOREIGN[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(CaseFileError, match=rf"{what}.*expected a case\.toml"):
        load_case(tmp_path / name)


def test_a_slip_in_a_case_is_no_file_of_another_kind(tmp_path: Path) -> None:
    (tmp_path / "case.toml").write_text(changed("gravity =", "units gravity"))
    with pytest.raises(CaseFileError, match=r"case\.toml, line 2: .*units gravity"):
        load_case(tmp_path)


def test_a_single_body_has_nothing_to_touch() -> None:
    with pytest.raises(CaseFileError, match=r"particles: a single particle and no wall.*expected a second particle or"):
        load_case("falling_particle", overrides=["walls.floor=none"])


def test_same_plane_twice() -> None:
    twin = '[walls.roof]\naxis = "z"\nposition = -0.01\nmaterial = "rigid"\n\n[contact]'
    assert "walls.roof.position: the same plane as wall 'floor'" in refused(changed("[contact]", twin))


@pytest.mark.parametrize(
    ("start", "end", "wanted"),
    [
        ("[materials.glass]", "[particles.a]", "materials: missing: expected at least one [materials.NAME]"),
        ("[particles.a]", "[walls.floor]", "particles: missing: expected at least one [particles.NAME]"),
        ("[run]", "[tolerances]", "run: neither is given: expected exactly one of until_time [s] and until_bounces"),
    ],
)
def test_missing_tables(start: str, end: str, wanted: str) -> None:
    text = GOOD[: GOOD.index(start)] + GOOD[GOOD.index(end) :]
    assert wanted in refused(text)


def test_unknown_keys_without_a_near_name_are_listed() -> None:
    assert "line 1: 'a b&': unknown key: expected one of title, source" in refused('"a b&" = 1\n' + GOOD)
    assert "'a\\nb': unknown key: expected one of title, source" in refused('"a\\nb" = 1\n' + GOOD)


def test_every_fault_is_listed_in_the_order_of_the_file() -> None:
    text = changed("e_n = 0.9", "e_n = 9").replace("70e9", '"70 GPa"').replace("2500.0", "true")
    rows = refused(text).splitlines()
    assert [re.search(r"line (\d+)", row)[1] for row in rows] == ["5", "7", "27"]  # type: ignore[index]
    many = "\n".join(f"key{i} = 1" for i in range(30))
    rows = refused(many + "\n" + GOOD).splitlines()
    assert len(rows) == 11
    assert rows[-1].endswith("and 20 more")


@pytest.mark.parametrize(
    "text", ["", "title", "[", "a = " + "[" * 5000, "a = 1\na = 2", "[a]\n[a]", "a = 1" + "0" * 5000, "\x00"]
)
def test_text_that_is_no_toml_or_no_case(text: str) -> None:
    assert "expected" in refused(text)


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_damaged_files_give_a_case_file_error_or_a_scene(data: st.DataObject) -> None:
    at = data.draw(st.integers(0, len(GOOD)))
    length = data.draw(st.integers(0, 20))
    text = GOOD[:at] + data.draw(st.text(max_size=10)) + GOOD[at + length :]
    try:
        scene = parse_case(text, name="sample", where="here/case.toml")
    except KncalError as error:
        assert isinstance(error, CaseFileError)
        assert str(error).startswith("here/case.toml")
    else:
        assert parse_case(dump_case(scene), name="sample") == scene
