"""Checkpoints of a coupled run: whole or not there, also after a power cut."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from kncal.core.disk import is_full
from kncal.core.errors import ReadError, RunError
from kncal.core.files import sha256, write_json
from kncal.core.records import Digests, Record, Seconds, read_record

GAS, PARTICLES = "gas", "particles"
RECORD = "checkpoint.json"
#: Name of a checkpoint's folder.
CHECKPOINT = re.compile(r"checkpoint-([1-9]\d{0,15})")
#: More couplings than any run has; a float holds them exactly.
_MOST = 2**53


class _Record(Record):
    coupling: Annotated[int, Field(ge=1, le=_MOST)]
    cost: dict[str, Seconds]
    files_sha256: Digests


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """One checkpoint: its folder, the couplings done, and what they cost (numbers of `CoupledCost`, by name)."""

    path: Path
    coupling: int
    cost: Mapping[str, float]


def write_checkpoint(
    folder: Path,
    coupling: int,
    cost: Mapping[str, float],
    save_gas: Callable[[Path], None] | None,
    save_particles: Callable[[Path], None] | None,
) -> None:
    """Write the state after ``coupling`` into ``folder``; older checkpoints go when all of it is on the disk."""
    new = folder / f"checkpoint-{coupling}"
    if new.exists():
        shutil.rmtree(new)
    new.mkdir(parents=True)
    for name, save in ((GAS, save_gas), (PARTICLES, save_particles)):
        if save is not None:
            save(new / name)
    if is_full(new):  # LIGGGHTS does not look whether its file could be written
        raise RunError(f"{new}: the disk is full, so that this checkpoint may be cut short: make room", "disk-full")
    files = [path for path in sorted(new.rglob("*")) if path.is_file()]
    for path in (*files, new / GAS, new / PARTICLES, new):
        if path.exists():
            _sync(path)
    digests = {path.relative_to(new).as_posix(): sha256(path) for path in files}
    write_json(new / RECORD, {"coupling": coupling, "cost": dict(cost), "files_sha256": digests})
    _sync(folder)
    for old in _folders(folder):
        if old != new:
            shutil.rmtree(old)


def last_checkpoint(folder: Path, couplings: int = _MOST) -> Checkpoint | None:
    """Return the newest whole checkpoint of a run of so many couplings, None if there is none."""
    found = [checkpoint for path in _folders(folder) if (checkpoint := _read(path, couplings)) is not None]
    return max(found, key=lambda checkpoint: checkpoint.coupling, default=None)


def _folders(folder: Path) -> list[Path]:
    """Return the folders with the name of a checkpoint; what else is called so is somebody's own."""
    found = folder.glob("checkpoint-*")
    return [path for path in found if CHECKPOINT.fullmatch(path.name) and path.is_dir() and not path.is_symlink()]


def _read(path: Path, couplings: int) -> Checkpoint | None:
    """Return a checkpoint; None if it was cut short while it was written, changed since, or is not of such a run."""
    try:
        record = read_record(_Record, path / RECORD)
        if record.coupling > couplings or path.name != f"checkpoint-{record.coupling}":
            return None
        whole = all(sha256(path / name) == digest for name, digest in record.files_sha256.items())
    except ReadError:
        return None
    return Checkpoint(path=path, coupling=record.coupling, cost=record.cost) if whole else None


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
