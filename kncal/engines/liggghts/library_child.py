"""The process that holds LIGGGHTS: any error of the library ends the process that loaded it, so it is never ours.

Started by `kncal.engines.liggghts.library`: ``python -m kncal.engines.liggghts.library_child '{"count": 5, ...}'`` in
the folder of the deck.
It runs the deck, then answers one JSON message with one JSON message; arrays go through a shared mapping, by row.
What LIGGGHTS prints is this process' standard output, which is a log file.

A particle keeps its row for ever. LIGGGHTS gives the id of one that was deleted to a new one, so rows follow ids only
until then.
"""

from __future__ import annotations

import itertools
import json
import mmap
import os
import socket
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kncal.core.checks import Array
from kncal.core.solver_process import MAX_MESSAGE
from kncal.engines.liggghts.c_library import Library, RankLibrary
from kncal.engines.liggghts.impacts import (
    Before,
    Speeds,
    Surface,
    count_speeds,
    mesh_speeds,
    pair_speeds,
    wall_speeds,
)
from kncal.engines.liggghts.rows import Rows, inverse
from kncal.engines.liggghts.shared import BINS_PER_DECADE, DECADES, Shared, Sizes

#: Environment variable with the numbers of the inherited socket and memory.
VARIABLE = "KNCAL_PARTICLES"
#: Overlaps are looked at about every so many steps, at least once in an interval and at its end: with gas, and without,
#: where more else is looked at. One look costs as much as 1.5 steps, so this is 4 % and 1 % of the run.
LOOK_EVERY, SELDOM = 40, 150
#: New contacts are watched for in the last step of an interval, about once in so many steps; that costs 2 or 3 steps.
WATCH_EVERY = 80
#: Output of the runs beyond so many bytes is dropped; that of the deck is kept.
MAX_LOG = 1 << 16

SAVED_FORCES = "forces.npz"


class Child:
    """Runs the deck, then what the parent asks for; ``given``: what `kncal.engines.liggghts.library` says of it."""

    def __init__(self, lib: Library, shared: Shared, given: dict[str, Any]) -> None:
        self.lib, self.shared, self.given = lib, shared, given
        self._up, self._periods = np.array(given["up"]), given["periods"]
        self._rows = Rows(len(shared.x))
        self._tally = _Tally(given["pairs"], given["kinds"])
        saved = str(given["saved"])
        deck = Path(str(given["deck"]))
        lib.file(deck.name)
        #: LIGGGHTS takes no wall away that has these tables.
        self._tables = [
            line
            for line in deck.read_text("ascii").splitlines()
            if line.startswith("compute") and "wall_contacts" in line
        ]
        self._samples = 1  # of the running mean of the floor force: the deck took one
        self._floor = lib.scalar("floor") if given["floor"] else 0.0
        self._gas = lib.has_fix("dragforce")
        # The deck ended with the forces of the start; a first force from the gas is added by hand (see `run`).
        self._fresh = not saved
        self._out = np.zeros((len(given["outlets"]), 3))
        if saved:
            with np.load(saved, allow_pickle=False) as state:
                self._put(state)
                self._floor = float(state["floor"])
                self._rows.load(state["row_of_id"], int(state["next_row"]))
                # A restart brings back some of an outlet's numbers, not all.
                self._out = state["out"] - self._passed()
        self.publish()

    def publish(self) -> dict[str, Any]:
        """Put positions, velocities and species into the shared arrays, by row; return what every answer holds."""
        shared, lib = self.shared, self.lib
        rows, kinds = self._rows(lib.whole(lib.ids)), lib.whole(lib.kinds)
        vectors = [
            (lib.whole(lib.vectors(name)), to)
            for name, to in (("x", shared.x), ("v", shared.v), ("omega", shared.spin))
        ]
        if len(rows) == len(shared.x):
            # By the inverse of rows: to take rows of three is ten times quicker than to put them.
            places = inverse(rows, len(rows))
            for vector, to in vectors:
                vector.take(places, axis=0, out=to, mode="clip")
            kinds.take(places, out=shared.kind, mode="clip")
        elif not self._rows.full:
            shared.kind[:] = -1
            shared.kind[rows] = kinds
            for vector, to in vectors:
                to[:] = np.nan
                to[rows] = vector
        for axis, period in enumerate(self._periods):
            if period:
                # LIGGGHTS brings a particle back into a periodic box only when it makes neighbour lists.
                low = float(self.given["low"][axis])
                shared.x[:, axis] = low + (shared.x[:, axis] - low) % period
        passed = self._out + self._passed()
        return {
            "count": len(rows),
            "step": self.lib.step,
            "in_plane": self.given["plane"] is None or self._in_plane(float(self.given["plane"])),
            "come": self._rows.come,
            "out_number": passed[:, 0].round().astype(int).tolist(),
            "out_mass": passed[:, 1].tolist(),
            "deleted": int(passed[:, 2].sum().round()),
            "cpu": float(lib.whole(np.array([time.process_time()])).sum()),
        }

    def run(self, steps: int, with_force: bool) -> dict[str, Any]:
        """Run ``steps``, if asked with the shared force held; reactions and overlaps of this interval."""
        old, push = self._hold(with_force)
        floor_before, first, momentum = self._sum(), self._floor, self._momentum()
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
        self._add_wall_forces()
        return self._balance(steps, floor_before, first, momentum, old, push) | {
            "contacts": number / samples,
            "overlap_max": largest,
            "overlap_mean": total / number if number else 0.0,
            "watched": self._watched,
        }

    def _hold(self, with_force: bool) -> tuple[float, float]:
        """Put the shared force on the particles; return the sums along up [N] of that before, and of this."""
        if not self._gas:
            return 0.0, 0.0
        held = self.lib.of_fix("dragforce")
        force = self.shared.force.take(self._rows(self.lib.ids), axis=0) if with_force else held.copy()
        old = float((held @ self._up).sum())
        push = float((force @ self._up).sum())
        if self._fresh:
            old = push
            # The first half kick uses forces that the deck computed without gas.
            self.lib.vectors("f")[:] += force
            self._fresh = False
        held[:] = force
        return old, push

    def _balance(
        self, steps: int, before: float, first: float, momentum: float, old: float, push: float
    ) -> dict[str, float]:
        """Return the forces on the floor and on the other walls, means over the interval [N]."""
        gas = ((steps - 0.5) * push + 0.5 * old) / steps
        gain = (self._momentum() - momentum) / (steps * float(self.given["dt"]))
        weight = float(self.given["gravity"]) * self.lib.whole(self.lib.masses).sum()
        others = gain + weight - gas
        if self.given["flows"]:
            others = float("nan")  # particles that come and go bring momentum, and take it along
        if not self.given["floor"]:
            return {"floor": float("nan"), "other_walls": others}
        self._samples += steps
        self._floor = self.lib.scalar("floor")
        # Velocity Verlet gives half the first force and half the last: the trapezoidal sum is the impulse.
        floor = (self._sum() - before + 0.5 * (first - self._floor)) / steps
        # To add up the other walls' forces in every step would cost 2 % of the run for each of them.
        return {"floor": floor, "other_walls": others - floor}

    def change(self, commands: Sequence[str], walls: Mapping[str, Any]) -> dict[str, Any]:
        """Carry out commands between two intervals; forces and motion stay as they are.

        ``walls``: what is then to be known of walls, if they change.
        """
        forces, tables = self._forces(), [line for line in self._tables if "unfix meshes" in map(_plain, commands)]
        for line in reversed(tables):
            self.lib.command(f"uncompute {line.split()[1]}")
        for command in commands:
            self.lib.command(command)
        self.given |= walls
        if self.given["meshes"]:
            self.lib.as_at_the_start(tables)
        self.lib.command("run 0 post no")
        self._put(forces)
        return {}

    def save(self) -> dict[str, Any]:
        """Write the state: LIGGGHTS' restart with the contact history, and the forces of the last step.

        A restart alone is set up with forces that LIGGGHTS computes anew, with other velocities than a run does.
        Writing it sorts the particles anew, so this process goes on exactly as the one that will read it.
        """
        row_of_id, next_row = self._rows.state
        state = self._forces() | {
            "floor": np.array(self._floor),
            "row_of_id": row_of_id,
            "next_row": np.array(next_row),
            "out": self._out + self._passed(),
        }
        if self.lib.rank == 0:
            np.savez(SAVED_FORCES, **state)  # type: ignore[arg-type]  # the stubs mistake the names for options
        self.lib.command("write_restart particles.restart")
        self.lib.command("run 0 post no")
        self._put(state)
        return {}

    def _looks(self, steps: int) -> Iterator[Array]:
        """Run, and give the contacts (see `Library.contacts`) on the way and at the end; they are gone at the next."""
        every = LOOK_EVERY if self._gas else SELDOM
        # What several ranks have in contact is brought together through a file: that is dearer.
        *parts, last = split(steps, max(1, round(steps / every)) if self.lib.ranks == 1 else 1)
        for part in parts:
            self._advance(part)
            yield self.lib.contacts()
        # by the count of all steps, so that a continued run watches in the same intervals
        end = self.lib.step + last
        watched = end // WATCH_EVERY > (end - steps) // WATCH_EVERY
        apart = watched or any(outlet["deletes"] for outlet in self.given["outlets"])
        self._advance(last - 1 if apart else last)
        earlier = self._before() if watched else None
        if apart:
            self._last_step()
        contacts = self.lib.contacts()
        if earlier is not None:
            self._see_impacts(*earlier, contacts)
        yield contacts

    def _advance(self, steps: int) -> None:
        if steps > 0:
            self.lib.command(f"run {steps} pre no post no")

    def _last_step(self) -> None:
        """Run one step; with new neighbour lists if particles may be deleted: they go only when these are made.

        So at the end of an interval none is marked to go: a restart would forget the mark.
        """
        if not self._leaving():
            return self._advance(1)
        self.lib.command("neigh_modify check no")
        self._advance(1)
        self.lib.command("neigh_modify check yes")

    def _leaving(self) -> bool:
        """Whether a particle is near an outlet that deletes, or was marked to go."""
        x = self.lib.whole(self.lib.vectors("x"))
        for outlet, (number, _, deleted) in zip(self.given["outlets"], self._out + self._passed(), strict=True):
            near = np.abs(x[:, outlet["axis"]] - outlet["position"]) < outlet["reach"]
            if outlet["deletes"] and (number > deleted or near.any()):
                return True
        return False

    def _before(self) -> tuple[Before, Array]:
        """Copy what the impact speeds of the next step's new contacts are made of."""
        lib = self.lib
        before = Before(
            x=lib.whole(lib.vectors("x").copy()),
            v=lib.whole(lib.vectors("v").copy()),
            push=lib.whole(lib.vectors("f") / lib.masses[:, None]),
            radius=lib.whole(lib.radii.copy()),
            kind=lib.whole(lib.kinds),
            row=inverse(lib.whole(lib.ids), len(self.shared.x)),
        )
        return before, lib.wall_contacts().copy() if self.given["meshes"] else np.empty((0, 0))

    def _see_impacts(self, before: Before, near: Array, contacts: Array) -> None:
        """Count the impact speeds of the contacts that began in the last step."""
        given, ids, x = self.given, self.lib.whole(self.lib.ids), self.lib.whole(self.lib.vectors("x"))
        self._watched = dt = float(given["dt"])
        first, second = (contacts[:, k].astype(np.intp) - 1 for k in (0, 1))
        seen = [pair_speeds(before, first, second, self._periods)]
        seen += [wall_speeds(before, x, ids, Surface(*wall)) for wall in given["surfaces"]]
        if given["meshes"]:
            kinds = [mesh["kind"] for mesh in given["meshes"]]
            seen.append(mesh_speeds(before, near, self.lib.wall_contacts(), kinds, dt))
        for speeds in seen:
            self._tally(self.shared, speeds)

    def _add_wall_forces(self) -> None:
        """Put the forces of the particles on the walls, by height, into the shared array [N]."""
        forces, edges = self.shared.wall_force, np.array(self.given["heights"])
        forces[:] = 0.0
        if not len(forces):
            return
        heights = self.lib.whole(self.lib.vectors("x")) @ self._up
        for wall, fix in self.given["forces"]:
            _add_by_height(forces[wall], edges, heights, self.lib.whole(self.lib.of_fix(fix)))
        if self.given["meshes"]:
            near = self.lib.wall_contacts()
            near = near[near[:, 12] > 0.0]
            for number, mesh in enumerate(self.given["meshes"]):
                own = near[near[:, 6] == number]
                _add_by_height(forces[mesh["wall"]], edges, own[:, 3:6] @ self._up, own[:, 9:12])
        if self.given["held"]:
            # With their own weight; the last of the "walls".
            total = np.array([[-self.lib.number("freeze", axis) for axis in range(3)]])
            held = np.isin(self.lib.whole(self.lib.kinds), self.given["held"])
            _add_by_height(forces[-1], edges, heights[held].mean(keepdims=True), total)

    def _forces(self) -> dict[str, Array]:
        """Return forces and torques by id."""
        found, ids = {}, self.lib.whole(self.lib.ids)
        for name in ("f", "torque"):
            found[name] = np.full_like(self.shared.x, np.nan)
            found[name][ids] = self.lib.whole(self.lib.vectors(name))
        return found

    def _put(self, forces: Mapping[str, Array]) -> None:
        ids = self.lib.ids
        for name in ("f", "torque"):
            self.lib.vectors(name)[:] = forces[name][ids]

    def _passed(self) -> Array:
        """Return what each outlet counts: number and mass [kg] that passed it, and number that was deleted there."""
        outlets = self.given["outlets"]
        found = [[self.lib.number(outlet["fix"], place) for place in (1, 0, 5)] for outlet in outlets]
        passed = np.array(found).reshape(-1, 3)
        passed[[not outlet["deletes"] for outlet in outlets], 2] = 0.0
        return passed

    def _sum(self) -> float:
        """Return the floor force summed over all steps so far (the fix gives its mean)."""
        return self._samples * self.lib.number("floor_mean") if self.given["floor"] else 0.0

    def _momentum(self) -> float:
        """Return the upward momentum of all particles [N s]."""
        return float(self.lib.whole(self.lib.masses) @ (self.lib.whole(self.lib.vectors("v")) @ self._up))

    def _in_plane(self, y: float) -> bool:
        """Whether every particle is exactly in the plane and neither moves nor spins out of it."""
        x, v, spin = (self.lib.vectors(name) for name in ("x", "v", "omega"))
        return bool((x[:, 1] == y).all()) and not (v[:, 1].any() or spin[:, 0].any() or spin[:, 2].any())

    def _bins(self, overlaps: Array) -> Array:
        with np.errstate(divide="ignore"):  # an overlap of exactly 0 belongs to the first bin
            place = np.floor((np.log10(overlaps / float(self.given["d_min"])) + DECADES) * BINS_PER_DECADE) + 1.0
        last = DECADES * BINS_PER_DECADE
        return np.bincount(np.clip(place, 0, last).astype(np.intp), minlength=last + 1).astype(np.float64)


class _Tally:
    """Counts impact speeds by pair of species."""

    def __init__(self, pairs: Sequence[Sequence[int]], kinds: int) -> None:
        self._number = np.zeros((kinds, kinds), dtype=np.intp)
        for number, (i, j) in enumerate(pairs):
            self._number[i, j] = self._number[j, i] = number

    def __call__(self, shared: Shared, speeds: Speeds) -> None:
        """Add to the shared sums."""
        which = self._number[speeds.one, speeds.other]
        for pair in np.unique(which):
            own = speeds.v[which == pair]
            shared.impacts[pair] += count_speeds(own)
            shared.impact_sums[pair] += [(own**power).sum() for power in (1, 2, 3)]


def _add_by_height(to: Array, edges: Array, heights: Array, force: Array) -> None:
    """Add the reactions to ``force`` (n, 3) [N] on particles at ``heights`` (n,) [m] to (heights, 3) sums."""
    place = np.clip(np.searchsorted(edges, heights, side="right") - 1, 0, len(to) - 1)
    for axis in range(3):
        to[:, axis] -= np.bincount(place, force[:, axis], len(to))


def _plain(command: str) -> str:
    return " ".join(command.split())


def split(steps: int, parts: int) -> list[int]:
    """Return ``steps`` in at most ``parts`` whole, nearly equal parts."""
    marks = [steps * i // parts for i in range(parts + 1)]
    return [b - a for a, b in itertools.pairwise(marks) if b > a]


def serve(channel: socket.socket | None, child: Child, kept: int) -> None:
    """Answer until the parent closes the socket, or is gone; the first rank talks for all (others: None)."""
    lib = child.lib
    _send(channel, child.publish())
    while message := lib.told(b"" if channel is None else channel.recv(MAX_MESSAGE)):
        request = json.loads(message)
        answer: dict[str, Any] = getattr(child, request.pop("do"))(**request)
        if lib.ranks == 1 and os.fstat(1).st_size > kept + MAX_LOG:
            os.ftruncate(1, kept)  # opened for appending: the next line follows the deck's
        _send(channel, answer | child.publish())


def _send(channel: socket.socket | None, answer: dict[str, Any]) -> None:
    if channel is not None:
        channel.send(json.dumps(answer).encode())


def main(arguments: list[str]) -> None:
    """Take the socket and the mapping, and serve; of several ranks the first has them."""
    given = json.loads(arguments[0])
    sizes = Sizes(*given["sizes"])
    library = Library() if given["ranks"] == 1 else RankLibrary()
    channel, memory = None, mmap.mmap(-1, sizes.bytes)
    if library.ranks > 1 and library.rank == 0:
        name, path = os.environ[VARIABLE].split()
        # Before the parent, which waits for the connection, closes it.
        with Path(path).open("r+b") as file:
            memory = mmap.mmap(file.fileno(), sizes.bytes)
        channel = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        channel.connect(f"\0{name}")
    elif library.ranks == 1:
        number, descriptor = map(int, os.environ[VARIABLE].split())
        channel, memory = socket.socket(fileno=number), mmap.mmap(descriptor, sizes.bytes)
    serve(channel, Child(library, Shared.over(memory, sizes), given), os.fstat(1).st_size)
    library.close()


if __name__ == "__main__":
    main(sys.argv[1:])
