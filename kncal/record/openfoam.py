"""Files of OpenFOAM v1912 (64-bit scalars, 32-bit labels, little endian): parcel clouds, fields, logs.

Written and read here: what an exchange with a running solver needs, in binary, every bit kept.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError, ReadError
from kncal.core.files import decode_line, open_limited, read_limited

#: Folder of the parcels inside a time folder.
CLOUD = Path("lagrangian/kinematicCloud")
#: A larger file is refused [bytes].
MAX_BYTES = 1 << 31

_CLASSES = {("f", 1): "scalarField", ("f", 2): "vectorField", ("i", 1): "labelField"}
_WIDTHS = {"scalar": 1, "label": 1, "vector": 3, "symmTensor": 6, "tensor": 9}
_ARCH = "LSB;label=32;scalar=64"
_KEPT_LINES = 8  # of an error message
_LOG_END = 1 << 16  # bytes of a log that are searched
_DEEPEST = 20  # dictionaries inside each other
_LONGEST_VALUE = 1000  # bytes of one uniform value
_HEADER_BYTES = 4096  # where FoamFile is looked for

# Fields of basicKinematicCollidingParcel that are the same for all parcels and never matter here
_CONSTANT_SCALARS = {"age": "0", "tTurb": "0"}
_CONSTANT_LABELS = {"active": "1", "typeId": "1", "origProcId": "0"}
_CONSTANT_VECTORS = ("UTurb", "f", "angularMomentum", "torque")
# What a saved state may hold
_PLAIN_START = re.compile(rb"\s*+(?:/\*(?:[^*]|\*(?!/))*+\*/\s*+)?FoamFile\s*+\{[^#$}]*+\}")
_STATE_KEYS = {
    "dimensions", "internalField", "value", "type", "phi", "alpha", "inletVelocity", "gradient", "oriented", "rho", "U",
}  # fmt: skip
_STATE_TYPES = {
    "fixedValue", "interstitialInletVelocity", "pressureInletOutletVelocity", "slip", "noSlip", "cyclic", "empty",
    "fixedFluxPressure", "calculated",
}  # fmt: skip
_RECORDS = {
    "PairAccessed": "label",
    "PairOrigProcOfOther": "label",
    "PairOrigIdOfOther": "label",
    "PairData": "vector",
    "WallAccessed": "label",
    "WallPRel": "vector",
    "WallData": "vector",
}
_RECORD = np.dtype([("open", "S2"), ("x", "<f8", 3), ("cell", "<i4"), ("close", "S1")])  # 31 bytes


def write_parcel_motion(time_folder: Path, x: Array, cell: NDArray[np.int32], v: Array) -> None:
    """Write the positions (n, 3) [m] with cell labels (n,), and the velocities (n, 3) [m/s] of a cloud's parcels.

    The positions must lie inside the mesh; the cell is where the solver begins to look.
    """
    records = np.zeros(len(x), _RECORD)
    records["open"], records["x"], records["cell"], records["close"] = b"\n(", x, cell, b")"
    path = time_folder / CLOUD / "positions"
    head = f"{_header('Cloud<basicKinematicCollidingParcel>', 'positions', 'binary')}\n{len(x)}\n("
    path.write_bytes(head.encode("ascii") + records.tobytes() + b"\n)\n")
    write_list(time_folder / CLOUD / "U", v)


def write_parcel_constants(time_folder: Path, diameter: Array, density: Array, weight: Array) -> None:
    """Write what changes only with the particles: (n,) diameters [m], densities [kg/m³], particles per parcel [-].

    ``origId`` is 0 … n-1: the solver's output is in another order, and is told apart by it.
    """
    folder, n = time_folder / CLOUD, len(diameter)
    folder.mkdir(parents=True, exist_ok=True)
    for name, values in {"d": diameter, "dTarget": diameter, "rho": density, "nParticle": weight}.items():
        write_list(folder / name, values)
    for name, text in _CONSTANT_SCALARS.items():
        _write_constant(folder / name, "scalarField", n, text)
    for name, text in _CONSTANT_LABELS.items():
        _write_constant(folder / name, "labelField", n, text)
    for name in _CONSTANT_VECTORS:
        _write_constant(folder / name, "vectorField", n, "(0 0 0)")
    write_list(folder / "origId", np.arange(n, dtype=np.int32))
    for name, kind in _RECORDS.items():  # a list of n empty lists: n + 1 offsets, then no data
        path = folder / f"collisionRecords{name}"
        path.write_text(f"{_header(f'{kind}FieldCompactField', path.name, 'ascii')}\n{n + 1}{{0}}\n0()\n", "ascii")
    path = time_folder / "uniform" / CLOUD / "cloudProperties"
    path.parent.mkdir(parents=True, exist_ok=True)
    head = _header("dictionary", path.name, "ascii")
    path.write_text(f"{head}\ngeometry positions;\nprocessor0 {{ particleCount {n}; }}\n", "ascii")


def write_list(path: Path, values: ArrayLike) -> None:
    """Write a binary list of scalars (n,), labels (n,) (integers) or vectors (n, 3).

    Raises
    ------
    InputError
        For arrays of another shape or kind.
    """
    given = np.asarray(values)
    kind = _CLASSES.get((given.dtype.kind, given.ndim))
    if kind is None:
        what = f"{given.dtype} array of shape {given.shape}"
        raise InputError(f"{path.name}: {what}: expected scalars (n,), labels (n,) or vectors (n, 3)")
    array = np.ascontiguousarray(given, "<f8" if given.dtype.kind == "f" else "<i4")
    head = f"{_header(kind, path.name, 'binary')}\n{len(array)}\n("
    path.write_bytes(head.encode("ascii") + array.tobytes() + b")\n")


def read_list(path: Path) -> NDArray[Any]:
    """Read a binary list of a cloud: scalars (n,), labels (n,) or vectors (n, 3), in the solver's order.

    Raises
    ------
    ReadError
        If the file is missing, cut off, of another kind, or holds numbers as text.
    """
    raw = _read(path)
    head, start = _read_header(path, raw)
    match = re.fullmatch(r"(scalar|label|vector)Field", head.get("class", ""))
    if match is None:
        raise ReadError(f"{path}: class {head.get('class')!r}: expected a scalarField, labelField or vectorField")
    return _Reader(path, raw, start, head).numbers(match[1])[0]


def read_field(path: Path) -> dict[str, Any]:
    """Read a volume or surface field with binary lists as a nested dict.

    Returns
    -------
    dict
        Entries as in the file. ``internalField`` (``value`` in fields without boundary) and a patch's ``value`` are
        arrays: (n,) or (n, 3); a uniform value is a 0-d or (3,) array. What is no number stays text.

    Raises
    ------
    ReadError
        If the file is missing, cut off, or holds lists of numbers as text.
    """
    raw = _read(path)
    head, start = _read_header(path, raw)
    return _Reader(path, raw, start, head).dictionary(top=True)


def read_cells(path: Path, count: int) -> Array:
    """Read the cell values of a volume field: (count,) or (count, 3).

    Raises
    ------
    ReadError
        As `read_field`, or if the number of cells is another.
    """
    field = read_field(path)
    values = field.get("internalField", field.get("value"))
    return _spread(path, "internal field", values, count)


def refuse_code(path: Path) -> None:
    """Refuse a field that holds anything but numbers and the few entries of a state that kncal's cases write.

    OpenFOAM obeys more in a field than numbers: ``libs`` in a patch loads a library, ``codedFixedValue`` and ``#calc``
    compile code, ``#include`` reads other files. A saved state may come from another machine.

    Raises
    ------
    ReadError
        Naming the entry; also as `read_field`.
    """

    def check(entries: dict[str, Any], where: str, patches: bool) -> None:
        for key, value in entries.items():
            place = f"{where}{key}"[:200]
            if isinstance(value, dict):
                if not re.fullmatch(r"boundaryField|oriented" if not where else r"[A-Za-z]\w{0,63}", key):
                    raise ReadError(f"{path}: {place}: expected no such entry in a saved state")
                check(value, f"{place}.", where == "boundaryField.")
            elif key not in _STATE_KEYS:
                raise ReadError(f"{path}: {place}: expected a saved state, with {', '.join(sorted(_STATE_KEYS))} only")
            elif isinstance(value, str) and (
                not re.fullmatch(r"[\w. \[\]-]*", value) or (patches and key == "type" and value not in _STATE_TYPES)
            ):
                raise ReadError(f"{path}: {place} = {value[:60]!r}: expected numbers, or the name of a plain condition")

    if not _PLAIN_START.match(_read(path)):
        raise ReadError(f"{path}: expected a saved state, which begins with a plain FoamFile header")
    check(read_field(path), "", patches=False)


def read_patch(path: Path, patch: str, count: int) -> Array:
    """Read the face values of a patch of a volume field: (count,) or (count, 3).

    Raises
    ------
    ReadError
        As `read_field`, or if there is no such patch with that number of faces.
    """
    patches = read_field(path).get("boundaryField")
    entry = patches.get(patch) if isinstance(patches, dict) else None
    if not isinstance(entry, dict):
        raise ReadError(f"{path}: no patch {patch!r} in boundaryField")
    return _spread(path, f"patch {patch!r}", entry.get("value"), count)


def set_patch_vector(path: Path, patch: str, entry: str, value: tuple[float, float, float]) -> None:
    """Rewrite a ``uniform`` vector ``entry`` of ``patch`` in a volume field; the rest of the file stays as it is.

    Raises
    ------
    ReadError
        If the file cannot be read or has no such uniform entry.
    """
    raw = _read(path)
    head, start = _read_header(path, raw)
    reader = _Reader(path, raw, start, head)
    reader.dictionary(top=True)
    span = reader.uniform.get(("boundaryField", patch, entry))
    if span is None:
        raise ReadError(f"{path}: patch {patch!r} has no entry {entry!r} with one uniform value")
    text = "(" + " ".join(repr(float(component)) for component in value) + ")"
    path.write_bytes(raw[: span[0]] + text.encode("ascii") + raw[span[1] :])


def fatal_error(log: Path) -> str:
    """Return the solver's own error message from the end of a log (lines joined by " / "), empty if there is none."""
    try:
        with open_limited(log, sys.maxsize, "a log") as handle:
            handle.seek(0, 2)
            handle.seek(max(handle.tell() - _LOG_END, 0))
            lines = [decode_line(line) for line in handle.read(_LOG_END).split(b"\n")]
    except (OSError, ReadError):
        return ""
    for number, line in enumerate(lines):
        if "FOAM FATAL" in line:
            message = [text.strip() for text in lines[number : number + 4 * _KEPT_LINES]]
            ends = [i for i, text in enumerate(message) if text.startswith(("FOAM exiting", "FOAM aborting"))]
            return " / ".join([text for text in message[: ends[0] if ends else None] if text][:_KEPT_LINES])
    return next((line.strip() for line in lines if "sigFpe" in line), "")


class _Reader:
    """Walks through a dictionary of OpenFOAM whose lists are binary: what follows a list is found by counting."""

    _SPACE = re.compile(rb"\s+|//[^\n]*(?:\n|\Z)")
    _WORD = re.compile(rb'"[^"]*"|[^\s{};"]+')
    _LIST = re.compile(rb"nonuniform\s+List<(\w+)>\s*")
    _UNIFORM = re.compile(rb"uniform\s+(\([^();]*\)|[^\s();]+)\s*;")
    _COUNT = re.compile(rb"\s*(\d{1,10})\s*")

    def __init__(self, path: Path, raw: bytes, start: int, head: dict[str, str]) -> None:
        self._path, self._raw, self._at = path, raw, start
        self._binary = head["format"] == "binary"
        self._keys: list[str] = []
        #: (keys from the top) -> (start, end) of the text of a uniform value
        self.uniform: dict[tuple[str, ...], tuple[int, int]] = {}

    def dictionary(self, *, top: bool = False) -> dict[str, Any]:
        if len(self._keys) > _DEEPEST:
            raise ReadError(f"{self._path}: byte {self._at}: more than {_DEEPEST} dictionaries inside each other")
        entries: dict[str, Any] = {}
        while True:
            self._skip()
            if self._at >= len(self._raw):
                if top:
                    return entries
                raise self._cut_off()
            if self._raw[self._at : self._at + 1] == b"}":
                self._at += 1
                return entries
            word = self._WORD.match(self._raw, self._at)
            if word is None:
                raise ReadError(f"{self._path}: byte {self._at}: expected a keyword; the file is damaged")
            self._at = word.end()
            self._skip()
            self._keys.append(word[0].decode("ascii", errors="replace").strip('"'))
            entries[self._keys[-1]] = self._value()
            self._keys.pop()

    def numbers(self, kind: str) -> tuple[NDArray[Any], int]:
        """Read ``N(bytes)`` or ``N{value}`` from here; return the array and where it ends."""
        self._skip()
        match = self._COUNT.match(self._raw, self._at)
        if match is None or kind not in _WIDTHS:
            raise ReadError(f"{self._path}: byte {self._at}: expected a binary list of numbers, found a list of {kind}")
        count, width = int(match[1]), _WIDTHS[kind]
        shape = (count,) if width == 1 else (count, width)
        dtype = np.dtype("<i4" if kind == "label" else "<f8")
        mark = self._raw[match.end() : match.end() + 1]
        if mark == b"{":
            end = self._raw.find(b"}", match.end(), match.end() + _LONGEST_VALUE)
            values = None if end < 0 else _numbers(self._raw[match.end() + 1 : end])
            if values is None or values.size != width:
                raise self._cut_off()
            if dtype.kind == "i" and not (abs(values) < 2**31).all():
                raise ReadError(f"{self._path}: byte {self._at}: {values}: expected a label")
            # one value for all, however many the file claims: no memory is taken for them
            return np.broadcast_to(values.astype(dtype), shape), end + 1
        if count == 0:
            if mark != b"(":
                return np.zeros(shape, dtype), match.end()
            end = match.end() + 1
            if self._raw[end : end + 1] != b")":
                raise self._cut_off()
            return np.zeros(shape, dtype), end + 1
        if not self._binary:
            hint = "set writeFormat binary in system/controlDict"
            raise ReadError(f"{self._path}: byte {self._at}: a list of numbers as text, expected binary; {hint}")
        start = match.end() + 1
        end = start + count * width * dtype.itemsize
        if mark != b"(" or self._raw[end : end + 1] != b")":
            raise self._cut_off()
        return np.frombuffer(self._raw, dtype, count * width, start).reshape(shape), end + 1

    def _value(self) -> Any:
        if self._raw[self._at : self._at + 1] == b"{":
            self._at += 1
            return self.dictionary()
        if match := self._LIST.match(self._raw, self._at):
            self._at = match.end()
            values, self._at = self.numbers(match[1].decode("ascii"))
            self._skip()
            if self._raw[self._at : self._at + 1] != b";":
                raise self._cut_off()
            self._at += 1
            return values
        if match := self._UNIFORM.match(self._raw, self._at):
            self._at = match.end()
            self.uniform[tuple(self._keys)] = match.span(1)
            numbers = _numbers(match[1].strip(b"()"))
            return match[1].decode("ascii", errors="replace") if numbers is None else numbers
        end = self._raw.find(b";", self._at)
        if end < 0:
            raise self._cut_off()
        text = self._raw[self._at : end].decode("ascii", errors="replace").strip()
        self._at = end + 1
        return text

    def _skip(self) -> None:
        while True:
            if match := self._SPACE.match(self._raw, self._at):
                self._at = match.end()
            elif self._raw.startswith(b"/*", self._at):
                end = self._raw.find(b"*/", self._at + 2)
                if end < 0:
                    raise self._cut_off()
                self._at = end + 2
            else:
                return

    def _cut_off(self) -> ReadError:
        return ReadError(
            f"{self._path}: byte {self._at} of {len(self._raw)}: the file is cut off or damaged; expected a field of "
            "OpenFOAM v1912 in binary (double precision, 32-bit labels)"
        )


def _numbers(text: bytes) -> Array | None:
    """Return the number (0-d) or the numbers (n,) in a text, None if it holds something else."""
    try:
        values = np.array([float(word) for word in text.strip(b" ()").split()])
    except ValueError:
        return None
    return values[0] if values.size == 1 else values


def _spread(path: Path, what: str, values: Any, count: int) -> Array:
    """Return an array of ``count`` rows from one that may be uniform."""
    if not isinstance(values, np.ndarray | np.float64) or (values.ndim and not values.size):
        raise ReadError(f"{path}: {what} holds no numbers; expected {count} values")
    array = np.asarray(values)
    if array.ndim == 0 or (array.shape == (3,) and count != 3):
        return np.broadcast_to(array, (count, *array.shape)).copy()
    if len(array) != count:
        raise ReadError(f"{path}: {what} has {len(array)} values, expected {count}")
    return array


def _write_constant(path: Path, kind: str, count: int, value: str) -> None:
    path.write_text(f"{_header(kind, path.name, 'ascii')}\n{count}{{{value}}}\n", "ascii")


def _header(kind: str, name: str, text_format: str) -> str:
    arch = f'arch "{_ARCH}"; ' if text_format == "binary" else ""
    return f"FoamFile {{ version 2.0; format {text_format}; class {kind}; {arch}object {name}; }}\n"


def _read(path: Path) -> bytes:
    return read_limited(path, MAX_BYTES, "a file written by OpenFOAM")


def _read_header(path: Path, raw: bytes) -> tuple[dict[str, str], int]:
    """Return the entries of ``FoamFile`` and where it ends."""
    match = re.search(rb"FoamFile\s*\{([^}]*)\}", raw[:_HEADER_BYTES])
    if match is None:
        raise ReadError(f"{path}: no FoamFile header; expected a file of OpenFOAM")
    text = match[1].decode("ascii", errors="replace")
    pairs: list[tuple[str, str]] = re.findall(r'(\w+)\s+("[^"]*"|[^;]*);', text)
    head = {key: value.strip().strip('"') for key, value in pairs}
    if head.get("format") not in ("ascii", "binary"):
        raise ReadError(f"{path}: format {head.get('format')!r}: expected ascii or binary")
    if head.get("arch", _ARCH) != _ARCH:
        raise ReadError(f"{path}: arch {head['arch']!r}: expected {_ARCH!r} (double precision, 32-bit labels)")
    return head, match.end()
