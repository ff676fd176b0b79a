"""What docs/validation.md compares: `ENTRIES`.

A new row is one more `Entry`. Of a case whose expected.json has the metric, `expected` needs no number.
"""

from __future__ import annotations

import json

import numpy as np
from validation_chung_ooi import CHUNG_OOI
from validation_entry import BOTH, Entry, expected
from validation_flowing import FLOWING

from kncal.core.errors import InputError
from kncal.core.shipped import folder
from kncal.observe.run_data import RunData
from kncal.observe.signals import rows_from

_DEM, _GAS, _SLIDING = "MFIX's DEM01 to DEM06", "Particles and gas", "sliding, closed form"
_GRAINS, _FARR = "Many particles without gas", "Farr & Groot (2009)"


def _stacked(run: RunData) -> float:
    """Largest distance of the particles from the positions in expected.json, over 0.1 mm."""
    case = folder("cases") / run.model.scene.name / "expected.json"
    frames, apart = run.trajectory, []
    for name, known in json.loads(case.read_text("utf-8"))["positions"][run.model.kind].items():
        path = frames.x[:, frames.names.index(name), "xyz".index(known["axis"])]
        apart.append(np.abs(np.interp(known["t"], frames.t, path) - known["value"]).max())
    return float(max(apart) / 1e-4)


def _floor_by_janssen(run: RunData) -> float:
    """Force on the floor over what Janssen's law gives for the length that is fitted to the wall's forces."""
    seen = run.grains
    if seen is None:
        raise InputError(f"{run.model.scene.name}: no particles without gas")
    rows, limit = rows_from(seen.series, seen.window.begin), seen.silo.limit
    weight = float(seen.series.mass[-1]) * seen.series.facts.gravity
    return float(seen.carried[0][rows].mean() / (limit * -np.expm1(-weight / limit)))


MFIX = [
    expected(_DEM, "DEM01, 02: first rebound height", "falling_particle", "rebound_height", "motion with gravity"),
    expected(_DEM, "DEM01, 02: third rebound height", "falling_particle", "rebound_height_3", "motion with gravity"),
    Entry(
        section=_DEM,
        what="DEM03: largest deviation of a position, over 0.1 mm",
        source="matrix exponential",
        case="stacked_particles",
        metric="positions",
        models=("linear",),
        value=_stacked,
        reference=0.0,
        tolerance=0.005,
        scale=1.0,
    ),
    expected(_DEM, "DEM03: largest overlap at the floor", "stacked_particles", "delta_max_2", "equations of motion"),
    expected(_DEM, "DEM04: end of slip", "sliding_particle", "slip_end_time", "2 u/(7 mu g)"),
    expected(_DEM, "DEM04: speed then", "sliding_particle", "slip_end_speed", "(5/7) u"),
    expected(_DEM, "DEM05: tangential restitution at 45°", "oblique_impact", "tangential_restitution", _SLIDING),
    expected(_DEM, "DEM05: spin", "oblique_impact", "spin_out", _SLIDING),
    expected(_DEM, "DEM06: slip of a falling particle", "terminal_velocity", "slip", "equation of motion", "linear"),
]

GAS = [
    expected(_GAS, "slip at Re 68", "terminal_velocity_intermediate", "slip", "equation of motion", "linear"),
    expected(_GAS, "pressure gradient of a packed bed", "packed_bed", "ergun_ratio", "Ergun (1952)", "linear"),
    expected(_GAS, "U_mf of NETL's beads", "fluidization_curve", "U_mf", "measured, NETL SSCP-I", "linear", long=True),
]

GRAINS = [
    expected(_GRAINS, "mass flow of a conical hopper", "hopper", "mass_flow", "Beverloo et al. (1961)", long=True),
    expected(_GRAINS, "mass flow through a slot", "hopper_flat", "mass_flow", "Myers & Sellers", long=True),
    expected(_GRAINS, "frictionless packing of two sizes", "binary_packing", "packing_fraction", _FARR, long=True),
    expected(_GRAINS, "its contacts per sphere", "binary_packing", "coordination", "isostatic", long=True),
    expected(_GRAINS, "dynamic angle of a rolling drum", "drum", "dynamic_angle", "22° to 32°, as quoted", long=True),
    expected(_GRAINS, "force on the drum over weight", "drum", "support", "momentum", long=True),
    expected(_GRAINS, "angle of repose", "heap", "angle_of_repose", "18° to 25°, as quoted", long=True),
    expected(_GRAINS, "packing of the heap", "heap", "packing_fraction", "Silbert et al. (2002)", long=True),
    expected(_GRAINS, "force on floor and wall over weight", "silo", "support", "weight", long=True),
    expected(_GRAINS, "K μ of a silo", "silo", "janssen_k_mu", "Janssen (1895), K of 0.33 to 0.75", long=True),
    Entry(
        section=_GRAINS,
        what="floor force of the silo over that by its own K μ",
        source="Janssen (1895)",
        case="silo",
        metric="floor_by_janssen",
        models=BOTH,
        value=_floor_by_janssen,
        reference=1.0,
        tolerance=0.05,
        long=True,
    ),
    expected(_GRAINS, "mixing index of a mixer", "mixer", "mixing_index", "random: Lacey (1954)", long=True),
]

ENTRIES: tuple[Entry, ...] = (*CHUNG_OOI, *MFIX, *GAS, *GRAINS, *FLOWING)
