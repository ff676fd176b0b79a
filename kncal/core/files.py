"""Files that others wrote, opened with care: regular files only, and no more bytes than a limit."""

from __future__ import annotations

import hashlib
import os
import stat
from io import BufferedReader
from pathlib import Path

from kncal.core.errors import ReadError

#: Of a larger file no digest is compared: that would take minutes [bytes].
MOST_HASHED = 16 * 1024**3


def open_limited(path: Path, most: int, expected: str, advice: str = "") -> BufferedReader:
    """Open a regular file of at most ``most`` bytes for reading.

    A device or a pipe has no size and may give bytes for ever, or none: it is refused without waiting for it.

    Raises
    ------
    ReadError
        If the file is missing, no regular file or too large; the text names it, ``expected`` and the ``advice``.
    """
    try:
        # O_NONBLOCK: opening a pipe that nobody writes to would wait
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ReadError(f"{path}: cannot be read ({reason}); expected {expected}") from error
    try:
        about = os.fstat(descriptor)
        if not stat.S_ISREG(about.st_mode):
            raise ReadError(f"{path}: not a regular file; expected {expected}")
        if about.st_size > most:
            hint = f"; {advice}" if advice else ""
            raise ReadError(f"{path}: {about.st_size} bytes, expected at most {most}{hint}")
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def sha256(path: Path, most: int = MOST_HASHED) -> str:
    """Return the SHA-256 of a regular file of at most ``most`` bytes as hexadecimal text; errors as `open_limited`."""
    with open_limited(path, most, "a file to compare with its record") as file:
        try:
            return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise ReadError(f"{path}: cannot be read ({error.strerror})") from error


def read_limited(path: Path, most: int, expected: str, advice: str = "") -> bytes:
    """Return the bytes of a regular file of at most ``most`` bytes; see `open_limited` for the errors."""
    with open_limited(path, most, expected, advice) as file:
        try:
            # not more than it was when it was opened: something may still be writing
            return file.read(os.fstat(file.fileno()).st_size)
        except OSError as error:
            raise ReadError(f"{path}: cannot be read ({error.strerror}); expected {expected}") from error
