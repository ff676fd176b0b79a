"""Checkpoints of a coupled run: whole or not there, also after a power cut."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from kncal.errors import ReadError
from kncal.io.tables import read_json, write_json

GAS, PARTICLES = "gas", "particles"
_RECORD = "checkpoint.json"


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
    files = [path for path in sorted(new.rglob("*")) if path.is_file()]
    for path in (*files, new / GAS, new / PARTICLES, new):
        if path.exists():
            _sync(path)
    digests = {path.relative_to(new).as_posix(): _digest(path) for path in files}
    write_json(new / _RECORD, {"coupling": coupling, "cost": dict(cost), "files_sha256": digests})
    _sync(folder)
    for old in folder.glob("checkpoint-*"):
        if old != new:
            shutil.rmtree(old)


def last_checkpoint(folder: Path) -> Checkpoint | None:
    """Return the newest checkpoint of a run that is whole, None if there is none."""
    found = [checkpoint for path in folder.glob("checkpoint-*") if (checkpoint := _read(path)) is not None]
    return max(found, key=lambda checkpoint: checkpoint.coupling, default=None)


def _read(path: Path) -> Checkpoint | None:
    """Return a checkpoint; None if it was cut short while it was written, or changed since."""
    try:
        data = read_json(path / _RECORD)
        coupling, cost, files = data["coupling"], data["cost"], data["files_sha256"]
        whole = all(_digest(path / name) == digest for name, digest in files.items())
        numbers = {str(name): float(value) for name, value in cost.items()}
    except (ReadError, OSError, KeyError, TypeError, ValueError, AttributeError):
        return None
    return Checkpoint(path=path, coupling=coupling, cost=numbers) if whole and isinstance(coupling, int) else None


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
