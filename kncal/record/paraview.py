"""A bed run for other programs: numbers as CSV, particles and gas fields as one time series for ParaView."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np

from kncal.core.errors import InputError
from kncal.record.series import BedSeries, write_series_csv

if TYPE_CHECKING:
    import pyvista

__all__ = ["write_paraview", "write_series_csv"]


def write_paraview(series: BedSeries, folder: Path) -> Path:
    """Write every frame as files of particles (VTP) and, with gas, of its fields (VTI), and one collection of all.

    Particles are points [m] with ``id`` (from 1), ``radius`` [m], ``velocity`` [m/s]; the gas fields are cell data
    ``eps_g`` [-], ``p`` [Pa], ``U`` [m/s].

    Parameters
    ----------
    series : BedSeries
    folder : Path
        Gets ``bed.pvd``, ``particles/`` and ``gas/``; made if it is not there.

    Returns
    -------
    Path
        The collection ``bed.pvd``: the file to open in ParaView. Block 0 holds the particles, block 1 the gas.

    Raises
    ------
    InputError
        If the run recorded no frame.
    """
    if not len(series.t_frame):
        raise InputError(
            f"{series.facts.name}: no frame was recorded, so there is nothing for ParaView: expected "
            "run.frames_every below run.end_time"
        )
    (folder / "particles").mkdir(parents=True, exist_ok=True)
    has_gas = len(series.eps_g) > 0
    if has_gas:
        (folder / "gas").mkdir(exist_ok=True)
    lines = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1">', "  <Collection>"]
    for frame, (time, coupling) in enumerate(zip(series.t_frame.tolist(), series.frame_coupling.tolist(), strict=True)):
        names = [f"particles/{coupling:09d}.vtp"]
        _particles(series, frame).save(folder / names[0])
        if has_gas:
            names.append(f"gas/{coupling:09d}.vti")
            _gas(series, frame).save(folder / names[1])
        lines += [
            f'    <DataSet timestep="{time!r}" part="{part}" file={quoteattr(name)}/>'
            for part, name in enumerate(names)
        ]
    lines += ["  </Collection>", "</VTKFile>", ""]
    path = folder / "bed.pvd"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def _particles(series: BedSeries, frame: int) -> pyvista.PolyData:
    import pyvista

    if not series.facts.count:
        return pyvista.PolyData()  # which takes no arrays of no values
    points = pyvista.PolyData(np.array(series.x[frame]))
    points.point_data["id"] = np.arange(1, series.facts.count + 1)
    points.point_data["radius"] = np.full(series.facts.count, 0.5 * series.facts.diameter)
    points.point_data["velocity"] = series.v[frame]
    return points


def _gas(series: BedSeries, frame: int) -> pyvista.ImageData:
    import pyvista

    cells = np.array(series.facts.cells)
    grid = pyvista.ImageData(dimensions=tuple(cells + 1), spacing=tuple(np.array(series.facts.size) / cells))
    grid.cell_data["eps_g"] = series.eps_g[frame].ravel()
    grid.cell_data["p"] = series.p[frame].ravel()
    grid.cell_data["U"] = series.U[frame].reshape(-1, 3)
    return grid
