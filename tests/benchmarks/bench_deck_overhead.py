"""CPU time of rendered decks against minimal hand-written decks of the same scenes, without and with recording.

Run: python tests/benchmarks/bench_deck_overhead.py [runs]

Every round runs the three decks of a scene in random order; printed are medians of the ratios within a round, since
the speed of a shared machine drifts. Target: at most 1.05 against the deck that records nothing.
"""

from __future__ import annotations

import random
import statistics
import sys
import tempfile
from pathlib import Path

from kncal.core.process import run_process, solver_environment
from kncal.core.shipped import folder as shipped_folder
from kncal.engines.liggghts.batch import Liggghts
from kncal.physics.material import Material
from kncal.scene.bodies import Particle, Wall
from kncal.scene.case_file import load_case
from kncal.scene.contact import ContactChoice
from kncal.scene.model import Plan
from kncal.scene.plan import plan
from kncal.scene.run_control import RunControl
from kncal.scene.scene import Scene

GLASS = Material(young=7e10, poisson=0.22, density=2500.0, name="glass")


def glass_bead_drop() -> Scene:
    """A 2 mm bead of real glass falls by 1 cm: many steps of flight, one contact of 50 steps."""
    return Scene.of(
        name="glass_bead_drop",
        spheres=(Particle(name="bead", material=GLASS, radius=1e-3, position=(0.0, 0.0, 0.011)),),
        planes=(Wall(name="floor", axis="z", position=0.0, material=GLASS),),
        gravity=(0.0, 0.0, -9.81),
        contact=ContactChoice(e_n=0.9),
        run=RunControl(until_time=0.06),
    )


def minimal(model: Plan, record: bool) -> str:
    """The shortest deck that a person would write for one bead over one floor normal to z."""
    (bead,), (floor,) = model.scene.spheres, model.scene.planes
    (contact,) = model.contacts.values()
    z = [bead.position[2], floor.position]
    margin = 4.0 * bead.radius
    if model.kind == "linear":
        style, switch = "hooke/stiffness", "absolute_damping on"
        properties = {"kn": contact.k, "kt": 0.0, "gamman_abs": contact.c, "gammat_abs": 0.0}
        per_type = {}
    else:
        style, switch = "hertz", ""
        properties = {"coefficientRestitution": contact.e_n}
        rigid = 1e17 * float(bead.material.young)
        wall_young = rigid if floor.material is None else floor.material.young
        wall_poisson = 0.0 if floor.material is None else floor.material.poisson
        per_type = {
            "youngsModulus": (bead.material.young, wall_young),
            "poissonsRatio": (bead.material.poisson, wall_poisson),
        }
    fixes = [
        f"fix {n} all property/global {n} peratomtypepair 2 {v!r} {v!r} {v!r} {v!r}" for n, v in properties.items()
    ]
    fixes += [f"fix {n} all property/global {n} peratomtype {a!r} {b!r}" for n, (a, b) in per_type.items()]
    width = f"{-margin!r} {margin!r}"
    lines = [
        "units si",
        "hard_particles yes",
        "soft_particles yes",
        "atom_style granular",
        "boundary f f f",
        "newton off",
        "communicate single vel yes",
        f"region box block {width} {width} {min(z) - margin!r} {max(z) + margin!r} units box",
        "create_box 2 box",
        f"neighbor {0.5 * bead.radius!r} bin",
        "neigh_modify delay 0",
        *fixes,
        f"pair_style gran model {style} tangential off {switch}",
        "pair_coeff * *",
        f"timestep {model.dt!r}",
        f"fix w all wall/gran model {style} tangential off primitive type 2 zplane {floor.position!r} {switch}",
        f"create_atoms 1 single 0.0 0.0 {bead.position[2]!r} units box",
        f"set group all diameter {2.0 * bead.radius!r} density {bead.material.density!r} vz {bead.velocity[2]!r}",
        f"fix g all gravity {-model.scene.gravity[2]!r} vector 0 0 -1",
        "fix mv all nve/sphere",
    ]
    if record:
        columns = "id type x y z vx vy vz omegax omegay omegaz fx fy fz"
        lines += [
            f"dump d all custom {model.record_every} particles.dump {columns}",
            'dump_modify d sort id format "%d %d' + " %.17g" * 12 + '"',
        ]
    lines += [
        "thermo_style custom step atoms ke",
        "thermo_modify norm no lost error",
        f"thermo {max(1, model.n_steps // 100)}",
        f"run {model.n_steps}",
    ]
    return "\n".join(lines) + "\n"


def cpu_seconds(folder: Path) -> float:
    """CPU time of one run of the deck in ``folder`` [s]."""
    result = run_process(
        ["liggghts", "-in", "in.liggghts", "-log", "none"], cwd=folder, log=folder / "screen", env=solver_environment()
    )
    if result.returncode != 0:
        raise SystemExit(f"{folder}: {result.last_lines}")
    return result.cpu_seconds


def bench(model: Plan, runs: int) -> None:
    """Print the ratios of one model; recording every step is left out where it would write more than 1e5 frames."""
    with tempfile.TemporaryDirectory() as scratch:
        folders = {name: Path(scratch) / name for name in ("rendered", "minimal", "every_step")}
        if model.n_steps > 100_000 * model.record_every:
            del folders["every_step"]
        for name, folder in folders.items():
            folder.mkdir()
            if name == "rendered":
                Liggghts().render(model, folder)
            else:
                (folder / "in.liggghts").write_text(minimal(model, name == "every_step"), encoding="ascii")
        samples: dict[str, list[float]] = {name: [] for name in folders}
        for _ in range(runs):
            for name in random.sample(list(folders), len(folders)):
                samples[name].append(cpu_seconds(folders[name]))
        frames = (folders["rendered"] / "particles.dump").read_text(encoding="ascii").count("ITEM: TIMESTEP")

    def ratio(name: str) -> str:
        if name not in samples:
            return "    -"
        return f"{statistics.median(a / b for a, b in zip(samples['rendered'], samples[name], strict=True)):5.3f}"

    print(
        f"{model.scene.name:18s} {model.kind:7s} {model.n_steps:8d} {frames:7d} "
        f"{statistics.median(samples['rendered']):8.3f} {ratio('minimal'):>12s} {ratio('every_step'):>12s}"
    )


def main() -> None:
    """Print one line per scene and model."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 15
    falling = load_case(shipped_folder("cases") / "falling_particle" / "case.toml")
    print("scene              model      steps  frames  CPU [s]    / minimal / every step")
    for scene in (falling, glass_bead_drop()):
        for model in plan(scene).values():
            bench(model, runs)


if __name__ == "__main__":
    if Liggghts().profile().program is None:
        raise SystemExit(Liggghts().profile().problem)
    main()
