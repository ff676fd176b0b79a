"""The case file: what it promises to read and to write, and where it is found."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from models import with_bodies
from sample_case import GOOD

from kncal.core.errors import CaseFileError, InputError
from kncal.physics.material import Material
from kncal.physics.methods import METHODS
from kncal.scene.bodies import Particle, Wall
from kncal.scene.case_file import MOST_BYTES, dump_case, load_case, parse_case
from kncal.scene.contact import ContactChoice, PairChoice
from kncal.scene.run_control import RunControl
from kncal.scene.scene import Scene


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


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"gravity": (0.0, 0.0)}, r"Scene\.gravity\[2\]: Field required"),
        ({"gravity": (0.0, 0.0, float("nan"))}, r"Scene\.gravity\[2\] = nan"),
        ({"title": "two\nlines"}, "one line"),
        ({"weight": 1.0}, r"Scene\.weight"),
    ],
)
def test_a_scene_made_in_python_is_checked_like_a_file(change: dict[str, object], told: str) -> None:
    scene = parse_case(GOOD, name="sample")
    with pytest.raises(InputError, match=told):
        Scene(**({f.name: getattr(scene, f.name) for f in fields(scene)} | change))  # type: ignore[arg-type]
