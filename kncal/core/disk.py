"""Is the disk full? Solvers do not say so: they print nothing, end with 0, or die of what they could not write."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path

#: What a system says where no more can be written.
FULL = (errno.ENOSPC, errno.EDQUOT)
#: A disk on which not even so much can be written is full [bytes].
ROOM = 1 << 20
#: Failures that a full disk may be behind. The others (a lost particle ...) have a cause of their own.
_MAYBE = (
    "solver-error", "killed", "peer-died", "no-end-marker", "wrong-last-step", "empty-output", "truncated-output",
)  # fmt: skip


def is_full(folder: Path) -> bool:
    """Return whether `ROOM` bytes cannot be written into ``folder``: no space, no free inode, or a quota."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            os.posix_fallocate(file.fileno(), 0, ROOM)
    except OSError as error:
        return error.errno in FULL
    return False


def blame(failure: str, message: str, folder: Path) -> tuple[str, str]:
    """Return failure and message of a run in ``folder``: "disk-full" if its disk is, and that may be the cause."""
    if failure not in _MAYBE or not is_full(folder):
        return failure, message
    return "disk-full", f"the disk of {folder} is full: make room and run again; {message}"
