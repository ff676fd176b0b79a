"""A page that opens from disk: a verdict, then sections of text, tables and figures. All reports are made of these.

A page needs no network and runs no script: a Content-Security-Policy forbids both, and every text in it is escaped.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from kncal.core.errors import RenderError
from kncal.core.files import write_text
from kncal.core.scratch import drawn_aside
from kncal.core.templating import Page as Template
from kncal.observe.verdict import Verdict

#: Stands before the number of a note.
_GAP = "\u202f"
T = TypeVar("T")
_SUPERSCRIPT = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Table:
    """A table as a page or a terminal shows it.

    Attributes
    ----------
    headings : of the columns
    rows : cells that are text already
    text : columns of words; the others hold numbers, which are aligned at their right
    below : a line in small letters under each row, "" for none; empty: no row has one
    """

    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    text: tuple[int, ...] = (0,)
    below: tuple[str, ...] = ()

    @classmethod
    def of(cls, items: Iterable[T], columns: Mapping[str, Callable[[T], str]], words: Collection[str]) -> Table:
        """Return a table with a row per item; ``columns``: heading -> cell; ``words``: headings of columns of words."""
        rows = tuple(tuple(cell(item) for cell in columns.values()) for item in items)
        return cls(tuple(columns), rows, text=tuple(i for i, name in enumerate(columns) if name in words))


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A figure in a report's folder: its files, what to look at, and what a blind reader is told.

    ``wide``: it takes the whole width of the page.
    """

    name: str
    png: str
    svg: str
    caption: str
    alt: str
    wide: bool = False


@dataclass(frozen=True, kw_only=True)
class Section:
    """A part of a page: text, table, notes, points, figures, code, parts, in this order; an empty one is left out.

    Attributes
    ----------
    text : paragraphs
    table, remark : and how it is to be read
    notes : numbered; cells refer to them by `marks`
    points : of a list
    entries : nested mappings, lists and numbers, shown as they are
    parts : sections within this one
    folded : shown only when the reader opens it
    """

    title: str
    text: tuple[str, ...] = ()
    table: Table | None = None
    remark: str = ""
    notes: tuple[str, ...] = ()
    points: tuple[str, ...] = ()
    figures: tuple[Figure, ...] = ()
    code: str = ""
    entries: Mapping[str, Any] = field(default_factory=dict)
    parts: tuple[Section, ...] = ()
    folded: bool = False

    @property
    def kept(self) -> Section | None:
        """The section without empty parts; None if nothing is left."""
        parts = kept(self.parts)
        table = self.table if self.table is not None and self.table.rows else None
        shown = (self.text, table, self.notes, self.points, self.figures, self.code, self.entries, parts)
        return replace(self, table=table, parts=parts) if any(shown) else None


@dataclass(frozen=True, kw_only=True)
class Page:
    """A page.

    Attributes
    ----------
    case, title : of the case; the page is called ``title``, or ``case`` without one
    subject : what the page is about, in a few words for the window's title
    about : one paragraph below the title
    provenance : section -> entries (nested mappings, lists, text, numbers), shown as they are
    files : beside the page, with its numbers
    """

    case: str
    title: str
    subject: str
    about: str
    verdict: Verdict
    sections: tuple[Section, ...]
    provenance: Mapping[str, Any] = field(default_factory=dict)
    files: tuple[str, ...] = ()


@contextmanager
def report_folder(folder: Path) -> Iterator[Path]:
    """Make the folder of a report, and give a place to draw in.

    What is drawn moves into ``folder`` at the end: each file is whole, and no link in the folder is followed.

    Raises
    ------
    RenderError
        If ``folder`` is a file or a symbolic link.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise RenderError(f"{folder}: expected a folder for the report (or nothing yet), not a file or a link")
    folder.mkdir(parents=True, exist_ok=True)
    with drawn_aside(folder) as drawn:
        yield drawn


def write_page(page: Page, folder: Path) -> Path:
    """Write ``index.html`` into ``folder``, in place of an earlier one; returns its path."""
    path = folder / "index.html"
    shown = replace(page, sections=kept(page.sections))
    write_text(path, page_template("index.html.j2").render(page=shown, provenance=page.provenance))
    return path


def page_template(name: str) -> Template:
    """Return a page of ``templates/report`` as a template that escapes every text it is given."""
    return Template(name)


def kept(sections: Sequence[Section | None]) -> tuple[Section, ...]:
    """Return the sections that have something to show."""
    return tuple(found for section in sections if section is not None and (found := section.kept) is not None)


def unmarked(cell: str) -> str:
    """Return a cell without the numbers of its notes."""
    return cell.partition(_GAP)[0]


def marks(numbers: Sequence[int]) -> str:
    """Return the numbers of notes as they stand at a cell's end: " ¹ ³"; "" for none."""
    return "".join(f"{_GAP}{number}" for number in numbers).translate(_SUPERSCRIPT)
