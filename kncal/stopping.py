"""Stopping work in a thread from another thread, as Ctrl-C stops the main thread.

Python raises `KeyboardInterrupt` in the main thread only. Work that runs in other threads looks here from time to time
instead; to the code it is the same: a `KeyboardInterrupt` at a place where one may come anyway.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Event

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
