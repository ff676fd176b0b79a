"""CPU time of the rendered deck of a rotating drum against a minimal hand-written one with the same output.

Run: python tests/benchmarks/bench_granular_decks.py [rounds] [particles]

The rendered deck forgets the springs of contacts that opened, which the minimal one does not.

Every round runs both decks in random order; printed is the median of the ratios within a round, since the speed of a
shared machine drifts. Both write frames, and the force on the drum and on its ends at each interval. Target: at most
1.05.
"""

from __future__ import annotations

import random
import statistics
import sys
import tempfile
from pathlib import Path

import numpy as np

from kncal.core.process import run_process, solver_environment
from kncal.engines.liggghts.deck import bed_deck, write_deck
from kncal.scene.case_file import parse_case
from kncal.scene.model import Plan
from kncal.scene.placement import Start
from kncal.scene.plan import plan

DRUM = """
gravity = [0.0, 0.0, -9.81]
[materials.glass]
young = 5e6
poisson = 0.3
density = 2500
[contact]
v_0 = 0.5
e_n = 0.5
friction = 0.5
[domain]
low = [-0.07, -0.03, -0.07]
high = [0.07, 0.03, 0.07]
[run]
until_time = 0.4
sample_every = 0.005
frames_every = 0.02
steps_per_contact = 20
[particles.beads]
material = "glass"
diameter = 0.004
positions = POSITIONS
[walls.drum]
shape = "cylinder"
axis = "y"
radius = 0.06
low = -0.02
high = 0.02
material = "glass"
[[walls.drum.motion]]
kind = "rotate"
axis = [0, 1, 0]
period = 2.0
[walls.front]
axis = "y"
position = -0.02
material = "glass"
[walls.back]
axis = "y"
position = 0.02
material = "glass"
"""


def minimal(model: Plan) -> str:
    """The shortest deck that a person would write for the drum, with the same output."""
    contacts = model.contacts
    pair, wall = contacts[0, 0], contacts[0, 1]
    every, frames = model.steps_per_coupling, model.frames_every * model.steps_per_coupling
    values = {
        "kn": (pair.k, wall.k),
        "kt": (pair.k_t, wall.k_t),
        "gamman_abs": (pair.c, wall.c),
        "gammat_abs": (0.0, 0.0),
        "coefficientFriction": (pair.friction, wall.friction),
    }
    model_words = "hooke/stiffness tangential history"
    switches = "absolute_damping on tangential_damping off"
    plane = f"all wall/gran model {model_words} primitive type 2 yplane"
    sums = "all reduce sum f_force_{0}[1] f_force_{0}[2] f_force_{0}[3]"
    columns = "id type radius x y z vx vy vz omegax omegay omegaz"
    average = f"all ave/time {every} 1 {every}"
    lines = [
        "units si",
        "atom_style granular",
        "atom_modify map array",
        "newton off",
        "communicate single vel yes",
        "boundary f f f",
        "read_data particles.data",
        "neighbor 0.001 bin",
        "neigh_modify delay 0",
        *(f"fix {n} all property/global {n} peratomtypepair 2 {a!r} {b!r} {b!r} {b!r}" for n, (a, b) in values.items()),
        f"pair_style gran model {model_words} {switches}",
        "pair_coeff * *",
        f"timestep {model.dt!r}",
        f"fix front {plane} -0.02 store_force yes {switches}",
        f"fix back {plane} 0.02 store_force yes {switches}",
        "fix drum all mesh/surface/stress file wall_drum.stl type 2 curvature_tolerant yes",
        "fix g all gravity 9.81 vector 0 0 -1",
        f"fix meshes all wall/gran model {model_words} mesh n_meshes 1 meshes drum {switches}",
        "fix turn all move/mesh mesh drum rotate origin 0 0 0 axis 0 1 0 period 2.0",
        "fix mv all nve/sphere",
        f"dump d all custom {frames} particles.dump {columns}",
        'dump_modify d first yes sort id format "%d %d' + " %.17g" * 10 + '"',
        f"compute front {sums.format('front')}",
        f"compute back {sums.format('back')}",
        f"fix a {average} c_front[1] c_front[2] c_front[3] file front.txt",
        f"fix b {average} c_back[1] c_back[2] c_back[3] file back.txt",
        f"fix c {average} f_drum[1] f_drum[2] f_drum[3] file drum.txt",
        "thermo_style custom step atoms ke",
        "thermo_modify norm no lost error",
        "thermo 1000",
        f"run {model.n_steps}",
    ]
    return "\n".join(lines) + "\n"


def places(count: int) -> list[list[float]]:
    """Centres inside the drum, on a lattice from below."""
    steps = np.arange(-0.055, 0.055, 0.0043)
    grid = [(x, y, z) for z in steps for x in steps for y in np.arange(-0.0172, 0.0173, 0.0043)]
    return [[float(c) for c in place] for place in grid if np.hypot(place[0], place[2]) < 0.0565][:count]


def cpu_seconds(folder: Path) -> float:
    """CPU time of one run of the deck in ``folder`` [s]."""
    result = run_process(
        ["liggghts", "-in", "in.liggghts", "-log", "none"], cwd=folder, log=folder / "screen", env=solver_environment()
    )
    if result.returncode != 0:
        raise SystemExit(f"{folder}: {result.last_lines}")
    return result.cpu_seconds


def bench(kind: str, rounds: int, count: int) -> None:
    """Print the ratio for one model."""
    centres = places(count)
    model = plan(parse_case(DRUM.replace("POSITIONS", str(centres)), name="drum"))[kind]
    with tempfile.TemporaryDirectory() as scratch:
        folders = {name: Path(scratch) / name for name in ("rendered", "minimal")}
        for folder in folders.values():
            folder.mkdir()
            write_deck(bed_deck(model, Start.at(np.array(centres)), by_hand=True), folder)
        (folders["minimal"] / "in.liggghts").write_text(minimal(model))
        ratios = []
        for _ in range(rounds):
            order = random.sample(list(folders), len(folders))
            seconds = {name: cpu_seconds(folders[name]) for name in order}
            ratios.append(seconds["rendered"] / seconds["minimal"])
        print(
            f"drum of {len(centres)}, {kind}: rendered/minimal {statistics.median(ratios):.3f} "
            f"({min(ratios):.3f} to {max(ratios):.3f}, {rounds} rounds), {seconds['rendered']:.1f} s"
        )


if __name__ == "__main__":
    arguments = [int(text) for text in sys.argv[1:]]
    bench("linear", *(arguments + [5, 2000][len(arguments) :]))
