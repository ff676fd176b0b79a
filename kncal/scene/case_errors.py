"""Refusals of a case file: from a finding to a line that says file, line, key, value and what is expected."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Any, get_args, get_origin

from kncal.core.checks import nearest, short
from kncal.core.errors import CaseFileError
from kncal.physics.laws import LAWS
from kncal.physics.timestep import USUAL_STEPS, instead_of_zero
from kncal.scene.scene import Scene
from kncal.scene.walls import MOTIONS, WALLS

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

#: A refusal lists at most this many faults.
MOST_FAULTS = 10

KeyPath = tuple[str | int, ...]
Fault = tuple[KeyPath, str]


BARE = re.compile(r"[A-Za-z0-9_-]+")
_PART = r"""(?:[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*')"""
_KEYS = rf"{_PART}(?:\s*\.\s*{_PART})*"
_LINE = re.compile(rf"\s*(?:\[\[\s*(?P<many>{_KEYS})\s*\]\]|\[\s*(?P<one>{_KEYS})\s*\]|(?P<key>{_KEYS})\s*=)")


def fault(error: ErrorDetails, tables: Mapping[str, Any]) -> Fault:
    """Turn one of pydantic's findings in ``tables`` into (path, message)."""
    path, known = _without_marks(error["loc"]), table_at(error["loc"])
    return _about_keys(error, path, known) or _about_value(error, path, known, tables)


def _about_keys(error: ErrorDetails, path: KeyPath, known: Mapping[str, str]) -> Fault | None:
    """The fault of keys that are missing, unknown, or no table; None for that of a value."""
    kind, last = error["type"], path[-1]
    if kind == "unexpected_keyword_argument":
        return path, f"{_shown(path)}: unknown key: {_instead(str(last), [key for key in known if key != 'name'])}"
    if kind == "missing" and isinstance(last, str):
        return path, f"{_shown(path)}: missing: expected {_meaning(path, known)}"
    if kind == "dataclass_type":
        inside = ", ".join(table_at((*error["loc"], "")))
        return path, f"{_shown(path)} = {short(error['input'])}: expected a table with {inside}"
    if kind == "union_tag_invalid":
        return _no_such_kind(error, path)
    if last == "[key]":
        return path[:-1], f"{_shown(path[:-2])}: key {short(path[-2])}: {_cause(error)}"
    return None


def _no_such_kind(error: ErrorDetails, path: KeyPath) -> Fault:
    kinds = MOTIONS if "motion" in path[2:] else WALLS
    if not isinstance(error["input"], Mapping):
        return path, f"{_shown(path)} = {short(error['input'])}: expected a table with {kinds.what}, {', '.join(kinds)}"
    tag = str(error["ctx"]["tag"])
    if not tag:
        return path, f"{_shown(path)}.{kinds.what}: missing: expected one of {', '.join(kinds)}"
    path = (*path, kinds.what)
    return path, f"{_shown(path)} = {short(tag)}: {_instead(tag, list(kinds))}"


def _about_value(error: ErrorDetails, path: KeyPath, known: Mapping[str, str], tables: Mapping[str, Any]) -> Fault:
    kind, meaning = error["type"], _meaning(path, known)
    value = f"{_shown(path)} = {short(error['input'])}"
    about = f" for the {meaning}" if meaning else ""
    if kind == "missing":  # a number of a vector
        given = len(error["input"])
        return path[:-1], f"{_shown(path[:-1])} = {short(error['input'])}: {given} entries{about}: too few"
    if kind in _LENGTH:
        # how many are too many says enough
        about = about if kind == "too_short" else ""
        return path, f"{value}: {len(error['input'])} entries{about}: {_LENGTH[kind].format(**error['ctx'])}"
    if kind in _EXPECTED:
        return path, f"{value}: expected {_EXPECTED[kind]}{about}"
    remedy = f"; {_no_rebound(tables)}" if path and path[-1] == "e_n" and error["input"] == 0 else ""
    return path, f"{value}: {_cause(error)}{remedy}"


def table_at(path: KeyPath) -> dict[str, str]:
    """Return the keys of the table that holds the last key of ``path``, and what each means.

    ``("walls", "floor", "plane", "axis")`` -> those of a plane; "plane" is pydantic's mark for it.
    """
    while path and isinstance(path[-1], int):  # a number of a vector
        path = path[:-1]
    tables, _ = _followed(path[:-1])
    return {key: field.description or "" for t in tables for key, field in t.__pydantic_fields__.items()}


def _followed(path: KeyPath) -> tuple[list[Any], KeyPath]:
    """The classes that may stand at a path, and the path without what pydantic adds to it for the kinds of a union."""
    tables: list[Any] = [Scene]
    named = False  # whether the next part is a name that the user gave
    kept: KeyPath = ()
    for part in path:
        if not named and len(tables) > 1 and (kind := WALLS.get(str(part)) or MOTIONS.get(str(part))):
            tables = [kind.table]
            continue
        kept = (*kept, part)
        if named or isinstance(part, int):
            named = False
        else:
            annotations = [t.__pydantic_fields__[part].annotation for t in tables if part in t.__pydantic_fields__]
            named = any(get_origin(a) is dict for a in annotations)
            tables = [inner for a in annotations for inner in _tables(a)]
    return tables, kept


def _tables(annotation: Any) -> list[Any]:
    """The classes of a scene inside an annotation."""
    if isinstance(annotation, type) and is_dataclass(annotation):
        return [annotation]
    return [inner for part in get_args(annotation) for inner in _tables(part)]


def _without_marks(path: KeyPath) -> KeyPath:
    """A path without what pydantic adds to it for the kinds of a union."""
    _, path = _followed(path)
    return path[:3] if path[:2] == ("contact", "options") else path


def _meaning(path: KeyPath, known: Mapping[str, str]) -> str:
    last = next((part for part in reversed(path) if isinstance(part, str)), "")
    return known.get(last, "")


def _no_rebound(tables: Mapping[str, Any]) -> str:
    """What to do about e_n = 0 at the step of the case, as far as what it says of it is valid."""
    contact, run = (t if isinstance(t := tables.get(name), Mapping) else {} for name in ("contact", "run"))
    law, end, n = contact.get("law", "tsuji"), contact.get("end", "overlap"), run.get("steps_per_contact", USUAL_STEPS)
    usable = isinstance(n, int | float) and 4.0 <= n <= 1e6
    laws = ("linear", law) if isinstance(law, str) and law in LAWS else ("linear",)
    return instead_of_zero(float(n) if usable else USUAL_STEPS, laws, "force" if end == "force" else "overlap")


#: pydantic's error types of lists, with the number that it knows.
_LENGTH = {"too_short": "expected at least {min_length}", "too_long": "expected at most {max_length}"}
#: pydantic's error types in plain words.
_EXPECTED = {
    "float_type": "a number in SI units, without quotes or unit,",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "finite_number": "a finite number",
    "string_type": "text in quotes",
    "bool_type": "true or false",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table",
}


def _cause(error: ErrorDetails) -> str:
    """The "expected ..." part of a message of our own, or what pydantic says."""
    if error["type"] == "literal_error":
        choices = str(error.get("ctx", {}).get("expected", ""))
        return _instead(str(error["input"]), re.findall(r"'([^']*)'", choices) or re.split(r", | or ", choices))
    text = str(error.get("ctx", {}).get("error", error["msg"]))
    head, found, rest = text.partition("expected ")
    return found + rest if found else head[:1].lower() + head[1:]


def placed(path: KeyPath, message: str) -> Fault:
    """Prefix a message with its path; one that begins with the key (``e_n = 2: ...``) has half of it."""
    key = str(path[-1])
    message = message.removeprefix(f"{key}: ")
    if message.startswith(f"{key} = "):
        return path, f"{_shown(path)}{message[len(key) :]}"
    return path, f"{_shown(path)}: {message}"


def _instead(key: str, allowed: Collection[str]) -> str:
    return f"expected one of {', '.join(allowed)}{nearest(key, allowed)}"


def _shown(path: Iterable[str | int]) -> str:
    """``("particles", 0, "name")`` -> ``particles[0].name``; odd keys are quoted and escaped."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += ("." if text else "") + (part if BARE.fullmatch(part) and len(part) <= 64 else short(part))
    return text


def refusal(where: str, text: str, faults: list[Fault]) -> CaseFileError:
    """Return the error that lists ``faults`` by line; ``text`` is the content of the file ``where``."""
    lines = _line_numbers(text)

    def line(path: KeyPath) -> int | None:
        return next((lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in lines), None)

    in_order = sorted(((line(path), message) for path, message in faults), key=lambda item: item[0] or 0)
    listed = [f"{where}{f', line {n}' if n else ''}: {message}" for n, message in in_order[:MOST_FAULTS]]
    if len(faults) > MOST_FAULTS:
        listed.append(f"{where}: and {len(faults) - MOST_FAULTS} more")
    return CaseFileError("\n".join(listed))


def _line_numbers(text: str) -> dict[KeyPath, int]:
    """Where each key stands, best effort: TOML one line at a time, as people write it."""
    found: dict[KeyPath, int] = {}
    counts: dict[KeyPath, int] = {}
    table: KeyPath = ()
    for number, line in enumerate(text.split("\n"), start=1):
        match = _LINE.match(line)
        if match is None:
            continue
        keys = _parts_of(match["many"] or match["one"] or match["key"])
        path: KeyPath = table if match["key"] else ()
        for i, key in enumerate(keys):
            path = (*path, key)
            if match["many"] and i == len(keys) - 1:
                counts[path] = counts.get(path, -1) + 1
            if path in counts:
                path = (*path, counts[path])
        found.setdefault(path, number)
        if not match["key"]:
            table = path
    return found


def _parts_of(key: str) -> list[str]:
    """``walls."a b".axis`` -> its parts; none if it is no TOML key after all."""
    try:
        inside: Any = tomllib.loads(f"{key} = 0")
    except tomllib.TOMLDecodeError:
        return []
    parts = []
    while isinstance(inside, dict):
        ((part, inside),) = inside.items()
        parts.append(part)
    return parts
