"""Single values of a case file given from outside: ``run.until_time=0.2`` in place of what the file says.

They are put into the TOML tables before these are validated, so a wrong one is refused like the file itself.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from enum import Enum
from typing import Any

from kncal.core.checks import instance, nearest, short
from kncal.core.errors import CaseFileError, InputError
from kncal.scene.case_text import toml_key, toml_value

_BARE_WORD = re.compile(r"[A-Za-z][A-Za-z0-9._-]*")


class Absent(Enum):
    """Stands for "not there": the bare word ``none`` takes a key, a table or a row of a list out of the case."""

    NONE = "none"

    def __str__(self) -> str:
        return self.value


#: A title of a case is at most so long.
_LONGEST_TITLE = 300


@dataclass(frozen=True)
class Override:
    """One value for a case.

    Attributes
    ----------
    path : keys from the top of the file; inside a list of tables the name or the number (from 0) of one of them
    value : as TOML has it, or `Absent.NONE`
    """

    path: tuple[str, ...]
    value: Any

    @property
    def key(self) -> str:
        """The dotted key, as TOML writes it."""
        return ".".join(toml_key(part) for part in self.path)

    def __str__(self) -> str:
        return f"{self.key} = {_shown(self.value)}"


def parse_override(text: str) -> Override:
    """Return what ``KEY=VALUE`` says: a dotted TOML key, and a TOML value or a bare word (which is text).

    ``run.until_time=0.2``, ``particles.beads.count=500``, ``contact.law=hertz``, ``gas.ramp=[[0, 0.1], [1, 0.5]]``,
    ``walls.floor.position=0.0`` (of the wall called floor), ``title="two words"``; ``contact.method=none`` takes the
    key out of the case (``gas=none`` the table).

    Raises
    ------
    InputError
        If it is not of that form.
    """
    key, sign, given = text.partition("=")
    if not sign or not key.strip() or not given.strip():
        raise InputError(f"{short(text)}: expected KEY=VALUE, e.g. run.until_time=0.2")
    path: list[str] = []
    keys = _one_entry(f"{key} = 0")
    while isinstance(keys, dict) and len(keys) == 1:
        (part, keys), *_ = keys.items()
        path.append(part)
    if keys != 0 or not path:
        raise InputError(
            f"{short(text)}: {short(key)} is no key: expected names with dots between, e.g. run.until_time"
        )
    value = _one_entry(f"x = {given.strip()}")
    if isinstance(value, dict) and set(value) == {"x"}:
        return Override(tuple(path), value["x"])
    if given.strip() == str(Absent.NONE):
        return Override(tuple(path), Absent.NONE)
    if _BARE_WORD.fullmatch(given.strip()):
        return Override(tuple(path), given.strip())
    raise InputError(
        f"{short(text)}: {short(given)} is no TOML value: expected a number without unit, true, false, a word, "
        '[a, list] or "text in quotes" (quoted once more for the shell)'
    )


def parse_overrides(texts: Sequence[str]) -> list[Override]:
    """Return what each of ``texts`` says, see `parse_override`; `InputError` if it is no list of them."""
    if isinstance(texts, (str, bytes)) or not isinstance(texts, Sequence):
        raise InputError(f"overrides = {short(texts)}: expected a list of texts KEY=VALUE")
    return [parse_override(instance("override", text, str, "KEY=VALUE")) for text in texts]


def overridden(tables: Mapping[str, Any], overrides: Iterable[Override]) -> dict[str, Any]:
    """Return a copy of the tables of a case file with these values in place of, or beside, its own.

    The title tells of them, so that a run folder does: ``Small bubbling bed (run.until_time = 0.1)``.

    Raises
    ------
    CaseFileError
        If a key leads through something that is not there or is no table, or is given twice. Keys that no case may
        have are refused by the validation that follows.
    """
    result = deepcopy(dict(tables))
    seen: set[tuple[str, ...]] = set()
    for override in overrides:
        if override.path in seen:
            raise CaseFileError(f"{override.key}: given twice: expected one value")
        seen.add(override.path)
        _put(result, override)
    told = ", ".join(f"{path} = {_shown(value)}" for path, value in _traced(overrides))
    title = result.get("title", "")
    if told and isinstance(title, str):
        room = _LONGEST_TITLE - len(title) - 3
        told = told if len(told) <= room else told[: max(room - 4, 0)] + " ..."
        result["title"] = f"{title} ({told})".strip()[:_LONGEST_TITLE]
    return result


def _traced(overrides: Iterable[Override]) -> list[tuple[str, Any]]:
    return [(o.key, o.value) for o in overrides if o.path != ("title",)]


def _put(tables: dict[str, Any], override: Override) -> None:
    here: Any = tables
    done: list[str] = []
    for part in override.path[:-1]:
        here = _inside(here, part, done, override)
        done.append(part)
    last = override.path[-1]
    if isinstance(here, list):
        row = _row(here, last, done, override)
        here[row : row + 1] = [] if override.value is Absent.NONE else [override.value]
    elif isinstance(here, dict) and override.value is Absent.NONE:
        if last not in here:  # or a slip in the key would pass in silence
            raise CaseFileError(f"{override.key} = none: not in the case: expected {_instead(last, here)}")
        del here[last]
    elif isinstance(here, dict):
        here[last] = override.value
    else:
        raise CaseFileError(f"{override.key}: {'.'.join(done)} = {short(here)}: expected a table above {last!r}")


def _inside(here: Any, part: str, done: Sequence[str], override: Override) -> Any:
    if isinstance(here, list):
        return here[_row(here, part, done, override)]
    if not isinstance(here, dict):
        raise CaseFileError(f"{override.key}: {'.'.join(done)} = {short(here)}: expected a table above {part!r}")
    if part not in here and list(done) in (["materials"], ["particles"], ["walls"]):
        # a new one would lack everything but this key, and the refusal would not name the slip
        raise CaseFileError(f"{override.key}: no {part!r} in {done[0]}: expected {_instead(part, here)}")
    return here.setdefault(part, {})


def _row(rows: list[Any], part: str, done: Sequence[str], override: Override) -> int:
    names = [row.get("name") if isinstance(row, dict) else None for row in rows]
    if part in names:
        return names.index(part)
    if re.fullmatch(r"[0-9]{1,9}", part) and int(part) < len(rows):
        return int(part)
    known = [name for name in names if isinstance(name, str)]
    count = f"a number from 0 to {len(rows) - 1}" if rows else "nothing, the list is empty"
    hint = f" or {_instead(part, known)}" if known else ""
    raise CaseFileError(f"{override.key}: no {part!r} in {'.'.join(done)}: expected {count}{hint}")


def _instead(part: str, known: Iterable[str]) -> str:
    known = list(known)
    return f"one of {', '.join(known)}{nearest(part, known)}"


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml_key(key)} = {_shown(v)}" for key, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_shown, value)) + "]"
    return toml_value(value) if isinstance(value, (bool, str, int, float)) else str(value)


def _one_entry(line: str) -> Any:
    """Return the tables of one TOML line, None if it is none."""
    try:
        return tomllib.loads(line)
    except (ValueError, RecursionError):
        return None
