"""LIGGGHTS logs (`log.liggghts`, or the screen output): how far the run came, errors, and whether the deck ended."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from kncal.core.errors import ReadError
from kncal.core.files import MAX_LINE, decode_line, open_limited

#: kncal's decks print this as their last action: LIGGGHTS' exit code is 0 for many runs that stopped early.
END_MARKER = "KNCAL_DONE"
#: A larger log is refused.
MAX_BYTES = 128 * 1024**2

_KEPT = 20


@dataclass(frozen=True, kw_only=True)
class LiggghtsLog:
    """What a log says.

    Attributes
    ----------
    last_step : step of the last thermo line, None if there is none
    atoms : number of particles in the last thermo line, None if there is none
    errors : the lines that begin with "ERROR" (the first 20)
    finished : whether `END_MARKER` stands alone on a line
    """

    last_step: int | None
    atoms: int | None
    errors: tuple[str, ...]
    finished: bool


def read_log(path: Path) -> LiggghtsLog:
    """Read a log, also one that was cut off or holds random bytes.

    Raises
    ------
    ReadError
        If the file is missing, or larger than `MAX_BYTES`.
    """
    errors: list[str] = []
    columns: list[str] = []  # of the thermo lines, in a run's block
    last: dict[str, float] = {}
    finished = False
    try:
        with open_limited(path, MAX_BYTES, "a LIGGGHTS log", "write thermo lines less often") as file:
            for line, ended in _lines(file):
                tokens = line.split()
                if not tokens:
                    continue
                if tokens[0] == "Step":
                    columns = tokens
                elif ended and len(tokens) == len(columns) and (row := _numbers(tokens)):
                    last = dict(zip(columns, row, strict=True))
                elif tokens[0].startswith("ERROR"):
                    errors += [line] if len(errors) < _KEPT else []
                elif line == END_MARKER:
                    finished = True
                elif line.startswith("Loop time of "):
                    columns = []
    except OSError as error:
        raise ReadError(f"{path}: cannot be read ({error.strerror}); expected a LIGGGHTS log") from error
    whole = {name: int(value) for name, value in last.items() if math.isfinite(value)}
    return LiggghtsLog(last_step=whole.get("Step"), atoms=whole.get("Atoms"), errors=tuple(errors), finished=finished)


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
