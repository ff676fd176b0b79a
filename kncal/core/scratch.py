"""Temporary folders and half-written files that no kill leaves for ever.

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
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

_SUFFIX, _PART = ".scratch", ".part"
_RANDOM = "[a-z0-9_]{8}"  # by the module tempfile
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
    for old in _named(base, rf"{re.escape(prefix)}{_RANDOM}{re.escape(_SUFFIX)}"):
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


@contextmanager
def replacing(path: Path, *, durable: bool = True) -> Iterator[BinaryIO]:
    """Give a temporary file beside ``path``, put in its place in one move at the end; after an error it is removed.

    With ``durable`` it is on the disk before. A symbolic link at ``path`` is replaced, not followed.
    """
    name = path.name[:100]
    sweep_parts(path.parent, [name])
    while True:
        descriptor, made = tempfile.mkstemp(dir=path.parent, prefix=f".{name}.", suffix=_PART)
        with suppress(OSError):  # where no file can be locked
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        if os.fstat(descriptor).st_nlink:
            break
        os.close(descriptor)  # another start took it for a leftover before it was held
    part = Path(made)
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file
            file.flush()
            os.fchmod(file.fileno(), 0o644)  # mkstemp makes it private; results are for everyone to read
            if durable:
                os.fsync(file.fileno())
            part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    if durable:
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)  # without it the move itself may be lost
        finally:
            os.close(folder)


def sweep_parts(folder: Path, names: Collection[str] | None = None) -> None:
    """Remove what killed starts left of `replacing` in ``folder``, of files with these names; None: of all."""
    of = ".+" if names is None else "|".join(map(re.escape, names))
    for part in _named(folder, rf"\.(?:{of})\.{_RANDOM}{re.escape(_PART)}"):
        if (descriptor := hold(part, stat.S_IFREG)) is not None:
            with suppress(OSError):
                part.unlink()
            os.close(descriptor)


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


def _named(folder: Path, pattern: str) -> list[Path]:
    named = re.compile(pattern)
    try:
        with os.scandir(folder) as entries:
            return [Path(entry.path) for entry in entries if named.fullmatch(entry.name)]
    except OSError:
        return []
