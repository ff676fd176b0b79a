"""What may go from run folders: earlier attempts, and what only an unfinished run would still need."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from kncal.errors import ReadError, RenderError
from kncal.lock import LOCK, locked
from kncal.model import KINDS
from kncal.states import find_run_folders, holder, run_state

#: Of a completed coupled run: where the solvers worked, and from where it could have gone on.
_WORK = ("gas", "gas-*", "particles", "particles-*", "checkpoint-*")


@dataclass(frozen=True, kw_only=True)
class Removal:
    """One folder that may go.

    Attributes
    ----------
    path : Path; owner : the run folder that it is in
    why : for a person
    size : [bytes]
    """

    path: Path
    owner: Path
    why: str
    size: int


def plan_cleaning(root: Path) -> tuple[tuple[Removal, ...], tuple[str, ...]]:
    """Return what may go from the run folders in ``root``, and a sentence for each that is left alone.

    Records, series, frames, logs and reports stay. A folder that a run holds is left alone.

    Raises
    ------
    ReadError
        If ``root`` is not a folder.
    """
    if not root.is_dir():
        raise ReadError(f"{root}: not a folder; expected one that holds runs, e.g. runs")
    removals: list[Removal] = []
    left: list[str] = []
    for out in find_run_folders(root):
        if owner := holder(out):
            left.append(f"{out}: left alone, in use by {owner}")
            continue
        found = [(path, "an earlier attempt") for path in sorted(out.glob("attempt-*"))]
        for kind in KINDS:
            if (out / kind / "series").is_dir() and run_state(out / kind).status == "completed":
                found += [(path, "of a completed run") for name in _WORK for path in sorted((out / kind).glob(name))]
        removals += [
            Removal(path=path, owner=out, why=why, size=_size(path))
            for path, why in found
            if path.is_dir() and not path.is_symlink()
        ]
    return tuple(removals), tuple(left)


def clean(removals: Iterable[Removal]) -> tuple[int, tuple[str, ...]]:
    """Remove what was planned; returns the bytes that were freed, and a sentence for each folder that is now in use."""
    freed, left = 0, {}
    for removal in removals:
        if removal.owner in left:
            continue
        try:
            with locked(removal.owner):  # a run may have started since
                shutil.rmtree(removal.path)
                freed += removal.size
        except RenderError as error:
            left[removal.owner] = str(error)
    return freed, tuple(left.values())


def _size(folder: Path) -> int:
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.name != LOCK)
