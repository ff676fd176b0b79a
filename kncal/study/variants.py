"""One variant of a case: a contact model, and values that stand in place of the case's."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kncal.core.checks import one_of
from kncal.core.errors import InputError
from kncal.scene.case_text import parse_toml, read_case
from kncal.scene.model import KINDS
from kncal.scene.overrides import Absent, Override, parse_override
from kncal.study.points import Point

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")

#: Dotted key of a case -> the value that stands there instead; None takes the key out of the case.
Changes = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A case with one model and some values replaced.

    Attributes
    ----------
    name : unique in a study; letters, digits, ``.``, ``_`` and ``-``
    model : "linear" or "hertz"
    changes : dotted key -> value, None to take the key out: ``{"contact.k_n": 1e3, "contact.method": None}``

    Raises
    ------
    InputError
        If one of them is not of its form.
    """

    name: str
    model: str
    changes: Changes = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise InputError(f"variant {self.name!r}: expected a name of 1 to 64 letters, digits, '.', '_' or '-'")
        one_of("model", self.model, KINDS)
        _ = self.point

    @property
    def point(self) -> Point:
        """The changes as a point of a sweep."""
        return point(self.changes)

    @property
    def overrides(self) -> tuple[str, ...]:
        """The changes as `kncal.scene.case_file.load_case` takes them."""
        return texts(self.changes)


def point(changes: Changes) -> Point:
    """Return changes as a point of a sweep, by key."""
    found = [Override(_path(key), Absent.NONE if value is None else value) for key, value in changes.items()]
    return tuple(sorted(found, key=lambda override: override.key))


def texts(changes: Changes) -> tuple[str, ...]:
    """Return changes as ``KEY = VALUE``."""
    return tuple(map(str, point(changes)))


def changes_of(overrides: Iterable[str]) -> dict[str, Any]:
    """Return what each ``KEY=VALUE`` changes."""
    found = map(parse_override, overrides)
    return {override.key: None if override.value is Absent.NONE else override.value for override in found}


def removing(case: str | Path, *keys: str) -> dict[str, Any]:
    """Return the changes that take out those of ``keys`` (dotted) that the case file has."""
    text, _, where = read_case(case)
    tables = parse_toml(text, where)
    return {key: None for key in keys if _has(tables, _path(key))}


def _path(key: str) -> tuple[str, ...]:
    return parse_override(f"{key}=0").path


def _has(here: Any, path: tuple[str, ...]) -> bool:
    for part in path:
        if isinstance(here, list) and part.isdigit() and int(part) < len(here):
            here = here[int(part)]
        elif isinstance(here, dict) and part in here:
            here = here[part]
        else:
            return False
    return True
