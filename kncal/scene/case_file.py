"""case.toml <-> Scene: the only place that validates what a user wrote; deeper code trusts the scene.

A refusal names the file, the line where it can, the key, the value and what is expected; all faults at once.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any, TypeGuard

from pydantic import TypeAdapter, ValidationError

from kncal.core.checks import short
from kncal.core.errors import CaseFileError, InputError
from kncal.core.files import read_limited, replacing, sha256, write_text
from kncal.scene.case_checks import problems
from kncal.scene.case_errors import Fault, fault, placed, refusal
from kncal.scene.case_text import CASE, MOST_BYTES, dump, find_case, parse_toml, read_case, shipped_cases
from kncal.scene.overrides import overridden, parse_overrides
from kncal.scene.scene import FILES, Scene
from kncal.scene.values import NAME, NAME_EXPECTED

__all__ = [
    "CASE", "FILES", "MOST_BYTES", "copy_files", "dump_case", "find_case", "identity_text", "kept_identity",
    "load_case", "parse_case", "shipped_cases", "write_case",
]  # fmt: skip

#: What ``contact.v_0`` says where the speed is to be measured.
MEASURED = "measured"


def load_case(case: str | Path, *, name: str | None = None, overrides: Sequence[str] = ()) -> Scene:
    """Read a case file.

    Parameters
    ----------
    case : str or Path
        A case.toml, a folder holding one, or the name of a shipped case.
    name : str, optional
        The scene's name; without it, the folder's name (for a file not called case.toml: its stem).
    overrides : sequence of str
        ``KEY=VALUE``, each in place of what the file says (see `kncal.scene.overrides`), e.g. ``run.until_time=0.2``.

    Raises
    ------
    CaseFileError
        If there is no such case, or it is not valid: with file, line, key, value and what is expected.
    InputError
        If an override is not of its form.
    """
    text, name, where = read_case(case, name)
    tables, home = parse_toml(text, where), Path(where).parent
    changes = parse_overrides(overrides)
    if not changes:
        return parse_case(text, name=name, where=where, tables=tables, folder=home)
    refuse_old(tables, where)
    try:
        return parse_case(text, name=name, where=where, tables=overridden(tables, changes), folder=home)
    except CaseFileError as error:
        raise CaseFileError(f"{error}\n(with {', '.join(map(str, changes))} from outside the file)") from error


def parse_case(
    text: str,
    *,
    name: str,
    where: str = "case",
    tables: Mapping[str, Any] | None = None,
    folder: Path | None = None,
) -> Scene:
    """Return the scene that the text of a case file describes; ``where`` stands for the file in messages.

    ``tables``: the tables of the text, where some values in them are not the text's; ``folder``: where the files lie
    that the case names.

    Raises
    ------
    CaseFileError
        If the text is not a valid case, or ``name`` not a valid name.
    """
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise CaseFileError(f"{where}: name of the case (its folder) = {short(name)}: {NAME_EXPECTED}")
    tables = parse_toml(text, where) if tables is None else tables
    refuse_old(tables, where)
    given, faults = _contact(tables)
    for key in ("name", "folder"):
        if key in tables:
            faults.append(((key,), f"{key}: unknown key: the name of a case is that of its folder: leave it out"))
    try:
        scene: Scene = _adapter().validate_python({**given, "name": name, "folder": folder})
    except ValidationError as error:
        found = [fault(e, tables) for e in error.errors(include_url=False)]
        # one of each key: of a choice of kinds, and of a vector, pydantic tells several
        raise refusal(
            where, text, faults + list({path: (path, told) for path, told in reversed(found)}.values())
        ) from None
    if found := faults + [placed(path, message) for path, message in problems(scene)]:
        raise refusal(where, text, found)
    return scene


@cache
def _adapter() -> TypeAdapter[Scene]:
    return TypeAdapter(Scene)


def _contact(tables: Mapping[str, Any]) -> tuple[dict[str, Any], list[Fault]]:
    """Return the tables with ``v_0 = "measured"`` as the table that it stands for, and what contradicts another key."""
    contact, faults = tables.get("contact"), []
    if not isinstance(contact, Mapping):
        return dict(tables), []
    if "method" in contact and "k_n" in contact:
        faults.append(placed(("contact", "method"), "given together with k_n: expected one of the two"))
    if contact.get("v_0") == MEASURED:
        contact = {"measured": {}} | {key: value for key, value in contact.items() if key != "v_0"}
    elif "measured" in contact:
        faults.append(
            placed(("contact", "measured"), f'given without v_0 = "{MEASURED}": expected both or none of them')
        )
    return {**tables, "contact": contact}, faults


def refuse_old(tables: Mapping[str, Any], where: str) -> None:
    """Raise `CaseFileError` for a case file as kncal 0.1 had it, with the new spelling of what was found."""
    found = list(_old(tables))
    if found:
        raise CaseFileError(
            f"{where}: a case file of kncal 0.1, which this version does not read: write {'; '.join(found)} "
            "(the page on case files, docs/case-file.md, tells all of it)"
        )


def _old(tables: Mapping[str, Any]) -> Iterator[str]:
    for kind in ("particles", "walls"):
        table = tables.get(kind)
        if isinstance(table, list):
            yield f"[{kind}.NAME] in place of [[{kind}]] with name"
    if _is_number(_inside(tables, "particles", "diameter")):
        yield "[particles.beads] in place of [particles], with place in place of packing"
    if "column" in tables:
        yield (
            '[walls.column] with shape = "box", size = [width, depth, height] and material in place of [column], with '
            'gas.cells and gas.walls, and periodic = ["y"] or layer = "y" in place of front_back'
        )
    if _inside(tables, "run", "end_time") is not None:
        yield "run.until_time in place of run.end_time"
    gravity = tables.get("gravity")
    if _is_number(gravity) and 0.0 < gravity <= 1e5:
        yield f"gravity = [0.0, 0.0, {-float(gravity)}] in place of {gravity}"


def _inside(tables: Mapping[str, Any], table: str, key: str) -> Any:
    return inside.get(key) if isinstance(inside := tables.get(table), Mapping) else None


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def dump_case(scene: Scene) -> str:
    """Return the text of a case file that loads back to an equal scene (under the same name).

    Raises
    ------
    InputError
        If the scene holds something that no case file may say.
    """
    text = dump(scene, skip={"name", "folder"})
    if (size := len(text.encode())) > MOST_BYTES:
        raise InputError(f"scene {scene.name!r}: {size} bytes as a case file: expected at most {MOST_BYTES}")
    try:
        back = parse_case(text, name=scene.name, where=f"scene {scene.name!r}", folder=scene.folder)
    except CaseFileError as error:
        raise InputError(f"the scene cannot be written as a case file: {error}") from error
    if back != scene:
        different = [f.name for f in fields(Scene) if getattr(back, f.name) != getattr(scene, f.name)]
        raise InputError(
            f"scene {scene.name!r}: a case file cannot hold its {', '.join(different)}: expected consistent numbers"
        )
    return text


def write_case(scene: Scene, path: Path) -> None:
    """Write the case file ``path``, whose folder exists, and copies of the files that it names.

    Raises
    ------
    InputError, CaseFileError
        As `dump_case`, or if a file is missing.
    """
    write_text(path, dump_case(scene))
    copy_files(scene, path.parent)


def copy_files(scene: Scene, folder: Path) -> None:
    """Copy the files that a case names to where a case file in ``folder`` finds them."""
    for name in scene.files:
        source, target = scene.path_of(name), folder / FILES / name
        if source == target.resolve():
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        with replacing(target) as file, source.open("rb") as given:
            shutil.copyfileobj(given, file)


def identity_text(scene: Scene) -> str:
    """Return a text that two scenes share only if their case files, and the files that these name, are equal."""
    return _identity(dump_case(scene), {name: scene.path_of(name) for name in scene.files})


def kept_identity(folder: Path) -> str:
    """Return the `identity_text` of a case that was written into ``folder``; `ReadError` if it cannot be read."""
    text = read_limited(folder / CASE, MOST_BYTES, "a case file").decode("utf-8")
    there = (path for path in (folder / FILES).rglob("*") if path.is_file())
    return _identity(text, {path.relative_to(folder / FILES).as_posix(): path for path in there})


def _identity(text: str, files: Mapping[str, Path]) -> str:
    return text + "".join(f"# {name}: {sha256(files[name])}\n" for name in sorted(files))
