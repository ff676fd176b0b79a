"""The process that holds LIGGGHTS: any error of the library ends the process that loaded it, so it is never ours.

Started by `kncal.engines.liggghts.library`: ``python -m kncal.engines.liggghts.library_child '{"count": 5, ...}'`` in
the folder of the deck.
It runs the deck, then answers one JSON message with one JSON message; arrays go through a shared mapping, by id.
What LIGGGHTS prints is this process' standard output, which is a log file.
"""

from __future__ import annotations

import ctypes
import itertools
import json
import mmap
import os
import socket
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.solver_process import MAX_MESSAGE
from kncal.engines.liggghts.impacts import BINS, POWERS, Before, count_speeds, pair_speeds, wall_speeds

LIBRARY = "libliggghts.so.3"
#: Environment variable with the numbers of the inherited socket and memory.
VARIABLE = "KNCAL_PARTICLES"
#: Overlaps are looked at about every so many steps, at least once in an interval and at its end. One look costs as much
#: as 1.5 steps, so this is 4 % of the run.
LOOK_EVERY = 40
#: New contacts are watched for in the last step of an interval, about once in so many steps; that costs 2 or 3 steps.
WATCH_EVERY = 80
#: Overlap bins per decade, and the smallest overlap that is told apart from nothing, in diameters.
BINS_PER_DECADE, DECADES = 20, 8
_OVERLAP_BINS = DECADES * BINS_PER_DECADE + 1
#: Output of the runs beyond so many bytes is dropped; that of the deck is kept.
MAX_LOG = 1 << 16

SAVED_FORCES = "forces.npz"


def histogram_edges(diameter: float) -> Array:
    """Return the edges of the overlap bins [m]: 0, then 20 a decade from 1e-8 to 1 diameter."""
    decades = np.arange(DECADES * BINS_PER_DECADE + 1) / BINS_PER_DECADE - DECADES
    return np.concatenate(([0.0], diameter * 10.0**decades))


@dataclass(frozen=True)
class Shared:
    """The mapping that parent and child share: positions, velocities, gas forces (n, 3) by id; what was looked at.

    ``histogram``: (bins,) overlaps; ``impacts``: (2, bins) speeds of new contacts of two particles, and of a particle
    and a wall (see `kncal.engines.liggghts.impacts`); ``impact_sums``: (2, 3) sums of v, v², v³ of both.
    """

    x: Array
    v: Array
    force: Array
    histogram: Array
    impacts: Array
    impact_sums: Array

    @staticmethod
    def size(count: int) -> int:
        """Return the bytes that ``count`` particles need."""
        return 8 * (9 * count + _OVERLAP_BINS + 2 * BINS + 2 * POWERS)

    @classmethod
    def over(cls, buffer: mmap.mmap, count: int) -> Shared:
        """Return views of ``buffer``, which keep it open."""
        numbers = np.frombuffer(buffer, dtype=np.float64)
        x, v, force = (numbers[3 * count * i : 3 * count * (i + 1)].reshape(count, 3) for i in range(3))
        histogram, impacts, sums = np.split(numbers[9 * count :], (_OVERLAP_BINS, _OVERLAP_BINS + 2 * BINS))
        return cls(
            x=x,
            v=v,
            force=force,
            histogram=histogram,
            impacts=impacts.reshape(2, BINS),
            impact_sums=sums.reshape(2, POWERS),
        )


class Library:
    """LIGGGHTS through its C interface. Rows move and pointers change in every run: fetch them anew after each."""

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
    def rows(self) -> NDArray[np.intp]:
        """Row of the callers' arrays (id - 1) for each row of LIGGGHTS."""
        ids = self._view(self._lib.lammps_extract_atom(self._handle, b"id"), ctypes.c_int, self.count)
        return ids.astype(np.intp) - 1

    @property
    def masses(self) -> Array:
        """Masses by row [kg]."""
        return self._view(self._lib.lammps_extract_atom(self._handle, b"rmass"), ctypes.c_double, self.count)

    def vectors(self, name: str) -> Array:
        """Return a writable view of a per-particle vector: x, v, omega, f, torque; or dragforce."""
        if name == "dragforce":
            address = self._lib.lammps_extract_fix(self._handle, b"dragforce", 1, 2, 0, 0)
        else:
            address = self._lib.lammps_extract_atom(self._handle, name.encode())
        return self._table(address, self.count, 3)

    def scalar(self, compute: str) -> float:
        """Return the value of a compute, now."""
        address = self._lib.lammps_extract_compute(self._handle, compute.encode(), 0, 0)
        return ctypes.c_double.from_address(address).value

    def mean(self, fix: str) -> float:
        """Return the value of a ``fix ave/time`` with one column."""
        address = self._lib.lammps_extract_fix(self._handle, fix.encode(), 0, 0, 0, 0)
        value = ctypes.c_double.from_address(address).value
        self._libc.free(address)
        return value

    def contacts(self) -> Array:
        """Return a row for every particle-particle contact now: both ids, whether across a period, overlap [m]."""
        total, mean = self.scalar("overlap_sum"), self.scalar("overlap_mean")
        if mean == 0.0:
            return np.empty((0, 4))
        # The library does not tell the number of rows of a local compute; sum over mean is it.
        address = self._lib.lammps_extract_compute(self._handle, b"contacts", 2, 2)
        return self._table(address, round(total / mean), 4)

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


class Child:
    """Runs the deck, then what the parent asks for."""

    def __init__(self, lib: Library, shared: Shared, given: dict[str, Any]) -> None:
        self.lib, self.shared, self.given = lib, shared, given
        saved, self._diameter = str(given["saved"]), float(given["diameter"])
        lib.file(str(given["deck"]))
        self._samples = 1  # of the running mean of the floor force: the deck took one
        self._floor = lib.scalar("floor")
        # The deck ended with the forces of the start; a first force from the gas is added by hand (see `run`).
        self._fresh = not saved
        if saved:
            self._restore(Path(saved))
        self.publish()

    def publish(self) -> dict[str, Any]:
        """Put positions and velocities into the shared arrays, by id; return what every answer holds."""
        rows = self.lib.rows
        if len(rows) == len(self.shared.x):
            # By the inverse of rows: to take rows of three is ten times quicker than to put them.
            places = _inverse(rows)
            for name, to in (("x", self.shared.x), ("v", self.shared.v)):
                self.lib.vectors(name).take(places, axis=0, out=to, mode="clip")
            if self.given["period"] is not None:
                # LIGGGHTS brings a particle back into a periodic box only when it makes neighbour lists.
                self.shared.x[:, 1] %= float(self.given["period"])
        return {
            "count": len(rows),
            "step": self.lib.step,
            "in_plane": self.given["plane"] is None or self._in_plane(float(self.given["plane"])),
        }

    def run(self, steps: int) -> dict[str, Any]:
        """Hold the shared force and run ``steps``; reactions and overlaps of this interval."""
        rows = self.lib.rows
        force = self.shared.force.take(rows, axis=0)
        old = self.lib.vectors("dragforce")[:, 2].sum()
        if self._fresh:
            old = force[:, 2].sum()
            # The first half kick uses forces that the deck computed without gas.
            self.lib.vectors("f")[:] += force
            self._fresh = False
        self.lib.vectors("dragforce")[:] = force
        before, first, momentum = self._sum(), self._floor, self._momentum()
        for sums in (self.shared.histogram, self.shared.impacts, self.shared.impact_sums):
            sums[:] = 0.0
        self._watched = 0.0
        number, total, largest, samples = 0, 0.0, 0.0, 0
        for contacts in self._looks(steps):
            overlaps = contacts[:, 3]
            samples += 1
            if len(overlaps):
                number, total = number + len(overlaps), total + float(overlaps.sum())
                largest = max(largest, float(overlaps.max()))
                self.shared.histogram[:] += self._bins(overlaps)
        self._samples += steps
        self._floor = self.lib.scalar("floor")
        # Velocity Verlet gives half the first force and half the last: the trapezoidal sum is the impulse.
        floor = (self._sum() - before + 0.5 * (first - self._floor)) / steps
        gas = ((steps - 0.5) * force[:, 2].sum() + 0.5 * old) / steps
        gain = (self._momentum() - momentum) / (steps * float(self.given["dt"]))
        weight = float(self.given["gravity"]) * self.lib.masses.sum()
        return {
            "floor": floor,
            # To add up the other walls' forces in every step would cost 2 % of the run for each of them.
            "other_walls": gain + weight - gas - floor,
            "contacts": number / samples,
            "overlap_max": largest,
            "overlap_mean": total / number if number else 0.0,
            "watched": self._watched,
        }

    def save(self) -> dict[str, Any]:
        """Write the state: LIGGGHTS' restart with the contact history, and the forces of the last step.

        A restart alone is set up with forces that LIGGGHTS computes anew, with other velocities than a run does.
        Writing it sorts the particles anew, so this process goes on exactly as the one that will read it.
        """
        forces = {"f": self._by_id("f"), "torque": self._by_id("torque"), "floor": np.array(self._floor)}
        np.savez(SAVED_FORCES, **forces)  # type: ignore[arg-type]  # the stubs mistake the names for options
        self.lib.command("write_restart particles.restart")
        self.lib.command("run 0 post no")
        self._restore(Path(SAVED_FORCES))
        return {}

    def _looks(self, steps: int) -> Iterator[Array]:
        """Run, and give the contacts (see `Library.contacts`) on the way and at the end; they are gone at the next."""
        *parts, last = split(steps, max(1, round(steps / LOOK_EVERY)))
        for part in parts:
            self._advance(part)
            yield self.lib.contacts()
        # by the count of all steps, so that a continued run watches in the same intervals
        end = self.lib.step + last
        watched = end // WATCH_EVERY > (end - steps) // WATCH_EVERY
        self._advance(last - 1 if watched else last)
        earlier = self._before() if watched else None
        self._advance(1 if watched else 0)
        contacts = self.lib.contacts()
        if earlier is not None:
            self._see_impacts(earlier, contacts)
        yield contacts

    def _advance(self, steps: int) -> None:
        if steps > 0:
            self.lib.command(f"run {steps} pre no post no")

    def _before(self) -> Before | None:
        """Copy what the impact speeds of the next step's new contacts are made of; None if particles are lost."""
        rows = self.lib.rows
        if len(rows) != len(self.shared.x):
            return None
        x, v, force = (self.lib.vectors(name).copy() for name in ("x", "v", "f"))
        return Before(x=x, v=v, force=force, row=_inverse(rows), mass=float(self.lib.masses[0]))

    def _see_impacts(self, before: Before, contacts: Array) -> None:
        """Count the impact speeds of the contacts that began in the last step."""
        rows = self.lib.rows
        if len(rows) != len(self.shared.x):
            return  # the parent will end this run
        self._watched = float(self.given["dt"])
        first, second = (contacts[:, k].astype(np.intp) - 1 for k in (0, 1))
        period = self.given["period"] or 0.0
        pairs = pair_speeds(before, first, second, self._diameter, period)
        walls = wall_speeds(before, self.lib.vectors("x"), rows, self.given["sides"], 0.5 * self._diameter)
        for kind, speeds in enumerate((pairs, walls)):
            if len(speeds):
                self.shared.impacts[kind] += count_speeds(speeds)
                self.shared.impact_sums[kind] += [(speeds**power).sum() for power in (1, 2, 3)]

    def _restore(self, path: Path) -> None:
        rows = self.lib.rows
        with np.load(path, allow_pickle=False) as saved:
            self.lib.vectors("f")[:] = saved["f"][rows]
            self.lib.vectors("torque")[:] = saved["torque"][rows]
            self._floor = float(saved["floor"])

    def _by_id(self, name: str) -> Array:
        out = np.empty_like(self.shared.x)
        out[self.lib.rows] = self.lib.vectors(name)
        return out

    def _sum(self) -> float:
        """Return the floor force summed over all steps so far (the fix gives its mean)."""
        return self._samples * self.lib.mean("floor_mean")

    def _momentum(self) -> float:
        """Return the upward momentum of all particles [N s]."""
        return float(self.lib.masses @ self.lib.vectors("v")[:, 2])

    def _in_plane(self, y: float) -> bool:
        """Whether every particle is exactly in the plane and neither moves nor spins out of it."""
        x, v, spin = (self.lib.vectors(name) for name in ("x", "v", "omega"))
        return bool((x[:, 1] == y).all()) and not (v[:, 1].any() or spin[:, 0].any() or spin[:, 2].any())

    def _bins(self, overlaps: Array) -> Array:
        with np.errstate(divide="ignore"):  # an overlap of exactly 0 belongs to the first bin
            place = np.floor((np.log10(overlaps / self._diameter) + DECADES) * BINS_PER_DECADE) + 1.0
        last = DECADES * BINS_PER_DECADE
        return np.bincount(np.clip(place, 0, last).astype(np.intp), minlength=last + 1).astype(np.float64)


def _inverse(rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the row of LIGGGHTS for each row of the callers' arrays."""
    places = np.empty_like(rows)
    places[rows] = np.arange(len(rows))
    return places


def split(steps: int, parts: int) -> list[int]:
    """Return ``steps`` in at most ``parts`` whole, nearly equal parts."""
    marks = [steps * i // parts for i in range(parts + 1)]
    return [b - a for a, b in itertools.pairwise(marks) if b > a]


def serve(channel: socket.socket, child: Child, kept: int) -> None:
    """Answer until the parent closes the socket, or is gone."""
    channel.send(json.dumps(child.publish()).encode())
    while message := channel.recv(MAX_MESSAGE):
        request = json.loads(message)
        answer = child.save() if request["do"] == "save" else child.run(int(request["steps"]))
        if os.fstat(1).st_size > kept + MAX_LOG:
            os.ftruncate(1, kept)  # opened for appending: the next line follows the deck's
        channel.send(json.dumps(answer | child.publish()).encode())


def main(arguments: list[str]) -> None:
    """Take the inherited socket and mapping, and serve."""
    given = json.loads(arguments[0])
    count = int(given["count"])
    channel, memory = map(int, os.environ[VARIABLE].split())
    shared = Shared.over(mmap.mmap(memory, Shared.size(count)), count)
    library = Library()
    serve(socket.socket(fileno=channel), Child(library, shared, given), os.fstat(1).st_size)
    library.close()


if __name__ == "__main__":
    main(sys.argv[1:])
