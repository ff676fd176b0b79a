"""Arrays in ``.npz`` and ``.npy`` files as numpy writes them: plain numbers, nothing compressed, nothing pickled.

`numpy.load` makes an array as large as the header claims before it looks at the data, and unpacks what is
compressed; here everything is checked against the size of the file first, so that memory is bounded by it.
"""

from __future__ import annotations

import math
import os
import re
import struct
import zipfile
from collections.abc import Callable, Container
from pathlib import Path
from typing import IO, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from kncal.core.errors import ReadError
from kncal.core.files import open_limited

_EXPECTED = "arrays of numbers, as numpy.savez and numpy.save write them"
_MOST_ARRAYS, _MOST_AXES = 64, 8
_DIRECTORY_END = struct.Struct("<4s4H2LH")
_MAGIC = b"\x93NUMPY\x01\x00"
_HEADER = re.compile(
    rb"\{'descr': '([<|][biuf]\d{1,2})', 'fortran_order': (True|False), 'shape': \((\d[\d, ]*)?\), \} *\n"
)
_T = TypeVar("_T")


class ArrayShape(NamedTuple):
    """Kind of number and shape of an array."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]


def read_npz(path: Path, most: int, names: Container[str] | None = None) -> dict[str, NDArray[Any]]:
    """Return the arrays of an uncompressed ``.npz`` file of at most ``most`` bytes, by name; of any shape.

    ``names``: only these are read; None: all.

    Raises
    ------
    ReadError
        If the file is missing, too large, damaged, compressed, or holds anything but arrays of numbers.
    """
    return _of_each(path, most, lambda name: names is None or name in names, _array)


def npz_shapes(path: Path, most: int) -> dict[str, ArrayShape]:
    """Return kind and shape of the arrays of such a file, of which only the heads are read; errors as `read_npz`."""
    return _of_each(path, most, lambda _: True, lambda file, size: _head(file, size)[0])


def _of_each(
    path: Path, most: int, wanted: Callable[[str], bool], part: Callable[[IO[bytes], int], _T]
) -> dict[str, _T]:
    with open_limited(path, most, _EXPECTED) as file:
        try:
            size = os.fstat(file.fileno()).st_size
            _check_directory(file, size)
            with zipfile.ZipFile(file) as archive:
                found = archive.infolist()
                if sum(entry.file_size for entry in found) > size:
                    raise ValueError("its parts are larger than the file")
                arrays = {}
                for entry in found:
                    if wanted(name := _name(entry)):
                        with archive.open(entry) as stored:
                            arrays[name] = part(stored, entry.file_size)
                return arrays
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


def _check_directory(file: IO[bytes], size_of_file: int) -> None:
    """Refuse a table of contents that would itself take much memory, before `zipfile` reads it."""
    file.seek(max(size_of_file - _DIRECTORY_END.size - 20, 0))
    data = file.read()
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


def _head(file: IO[bytes], size: int) -> tuple[ArrayShape, bool]:
    """Read the head of a ``.npy`` file of ``size`` bytes: what it holds, and whether its first index is the quickest.

    A header that numpy would not write is an error.
    """
    begin = file.read(10)
    if not begin.startswith(_MAGIC):
        raise ValueError("not an array of numpy")
    length = int.from_bytes(begin[8:10], "little")
    head = file.read(length)
    header = _HEADER.fullmatch(head)
    if header is None:
        raise ValueError(f"not plain numbers: {head[:70]!r}")
    kind, order, sizes = header.groups(b"")
    shape = tuple(int(number) for number in sizes.split(b",") if number.strip())
    try:
        dtype = np.dtype(kind.decode("ascii"))
    except TypeError as error:
        raise ValueError(f"unknown kind of number {kind!r}") from error
    left = size - 10 - length
    if len(shape) > _MOST_AXES or math.prod(shape) * dtype.itemsize != left:
        raise ValueError(f"{left} bytes for shape {shape}")
    return ArrayShape(dtype, shape), order == b"True"


def _array(file: IO[bytes], size: int) -> NDArray[Any]:
    """Return the array in a ``.npy`` file of ``size`` bytes."""
    (dtype, shape), turned = _head(file, size)
    data = file.read()
    numbers = np.frombuffer(data, dtype) if data else np.empty(0, dtype)
    return numbers.reshape(shape, order="F" if turned else "C").copy()
