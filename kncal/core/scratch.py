"""Temporary folders that no kill leaves for ever (half-written files: see `kncal.core.files.replacing`).

Each is held by a kernel lock, which ends with the processes that have its descriptor; the next start removes those
that nobody holds. What is no kncal's has another name, and is never touched.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_SUFFIX = ".scratch"
RANDOM = "[a-z0-9_]{8}"  # by the module tempfile
#: Where no file can be locked: leftovers stay there, nothing else changes.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)


@contextmanager
def scratch(base: Path | None = None, prefix: str = "kncal-") -> Iterator[Path]:
    """Give a new temporary folder in ``base`` (default: where temporary files are), removed at the end."""
    with held_scratch(base, prefix) as (folder, _):
        yield folder


@contextmanager
def held_scratch(base: Path | None = None, prefix: str = "kncal-") -> Iterator[tuple[Path, tuple[int, ...]]]:
    """As `scratch`; also gives the descriptors that hold the folder, for a child that may outlive this process."""
    base = Path(tempfile.gettempdir()) if base is None else base
    for old in named(base, rf"{re.escape(prefix)}{RANDOM}{re.escape(_SUFFIX)}"):
        if (descriptor := hold(old, stat.S_IFDIR)) is not None:
            shutil.rmtree(old, ignore_errors=True)
            os.close(descriptor)
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix, suffix=_SUFFIX, dir=base))
        descriptor = hold(folder, stat.S_IFDIR, anyway=True)
        if descriptor is not None and folder.exists():
            break
        if descriptor is not None:  # another start took it for a leftover before it was held
            os.close(descriptor)
    try:
        yield folder, (descriptor,)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(descriptor)


@contextmanager
def drawn_aside(folder: Path) -> Iterator[Path]:
    """Give a temporary folder whose files move into ``folder`` at the end: each whole, no link there followed."""
    with scratch(folder, ".figures-") as drawn:
        yield drawn
        for picture in drawn.iterdir():
            picture.replace(folder / picture.name)


def hold(path: Path, kind: int, *, anyway: bool = False) -> int | None:
    """Lock a file or folder of ours and return its descriptor; None if it is held, another user's, or of another kind.

    With ``anyway`` the descriptor is also returned where nothing can be locked.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError:
        if anyway and os.path.lexists(path):  # it was just made, and nobody took it: no descriptor is left
            raise
        return None
    about = os.fstat(descriptor)
    if stat.S_IFMT(about.st_mode) == kind and about.st_uid == os.geteuid():
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if anyway and error.errno in _NO_LOCKS:
                return descriptor
        else:
            return descriptor
    os.close(descriptor)
    return None


def named(folder: Path, pattern: str) -> list[Path]:
    """Return what in a folder has a name of this pattern; nothing if the folder cannot be read."""
    wanted = re.compile(pattern)
    try:
        with os.scandir(folder) as entries:
            return [Path(entry.path) for entry in entries if wanted.fullmatch(entry.name)]
    except OSError:
        return []
