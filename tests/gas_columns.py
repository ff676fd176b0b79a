"""Small columns of gas and packings made by hand, for tests of the gas side."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kncal.core.checks import Array
from kncal.engines.base import GasSetup

RHO_G, MU, G = 1.2, 1.8e-5, 9.81
D, RHO = 1.2e-3, 1000.0
VOLUME = np.pi / 6.0 * D**3

#: What starts the real OpenFOAM
needs_openfoam = [
    pytest.mark.solver,
    pytest.mark.skipif(shutil.which("DPMFoam") is None, reason="OpenFOAM is not installed (apt-get install openfoam)"),
]


def setup(cells: tuple[int, int, int] = (5, 2, 15), h: float = 3e-3, **changes: Any) -> GasSetup:
    """A column of cubic cells with side ``h`` [m]."""
    given: dict[str, Any] = {
        "size": tuple(h * n for n in cells),
        "cells": cells,
        "inlet": 0.3,
        "jet": None,
        "density": RHO_G,
        "viscosity": MU,
        "gravity": G,
        "step": 5e-4,
    }
    return GasSetup(**(given | changes))


def packing(box: tuple[float, float, float], seed: int = 0, pitch: float = 1.08 * D) -> Array:
    """Centres (n, 3) of a lattice that fills ``box`` [m] evenly, each moved at random by up to 4 % of the pitch."""
    axes = []
    for length in box:
        count = int(length / pitch)
        axes.append((np.arange(count) + 0.5) * length / count)
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return x + np.random.default_rng(seed).uniform(-0.04 * pitch, 0.04 * pitch, x.shape)


def alike(x: Array) -> tuple[Array, Array]:
    """Diameters and densities of equal particles at ``x``."""
    return np.full(len(x), D), np.full(len(x), RHO)


def weight(x: Array) -> float:
    """Weight of equal particles [N]."""
    return len(x) * RHO * VOLUME * G


def read_case(case: Path) -> Any:
    """Mesh, fields, patches and parcels of the last written time, as ParaView reads them."""
    import pyvista

    reader = pyvista.OpenFOAMReader(str(case / "system" / "controlDict"))
    reader.enable_all_patch_arrays()
    reader.reader.EnableAllLagrangianArrays()
    reader.set_active_time_value(max(reader.time_values))
    return reader.read()
