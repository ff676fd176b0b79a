"""One owner of a run folder: a lock that lives as long as the run, and as a solver that outlives it.

The lock is an ``flock`` on ``OUT/.lock``. Its descriptor is handed on to the solver, so a folder stays taken while an
orphan still writes into it. The file itself stays: removing it would let two starts lock two files.
"""

from __future__ import annotations

import fcntl
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from kncal.awake import awake
from kncal.errors import RenderError

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
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
    try:
        try:
            _lock(descriptor)
        except BlockingIOError as error:
            owner = os.pread(descriptor, 300, 0).decode("utf-8", errors="replace").strip()
            raise FolderInUseError(
                f"{out}: in use by {owner or 'another run that is just starting'} (or by a solver it left behind); "
                "wait for its end, or choose another --out; nothing was changed"
            ) from error
        except OSError as error:
            raise RenderError(f"{path}: cannot be locked ({error.strerror}); choose another --out") from error
        yield descriptor
    finally:
        os.close(descriptor)


def sign(descriptor: int) -> None:
    """Write into the lock who holds it."""
    started = time.strftime("%Y-%m-%dT%H:%M:%S%z")
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, f"pid {os.getpid()} on {socket.gethostname()}, started {started}\n".encode(), 0)


def _lock(descriptor: int) -> None:
    """Take the lock; who only looks whether it is held (`kncal.states.holder`) holds it for an instant, too."""
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
