"""VTK files for ParaView, and meshes of foreign formats."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO
from xml.sax.saxutils import quoteattr

import numpy as np

from kncal.core.errors import InputError, ReadError
from kncal.core.files import open_limited, write_text
from kncal.record.probe import probe

if TYPE_CHECKING:
    from kncal.record.frames import Trajectory

#: A larger mesh file is refused.
MAX_BYTES = 1024**3

#: XML by their name; a file may also begin with so many blanks that its first bytes do not show it.
_XML_SUFFIXES = (".vtp", ".vtu", ".vts", ".vtr", ".vti", ".xdmf", ".xmf", ".svg", ".xml")
_PYVISTA_SUFFIXES = (".vtk", ".vtp", ".stl")  # meshio ends the program, or misreads the text form


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
        entries.append((float(trajectory.t[frame]), name))
    return _write_collection(folder / "particles.pvd", entries)


def read_mesh(path: Path) -> Any:
    """Read a mesh or a point cloud: vtk, vtp and stl with pyvista, all else (vtu, msh, ...) with meshio.

    A child process reads it first (about a second): a damaged file may crash these readers, or make them ask for
    memory without end.

    Returns
    -------
    pyvista.DataSet
        With points [as in the file], cells and data arrays.

    Raises
    ------
    ReadError
        If the file is missing, too large, of an unknown format, damaged or without points, or if it is XML with
        a document type (which can blow up in memory, and which no mesh needs).
    """
    _refuse_unsafe(path)
    probe("mesh", path)
    try:
        mesh = read_native(path)
    except Exception as error:  # foreign readers raise anything
        raise ReadError(f"{path}: cannot be read ({_first_line(error)})") from error
    if not mesh.n_points:
        raise ReadError(f"{path}: holds no points; expected a mesh (is the file cut off?)")
    return mesh


def read_native(path: Path) -> Any:
    """Read a mesh in this process, which a damaged file may end; raises anything. For `kncal.record.probe`."""
    import pyvista

    if path.suffix.lower() not in _PYVISTA_SUFFIXES:
        import meshio

        mesh = pyvista.from_meshio(meshio.read(path))
    else:
        with warnings.catch_warnings(), pyvista.VtkErrorCatcher(raise_errors=True):
            warnings.simplefilter("error", UserWarning)  # pyvista only warns of some damage
            mesh = pyvista.read(path)
    if not isinstance(mesh, pyvista.DataSet):
        raise TypeError(f"a {type(mesh).__name__}, expected one mesh")
    return mesh


def _refuse_unsafe(path: Path) -> None:
    """Refuse what is dangerous to hand to a reader: huge files, and XML that declares entities."""
    with open_limited(path, MAX_BYTES, "a mesh file") as file:
        try:
            start = file.read(64)
            if not start:
                raise ReadError(f"{path}: the file is empty; expected a mesh")
            is_xml = start.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<")
            # 16- and 32-bit text would hide the words looked for, and no mesh writer uses it.
            if start[:2] in (b"\xff\xfe", b"\xfe\xff", b"\0<") or (is_xml and b"\0" in start):
                raise ReadError(f"{path}: 16-bit text, expected XML in UTF-8 or a binary mesh")
            if (is_xml or path.suffix.lower() in _XML_SUFFIXES) and _holds_doctype(file, start):
                raise ReadError(f"{path}: XML with a DOCTYPE is refused; expected a plain VTK file without one")
        except OSError as error:
            raise ReadError(f"{path}: cannot be read ({error.strerror}); expected a mesh file") from error


def _holds_doctype(file: BinaryIO, start: bytes) -> bool:
    text = start
    while True:
        if b"<!DOCTYPE" in text.upper():
            return True
        block = file.read(1 << 20)
        if not block:
            return False
        text = text[-16:] + block


def _first_line(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return lines[0][:200] if lines else type(error).__name__


def _write_collection(path: Path, entries: list[tuple[float, str]]) -> Path:
    """Write a ParaView collection of (time [s], file relative to it); pyvista reads but cannot write one."""
    lines = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1">', "  <Collection>"]
    lines += [f'    <DataSet timestep="{time!r}" part="0" file={quoteattr(name)}/>' for time, name in entries]
    lines += ["  </Collection>", "</VTKFile>", ""]
    write_text(path, "\n".join(lines))
    return path
