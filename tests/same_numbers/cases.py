"""Cases of the first format, always the same ones: every shipped case and 220 random ones, as TOML tables by name."""

from __future__ import annotations

import random
import tomllib
from pathlib import Path

LAWS = ["tsuji", "hertz", "kuwabara_kono", "hunt_crossley"]
METHODS = ["mean_overlap", "max_overlap", "contact_duration", "strain_energy"]


def shipped(root: Path):
    return {p.parent.name: tomllib.loads(p.read_text()) for p in sorted((root / "cases").glob("*/case.toml"))}


def material(r):
    m = {"young": 10 ** r.uniform(5, 11), "poisson": r.uniform(0.05, 0.45), "density": r.uniform(500, 8000)}
    return m


def contact(r, names, methods):
    c = {"law": r.choice(LAWS), "e_n": round(r.uniform(0.35, 0.99), 3)}
    if r.random() < 0.15:
        c["k_n"] = 10 ** r.uniform(1, 5)
    else:
        c["method"] = r.choice(methods)
    if r.random() < 0.5:
        c["friction"] = round(r.uniform(0, 0.8), 2)
    if r.random() < 0.3:
        c["k_t_ratio"] = round(r.uniform(0.2, 1.0), 3)
    if r.random() < 0.2:
        c["rolling_friction"] = 0.01
    if r.random() < 0.3:
        c["end"] = "force"
    if c["law"] == "hertz":
        c["e_n"] = 1.0
    return c


def single(r, i, methods):
    mats = {f"m{k}": material(r) for k in range(r.randint(1, 3))}
    names = list(mats)
    n = r.randint(1, 4)
    d = 10 ** r.uniform(-3.3, -2)
    parts, z = [], 0.0
    for k in range(n):
        size = d * (1.0 if r.random() < 0.5 else r.uniform(0.5, 2.0))
        z += size * r.uniform(0.6, 1.2) + (d * 1.1 if k else 0)
        parts.append(
            {
                "name": f"p{k}",
                "material": r.choice(names),
                "diameter": size,
                "position": [0.0 if r.random() < 0.7 else 0.1 * d, 0.0, z + 0.5 * size],
                "velocity": [
                    0.0 if r.random() < 0.7 else r.uniform(-1, 1),
                    0.0,
                    -r.uniform(0.1, 3.0) * (1 if k == 0 else 1.5),
                ],
            }
        )
        if r.random() < 0.2:
            parts[-1]["spin"] = [0.0, r.uniform(-50, 50), 0.0]
        z += size
    t = {
        "title": f"generated {i}",
        "source": "ours",
        "materials": mats,
        "particles": parts,
        "contact": contact(r, names, methods),
        "run": {"steps_per_contact": r.choice([20, 50, 100])},
    }
    floor = {"name": "floor", "axis": "z", "position": 0.0}
    floor["material"] = r.choice([*names, "rigid"])
    t["walls"] = [floor]
    if r.random() < 0.3:
        t["walls"].append({"name": "side", "axis": "x", "position": -5 * d, "material": "rigid"})
    if r.random() < 0.7:
        t["gravity"] = [0.0, 0.0, -9.81]
    if r.random() < 0.4:
        t["run"]["until_time"] = 10 ** r.uniform(-3, -1)
    else:
        t["run"]["until_bounces"] = 1
    if len(t["walls"]) and r.random() < 0.3:
        t["contact"]["pairs"] = [{"between": ["p0", "floor"], "e_n": 0.7, "friction": 0.3}]
    t["tolerances"] = {"e_n": 0.05}
    return t


def bed(r, i, methods):
    d = 10 ** r.uniform(-3.2, -2.4)
    nx, nz = r.randint(4, 10), r.randint(12, 30)
    cell = d * r.uniform(2.0, 3.0)
    ny = r.choice([1, 2, 3])
    mats = {"bead": material(r)}
    mats["bead"]["young"] = 10 ** r.uniform(6.5, 8.5)
    r.random()  # keeps the cases what they were
    t = {
        "title": f"generated bed {i}",
        "source": "ours",
        "materials": mats,
        "column": {"width": nx * cell, "depth": ny * cell, "height": nz * cell, "cells": [nx, ny, nz]},
        "particles": {
            "count": int(nx * ny * nz * 0.25 * cell**3 / (0.5236 * d**3) * 0.55),
            "diameter": d,
            "material": "bead",
            "packing": "lattice",
        },
        "gas": {"density": r.uniform(0.5, 3.0), "viscosity": r.uniform(1e-5, 3e-5), "U_0": r.uniform(0.5, 3.0)},
        "contact": contact(r, ["bead"], methods),
        "run": {
            "end_time": round(r.uniform(0.05, 2.0), 3),
            "coupling": 10 ** r.uniform(-4.5, -3.3),
            "steps_per_contact": r.choice([20, 25, 50]),
        },
        "tolerances": {},
    }
    t["contact"]["v_0"] = r.uniform(0.05, 1.0)
    if r.random() < 0.3:
        t["column"]["wall_material"] = "bead"
    if r.random() < 0.3:
        t["column"]["front_back"] = "periodic"
    if r.random() < 0.3:
        t["gas"]["drag"] = "PlessisMasliyah"
    if r.random() < 0.2:
        t["run"]["gas_step"] = t["run"]["coupling"] / 3
    if r.random() < 0.15:
        t["particles"]["frozen"] = True
    if r.random() < 0.3:
        t["contact"]["pairs"] = [{"between": ["particles", "walls"], "e_n": 0.6}]
    if r.random() < 0.2:
        del t["gas"]["U_0"]
        t["gas"]["jet"] = {"x_low": cell * (nx // 2 - 1), "x_high": cell * (nx // 2 + 1), "velocity": r.uniform(5, 30)}
    return t


def generated():
    r = random.Random(20130707)  # noqa: S311
    out = {}
    for i in range(150):
        out[f"g{i:03d}"] = single(r, i, METHODS)
    for i in range(90):
        out[f"b{i:03d}"] = bed(r, i, METHODS)
    return out
