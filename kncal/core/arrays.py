"""Arrays in ``.npz`` and ``.npy`` files as numpy writes them: plain numbers, nothing compressed, nothing pickled.

`numpy.load` makes an array as large as the header claims before it looks at the data, and unpacks what is
compressed; here everything is checked against the size of the file first, so that memory is bounded by it.
"""

from __future__ import annotations

import io
import math
import re
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kncal.core.errors import ReadError
from kncal.core.files import read_limited

_EXPECTED = "arrays of numbers, as numpy.savez and numpy.save write them"
_MOST_ARRAYS, _MOST_AXES = 64, 8
_DIRECTORY_END = struct.Struct("<4s4H2LH")
_MAGIC = b"\x93NUMPY\x01\x00"
_HEADER = re.compile(
    rb"\{'descr': '([<|][biuf]\d{1,2})', 'fortran_order': (True|False), 'shape': \((\d[\d, ]*)?\), \} *\n"
)


def read_npz(path: Path, most: int) -> dict[str, NDArray[Any]]:
    """Return the arrays of an uncompressed ``.npz`` file of at most ``most`` bytes, by name; of any shape.

    Raises
    ------
    ReadError
        If the file is missing, too large, damaged, compressed, or holds anything but arrays of numbers.
    """
    data = read_limited(path, most, _EXPECTED)
    try:
        _check_directory(data)
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            found = archive.infolist()
            if sum(entry.file_size for entry in found) > len(data):
                raise ValueError("its parts are larger than the file")
            return {_name(entry): _array(archive.read(entry)) for entry in found}
    except (
        ValueError,
        OSError,
        EOFError,
        struct.error,
        NotImplementedError,
        RuntimeError,
        zipfile.BadZipFile,
    ) as error:
        raise ReadError(f"{path}: damaged ({error}); expected {_EXPECTED}") from error


def _check_directory(data: bytes) -> None:
    """Refuse a table of contents that would itself take much memory, before `zipfile` reads it."""
    end = data[-_DIRECTORY_END.size :]
    if len(end) < _DIRECTORY_END.size:
        raise ValueError("cut off")
    mark, _, _, _, entries, size, _, comment = _DIRECTORY_END.unpack(end)
    if mark != b"PK\x05\x06" or comment:
        raise ValueError("no table of contents at the end: cut off?")
    # numpy needs the second, larger table of zip64 only beyond 4 GiB
    if entries > _MOST_ARRAYS or size > 256 * _MOST_ARRAYS or data[-42:-38] == b"PK\x06\x07":
        raise ValueError(f"more than {_MOST_ARRAYS} arrays")


def _name(entry: zipfile.ZipInfo) -> str:
    if entry.compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"{entry.filename!r} is compressed")
    name = entry.filename.removesuffix(".npy")
    if name == entry.filename or not name.isidentifier():
        raise ValueError(f"{entry.filename!r} is no array")
    return name


def _array(data: bytes) -> NDArray[Any]:
    """Return the array in the bytes of a ``.npy`` file; a header that numpy would not write is an error."""
    if not data.startswith(_MAGIC):
        raise ValueError("not an array of numpy")
    start = 10 + int.from_bytes(data[8:10], "little")
    header = _HEADER.fullmatch(data[10:start])
    if header is None:
        raise ValueError(f"not plain numbers: {data[10:80]!r}")
    kind, order, sizes = header.groups(b"")
    shape = tuple(int(size) for size in sizes.split(b",") if size.strip())
    try:
        dtype = np.dtype(kind.decode("ascii"))
    except TypeError as error:
        raise ValueError(f"unknown kind of number {kind!r}") from error
    if len(shape) > _MOST_AXES or math.prod(shape) * dtype.itemsize != len(data) - start:
        raise ValueError(f"{len(data) - start} bytes for shape {shape}")
    numbers = np.frombuffer(data, dtype, offset=start) if len(data) > start else np.empty(0, dtype)
    return numbers.reshape(shape, order="F" if order == b"True" else "C").copy()
