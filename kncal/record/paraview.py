"""Runs as ParaView opens them: files of every frame, and one collection with their true times."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.core.files import write_text
from kncal.record.series import BedSeries
from kncal.scene.shapes import surface

if TYPE_CHECKING:
    import pyvista

    from kncal.record.frames import Trajectory


#: From a time [s] to the triangles (n, 3, 3) [m] of the walls that are there then, by name.
WallsAt = Callable[[float], Mapping[str, Array]]
#: Triangles of a wall, and the file that they were last written to.
Written = tuple[Array, str]


def write_paraview(series: BedSeries, folder: Path, walls: WallsAt | None = None) -> Path:
    """Write every frame as files of particles (VTP), walls (VTP) and, with gas, its fields (VTI); a collection of all.

    Particles are points [m] with ``id`` (from 1), ``radius`` [m], ``velocity`` [m/s], ``spin`` [rad/s] and ``species``
    (from 0); the gas fields are cell data ``eps_g`` [-], ``p`` [Pa], ``U`` [m/s].

    Parameters
    ----------
    series : BedSeries
    folder : Path
        Gets ``bed.pvd``, ``particles/``, ``walls/`` and ``gas/``; made if it is not there.
    walls : WallsAt, optional
        A wall that stays as it is has one file for all times.

    Returns
    -------
    Path
        The collection ``bed.pvd``: the file to open in ParaView. Block 0 holds the particles, then come the gas and the
        walls.

    Raises
    ------
    InputError
        If the run recorded no frame.
    """
    if not len(series.t_frame):
        raise InputError(
            f"{series.facts.name}: no frame was recorded, so there is nothing for ParaView: expected "
            "run.frames_every below run.until_time"
        )
    (folder / "particles").mkdir(parents=True, exist_ok=True)
    has_gas = len(series.eps_g) > 0
    if has_gas:
        (folder / "gas").mkdir(exist_ok=True)
    entries = []
    written: dict[str, Written] = {}
    for frame, (time, coupling) in enumerate(zip(series.t_frame.tolist(), series.frame_coupling.tolist(), strict=True)):
        names = [f"particles/{coupling:09d}.vtp"]
        _particles(series, frame).save(folder / names[0])
        if has_gas:
            names.append(f"gas/{coupling:09d}.vti")
            _gas(series, frame).save(folder / names[1])
        if walls is not None:
            names += _walls(walls(time), folder, coupling, written)
        entries += [(time, part, name) for part, name in enumerate(names)]
    return _collection(folder / "bed.pvd", entries)


def _walls(
    surfaces: Mapping[str, Array], folder: Path, coupling: int, written: dict[str, tuple[Array, str]]
) -> list[str]:
    """Write the walls that are not as they were in the frame before; return the files of all of them."""
    for name, triangles in surfaces.items():
        if name not in written or not np.array_equal(written[name][0], triangles):
            file = f"walls/{name}/{coupling:09d}.vtp"
            (folder / "walls" / name).mkdir(parents=True, exist_ok=True)
            surface(triangles).save(folder / file)
            written[name] = triangles, file
    return [written[name][1] for name in surfaces]


def write_particles(trajectory: Trajectory, folder: Path, every: int = 1) -> Path:
    """Write one VTP file per frame, and a collection with the true times (frames are not evenly spaced).

    Each file holds the particles as points [m] with ``id`` (from 1), ``radius`` [m], ``velocity`` [m/s],
    ``spin`` [rad/s] and ``force`` [N].

    Parameters
    ----------
    trajectory : Trajectory
    folder : Path
        Gets ``particles.pvd`` and the folder ``particles``; made if it is not there.
    every : int
        Write every n-th frame, beginning with the first.

    Returns
    -------
    Path
        The collection ``particles.pvd``: the file to open in ParaView.

    Raises
    ------
    InputError
        If ``every`` is below 1.
    """
    import pyvista

    if every < 1:
        raise InputError(f"every = {every}: expected a whole number of frames, at least 1")
    (folder / "particles").mkdir(parents=True, exist_ok=True)
    entries = []
    for frame in range(0, trajectory.step.size, every):
        points = pyvista.PolyData(np.array(trajectory.x[frame], dtype=np.float64))
        points.point_data["id"] = np.arange(1, len(trajectory.names) + 1)
        points.point_data["radius"] = trajectory.radius
        points.point_data["velocity"] = trajectory.v[frame]
        points.point_data["spin"] = trajectory.spin[frame]
        points.point_data["force"] = trajectory.force[frame]
        name = f"particles/{int(trajectory.step[frame]):012d}.vtp"
        points.save(folder / name)
        entries.append((float(trajectory.t[frame]), 0, name))
    return _collection(folder / "particles.pvd", entries)


def _collection(path: Path, entries: list[tuple[float, int, str]]) -> Path:
    """Write a ParaView collection of (time [s], part, file relative to it); pyvista reads but cannot write one."""
    lines = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1">', "  <Collection>"]
    lines += [
        f'    <DataSet timestep="{time!r}" part="{part}" file={quoteattr(name)}/>' for time, part, name in entries
    ]
    lines += ["  </Collection>", "</VTKFile>", ""]
    write_text(path, "\n".join(lines))
    return path


def _particles(series: BedSeries, frame: int) -> pyvista.PolyData:
    import pyvista

    kind = series.kind[frame]
    there = np.flatnonzero(kind >= 0)
    if not len(there):
        return pyvista.PolyData()  # which takes no arrays of no values
    points = pyvista.PolyData(np.array(series.x[frame])[there])
    points.point_data["id"] = there + 1
    points.point_data["radius"] = np.array(series.facts.radii)[kind[there]]
    points.point_data["species"] = kind[there]
    points.point_data["velocity"] = series.v[frame][there]
    points.point_data["spin"] = series.spin[frame][there]
    return points


def _gas(series: BedSeries, frame: int) -> pyvista.ImageData:
    import pyvista

    cells = np.array(series.facts.cells)
    grid = pyvista.ImageData(dimensions=tuple(cells + 1), spacing=tuple(np.array(series.facts.size) / cells))
    grid.cell_data["eps_g"] = series.eps_g[frame].ravel()
    grid.cell_data["p"] = series.p[frame].ravel()
    grid.cell_data["U"] = series.U[frame].reshape(-1, 3)
    return grid
