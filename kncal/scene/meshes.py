"""Meshes of walls, read by pyvista or meshio.

``python -m kncal.scene.meshes PATH`` reads one as the parent will: a damaged file may crash these readers.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from kncal.core.checks import Array
from kncal.core.child import ChildError, answer, ask
from kncal.core.errors import ReadError
from kncal.core.files import open_limited, sha256

#: A larger mesh file is refused [bytes]; what a reader may take beyond what Python and VTK have taken already.
MAX_BYTES, MEMORY, SECONDS = 1024**3, 4 * 1024**3, 60
#: Triangles of one wall; LIGGGHTS reads them in seconds.
MOST_TRIANGLES = 1_000_000
_VTK_TRIANGLE = 5
#: Triangles by the content of their file: a scene asks often for its walls, and its copies for the same.
_known: dict[tuple[str, str], Array] = {}
_MOST_KNOWN = 16
#: Bytes of a binary STL file: its head with the number of triangles, and each triangle.
_STL_HEAD, _STL_TRIANGLE = 84, 50

#: XML by their name; a file may also begin with so many blanks that its first bytes do not show it.
_XML_SUFFIXES = (".vtp", ".vtu")
#: What is read at all: files that hold all of a mesh themselves. Others (XDMF, HDF5 …) can name files anywhere.
FORMATS = (".stl", ".obj", ".ply", ".off", ".vtk", ".vtp", ".vtu", ".msh", ".bdf", ".nas", ".inp", ".mesh")
_PYVISTA_SUFFIXES = (".vtk", ".vtp", ".stl")  # meshio ends the program, or misreads the text form


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
    if path.suffix.lower() not in FORMATS:
        raise ReadError(f"{path}: not a format that is read: expected one of {', '.join(FORMATS)}")
    _refuse_unsafe(path)
    if path.suffix.lower() == ".stl":
        _refuse_cut_stl(path)
    try:
        ask("kncal.scene.meshes", str(path.absolute()), seconds=2 * SECONDS)
        mesh = _read(path)
    except (ChildError, MemoryError) as error:
        raise ReadError(f"{path}: cannot be read ({error})") from error
    if not mesh.n_points:
        raise ReadError(f"{path}: holds no points; expected a mesh (is the file cut off?)")
    return mesh


def triangles_of(path: Path) -> Array:
    """Return the triangles of the surface of a mesh file, (n, 3, 3): the corners of each, in the file's unit.

    Raises
    ------
    ReadError
        As `read_mesh`; or if it has no triangle, more than `MOST_TRIANGLES`, or a coordinate that is not finite.
    """
    digest = sha256(path)
    if (known := _known.get((digest, path.suffix.lower()))) is None:
        known = _triangles(path)
        _known[digest, path.suffix.lower()] = known
        if len(_known) > _MOST_KNOWN:
            del _known[next(iter(_known))]
    return known


def _triangles(path: Path) -> Array:
    mesh = read_mesh(path).cast_to_unstructured_grid().triangulate()
    cells = mesh.cells_dict.get(_VTK_TRIANGLE, np.empty((0, 3), dtype=np.intp))
    corners: Array = np.array(mesh.points, dtype=np.float64)[cells]
    if not 0 < len(corners) <= MOST_TRIANGLES:
        raise ReadError(f"{path}: {len(corners)} triangles: expected a surface of 1 to {MOST_TRIANGLES}")
    if not np.isfinite(corners).all():
        raise ReadError(f"{path}: holds a coordinate that is not finite: expected numbers")
    corners.flags.writeable = False
    return corners


def _read(path: Path) -> Any:
    """Read a mesh in this process, which a damaged file may end; raises anything."""
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


def _refuse_cut_stl(path: Path) -> None:
    """Refuse an STL file that ends before its triangles do: VTK reads what is there, without a word."""
    with open_limited(path, MAX_BYTES, "a mesh file") as file:
        head = file.read(_STL_HEAD)
        size = file.seek(0, 2)
        file.seek(max(0, size - 200))
        tail = file.read()
    number = int.from_bytes(head[80:84], "little")
    if head.lstrip().lower().startswith(b"solid"):
        if b"endsolid" in tail.lower():
            return
    elif len(head) == _STL_HEAD and size >= _STL_HEAD + _STL_TRIANGLE * number:
        return
    # some programs begin binary files with the word, too
    if len(head) < _STL_HEAD or size != _STL_HEAD + _STL_TRIANGLE * number:
        raise ReadError(
            f"{path}: an STL file that is cut off, or none: {size} bytes; expected {_STL_HEAD} and {_STL_TRIANGLE} for "
            'each triangle, or text that ends with "endsolid"'
        )


def _holds_doctype(file: BinaryIO, start: bytes) -> bool:
    text = start
    while True:
        if b"<!DOCTYPE" in text.upper():
            return True
        block = file.read(1 << 20)
        if not block:
            return False
        text = text[-16:] + block


def _tried(path: Path) -> bytes:
    _read(path)
    return b""


if __name__ == "__main__":
    import pyvista  # noqa: F401  before the limits: it takes much address space and is no part of the file

    answer(lambda: _tried(Path(sys.argv[1])), MEMORY, SECONDS)
