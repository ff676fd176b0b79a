"""How the command line prints: tables, numbers with units, JSON, progress."""

from __future__ import annotations

import io
import json
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from kncal.engines.base import Progress

#: Width of tables of text where there is no terminal, and room in which a table of numbers is measured.
_TEXT_WIDTH, _ROOM = 140, 500


def console(*, stderr: bool = False) -> Console:
    """Return a console that never breaks a number apart."""
    from rich.console import Console

    return Console(highlight=False, stderr=stderr, soft_wrap=True)


def printable(text: str) -> str:
    """Return ``text`` without control characters: solver logs and file names may hold anything."""
    return "".join(c if c.isprintable() or c == "\n" else "\N{REPLACEMENT CHARACTER}" for c in text)


def quantity(value: float | None, unit: str = "", digits: int = 4) -> str:
    """Return a number with its unit and a fitting prefix."""
    from kncal.units import quantity as with_unit

    return with_unit(value, unit, digits)


def percent(share: float | None) -> str:
    """Return a share with its sign in percent."""
    from kncal.units import percent as in_percent

    return in_percent(share)


def table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], *, text: Sequence[int] = (0,), fold: bool = False
) -> None:
    """Print a table; columns in ``text`` are left-aligned and wrapped if ``fold``, numbers are never broken."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    out = Table(title=Text(title), box=box.SIMPLE_HEAD, title_justify="left", pad_edge=False)
    for i, name in enumerate(columns):
        out.add_column(Text(name), justify="left" if i in text else "right", no_wrap=not (fold and i in text))
    for row in rows:
        out.add_row(*(Text(printable(cell)) for cell in row))
    screen = console()
    if not fold:
        screen.width = _ROOM
        screen.width = screen.measure(out).maximum
    elif not screen.is_terminal:
        screen.width = _TEXT_WIDTH
    screen.print(out, crop=False)


def say(text: str = "") -> None:
    """Print a line without any markup."""
    print(printable(text))


def as_json(data: Any) -> None:
    """Print ``data`` as JSON; refuses NaN."""
    utf8 = (getattr(sys.stdout, "encoding", None) or "utf-8").lower().replace("-", "") == "utf8"
    print(json.dumps(data, indent=2, ensure_ascii=not utf8, allow_nan=False))


@contextmanager
def progress_bars() -> Iterator[Callable[[str], Progress]]:
    """Show one progress bar per model on stderr (nothing is drawn where stderr is not a terminal)."""
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description:>8}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} steps"),
        TimeRemainingColumn(),
    )
    screen = console(stderr=True)
    with Progress(*columns, console=screen, disable=not screen.is_terminal) as bars:
        tasks: dict[str, TaskID] = {}

        def for_model(kind: str) -> Progress:
            def advance(done: int, total: int) -> None:
                if kind not in tasks:
                    tasks[kind] = bars.add_task(kind, total=total)
                bars.update(tasks[kind], completed=done, total=total)

            return advance  # type: ignore[return-value]

        yield for_model  # type: ignore[misc]


class _Steady(io.FileIO):
    """A stream whose reader may go away: the rest is dropped, so that the exit code still says what was found."""

    def write(self, data: Any) -> int | None:  # type: ignore[override]
        try:
            return super().write(data)
        except BrokenPipeError:
            return len(data)


@contextmanager
def steady_streams() -> Iterator[None]:
    """Let standard output and error survive a closed pipe, and signs that their encoding does not have."""
    given = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _steady(sys.stdout, "replace"), _steady(sys.stderr, "backslashreplace")
    try:
        yield
    finally:
        sys.stdout, sys.stderr = given


def _steady(stream: Any, errors: str) -> Any:
    try:
        stream.flush()
        raw = _Steady(stream.fileno(), "w", closefd=False)
    except (AttributeError, OSError):
        return stream  # closed, or not a file (a test's)
    live = errors != "replace" or raw.isatty()
    return io.TextIOWrapper(io.BufferedWriter(raw), encoding=stream.encoding, errors=errors, line_buffering=live)


@contextmanager
def stop_signals() -> Iterator[None]:
    """Treat SIGTERM and SIGHUP as Ctrl-C, unless they are ignored (nohup) or handled already."""

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    numbers = [n for n in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(n) is signal.SIG_DFL]
    for number in numbers:
        signal.signal(number, stop)
    try:
        yield
    finally:
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)
