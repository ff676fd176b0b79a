"""The block to paste, pasted: every pair and wall rebounds as asked, in the real LIGGGHTS, sizes 1:1 to 1:10."""

from __future__ import annotations

import re
import subprocess
from itertools import combinations_with_replacement

import numpy as np
import pytest

from kncal import Material, RenderError, calibrate, calibrate_matrix, matrix_block, predict_error, wall_pair

pytestmark = pytest.mark.solver

GLASS = Material(young=7e9, poisson=0.22, density=2500.0)
STEEL = Material(young=2.1e11, poisson=0.3, density=7800.0)
V, MU, SLIDE = 0.5, 0.1, 2.0  # impact speed, friction, tangential speed: far above what a sphere can stick at
N = 100.0  # steps in the shortest contact
# all different, so that no entry can stand in for another
RESTITUTION = {
    ("small", "small"): 0.9,
    ("small", "large"): 0.8,
    ("large", "large"): 0.7,
    ("small", "floor"): 0.85,
    ("small", "rigid"): 0.75,
    ("large", "floor"): 0.65,
    ("large", "rigid"): 0.6,
}


def pasted(folder, block: str, radius: dict[str, float], density: dict[str, float], duration: float) -> np.ndarray:
    """Paste ``block`` into a deck with every pair of spheres, and every sphere on floor (z = 0) and lid, meeting at V.

    One more small sphere slides along the floor. Returns rows (vx, vy, vz) after ``duration``, in order of the pairs.
    """
    size = int(re.search(r"create_box (\d+)", block)[1])
    types = {name: int(i) for i, name in re.findall(r"(\d+) = ([\w.-]+)", block)}
    dt = float(re.search(r"^timestep (\S+)$", block, re.MULTILINE)[1])
    wall = re.search(r"^# (fix NAME all wall/gran .* primitive )type \d+ zplane \S+ (.*)$", block, re.MULTILINE)
    biggest = max(radius.values())
    gap, pitch, lid = 0.37 * V * dt, 5.0 * biggest, 20.0 * biggest
    atoms = []
    for a, b in combinations_with_replacement(radius, 2):
        x, apart = pitch * len(atoms), radius[a] + radius[b] + gap
        atoms += [(a, (x, 0.0, lid / 2), (0.0, V / 2, 0.0)), (b, (x, apart, lid / 2), (0.0, -V / 2, 0.0))]
    for a, r in radius.items():
        for z, v in ((r + gap, -V), (lid - r - gap, V)):
            atoms.append((a, (pitch * len(atoms), 0.0, z), (0.0, 0.0, v)))
    atoms.append(("small", (pitch * len(atoms), 0.0, radius["small"] + gap), (SLIDE, 0.0, -V)))
    lines = ["units si", "atom_style granular", "atom_modify map array", "boundary m m m", "newton off"]
    lines += ["communicate single vel yes"]
    lines += [f"region box block {-pitch} {pitch * len(atoms)} {-pitch} {pitch} {-pitch} {lid + pitch} units box"]
    lines += [f"create_box {size} box", f"neighbor {biggest} nsq", "neigh_modify delay 0", block]
    for name, z in (("floor", 0.0), ("rigid", lid))[: len(types) - len(radius)]:
        lines.append(wall[1].replace("NAME", name) + f"type {types[name]} zplane {z!r} {wall[2]}")
    lines += [f"create_atoms {types[a]} single {x!r} {y!r} {z!r} units box" for a, (x, y, z), _ in atoms]
    for i, (a, _, (vx, vy, vz)) in enumerate(atoms, 1):
        lines.append(f"set atom {i} diameter {2 * radius[a]!r} density {density[a]!r} vx {vx!r} vy {vy!r} vz {vz!r}")
    lines += ["fix move all nve/sphere", "thermo_style custom step atoms ke", "thermo_modify norm no lost error"]
    lines += ["dump d all custom 1000000 last.dump id vx vy vz"]
    lines += ['dump_modify d sort id format "%d %.17g %.17g %.17g"']
    steps = int(duration / dt)
    lines += [f"run {steps}", "dump_modify d every 1", "run 1", 'print "PASTED_DONE"']
    (folder / "in.own").write_text("\n".join(lines) + "\n", encoding="ascii")
    done = subprocess.run(
        ["liggghts", "-in", "in.own"], cwd=folder, capture_output=True, text=True, timeout=60, check=False
    )
    assert "PASTED_DONE" in done.stdout, done.stdout[-2000:] + done.stderr[-500:]
    rows = [line.split() for line in (folder / "last.dump").read_text().splitlines()[-len(atoms) :]]
    return np.array(rows, dtype=float)[:, 1:]


def rebounds(rows: np.ndarray, names: list[str]) -> dict[tuple[str, str], float]:
    """The measured restitution of every pair and wall."""
    pairs = list(combinations_with_replacement(names, 2))
    found = {pair: (rows[2 * i + 1, 1] - rows[2 * i, 1]) / V for i, pair in enumerate(pairs)}
    on_walls = rows[2 * len(pairs) : -1, 2] / V
    for i, name in enumerate(names):
        found |= {(name, "floor"): on_walls[2 * i], (name, "rigid"): -on_walls[2 * i + 1]}
    return found


@pytest.mark.parametrize("end", ["overlap", "force"])
@pytest.mark.parametrize("ratio", [1.0, 3.0, 10.0])
@pytest.mark.parametrize("style", ["hooke/stiffness", "hooke", "hertz"])
def test_every_pair_and_wall_rebounds_as_asked(tmp_path, style, ratio, end):
    radius, density = {"small": 1e-3, "large": ratio * 1e-3}, {"small": GLASS.density, "large": STEEL.density}
    method = "strain_energy" if style == "hooke" else "mean_overlap"
    matrix = calibrate_matrix(
        {"small": (GLASS, radius["small"]), "large": (STEEL, radius["large"])},
        {"floor": STEEL, "rigid": None},
        v_0=V,
        e_n=RESTITUTION,
        method=method,
        end=end,
    )
    block = matrix_block(matrix, style, friction=MU, steps_per_contact=N)
    dt = float(re.search(r"^timestep (\S+)$", block, re.MULTILINE)[1])
    law = "tsuji" if style == "hertz" else "linear"
    duration = {pair: float(c.reference.t_c if style == "hertz" else c.t_c) for pair, c in matrix.calibrations.items()}
    assert min(duration.values()) / dt == pytest.approx(N, rel=1e-9)
    rows = pasted(tmp_path, block, radius, density, 2.0 * max(duration.values()))
    found = rebounds(rows, list(radius))
    assert set(found) == set(RESTITUTION)
    for pair, e_n in RESTITUTION.items():
        # the longer contacts have more steps, and smaller errors
        allowed = 1.05 * predict_error(law, e_n, N, end).worst["e_n"]
        assert allowed < 0.015  # the gamman of a pair would be 4 % off and more at a wall
        assert found[pair] == pytest.approx(e_n, rel=allowed), pair
    # Coulomb: the sphere slides all the time, so its tangential momentum changes by mu times the normal one
    assert SLIDE - rows[-1, 0] == pytest.approx(MU * (1.0 + RESTITUTION["small", "floor"]) * V, rel=0.02)


def one_step_on_the_floor(folder, block: str) -> float:
    """Paste ``block``; return the tangential force on a sphere that a step has moved along the floor."""
    model = re.search(r"^pair_style gran (.*)$", block, re.MULTILINE)[1]
    wall = re.search(r"^# (fix NAME .*)$", block, re.MULTILINE)[1].replace("NAME", "floor")
    text = f"""units si
atom_style granular
boundary m m m
newton off
communicate single vel yes
region box block -0.01 0.01 -0.01 0.01 -0.01 0.01 units box
create_box 2 box
neighbor 1e-3 nsq
{block}
{wall}
create_atoms 1 single 0 0 0.99e-3 units box
set group all diameter 2e-3 density 2500 vx 1e-3
fix move all nve/sphere
dump d all custom 1 step.dump fx
dump_modify d format "%.17g"
run 1
print "PASTED_DONE"
"""
    assert model in wall.replace(" primitive type 2 zplane 0.0", "")
    (folder / "in.own").write_text(text, encoding="ascii")
    done = subprocess.run(
        ["liggghts", "-in", "in.own"], cwd=folder, capture_output=True, text=True, timeout=60, check=False
    )
    assert "PASTED_DONE" in done.stdout, done.stdout[-2000:]
    return float((folder / "step.dump").read_text().split()[-1])


def test_hooke_has_the_tangential_stiffness_asked_for(tmp_path):
    matrix = calibrate_matrix({"small": (GLASS, 1e-3)}, {"floor": None}, v_0=V, e_n=1.0, method="strain_energy")
    dt = matrix.t_c / 50.0
    for k_t_ratio in (1.0, 2.0 / 7.0):
        force = one_step_on_the_floor(tmp_path, matrix_block(matrix, "hooke", friction=10.0, k_t_ratio=k_t_ratio))
        spring = -k_t_ratio * float(matrix["small", "floor"].k_n) * 1e-3 * dt
        assert force == pytest.approx(spring, rel=1e-3)  # it also bends by the turning of the sphere
    for k_t_ratio in (0.5, 0.0):
        with pytest.raises(RenderError, match="k_t_ratio"):
            matrix_block(matrix, "hooke", friction=0.1, k_t_ratio=k_t_ratio)


def test_liggghts_has_the_kuwabara_kono_contact(tmp_path):
    # hertz/stiffness: F = sqrt(R delta) (kn delta + gamman m v), so kn = k_h/sqrt(R), gamman = c/(m sqrt(R))
    e_n, steps = 0.8, 400
    contact = calibrate(wall_pair(GLASS, 1e-3), v_0=V, e_n=e_n, law="kuwabara_kono")
    m, R, k_h = contact.pair.m_eff, contact.pair.R_eff, contact.pair.k_h
    length = (m * V**2 / k_h) ** 0.4
    c = contact.reference.C * m * V / length**1.5
    numbers = {"kn": k_h / R**0.5, "kt": 0.0, "gamman": c / (m * R**0.5), "gammat": 0.0, "coefficientFriction": 0.0}
    model = "model hertz/stiffness tangential history"
    block = [f"fix {k} all property/global {k} peratomtypepair 2 " + f"{float(v)!r} " * 4 for k, v in numbers.items()]
    block += ["# create_box 2", "# atom types: 1 = small, 2 = floor", f"pair_style gran {model}", "pair_coeff * *"]
    block += [
        f"timestep {float(contact.reference.t_c) / steps!r}",
        f"# fix NAME all wall/gran {model} primitive type 2 zplane 0.0 ",
    ]
    rows = pasted(tmp_path, "\n".join(block), {"small": 1e-3}, {"small": 2500.0}, 2.0 * float(contact.reference.t_c))
    predicted = predict_error("kuwabara_kono", e_n, steps).worst["e_n"]
    assert predicted < 2e-3
    assert rows[2, 2] / V == pytest.approx(e_n, rel=1.05 * predicted)
