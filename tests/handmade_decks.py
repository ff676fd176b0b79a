"""LIGGGHTS decks written by hand for tests: every particle and every wall is a type of its own.

Kept apart from the project's templates, so that a test of the integrator does not lean on them.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np

from kncal.scene.bodies import Wall
from kncal.scene.model import Plan

COLUMNS = "id x y z vx vy vz omegax omegay omegaz fx fy fz"


def deck(model: Plan, every: int) -> str:
    """The input text for ``model``; a frame every ``every`` steps."""
    scene = model.scene
    types = {body.name: k for k, body in enumerate(scene.bodies, start=1)}
    n = len(types)
    pairs = {}
    for a, b in scene.body_pairs():
        i, j = types[a.name] - 1, types[b.name] - 1
        pairs[i, j] = pairs[j, i] = model.between(a.name, b.name)
    any_contact = next(iter(model.contacts.values()))

    def matrix(name: str, value: object) -> str:
        # pairs that cannot meet (wall and wall, a body and itself) need an entry all the same
        cells = [value(pairs.get((i, j), any_contact)) for i in range(n) for j in range(n)]  # type: ignore[operator]
        return f"peratomtypepair {n} " + " ".join(repr(float(c)) for c in cells)

    limits = []
    for k in range(3):
        spots = [p.position[k] for p in scene.spheres]
        spots += [w.position for w in scene.planes if w.axis == "xyz"[k]]
        room = 0.01 + max(abs(p.velocity[k]) for p in scene.spheres) * model.t_end
        limits += [repr(min(spots) - room), repr(max(spots) + room)]
    lines = [
        "units si",
        "atom_style granular",
        "atom_modify map array",
        "boundary f f f",
        "newton off",
        "communicate single vel yes",
        "hard_particles yes",
        f"region dom block {' '.join(limits)} units box",
        f"create_box {n} dom",
        "neighbor 0.0005 bin",
        "neigh_modify delay 0",
    ]
    properties = {"coefficientFriction": matrix("mu", lambda c: c.friction)}
    if model.kind == "linear":
        style = "hooke/stiffness"
        properties |= {
            "kn": matrix("kn", lambda c: c.k),
            "kt": matrix("kt", lambda c: c.k_t),
            "gamman": matrix("gamman", lambda c: c.c / c.m_eff),
            "gammat": matrix("gammat", lambda c: c.c_t / c.m_eff),
        }
    elif any_contact.law == "kuwabara_kono":
        style = "hertz/stiffness"
        properties |= {
            "kn": matrix("kn", lambda c: 4.0 / 3.0 * c.E_eff),
            "kt": matrix("kt", lambda c: 8.0 * c.G_eff),
            "gamman": matrix("gamman", lambda c: c.c / c.m_eff / c.R_eff**0.5),
            "gammat": matrix("gammat", lambda c: c.c_t / c.m_eff / c.R_eff**0.5),
        }
    else:
        style = "hertz"
        materials = [b.material for b in scene.bodies]
        assert all(m is not None for m in materials)
        properties |= {
            "youngsModulus": "peratomtype " + " ".join(repr(m.young) for m in materials if m),
            "poissonsRatio": "peratomtype " + " ".join(repr(m.poisson) for m in materials if m),
            "coefficientRestitution": matrix("e", lambda c: c.e_n),
        }
    memory = "history" if any_contact.spring else "no_history"
    switches = "tangential_damping " + ("on" if any(c.c_t for c in model.contacts.values()) else "off")
    switches += " limitForce on" if any_contact.end == "force" else ""
    lines += [f"fix p{k} all property/global {name} {text}" for k, (name, text) in enumerate(properties.items())]
    lines += [f"pair_style gran model {style} tangential {memory} {switches}", "pair_coeff * *"]
    lines.append(f"timestep {model.dt!r}")
    for wall in scene.planes:
        lines.append(
            f"fix {wall.name} all wall/gran model {style} tangential {memory} primitive "
            f"type {types[wall.name]} {wall.axis}plane {wall.position!r} {switches}"
        )
    for k, p in enumerate(scene.spheres, start=1):
        lines.append(f"create_atoms {k} single {' '.join(map(repr, p.position))} units box")
    for k, p in enumerate(scene.spheres, start=1):
        lines.append(f"set atom {k} diameter {2 * p.radius!r} density {p.material.density!r}")
        lines.append("set atom {} vx {!r} vy {!r} vz {!r}".format(k, *p.velocity))
        lines.append("set atom {} omegax {!r} omegay {!r} omegaz {!r}".format(k, *p.spin))
    size = float(np.linalg.norm(scene.gravity))
    if size > 0.0:
        lines.append(f"fix g all gravity {size!r} vector {' '.join(repr(g / size) for g in scene.gravity)}")
    lines += [
        "fix mv all nve/sphere",
        f"dump d all custom {every} frames.dump {COLUMNS}",
        'dump_modify d sort id first yes format "%d' + " %.17g" * 12 + '"',
        "thermo_style custom step atoms ke",
        "thermo_modify norm no lost error",
        f"run {model.n_steps}",
        'print "HANDMADE_DONE"',
    ]
    return "\n".join(lines) + "\n"


def run(model: Plan, folder: Path, every: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Run ``model`` in LIGGGHTS; return steps and (frames, particles, 12) in the order of `COLUMNS`."""
    (folder / "in.liggghts").write_text(deck(model, every))
    done = subprocess.run(
        ["liggghts", "-in", "in.liggghts"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert "HANDMADE_DONE" in done.stdout, done.stdout[-2000:] + done.stderr[-500:]
    lines = (folder / "frames.dump").read_text().splitlines()
    n = len(model.scene.spheres)
    frames = [lines[k : k + 9 + n] for k in range(0, len(lines), 9 + n)]
    steps = np.array([int(frame[1]) for frame in frames])
    rows = np.array([[line.split()[1:] for line in frame[9:]] for frame in frames], dtype=float)
    assert steps[-1] == model.n_steps
    return steps, rows


def rebound_and_overlap(model: Plan, x: np.ndarray, v: np.ndarray) -> tuple[float, float]:
    """Speed of leaving (last frame) and largest overlap of the frames, of the first pair of bodies."""
    a, b = model.scene.body_pairs()[0]
    if isinstance(b, Wall):
        k = "xyz".index(b.axis)
        return float(abs(v[-1, 0, k])), float(np.max(a.radius - np.abs(x[:, 0, k] - b.position)))
    gap = x[:, 1] - x[:, 0]
    distance = np.linalg.norm(gap, axis=1)
    leaving = float((v[-1, 1] - v[-1, 0]) @ gap[-1] / distance[-1])
    return leaving, float(np.max(a.radius + b.radius - distance))
