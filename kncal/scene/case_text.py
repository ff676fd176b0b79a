"""The text of a case file: where it is, read with care, its TOML parsed; and TOML written back."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

from kncal.core.checks import short
from kncal.core.errors import CaseFileError, ReadError
from kncal.core.files import read_limited
from kncal.core.shipped import folder
from kncal.scene.other_files import kind_of_file

CASE = "case.toml"
#: A case file larger than this is not read; 100 particles take about 20 kB, 4000 positions 200 kB.
MOST_BYTES = 256 * 1024
#: Tables or lists inside each other; no case file has more than five. Reading a.a.a... takes time by the square of it.
DEEPEST = 16

_KEY_PART = r"""(?:[A-Za-z0-9_-]++|"[^"\n]*+"|'[^'\n]*+')"""
_STRING_OR_COMMENT = re.compile(r"""("(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')|#[^\n]*+""")
_DEEP_KEY = re.compile(rf"(?<![A-Za-z0-9_.-]){_KEY_PART}(?:[ \t]*+\.[ \t]*+{_KEY_PART}){{{DEEPEST},}}")


class CaseText(NamedTuple):
    """A case file that was read: its text, the name of the case, and what to call the file in messages."""

    text: str
    name: str
    where: str


def shipped_cases() -> tuple[str, ...]:
    """Return the names of the cases that come with kncal, sorted."""
    return tuple(path.parent.name for path in sorted(folder("cases").glob(f"*/{CASE}")))


def find_case(case: str | Path) -> Path:
    """Return the file that ``case`` means: a file, a folder holding a case.toml, or a shipped case's name.

    What is there on disk comes before a shipped name. Raises `CaseFileError` if nothing fits, or if the file is a link
    that leads out of its folder: a stranger's case could so have a file of the user read, and shown in an error.
    """
    try:
        given = Path(case)
        found = next((path for path in (given, given / CASE) if path.is_file()), None)
        if found is not None:
            home, target = found.parent.resolve(), found.resolve()
            shipped_one = found.is_relative_to(folder("cases"))  # however it was installed
            if found.is_symlink() and not target.is_relative_to(home) and not shipped_one:
                raise CaseFileError(f"{found}: a link out of its folder; expected a file, so copy or name {target}")
            return found
    except CaseFileError:
        raise
    except TypeError:
        raise CaseFileError(f"case = {short(case)}: expected a name or a path as text") from None
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise CaseFileError(f"{short(str(case), 300)}: cannot be looked up: {why}") from error
    shipped = shipped_cases()
    if str(case) in shipped:
        return folder("cases") / str(case) / CASE
    import difflib

    near = difflib.get_close_matches(str(case)[:100], shipped, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise CaseFileError(
        f"{short(str(case), 300)}: no such case: expected a {CASE}, a folder with one, or one of "
        f"{', '.join(shipped)}{hint}"
    )


def read_case(case: str | Path, name: str | None = None) -> CaseText:
    """Return the text of a case file; ``name`` of the case, or else its folder's (for another file name: its stem).

    Raises
    ------
    CaseFileError
        If there is no such case, or the file is too large or not UTF-8 text.
    """
    path = find_case(case)
    try:
        data = read_limited(path, MOST_BYTES, "a case file of a few kilobytes")
    except ReadError as error:
        raise _no_case(str(path), "") or CaseFileError(str(error)) from error
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        if other := _no_case(str(path), data.decode("latin-1")):
            raise other from error
        line = data.count(b"\n", 0, error.start) + 1
        raise CaseFileError(f"{path}, line {line}: not UTF-8 text ({error.reason}): expected a TOML file") from error
    if other := _no_case(str(path), ""):  # some are valid TOML by chance
        raise other
    if name is None:
        name = path.resolve().parent.name if path.name == CASE else path.stem
    return CaseText(text, name, str(path))


def _no_case(where: str, text: str) -> CaseFileError | None:
    """Return the refusal of a file that is something else, if its name or its beginning tells what."""
    what = "" if where.endswith(".toml") else kind_of_file(where, text)
    if not what:
        return None
    return CaseFileError(
        f"{where}: {what}, it seems, not a case of kncal: expected a {CASE} (`kncal new wall_impact my_case` writes "
        "one to fill in)"
    )


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Return the tables of a TOML text; `CaseFileError` with file and line where it is none."""
    bare = _STRING_OR_COMMENT.sub(lambda found: '"s"' if found[1] else "", text)
    if deep := _DEEP_KEY.search(bare):
        line = bare.count("\n", 0, deep.start()) + 1
        raise CaseFileError(f"{where}, line {line}: {short(deep[0])}: expected keys of at most {DEEPEST} parts")
    try:
        tables = tomllib.loads(text)
        if _depth(tables) > DEEPEST:
            raise CaseFileError(f"{where}: tables or lists more than {DEEPEST} deep: expected at most five")
        return tables
    except CaseFileError:
        raise
    except tomllib.TOMLDecodeError as error:
        if other := _no_case(where, text):
            raise other from error
        found = re.search(r"at line (\d+)", str(error))
        lines = text.splitlines()
        number = int(found[1]) if found else len(lines)
        faulty = lines[number - 1].strip() if 0 < number <= len(lines) else ""
        shown = f": {short(faulty)}" if faulty and faulty.replace("\t", " ").isprintable() else ""
        hint = "expected TOML: text in double quotes, numbers without units, each key once"
        raise CaseFileError(f"{where}, line {number}{shown}: {str(error)[:100]}; {hint}") from error
    except (ValueError, RecursionError) as error:
        raise CaseFileError(f"{where}: {error}: expected TOML with plain numbers and short lists") from error


def _depth(tables: object) -> int:
    """Return how many tables and lists are inside each other, at most `DEEPEST` + 1."""
    deepest, rest = 0, [(tables, 1)]
    while rest and deepest <= DEEPEST:
        value, depth = rest.pop()
        inside = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        rest += [(item, depth + 1) for item in inside if isinstance(item, (dict, list))]
        deepest = max(deepest, depth)
    return deepest


def dump(thing: Any, skip: Collection[str] = ()) -> str:
    """Return the TOML of a frozen class of a scene: keys, then tables; without what is as if it were not given."""
    return "\n".join(_parts("", settings(thing, skip)))


def settings(thing: Any, skip: Collection[str] = ()) -> dict[str, Any]:
    """Return the fields of a class of a scene that are not None and differ from their defaults, by key."""
    given = {
        name: getattr(thing, name)
        for name, field in thing.__pydantic_fields__.items()
        if name not in skip
        and (field.is_required() or getattr(thing, name) != field.get_default(call_default_factory=True))
    }
    if given.get("measured") is not None:
        given = {"v_0": "measured"} | given
    return {name: value for name, value in given.items() if value is not None}


def _parts(path: str, values: Mapping[str, Any]) -> Iterator[str]:
    """The keys of a table, then the tables inside."""
    plain, inner, rows = {}, {}, {}
    for key, value in values.items():
        if is_dataclass(value):
            inner[key] = settings(value)
        elif isinstance(value, Mapping):
            inner[key] = {k: settings(v) if is_dataclass(v) else v for k, v in value.items()}
        elif isinstance(value, tuple) and value and is_dataclass(value[0]):
            rows[key] = [settings(row) for row in value]
        else:
            plain[key] = value
    tables_only = inner and not plain and not rows  # [materials] above [materials.glass] says nothing
    if not tables_only:
        yield table(f"[{path}]", plain) if path else entries(plain)
    for key, value in inner.items():
        yield from _parts(f"{path}.{toml_key(key)}" if path else toml_key(key), value)
    for key, value in rows.items():
        yield from (table(f"[[{path}.{key}]]", row) for row in value)


def table(header: str, values: Mapping[str, Any]) -> str:
    """Return a TOML table: its header and a line per value."""
    return f"{header}\n{entries(values)}"


def entries(values: Mapping[str, Any]) -> str:
    """Return ``key = value`` lines."""
    return "".join(f"{toml_key(key)} = {toml_value(value)}\n" for key, value in values.items())


def toml_key(key: str) -> str:
    """Return a key as TOML writes it, quoted where it must be."""
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else toml_value(key)


def toml_value(value: Any) -> str:
    """Return a value as TOML writes it; numbers so that they read back to the same bits."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{toml_key(key)} = {toml_value(v)}" for key, v in value.items()) + "}"
    return repr(value) if isinstance(value, int) else repr(float(value))
