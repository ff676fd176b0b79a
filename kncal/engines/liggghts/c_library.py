"""LIGGGHTS through its C interface: it runs in the process that makes a `Library`, and ends that on any error."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array

LIBRARY, MPI = "libliggghts.so.3", "libmpi.so.40"
#: Columns of the table of contacts with meshes: contact point, centre, number of the mesh, of its triangle, id, force
#: of the wall, overlap (negative: a gap).
WALL_COLUMNS = 13


class Library:
    """LIGGGHTS through its C interface. Rows move and pointers change in every run: fetch them anew after each.

    On several ranks each has some of the particles, and all make the same calls: `whole` makes of what each has what
    all have together.
    """

    ranks, rank = 1, 0

    def __init__(self) -> None:
        self._lib = ctypes.CDLL(LIBRARY, mode=ctypes.RTLD_GLOBAL)
        text, pointer, number = ctypes.c_char_p, ctypes.c_void_p, ctypes.c_int
        for name, result, arguments in (
            ("lammps_open_no_mpi", None, [number, ctypes.POINTER(text), ctypes.POINTER(pointer)]),
            ("lammps_close", None, [pointer]),
            ("lammps_file", None, [pointer, text]),
            ("lammps_command", text, [pointer, text]),
            ("lammps_extract_atom", pointer, [pointer, text]),
            ("lammps_extract_global", pointer, [pointer, text]),
            ("lammps_extract_fix", pointer, [pointer, text] + [number] * 4),
            ("lammps_extract_compute", pointer, [pointer, text, number, number]),
        ):
            function = getattr(self._lib, name)
            function.restype, function.argtypes = result, arguments
        self._libc = ctypes.CDLL(None)
        self._libc.free.argtypes = [pointer]
        # By lines: what a buffer still holds is lost when the library ends the process.
        stdout = pointer.in_dll(self._libc, "stdout")
        self._libc.setvbuf(stdout, None, 1, 0)  # 1: _IOLBF
        words = [b"liggghts", b"-log", b"none"]
        self._handle = pointer()
        self._lib.lammps_open_no_mpi(len(words), (text * len(words))(*words), ctypes.byref(self._handle))

    def file(self, name: str) -> None:
        """Run the commands of a file."""
        self._lib.lammps_file(self._handle, name.encode())

    def command(self, line: str) -> None:
        """Run one command."""
        self._lib.lammps_command(self._handle, line.encode())

    def whole(self, own: NDArray[Any]) -> NDArray[Any]:
        """Return the rows of this rank, and those of all others, in the same order for all that is asked."""
        return own

    def told(self, message: bytes) -> bytes:
        """Return the message that the first rank gives."""
        return message

    def as_at_the_start(self, lines: Iterable[str]) -> None:
        """Run commands that LIGGGHTS takes at step 0 only, for no other reason than that."""
        step = ctypes.c_int64.from_address(self._global("ntimestep"))
        now, step.value = step.value, 0
        for line in lines:
            self.command(line)
        step.value = now

    def close(self) -> None:
        """End LIGGGHTS."""
        self._lib.lammps_close(self._handle)

    @property
    def count(self) -> int:
        """Number of particles that are left."""
        return ctypes.c_int.from_address(self._global("nlocal")).value

    @property
    def step(self) -> int:
        """Steps so far."""
        return ctypes.c_int64.from_address(self._global("ntimestep")).value

    @property
    def ids(self) -> NDArray[np.intp]:
        """Ids less 1, by row."""
        ids = self._view(self._lib.lammps_extract_atom(self._handle, b"id"), ctypes.c_int, self.count)
        return ids.astype(np.intp) - 1

    @property
    def masses(self) -> Array:
        """Masses by row [kg]."""
        return self._view(self._lib.lammps_extract_atom(self._handle, b"rmass"), ctypes.c_double, self.count)

    @property
    def radii(self) -> Array:
        """Radii by row [m]."""
        return self._view(self._lib.lammps_extract_atom(self._handle, b"radius"), ctypes.c_double, self.count)

    @property
    def kinds(self) -> NDArray[np.int64]:
        """Species by row."""
        types = self._view(self._lib.lammps_extract_atom(self._handle, b"type"), ctypes.c_int, self.count)
        return types.astype(np.int64) - 1

    def vectors(self, name: str) -> Array:
        """Return a writable view of a per-particle vector: x, v, omega, f or torque."""
        return self._table(self._lib.lammps_extract_atom(self._handle, name.encode()), self.count, 3)

    def has_fix(self, name: str) -> bool:
        """Whether there is a fix that keeps a vector for each particle under this name."""
        return bool(self._lib.lammps_extract_fix(self._handle, name.encode(), 1, 2, 0, 0))

    def of_fix(self, name: str) -> Array:
        """Return a writable view of the vector that a fix keeps for each particle."""
        return self._table(self._lib.lammps_extract_fix(self._handle, name.encode(), 1, 2, 0, 0), self.count, 3)

    def scalar(self, compute: str) -> float:
        """Return the value of a compute, now."""
        address = self._lib.lammps_extract_compute(self._handle, compute.encode(), 0, 0)
        return ctypes.c_double.from_address(address).value

    def number(self, fix: str, place: int | None = None) -> float:
        """Return the number that a fix gives, or the one at ``place`` of its numbers."""
        kind, place = (0, 0) if place is None else (1, place)
        address = self._lib.lammps_extract_fix(self._handle, fix.encode(), 0, kind, place, 0)
        value = ctypes.c_double.from_address(address).value
        self._libc.free(address)
        return value

    def contacts(self) -> Array:
        """Return a row for every particle-particle contact now: both ids, whether across a period, overlap [m]."""
        return self._local("contacts", "overlap", 4)

    def wall_contacts(self) -> Array:
        """Return a row for every particle near a triangle of a mesh now, of `WALL_COLUMNS`."""
        return self._local("wall_contacts", "wall_contacts", WALL_COLUMNS)

    def _local(self, compute: str, reduced: str, columns: int) -> Array:
        total, mean = self.scalar(f"{reduced}_sum"), self.scalar(f"{reduced}_mean")
        if mean == 0.0:
            return np.empty((0, columns))
        # The library does not tell the number of rows of a local compute; sum over mean is it.
        return self._rows_of(compute, round(total / mean), columns)

    def _rows_of(self, compute: str, rows: int, columns: int) -> Array:
        address = self._lib.lammps_extract_compute(self._handle, compute.encode(), 2, 2)
        return self._table(address, rows, columns)

    def _global(self, name: str) -> int:
        return int(self._lib.lammps_extract_global(self._handle, name.encode()))

    @classmethod
    def _table(cls, address: int, rows: int, columns: int) -> Array:
        """Return a view of a table, given where its rows' addresses begin; its rows follow each other."""
        if rows == 0:
            return np.empty((0, columns))
        first = ctypes.c_size_t.from_address(address).value
        return cls._view(first, ctypes.c_double, rows * columns).reshape(rows, columns)

    @staticmethod
    def _view(address: int, kind: type[Any], length: int) -> NDArray[Any]:
        # Several times quicker than numpy.ctypeslib.as_array, and there are a dozen in each interval.
        return np.frombuffer((kind * length).from_address(address), dtype=kind)


class RankLibrary(Library):
    """One of several ranks; Open MPI's own calls bring together what they have."""

    _TABLE = "rows.txt"

    def __init__(self) -> None:
        super().__init__()
        self._mpi = ctypes.CDLL(MPI, mode=ctypes.RTLD_GLOBAL)
        number = ctypes.c_int
        self._world, self._byte = (
            ctypes.c_void_p(ctypes.addressof(number.in_dll(self._mpi, name)))
            for name in ("ompi_mpi_comm_world", "ompi_mpi_byte")
        )
        rank, ranks = number(), number()
        self._mpi.MPI_Comm_rank(self._world, ctypes.byref(rank))
        self._mpi.MPI_Comm_size(self._world, ctypes.byref(ranks))
        self.rank, self.ranks = rank.value, ranks.value

    def whole(self, own: NDArray[Any]) -> NDArray[Any]:
        """Return the rows of all ranks, those of the first rank first."""
        own = np.ascontiguousarray(own)
        mine, sizes = np.array([own.nbytes], dtype=np.int32), np.zeros(self.ranks, dtype=np.int32)
        one = ctypes.c_int(4)
        self._mpi.MPI_Allgather(_at(mine), one, self._byte, _at(sizes), one, self._byte, self._world)
        begins = np.concatenate(([0], np.cumsum(sizes)[:-1])).astype(np.int32)
        row = own.nbytes // len(own) if len(own) else own.itemsize * int(np.prod(own.shape[1:]))
        found = np.empty((int(sizes.sum()) // row, *own.shape[1:]), dtype=own.dtype)
        parts = (_at(own), ctypes.c_int(own.nbytes), self._byte, _at(found), _at(sizes), _at(begins), self._byte)
        self._mpi.MPI_Allgatherv(*parts, self._world)
        return found

    def told(self, message: bytes) -> bytes:
        """Return the message of the first rank, the same on all."""
        size = ctypes.c_int(len(message))
        self._mpi.MPI_Bcast(ctypes.byref(size), ctypes.c_int(4), self._byte, ctypes.c_int(0), self._world)
        text = ctypes.create_string_buffer(message, max(size.value, 1))
        self._mpi.MPI_Bcast(text, size, self._byte, ctypes.c_int(0), self._world)
        return text.raw[: size.value]

    def close(self) -> None:
        """End LIGGGHTS and this rank's part in what the ranks do together."""
        super().close()
        self._mpi.MPI_Finalize()

    def _rows_of(self, compute: str, rows: int, columns: int) -> Array:
        # How many of the rows are this rank's is told nowhere; LIGGGHTS itself writes all of them.
        places = " ".join(f"c_{compute}[{column + 1}]" for column in range(columns))
        self.command(f'write_dump all local {self._TABLE} {places} modify format "{" ".join(["%.17g"] * columns)}"')
        found = np.empty(0)
        if self.rank == 0:
            found = np.loadtxt(self._TABLE, skiprows=9, ndmin=2)
            Path(self._TABLE).unlink()
        return self.whole(found.ravel()).reshape(rows, columns)


def _at(array: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
