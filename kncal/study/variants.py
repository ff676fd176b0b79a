"""One variant of a case: a contact model and the values that stand in place of the case's."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kncal.core.checks import one_of
from kncal.core.errors import InputError
from kncal.scene.case_text import parse_toml, read_case
from kncal.scene.model import KINDS
from kncal.scene.overrides import parse_override
from kncal.study.points import Point

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A case with one model and some values replaced.

    Attributes
    ----------
    name : unique in a study; letters, digits, ``.``, ``_`` and ``-``
    model : "linear" or "hertz"
    overrides : ``KEY=VALUE`` (see `kncal.scene.overrides`)

    Raises
    ------
    InputError
        If one of them is not of its form.
    """

    name: str
    model: str
    overrides: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise InputError(f"variant {self.name!r}: expected a name of 1 to 64 letters, digits, '.', '_' or '-'")
        one_of("model", self.model, KINDS)
        _ = self.point

    @property
    def point(self) -> Point:
        """The values as a point of a sweep."""
        return tuple(sorted((parse_override(text) for text in self.overrides), key=lambda override: override.key))


def removing(case: str | Path, *keys: str) -> tuple[str, ...]:
    """Return the overrides that take out those of ``keys`` (dotted) that the case file has: ``contact.method=none``."""
    text, _, where = read_case(case)
    tables = parse_toml(text, where)
    return tuple(f"{key}=none" for key in keys if _has(tables, parse_override(f"{key}=none").path))


def _has(here: Any, path: tuple[str, ...]) -> bool:
    for part in path:
        if not isinstance(here, dict) or part not in here:
            return False
        here = here[part]
    return True
