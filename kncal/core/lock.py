"""Locks. One owner of a run folder: a lock that lives as long as the run, and as a solver that outlives it.

The lock is an ``flock`` on ``OUT/.lock``. Its descriptor is handed on to the solver, so a folder stays taken while an
orphan still writes into it. The file itself stays: removing it would let two starts lock two files.
"""

from __future__ import annotations

import fcntl
import math
import os
import socket
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from kncal.core.awake import awake
from kncal.core.errors import RenderError
from kncal.core.stopping import check_stop

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
            _take(descriptor, _INSTANT)  # who only looks whether it is held holds it for an instant, too
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


@contextmanager
def only_one(path: Path, limit: float = math.inf, waiting: Callable[[], None] | None = None) -> Iterator[None]:
    """Hold a lock on the file ``path`` (made if missing), after whoever holds it; ``waiting`` is called if one does.

    The lock goes with the process that holds it, however that ends.

    Raises
    ------
    BlockingIOError
        If it is still held after ``limit`` [s].
    """
    with path.open("w") as file:
        _take(file.fileno(), limit, waiting)
        yield


def _take(descriptor: int, limit: float, waiting: Callable[[], None] | None = None) -> None:
    deadline = awake() + limit
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if awake() > deadline:
                raise
            if waiting is not None:
                waiting()
                waiting = None
            check_stop()
            time.sleep(0.02)
        else:
            return
