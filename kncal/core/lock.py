"""One owner of a run folder: a lock that lives as long as the run, and as a solver that outlives it.

The lock is an ``flock`` on ``OUT/.lock``. Its descriptor is handed on to the solver, so a folder stays taken while an
orphan still writes into it. The file itself stays: removing it would let two starts lock two files.
"""

from __future__ import annotations

import fcntl
import os
import socket
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from kncal.core.awake import awake
from kncal.core.errors import RenderError

LOCK = ".lock"
_INSTANT = 0.5  # s


class FolderInUseError(RenderError):
    """Another process holds the lock of the folder."""


@contextmanager
def locked(out: Path) -> Iterator[int]:
    """Hold the lock of the run folder ``out`` (exists); gives the descriptor for the solver to inherit.

    Raises
    ------
    FolderInUseError
        If another process holds it (the text names its number, host and start).
    RenderError
        If the folder cannot be locked.
    """
    path = out / LOCK
    # O_NONBLOCK, O_NOCTTY: what a stranger put there may be a pipe or a terminal
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOCTTY
    descriptor = os.open(path, flags, 0o644)
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise RenderError(f"{path}: not a regular file, so no lock of kncal; remove it, or choose another --out")
        try:
            _lock(descriptor)
        except BlockingIOError as error:
            owner = signed(descriptor)
            raise FolderInUseError(
                f"{out}: in use by {owner or 'another run that is just starting'} (or by a solver it left behind); "
                "wait for its end, or choose another --out; nothing was changed"
            ) from error
        except OSError as error:
            raise RenderError(f"{path}: cannot be locked ({error.strerror}); choose another --out") from error
        yield descriptor
    finally:
        os.close(descriptor)


def signed(descriptor: int) -> str:
    """Return what the lock says of who holds it; empty if nothing yet."""
    text = os.pread(descriptor, 300, 0).decode("utf-8", errors="replace").strip()
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)


def sign(descriptor: int) -> None:
    """Write into the lock who holds it."""
    started = time.strftime("%Y-%m-%dT%H:%M:%S%z")
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, f"pid {os.getpid()} on {socket.gethostname()}, started {started}\n".encode(), 0)


def _lock(descriptor: int) -> None:
    """Take the lock; who only looks whether it is held (`kncal.runs.states.holder`) holds it for an instant, too."""
    deadline = awake() + _INSTANT
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if awake() > deadline:
                raise
            time.sleep(0.01)
        else:
            return
