"""Where the files that come with kncal are: templates and cases."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


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
