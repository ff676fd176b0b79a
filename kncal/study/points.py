"""The points of a sweep: grids, rows of a file, Latin hypercubes, and every combination of what is given.

A point is a tuple of `kncal.scene.overrides.Override`, the values that stand in place of what the case file says.
"""

from __future__ import annotations

import csv
import io
import itertools
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kncal.core.errors import InputError, ReadError
from kncal.core.files import read_limited
from kncal.scene.overrides import Override, parse_override

#: More points than this are refused.
MOST_POINTS = 100_000
#: A larger file of points is refused [bytes].
MOST_BYTES = 32 * 1024**2

Point = tuple[Override, ...]


@dataclass(frozen=True)
class Range:
    """A range to sample one key from, by the logarithm if ``log``."""

    path: tuple[str, ...]
    low: float
    high: float
    log: bool = False


def split_values(text: str) -> list[str]:
    """Split at the commas that are in no bracket and in no quotes: ``[1,2],[3,4]`` has two values."""
    parts, depth, quote, start = [], 0, "", 0
    for i, c in enumerate(text):
        if quote:
            if c == quote and text[i - 1] != "\\":
                quote = ""
        elif c in "\"'":
            quote = c
        elif c in "[{":
            depth += 1
        elif c in "]}":
            depth -= 1
        elif c == "," and depth == 0:
            parts.append(text[start:i])
            start = i + 1
    return [*parts, text[start:]]


def grid_axis(text: str) -> list[Point]:
    """Return the points of ``KEY=VALUE,VALUE,...``, one value each.

    Raises
    ------
    InputError
        If it is not of that form.
    """
    key, sign, given = text.partition("=")
    if not sign:
        raise InputError(f"--set {text}: expected KEY=VALUE,VALUE,..., e.g. contact.k_n=500,1000")
    return [(parse_override(f"{key}={value}"),) for value in split_values(given)]


def read_points(path: Path) -> list[Point]:
    """Read a CSV file of points: a header of dotted keys, then one row per run; an empty cell leaves the case's value.

    Raises
    ------
    InputError
        If it cannot be read, or a row is not as long as the header; the text names the line.
    """
    try:
        text = read_limited(path, MOST_BYTES, "a CSV file of points").decode("utf-8-sig")
    except ReadError as error:
        raise InputError(f"--points {error}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"--points {path}: byte {error.start} is not UTF-8; expected a CSV file") from error
    reader = csv.reader(io.StringIO(text, newline=""), strict=True, skipinitialspace=True)
    points: list[Point] = []
    try:
        header = [name.strip() for name in next(reader, [])]
        if not any(header):
            raise InputError(f"--points {path}: empty; expected a first line of keys, e.g. contact.k_n,run.until_time")
        for row in reader:
            if not row:
                continue
            if len(row) != len(header):
                raise InputError(
                    f"--points {path}, line {reader.line_num}: {len(row)} cells, expected {len(header)} as in the "
                    "header (a list in one cell needs double quotes around it)"
                )
            cells = zip(header, row, strict=True)
            points.append(tuple(parse_override(f"{key}={cell}") for key, cell in cells if cell.strip()))
    except csv.Error as error:
        raise InputError(f"--points {path}, line {reader.line_num}: {error}; expected CSV") from error
    except InputError as error:
        place = "" if str(error).startswith("--points") else f"--points {path}, line {reader.line_num}: "
        raise InputError(f"{place}{error}") from error
    if not points:
        raise InputError(f"--points {path}: no row below the header; expected one row per run")
    return points


def parse_range(text: str, log: Iterable[str] = ()) -> Range:
    """Return what ``KEY=LOW:HIGH`` says; by the logarithm if the key is in ``log``.

    Raises
    ------
    InputError
        If it is not of that form, the ends are not finite and increasing, or not positive for a logarithm.
    """
    found = re.fullmatch(r"([^=]+)=([^:=]+):([^:=]+)", text)
    if not found:
        raise InputError(f"--range {text}: expected KEY=LOW:HIGH, e.g. contact.v_0=0.1:1.0")
    try:
        low, high = float(found[2]), float(found[3])
    except ValueError:
        raise InputError(f"--range {text}: expected two numbers, e.g. contact.v_0=0.1:1.0") from None
    override = parse_override(f"{found[1]}=0")
    by_log = override.key in {parse_override(f"{key}=0").key for key in log}
    if not (math.isfinite(low) and math.isfinite(high) and low < high and math.isfinite(high - low)):
        raise InputError(f"--range {text}: expected two finite numbers, the smaller first")
    if by_log and low <= 0.0:
        raise InputError(f"--range {text}: expected positive numbers, since --log {override.key} is given")
    return Range(override.path, low, high, by_log)


def sample(ranges: Sequence[Range], number: int, seed: int = 0) -> list[Point]:
    """Return a Latin hypercube: ``number`` points, of which each of as many equal slices of every range holds one.

    Values have six significant digits, so that a table of them can be read; the same seed gives the same points.

    Raises
    ------
    InputError
        If there is no range, or the number or the seed is out of range.
    """
    from scipy.stats import qmc

    if not ranges:
        raise InputError("--sample needs at least one --range KEY=LOW:HIGH")
    if not 1 <= number <= MOST_POINTS:
        raise InputError(f"--sample {number}: expected 1 to {MOST_POINTS}")
    if seed < 0:
        raise InputError(f"--seed {seed}: expected a whole number from 0 on")
    unit = qmc.LatinHypercube(d=len(ranges), rng=seed).random(number)
    return [tuple(Override(r.path, _scaled(r, float(u))) for r, u in zip(ranges, row, strict=True)) for row in unit]


def _scaled(r: Range, u: float) -> float:
    if r.log:
        value = math.exp(math.log(r.low) + u * (math.log(r.high) - math.log(r.low)))
    else:
        value = r.low + u * (r.high - r.low)
    return min(max(float(f"{value:.6g}"), r.low), r.high)


def combine(groups: Sequence[Sequence[Point]]) -> list[Point]:
    """Return every combination of a point of each group, the last group fastest; each point sorted by its keys.

    Raises
    ------
    InputError
        If two groups set the same key, or there are no points or more than `MOST_POINTS`.
    """
    if not groups:
        raise InputError("nothing to vary: expected --set KEY=VALUE,VALUE,..., --points FILE, or --sample with --range")
    number = math.prod(len(group) for group in groups)
    if number > MOST_POINTS:
        raise InputError(f"{number} points: expected at most {MOST_POINTS}")
    seen: set[str] = set()
    for group in groups:
        keys = {override.key for point in group for override in point}
        if twice := sorted(keys & seen):
            raise InputError(f"{twice[0]}: varied twice; expected each key in one --set, column or --range")
        seen |= keys
    points = [tuple(itertools.chain.from_iterable(parts)) for parts in itertools.product(*groups)]
    return [tuple(sorted(point, key=lambda override: override.key)) for point in points]
