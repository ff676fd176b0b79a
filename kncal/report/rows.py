"""The rows of a comparison as a table: value ± width of both runs, their difference, and what is to know about each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from kncal.core.units import percent, quantity
from kncal.observe.estimate import Estimate
from kncal.observe.row import Row, allowed, difference_text
from kncal.observe.verdict import by_length
from kncal.report.page import Table, marks

_SIDES = ("linear", "hertz")
_SEEN = {True: "yes", False: "no", None: "not known"}
_HEADINGS = ("metric", "linear", "Hertz", "difference", "exact difference", "difference seen", "allowed", "")


@dataclass(frozen=True)
class Rows:
    """The table of a comparison.

    Attributes
    ----------
    table : what was seen in a run, or was to be judged
    notes : why some of it is not reliable, each once; the names of the rows carry their numbers
    unseen : what neither run shows and nobody asked for: "names: reason"
    """

    table: Table
    notes: tuple[str, ...]
    unseen: tuple[str, ...]


def table_of(rows: Sequence[Row]) -> Rows:
    """Return the table of ``rows``, in their order; a column that is empty in all of them is left out."""
    notes: dict[str, int] = {}
    unseen: dict[str, list[str]] = {}
    cells, below = [], []
    for row in rows:
        if not row.seen and row.tolerance is None:
            unseen.setdefault(row.reason or "not observed", []).append(row.metric)
            continue
        doubts = [] if row.difference.reliable else split_reason(row.reason)
        cells.append(
            (
                row.metric + marks(sorted(notes.setdefault(note, len(notes) + 1) for note in doubts)),
                shown(row.run, row.unit),
                shown(row.reference, row.unit),
                difference_text(row),
                percent(row.exact_difference),
                "" if row.difference.value is None else _SEEN[row.difference.significant],
                "" if row.tolerance is None else allowed(row.tolerance),
                "" if row.verdict == "-" else row.verdict,
            )
        )
        basis = f"difference: {row.basis}" if row.basis and not row.basis.startswith("relative") else ""
        reason = row.reason if row.difference.reliable else ""
        below.append("; ".join(filter(None, (row.text, basis, _to_decide(row), reason))))
    last = len(_HEADINGS) - 1
    used = [i for i in range(last + 1) if i == last or any(row[i] not in ("", "–") for row in cells)]
    table = Table(
        tuple(_HEADINGS[i] for i in used),
        tuple(tuple(row[i] for i in used) for row in cells),
        text=(0, *(place for place, i in enumerate(used) if _HEADINGS[i] in ("difference seen", ""))),
        below=tuple(below),
    )
    return Rows(table, tuple(notes), tuple(f"{', '.join(names)}: {reason}" for reason, names in unseen.items()))


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


def _to_decide(row: Row) -> str:
    """What would decide an undecided row."""
    if row.verdict != "undecided":
        return ""
    if not row.difference.chance:
        return "to decide, take more steps per contact"
    end = row.difference.needed_end
    if end is None and not by_length(row):
        return "to decide, take more particles"
    return "to decide, run " + ("much longer (out of reach)" if end is None else f"until about {end:.3g} s")


def shown(found: Estimate, unit: str) -> str:
    """Return an average ± its uncertainty with one unit: "105.3 ± 1.2 Pa"; other values alone, "–" without one."""
    return quantity(found.value, unit, width=found.width if found.chance else None)
