"""Refusals of a case file: from a finding to a line that says file, line, key, value and what is expected."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from kncal.core.checks import nearest, short
from kncal.core.errors import CaseFileError
from kncal.scene.case_schema import CaseTable, Root, description, table_at

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

#: A refusal lists at most this many faults.
MOST_FAULTS = 10

KeyPath = tuple[str | int, ...]
Fault = tuple[KeyPath, str]


BARE = re.compile(r"[A-Za-z0-9_-]+")
_PART = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')"""
_KEYS = rf"{_PART}(?:\s*\.\s*{_PART})*"
_LINE = re.compile(rf"\s*(?:\[\[\s*(?P<many>{_KEYS})\s*\]\]|\[\s*(?P<one>{_KEYS})\s*\]|(?P<key>{_KEYS})\s*=)")


def fault(error: ErrorDetails, tables: Mapping[str, Any], root: type[Root] = CaseTable) -> Fault:
    """Turn one of pydantic's findings in ``tables``, of a file of the form ``root``, into (path, message)."""
    path = tuple(part for part in error["loc"] if part not in ("float", "str", "function-after[_option(), float]"))
    kind, meaning = error["type"], description(path, root)
    value = f"{_shown(path)} = {short(error['input'])}"
    about = f" for the {meaning}" if meaning else ""
    if kind == "extra_forbidden":
        return path, f"{_shown(path)}: unknown key: {_instead(str(path[-1]), table_at(path, root).model_fields)}"
    if kind == "missing":
        return path, f"{_shown(path)}: missing: expected {meaning}"
    if path and path[-1] == "[key]":
        return path[:-1], f"{_shown(path[:-2])}: key {short(path[-2])}: {_cause(error)}"
    if kind in _LENGTH:
        # how many are too many says enough
        about = about if kind == "too_short" else ""
        return path, f"{value}: {error['ctx']['actual_length']} entries{about}: {_LENGTH[kind].format(**error['ctx'])}"
    if kind in _EXPECTED:
        return path, f"{value}: expected {_EXPECTED[kind]}{about}"
    remedy = f"; {_no_rebound(tables)}" if path and path[-1] == "e_n" and error["input"] == 0 else ""
    return path, f"{value}: {_cause(error)}{remedy}"


def _no_rebound(tables: Mapping[str, Any]) -> str:
    """What to do about e_n = 0 at the step of the case, as far as what it says of it is valid."""
    from kncal.physics.laws import LAWS
    from kncal.physics.timestep import USUAL_STEPS, instead_of_zero

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
}


def _cause(error: ErrorDetails) -> str:
    """The "expected ..." part of a message of our own, or what pydantic says."""
    if error["type"] == "literal_error":
        return _instead(str(error["input"]), re.findall(r"'([^']*)'", str(error.get("ctx", {}).get("expected", ""))))
    text = str(error.get("ctx", {}).get("error", error["msg"]))
    head, found, rest = text.partition("expected ")
    return found + rest if found else head[:1].lower() + head[1:]


def placed(path: KeyPath, message: str) -> Fault:
    """Prefix a message with its path; one that begins with the key (``e_n = 2: ...``) has half of it."""
    key = str(path[-1])
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
        keys = [part.strip("\"'") for part in re.findall(_PART, match["many"] or match["one"] or match["key"])]
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
