"""The folder of a command that makes many runs of one case: its own, so that nothing else is written over there."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from kncal.core.errors import InputError, ReadError
from kncal.core.files import read_json
from kncal.core.lock import LOCK


def refuse_other(out: Path, record: str, started: Collection[str], case: str | Path) -> None:
    """Refuse ``out`` if it is a file or a link, holds the case, or anything without a ``record`` that says that it may.

    ``started``: names that an earlier start may have left there before its record.

    Raises
    ------
    InputError
        Saying what is there; nothing was changed.
    """
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise InputError(f"{out}: expected a folder (or nothing yet), not a file or a link; choose another --out")
    home = Path(case).parent if Path(case).is_file() else Path(case)
    if home.is_dir() and out.is_dir() and home.samefile(out):
        raise InputError(f"{out}: holds the case itself, which would be written over: choose another --out")
    if not out.is_dir():
        return
    if (out / record).exists():
        _check_record(out / record)
        return
    other = sorted(path.name for path in out.iterdir() if not _left(path.name, started))
    if other:
        raise InputError(
            f"{out}: holds {', '.join(other[:3])}{' ...' if len(other) > 3 else ''} and no {record}: expected a new or "
            "an empty folder, or that of the same command; choose another --out, nothing was changed"
        )


def _check_record(path: Path) -> None:
    """Raise `InputError` if this is no record of a command of many runs: those say of which case."""
    try:
        data = read_json(path)
        wrong = "" if isinstance(data, dict) and isinstance(data.get("case"), str) else "it names no case"
    except ReadError as error:
        wrong = str(error)
    if wrong:
        raise InputError(
            f"{path}: not a record of kncal ({wrong}): choose another --out, or remove it; nothing was changed"
        )


def _left(name: str, started: Collection[str]) -> bool:
    return name == LOCK or name in started or (name.startswith(".") and name.endswith(".part"))
