"""DPMFoam on several ranks: the column cut into slices, run, and put together again.

A parallel start takes a second or two (three programs, each loads OpenFOAM's libraries; ``mpirun``), whatever the size
of the mesh: it pays for large meshes only. Cells, parcels and fields come out in the order of a serial run.

The results differ from a serial run's by what the linear solvers leave: the pressure equation is solved on other parts
to the same normalised residual, `TOLERANCE`. In a column with a given inflow a residual is gas that appears or goes
missing on the way, so the pressure drop is off by no more than its share of the flow: a few times `TOLERANCE`.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from kncal.core.errors import InputError
from kncal.record.openfoam import CLOUD

DECOMPOSE, RECONSTRUCT = "decomposePar", "reconstructPar"
#: Normalised residual to which ``system/fvSolution`` asks for the pressure.
TOLERANCE = 1e-6

#: Runs one program of OpenFOAM on so many ranks: (command, ranks) -> CPU time [s]; raises if it failed.
Run = Callable[[list[str], int], float]


def divisions(cells: tuple[int, int, int], ranks: int) -> tuple[int, int, int]:
    """Return into how many slices each axis of a column of ``cells`` is cut: all cuts are across one axis.

    That is x if it gives each rank two layers of cells (so all ranks have their share of the particles, which lie
    below), else z. Never y, along which front and back may be coupled.

    Raises
    ------
    InputError
        If there are not as many layers of cells.
    """
    nx, _, nz = cells
    if ranks == 1:
        return (1, 1, 1)
    if nx >= 2 * ranks:
        return (ranks, 1, 1)
    if nz >= ranks:
        return (1, 1, ranks)
    raise InputError(
        f"ranks = {ranks}: the gas has {nx} x {nz} cells in x and z; expected at most {max(nx // 2, nz)} ranks"
    )


def decompose(folder: Path, run: Run) -> float:
    """Hand out the start fields and parcels of the case in ``folder`` to its ranks; return the CPU time [s]."""
    first = not _parts(folder)
    for part in _parts(folder):
        shutil.rmtree(part / "0")
    cpu = run([DECOMPOSE] if first else [DECOMPOSE, "-fields"], 1)
    for part in _parts(folder):
        own = part / "0" / "uniform"
        if own.is_symlink():  # to that of the whole case; a run folder holds no links
            own.unlink()
        _tell_geometry(folder, part)
    return cpu


def reconstruct(folder: Path, end: Path, run: Run) -> float:
    """Put the time folder ``end`` of all ranks together as one of the case; return the CPU time [s]."""
    cpu = run([RECONSTRUCT, "-time", end.name], 1)
    for part in _parts(folder):
        shutil.rmtree(part / end.name, ignore_errors=True)
    return cpu


def _parts(folder: Path) -> list[Path]:
    return sorted(folder.glob("processor[0-9]*"))


def _tell_geometry(folder: Path, part: Path) -> None:
    """Say how a rank's parcels are written: decomposePar reads positions and writes coordinates, and leaves that out.

    Without it the solver finds no parcels and goes on without them.
    """
    place = Path("uniform") / CLOUD / "cloudProperties"
    whole = folder / "0" / place
    if not whole.is_file():
        return
    own = part / "0" / place
    own.parent.mkdir(parents=True, exist_ok=True)
    own.write_bytes(whole.read_bytes().replace(b"geometry positions;", b"geometry coordinates;"))
