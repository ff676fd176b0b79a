"""LIGGGHTS text dumps (`dump custom`, `dump local`): read by their headers; written for the built-in engine.

A dump is a chain of frames: nine header lines (step, number of rows, box, names of columns), then the rows.
Frames need not be evenly spaced. The format is described in the LIGGGHTS manual, command `dump`.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from kncal.core.checks import one_of, positive
from kncal.core.errors import InputError, ReadError
from kncal.core.files import open_limited, read_limited
from kncal.record.frames import Trajectory

if TYPE_CHECKING:
    import pandas as pd

#: Columns of a dump that `read_trajectory` needs and `write_trajectory` writes.
TRAJECTORY_COLUMNS = (
    "id", "type", "x", "y", "z", "vx", "vy", "vz", "omegax", "omegay", "omegaz", "fx", "fy", "fz",
)  # fmt: skip
#: A larger dump is refused, it is read into memory as a whole; also one whose table would be larger than that.
MAX_BYTES = 2 * 1024**3
MAX_COLUMNS, MAX_FRAMES = 200, 5_000_000

_KINDS = {"atoms": "ATOMS", "local": "ENTRIES"}
_INTEGERS = ("id", "type")
_HEADER_LINES, _FIRST = 9, b"ITEM: TIMESTEP\n"
#: Bytes read at once; a line of a dump is shorter than the second. What comes behind the last blank of a row.
_BLOCK, _LONGEST_LINE, _TAIL = 1 << 19, 1 << 16, " "
_HEADER = re.compile(
    rb"ITEM: TIMESTEP\n(\d{1,18}) *\nITEM: NUMBER OF (ATOMS|ENTRIES)\n(\d{1,18}) *\n"
    rb"ITEM: BOX BOUNDS[^\n]*\n(?:[^\nI]*\n){3}ITEM: (ATOMS|ENTRIES)([^\n]*)\n"
)
_NUMBER = re.compile(rb"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|nan|inf|infinity)", re.IGNORECASE)


def read_dump(path: Path, *, kind: str = "atoms") -> pd.DataFrame:
    """Read every frame of a text dump.

    Parameters
    ----------
    path : Path
        A whole dump file, all frames in one file, at most `MAX_BYTES`.
    kind : {"atoms", "local"}
        ``dump custom`` (``ITEM: ATOMS``) or ``dump local`` (``ITEM: ENTRIES``).

    Returns
    -------
    pandas.DataFrame
        One row per particle (or entry) and frame, in the order of the file: the integer column ``step``,
        then the columns that the header names. ``id`` and ``type`` are int64, all others float64 in the units
        of the deck; NaN and infinite values are kept. Frames without rows leave no trace.

    Raises
    ------
    ReadError
        If the file is missing, empty, truncated, malformed or too large, or if its frames name different
        columns; the text names the file and the line.
    InputError
        If ``kind`` is unknown.
    """
    item = _KINDS[one_of("kind", kind, _KINDS)]
    with open_limited(path, MAX_BYTES, "a LIGGGHTS dump", "dump less often") as file:
        names = _names(path, file, item)
        # LIGGGHTS ends each row with a blank, which makes one more column: empty, or the row is too long. Several
        # blanks between the numbers, or a fault: the second pass or `_refuse` decides.
        for separator, columns in ((" ", [*names, _TAIL]), (r"\s+", names)):
            file.seek(0)
            rows = _Rows(path, file, item, len(names))
            table = _parse(rows, separator, columns)
            if rows.fault:
                raise rows.fault
            if table is not None:
                table.insert(0, "step", np.repeat(np.array(rows.steps, dtype=np.int64), rows.counts))
                return table
    _refuse(path, _read_bytes(path), item)


def read_trajectory(path: Path, names: Sequence[str], radius: Sequence[float], dt: float) -> Trajectory:
    """Read a dump with the columns `TRAJECTORY_COLUMNS` (in any order, others are ignored) as a trajectory.

    Parameters
    ----------
    path : Path
    names : sequence of str
        Particle names; the particle with ``id`` i is ``names[i - 1]``.
    radius : sequence of float
        Their radii [m].
    dt : float
        Time step [s]; the time of a frame is step·dt.

    Raises
    ------
    ReadError
        As `read_dump`; also if a column is missing, if the steps do not increase, or if a frame does not hold
        every particle exactly once.
    InputError
        If ``dt`` is not positive, or ``names`` and ``radius`` differ in length.
    """
    positive("dt", dt, unit="s")
    if len(names) != len(radius):
        raise InputError(f"radius has {len(radius)} values: expected one for each of {len(names)} names")
    table = read_dump(path)
    missing = [name for name in TRAJECTORY_COLUMNS if name not in table.columns]
    if missing:
        raise ReadError(
            f"{path}: no column {', '.join(missing)}; expected `dump custom` with {' '.join(TRAJECTORY_COLUMNS)}"
        )
    step, order = _whole_frames(path, table["step"].to_numpy(), table["id"].to_numpy(), len(names))

    def vectors(*columns: str) -> np.ndarray:
        values = np.stack([table[column].to_numpy() for column in columns], axis=-1)
        return np.ascontiguousarray(values[order].reshape(step.size, len(names), 3))

    return Trajectory(
        names=tuple(names),
        step=step,
        t=step * float(dt),
        x=vectors("x", "y", "z"),
        v=vectors("vx", "vy", "vz"),
        spin=vectors("omegax", "omegay", "omegaz"),
        force=vectors("fx", "fy", "fz"),
        radius=np.asarray(radius, dtype=np.float64),
    )


def write_trajectory(path: Path, trajectory: Trajectory, types: Sequence[int]) -> None:
    """Write a trajectory as a LIGGGHTS dump with 17 significant digits, so that it reads back exactly.

    Parameters
    ----------
    path : Path
    trajectory : Trajectory
        Its times are not written: a reader needs the time step.
    types : sequence of int
        Atom type of each particle, from 1.

    Raises
    ------
    InputError
        If the number of types is not the number of particles.
    """
    count = len(trajectory.names)
    if len(types) != count:
        raise InputError(f"types has {len(types)} values: expected one for each of {count} particles")
    reach = trajectory.radius[:, None]
    low = np.min(trajectory.x - reach, axis=(0, 1), initial=np.inf)
    high = np.max(trajectory.x + reach, axis=(0, 1), initial=-np.inf)
    box = "".join(f"{a:.17g} {b:.17g}\n" for a, b in zip(low.tolist(), high.tolist(), strict=True))
    row = " ".join(["%.17g"] * 12)
    rows = "".join(f"{i} {int(kind)} {row} \n" for i, kind in enumerate(types, start=1))
    frame = (
        f"ITEM: TIMESTEP\n%d\nITEM: NUMBER OF ATOMS\n{count}\nITEM: BOX BOUNDS ff ff ff\n{box}"
        f"ITEM: ATOMS {' '.join(TRAJECTORY_COLUMNS)} \n{rows}"
    )
    values = np.concatenate([trajectory.x, trajectory.v, trajectory.spin, trajectory.force], axis=-1)
    with path.open("w", encoding="ascii", newline="\n") as file:
        for step, numbers in zip(trajectory.step.tolist(), values, strict=True):
            file.write(frame % (step, *numbers.ravel().tolist()))


def _read_bytes(path: Path) -> bytes:
    data = read_limited(path, MAX_BYTES, "a LIGGGHTS dump", "dump less often")
    if not data:
        raise ReadError(
            f"{path}, line 1: the file is empty, expected 'ITEM: TIMESTEP'; did the solver stop early, "
            "or is the disk full?"
        )
    return data


def _names(path: Path, file: BufferedReader, item: str) -> list[str]:
    """Return the columns that the first frame names."""
    columns = [file.readline(_LONGEST_LINE) for _ in range(_HEADER_LINES)][-1]
    prefix = f"ITEM: {item}".encode()
    if not columns.startswith(prefix) or not columns.endswith(b"\n"):
        _refuse(path, _read_bytes(path), item)
    names = columns[len(prefix) :].decode("ascii", errors="replace").split()
    if not names or len(set(names)) != len(names) or {"step", ""} & set(names):
        raise ReadError(
            f"{path}, line {_HEADER_LINES}: columns {_shown(columns[len(prefix) :])}; expected distinct names without "
            "'step'"
        )
    if len(names) > MAX_COLUMNS:
        raise ReadError(f"{path}: {len(names)} columns; expected at most {MAX_COLUMNS}")
    return names


class _Rows(io.RawIOBase):
    """The rows of all frames as one stream: headers are checked and taken out as it goes.

    ``steps`` and ``counts`` (rows) are those of the frames so far. What is not as expected ends the stream with an
    error, which `pandas` makes its own; ``fault`` if it is one that nobody else would find.
    """

    def __init__(self, path: Path, file: BufferedReader, item: str, columns: int) -> None:
        self._path, self._file, self._kind, self._columns = path, file, item.encode(), columns
        self.steps: list[int] = []
        self.counts: list[int] = []
        self.fault: ReadError | None = None
        # one buffer for all blocks: making memory anew for each takes as long as all else that is done here
        self._buffer = bytearray(_BLOCK + _HEADER_LINES * _LONGEST_LINE)
        self._text = np.frombuffer(self._buffer, dtype=np.uint8)
        self._is_end = np.empty(self._text.size, dtype=np.bool_)
        self._begin = self._filled = 0  # of what is no whole line or header yet
        self._named = self._known = (
            b""  # the latter: all of the last header behind its step: in most dumps that of every frame
        )
        self._left = self._count = self._total = 0
        self._begun = False

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        view, parts = memoryview(self._buffer), list[memoryview]()
        while not parts:
            rest = self._filled - self._begin
            view[:rest] = view[self._begin : self._filled]
            number = self._file.readinto(view[rest : rest + _BLOCK])
            if not number:
                if rest or self._left:
                    raise ValueError("cut off, or a line without end")
                return b""
            self._filled = rest + number
            self._begin = self._take(view[: self._filled], parts)
        if not self._begun and len(bytes(parts[0]).partition(b"\n")[0].split()) != self._columns:
            # pandas takes its number of columns from the first row, so it would not notice one that is too long.
            raise ValueError("columns")
        self._begun = True
        return b"".join(parts)

    def _take(self, view: memoryview, parts: list[memoryview]) -> int:
        """Add the rows in ``view`` to ``parts``; return where what is no whole line or header begins."""
        ends = np.flatnonzero(np.equal(self._text[: len(view)], 10, out=self._is_end[: len(view)]))
        at = line = 0
        while line < ends.size:
            if self._left:
                lines = min(self._left, ends.size - line)
                self._left -= lines
                stop = int(ends[line + lines - 1]) + 1
                parts.append(view[at:stop])
            elif line + _HEADER_LINES > ends.size:
                break
            elif alike := self._like_the_last(view, ends[line:], at, parts):
                lines = alike * (_HEADER_LINES + self._count)
                stop = int(ends[line + lines - 1]) + 1
            else:
                lines, stop = _HEADER_LINES, int(ends[line + _HEADER_LINES - 1]) + 1
                self._header(at, stop)
            at, line = stop, line + lines
        return at

    def _header(self, start: int, stop: int) -> None:
        """Take the header that lies there in the buffer."""
        head = _HEADER.match(self._buffer, start, stop)
        if head is None or head.end() != stop:
            raise ValueError("no header")
        step, counted, rows, listed, named = head.groups()
        self._named = self._named or named
        if counted != self._kind or listed != self._kind or named != self._named:
            raise ValueError("another header")
        self._count = self._left = int(rows)
        self._known = bytes(self._buffer[head.end(1) : stop])
        self._add([int(step)])

    def _like_the_last(self, view: memoryview, ends: np.ndarray, start: int, parts: list[memoryview]) -> int:
        """Take the whole frames from ``start`` whose headers are the last one but for the step; return how many.

        Near contacts a dump has many frames of few rows: this takes all in a block at once. ``ends`` of lines.
        """
        lines = _HEADER_LINES + self._count
        ends = ends[: ends.size // lines * lines].reshape(-1, lines)
        if len(ends) < 2 or not self._count:
            return 0
        text = self._text[: len(view)]
        starts = np.concatenate(([start], ends[:-1, -1] + 1))
        alike = ends[:, _HEADER_LINES - 1] - ends[:, 1] + 1 == len(self._known)
        for place, words in ((starts, _FIRST), (ends[:, 1], self._known)):
            if text.size < len(words):
                return 0
            windows = np.lib.stride_tricks.sliding_window_view(text, len(words))
            there = windows[np.minimum(place, len(windows) - 1)]
            alike &= (there == np.frombuffer(words, dtype=np.uint8)).all(axis=1)
        number = int(np.argmin(alike)) if not alike.all() else len(ends)
        steps = [
            bytes(view[a:b]) for a, b in zip((ends[:number, 0] + 1).tolist(), ends[:number, 1].tolist(), strict=True)
        ]
        if not all(step.isdigit() and len(step) <= 18 for step in steps):
            return 0
        begins = ends[:number, _HEADER_LINES - 1] + 1
        parts += [view[a:b] for a, b in zip(begins.tolist(), (ends[:number, -1] + 1).tolist(), strict=True)]
        self._add(list(map(int, steps)))
        return number

    def _add(self, steps: list[int]) -> None:
        self.steps += steps
        self.counts += [self._count] * len(steps)
        self._total += self._count * len(steps)
        if len(self.steps) > MAX_FRAMES or 8 * self._columns * self._total > MAX_BYTES:
            self.fault = ReadError(
                f"{self._path}: more than {MAX_FRAMES} frames or {MAX_BYTES // 8} numbers; dump less often"
            )
            raise self.fault


def _parse(rows: _Rows, separator: str, names: list[str]) -> pd.DataFrame | None:
    """Parse all rows at once (one call per frame would be slow for many small frames); None if they are no table."""
    import pandas as pd

    types = {name: np.int64 if name in _INTEGERS else np.float64 for name in names}
    # Up to pandas 3.0 the default reading of decimals may be wrong in the last digit; later it is exact.
    release = tuple(int(part) for part in pd.__version__.split(".")[:2])
    exact = {"float_precision": "round_trip"} if release < (3, 1) else {}
    try:
        table: pd.DataFrame = pd.read_csv(  # type: ignore[call-overload]
            rows,
            sep=separator,
            header=None,
            names=names,
            index_col=False,
            dtype=types,
            keep_default_na=False,
            na_values={name: [""] if name == _TAIL else ["nan", "-nan"] for name in names},
            quoting=3,
            **exact,
        )
    except pd.errors.EmptyDataError:
        table = pd.DataFrame({name: np.empty(0, dtype=kind) for name, kind in types.items()})
    except ValueError:
        return None
    if len(table) != sum(rows.counts) or (_TAIL in names and not table.pop(_TAIL).isna().all()):
        return None
    return table


def _refuse(path: Path, data: bytes, item: str) -> NoReturn:
    """Go through a bad dump line by line and raise a `ReadError` that names the first bad line."""
    source = io.BytesIO(data)
    number = 0

    def fail(text: str) -> NoReturn:
        raise ReadError(f"{path}, line {number}: {text}")

    def next_line(expected: str) -> bytes:
        nonlocal number
        number += 1
        line = source.readline()
        if not line.endswith(b"\n"):
            fail(f"the file ends inside a frame, expected {expected}; the run was cut off, or the disk is full")
        return line.strip()

    def expect(pattern: bytes, expected: str) -> bytes:
        line = next_line(expected)
        if not re.fullmatch(pattern, line):
            fail(f"{_shown(line)}, expected {expected}")
        return line

    first: list[bytes] | None = None
    while source.tell() < len(data):
        expect(rb"ITEM: TIMESTEP", "'ITEM: TIMESTEP' (or the number of rows above is wrong)")
        step = int(expect(rb"\d{1,18}", "a step number"))
        expect(f"ITEM: NUMBER OF {item}".encode(), f"'ITEM: NUMBER OF {item}'")
        rows = int(expect(rb"\d{1,18}", "a number of rows"))
        expect(rb"ITEM: BOX BOUNDS.*", "'ITEM: BOX BOUNDS ...'")
        for _ in range(3):
            expect(rb"[^I].*", "two bounds of the box")
        names = expect(f"ITEM: {item}( .*)?".encode(), f"'ITEM: {item}' with names of columns").split()[2:]
        if first is not None and names != first:
            fail(f"columns {_shown(b' '.join(names))}, expected those of frame 1: {_shown(b' '.join(first))}")
        first = names
        for row in range(rows):
            fields = next_line(f"row {row + 1} of {rows} of step {step}").split()
            if len(fields) != len(names):
                fail(f"{len(fields)} values, expected {len(names)} (row {row + 1} of {rows} of step {step})")
            for name, field in zip(names, fields, strict=True):
                whole = name.decode("ascii", errors="replace") in _INTEGERS
                if not (re.fullmatch(rb"[+-]?\d{1,18}", field) if whole else _NUMBER.fullmatch(field)):
                    fail(f"{_shown(name)} = {_shown(field)}, expected {'an integer' if whole else 'a number'}")
    raise ReadError(f"{path}: not a LIGGGHTS text dump; expected lines of plain ASCII text")


def _shown(text: bytes) -> str:
    return repr(text[:60].decode("utf-8", errors="replace"))


def _whole_frames(path: Path, steps: np.ndarray, ids: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the step of each frame and the order of the rows by frame and id; refuse incomplete frames."""
    starts = np.flatnonzero(np.diff(steps, prepend=-1))
    step = steps[starts]
    sizes = np.diff(starts, append=steps.size)
    # Frames are whole, in order and of nine header lines each, so the header's line follows from the sizes.
    lines = 1 + _HEADER_LINES * np.arange(step.size) + np.concatenate(([0], np.cumsum(sizes)[:-1]))[: step.size]
    if not step.size:
        raise ReadError(f"{path}: no frame holds a particle, expected {count}")
    back = np.flatnonzero(np.diff(step) <= 0)
    if back.size:
        k = int(back[0]) + 1
        raise ReadError(f"{path}, line {lines[k]}: step {step[k]} after {step[k - 1]}, expected steps that increase")
    wrong = np.flatnonzero(sizes != count)
    if wrong.size:
        k = int(wrong[0])
        raise ReadError(f"{path}, line {lines[k]}: step {step[k]} holds {sizes[k]} particles, expected {count}")
    order = np.lexsort((ids, steps))
    bad = np.flatnonzero((ids[order].reshape(-1, count) != np.arange(1, count + 1)).any(axis=1))
    if bad.size:
        k = int(bad[0])
        found = sorted(ids[starts[k] : starts[k] + count].tolist())
        raise ReadError(f"{path}, line {lines[k]}: step {step[k]} holds ids {found[:10]}, expected 1 to {count}")
    return step, order
