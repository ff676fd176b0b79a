"""Streams that LIGGGHTS inserts, and runs that go on with walls that move."""

from __future__ import annotations

import math
import re
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from granular import frames, placed, plan_of, start_at

from kncal.core.checks import Array
from kncal.engines.liggghts.deck import DECK, bed_deck, data_text, write_deck
from kncal.engines.liggghts.deck_flow import LEAST_SEED, primes
from kncal.scene.placement import Start
from kncal.scene.wall_motion import pose

solver = pytest.mark.solver


def test_seeds_are_different_primes_above_ten_thousand_of_the_users_seed() -> None:
    found = primes((3, 1), 50)
    assert found == primes((3, 1), 50)
    assert len(set(found)) == 50
    assert not set(found) & set(primes((3, 2), 50))
    for seed in found:
        assert seed > LEAST_SEED > 10_000
        assert all(pow(base, seed - 1, seed) == 1 for base in (2, 3, 5, 7, 11))  # Fermat, another way than theirs


STREAM = """
[particles.rain]
material = "glass"
count = 80
place = "stream"
rate = 0.02
start = 0.05
velocity = [0.0, 0.0, -0.5]
seed = 7
region = {shape = "box", low = [-0.02, -0.02, 0.08], high = [0.02, 0.02, 0.11]}
[particles.rain.sizes]
by = "number"
shares = [[0.003, 0.75], [0.005, 0.25]]
[walls.floor]
axis = "z"
position = 0.0
material = "glass"
[walls.tray]
shape = "cylinder"
radius = 0.03
"""


@solver
def test_a_stream_brings_its_mass_per_time_in_its_sizes_until_all_are_there(tmp_path: Path) -> None:
    model = plan_of(STREAM, until=0.4)
    start = Start.at(np.zeros((0, 3)))
    write_deck(bed_deck(model, start, by_hand=True), tmp_path)
    done = subprocess.run(["./Allrun"], cwd=tmp_path, capture_output=True, text=True, errors="replace", check=False)
    assert done.returncode == 0, done.stdout
    assert "WARNING" not in done.stdout
    mass = {2: 2500.0 * math.pi / 6.0 * 0.005**3, 1: 2500.0 * math.pi / 6.0 * 0.003**3}
    mean = 0.75 * mass[1] + 0.25 * mass[2]
    every = [(step * model.dt, rows) for step, rows in frames(tmp_path).items()]
    for t, rows in every:
        expected = min(80.0, max(0.0, (t - 0.05) * 0.02 / mean))
        # how many come in each interval is rounded up or down at random, and those of one come at once
        times = max(0.0, t - 0.05) / 0.005
        assert len(rows) == pytest.approx(expected, abs=0.005 * 0.02 / mean + 1.0 + 2.0 * math.sqrt(times))
        assert sorted(rows[:, 0]) == list(range(1, len(rows) + 1))
    last = every[-1][1]
    assert len(last) == 80
    assert (last[:, 1] == 2).sum() == pytest.approx(20, abs=12)
    assert last[:, 2] == pytest.approx(np.where(last[:, 1] == 2, 0.0025, 0.0015))


@solver
def test_a_deck_without_a_particle_at_the_start_is_set_up(tmp_path: Path) -> None:
    """`run 0` fails where LIGGGHTS knows no size of particles; a stream's templates tell it."""
    deck = bed_deck(plan_of(STREAM), Start.at(np.zeros((0, 3))))
    write_deck(deck, tmp_path)
    _run(tmp_path, 0, "units         si", "units         si")
    assert deck.start is not None
    assert "0 atoms" in data_text(deck, deck.start)


WHEEL = """
[walls.wheel]
shape = "plate"
corner = [0.004, 0.0, 0.05]
edge_1 = [0.01, 0.0, 0.0]
edge_2 = [0.0, 0.002, 0.01]
[[walls.wheel.motion]]
kind = "translate"
velocity = [0.1, 0.0, 0.0]
[[walls.wheel.motion]]
kind = "rotate"
axis = [0, 0, 1]
period = 0.1
[[walls.wheel.motion]]
kind = "oscillate"
amplitude = [0.0, 0.0, 0.002]
period = 0.06
"""


def nodes(path: Path) -> Array:
    return np.array([line.split()[1:] for line in path.read_text().splitlines() if "vertex" in line], dtype=np.float64)


def _run(folder: Path, steps: int, old: str, new: str) -> None:
    text = (folder / DECK).read_text()
    assert old in text
    (folder / DECK).write_text(text.replace(old, new, 1))
    done = subprocess.run(
        ["liggghts", "-in", DECK, "-var", "steps", str(steps)],
        cwd=folder,
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    assert done.returncode == 0, done.stdout


@solver
def test_a_run_that_goes_on_turns_a_wall_about_the_axis_that_was_carried_along(tmp_path: Path) -> None:
    """LIGGGHTS forgets at a restart that an axis moved: without a word the wall went another way."""
    model = plan_of(placed((0.02, 0.02, -0.01)) + WHEEL, gravity=0.0, until=0.1)
    first, then = tmp_path / "first", tmp_path / "then"
    half, n = 10 * model.steps_per_coupling, model.n_steps
    time = half * model.dt
    dump = f"dump w all mesh/stl {model.steps_per_coupling} wall*.stl\nthermo_style"
    first.mkdir()
    write_deck(bed_deck(model, start_at(model)), first)
    _run(first, half, "print         ", "write_restart particles.restart\nprint         ")
    then.mkdir()
    write_deck(bed_deck(model, time=time), then)
    (first / "particles.restart").rename(then / "particles.restart")
    _run(then, n - half, "thermo_style", dump)
    (wheel,) = bed_deck(model, time=time).walls
    assert wheel.triangles is not None
    found = sorted((int(re.sub(r"\D", "", path.name)), path) for path in then.glob("wall[0-9]*.stl"))
    assert found[0][0] == half
    for step, path in found:
        expected = pose(wheel.wall.motion, step * model.dt, model.coupling).placed(wheel.triangles.reshape(-1, 3))
        assert np.abs(nodes(path) - expected).max() < 0.002 * 2.0 * math.pi / 0.06 * model.dt + 1e-6
    assert all(np.abs(nodes(b) - nodes(a)).max() > 1e-5 for (_, a), (_, b) in pairwise(found))
