"""How the command line prints: tables, numbers with units, JSON, progress."""

from __future__ import annotations

import errno
import io
import json
import math
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from datetime import timedelta
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

from kncal.core.stopping import start_deaf

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as RichProgress
    from rich.progress import Task, TaskID

    from kncal.engines.base import Progress

#: Width of tables of text where there is no terminal, and room in which a table of numbers is measured.
_TEXT_WIDTH, _ROOM = 140, 500
#: Without a terminal progress is told so often [s].
MINUTE = 60.0
_JSON_PRINTED: ContextVar[bool] = ContextVar("json_printed", default=False)


def console(*, stderr: bool = False) -> Console:
    """Return a console that never breaks a number apart."""
    from rich.console import Console

    return Console(highlight=False, stderr=stderr, soft_wrap=True)


def printable(text: str) -> str:
    """Return ``text`` without control characters: solver logs and file names may hold anything."""
    return "".join(c if c.isprintable() or c == "\n" else "\N{REPLACEMENT CHARACTER}" for c in text)


def quantity(value: float | None, unit: str = "", digits: int = 4, *, width: float | None = None) -> str:
    """Return a number with its unit and a fitting prefix, and with its width if there is one."""
    from kncal.core.units import quantity as with_unit

    return with_unit(value, unit, digits, width=width)


def kind_of(code: str) -> str:
    """Return what a warning of a calibration is called: a note if nearly every damped contact has it (attraction)."""
    return "note" if code == "attraction" else "warning"


def words(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table of text, wrapped to the terminal."""
    table(title, columns, rows, text=range(len(columns)), fold=True)


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
    """Print ``data`` as JSON, paths as text; refuses NaN."""
    utf8 = (getattr(sys.stdout, "encoding", None) or "utf-8").lower().replace("-", "") == "utf8"
    text = json.dumps(data, indent=2, ensure_ascii=not utf8, allow_nan=False, default=os.fspath)
    _JSON_PRINTED.set(True)
    print(text)


def json_was_printed() -> bool:
    """Return whether this command has printed its result as JSON: a second object would make both unreadable."""
    return _JSON_PRINTED.get()


ProgressFor = Callable[[str], "Progress"]


@contextmanager
def run_bars(intervals: Mapping[str, float | None]) -> Iterator[ProgressFor]:
    """Show one bar per model on stderr: how far it is, and the wall time that is left.

    ``intervals``: the simulated time [s] of one unit of progress, by model; without one the unit is a step. Until the
    first progress a bar says that the run is being prepared.
    """
    from rich.progress import BarColumn, ProgressColumn, TextColumn
    from rich.text import Text

    class Times(ProgressColumn):
        def render(self, task: Task) -> Text:
            if task.total is None:
                return Text("preparing")
            if task.fields["unit"] == "steps":
                text = f"{task.completed:.0f} of {task.total:.0f} steps"
            else:
                text = f"{task.completed:.3f} of {task.total:.3f} s simulated"
                if speed := task.finished_speed or task.speed:
                    text += f", {quantity(speed, 's', 3)} per s"
            if left := _left(task):
                text += f", {left} left"
            return Text(text, no_wrap=True)

    columns = (TextColumn("{task.description:>8}"), BarColumn(bar_width=12), Times())
    with bars(*columns) as shown:
        start = shown.add_task("start", total=None)
        tasks: dict[str, TaskID] = {}

        def for_model(kind: str) -> Progress:
            interval = intervals.get(kind)
            scale, unit = (1.0, "steps") if interval is None else (interval, "s simulated")

            def advance(done: int, total: int) -> None:
                shown.update(start, visible=False)
                if kind not in tasks:
                    tasks[kind] = shown.add_task(kind, total=scale * total, unit=unit, first=scale * done)
                shown.update(tasks[kind], completed=scale * done, total=scale * total)

            return advance

        yield for_model


@contextmanager
def working(what: str) -> Iterator[Callable[[str], None]]:
    """Show on stderr that something is going on whose length is not known; gives a function that names it."""
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

    with bars(TextColumn("{task.description:>8}"), BarColumn(), TimeElapsedColumn()) as shown:
        task = shown.add_task(what, total=None)
        yield lambda now: shown.update(task, description=now)


@contextmanager
def bars(*columns: Any) -> Iterator[RichProgress]:
    """Show progress bars on stderr; where that is no terminal, a line a minute for each that is going on."""
    from rich.progress import Progress as RichProgress

    screen = console(stderr=True)
    live = screen.is_terminal
    shown = RichProgress(*columns, console=screen, disable=not live)
    with shown, nullcontext() if live else _lines(shown):
        yield shown


@contextmanager
def _lines(shown: RichProgress) -> Iterator[None]:
    ended = Event()

    def tell() -> None:
        while not ended.wait(MINUTE):
            for task in shown.tasks:
                if task.visible and not task.finished:
                    note(_line(task))

    thread = Thread(target=tell, name="kncal-progress", daemon=True)
    start_deaf(thread)
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _line(task: Task) -> str:
    """Return how far something is: ``linear: 1200 of 4000 steps, 30 %, 0:02:00 so far, 0:04:40 left``."""
    parts = []
    if task.total:
        parts.append(task.fields.get("text") or f"{task.completed:.6g} of {task.total:.6g} {task.fields['unit']}")
        parts.append(f"{task.percentage:.0f} %")
    parts.append(f"{timedelta(seconds=round(task.elapsed or 0.0))} so far")
    if (left := _left(task)) is not None:
        parts.append(f"{left} left")
    return f"{task.description}: {', '.join(parts)}"


def _left(task: Task) -> timedelta | None:
    """Return the time that is left at the mean speed so far; rich's own forgets it where the total changes."""
    done = task.completed - task.fields.get("first", math.inf)
    if task.total is None or task.finished or not done > 0.0:
        return None
    return timedelta(seconds=round((task.elapsed or 0.0) * (task.total - task.completed) / done))


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
