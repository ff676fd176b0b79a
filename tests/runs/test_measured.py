"""contact.v_0 = "measured": rounds until k_n settles, kept and said; and where it cannot be."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from kncal.cli import main
from kncal.core.errors import CaseFileError, RenderError, RunError
from kncal.runs.impact_speeds import run_speeds
from kncal.runs.measure_speed import RECORD, resolve_measured
from kncal.scene.case_file import dump_case, load_case, parse_case
from kncal.scene.contact import MeasuredSpeed
from kncal.scene.plan import plan
from kncal.scene.scene import Scene

pytestmark = pytest.mark.slow

solver = pytest.mark.solver

BALL = """
gravity = [0.0, 0.0, -9.81]
[materials.rubber]
young = 5e6
poisson = 0.3
density = 1000.0
[particles.ball]
material = "rubber"
diameter = 0.01
position = [0.0, 0.0, 0.105]
[walls.floor]
axis = "z"
position = 0.0
material = "rubber"
[contact]
e_n = 0.7
v_0 = "measured"
[contact.measured]
tolerance = 0.01
[run]
until_bounces = 4
"""

BED = """
gravity = [0.0, 0.0, -9.81]
[materials.soft]
young = 5e6
poisson = 0.3
density = 1000.0
[walls.column]
shape = "box"
size = [0.015, 0.006, 0.06]
material = "soft"
[particles.beads]
count = 300
diameter = 0.0012
material = "soft"
place = "lattice"
[contact]
e_n = 0.9
friction = 0.1
v_0 = "measured"
[contact.measured]
start = 0.5
run_time = 0.05
[run]
until_time = 0.06
coupling = 5e-4
steps_per_contact = 25
"""


def ball(**changes: Any) -> Scene:
    text = BALL
    for key, value in changes.items():
        text = text.replace("tolerance = 0.01", f"{key} = {json.dumps(value)}\ntolerance = 0.01")
    return parse_case(text, name="ball")


def test_a_case_that_is_to_be_measured_is_read_and_written() -> None:
    scene = ball(statistic="p99", start=0.5, run_time=0.1, rounds=3)
    expected = MeasuredSpeed(statistic="p99", start=0.5, run_time=0.1, tolerance=0.01, rounds=3)
    assert scene.contact.measured == expected
    assert scene.contact.v_0 is None
    assert 'v_0 = "measured"' in dump_case(scene)  # which also reads it back


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (
            'v_0 = "measured"',
            'v_0 = "fast"',
            'without quotes or unit, for the impact speed to calibrate at [m/s], or "measured"',
        ),
        ('v_0 = "measured"', "v_0 = true", "expected a number"),
        ('v_0 = "measured"', "v_0 = 0.5", 'contact.measured: given without v_0 = "measured"'),
        ('v_0 = "measured"', 'v_0 = "measured"\nk_n = 100.0', "contact.k_n: given together with"),
        ("tolerance = 0.01", "tolerance = 0.0", "tolerance"),
        ("tolerance = 0.01", "statistic = 'median'", "statistic"),
        ("tolerance = 0.01", "begin = 1.0", "unknown key"),
    ],
)
def test_what_contradicts_itself_is_refused(old: str, new: str, text: str) -> None:
    with pytest.raises(CaseFileError, match="contact") as refused:
        parse_case(BALL.replace(old, new), name="ball")
    assert text in str(refused.value)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("start = 0.5", "", "contact.measured.start: missing"),
        ("run_time = 0.05", "", "contact.measured.run_time: missing"),
        ("run_time = 0.05", "run_time = 0.005", "at least 20 couplings, 0.01 s"),
        ("[contact.measured]\nstart = 0.5\nrun_time = 0.05\n", "", "contact.measured.start: missing"),
    ],
)
def test_a_bed_says_where_to_start_and_how_long_to_measure(tmp_path: Path, old: str, new: str, text: str) -> None:
    (tmp_path / "case.toml").write_text(BED.replace(old, new))
    with pytest.raises(CaseFileError) as refused:
        load_case(tmp_path)
    assert text in str(refused.value)


def test_nothing_is_planned_without_a_number() -> None:
    with pytest.raises(CaseFileError, match="still to be measured"):
        plan(ball())


def test_bounces_are_averaged_and_the_second_round_settles(tmp_path: Path) -> None:
    """Speeds v, e v, e² v, e³ v: energy-weighted v (1 + e³ + e⁶ + e⁹)/(1 + e² + e⁴ + e⁶), whatever the spring."""
    said: list[str] = []
    resolved = resolve_measured(ball(), tmp_path, engine="builtin", tell=said.append)
    e, v = 0.7, (2.0 * 9.81 * 0.1) ** 0.5
    exact = v * (1.0 + e**3 + e**6 + e**9) / (1.0 + e**2 + e**4 + e**6)
    # gravity during the contact makes the linear contact lose a little more or less: 1 % of e at the last bounce
    assert resolved.contact.v_0 == pytest.approx(exact, rel=5e-3)
    assert resolved.contact.measured is None
    assert "measured in 2 rounds" in resolved.title
    assert "settled in 2 rounds" in said[-1]
    record = json.loads((tmp_path / "measuring" / RECORD).read_text())
    assert record["settled"] is True
    assert record["v_0"] == resolved.contact.v_0
    assert [r["v_0"] for r in record["rounds"]] == pytest.approx([v, exact], rel=5e-3)
    # k_n ~ v^(2/5)
    assert record["rounds"][0]["change"] == pytest.approx((exact / v) ** 0.4 - 1.0, abs=2e-3)
    assert plan(resolved)["linear"].between("ball", "floor").v_0 == resolved.contact.v_0

    results = sorted((tmp_path / "measuring").glob("round-*/linear/result.json"))
    assert len(results) == 2
    before = [path.stat().st_mtime_ns for path in results]
    assert resolve_measured(ball(), tmp_path, engine="builtin") == resolved
    assert [path.stat().st_mtime_ns for path in results] == before


def test_the_start_is_taken_and_one_round_is_enough_where_it_is_right(tmp_path: Path) -> None:
    first = (2.0 * 9.81 * 0.1) ** 0.5
    scene = ball(start=round(first, 3), statistic="mean", run_time=0.15)  # the first bounce alone
    resolved = resolve_measured(scene, tmp_path, engine="builtin")
    assert "measured in 1 round)" in resolved.title
    assert resolved.contact.v_0 == pytest.approx(first, rel=1e-3)


def test_what_does_not_settle_is_an_error_with_the_last_values(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"not settled in 1 rounds.*run_time") as error:
        resolve_measured(ball(rounds=1), tmp_path, engine="builtin")
    record = json.loads((tmp_path / "measuring" / RECORD).read_text())
    assert record["settled"] is False
    assert record["v_0"] is None
    assert f"{record['rounds'][-1]['found']['v_0']['value']:.4g}" in str(error.value)


def test_a_run_in_which_nothing_meets_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="nothing met"):
        resolve_measured(ball(run_time=0.01), tmp_path, engine="builtin")


def test_a_folder_of_someone_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(RenderError, match="choose an empty folder"):
        resolve_measured(ball(), tmp_path, engine="builtin")
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def call(*arguments: str | Path) -> int:
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    return int(end.value.code or 0)


def test_the_command_line_measures_runs_and_tells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case, out = tmp_path / "ball", tmp_path / "out"
    case.mkdir()
    (case / "case.toml").write_text(BALL)
    assert call("run", case, "--engine", "builtin", "--out", out, "--json") == 0
    told = capsys.readouterr()
    assert "settled in 2 rounds" in told.err
    assert set(json.loads(told.out)) == {"linear", "hertz"}
    scene = load_case(out / "case.toml", name="ball")
    assert scene.contact.v_0 is not None
    assert call("run", case, "--engine", "builtin", "--out", out) == 0
    assert not list(out.glob("attempt-*"))  # all was kept
    capsys.readouterr()
    assert call("kn", "--from-run", out, "--json") == 0
    runs = json.loads(capsys.readouterr().out)["runs"]
    assert [run["model"] for run in runs] == ["linear", "hertz"]
    (row,) = (row for row in runs[0]["impacts"]["all"]["k_n"] if row["statistic"] == "energy_weighted")
    assert row["v_0"]["value"] == pytest.approx(scene.contact.v_0, rel=1e-3)
    assert call("kn", case, "--engine", "builtin", "--out", out, "--json") == 0
    assert json.loads(capsys.readouterr().out)["pairs"]["ball–floor"]["methods"][0]["v_0"] == scene.contact.v_0
    assert call("kn", case, "--engine", "builtin", "--out", out, "--set", "contact.measured.rounds=1") == 3
    assert "not settled" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ("--from-run", "nowhere"),
        ("wall_impact", "--from-run", "nowhere"),
        ("--picture", "x.png"),
        ("wall_impact", "--engine", "builtin"),
        ("--young", "7e10", "--out", "x"),
        ("wall_impact", "--uncertain", "young"),
        ("wall_impact", "--uncertain", "young=5%", "--uncertain", "young=6%"),
    ],
)
def test_flags_that_do_not_fit_are_refused(arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert call("kn", *arguments) == 2
    told = capsys.readouterr().err
    assert "expected" in told or "leave it out" in told


@solver
def test_a_bed_is_measured_by_the_impacts_of_its_particles(tmp_path: Path) -> None:
    """A loose lattice that falls: particles meet at speeds below that of a fall through all of the column."""
    (tmp_path / "case.toml").write_text(BED)
    scene = load_case(tmp_path, name="bed")
    resolved = resolve_measured(scene, tmp_path / "out")
    assert resolved.contact.v_0 is not None
    assert 0.0 < resolved.contact.v_0 < (2.0 * 9.81 * 0.06) ** 0.5
    record = json.loads((tmp_path / "out" / "measuring" / RECORD).read_text())
    last = record["rounds"][-1]
    assert abs(last["change"]) < last["allowed"]
    seen = run_speeds(tmp_path / "out" / "measuring" / last["folder"] / "linear")
    assert seen.main == "particles"
    assert seen.speeds["particles"].speeds["energy_weighted"].value == pytest.approx(resolved.contact.v_0, rel=1e-3)
    assert seen.enduring is not None


BEADS = """
[materials.rubber]
young = 5e6
poisson = 0.3
density = 1000.0
{beads}
[walls.floor]
axis = "z"
position = 0.0
material = "rubber"
[contact]
e_n = 0.7
v_0 = 1.0
[run]
until_time = 0.01
"""


def _bead(name: str, x: float, z: float, speed: tuple[float, float]) -> str:
    velocity = [speed[0], 0.0, speed[1]]
    return (
        f'[particles.{name}]\nmaterial = "rubber"\ndiameter = 0.01\nposition = [{x}, 0.0, {z}]\nvelocity = {velocity}\n'
    )


def test_pairs_that_are_not_alike_are_told_apart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two beads fall on the floor at 1 and 2 m/s; far from it two meet at 3 m/s."""
    beads = [
        _bead("slow", 0.0, 0.006, (0.0, -1.0)), _bead("fast", 0.1, 0.006, (0.0, -2.0)),
        _bead("left", 0.20, 0.5, (3.0, 0.0)), _bead("right", 0.211, 0.5, (0.0, 0.0)),
    ]  # fmt: skip
    case, out = tmp_path / "beads", tmp_path / "out"
    case.mkdir()
    (case / "case.toml").write_text(BEADS.format(beads="\n".join(beads)))
    assert call("run", case, "--engine", "builtin", "--model", "linear", "--out", out) == 0
    found = run_speeds(out / "linear")
    assert set(found.speeds) == {"fast–floor", "left–right"}
    on_floor, met = found.speeds["fast–floor"].speeds, found.speeds["left–right"].speeds
    assert on_floor["mean"].value == pytest.approx(1.5, rel=1e-9)
    assert on_floor["energy_weighted"].value == pytest.approx((1.0 + 8.0) / (1.0 + 4.0), rel=1e-9)
    assert met["mean"].value == pytest.approx(3.0, rel=1e-9)
    # of one speed a sphere on a wall of its material needs 2^0.6 times the stiffness of two spheres, and v^(2/5)
    stiffness = {key: next(r.k_n.value for r in found.stiffness(key) if r.statistic == "mean") for key in found.speeds}
    ratio = stiffness["fast–floor"] / stiffness["left–right"]
    assert ratio == pytest.approx(2.0**0.6 * (1.5 / 3.0) ** 0.4, rel=1e-9)
    capsys.readouterr()
    assert call("kn", "--from-run", out) == 0
    told = capsys.readouterr().out
    assert "fast–floor: 2 impacts" in told
    assert "left–right: 1 impacts" in told


def test_a_pair_with_a_speed_of_its_own_is_not_measured_at(tmp_path: Path) -> None:
    text = BALL.replace("[run]", '[[contact.pairs]]\nbetween = ["ball", "floor"]\nv_0 = 0.5\n[run]')
    with pytest.raises(CaseFileError, match=r"ball–floor, has a v_0 of its own, 0\.5 m/s"):
        resolve_measured(parse_case(text, name="ball"), tmp_path / "out", engine="builtin")
