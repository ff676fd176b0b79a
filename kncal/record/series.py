"""What a bed run leaves behind: numbers per coupling, frames of particles and gas; written piece by piece.

On disk: a folder with ``facts.json`` and ``piece-00000.npz``, ``piece-00001.npz``, ... Every piece appears as a
whole or not at all, so a run that dies keeps all pieces before. A run that goes on from a checkpoint opens the same
folder again; rows that it computes anew replace the old ones when the folder is read.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kncal.core.arrays import npz_shapes, read_npz
from kncal.core.checks import Array
from kncal.core.errors import InputError, ReadError
from kncal.core.files import read_json, replacing, write_csv, write_json
from kncal.record.facts import HEIGHTS, BedFacts
from kncal.record.frame_stack import FrameStack, Pieces
from kncal.record.steps import DemStep, GasFields, GasStep, ParticleState

#: Folder of the pieces in a run's folder, and the table of the numbers per coupling beside it.
PIECES, SERIES = "series", "series.csv"
#: A piece is written when it holds this much [bytes], or when the last one is this old [s].
PIECE_BYTES = 16 * 1024**2
PIECE_SECONDS = 30.0
#: A larger piece is refused when read [bytes].
MAX_PIECE_BYTES = 1024**3

#: An array of all frames; of a run that was read it is a `FrameStack`, which is indexed likewise.
Frames = NDArray[np.float32]

#: Unit of each number of a coupling.
UNITS: Mapping[str, str] = {
    "coupling": "-", "t": "s", "U_0": "m/s", "p_in": "Pa", "floor": "N", "walls": "N", "drag_z": "N", "weight": "N",
    "momentum_z": "kg m/s", "kinetic_energy": "J", "kinetic_rotation": "J", "number": "-", "mass": "kg", "z_mean": "m",
    "z_95": "m", "overlap_max": "m", "overlap_mean": "m", "contacts": "-", "reaction_error": "-", "not_passed": "-",
    "solids_error": "-", "eps_g_min": "-", "courant_max": "-",
}  # fmt: skip
_PER_COUPLING = ("rows", "histogram", "watched", "impacts", "impact_sums", "out_number", "out_mass", "wall_force")
_OF_PARTICLES = ("x", "v", "spin", "kind")
_PER_FRAME = ("frame_coupling", "t_frame", *_OF_PARTICLES)
_PER_GAS_FRAME = ("eps_g", "p", "U")
_LARGE = (*_OF_PARTICLES, *_PER_GAS_FRAME)


@dataclass(frozen=True, kw_only=True)
class BedSeries:
    """All numbers of a run; NaN where a run without gas or with frozen particles has none.

    Arrays of (couplings,), at or over the interval that ends at ``t``:

    Attributes
    ----------
    facts : BedFacts
    coupling : number of the coupling, from 1, increasing by 1
    t : time [s]; U_0 : superficial inlet velocity [m/s]
    p_in : mean gauge pressure at the inlet patch [Pa]
    floor, walls : force of the particles on the floor, and on all other walls, positive downwards, mean over the
        interval [N]; NaN as in `kncal.record.steps.DemStep`
    drag_z : sum of the gas forces on the particles, buoyancy included, upwards [N]
    number, mass : of the particles that are there [-], [kg]; weight : theirs [N]
    momentum_z : of the particles, upwards [kg m/s]
    kinetic_energy, kinetic_rotation : of the particles' translation and rotation [J]
    z_mean, z_95 : mean and 95 % quantile of the heights of the particle centres [m]
    overlap_max, overlap_mean : of the particle contacts in the interval [m]; contacts : their number
    reaction_error, not_passed : see `kncal.record.steps.GasStep`, relative to the weight
    solids_error, eps_g_min, courant_max : see `GasStep`
    histogram : (couplings, bins) counts of overlaps, edges in ``facts.histogram_edges``
    watched : (couplings,) time in which new contacts were watched for [s]; 0 where impacts were not recorded
    impacts : (couplings, pairs, bins) counts of the impact speeds of new contacts by pair of species
        (``facts.pairs``), edges in ``facts.impact_edges`` (no bins where they were not recorded)
    impact_sums : (couplings, pairs, 3) sums over the same impacts of v, v², v³
    out_number, out_mass : (couplings, outlets) number and mass [kg] of the particles that have passed each outlet
    wall_force : (couplings, walls, heights, 3) force of the particles on each wall, by intervals of height
        (``facts.heights``), at the end of the coupling [N]
    frame_coupling : (frames,) coupling after which a frame was taken, 0 for the start
    t_frame : (frames,) [s]
    x, v, spin : (frames, particles, 3) [m], [m/s], [rad/s], single precision; NaN for those that are not there
    kind : (frames, particles) species of each, -1 for those that are not there
    eps_g, p, U : (frames, nz, ny, nx) void fraction, gauge pressure [Pa]; (frames, nz, ny, nx, 3) [m/s]; single
        precision; no frames (first axis 0) without gas
    """

    facts: BedFacts
    coupling: NDArray[np.int64]
    t: Array
    U_0: Array
    p_in: Array
    floor: Array
    walls: Array
    drag_z: Array
    weight: Array
    momentum_z: Array
    kinetic_energy: Array
    kinetic_rotation: Array
    number: Array
    mass: Array
    z_mean: Array
    z_95: Array
    overlap_max: Array
    overlap_mean: Array
    contacts: Array
    reaction_error: Array
    not_passed: Array
    solids_error: Array
    eps_g_min: Array
    courant_max: Array
    histogram: NDArray[np.int64]
    watched: Array
    impacts: NDArray[np.int32]
    impact_sums: Array
    out_number: NDArray[np.int64]
    out_mass: Array
    wall_force: Array
    frame_coupling: NDArray[np.int64]
    t_frame: Array
    x: Frames
    v: Frames
    spin: Frames
    kind: NDArray[np.int16]
    eps_g: Frames
    p: Frames
    U: Frames


class SeriesWriter:
    """Writes a run into a folder, piece by piece; use as a context manager or call `close`.

    The folder is made if missing; pieces that are there stay, see the module's text. InputError if they are of a run
    with other facts.
    """

    def __init__(self, folder: Path, facts: BedFacts) -> None:
        self.folder = folder
        self.facts = facts
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / "facts.json").exists():
            there = _read_facts(folder)
            if there != facts:
                differing = ", ".join(f.name for f in fields(facts) if getattr(there, f.name) != getattr(facts, f.name))
                raise InputError(
                    f"{folder} holds the series of another run ({differing} differ); expected the same run, or an "
                    "empty folder"
                )
        else:
            write_json(folder / "facts.json", asdict(facts))
        self._number = 1 + max((_piece_number(path) for path in folder.glob("piece-*.npz")), default=-1)
        self._shapes = _shapes(facts)
        self._kept: dict[str, list[Any]] = {name: [] for name in self._shapes}
        self._bytes = 0
        self._written_at = time.monotonic()

    def __enter__(self) -> SeriesWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(self, coupling: int, U_0: float, gas: GasStep | None, dem: DemStep | None, state: ParticleState) -> None:
        """Take the numbers of one coupling.

        Parameters
        ----------
        coupling : int
            Its number, from 1.
        U_0 : float
            Superficial inlet velocity in it [m/s].
        gas, dem : GasStep, DemStep or None
            What gas and particles said. None without gas: its numbers become 0 (pressure, drag) or NaN (others);
            None with frozen particles: NaN.
        state : ParticleState
            At the end of the interval.
        """
        # Only here: a piece holds the frames of its couplings, so that a later piece replaces whole couplings.
        if self._bytes > PIECE_BYTES or time.monotonic() - self._written_at > PIECE_SECONDS:
            self.flush()
        nan = float("nan")
        row = dict.fromkeys(UNITS, nan) | {
            "coupling": float(coupling),
            "t": coupling * self.facts.coupling,
            "U_0": U_0,
            "p_in": 0.0,
            "drag_z": 0.0,
        }
        row |= _of_particles(self.facts, state)
        if gas is not None:
            weight = row["weight"]
            row |= {name: getattr(gas, name) for name in ("p_in", "solids_error", "eps_g_min", "courant_max")}
            row["drag_z"] = float(gas.force[:, 2].sum())
            row["reaction_error"] = gas.reaction_error / weight if weight else nan
            row["not_passed"] = gas.not_passed / weight if weight else nan
        kept: dict[str, Any] = {}
        if dem is not None:
            row |= {name: getattr(dem, name) for name in ("overlap_max", "overlap_mean", "contacts")}
            row |= {"floor": dem.floor_force, "walls": dem.other_walls_force}
            kept |= {name: getattr(dem, name) for name in _PER_COUPLING[1:]}
        kept["rows"] = [row[name] for name in UNITS]
        self._keep(_PER_COUPLING, kept)

    def _keep(self, names: Iterable[str], values: Mapping[str, Any]) -> None:
        """Take a copy of one value of each of these arrays; zeros where there is none."""
        for name in names:
            kind, shape = self._shapes[name]
            value = np.array(values[name], dtype=kind) if name in values else np.zeros(shape, dtype=kind)
            self._kept[name].append(value)
            self._bytes += value.nbytes

    def frame(self, coupling: int, state: ParticleState, fields: GasFields | None) -> None:
        """Record a frame after coupling ``coupling`` (0: the start), before the next `add`; copies what it is given.

        ``fields`` None without gas.
        """
        numbers = {"frame_coupling": coupling, "t_frame": coupling * self.facts.coupling}
        self._keep(_PER_FRAME, numbers | {name: getattr(state, name) for name in _OF_PARTICLES})
        if fields is not None:
            self._keep(_PER_GAS_FRAME, {name: getattr(fields, name) for name in _PER_GAS_FRAME})

    def flush(self) -> None:
        """Bring everything so far to the disk. Call it before saving a checkpoint."""
        self._written_at = time.monotonic()
        if not self._kept["rows"] and not self._kept["frame_coupling"]:
            return
        arrays = {
            name: np.array(values, dtype=self._shapes[name][0]).reshape(len(values), *self._shapes[name][1])
            for name, values in self._kept.items()
        }
        path = self.folder / f"piece-{self._number:05d}.npz"
        with replacing(path) as file:
            np.savez(file, allow_pickle=False, **arrays)
        self._number += 1
        self._kept, self._bytes = {name: [] for name in self._shapes}, 0

    def close(self) -> None:
        """Write what is left; may be called twice."""
        self.flush()


def read_series(folder: Path) -> BedSeries:
    """Read the series that `SeriesWriter` wrote into ``folder``, of a finished, a running or a dead run.

    Frames stay on the disk until they are asked for.

    Raises
    ------
    ReadError
        If there is no piece, if a piece is damaged or does not fit the facts, or if couplings are missing.
    """
    facts = _read_facts(folder)
    paths = sorted(folder.glob("piece-*.npz"), key=_piece_number)
    if not paths:
        raise ReadError(f"{folder}: no piece-*.npz; expected the series of a run (did it end before its first piece?)")
    kept: list[_Part] = []
    for path in paths:
        part = _read_part(path, facts)
        numbers = np.concatenate([part.arrays["rows"][:, 0], part.arrays["frame_coupling"]])
        kept = [earlier.before(int(numbers.min())) for earlier in kept]  # computed anew after a checkpoint
        kept.append(part)
    whole = {name: np.concatenate([part.arrays[name] for part in kept]) for name in kept[0].arrays}
    rows = whole.pop("rows")
    coupling = rows[:, 0].astype(np.int64)
    if len(coupling) and not np.array_equal(coupling, np.arange(1, len(coupling) + 1)):
        at = int(np.flatnonzero(coupling != np.arange(1, len(coupling) + 1))[0]) + 1
        raise ReadError(f"{folder}: coupling {at} is missing; expected every coupling from 1 on (was a piece deleted?)")
    table: dict[str, Any] = {name: rows[:, i].astype(np.float64) for i, name in enumerate(UNITS)}
    return BedSeries(facts=facts, **(table | {"coupling": coupling}), **whole, **_stacks(facts, kept))


def _stacks(facts: BedFacts, parts: list[_Part]) -> dict[str, Any]:
    """Return the large arrays, of which each frame is read when it is asked for."""
    pieces, shapes = Pieces(lambda path: read_npz(path, MAX_PIECE_BYTES)), _shapes(facts)
    places = [(part.path, row) for part in parts for row in part.frames]
    of_gas = [(part.path, row) for part in parts if part.has_gas for row in part.frames]
    return {name: FrameStack(pieces, name, places, *shapes[name]) for name in _OF_PARTICLES} | {
        name: FrameStack(pieces, name, of_gas, *shapes[name]) for name in _PER_GAS_FRAME
    }


def series_reaches(folder: Path, coupling: int) -> bool:
    """Return whether there is a series with every coupling from 1 to ``coupling``."""
    there: set[int] = set()
    try:
        facts = _read_facts(folder)
        for path in folder.glob("piece-*.npz"):
            there.update(_read_part(path, facts).arrays["rows"][:, 0].astype(np.int64).tolist())
    except ReadError:
        return False
    return len(there.intersection(range(1, coupling + 1))) == coupling


def write_series_csv(path: Path, series: BedSeries) -> None:
    """Write the numbers per coupling as CSV with units in its first line; see `kncal.core.files.write_csv`."""
    import pandas as pd

    write_csv(path, pd.DataFrame({name: getattr(series, name) for name in UNITS}), UNITS)


def _quantile(values: Array, share: float) -> float:
    """Return the smallest value that at least ``share`` of all do not exceed: quicker than np.quantile."""
    at = max(0, int(np.ceil(share * len(values))) - 1)
    return float(np.partition(values, at)[at])


def _piece_number(path: Path) -> int:
    try:
        return int(path.stem.removeprefix("piece-"))
    except ValueError as error:
        raise ReadError(f"{path}: not a name that kncal gives; expected piece-00000.npz and so on") from error


def _read_facts(folder: Path) -> BedFacts:
    path = folder / "facts.json"
    data = read_json(path)
    if not isinstance(data, dict):
        raise ReadError(f"{path}: expected the facts of a series")
    try:
        return BedFacts(**data)
    except InputError as error:
        raise ReadError(f"{path}: {error}") from error


def _shapes(facts: BedFacts) -> dict[str, tuple[type[np.generic], tuple[int, ...]]]:
    """Return kind and shape of one value of every array in a piece."""
    nx, ny, nz = facts.cells
    return {
        "rows": (np.float64, (len(UNITS),)),
        "histogram": (np.int64, (len(facts.histogram_edges) - 1,)),
        "watched": (np.float64, ()),
        "impacts": (np.int32, (len(facts.pairs), facts.impact_bins)),
        "impact_sums": (np.float64, (len(facts.pairs), 3)),
        "out_number": (np.int64, (len(facts.outlets),)),
        "out_mass": (np.float64, (len(facts.outlets),)),
        "wall_force": (np.float64, (len(facts.walls), HEIGHTS, 3)),
        "frame_coupling": (np.int64, ()),
        "t_frame": (np.float64, ()),
        "x": (np.float32, (facts.count, 3)),
        "v": (np.float32, (facts.count, 3)),
        "spin": (np.float32, (facts.count, 3)),
        "kind": (np.int16, (facts.count,)),
        "eps_g": (np.float32, (nz, ny, nx)),
        "p": (np.float32, (nz, ny, nx)),
        "U": (np.float32, (nz, ny, nx, 3)),
    }


@dataclass(frozen=True)
class _Part:
    """What is in memory of one piece: its small arrays; ``frames``: rows of the frames in its large ones."""

    path: Path
    arrays: dict[str, NDArray[Any]]
    frames: list[int]
    has_gas: bool

    def before(self, coupling: int) -> _Part:
        """Return the part without what is of ``coupling`` and later."""
        rows, frames = self.arrays["rows"][:, 0] < coupling, self.arrays["frame_coupling"] < coupling
        arrays = {name: a[frames if name in _PER_FRAME else rows] for name, a in self.arrays.items()}
        return replace(self, arrays=arrays, frames=[row for row, keep in zip(self.frames, frames, strict=True) if keep])


def _read_part(path: Path, facts: BedFacts) -> _Part:
    """Read one piece; every array is there, without rows if the piece has none, and has the shape it must have."""
    there, shapes = npz_shapes(path, MAX_PIECE_BYTES), _shapes(facts)
    for name, (kind, shape) in shapes.items():
        if name not in there:
            raise ReadError(f"{path}: no {name}; expected {', '.join(shapes)}")
        found = there[name]
        if found.dtype != kind or len(found.shape) != 1 + len(shape) or found.shape[1:] != shape:
            raise ReadError(f"{path}: {name} is {found.dtype} {found.shape}; expected {kind.__name__} (any, {shape})")
    for names in (_PER_COUPLING, _PER_FRAME, _PER_GAS_FRAME):
        lengths = {name: there[name].shape[0] for name in names}
        if len(set(lengths.values())) > 1:
            raise ReadError(f"{path}: arrays of unequal length: {lengths}; expected as many of each")
    frames, of_gas = there["x"].shape[0], there["p"].shape[0]
    if not there["rows"].shape[0] and not frames:
        raise ReadError(f"{path}: empty; expected rows or frames")
    if of_gas not in (0, frames):
        raise ReadError(f"{path}: {of_gas} frames of the gas; expected none, or {frames} as of the particles")
    small = [name for name in shapes if name not in _LARGE]
    arrays = read_npz(path, MAX_PIECE_BYTES, small)
    return _Part(path, {name: arrays[name] for name in small}, list(range(frames)), of_gas > 0)


def _of_particles(facts: BedFacts, state: ParticleState) -> dict[str, float]:
    """Return what positions and velocities of the particles that are there add up to."""
    there = state.kind >= 0
    x, v, spin, kind = (
        (state.x, state.v, state.spin, state.kind)
        if there.all()
        else (part[there] for part in (state.x, state.v, state.spin, state.kind))
    )
    up, mass = np.array(facts.up), np.array(facts.masses)[kind]
    inertia = 0.4 * mass * np.array(facts.radii)[kind] ** 2
    heights = x @ up
    return {
        "number": float(len(x)),
        "mass": float(mass.sum()),
        "weight": float(mass.sum()) * facts.gravity,
        "momentum_z": float(mass @ (v @ up)),
        "kinetic_energy": 0.5 * float(mass @ np.einsum("ij,ij->i", v, v)),
        "kinetic_rotation": 0.5 * float(inertia @ np.einsum("ij,ij->i", spin, spin)),
        "z_mean": float(heights.mean()) if len(x) else float("nan"),
        "z_95": _quantile(heights, 0.95) if len(x) else float("nan"),
    }
