"""LIGGGHTS logs (`log.liggghts`, or the screen output): thermo tables, errors, and whether the deck ended."""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from kncal.core.errors import ReadError
from kncal.core.files import MAX_LINE, decode_line, open_limited

if TYPE_CHECKING:
    import pandas as pd

#: kncal's decks print this as their last action: LIGGGHTS' exit code is 0 for many runs that stopped early.
END_MARKER = "KNCAL_DONE"
#: A larger log is refused, and one with more columns, changes of columns, or numbers in all its tables together.
MAX_BYTES = 128 * 1024**2
MAX_COLUMNS, MAX_BLOCKS, MAX_NUMBERS = 200, 1000, 30_000_000

_KEPT = 20
_VERSION = re.compile(r"LIGGGHTS \(Version (?:LIGGGHTS-PUBLIC )?([^,)]+)")
_LOOP = re.compile(r"Loop time of (\S+) on \d+ procs for \d+ steps")


@dataclass(frozen=True, kw_only=True)
class LiggghtsLog:
    """What a log says.

    Attributes
    ----------
    thermo : every thermo line of every run block, one row each, columns as in the log ("Step", "Atoms", ...),
        float64; a column that a block does not have is NaN there
    last_step : step of the last thermo line, None if there is none
    atoms : number of particles in the last thermo line, None if there is none
    errors : the lines that begin with "ERROR" (the first 20)
    warnings : the lines that begin with "WARNING" (the first 20)
    finished : whether `END_MARKER` stands alone on a line
    version : from the banner, e.g. "3.8.0"; None where the log has none (log.liggghts does not)
    loop_cpu : time spent in the runs' loops, added up [s]; None before the end of the first
    """

    thermo: pd.DataFrame
    last_step: int | None
    atoms: int | None
    errors: tuple[str, ...]
    warnings: tuple[str, ...]
    finished: bool
    version: str | None
    loop_cpu: float | None


def read_log(path: Path) -> LiggghtsLog:
    """Read a log, also one that was cut off or holds random bytes.

    Raises
    ------
    ReadError
        If the file is missing, or larger than `MAX_BYTES`, or its tables are larger than any of kncal's decks makes.
    """
    blocks: list[tuple[tuple[str, ...], array[float]]] = []
    errors: list[str] = []
    warnings: list[str] = []
    finished = in_block = False
    version: str | None = None
    loop: float | None = None
    try:
        with open_limited(path, MAX_BYTES, "a LIGGGHTS log", "write thermo lines less often") as file:
            for line, ended in _lines(file):
                tokens = line.split()
                if not tokens:
                    continue
                if tokens[0] == "Step":
                    if not blocks or blocks[-1][0] != tuple(tokens):
                        blocks.append((tuple(tokens), array("d")))
                        _check_size(path, blocks)
                    in_block = True
                elif ended and in_block and (row := _numbers(tokens)) and len(row) == len(blocks[-1][0]):
                    blocks[-1][1].extend(row)
                elif tokens[0].startswith("ERROR"):
                    errors += [line] if len(errors) < _KEPT else []
                elif tokens[0].startswith("WARNING"):
                    warnings += [line] if len(warnings) < _KEPT else []
                elif line == END_MARKER:
                    finished = True
                elif match := _LOOP.match(line):
                    in_block = False
                    seconds = _numbers([match[1]])
                    loop = (loop or 0.0) + (seconds[0] if seconds else 0.0)
                elif version is None and (match := _VERSION.match(line)):
                    version = match[1].strip()
    except OSError as error:
        raise ReadError(f"{path}: cannot be read ({error.strerror}); expected a LIGGGHTS log") from error
    _check_size(path, blocks)
    thermo = _thermo(blocks)
    return LiggghtsLog(
        thermo=thermo,
        last_step=_last(thermo, "Step"),
        atoms=_last(thermo, "Atoms"),
        errors=tuple(errors),
        warnings=tuple(warnings),
        finished=finished,
        version=version,
        loop_cpu=loop,
    )


def step_of_line(line: str) -> int | None:
    """Return the step if ``line`` looks like a thermo line (a whole number, then numbers only), else None.

    For live progress; only `read_log`, which knows the headers, decides what is a thermo line.
    """
    tokens = line.split()
    if len(tokens) < 2 or not tokens[0].isdecimal() or not tokens[0].isascii() or not _numbers(tokens):
        return None
    return int(tokens[0][:18])


def _lines(file: BinaryIO) -> Iterator[tuple[str, bool]]:
    """Lines without blanks around them; of one longer than `MAX_LINE` bytes, the beginning.

    With each, whether it ended there: the last number of a line that did not may be half of a number.
    """
    whole = True
    while piece := file.readline(MAX_LINE):
        if whole:
            yield decode_line(piece).strip(), piece.endswith(b"\n")
        whole = piece.endswith(b"\n")


def _numbers(tokens: list[str]) -> list[float]:
    """Return the numbers, or nothing if a token is not one ("nan" and "inf" are)."""
    try:
        return [float(token) for token in tokens]
    except ValueError:
        return []


def _check_size(path: Path, blocks: list[tuple[tuple[str, ...], array[float]]]) -> None:
    """Refuse tables that would take far more memory than the log: put together, every row has every column."""
    columns = max(len({name for names, _ in blocks for name in names}), *(len(names) for names, _ in blocks), 0)
    rows = sum(len(values) // len(names) for names, values in blocks)
    if columns > MAX_COLUMNS or len(blocks) > MAX_BLOCKS or rows * columns > MAX_NUMBERS:
        raise ReadError(
            f"{path}: {rows} thermo lines, {columns} columns that change {len(blocks)} times: expected at most "
            f"{MAX_NUMBERS} numbers in all, {MAX_COLUMNS} columns, {MAX_BLOCKS} changes; write thermo lines less often"
        )


def _thermo(blocks: list[tuple[tuple[str, ...], array[float]]]) -> pd.DataFrame:
    import pandas as pd

    tables = []
    for names, values in blocks:
        distinct = [i for i, name in enumerate(names) if name not in names[:i]]
        table = np.array(values, dtype=np.float64).reshape(-1, len(names))[:, distinct]
        if len(table):
            tables.append(pd.DataFrame(table, columns=[names[i] for i in distinct]))
    if not tables:
        return pd.DataFrame({"Step": np.empty(0)})
    return pd.concat(tables, ignore_index=True)


def _last(thermo: pd.DataFrame, name: str) -> int | None:
    if name not in thermo.columns or not len(thermo):
        return None
    value = float(thermo[name].iloc[-1])
    return int(value) if np.isfinite(value) else None
