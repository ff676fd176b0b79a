"""What may go from run folders: earlier attempts, and what only an unfinished run would still need."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from kncal.core.errors import ReadError, RenderError
from kncal.core.lock import LOCK, locked
from kncal.core.records import is_record
from kncal.engines.checkpoint import CHECKPOINT, GAS, PARTICLES
from kncal.engines.checkpoint import RECORD as CHECKPOINT_RECORD
from kncal.engines.liggghts.deck import DECK
from kncal.runs.folder import OURS, is_attempt, is_run_folder
from kncal.runs.records import MANIFEST, ModelManifest
from kncal.runs.states import find_run_folders, holder, run_state
from kncal.scene.model import KINDS

#: Of a completed coupled run: where the solvers worked, and from where it could have resumed; and what tells each
#: from a folder of somebody's own with such a name.
_WORK = (
    (re.compile(r"gas(-[1-9]\d*)?"), ("system", "constant", "log.*")),
    (re.compile(r"particles(-[1-9]\d*)?"), (DECK, "log.*")),
    (CHECKPOINT, (CHECKPOINT_RECORD, GAS, PARTICLES)),
)


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

    Records, series, frames, reports and the logs beside them stay; the logs inside the working folders of a completed
    bed (``gas``, ``particles``) go with these. A folder that a run holds is left alone, and so is what a link leads to.

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
        elif out.is_symlink():
            left.append(f"{out}: left alone, a link; name the folder that it leads to")
        else:
            found = _removable(out).items()
            left += [f"{path}: left alone, {why}" for path, why in _kept(out)]
            removals += [Removal(path=path, owner=out, why=why, size=_size(path)) for path, why in found]
    return tuple(removals), tuple(left)


def clean(removals: Iterable[Removal]) -> tuple[int, tuple[str, ...]]:
    """Remove what was planned and may still go; what has gone meanwhile is no error.

    Returns the bytes that were freed, and a sentence for each folder that is left: now in use, needed again by a run
    that began and stopped since the plan, or not to be removed.
    """
    planned: dict[Path, list[Removal]] = {}
    for removal in removals:
        planned.setdefault(removal.owner, []).append(removal)
    freed, left = 0, []
    for owner, group in planned.items():
        if owner.is_symlink() or not owner.is_dir():
            continue  # gone since, or no longer what was planned
        try:
            with locked(owner):  # a run may have started since
                size, kept = _remove(group, _removable(owner))
        except RenderError as error:
            left.append(str(error))
        except OSError as error:
            left.append(f"{owner}: left alone, its lock cannot be opened ({error.strerror or error})")
        else:
            freed += size
            left += kept
    return freed, tuple(left)


def _remove(group: Iterable[Removal], removable: Mapping[Path, str]) -> tuple[int, list[str]]:
    """Remove what is removable of one run folder, whose lock is held; return bytes freed, and why others are left."""
    freed, needed, left = 0, set(), []
    for removal in group:
        path = removal.path
        if path in removable:
            try:
                shutil.rmtree(path)
            except OSError as error:
                left.append(f"{error.filename or path}: cannot be removed ({error.strerror or error})")
            else:
                freed += removal.size
        elif path.is_dir():
            needed.add(path.parent)
    left += [f"{folder}: left alone, it is not that of a completed run any more" for folder in sorted(needed)]
    return freed, left


def _removable(out: Path) -> dict[Path, str]:
    """Return path -> why of each folder that may go from the run folder ``out``."""
    if not is_run_folder(out):
        return {}
    found = {path: "an earlier attempt" for path in _attempts(out) if not _others(path)}
    for folder in (out / kind for kind in KINDS):
        if _completed_bed(folder):
            found |= {path: "of a completed run" for path in sorted(folder.iterdir()) if _was_worked_in(path)}
    return found


def _kept(out: Path) -> list[tuple[Path, str]]:
    """Return the attempts in ``out`` that hold more than kncal put there, and what."""
    if not is_run_folder(out):
        return []
    found = [(path, _others(path)) for path in _attempts(out)]
    return [(path, f"it holds {', '.join(names[:3])}, not made by kncal") for path, names in found if names]


def _attempts(out: Path) -> list[Path]:
    return sorted(path for path in out.iterdir() if is_attempt(path))


def _others(attempt: Path) -> list[str]:
    return sorted(path.name for path in attempt.iterdir() if path.name not in (*OURS, LOCK))


def _was_worked_in(path: Path) -> bool:
    """Return whether a solver of a bed worked in this folder, or it is a checkpoint."""
    if path.is_symlink() or not path.is_dir():
        return False
    return any(name.fullmatch(path.name) and any(any(path.glob(sign)) for sign in signs) for name, signs in _WORK)


def _completed_bed(folder: Path) -> bool:
    if folder.is_symlink() or not (folder / "series").is_dir() or not is_record(ModelManifest, folder / MANIFEST):
        return False
    return run_state(folder).status == "completed"


def _size(folder: Path) -> int:
    size = 0
    for path in folder.rglob("*"):
        with suppress(FileNotFoundError):  # removed while this looks
            size += path.lstat().st_size if path.name != LOCK else 0
    return size
