"""The case file: what it promises to read, to write and to refuse."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from models import with_bodies

from kncal.core.errors import CaseFileError, InputError, KncalError
from kncal.physics.material import Material
from kncal.physics.methods import METHODS
from kncal.scene.bodies import Particle, Wall
from kncal.scene.case_file import MOST_BYTES, dump_case, load_case, parse_case
from kncal.scene.scene import ContactChoice, PairChoice, RunControl, Scene

GOOD = """\
title = "two beads"
gravity = [0, 0, -9.81]

[materials.glass]
young = 70e9
poisson = 0.22
density = 2500.0

[particles.a]
material = "glass"
diameter = 1e-3
position = [-0.001, 0.0, 0.0]
velocity = [0.5, 0.0, 0.0]

[particles.b]
material = "glass"
diameter = 2e-3
position = [0.002, 0.0, 0.0]

[walls.floor]
axis = "z"
position = -0.01
material = "rigid"

[contact]
law = "tsuji"
e_n = 0.9
method = "max_overlap"
friction = 0.3

[[contact.pairs]]
between = ["a", "floor"]
e_n = 0.5

[run]
until_time = 1e-3

[tolerances]
delta_max = 0.05
t_c_2 = 0.1

[needs]
tangential = true
"""


def changed(old: str, new: str) -> str:
    assert GOOD.count(old) == 1, f"{old!r} must stand exactly once in the sample"
    return GOOD.replace(old, new)


def refused(text: str) -> str:
    with pytest.raises(CaseFileError) as caught:
        parse_case(text, name="sample", where="here/case.toml")
    message = str(caught.value)
    assert all(line.startswith("here/case.toml") for line in message.splitlines())
    assert message.isprintable() or "\n" in message
    return message


def test_values_arrive_in_the_scene() -> None:
    scene = parse_case(GOOD, name="sample")
    a, b = scene.spheres
    assert scene.name == "sample"
    assert scene.gravity == (0.0, 0.0, -9.81)
    assert (a.radius, b.radius) == (0.5e-3, 1e-3)
    assert a.material == Material(name="glass", young=70e9, poisson=0.22, density=2500.0)
    assert a.velocity == (0.5, 0.0, 0.0)
    assert b.velocity == b.spin == (0.0, 0.0, 0.0)
    assert scene.planes == (Wall(name="floor", axis="z", position=-0.01),)
    assert (scene.contact.method, scene.contact.e_n, scene.contact.friction) == ("max_overlap", 0.9, 0.3)
    assert scene.contact.pairs == (PairChoice(between=("a", "floor"), e_n=0.5),)
    assert scene.run == RunControl(until_time=1e-3)
    assert scene.tolerances == {"delta_max": 0.05, "t_c_2": 0.1}
    assert scene.needs == {"tangential": True}


# --- round trip -------------------------------------------------------------------------------------------------

names = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9._-]{0,20}", fullmatch=True).filter(lambda n: n != "rigid")
texts = st.text(st.characters(exclude_categories=["C", "Z"]) | st.just(" "), max_size=60)


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


def maybe(strategy: st.SearchStrategy[float]) -> st.SearchStrategy[float | None]:
    return st.none() | strategy


def vectors(size: float) -> st.SearchStrategy[tuple[float, float, float]]:
    return st.tuples(*[numbers(-size, size)] * 3)


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    n_materials, n_particles = draw(st.integers(1, 3)), draw(st.integers(1, 4))
    n_walls = draw(st.integers(0 if n_particles > 1 else 1, 2))
    count = n_materials + n_particles + n_walls
    taken = draw(st.lists(names, min_size=count, max_size=count, unique=True))
    materials = [
        Material(
            name=taken.pop(),
            young=draw(numbers(1e3, 1e13)),
            poisson=draw(numbers(0.0, 0.5)),
            density=draw(numbers(10.0, 1e6)),
            yield_strength=draw(maybe(numbers(1e3, 1e10))),
        )
        for _ in range(n_materials)
    ]
    # places one metre apart hold spheres of at most one metre
    particles = tuple(
        Particle(
            name=taken.pop(),
            material=draw(st.sampled_from(materials)),
            radius=draw(numbers(1e-6, 0.5)),
            position=(float(i), *draw(st.tuples(*[numbers(-10.0, 10.0)] * 2))),
            velocity=draw(vectors(1e4)),
            spin=draw(vectors(1e6)),
        )
        for i in range(n_particles)
    )
    walls = tuple(
        Wall(
            name=taken.pop(),
            axis="z",
            position=-20.0 - i,
            material=draw(st.none() | st.sampled_from(materials)),
        )
        for i in range(n_walls)
    )
    fractions = numbers(1e-3, 1.0)
    if draw(st.booleans()):
        how: dict[str, object] = {"k_n": draw(numbers(1e-3, 1e12))}
    else:
        method = draw(st.sampled_from(sorted(METHODS)))
        how = {"method": method}
        how["options"] = {name: draw(numbers(1e-6, 1.0)) for name in METHODS[method].required}
    partners = [b.name for b in (*particles[1:], *walls)]
    pairs = tuple(
        PairChoice(
            between=(particles[0].name, partner),
            e_n=draw(fractions),
            friction=draw(maybe(numbers(0.0, 2.0))),
            v_0=draw(maybe(numbers(1e-6, 1e3))),
            k_n=draw(maybe(numbers(1e-3, 1e12))),
        )
        for partner in partners[: draw(st.integers(0, 2))]
    )
    until_time = draw(maybe(numbers(1e-9, 1e3)))
    return Scene.of(
        name=draw(names),
        title=draw(texts),
        source=draw(texts),
        spheres=particles,
        planes=walls,
        gravity=draw(vectors(100.0)),
        contact=ContactChoice(
            law=draw(st.sampled_from(["tsuji", "kuwabara_kono", "hunt_crossley"])),
            e_n=draw(fractions),
            end=draw(st.sampled_from(["overlap", "force"])),
            v_0=draw(maybe(numbers(1e-6, 1e3))),
            friction=draw(numbers(0.0, 2.0)),
            k_t_ratio=draw(maybe(numbers(0.0, 2.0))),
            rolling_friction=draw(numbers(0.0, 2.0)),
            pairs=pairs,
            **how,  # type: ignore[arg-type]
        ),
        run=RunControl(
            steps_per_contact=draw(numbers(4.0, 1e6)),
            until_time=until_time,
            until_bounces=draw(st.integers(1, 1000)) if until_time is None else None,
            dt=draw(maybe(numbers(1e-12, 1.0))),
            record_every=draw(st.integers(1, 10**6)),
        ),
        tolerances=draw(
            st.dictionaries(st.sampled_from(["e_n", "t_c_3", "trajectory"]), numbers(1e-6, 10.0), max_size=3)
        ),
        needs=draw(st.dictionaries(st.sampled_from(["tangential", "rolling"]), st.booleans(), max_size=2)),
    )


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(scene=scenes())
def test_dumped_scene_loads_back_equal(scene: Scene) -> None:
    assert parse_case(dump_case(scene), name=scene.name) == scene


def test_dump_refuses_what_a_file_cannot_hold() -> None:
    scene = parse_case(GOOD, name="sample")
    a, b = scene.spheres
    other = replace(b, material=replace(b.material, young=1e9))
    with pytest.raises(InputError, match="two different materials are called 'glass'"):
        with_bodies(scene, spheres=(a, other))
    with pytest.raises(InputError, match="neither is given"):
        dump_case(replace(scene, run=replace(scene.run, until_time=None)))


# --- finding the file ---------------------------------------------------------------------------------------------


def test_file_folder_and_name_of_the_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "my_beads"
    home.mkdir()
    (home / "case.toml").write_text(GOOD, encoding="utf-8")
    (home / "other.toml").write_text(GOOD, encoding="utf-8")
    assert load_case(home) == load_case(str(home / "case.toml")) == parse_case(GOOD, name="my_beads")
    assert load_case(home / "other.toml").name == "other"
    assert load_case(home, name="given").name == "given"
    monkeypatch.chdir(home)
    assert load_case(".").name == load_case("case.toml").name == "my_beads"


def test_a_folder_on_disk_comes_before_a_shipped_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shipped = load_case("wall_impact")
    (tmp_path / "wall_impact").mkdir()
    assert load_case("wall_impact") == shipped  # an empty folder is no case
    (tmp_path / "wall_impact" / "case.toml").write_text(GOOD, encoding="utf-8")
    assert load_case("wall_impact").title == "two beads"


@pytest.mark.parametrize(
    "case", ["wall_impakt", "../../etc/passwd", "/etc", "", "a\nb", "a\0b", "x" * 5000, "cases/../wall_impact"]
)
def test_no_such_case(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CaseFileError) as caught:
        load_case(case)
    assert "\n" not in str(caught.value)
    if case == "wall_impakt":
        assert "did you mean 'wall_impact'?" in str(caught.value)


def test_bad_folder_name_is_refused(tmp_path: Path) -> None:
    home = tmp_path / "my beads; rm"
    home.mkdir()
    (home / "case.toml").write_text(GOOD, encoding="utf-8")
    with pytest.raises(CaseFileError, match="name of the case"):
        load_case(home)
    assert load_case(home, name="beads").name == "beads"


def test_huge_binary_and_special_files(tmp_path: Path) -> None:
    path = tmp_path / "case.toml"
    path.write_bytes(GOOD.encode() + b"#" * MOST_BYTES)
    with pytest.raises(CaseFileError, match=rf"case\.toml: \d+ bytes, expected at most {MOST_BYTES}"):
        load_case(path)
    path.write_bytes(b'title = "x"\nsource = "\xff"\n')
    with pytest.raises(CaseFileError, match=r"case\.toml, line 2: not UTF-8"):
        load_case(path)
    with pytest.raises(CaseFileError, match="no such case"):
        load_case("/dev/zero")


# --- refusals -----------------------------------------------------------------------------------------------------

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
            "walls.floor.shape = 'plain': expected one of plane, box; did you mean 'plane'?",
        ),
        ('axis = "z"', 'shape = "box"\naxis = "z"', 22, "walls.floor.axis: unknown key: expected one of shape, size"),
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
        ("until_time = 1e-3", "until_time = 1.0\ndt = 0", 37, "run.dt = 0: expected a value in (0, inf) s"),
        ("delta_max = 0.05", "delta_maks = 0.05", 39, "did you mean 'delta_max'?"),
        ("delta_max = 0.05", "delta_max = 0", 39, "tolerances.delta_max = 0: expected a value in (0, inf)"),
        ("t_c_2 = 0.1", "t_c_1 = 0.1", 40, "tolerances.t_c_1"),
        ("t_c_2 = 0.1", "trajectory_2 = 0.1", 40, "tolerances.trajectory_2"),
        ("tangential = true", "tangential = 1", 43, "needs.tangential = 1: expected true or false"),
        ("tangential = true", "gas = true", 43, "needs.gas: physics = 'gas': expected one of rolling, tangential"),
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
