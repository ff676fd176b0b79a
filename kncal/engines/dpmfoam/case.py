"""A gas set-up as a case folder of OpenFOAM v1912 (DPMFoam): dictionaries, start fields, mesh.

The patch ``inlet`` is where gas enters: the whole floor, or the slot of a jet (the rest of the floor is then the
patch ``floor``). ``outlet`` is the top. Cells are counted as `kncal.engines.dpmfoam.grid.Grid.labels` says.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from kncal.core.checks import Array
from kncal.core.errors import InputError, ReadError, RenderError
from kncal.core.shipped import folder as shipped_folder
from kncal.core.templating import render
from kncal.engines.base import GasSetup
from kncal.engines.dpmfoam.decomposed import divisions
from kncal.engines.dpmfoam.grid import Grid
from kncal.physics.drag import DRAGS
from kncal.record.openfoam import read_cells, refuse_code, set_patch_vector

INLET, OUTLET = "inlet", "outlet"
#: The gas state between two steps: files of ``0/`` (binary). Nothing else is carried on.
STATE = ("U.air", "p", "phi.air")
#: Largest solid fraction of a cell; a fuller one would lose volume (seen in `GasStep.solids_error`).
SOLIDS_MAX = 0.9

_FILES = (
    "system/blockMeshDict",
    "system/controlDict",
    "system/fvSchemes",
    "system/fvSolution",
    "constant/g",
    "constant/transportProperties",
    "constant/turbulenceProperties.air",
    "constant/kinematicCloudProperties",
    "0/U.air",
    "0/p",
    "0/alpha.air",
    "0/alpha.air_0",
    "Allrun",
)
_DECOMPOSITION = "system/decomposeParDict"

Corner = Callable[[int, int, int], int]


def write_case(
    setup: GasSetup,
    folder: Path,
    *,
    end_time: float,
    write_interval: int = 1,
    functions: str | None = None,
    ranks: int = 1,
    oversubscribe: bool = False,
) -> None:
    """Write the case of ``setup`` into ``folder`` (made if missing); its mesh is that of ``blockMesh``.

    Parameters
    ----------
    setup : GasSetup
    folder : Path
    end_time : float
        The solver runs from 0 to here in steps of ``setup.step`` [s].
    write_interval : int
        Steps between written time folders.
    functions : str, optional
        Text of further entries of ``system/controlDict`` (``libs``, ``functions``), made by kncal, pasted as it is.
    ranks : int
        With more than one, ``system/decomposeParDict`` is written, and ``Allrun`` cuts the case up for that many.
    oversubscribe : bool
        Whether ``Allrun`` allows more ranks than cores.

    Raises
    ------
    InputError
        If a number or a name of the set-up cannot be; nothing is written.
    RenderError
        If ``folder`` already holds a case, or is not a folder.
    """
    check_setup(setup)
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()) or (folder / "system").exists():
        raise RenderError(f"{folder}: expected an empty folder for the gas case (or none yet), it holds something else")
    templates = shipped_folder("templates") / "openfoam"
    context = case_context(setup) | {"end_time": end_time, "write_interval": write_interval, "functions": functions}
    context |= {"ranks": ranks, "divisions": list(divisions(setup.cells, ranks)), "oversubscribe": oversubscribe}
    texts = {}
    for name in (*_FILES, _DECOMPOSITION) if ranks > 1 else _FILES:
        template = "0/alpha.air" if name == "0/alpha.air_0" else name
        texts[name] = render(templates, f"{template}.j2", context | {"field": name.rpartition("/")[2]})
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="ascii")
    (folder / "Allrun").chmod(0o755)
    (folder / "case.foam").touch()  # what ParaView opens


def set_case_inlet(setup: GasSetup, folder: Path, velocity: float) -> None:
    """Write the velocity at the inlet [m/s] into the start fields of a case (superficial; of a jet: in its slot)."""
    entry = "inletVelocity" if setup.jet is None else "value"
    set_patch_vector(folder / "0" / "U.air", INLET, entry, (0.0, 0.0, velocity))


def install_state(state: Path, folder: Path, cells: int) -> Array:
    """Copy a saved gas state (`STATE`) into the start fields of a case; return its velocity (cells, 3) [m/s].

    Raises
    ------
    ReadError
        If the state is not complete, or not that of a mesh with this number of cells; nothing is copied.
    """
    if missing := [name for name in STATE if not (state / name).is_file()]:
        raise ReadError(f"{state}: no {', '.join(missing)}; expected a saved gas state: {', '.join(STATE)}")
    U = read_cells(state / "U.air", cells)
    read_cells(state / "p", cells)
    for name in STATE:
        refuse_code(state / name)  # a run folder may come from a stranger, and the solver obeys what is in it
    for name in STATE:
        shutil.copyfile(state / name, folder / "0" / name)
    return U


def check_setup(setup: GasSetup) -> None:
    """Refuse a set-up whose parts do not fit each other, or whose drag law is none.

    Raises
    ------
    InputError
        Naming the entry, its value and what is expected.
    """
    DRAGS.find(setup.drag)
    if setup.jet is not None and setup.inlet != 0.0:
        raise InputError(f"inlet = {setup.inlet:g}: with a jet no gas enters elsewhere; expected inlet = 0")
    Grid(setup)


def case_context(setup: GasSetup) -> dict[str, object]:
    """Return what the templates need of a set-up, as plain numbers, names, lists and dicts."""
    grid = Grid(setup)
    planes = [float(i) * setup.size[0] / setup.cells[0] for i in grid.splits]
    planes[-1] = setup.size[0]
    _, depth, height = setup.size
    count = len(planes)

    def corner(i: int, j: int, k: int) -> int:
        return i + count * (j + 2 * k)

    blocks = [
        {
            "corners": [corner(i + a, j, k) for k in (0, 1) for j, a in ((0, 0), (0, 1), (1, 1), (1, 0))],
            "cells": [int(grid.splits[i + 1] - grid.splits[i]), setup.cells[1], setup.cells[2]],
        }
        for i in range(count - 1)
    ]
    return {
        "size": list(setup.size),
        "vertices": [[x, y, z] for z in (0.0, height) for y in (0.0, depth) for x in planes],
        "blocks": blocks,
        "patches": _patches(setup, grid, corner),
        "jet": setup.jet is not None,
        "inlet": inlet_velocity(setup),
        "start": start_velocity(setup),
        "walls": setup.walls,
        "density": setup.density,
        "nu": setup.viscosity / setup.density,
        "gravity": [0.0, 0.0, -setup.gravity],
        "step": setup.step,
        "drag": DRAGS.find(setup.drag).openfoam,
        "solids_max": SOLIDS_MAX,
    }


def inlet_velocity(setup: GasSetup) -> float:
    """Return the superficial velocity through the patch ``inlet`` [m/s]."""
    return setup.inlet if setup.jet is None else setup.jet.velocity


def start_velocity(setup: GasSetup) -> float:
    """Return the upward gas velocity everywhere at the start [m/s]: the inlet's, 0 with a jet."""
    return setup.inlet


def _patches(setup: GasSetup, grid: Grid, corner: Corner) -> list[dict[str, object]]:
    """Name, type, role, faces of each patch. Roles: inlet, outlet, wall, coupled (conditions named as the type)."""
    columns = range(len(grid.splits) - 1)

    def level(i: int, k: int) -> list[int]:
        return [corner(i, 0, k), corner(i + 1, 0, k), corner(i + 1, 1, k), corner(i, 1, k)]

    def side(i: int) -> list[int]:
        return [corner(i, 0, 0), corner(i, 1, 0), corner(i, 1, 1), corner(i, 0, 1)]

    def plane(i: int, j: int) -> list[int]:
        return [corner(i, j, 0), corner(i + 1, j, 0), corner(i + 1, j, 1), corner(i, j, 1)]

    entry = [i for i in columns if grid.slot is None or i == grid.slot]
    rest = [level(i, 0) for i in columns if i not in entry]
    front, back = ([plane(i, j) for i in columns] for j in (0, 1))
    walls = [side(0), side(len(grid.splits) - 1)]
    if setup.front_back == "walls":
        walls += front + back
    patches = [
        _patch(INLET, "patch", "inlet", [level(i, 0) for i in entry]),
        _patch(OUTLET, "patch", "outlet", [level(i, 1) for i in columns]),
        _patch("walls", "wall", "wall", walls),
    ]
    if rest:
        patches.append(_patch("floor", "wall", "wall", rest))
    if setup.front_back == "periodic":
        patches.append(_patch("front", "cyclic", "coupled", front, neighbour="back"))
        patches.append(_patch("back", "cyclic", "coupled", back, neighbour="front"))
    elif setup.front_back == "layer":
        patches.append(_patch("front_back", "empty", "coupled", front + back))
    return patches


def _patch(name: str, kind: str, role: str, faces: list[list[int]], neighbour: str = "") -> dict[str, object]:
    return {"name": name, "type": kind, "role": role, "faces": faces, "neighbour": neighbour}
