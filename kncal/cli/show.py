"""How the command line prints: tables, numbers with units, JSON, progress."""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID

    from kncal.engines.base import Progress

#: Width of tables of text where there is no terminal, and room in which a table of numbers is measured.
_TEXT_WIDTH, _ROOM = 140, 500
_JSON_PRINTED: ContextVar[bool] = ContextVar("json_printed", default=False)


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


def note(text: str) -> None:
    """Print a line on stderr: what is said about the work, not its result."""
    print(printable(text), file=sys.stderr)


def as_json(data: Any) -> None:
    """Print ``data`` as JSON; refuses NaN."""
    utf8 = (getattr(sys.stdout, "encoding", None) or "utf-8").lower().replace("-", "") == "utf8"
    text = json.dumps(data, indent=2, ensure_ascii=not utf8, allow_nan=False)
    _JSON_PRINTED.set(True)
    print(text)


def json_was_printed() -> bool:
    """Return whether this command has printed its result as JSON: a second object would make both unreadable."""
    return _JSON_PRINTED.get()


ProgressFor = Callable[[str], "Progress"]


@contextmanager
def progress_bars() -> Iterator[ProgressFor]:
    """Show one progress bar per model on stderr (nothing is drawn where stderr is not a terminal)."""
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description:>8}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} steps"),
        TimeRemainingColumn(),
    )
    with _bars(columns) as bars:
        yield _progress_for(bars, lambda _: 1.0)


@contextmanager
def time_bars(intervals: Mapping[str, float]) -> Iterator[ProgressFor]:
    """Show one bar per model on stderr: simulated time, simulated over wall time, and the wall time that is left.

    ``intervals``: the simulated time [s] of one unit of progress, by model. Until the first progress a bar says that
    the run is being prepared.
    """
    from datetime import timedelta

    from rich.progress import BarColumn, ProgressColumn, Task, TextColumn
    from rich.text import Text

    class Times(ProgressColumn):
        def render(self, task: Task) -> Text:
            if task.total is None:
                return Text("preparing")
            text = f"{task.completed:.3f} of {task.total:.3f} s simulated"
            if speed := task.finished_speed or task.speed:
                text += f", {quantity(speed, 's', 3)} per s"
            if task.time_remaining:
                text += f", {timedelta(seconds=round(task.time_remaining))} left"
            return Text(text, no_wrap=True)

    columns = (TextColumn("{task.description:>8}"), BarColumn(bar_width=12), Times())
    with _bars(columns) as bars:
        start = bars.add_task("start", total=None)
        made = _progress_for(bars, intervals.__getitem__)

        def for_model(kind: str) -> Progress:
            advance = made(kind)

            def go_on(done: int, total: int) -> None:
                bars.update(start, visible=False)
                advance(done, total)

            return go_on

        yield for_model


@contextmanager
def working(what: str) -> Iterator[None]:
    """Show on stderr that something is going on whose length is not known."""
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

    with _bars((TextColumn("{task.description:>8}"), BarColumn(), TimeElapsedColumn())) as bars:
        bars.add_task(what, total=None)
        yield


def _bars(columns: Sequence[Any]) -> RichProgress:
    from rich.progress import Progress as RichProgress

    screen = console(stderr=True)
    return RichProgress(*columns, console=screen, disable=not screen.is_terminal)


def _progress_for(bars: RichProgress, unit_of: Callable[[str], float]) -> ProgressFor:
    """Return what gives each model its progress callback; its bar appears with the first call."""
    tasks: dict[str, TaskID] = {}

    def for_model(kind: str) -> Progress:
        unit = unit_of(kind)

        def advance(done: int, total: int) -> None:
            if kind not in tasks:
                tasks[kind] = bars.add_task(kind, total=unit * total)
            bars.update(tasks[kind], completed=unit * done, total=unit * total)

        return advance

    return for_model


class _Steady(io.FileIO):
    """A stream whose reader may go away: the rest is dropped, so that the exit code still says what was found."""

    def write(self, data: Any) -> int | None:  # type: ignore[override]
        try:
            return super().write(data)
        except BrokenPipeError:
            return len(data)


class _Closed(io.RawIOBase):
    """Standard output of a process that was started without one (``>&-``): what is printed is lost, so say so."""

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int | None:
        raise OSError(errno.EBADF, os.strerror(errno.EBADF), "standard output")


@contextmanager
def steady_streams() -> Iterator[None]:
    """Let standard output and error survive a closed pipe, and signs that their encoding does not have."""
    given = sys.stdout, sys.stderr
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        out = sys.stdout or io.TextIOWrapper(io.BufferedWriter(_Closed()), encoding="utf-8")
        # without one print would take standard output
        sys.stdout, sys.stderr = _steady(out, "replace"), _steady(sys.stderr or nowhere, "backslashreplace")
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
