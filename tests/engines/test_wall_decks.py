"""Decks of scenes with walls of any shape, run by hand: walls hold, move, carry and go as closed forms say."""

from __future__ import annotations

import math
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from granular import G, driven_text, frames, placed, plan_of, run_by_hand, start_at, table

from kncal.core.checks import Array
from kncal.engines.liggghts.deck import bed_deck, write_deck
from kncal.engines.liggghts.deck_walls import DeckWall
from kncal.engines.liggghts.library import LiggghtsDem
from kncal.scene.wall_motion import pose, when

pytestmark = pytest.mark.solver
R = 0.0025
WEIGHT = 2500.0 * 4.0 / 3.0 * math.pi * R**3 * G

#: A wall that holds a bead, where the bead starts (a little above), and the height at which it comes to rest.
HOLDS = {
    "plane": ('shape = "plane"\naxis = "z"\nposition = 0.0\n', (0.0, 0.0, R), R),
    "box": ('shape = "box"\nsize = [0.04, 0.04, 0.1]\nlow = [-0.02, -0.02, 0.0]\n', (0.0, 0.0, R), R),
    "disc": ('shape = "disc"\ncentre = [0, 0, 0]\nradius = 0.02\n', (0.003, 0.004, R), R),
    "plate": (
        'shape = "plate"\ncorner = [-0.02, -0.02, 0]\nedge_1 = [0.04, 0, 0]\nedge_2 = [0, 0.04, 0]\n',
        (0.003, -0.004, R),
        R,
    ),
    "cylinder": ('shape = "cylinder"\naxis = "x"\ncentre = [0, 0.02]\nradius = 0.02\n', (0.0, 0.0, R), R),
    "tube": (
        'shape = "cylinder"\naxis = "x"\ncentre = [0, 0.02]\nradius = 0.02\nlow = -0.025\nhigh = 0.025\n',
        (0.0, 0.0, R),
        R,
    ),
    # in a cone of 45 degrees about the vertical a sphere touches all around, its centre sqrt(2) R above the tip
    "cone": (
        'shape = "cone"\nradius_low = 0.0\nradius_high = 0.02\nlow = 0.0\nhigh = 0.02\n',
        (0.0, 0.0, math.sqrt(2.0) * R),
        math.sqrt(2.0) * R,
    ),
}


@pytest.mark.parametrize("shape", HOLDS)
def test_a_bead_comes_to_rest_on_every_kind_of_wall_with_its_weight(shape: str, tmp_path: Path) -> None:
    wall, (x, y, z), height = HOLDS[shape]
    model = plan_of(f'{placed((x, y, z + 1e-5))}[walls.base]\nmaterial = "glass"\n{wall}')
    text = run_by_hand(model, tmp_path)
    assert "WARNING" not in text
    last = list(frames(tmp_path).values())[-1][0]
    assert np.linalg.norm(last[6:9]) < 1e-3
    # overlaps are small: weight/k_n = 1.5e-7 m; triangles are within 2 % of R of a curved wall
    assert last[5] == pytest.approx(height, abs=0.03 * R)
    files = sorted(tmp_path.glob("force_base*.txt"))
    on_particles = sum(table(file)[-20:, 3].mean() for file in files)
    mesh = (tmp_path / "wall_base.stl").exists()
    assert mesh == (shape in ("disc", "plate", "tube", "cone"))
    assert on_particles == pytest.approx(-WEIGHT if mesh else WEIGHT, rel=0.02)


def test_at_an_inner_edge_a_bead_is_carried_by_both_triangles(tmp_path: Path) -> None:
    """As in a groove: k delta cos(theta/2) of each. So a wall of triangles is twice as stiff there as a round one."""
    _, place, _ = HOLDS["tube"]
    tube = '[walls.base]\nmaterial = "glass"\n' + HOLDS["tube"][0]
    model = plan_of(placed(place) + tube, gravity=100.0 * G, until=0.1)
    run_by_hand(model, tmp_path)
    (base,) = bed_deck(model, start_at(model)).walls
    assert base.triangles is not None
    around = np.unique(base.triangles.reshape(-1, 3).round(9)[:, 1:], axis=0)
    half = math.pi / len(around)
    assert around[:, 1].min() == pytest.approx(0.0, abs=1e-12)  # an edge is at the bottom
    overlap = 100.0 * WEIGHT / (2.0 * model.contacts[0, 1].k * math.cos(half))
    rests = list(frames(tmp_path).values())[-1][0, 5]
    assert rests == pytest.approx((R - overlap) / math.cos(half), abs=0.02 * overlap)


MOVED = """
[walls.paddle]
shape = "plate"
corner = [0.004, 0.0, 0.05]
edge_1 = [0.01, 0.0, 0.0]
edge_2 = [0.0, 0.002, 0.01]
[[walls.paddle.motion]]
kind = "rotate"
axis = [0, 0, 1]
origin = [0.001, 0, 0]
period = 0.1
stop = 0.2
[[walls.paddle.motion]]
kind = "translate"
velocity = [0.05, 0.0, 0.02]
start = 0.05
stop = 0.15
[[walls.paddle.motion]]
kind = "oscillate"
amplitude = [0.0, 0.0, 0.004]
period = 0.07
start = 0.02
"""


def nodes(path: Path) -> Array:
    return np.array([line.split()[1:] for line in path.read_text().splitlines() if "vertex" in line], dtype=np.float64)


def test_a_wall_with_three_motions_goes_where_the_closed_form_says(tmp_path: Path) -> None:
    """Motions start and stop on the way, and carry an axis along; so do all nodes stay in the box."""
    model = plan_of(placed((0.02, 0.02, -0.01)) + MOVED, gravity=0.0)
    instead = ("dump          frames", "dump          walls all mesh/stl 400 wall*.stl\ndump          frames")
    assert "Not all nodes" not in run_by_hand(model, tmp_path, instead=instead)
    (paddle,) = bed_deck(model, start_at(model)).walls
    assert paddle.triangles is not None
    found = {int(re.sub(r"\D", "", path.name)): nodes(path) for path in tmp_path.glob("wall[0-9]*.stl")}
    assert len(found) > 15
    for step, there in found.items():
        expected = pose(paddle.wall.motion, step * model.dt, model.coupling).placed(paddle.triangles.reshape(-1, 3))
        # LIGGGHTS adds up an oscillation's speeds: amplitude omega dt of error; its files have six digits
        assert np.abs(there - expected).max() < 0.004 * 2.0 * math.pi / 0.07 * model.dt + 1e-6


def test_a_belt_drives_a_bead_by_friction_and_stays(tmp_path: Path) -> None:
    """Sliding: v = mu g t, omega R = 5/2 mu g t; until rolling both grow, and the belt itself does not move."""
    belt = '[walls.belt]\nshape = "plate"\ncorner = [-0.03, -0.03, 0]\nedge_1 = [0.06, 0, 0]\nedge_2 = [0, 0.06, 0]\n'
    model = plan_of(f"{placed((-0.02, 0.0, R - 1e-7))}{belt}surface_velocity = [1.0, 0.0, 0.0]\n", until=0.045)
    run_by_hand(model, tmp_path)
    assert "surface_vel 1.0 0.0 0.0" in (tmp_path / "in.liggghts").read_text()
    step, rows = next((step, rows) for step, rows in frames(tmp_path).items() if step)
    t = step * model.dt
    assert 0.5 * G * t * 3.5 < 1.0  # it still slides
    assert rows[0, 6] == pytest.approx(0.5 * G * t, rel=0.02)
    assert -rows[0, 10] * R == pytest.approx(2.5 * 0.5 * G * t, rel=0.02)


HOPPER = """
[particles.beads]
material = "glass"
diameter = 0.005
positions = POSITIONS
[walls.tube]
shape = "cylinder"
radius = 0.025
material = "glass"
[walls.cone]
shape = "cone"
radius_low = 0.012
radius_high = 0.025
low = 0.0
high = 0.02
material = "glass"
[walls.plug]
shape = "disc"
centre = [0, 0, 0.001]
radius = 0.0125
remove_at = 0.4
[outlets.out]
position = -0.01
"""
GRID = [[0.0075 * (i % 4) - 0.011, 0.0075 * (i // 4 % 4) - 0.011, 0.05 + 0.0075 * (i // 16)] for i in range(60)]


@pytest.fixture(scope="module")
def hopper(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hopper")
    run_by_hand(plan_of(HOPPER.replace("POSITIONS", str(GRID)), until=0.8), folder)
    return folder


def test_particles_stay_until_the_plug_is_taken_away_and_each_is_counted(hopper: Path) -> None:
    model = plan_of(HOPPER.replace("POSITIONS", str(GRID)), until=0.8)
    passed = table(hopper / "outlet_out.txt")
    opened = round(when(0.4, model.coupling) / model.dt)
    assert (passed[passed[:, 0] <= opened, 2] == 0).all()
    mass = 2500.0 * math.pi / 6.0 * 0.005**3
    assert passed[:, 1] == pytest.approx(passed[:, 2] * mass, rel=1e-5)
    assert passed[-1, 2] == 60
    for step, rows in frames(hopper).items():
        assert rows[:, 5].min(initial=1.0) > -0.012
        assert len(rows) >= 60 - passed[np.searchsorted(passed[:, 0], step), 2] - 5  # deleted at the next list


def test_walls_carry_the_weight_while_the_plug_is_closed(hopper: Path) -> None:
    model = plan_of(HOPPER.replace("POSITIONS", str(GRID)), until=0.8)
    opened = round(when(0.4, model.coupling) / model.dt)
    forces = {name: table(hopper / f"force_{name}.txt") for name in ("tube", "cone", "plug")}
    assert forces["plug"][-1, 0] <= opened
    sign = {"tube": 1.0, "cone": -1.0, "plug": -1.0}  # of a primitive LIGGGHTS tells the force on the particles
    total = sum(sign[name] * rows[rows[:, 0] <= opened][-6:, 3].mean() for name, rows in forces.items())
    assert total == pytest.approx(60 * WEIGHT, rel=0.1)  # they have not quite come to rest


def test_a_particle_that_is_lost_behind_a_deleting_outlet_ends_the_run_without_its_mark(tmp_path: Path) -> None:
    """LIGGGHTS takes deleted particles for lost ones, so its own check is off: the deck counts them itself."""
    outlet = "[outlets.out]\nposition = -0.01\n"
    model = plan_of(placed((0.0, 0.0, 0.0), (0.0, 0.0, 0.01)) + "velocity = [2.0, 0.0, 0.0]\n" + outlet)
    with pytest.raises(AssertionError, match="Lost particles: 2"):
        run_by_hand(model, tmp_path)
    assert "KNCAL_DONE" not in (tmp_path / "log.liggghts").read_text(errors="replace").splitlines()


def test_an_empty_box_does_not_end_a_run(tmp_path: Path) -> None:
    """All have left when a wall goes: LIGGGHTS has no size of particles then, and ends at the next set-up."""
    gate = '[walls.gate]\nshape = "disc"\ncentre = [0, 0, 0.1]\nradius = 0.01\nremove_at = 0.2\n'
    model = plan_of(f"{placed((0.0, 0.0, 0.0))}[outlets.out]\nposition = -0.01\n{gate}")
    run_by_hand(model, tmp_path)
    assert not len(list(frames(tmp_path).values())[-1])


def test_every_deck_has_one_line_of_output_whose_check_of_lost_particles_holds() -> None:
    """A second thermo_style drops what thermo_modify said before."""
    scenes = {"error": placed((0.0, 0.0, 0.0)), "ignore": HOPPER.replace("POSITIONS", str(GRID))}
    for lost, text in scenes.items():
        deck = driven_text(plan_of(text))
        assert deck.count("thermo_style") == 1
        assert deck.index("thermo_style") < deck.index(f"thermo_modify norm no lost {lost}")


def test_walls_of_a_run_that_goes_on_are_those_that_are_left() -> None:
    model = plan_of(HOPPER.replace("POSITIONS", str(GRID)), until=0.8)
    assert "mesh_3" in driven_text(model, time=when(0.4, model.coupling) - 0.5 * model.coupling)
    assert "mesh_3" not in driven_text(model, time=when(0.4, model.coupling))
    assert isinstance(bed_deck(model, start_at(model)).walls[0], DeckWall)


FIXED = """
[particles.anvil]
material = "glass"
diameter = 0.005
position = [0.0, 0.0, 0.0]
frozen = true
[particles.bead]
material = "glass"
diameter = 0.005
position = [0.0, 0.0, 0.00505]
velocity = [0.0, 0.0, -0.5]
"""


@pytest.mark.parametrize("kind", ["linear", "hertz"])
def test_a_frozen_particle_stays_and_is_infinitely_heavy_to_others(kind: str, tmp_path: Path) -> None:
    """So the restitution is the one asked for; with half the mass it would be another."""
    model = plan_of(FIXED, kind, until=0.01, gravity=0.0, sample=0.001, frames=0.001, steps_per_contact=100)
    run_by_hand(model, tmp_path)
    rows = list(frames(tmp_path).values())[-1]
    assert rows[0, 3:9] == pytest.approx(np.zeros(6))
    assert rows[1, 8] == pytest.approx(0.5 * 0.5, rel=0.01)


RAIN = """
[particles.rain]
material = "glass"
diameter = 0.005
place = "stream"
count = 40
rate = 0.02
region = {low = [-0.02, -0.02, 0.07], high = [0.02, 0.02, 0.1]}
[walls.box]
shape = "box"
size = [0.05, 0.05, 0.11]
low = [-0.025, -0.025, 0.0]
[walls.plate]
shape = "plate"
corner = [-0.03, -0.03, 0.01]
edge_1 = [0.06, 0.0, 0.0]
edge_2 = [0.0, 0.06, 0.0]
"""


@pytest.mark.parametrize("by_hand", [True, False])
def test_a_scene_begins_without_particles_where_all_flow_in(by_hand: bool, tmp_path: Path) -> None:
    """Of a file without particles LIGGGHTS says that they have no ids; with a mesh it dies where it has no screen."""
    model = plan_of(RAIN, until=0.5)
    write_deck(bed_deck(model, start_at(model), by_hand=by_hand), tmp_path, steps=model.n_steps)
    done = subprocess.run(["./Allrun"], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr
    left = (tmp_path / ("particles.dump" if by_hand else "settled.dump")).read_text().split("ITEM: NUMBER OF ATOMS")
    assert int(left[-1].split()[0]) == (40 if by_hand else 0)  # as a library kncal asks for each insertion


def test_a_deck_by_hand_moves_as_kncal_does_with_the_library(tmp_path: Path) -> None:
    """To rounding up to the first event, where each begins the next run in its way: half a step's force apart."""
    model = plan_of(HOPPER.replace("POSITIONS", str(GRID)), until=0.2)
    run_by_hand(model, tmp_path / "hand")
    with LiggghtsDem(model, tmp_path / "library", start_at(model)) as dem:
        for coupling in range(1, model.couplings + 1):
            dem.run(model.steps_per_coupling)
            dem.end_interval(coupling)
            if coupling % model.frames_every == 0:
                there = frames(tmp_path / "hand")[coupling * model.steps_per_coupling]
                assert dem.state().x == pytest.approx(there[:, 3:6], abs=1e-12)
                assert dem.state().spin == pytest.approx(there[:, 9:12], abs=1e-6)


def test_a_contact_that_opened_is_forgotten_before_its_gap_outgrows_the_distance() -> None:
    """At four times the speed of the calibration; with a shorter step a smaller distance is enough, and costs less."""
    found = []
    for steps in (20, 200):
        model = plan_of(placed((0.0, 0.0, 0.0)), steps_per_contact=steps)
        near = bed_deck(model).near
        assert (near - 1.0) * 2.0 * R > 3.99 * 0.5 * model.dt
        found.append(near)
    assert found[1] < found[0]
