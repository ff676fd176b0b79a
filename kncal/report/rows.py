"""The rows of a comparison as the report's table shows them: numbers in short lines, doubts as numbered notes below."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from kncal.core.units import plus_minus, quantity, si_prefix
from kncal.observe.row import Row, allowed, difference_text

_SIDES = ("linear", "hertz")


@dataclass(frozen=True)
class Line:
    """A row of the table; ``notes``: numbers, from 1, of the notes below it that belong to the row."""

    name: str
    notes: tuple[int, ...]
    text: str
    linear: str
    hertz: str
    difference: str
    seen: str
    allowed: str
    verdict: str
    remark: str


@dataclass(frozen=True)
class Lines:
    """The table of quantities.

    Attributes
    ----------
    rows : what was seen in a run, or was to be judged
    notes : why some of it is not to be relied upon, each once
    unseen : (reason, names) of what neither run shows and nobody asked for
    """

    rows: tuple[Line, ...]
    notes: tuple[str, ...]
    unseen: tuple[tuple[str, str], ...]


def lines_of(rows: Sequence[Row]) -> Lines:
    """Return the table of ``rows``, in their order."""
    notes: dict[str, int] = {}
    shown: list[Line] = []
    unseen: dict[str, list[str]] = {}
    for r in rows:
        if not r.seen and r.tolerance is None:
            unseen.setdefault(r.reason or "not observed", []).append(r.metric)
            continue
        numbers = [notes.setdefault(note, len(notes) + 1) for note in split_reason(r.reason)]
        shown.append(_line(r, tuple(numbers)))
    return Lines(tuple(shown), tuple(notes), tuple((reason, ", ".join(names)) for reason, names in unseen.items()))


def split_reason(reason: str) -> list[str]:
    """Return the single statements of a row's reason, each with its run in front unless both say the same.

    ``linear: a; b; hertz: b; c`` -> ``linear: a``, ``b``, ``hertz: c``.
    """
    side = ""
    said: dict[str, list[str]] = {}
    for part in filter(None, reason.split("; ")):
        head, colon, rest = part.partition(": ")
        if colon and head in _SIDES:
            side, part = head, rest  # noqa: PLW2901
        said.setdefault(part, []).append(side)
    return [
        text if set(sides) >= set(_SIDES) or not sides[0] else f"{sides[0]}: {text}" for text, sides in said.items()
    ]


def _line(r: Row, notes: tuple[int, ...]) -> Line:
    remarks = [] if not r.basis or r.basis.startswith("relative") else [f"difference: {r.basis}"]
    if r.verdict == "undecided":
        needed = "out of reach" if (end := r.difference.needed_end) is None else f"until about {end:.3g} s"
        remarks.append(f"to decide, run {needed}")
    seen = {True: "yes", False: "none seen", None: "not known"}[r.difference.significant]
    return Line(
        name=r.metric,
        notes=notes,
        text=r.text,
        linear=with_uncertainty(r.run.value, r.run.width, r.unit),
        hertz=with_uncertainty(r.reference.value, r.reference.width, r.unit),
        difference=difference_text(r),
        seen="" if r.difference.value is None else seen,
        allowed="" if r.tolerance is None else allowed(r.tolerance),
        verdict="" if r.verdict == "-" else r.verdict,
        remark="; ".join(remarks),
    )


def with_uncertainty(value: float | None, uncertainty: float | None, unit: str) -> str:
    """Return a number and its uncertainty with one unit: "105.3 ± 1.2 Pa"; "–" for one that is not there."""
    if value is None:
        return "–"
    if not uncertainty:
        return quantity(value, unit)
    factor, label = (1.0, "") if unit in ("", "–") else si_prefix(max(abs(value), uncertainty), unit)
    if "²" in unit:  # a prefix before a power would be read as part of it
        factor, label = 1.0, unit
    return f"{plus_minus(factor * value, factor * uncertainty)} {label}".rstrip()


def names_of(lines: Iterable[Line]) -> set[str]:
    """Return the names of the quantities in the table."""
    return {line.name for line in lines}
