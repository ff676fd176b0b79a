"""Where particles start, from files of others: CSV, VTK (vtk, vtp, vtu), dumps and data files of LIGGGHTS.

Of a dump the last frame is read. The format of both is described in the manual of LIGGGHTS (`dump custom`,
`read_data`); text is read as text, VTK by the native readers that `kncal.scene.meshes` tries in a child first.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array, nearest, positive, short
from kncal.core.errors import InputError, ReadError
from kncal.core.files import read_limited
from kncal.scene.meshes import read_mesh
from kncal.scene.sizes import Classes, merged

MAX_BYTES, MOST_ROWS, MOST_COLUMNS = 512 * 1024**2, 1_000_000, 200
_EXPECTED = "positions of particles as CSV (a line of names x,y,z,...), VTK, or a dump or data file of LIGGGHTS"
_MESHES = (".vtk", ".vtp", ".vtu")
#: What a column may hold; all else in a CSV file is a slip of the pen, in others of no interest.
_X, _V, _SPIN = ("x", "y", "z"), ("vx", "vy", "vz"), ("omegax", "omegay", "omegaz")
_IGNORED = ("type", "density", "mass", "fx", "fy", "fz", "tqx", "tqy", "tqz")
_KNOWN = (*_X, "diameter", "radius", *_V, *_SPIN, "id")
#: Columns of a data file by their number: ``atom_style sphere`` (or granular), the last three count periodic images.
_ATOMS = ("id", "type", "diameter", "density", "x", "y", "z")
_WIDTHS = (len(_ATOMS), len(_ATOMS) + 3)
_VELOCITIES = ("id", *_V, *_SPIN)
#: What point data of a VTK file are called.
_FIELDS = {"v": ("v", "velocity", "Velocity"), "spin": ("spin", "omega", "Omega")}
#: What a coordinate [m], a velocity [m/s] and a spin [rad/s] may be.
_MOST = {"x": 1e4, "v": 1e4, "spin": 1e8}


@dataclass(frozen=True)
class Given:
    """Particles of a file, n of them, in the order of its ids or of its rows.

    Attributes
    ----------
    x : centres (n, 3) [m]
    v, spin : velocities and angular velocities (n, 3) [m/s], [rad/s]; zero where the file says nothing of them
    diameter : (n,) [m], or None if the file does not say
    """

    x: Array
    v: Array
    spin: Array
    diameter: Array | None

    def classes(self, class_error: float, e_n: float) -> tuple[Classes, NDArray[np.int64]]:
        """Return the classes of the diameters and the class of each particle (n,); see `kncal.scene.sizes.merged`."""
        if self.diameter is None:
            raise InputError("the file has no diameters: expected a column diameter or radius, or particles.diameter")
        return merged(self.diameter, class_error, e_n)


def read_particles(path: Path, scale: float = 1.0) -> Given:
    """Read particles of a file.

    Parameters
    ----------
    path : Path
        ``.vtk``, ``.vtp``, ``.vtu`` (points; ``radius`` or ``diameter``, ``velocity`` and ``spin`` as point data), a
        text dump or data file of LIGGGHTS, or CSV with a line of names: x, y, z, and if there: diameter or radius, vx,
        vy, vz, omegax, omegay, omegaz, id.
    scale : float
        What the file's unit of length is [m].

    Raises
    ------
    ReadError
        If the file is missing, too large, of another kind, damaged, or holds what no particle can have; the text
        names file and line.
    """
    positive("scale", scale, unit="m")
    if path.suffix.lower() in _MESHES:
        return _of_points(path, scale)
    try:
        text = read_limited(path, MAX_BYTES, _EXPECTED).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ReadError(f"{path}: not UTF-8 text ({error.reason}); expected {_EXPECTED}") from error
    lines = text.split("\n")
    if lines[0].startswith("ITEM:"):
        table = _dump(path, lines)
    elif any(re.fullmatch(r"\s*\d+\s+atoms\s*", line) for line in lines[1:20]):
        table = _data(path, lines)
    else:
        table = _csv(path, lines)
    return _of_table(path, table, scale)


class _Table(NamedTuple):
    """Rows of numbers: names of their columns, values (n, columns), and the line of each row (n,), from 1."""

    names: tuple[str, ...]
    values: Array
    lines: NDArray[np.int64]


def _fail(path: Path, line: int, text: str) -> NoReturn:
    raise ReadError(f"{path}, line {line}: {text}")


def _rows(
    path: Path, lines: Sequence[str], span: tuple[int, int], names: Sequence[str], separator: str | None = None
) -> _Table:
    """Read ``lines[start:end]``, blank ones left out, as numbers."""
    start, end = span
    taken = [i for i in range(start, min(end, len(lines))) if lines[i].strip()]
    if len(taken) > MOST_ROWS:
        raise ReadError(f"{path}: {len(taken)} particles: expected at most {MOST_ROWS}")
    if len(set(names)) < len(names) or not 0 < len(names) <= MOST_COLUMNS:
        _fail(path, start, f"columns {short(' '.join(names))}: expected up to {MOST_COLUMNS} different names")
    try:
        values = np.loadtxt([lines[i] for i in taken], delimiter=separator, comments=None, ndmin=2) if taken else None
    except (ValueError, OverflowError):
        values = None
    if not taken or (values is not None and values.shape[1] == len(names)):
        found = np.empty((0, len(names))) if values is None else values
        return _Table(tuple(names), found, np.array(taken, dtype=np.int64) + 1)
    for i in taken:
        fields = lines[i].split(separator)
        if len(fields) != len(names):
            _fail(path, i + 1, f"{short(lines[i])}: {len(fields)} values, expected {len(names)}: {' '.join(names)}")
        for name, field in zip(names, fields, strict=True):
            if not re.fullmatch(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*", field, re.ASCII):
                _fail(path, i + 1, f"{name} = {short(field)}: expected a number")
    raise ReadError(f"{path}: cannot be read; expected {_EXPECTED}")


def _csv(path: Path, lines: Sequence[str]) -> _Table:
    names = [name.strip().strip('"') for name in lines[0].split(",")]
    for name in names:
        if name not in _KNOWN and name not in _IGNORED:
            _fail(path, 1, f"column {short(name)}: expected one of {', '.join(_KNOWN)}{nearest(name, _KNOWN)}")
    return _rows(path, lines, (1, len(lines)), names, ",")


def _dump(path: Path, lines: Sequence[str]) -> _Table:
    """The last frame of a text dump."""
    start = max(i for i, line in enumerate(lines) if line.startswith("ITEM: TIMESTEP") or i == 0)
    head = [line.strip() for line in lines[start : start + 9]]
    count = head[3] if len(head) == 9 else ""
    if len(head) < 9 or not head[2].startswith("ITEM: NUMBER OF ATOMS") or not re.fullmatch(r"\d{1,9}", count, re.A):
        _fail(path, start + 1, "expected a whole frame of a dump: ITEM: TIMESTEP, ITEM: NUMBER OF ATOMS, its box, rows")
    if not head[8].startswith("ITEM: ATOMS"):
        _fail(path, start + 9, f"{short(head[8])}: expected ITEM: ATOMS with names of columns")
    table = _rows(path, lines, (start + 9, len(lines)), head[8].split()[2:])
    if len(table.values) != int(count):
        _fail(path, len(lines), f"{len(table.values)} rows in the last frame, expected {count}: the file was cut off")
    return table


def _data(path: Path, lines: Sequence[str]) -> _Table:
    """The sections Atoms and Velocities of a data file."""
    heads = {i: line.split("#")[0].strip() for i, line in enumerate(lines) if re.match(r"[A-Z][a-z]+\b", line) and i}
    heads = {i: head for i, head in heads.items() if re.fullmatch(r"[A-Z][A-Za-z ]{3,30}", head)}
    bounds = [*sorted(heads), len(lines)]
    spans = {heads[i]: (i + 1, end) for i, end in itertools.pairwise(bounds)}
    if "Atoms" not in spans:
        raise ReadError(f"{path}: no section Atoms; expected a data file of LIGGGHTS as write_data makes it")
    first = next((line for line in lines[slice(*spans["Atoms"])] if line.strip()), "")
    if len(first.split()) not in _WIDTHS:
        _fail(path, spans["Atoms"][0] + 2, f"{short(first)}: expected {' '.join(_ATOMS)} (atom_style sphere)")
    images = ("ix", "iy", "iz") if len(first.split()) == _WIDTHS[1] else ()
    atoms = _rows(path, lines, spans["Atoms"], (*_ATOMS, *images))
    stated = next(int(found[1][:18]) for line in lines[1:20] if (found := re.fullmatch(r"\s*(\d+)\s+atoms\s*", line)))
    if len(atoms.values) != stated:
        _fail(path, spans["Atoms"][0], f"{len(atoms.values)} rows in Atoms, expected {stated} as the head says")
    if "Velocities" not in spans:
        return atoms
    moving = _rows(path, lines, spans["Velocities"], _VELOCITIES)
    order, other = np.argsort(atoms.values[:, 0]), np.argsort(moving.values[:, 0])
    if not np.array_equal(atoms.values[order, 0], moving.values[other, 0]):
        _fail(path, spans["Velocities"][0], "ids in Velocities differ from those in Atoms: expected the same")
    values = np.hstack([atoms.values[order], moving.values[other, 1:]])
    return _Table((*atoms.names, *_VELOCITIES[1:]), values, atoms.lines[order])


def _of_table(path: Path, table: _Table, scale: float) -> Given:
    column = dict(zip(table.names, table.values.T, strict=True))
    missing = [name for name in _X if name not in column]
    if missing:
        raise ReadError(f"{path}: no column {', '.join(missing)} among {short(' '.join(table.names))}; {_EXPECTED}")
    if not len(table.values):
        raise ReadError(f"{path}: holds no particles; expected a row for each")
    ids = column.get("id", np.arange(len(table.values)))
    if len(np.unique(ids)) < len(ids):
        raise ReadError(f"{path}: an id stands twice; expected each particle once")
    order = np.argsort(ids, kind="stable")
    column = {name: values[order] for name, values in column.items()}
    vectors: dict[str, Array | None] = {"x": np.stack([column[name] for name in _X], axis=-1)}
    for name, parts in (("v", _V), ("spin", _SPIN)):
        if given := [part for part in parts if part in column]:
            if len(given) < 3:
                raise ReadError(f"{path}: {', '.join(given)} without the others of {', '.join(parts)}: expected all")
            vectors[name] = np.stack([column[part] for part in parts], axis=-1)
    return _checked(path, vectors, _diameter(column), scale, table.lines[order])


def _of_points(path: Path, scale: float) -> Given:
    mesh = read_mesh(path)
    data = {str(name): np.asarray(values) for name, values in mesh.point_data.items()}
    vectors: dict[str, Array | None] = {"x": np.array(mesh.points, dtype=np.float64)}
    if len(mesh.points) > MOST_ROWS:
        raise ReadError(f"{path}: {len(mesh.points)} particles: expected at most {MOST_ROWS}")
    for name, words in _FIELDS.items():
        found = next((data[word] for word in words if word in data), None)
        if found is not None and found.shape != vectors["x"].shape:  # type: ignore[union-attr]
            raise ReadError(f"{path}: {name} of shape {found.shape}: expected three numbers for each point")
        vectors[name] = None if found is None else found.astype(np.float64)
    return _checked(path, vectors, _diameter(data), scale, None)


def _diameter(data: Mapping[str, Array]) -> Array | None:
    if "diameter" in data:
        return np.array(data["diameter"], dtype=np.float64)
    return 2.0 * data["radius"].astype(np.float64) if "radius" in data else None


def _checked(
    path: Path, vectors: Mapping[str, Array | None], diameter: Array | None, scale: float,
    lines: NDArray[np.int64] | None,
) -> Given:  # fmt: skip
    """Return what a file holds, in m; refuse the first value that no particle can have."""
    x = vectors["x"]
    assert x is not None  # noqa: S101  # by its makers
    x = x * scale
    found = {"x": x, "v": vectors.get("v"), "spin": vectors.get("spin")}

    def refuse(bad: NDArray[np.bool_], text: str) -> None:
        if bad.any():
            row = int(np.argmax(bad))
            raise ReadError(f"{path}, {f'point {row}' if lines is None else f'line {lines[row]}'}: {text}")

    for name, values in found.items():
        if values is not None:
            far = np.asarray(~(np.abs(values) <= _MOST[name]).all(axis=1))
            refuse(far, f"{name} is not finite, or beyond {_MOST[name]:g}: expected SI units (length: see scale)")
    if diameter is not None:
        diameter = diameter * scale
        if diameter.shape != (len(x),):
            raise ReadError(f"{path}: sizes of shape {diameter.shape}: expected one number for each particle")
        refuse(~((diameter >= 2e-9) & (diameter <= 1e3)), "diameter: expected one from 2e-9 to 1000 m (see scale)")
    still = np.zeros_like(x)
    return Given(
        x=x,
        v=still if found["v"] is None else found["v"],
        spin=still if found["spin"] is None else found["spin"],
        diameter=diameter,
    )
