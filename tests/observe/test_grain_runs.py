"""What is seen in real runs of many particles without gas."""

from __future__ import annotations

import re

import pytest

from kncal.cli import main
from kncal.observe.run_data import RunData
from kncal.runs.workflow import load

pytestmark = [pytest.mark.solver, pytest.mark.long]
#: Beads of two sizes and groups fall into a box with periodic sides: they come to rest.
CASE = """
title = "Beads fall into a box"
source = "made up"
gravity = [0.0, 0.0, -9.81]
periodic = ["y"]
[materials.glass]
young = 5e6
poisson = 0.3
density = 2500
[particles.red]
material = "glass"
count = 250
diameter = 4e-3
place = "lattice"
region = {shape = "box", low = [0.0021, 0.0021, 0.0021], high = [0.0479, 0.0179, 0.04]}
[particles.blue]
material = "glass"
count = 250
diameter = 4e-3
place = "lattice"
region = {shape = "box", low = [0.0021, 0.0021, 0.042], high = [0.0479, 0.0179, 0.09]}
[walls.box]
shape = "box"
material = "glass"
size = [0.05, 0.02, 0.1]
[contact]
e_n = 0.3
v_0 = 0.3
friction = 0.5
[observe]
surface = "slope"
[run]
until_time = 0.5
sample_every = 5e-3
frames_every = 0.05
steps_per_contact = 25
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    home = tmp_path_factory.mktemp("grains")
    case = home / "heap"
    case.mkdir()
    (case / "case.toml").write_text(CASE)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(home)
        with pytest.raises(SystemExit) as ended:
            main(["compare", "heap"])
    assert ended.value.code == 0
    return home / "runs" / "heap"


@pytest.fixture(scope="module")
def run(folder) -> RunData:
    return load(folder / "linear")


def test_a_box_of_beads_comes_to_rest_and_its_walls_carry_them(run) -> None:
    assert run.seen.kind == "resting" and run.seen.window.by == "rest"
    found = run.estimates
    assert found["support"].value == pytest.approx(1.0, abs=1e-3)
    assert 0.0 < found["wall_share"].value < 0.3
    assert found["angle_of_repose"].value < 15.0
    assert "mass_flow" not in found and "pressure_drop" not in found and "kinetic_energy" not in found


def test_groups_that_lie_on_each_other_stay_separate(run) -> None:
    found = run.estimates
    assert found["mixing_index"].value < 0.5
    assert found["mixing_time"].value is None and found["mixing_time"].why


def test_another_packing_would_differ_so_one_is_not_known_as_well_as_it_stays(run) -> None:
    for name in ("z_mean", "contacts"):
        found = run.estimates[name]
        assert not found.reliable and found.width > 1e-3 * found.value


def test_the_report_shows_what_was_measured(folder) -> None:
    page = (folder / "report" / "index.html").read_text(encoding="utf-8")
    for title in ("What the particles do", "Angle of the surface", "Profiles", "Mixing"):
        assert title in page
    for name in re.findall(r'src="([^"]+\.(?:png|svg|gif))"', page):
        assert (folder / "report" / name).stat().st_size > 1000
    assert (folder / "report" / "grains.png").exists()
