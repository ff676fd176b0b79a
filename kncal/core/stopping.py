"""Stopping work in a thread from another thread, as Ctrl-C stops the main thread.

Python raises `KeyboardInterrupt` in the main thread only. Work that runs in other threads looks here from time to time
instead; to the code it is the same: a `KeyboardInterrupt` at a place where one may come anyway.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Event, Thread, current_thread, main_thread
from types import FrameType

_STOP: ContextVar[Event | None] = ContextVar("stop", default=None)


@contextmanager
def stoppable(event: Event | None) -> Iterator[None]:
    """Let ``event``, once it is set, stop what this thread does in the block."""
    token = _STOP.set(event)
    try:
        yield
    finally:
        _STOP.reset(token)


def check_stop() -> None:
    """Raise `KeyboardInterrupt` if this thread's work is to stop."""
    event = _STOP.get()
    if event is not None and event.is_set():
        raise KeyboardInterrupt


@contextmanager
def shielded_start() -> Iterator[None]:
    """Start a process in the block that Ctrl-C is not to reach, as it belongs to a process group of its own.

    Until it is in that group the terminal's signals would end it. They are held back in this thread meanwhile, and
    so in the new process from its first moment (which takes SIGTERM as ever).
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def start_deaf(thread: Thread) -> None:
    """Start a thread that no signal is given to: signals wake those who wait for them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
    try:
        thread.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def stop_where_it_suits() -> Iterator[Callable[[], bool]]:
    """Let the block choose where it stops: gives a function that says whether it is asked to.

    Ctrl-C, SIGTERM and SIGHUP (in the main thread, where they are handled at all), and `stoppable`, then interrupt
    nothing by themselves; a second signal does.
    """
    outer, asked = _STOP.get(), Event()
    token = _STOP.set(None)
    before: dict[int, Callable[[int, FrameType | None], object]] = {}

    def ask(number: int, frame: FrameType | None) -> None:
        if asked.is_set():
            before[number](number, frame)
        asked.set()

    try:
        if current_thread() is main_thread():
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                handler = signal.getsignal(number)
                if callable(handler):
                    before[number] = handler
                    signal.signal(number, ask)
        yield lambda: asked.is_set() or (outer is not None and outer.is_set())
        if asked.is_set():  # after the block looked for the last time
            raise KeyboardInterrupt
    finally:
        for caught, handler in before.items():
            signal.signal(caught, handler)
        _STOP.reset(token)
