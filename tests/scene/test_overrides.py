"""Values from outside the case file: what they may say, where they go, and how they are refused and traced."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kncal.cli import main
from kncal.core.errors import CaseFileError, InputError
from kncal.scene.case_file import dump_case, load_case, parse_case, shipped_cases
from kncal.scene.overrides import Override, overridden, parse_override


@pytest.mark.parametrize(
    ("text", "path", "value"),
    [
        ("run.until_time=0.2", ("run", "until_time"), 0.2),
        ("particles.beads.count = 500", ("particles", "beads", "count"), 500),
        ("contact.law=hertz", ("contact", "law"), "hertz"),
        ("particles.beads.frozen=true", ("particles", "beads", "frozen"), True),
        ('title="two words"', ("title",), "two words"),
        ("gas.ramp=[[0, 0.1], [1, 0.5]]", ("gas", "ramp"), [[0, 0.1], [1, 0.5]]),
        ('materials."a.b".young=1e9', ("materials", "a.b", "young"), 1e9),
        ("a.b=x=y", None, None),
    ],
)
def test_an_override_is_a_toml_key_and_a_toml_value_or_a_bare_word(text, path, value):
    if path is None:
        with pytest.raises(InputError, match="no TOML value"):
            parse_override(text)
        return
    found = parse_override(text)
    assert (found.path, found.value) == (path, value)
    assert type(found.value) is type(value)


@pytest.mark.parametrize(
    "text",
    ["", "run.until_time", "=1", "run.until_time=", "a b=1", "a..b=1", "[a]=1", "a=1\nb=2", "a=1 s", "a=[1", "#=1"],
)
def test_what_is_no_override_is_refused(text):
    with pytest.raises(InputError, match="expected"):
        parse_override(text)


@given(
    st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(2**62), 2**62) | st.booleans() | st.text("aé #'")
)
def test_what_an_override_says_of_itself_reads_back(value):
    """str() is what the title and the messages show: it is an override again, with the same bits."""
    again = parse_override(str(Override(("run", "a b"), value)))
    assert again.path == ("run", "a b")
    assert again.value == value
    assert type(again.value) is type(value)


def test_none_takes_a_key_a_table_or_a_row_out_of_the_case():
    bed = load_case("bubbling_bed_mini", overrides=["gas=none", "contact.method=none", "contact.k_n=100"])
    assert bed.gas is None
    assert bed.contact.k_n == 100.0
    walls = load_case("stacked_particles").planes
    fewer = load_case("stacked_particles", overrides=[f"walls.{walls[0].name}=none"]).planes
    assert fewer == walls[1:]
    pairs = load_case("bubbling_bed").contact.pairs
    assert load_case("bubbling_bed", overrides=["contact.pairs.0=none"]).contact.pairs == pairs[1:]
    assert parse_override(str(parse_override("gas=none"))) == parse_override("gas=none")
    assert parse_override('title="none"').value == "none"


def test_what_is_not_there_cannot_be_taken_out():
    with pytest.raises(CaseFileError, match=r"contact\.methd = none: not in the case.*did you mean 'method'"):
        load_case("bubbling_bed_mini", overrides=["contact.methd=none"])


def test_the_tables_given_are_left_alone():
    tables = {"title": "x", "run": {"a": 1}, "walls": {"floor": {"position": 0.0}}}
    before = json.dumps(tables)
    changed = overridden(tables, [parse_override("run.a=2"), parse_override("walls.floor.position=1.0")])
    assert json.dumps(tables) == before
    assert changed["run"]["a"] == 2
    assert changed["walls"]["floor"]["position"] == 1.0


@pytest.mark.parametrize("name", shipped_cases())
def test_every_shipped_case_takes_one_and_its_dump_holds_it(name):
    scene = load_case(name, overrides=["run.steps_per_contact=31.25"])
    assert scene.run.steps_per_contact == 31.25
    assert scene.title.endswith("(run.steps_per_contact = 31.25)")
    assert load_case(name).title in scene.title
    text = dump_case(scene)
    assert parse_case(text, name=name, folder=scene.folder) == scene


def test_a_long_list_of_values_is_cut_in_the_title():
    many = [f"tolerances.e_n_{n}=0.1" for n in range(2, 40)]
    title = load_case("wall_impact", overrides=many).title
    assert len(title) <= 300
    assert title.endswith("...)")
    assert load_case("wall_impact", overrides=["title=mine"]).title == "mine"


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["run.until_tme=1"], ["run.until_tme", "unknown key", "did you mean 'until_time'"]),
        (["rnu.until_time=1"], ["rnu", "did you mean 'run'"]),
        (["materials.sof.young=1e6"], ["no 'sof' in materials", "did you mean 'soft'"]),
        (["run.until_time=soon"], ["run.until_time = 'soon'", "a number"]),
        (["run.until_time=-1"], ["run.until_time = -1", "with run.until_time = -1 from outside the file"]),
        (["run.until_time=1", "run.until_time=2"], ["given twice"]),
        (["run.until_time.x=1"], ["expected a table above 'x'"]),
        (["tolerances.zmean=0.1"], ["did you mean 'z_mean'"]),
        (["run.coupling=3.0"], ["coupling = 3", "at most until_time"]),
    ],
)
def test_a_wrong_one_is_refused_like_the_file(overrides, words):
    with pytest.raises(CaseFileError) as refused:
        load_case("bubbling_bed_mini", overrides=overrides)
    for word in words:
        assert word in str(refused.value)


@pytest.mark.parametrize("key", ["walls.5.position", "walls.flor.position", "walls.-1.position"])
def test_a_wall_that_is_not_there_is_refused_with_those_that_are(key):
    with pytest.raises(CaseFileError, match="expected one of floor"):
        load_case("wall_impact", overrides=[f"{key}=0.0"])


def test_a_row_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(CaseFileError, match="expected a number from 0 to 0"):
        load_case("bubbling_bed", overrides=["contact.pairs.1.e_n=0.5"])


def kncal(capsys, *arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return stop.value.code, out, err


@pytest.mark.slow
def test_every_command_that_runs_a_case_takes_set(capsys, tmp_path):
    more = ("--set", "contact.e_n=0.5", "--set", "particles.sphere.velocity=[0, 0, -2.0]")
    code, out, _ = kncal(capsys, "kn", "wall_impact", *more, "--json")
    assert code == 0
    (pair,) = json.loads(out)["pairs"].values()
    assert (pair["e_n"], pair["v_0"]) == (0.5, pytest.approx(2.0, rel=1e-3))  # gravity adds a little on the way
    for command, flags in (("run", ("--engine", "builtin")), ("compare", ("--engine", "builtin")), ("render", ())):
        out_dir = tmp_path / command
        code, *_ = kncal(capsys, command, "wall_impact", *flags, *more, "--out", out_dir)
        assert code in (0, 1)
        scene = load_case(out_dir / "case.toml")
        assert scene.contact.e_n == 0.5
        assert "contact.e_n = 0.5" in scene.title
        assert "sphere.velocity" in scene.title
    page = (tmp_path / "compare" / "report" / "index.html").read_text(encoding="utf-8")
    assert "contact.e_n = 0.5" in page
    # what was run with the values is read back with them
    code, *_ = kncal(capsys, "report", tmp_path / "compare")
    assert code == 0


def test_set_without_a_case_is_refused(capsys, tmp_path):
    code, _, err = kncal(capsys, "kn", "--young", "70e9", "--set", "contact.e_n=0.5")
    assert (code, "needs a case" in err) == (2, True)
    code, _, err = kncal(capsys, "compare", tmp_path / "a", tmp_path / "b", "--set", "contact.e_n=0.5")
    assert (code, "--set has no meaning" in err) == (2, True)
