"""``kncal trade`` as a user meets it."""

import json

import pytest

from kncal.cli import main
from kncal.cli.trade import seconds
from kncal.core.errors import InputError
from kncal.scene.case_file import dump_case, load_case
from kncal.study.trade.run import trade_scene
from kncal.study.trade.trade import TradeOptions

pytestmark = pytest.mark.slow


def kncal(capsys, *arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return stop.value.code, out, err


@pytest.mark.solver
def test_a_trade_with_the_real_solver_ends_in_a_case_that_repeats_its_error(capsys, tmp_path):
    out = tmp_path / "trade"
    flags = ["--factor", "1/10", "--steps", "20", "--rounds", "2", "--tolerance", "restitution=6%", "--json"]
    code, text, _ = kncal(capsys, "trade", "wall_impact", *flags, "--out", out)
    assert code == 0
    data = json.loads(text)
    points = {p["candidate"]["name"]: p for p in data["points"]}
    assert all(len(p["cpu_seconds"]) == 2 for p in points.values() if p["status"] == "completed")
    chosen = points[data["chosen"]]
    # e_n hardly depends on stiffness, and softer is cheaper
    assert chosen["candidate"]["factor"] < 1.0
    assert [s["over"].split()[0] for s in data["speed_ups"]] == ["the"]  # there is no Hertz at N = 50 here
    assert data["speed_ups"][0]["cpu"]["rounds"] == 2
    # the builtin engine and the solver do the same iteration
    assert any("differs by" in c and "e-1" in c for c in data["caveats"])

    model = chosen["candidate"]["variant"]["model"]
    case = data["case_file"]
    code, text, _ = kncal(capsys, "run", case, "--model", model, "--out", tmp_path / "again", "--json")
    assert code == 0
    again = json.loads(text)[model]["metrics"]
    # the same steps by the solver as by the screening: rounding, as the engines differ
    assert again["e_n"] == pytest.approx(chosen["errors"]["e_n"]["run"], rel=1e-9)


def test_nothing_inside_is_exit_code_1_and_says_how_far(capsys, tmp_path):
    flags = ["--factor", "1/10", "--steps", "20", "--rounds", "1", "--engine", "builtin", "--tolerance", "e_n=0.5%"]
    code, text, _ = kncal(capsys, "trade", "wall_impact", *flags, "--out", tmp_path / "trade")
    assert code == 1
    assert "No contact" in text
    assert "0.5 % allowed" in text
    assert not (tmp_path / "trade" / "case.toml").exists()


def test_the_uncertainty_of_a_path_holds_what_other_phases_of_first_touch_do_to_it(tmp_path):
    """A drop from 70 µm higher up is the same case, but for where in a step the sphere touches the floor."""
    options = TradeOptions(
        factors=(1.0,), steps=(50.0,), overlaps=(), rounds=1, engine="builtin", tolerances={"trajectory": 0.01}
    )
    errors = []
    for height in (0.5, 0.50007):
        scene = load_case("falling_particle", overrides=[f"particles.ball.position=[0, 0, {height}]"])
        case = tmp_path / f"at-{height}.toml"
        case.write_text(dump_case(scene), encoding="utf-8")
        trade = trade_scene(case, scene, tmp_path / f"trade-{height}", options, lambda _: None)
        errors.append(trade.point("linear-max_overlap-N50").errors["trajectory"].difference)
    one, other = errors
    assert abs(one.value - other.value) > 1e-3  # else the test says nothing
    assert other.value <= one.value + one.width
    assert one.value <= other.value + other.width


def test_nothing_of_the_users_is_written_over_or_removed(capsys, tmp_path):
    kncal(capsys, "new", "wall_impact", tmp_path / "mine")
    case = tmp_path / "mine" / "case.toml"
    before = case.read_text()
    code, _, err = kncal(capsys, "trade", case, "--out", case.parent, "--engine", "builtin")
    assert code == 2
    assert "holds the case itself" in err
    assert case.read_text() == before
    code, _, err = kncal(capsys, "trade", "falling_particle", "--out", case.parent, "--engine", "builtin")
    assert code == 2
    assert "holds case.toml and no trade.json" in err
    assert case.read_text() == before


@pytest.mark.parametrize(
    ("flags", "hint"),
    [
        (["--tolerance", "restitutoin=1%"], "did you mean"),
        (["--tolerance", "restitution=1"], "1 is a share, 100 %"),
        (["--budget", "ten"], "--budget"),
        (["--factor", "3"], "--factor"),
        (["--factor", "1/0"], "--factor"),
        (["--reference", "materials.nothing.young=1e9"], "no 'nothing' in materials"),
        (["--transport", "live"], "no meaning"),
    ],
)
def test_bad_flags_are_refused_before_any_run(capsys, tmp_path, flags, hint):
    code, _, err = kncal(capsys, "trade", "wall_impact", *flags, "--out", tmp_path / "out")
    assert code == 2
    assert hint in err
    assert not list(tmp_path.rglob("result.json"))


def test_an_engine_means_nothing_to_a_bed(capsys, tmp_path):
    code, _, err = kncal(capsys, "trade", "bubbling_bed_mini", "--engine", "builtin", "--out", tmp_path / "out")
    assert code == 2
    assert "--engine has no meaning for a bed" in err


@pytest.mark.parametrize(("text", "value"), [("90", 90.0), ("90s", 90.0), ("10min", 600.0), ("1.5h", 5400.0)])
def test_times(text, value):
    assert seconds(text) == value


@pytest.mark.parametrize("text", ["", "0", "-1s", "1.2.3s", "10 years", "inf"])
def test_what_is_no_time(text):
    with pytest.raises(InputError, match="expected a time"):
        seconds(text)
