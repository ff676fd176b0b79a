"""A bed as others meet it: rendered input that runs by hand, a folder with spaces, ParaView, the bar, exit codes."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from kncal.cli import main
from kncal.core.errors import RenderError
from kncal.engines.coupled import Coupled
from kncal.engines.dpmfoam.adapter_build import find
from kncal.record.openfoam import read_cells
from kncal.record.series import UNITS, read_series
from kncal.runs.workflow import render_case, run_case
from kncal.scene.case_file import load_case
from kncal.scene.plan import plan
from kncal.scene.scene import Scene

pytestmark = pytest.mark.slow

COUNT, END = 60, 0.005
#: A loose lattice needs no settling; ten couplings.
SMALL = [
    f"particles.beads.count={COUNT}",
    "particles.beads.place=lattice",
    f"run.until_time={END}",
    "run.frames_every=0.0025",
]
FLAGS = [flag for value in SMALL for flag in ("--set", value)]
GAS_FILES = (
    "system/blockMeshDict",
    "system/fvSchemes",
    "system/fvSolution",
    "constant/kinematicCloudProperties",
    "0/p",
)


def small(*more: str) -> Scene:
    return load_case("bubbling_bed_mini", overrides=[*SMALL, *more])


def kncal(capsys, *arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return stop.value.code, out, err


def positions(data: str) -> np.ndarray:
    """(n, 3) of the section Atoms of a LIGGGHTS data file: id, type, diameter, density, x, y, z."""
    lines = data.partition("Atoms\n\n")[2].partition("\n\n")[0].splitlines()
    return np.array([[float(word) for word in line.split()[4:7]] for line in lines])


@pytest.mark.solver
def test_a_rendered_bed_runs_by_hand(capsys, tmp_path):
    """Particles fall freely, g t²/2, as long as the gaps of the lattice last; gas alone stays a plug flow of U_0."""
    out = tmp_path / "two decks"
    code, printed, _ = kncal(capsys, "render", "bubbling_bed_mini", *FLAGS, "--out", out)
    assert code == 0
    assert "Both together need kncal run" in printed
    model = plan(small(), ("linear",))["linear"]
    steps = 100
    fall = 0.5 * 9.81 * (steps * model.dt) ** 2
    assert fall < 0.04 * model.scene.diameter  # the least gap of the lattice
    done = subprocess.run(["./Allrun", str(steps)], cwd=out / "linear", capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    start = positions((out / "linear/particles/particles.data").read_text())
    assert start.shape == (COUNT, 3)
    dump = (out / "linear/particles/settled.dump").read_text().splitlines()
    rows = np.array([[float(word) for word in line.split()] for line in dump[9:]])
    end = rows[np.argsort(rows[:, 0])][:, 2:5]
    free = start[:, 2] - 0.5 * model.scene.diameter > 1.1 * fall  # the others touch the floor
    assert free.sum() > 0.9 * COUNT
    # the dump prints six digits of coordinates up to 0.03 m, at most 5e-8 m off
    np.testing.assert_allclose((end - start)[free], np.tile([0.0, 0.0, -fall], (free.sum(), 1)), atol=5.1e-8)
    times = [path for path in (out / "linear/gas").iterdir() if re.fullmatch(r"[0-9.]+", path.name)]
    last = max(times, key=lambda path: float(path.name))
    # as often as a run records frames; the name is rounded to nine digits
    written = model.couplings // model.frames_every * model.frames_every
    assert float(last.name) == pytest.approx(written * model.coupling, rel=1e-8)
    U = read_cells(last / "U.air", 10 * 2 * 30)
    # the pressure solver stops at a residual of 1e-6, which leaves some times that share in the velocity
    np.testing.assert_allclose(U, np.tile([0.0, 0.0, 0.8], (600, 1)), atol=1e-5)


@pytest.mark.solver
def test_rendered_input_is_what_a_run_runs_and_a_folder_may_have_spaces(tmp_path):
    """Same deck, same dictionaries; and to the last bit the same numbers in a folder that OpenFOAM refuses by name."""
    scene = small()
    few = replace(scene, run=replace(scene.run, until_time=0.002, frames_every=0.001))
    render_case(few, Coupled(), tmp_path / "decks", ("linear",))
    transports = ("restart",) if find() is None else ("restart", "live")
    series = []
    for transport in transports:
        for name in (f"plain-{transport}", f"it's a {transport} run"):
            results = run_case(few, Coupled(transport), tmp_path / name, ("linear",))
            assert [r.status for r in results.values()] == ["completed"], results
            series.append(read_series(tmp_path / name / "linear" / "series"))
            one, two = tmp_path / "decks" / "linear", tmp_path / name / "linear"
            for file in ("particles/in.liggghts", "particles/particles.data", *(f"gas/{f}" for f in GAS_FILES[:-1])):
                assert (one / file).read_text() == (two / file).read_text(), file
    for other in series[1:]:
        for name in UNITS:
            np.testing.assert_array_equal(getattr(other, name), getattr(series[0], name), err_msg=name)
        np.testing.assert_array_equal(other.x, series[0].x)


@pytest.mark.solver
def test_compare_for_paraview_and_for_machines(capsys, tmp_path):
    """One compare in a folder with spaces: ParaView's series is the run's, and too short a run is exit code 1."""
    import pyvista

    out = tmp_path / "a bed"
    end = "run.until_time=0.012"
    flags = [end if flag.startswith("run.until_time") else flag for flag in FLAGS]
    code, printed, err = kncal(capsys, "compare", "bubbling_bed_mini", *flags, "--out", out, "--paraview", "--json")
    assert code == 1, err
    data = json.loads(printed)
    assert data["state"] in ("undecided", "outside")
    page = (out / "report" / "index.html").read_text(encoding="utf-8")
    assert "run.until_time = 0.012" in page
    for kind in ("linear", "hertz"):
        series = read_series(out / kind / "series")
        reader = pyvista.get_reader(out / kind / "paraview" / "bed.pvd")
        assert len(series.t_frame) >= 4
        np.testing.assert_allclose(reader.time_values, series.t_frame, rtol=1e-15)
        for frame, time in enumerate(reader.time_values):
            reader.set_active_time_value(time)
            particles, gas, *_ = reader.read()
            np.testing.assert_array_equal(particles.points, series.x[frame])
            np.testing.assert_array_equal(particles.point_data["velocity"], series.v[frame])
            np.testing.assert_array_equal(particles.point_data["id"], np.arange(1, COUNT + 1))
            assert gas.n_cells == 10 * 2 * 30
            for name, shape in (("eps_g", (600,)), ("p", (600,)), ("U", (600, 3))):
                assert gas.cell_data[name].shape == shape
            # solids volume of the gas blocks = that of the particles: both blocks show the same bed
            solids = float((1.0 - gas.cell_data["eps_g"].astype(np.float64)).sum()) * 0.003**3
            assert solids == pytest.approx(COUNT * np.pi / 6.0 * 0.0012**3, rel=1e-4)  # single precision near 1


def test_render_leaves_a_foreign_folder_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(RenderError, match="nothing was changed"):
        render_case(small(), Coupled(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("case", "flags", "has", "lacks"),
    [
        ("bubbling_bed_mini", FLAGS, ["particles", "gas"], []),
        (
            "packed_bed",
            ["--set", "particles.beads.place=lattice", "--set", "particles.beads.count=60"],
            ["gas"],
            ["particles"],
        ),
    ],
)
def test_what_nothing_runs_is_not_rendered(capsys, tmp_path, case, flags, has, lacks):
    code, *_ = kncal(capsys, "render", case, *flags, "--model", "hertz", "--out", tmp_path / "out")
    assert code == 0
    folder = tmp_path / "out" / "hertz"
    assert all((folder / name / "Allrun").stat().st_mode & 0o111 for name in has)
    assert not any((folder / name).exists() for name in lacks)
    text = (folder / "README.txt").read_text(encoding="utf-8")
    assert ("LIGGGHTS has nothing to do" in text) == ("particles" in lacks)
    assert json.loads((folder / "manifest.json").read_text())["model"] == "hertz"
    assert not (tmp_path / "out" / "linear").exists()


def test_kn_of_a_bed_has_both_pairs_with_the_numbers_of_its_models(capsys):
    code, out, _ = kncal(capsys, "kn", "bubbling_bed_mini", "--json")
    assert code == 0
    pairs = json.loads(out)["pairs"]
    assert set(pairs) == {"beads–beads", "beads–column"}
    scene = load_case("bubbling_bed_mini")
    for (a, b), contact in plan(scene, ("linear",))["linear"].named.items():
        (row,) = [row for row in pairs[f"{a}–{b}"]["methods"] if row["method"] == "mean_overlap"]
        assert row["k_n"] == contact.k
        assert row["eta_n"] == contact.c


def test_kn_of_a_bed_with_a_prescribed_stiffness_says_so(capsys):
    code, out, _ = kncal(capsys, "kn", "bubbling_bed")
    assert code == 0
    assert "beads–column: the case prescribes k_n = 1 kN/m" in out


_BAR = """
import time
from kncal.cli import show
with show.run_bars({"linear": 0.5, "hertz": 0.25}) as progress_for:
    for kind, couplings in (("linear", 4), ("hertz", 8)):
        advance = progress_for(kind)
        for done in range(1, couplings + 1):
            time.sleep(0.15)
            advance(done, couplings)
"""


def test_the_bar_of_a_bed_tells_simulated_time_speed_and_what_is_left():
    """On a terminal, 2 s are simulated by either model: 4 couplings of 0.5 s, 8 of 0.25 s."""
    import pty

    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    child = subprocess.Popen([sys.executable, "-c", _BAR], stdout=theirs, stderr=theirs, env=environment)
    os.close(theirs)
    shown = b""
    while True:
        try:
            block = os.read(ours, 4096)
        except OSError:  # the other end is closed
            break
        if not block:
            break
        shown += block
    os.close(ours)
    assert child.wait() == 0
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.decode())
    assert "preparing" in text
    for kind in ("linear", "hertz"):
        assert re.search(rf"{kind} \S+ 2\.000 of 2\.000 s simulated, [\d.]+ s per s", text)
    assert re.search(r"of 2\.000 s simulated, [\d.]+ s per s, 0:00:\d\d left", text)
    assert max(len(line) for line in re.split(r"[\r\n]+", text)) <= 100


def test_no_bar_where_no_terminal_is():
    done = subprocess.run([sys.executable, "-c", _BAR], capture_output=True, text=True, check=True)
    assert done.stdout + done.stderr == ""  # it takes less than a minute


_SLOW = """
import time
from kncal.cli import show
show.MINUTE = 0.4
with show.run_bars({"linear": 0.5}) as progress_for:
    time.sleep(0.6)
    for kind, first, steps in (("packing", 0, 100), ("linear", 10, 20)):
        advance = progress_for(kind)
        for done in range(first + 1, steps + 1):
            time.sleep(0.9 / (steps - first))
            advance(done, steps)
with show.run_bars({}) as progress_for:
    advance = progress_for("hertz")
    advance(1, 4)
    time.sleep(0.6)
with show.working("measuring") as now:
    now("round 1")
    time.sleep(0.6)
"""


@pytest.mark.slow
def test_without_a_terminal_progress_is_a_line_a_minute():
    """The minute is 0.4 s here. Each job takes 0.6 to 0.9 s: one line or two of each, on standard error."""
    done = subprocess.run([sys.executable, "-c", _SLOW], capture_output=True, text=True, check=True)
    assert done.stdout == ""
    lines = done.stderr.splitlines()
    for start in ("start: ", "packing: ", "linear: ", "hertz: 1 of 4 steps, 25 %", "round 1: "):
        assert 1 <= sum(line.startswith(start) for line in lines) <= 3, (start, lines)
    assert len(lines) == len([line for line in lines if re.search(r"0:00:\d\d so far", line)])
    (done_, total, unit, percent, left) = re.search(
        r"^linear: ([\d.]+) of ([\d.]+) (.*?), (\d+) %, .*, (\S+) left$", done.stderr, re.MULTILINE
    ).groups()
    assert (float(total), unit) == (10.0, "s simulated")
    assert 5.0 < float(done_) < 10.0
    assert int(percent) == round(10.0 * float(done_))
    assert left in ("0:00:00", "0:00:01")
