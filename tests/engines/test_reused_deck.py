"""A rendered deck used further: its tables hold for every pair of its types, also those its scene has no use for."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from kncal import calibrate, pair, wall_pair
from kncal.engines.liggghts.batch import Liggghts
from kncal.physics.material import Material
from kncal.scene.bodies import Particle, Wall
from kncal.scene.contact import ContactChoice, PairChoice
from kncal.scene.plan import plan
from kncal.scene.run_control import RunControl
from kncal.scene.scene import Scene

pytestmark = pytest.mark.solver

GLASS = Material(young=5e7, poisson=0.25, density=2500.0, name="glass")
STEEL = Material(young=2e11, poisson=0.3, density=7800.0, name="steel")
SMALL, SPEED, E_N, E_N_FLOOR = 1e-3, 1.0, 0.9, 0.6
#: Steps in the shortest contact.
STEPS = 200


def one_small_one_large(ratio: float) -> Scene:
    """A small sphere that flies at a large one: no two small or two large ones meet, and nothing meets the floor."""
    large = ratio * SMALL
    return Scene.of(
        name="two_sizes",
        spheres=(
            Particle(name="small", material=GLASS, radius=SMALL, position=(0.0, 0.0, 1.0), velocity=(SPEED, 0.0, 0.0)),
            Particle(name="large", material=GLASS, radius=large, position=(1.1 * SMALL + large, 0.0, 1.0)),
        ),
        planes=(Wall(name="floor", axis="z", position=0.0, material=STEEL),),
        contact=ContactChoice(e_n=E_N, v_0=SPEED, pairs=(PairChoice(between=("glass", "steel"), e_n=E_N_FLOOR),)),
        run=RunControl(until_time=1e-4),
    )


def used_further(deck: str, ratio: float, dt: float, steps: int) -> str:
    """The deck with its own box, step and particles: each pair of types and the floor, all far apart."""
    head = deck[: deck.index("# Particle ")]
    far = 25.0 * ratio * SMALL
    box = f"region        box block {-far} {10 * far} {-far} {far} 0 {far} units box"
    head = re.sub(r"^region .*$", box, head, flags=re.MULTILINE)
    head = re.sub(r"^timestep .*$", f"timestep {dt!r}", head, flags=re.MULTILINE)
    radius = {1: SMALL, 2: ratio * SMALL}
    gap, height = 1e-3 * SMALL, 10.0 * ratio * SMALL
    atoms: list[tuple[int, float, float, float, float]] = []  # 1 small or 2 large, x, z, v_x, v_z
    for k, (one, other) in enumerate(((1, 1), (2, 2), (1, 2))):
        atoms += [
            (one, k * far, height, SPEED, 0.0),
            (other, k * far + radius[one] + radius[other] + gap, height, 0.0, 0.0),
        ]
    atoms += [(kind, (4 + kind) * far, radius[kind] + gap, 0.0, -SPEED) for kind in radius]
    lines = []
    for i, (kind, x, z, v_x, v_z) in enumerate(atoms, start=1):
        lines += [
            f"create_atoms {kind if ratio > 1.0 else 1} single {x!r} 0 {z!r} units box",
            f"set atom {i} diameter {2 * radius[kind]!r} density {GLASS.density!r}",
            f"set atom {i} vx {v_x!r} vy 0 vz {v_z!r}",
        ]
    return head + "\n".join(
        [
            *lines,
            "fix motion all nve/sphere",
            f"dump end all custom {steps} end.dump id vx vz",
            'dump_modify end sort id format "%d %.17g %.17g"',
            f"run {steps}",
            "",
        ]
    )


@pytest.mark.parametrize("kind", ["linear", "hertz"])
@pytest.mark.parametrize("ratio", [1.0, 3.0, 10.0])
def test_every_pair_of_a_reused_deck_has_its_restitution(tmp_path: Path, kind: str, ratio: float) -> None:
    Liggghts().render(plan(one_small_one_large(ratio), [kind])[kind], tmp_path)
    shortest = calibrate(pair(GLASS, SMALL, GLASS, SMALL), v_0=SPEED, e_n=E_N).t_c
    longest = calibrate(wall_pair(GLASS, ratio * SMALL, STEEL), v_0=SPEED, e_n=E_N_FLOOR).t_c
    dt = shortest / STEPS
    steps = int((1.5 * longest + 1e-3 * SMALL / SPEED) / dt)
    text = used_further((tmp_path / "in.liggghts").read_text(), ratio, dt, steps)
    (tmp_path / "reused").write_text(text)
    command = ["liggghts", "-in", "reused"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    v = np.loadtxt((tmp_path / "end.dump").read_text().splitlines()[-8:])[:, 1:]
    for name, i, j in (("small–small", 0, 1), ("large–large", 2, 3), ("small–large", 4, 5)):
        assert v[j, 0] - v[i, 0] == pytest.approx(E_N * SPEED, rel=2e-3), name
    for name, i in (("small–floor", 6), ("large–floor", 7)):
        assert v[i, 1] == pytest.approx(E_N_FLOOR * SPEED, rel=2e-3), name
