"""Where the files that come with kncal are (templates and cases), and where it keeps what is dear to make again."""

from __future__ import annotations

import os
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]


def folder(name: str) -> Path:
    """Return the folder ``name`` ("cases", "templates") of an installed kncal or of a checkout.

    Raises
    ------
    FileNotFoundError
        If neither is there: the installation is incomplete.
    """
    # A wheel holds the folders inside the package; in a checkout they stand beside it.
    for place in (_PACKAGE / "_data" / name, _PACKAGE.parent / name):
        if place.is_dir():
            return place
    raise FileNotFoundError(
        f"kncal's folder {name!r} is missing: expected it in {_PACKAGE / '_data'} or {_PACKAGE.parent}; "
        "install kncal again"
    )


def cache_folder() -> Path:
    """Return the user's folder for what can be made again: ``$XDG_CACHE_HOME/kncal``, else ``~/.cache/kncal``.

    Raises
    ------
    FileNotFoundError
        If there is no home folder.
    """
    given = os.environ.get("XDG_CACHE_HOME", "")
    if Path(given).is_absolute():  # others are to be ignored, says the XDG standard
        return Path(given) / "kncal"
    try:
        return Path.home() / ".cache" / "kncal"
    except RuntimeError as error:
        raise FileNotFoundError("no home folder: set XDG_CACHE_HOME") from error
