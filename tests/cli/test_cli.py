"""The command line as a user meets it: exit codes, data for machines, clear complaints."""

import dataclasses
import json
import subprocess
import sys

import pytest

from kncal.cli import main

pytestmark = pytest.mark.slow

KN = [
    "kn",
    "--young",
    "70e9",
    "--poisson",
    "0.22",
    "--density",
    "2500",
    "--radius",
    "1e-3",
    "--v0",
    "0.5",
    "--en",
    "0.9",
]


def kncal(capsys, *arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return stop.value.code, out, err


def test_help_lists_every_command(capsys):
    code, out, _ = kncal(capsys, "--help")
    assert code == 0
    for name in ["doctor", "laws", "kn", "collide", "cases", "new", "needs", "render", "run", "compare", "report"]:
        assert name in out


def test_kn_json_agrees_with_the_api(capsys):
    from kncal import Material, calibrate, pair

    code, out, _ = kncal(capsys, *KN, "--json")
    data = json.loads(out)
    assert code == 0
    rows = {row["method"]: row for row in data["methods"]}
    contact = pair(Material(young=70e9, poisson=0.22, density=2500.0), 1e-3)
    for method in ("mean_overlap", "max_overlap", "contact_duration", "strain_energy"):
        assert rows[method]["k_n"] == calibrate(contact, v_0=0.5, e_n=0.9, method=method).k_n
    assert "problem" in rows["contact_time"]
    assert "peratomtypepair 2" in data["liggghts"]


@pytest.mark.parametrize(
    "flags",
    [
        [],
        ["--radius-2", "2e-3", "--young-2", "2e9"],
        ["--against", "wall", "--young-2", "210e9", "--density-2", "7800"],
        ["--against", "rigid-wall"],
    ],
)
def test_the_block_to_paste_holds_the_numbers_of_the_table(capsys, flags):
    _, out, _ = kncal(capsys, *KN, *flags, "--method", "max_overlap", "--json")
    data = json.loads(out)
    (row,) = [row for row in data["methods"] if row["method"] == "max_overlap"]
    lines = [line.split() for line in data["liggghts"].splitlines() if line.startswith("fix")]
    kn, gamman = (next(words[7:] for words in lines if words[1] == name) for name in ("kn", "gamman"))
    assert repr(row["k_n"]) in kn
    assert any(float(x) == pytest.approx(row["gamma_n"], rel=1e-12) for x in gamman)


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--style", "hooke"], "strain_energy"),
        (["--style", "hertz", "--law", "hunt_crossley"], "tsuji"),
        (["--style", "hertz", "--end", "force", "--e-n", "0.1"], "larger e_n"),
        (["--friction", "-1"], "friction"),
        (["--steps-per-contact", "0"], "steps_per_contact"),
    ],
)
def test_a_block_that_liggghts_would_not_take_is_refused(capsys, flags, words):
    given = KN[:-2] if "--e-n" in flags else KN
    code, _, err = kncal(capsys, *given, *flags)
    assert code == 2
    assert words in err


TWENTY_MM = """
[materials.stone]
young = 1e9
poisson = 0.25
density = 2500.0
[particles.one]
material = "stone"
diameter = 0.02
position = [0.0, 0.0, 0.02]
velocity = [{speed}, 0.0, 0.0]
[particles.two]
material = "stone"
diameter = 0.02
position = [0.03, 0.0, 0.02]
[walls.floor]
axis = "z"
position = 0.0
material = "rigid"
[contact]
e_n = 0.5
k_n = 1e4
[run]
until_time = 0.1
"""


@pytest.mark.parametrize("speed", [0.0, 0.2])
def test_a_prescribed_stiffness_has_damping_duration_step_and_block(capsys, tmp_path, speed):
    import math

    (tmp_path / "case.toml").write_text(TWENTY_MM.format(speed=speed))
    code, out, _ = kncal(capsys, "kn", tmp_path, "--json")
    assert code == 0
    data = json.loads(out)
    # closed form (Schaefer et al. 1996): two spheres of 20 mm; at the wall the effective mass is twice that
    m, k, log = 2500.0 * math.pi * 0.02**3 / 6.0, 1e4, math.log(2.0)
    for pair, m_eff in (("one–two", m / 2.0), ("one–floor", m)):
        (row,) = [row for row in data["pairs"][pair]["methods"] if row["method"] == "prescribed"]
        assert row["k_n"] == k
        assert row["eta_n"] == pytest.approx(2.0 * log * math.sqrt(k * m_eff / (math.pi**2 + log**2)), rel=1e-9)
        assert row["t_c"] == pytest.approx(math.sqrt((math.pi**2 + log**2) * m_eff / k), rel=1e-9)
        assert row["dt"] == pytest.approx(row["t_c"] / 50.0, rel=1e-12)
        assert (row["delta_max"] is None) == (speed == 0.0)
        if pair == "one–two":
            assert row["eta_n"] == pytest.approx(3.118, abs=5e-4)
            assert row["t_c"] == pytest.approx(2.328e-3, abs=5e-7)
            assert row["dt"] == pytest.approx(46.56e-6, abs=5e-9)
    lines = {w[1]: [float(x) for x in w[7:]] for w in map(str.split, data["liggghts"].splitlines()) if w[0] == "fix"}
    assert lines["kn"] == [k] * 4
    # two spheres of one kind are one type; eta_n/m_eff
    eta, walls_eta = (data["pairs"][p]["methods"][-1]["eta_n"] for p in ("one–two", "one–floor"))
    assert lines["gamman"][:2] == pytest.approx([eta / (m / 2.0), walls_eta / m], rel=1e-12)
    assert "timestep 4.65" in data["liggghts"]
    code, out, _ = kncal(capsys, "kn", tmp_path)
    assert code == 0
    assert "3.118" in out
    assert "46.56" in out


def test_kn_table_names_every_method(capsys):
    from kncal.physics.methods import METHODS

    code, out, _ = kncal(capsys, *KN)
    assert code == 0
    assert all(name in out for name in METHODS)


def test_kn_of_a_case(capsys):
    code, out, _ = kncal(capsys, "kn", "wall_impact", "--json")
    assert code == 0
    assert json.loads(out)["case"] == "wall_impact"


def many_spheres(folder, number, unlike):
    """A case of spheres above a floor, all alike or each of a size of its own."""
    text = "[materials.glass]\nyoung = 5e7\npoisson = 0.25\ndensity = 2500.0\n"
    for i in range(number):
        diameter = 0.002 * (1.0 + 0.005 * i * unlike)
        text += f'[particles.p{i}]\nmaterial = "glass"\ndiameter = {diameter}\n'
        text += f"position = [{0.01 * (i % 10)}, {0.01 * (i // 10)}, 0.01]\nvelocity = [0.0, 0.0, -0.5]\n"
    text += '[walls.floor]\naxis = "z"\nposition = 0.0\nmaterial = "rigid"\n'
    (folder / "case.toml").write_text(text + "[contact]\ne_n = 0.9\n[run]\nuntil_time = 0.001\n")
    return folder


def test_kn_of_many_alike_spheres_is_that_of_their_two_kinds_of_pairs(capsys, tmp_path):
    case = str(many_spheres(tmp_path, 100, unlike=False))
    code, out, _ = kncal(capsys, "kn", case, "--json")
    assert code == 0
    pairs = json.loads(out)["pairs"]
    assert {name: pair["pairs_of_bodies"] for name, pair in pairs.items()} == {"p0–p1": 4950, "p0–floor": 100}
    # k_n goes with m_eff^(1/5) R_eff^(2/5) E_eff^(4/5): against a rigid wall each of the three is doubled
    k_n = {name: pair["methods"][0]["k_n"] for name, pair in pairs.items()}
    assert k_n["p0–floor"] / k_n["p0–p1"] == pytest.approx(2.0**1.4, rel=1e-9)
    code, out, _ = kncal(capsys, "kn", case)
    assert code == 0
    assert len(out.splitlines()) < 100


def test_kn_of_many_unlike_spheres_is_one_table_of_the_shortest_contacts(capsys, tmp_path):
    case = str(many_spheres(tmp_path, 20, unlike=True))
    code, out, _ = kncal(capsys, "kn", case)
    assert code == 0
    assert len(out.splitlines()) < 100
    pairs = json.loads(kncal(capsys, "kn", case, "--json")[1])["pairs"]
    assert len(pairs) == 20 * 19 // 2 + 20
    assert all([row["method"] for row in pair["methods"]] == ["mean_overlap"] for pair in pairs.values())
    shortest = min(pairs, key=lambda name: pairs[name]["methods"][0]["t_c"])
    assert next(line for line in out.splitlines() if "–" in line).split()[0] == shortest
    assert kncal(capsys, "kn", case, "--uncertain", "young=10%")[0] == 2


def test_warnings_of_many_alike_bodies_are_few(capsys, tmp_path):
    # all sink into the floor by their own weight more than they should: said once for all of them
    case = str(many_spheres(tmp_path, 40, unlike=False))
    heavy = ("--set", "gravity=[0.0, 0.0, -9000.0]", "--set", "contact.v_0=5.0")
    code, out, _ = kncal(capsys, "render", case, "--out", str(tmp_path / "out"), *heavy)
    assert code == 0
    warnings = [line for line in out.splitlines() if line.startswith("  warning: ")]
    assert any("–floor" in line for line in warnings)
    assert len(warnings) < 10
    assert max(map(len, warnings)) < 500


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["kn", "--young", "70", "--density", "2500", "--radius", "1e-3", "--v0", "1", "--en", "0.9"],
            "70 GPa is 70e9",
        ),
        ([*KN[:-1], "1.2"], "e_n"),
        (["kn", "--young", "70e9"], "--density"),
        (["kn", "no_such_case"], "no_such_case"),
        (["kn", "wall_impact", "--young", "70e9"], "one or the other"),
        (["compare", "wall_inpact"], "wall_impact"),
        (["run", "wall_impact", "--engine", "mfix"], "mfix"),
        (["frobnicate"], "frobnicate"),
        ([*KN, "--against", "wall", "--radius-2", "1e-3"], "flat"),
        (["report", "nowhere"], "nowhere"),
        (["run", "bubbling_bed_mini", "--engine", "builtin"], "--engine has no meaning for a bed"),
        (["compare", "bubbling_bed_mini", "--repeat", "3"], "--repeat has no meaning for a bed"),
        (["run", "wall_impact", "--transport", "live"], "--transport has no meaning"),
        (["compare", "wall_impact", "--transport", "live"], "--transport has no meaning"),
    ],
)
def test_bad_usage_is_exit_code_2_and_says_what(capsys, arguments, words):
    code, out, err = kncal(capsys, *arguments)
    assert code == 2
    assert words in out + err
    assert "Traceback" not in out + err


def test_compare_writes_a_report_and_exits_0(capsys, tmp_path):
    out_dir = tmp_path / "with space"
    code, out, _ = kncal(capsys, "compare", "wall_impact", "--engine", "builtin", "--out", out_dir, "--json")
    data = json.loads(out)
    assert code == 0
    assert data["within"] is True
    assert (out_dir / "report" / "index.html").is_file()
    for kind in ("linear", "hertz"):
        assert json.loads((out_dir / kind / "result.json").read_text())["status"] == "completed"
        manifest = json.loads((out_dir / kind / "manifest.json").read_text())
        assert manifest["model"] == kind
        assert len(manifest["case_sha256"]) == 64
    # two run folders, and the report again
    code, out, _ = kncal(capsys, "compare", out_dir / "linear", out_dir / "hertz", "--json")
    assert code == 0
    assert json.loads(out)["rows"] == data["rows"]
    code, _, err = kncal(capsys, "compare", out_dir / "hertz", out_dir / "linear")
    assert code == 2
    assert "is a hertz run" in err
    code, out, _ = kncal(capsys, "report", out_dir, "--out", tmp_path / "again")
    assert code == 0
    assert (tmp_path / "again" / "index.html").is_file()


def test_compare_outside_a_tolerance_is_exit_code_1(capsys, tmp_path):
    code, *_ = kncal(capsys, "new", "wall_impact", tmp_path / "mine")
    assert code == 0
    case = tmp_path / "mine" / "case.toml"
    text = case.read_text().split("[tolerances]")[0] + "[tolerances]\ndelta_max = 0.0001\n"
    case.write_text(text)
    code, out, _ = kncal(capsys, "compare", case, "--engine", "builtin", "--out", tmp_path / "run")
    assert code == 1
    assert "outside" in out.lower()


def test_tables_and_paraview_frames_of_a_run(capsys, tmp_path):
    import pandas as pd
    import pyvista

    arguments = ("--engine", "builtin", "--out", tmp_path, "--model", "hertz", "--paraview", "--json")
    code, out, _ = kncal(capsys, "run", "head_on_collision", *arguments)
    assert code == 0
    metrics = json.loads(out)["hertz"]["metrics"]
    contacts = pd.read_csv(tmp_path / "hertz" / "contacts.csv", comment="#")
    assert contacts["delta_max"][0] == pytest.approx(metrics["delta_max"], rel=1e-12)
    overlaps = pd.read_csv(tmp_path / "hertz" / "overlaps.csv", comment="#")
    assert overlaps["delta"].max() == pytest.approx(metrics["delta_max"], rel=1e-2)
    reader = pyvista.get_reader(tmp_path / "hertz" / "paraview" / "particles.pvd")
    assert len(reader.time_values) == len(overlaps)
    assert reader.time_values[-1] == pytest.approx(overlaps["t"].iloc[-1], rel=1e-9)


def test_a_second_run_is_not_made_or_moves_the_first_aside(capsys, tmp_path):
    arguments = ("run", "wall_impact", "--engine", "builtin", "--out", tmp_path, "--model", "linear")
    code, *_ = kncal(capsys, *arguments)
    assert code == 0
    code, out, err = kncal(capsys, *arguments, "--json")
    assert code == 0
    assert json.loads(out)["linear"]["metrics"]
    assert "linear not run again: it is complete, with the same input" in err
    assert not (tmp_path / "attempt-1").exists()
    for _ in range(2):
        code, *_ = kncal(capsys, *arguments, "--rerun")
        assert code == 0
    assert (tmp_path / "attempt-1" / "linear" / "result.json").is_file()
    assert (tmp_path / "attempt-2" / "linear" / "result.json").is_file()
    assert not (tmp_path / "attempt-2" / "attempt-1").exists()


def test_a_foreign_folder_is_left_alone(capsys, tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    code, _, err = kncal(capsys, "render", "wall_impact", "--out", tmp_path)
    assert code == 2
    assert "nothing was changed" in err
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_changed_case_is_noticed(capsys, tmp_path):
    kncal(capsys, "run", "wall_impact", "--engine", "builtin", "--out", tmp_path)
    with (tmp_path / "case.toml").open("a") as case:
        case.write("# touched\n")
    code, _, err = kncal(capsys, "report", tmp_path)
    assert code == 2
    assert "changed" in err


def test_missing_solver_is_exit_code_4(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    code, _, err = kncal(capsys, "run", "wall_impact", "--out", tmp_path / "run")
    assert code == 4
    assert "apt-get install liggghts" in err


@pytest.mark.solver
def test_timed_out_solver_is_exit_code_3(capsys, tmp_path):
    kncal(capsys, "new", "falling_particle", tmp_path / "long")
    case = tmp_path / "long" / "case.toml"
    case.write_text(case.read_text().replace("until_bounces = 3", "until_time = 1000.0"))
    code, _, err = kncal(capsys, "run", case, "--out", tmp_path / "run", "--timeout", "2", "--model", "linear")
    assert code == 3
    assert "timed out" in err
    assert json.loads((tmp_path / "run" / "linear" / "result.json").read_text())["status"] == "timed_out"


def test_collide_and_laws_and_needs_and_cases(capsys, tmp_path):
    code, out, _ = kncal(capsys, "collide", *KN[1:], "--out", tmp_path / "one.svg", "--json")
    assert code == 0
    assert json.loads(out)["picture"].endswith("one.svg")
    for command in (["laws"], ["cases"], ["needs", "oblique_impact"]):
        code, out, _ = kncal(capsys, *command, "--json")
        assert code == 0, command
        assert json.loads(out)


@pytest.mark.solver
def test_the_doctor_finds_every_program(capsys):
    code, out, _ = kncal(capsys, "doctor", "--json")
    assert code == 0
    assert json.loads(out)


@pytest.mark.parametrize(
    ("method", "flag", "value", "equal"),
    [
        # what each method keeps equal: the definition of its option
        ("limited_overlap", "--fraction", 0.002, lambda c: c["delta_max"] / (2 * 1e-3)),
        ("contact_time", "--t-c", 1e-4, lambda c: c["t_c"]),
        ("static_load", "--force", 1e-3, lambda c: (c["k_n"] / c["pair"]["k_h"] ** (2 / 3)) ** 3),
        ("youngs_modulus", "--factor", 0.01, lambda c: c["k_n"] / (c["pair"]["E_eff"] * c["pair"]["R_eff"])),
    ],
)
def test_collide_takes_the_options_of_its_method(capsys, tmp_path, method, flag, value, equal):
    arguments = (*KN[1:], "--method", method, flag, value, "--out", tmp_path / "one.svg", "--json")
    code, out, _ = kncal(capsys, "collide", *arguments)
    assert code == 0
    assert equal(json.loads(out)) == pytest.approx(value, rel=1e-9)
    code, _, err = kncal(capsys, "collide", *KN[1:], flag, value, "--out", tmp_path / "one.svg")
    assert code == 2
    assert "mean_overlap" in err


def test_a_bead_of_a_metre_is_asked_about(capsys):
    given = [*KN[: KN.index("--radius") + 1], "1", *KN[KN.index("--radius") + 2 :]]
    code, out, _ = kncal(capsys, *given, "--json")
    assert code == 0
    for row in json.loads(out)["methods"]:
        assert "problem" in row or "radius-large" in [w["code"] for w in row["warnings"]]
    _, out, _ = kncal(capsys, *KN, "--json")
    assert "radius-large" not in out


def test_new_names_the_folder_that_cannot_be_a_case_and_marks_what_was_changed(capsys, tmp_path):
    from kncal.scene.case_file import load_case, shipped_cases

    code, _, err = kncal(capsys, "new", "wall_impact", tmp_path / "my wall")
    assert code == 2
    assert "'my wall'" in err
    assert "cases/wall_impact" not in err
    assert list(tmp_path.iterdir()) == []
    for name in shipped_cases():
        assert kncal(capsys, "new", name, tmp_path / name)[0] == 0
        mine, shipped = load_case(tmp_path / name), load_case(name)
        assert mine.source.startswith(f"changed from {name}: {shipped.source}"[:300])
        assert dataclasses.replace(mine, source=shipped.source) == shipped


def test_python_m_kncal_and_version():
    done = subprocess.run([sys.executable, "-m", "kncal", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "0.2.0"
