"""case.toml <-> Scene: the only place that validates what a user wrote; deeper code trusts the scene.

A refusal names the file, the line where it can, the key, the value and what is expected; all faults at once.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kncal.errors import CaseFileError, InputError
from kncal.material import Material
from kncal.resources import folder
from kncal.scene import ContactChoice, PairChoice, Particle, RunControl, Scene, Wall

if TYPE_CHECKING:
    from kncal.case_schema import CaseTable

CASE = "case.toml"
#: A case file larger than this is not read; 500 particles take about 100 kB.
MOST_BYTES = 256 * 1024


def shipped_cases() -> tuple[str, ...]:
    """Return the names of the cases that come with kncal, sorted."""
    return tuple(sorted(path.parent.name for path in folder("cases").glob(f"*/{CASE}")))


def find_case(case: str | Path) -> Path:
    """Return the file that ``case`` means: a file, a folder holding a case.toml, or a shipped case's name.

    What is there on disk comes before a shipped name. Raises `CaseFileError` if nothing fits.
    """
    given = Path(case)
    try:
        if given.is_file():
            return given
        if (given / CASE).is_file():
            return given / CASE
    except (OSError, ValueError) as error:
        raise CaseFileError(f"{str(case)!r}: cannot be looked up: {error}") from error
    shipped = shipped_cases()
    if str(case) in shipped:
        return folder("cases") / str(case) / CASE
    import difflib

    near = difflib.get_close_matches(str(case), shipped, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise CaseFileError(
        f"{str(case)!r}: no such case: expected a {CASE}, a folder with one, or one of {', '.join(shipped)}{hint}"
    )


def load_case(case: str | Path, *, name: str | None = None) -> Scene:
    """Read a case file.

    Parameters
    ----------
    case : str or Path
        A case.toml, a folder holding one, or the name of a shipped case.
    name : str, optional
        The scene's name; without it, the folder's name (for a file not called case.toml: its stem).

    Raises
    ------
    CaseFileError
        If there is no such case, or it is not valid: with file, line, key, value and what is expected.
    """
    path = find_case(case)
    try:
        with path.open("rb") as handle:
            data = handle.read(MOST_BYTES + 1)
    except OSError as error:
        raise CaseFileError(f"{path}: cannot be read: {error}") from error
    if len(data) > MOST_BYTES:
        raise CaseFileError(f"{path}: larger than {MOST_BYTES} bytes: expected a case file of a few kilobytes")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise CaseFileError(f"{path}, line {line}: not UTF-8 text ({error.reason}): expected a TOML file") from error
    if name is None:
        name = path.resolve().parent.name if path.name == CASE else path.stem
    return parse_case(text, name=name, where=str(path))


def parse_case(text: str, *, name: str, where: str = "case") -> Scene:
    """Return the scene that the text of a case file describes; ``where`` stands for the file in messages.

    Raises
    ------
    CaseFileError
        If the text is not a valid case, or ``name`` not a valid name.
    """
    from pydantic import ValidationError

    from kncal.case_checks import problems
    from kncal.case_messages import fault, placed, refusal, short
    from kncal.case_schema import NAME, NAME_EXPECTED, CaseTable

    if not NAME.fullmatch(name):
        raise CaseFileError(f"{where}: name of the case (its folder) = {short(name)}: {NAME_EXPECTED}")
    table = _parse_toml(text, where)
    try:
        case = CaseTable.model_validate(table)
    except ValidationError as error:
        raise refusal(where, text, [fault(e) for e in error.errors(include_url=False)]) from None
    if faults := problems(case):
        raise refusal(where, text, [placed(path, message) for path, message in faults])
    return _scene(case, name)


def _parse_toml(text: str, where: str) -> dict[str, Any]:
    from kncal.case_messages import short

    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        found = re.search(r"at line (\d+)", str(error))
        lines = text.splitlines()
        number = int(found[1]) if found else len(lines)
        shown = f": {short(lines[number - 1].strip())}" if 0 < number <= len(lines) else ""
        hint = "expected TOML: text in double quotes, numbers without units, each key once"
        raise CaseFileError(f"{where}, line {number}{shown}: {error}; {hint}") from error
    except (ValueError, RecursionError) as error:
        raise CaseFileError(f"{where}: {error}: expected TOML with plain numbers and short lists") from error


def _scene(case: CaseTable, name: str) -> Scene:
    from kncal.case_checks import make_materials

    materials = make_materials(case)
    contact = case.contact.model_dump(exclude={"options", "pairs", "method"})
    if case.contact.method is not None:
        contact["method"] = case.contact.method
    return Scene(
        name=name,
        title=case.title,
        source=case.source,
        particles=tuple(
            Particle(
                name=p.name,
                material=materials[p.material],
                radius=p.diameter / 2.0,
                position=_vector(p.position),
                velocity=_vector(p.velocity),
                spin=_vector(p.spin),
            )
            for p in case.particles
        ),
        walls=tuple(
            # "rigid" is no material's name (checked), so it gives None
            Wall(name=w.name, axis=w.axis, position=w.position, material=materials.get(w.material))
            for w in case.walls
        ),
        gravity=_vector(case.gravity),
        contact=ContactChoice(
            **contact,
            method_options=dict(case.contact.options),
            pairs=tuple(
                PairChoice(between=(c.between[0], c.between[1]), **c.model_dump(exclude={"between"}))
                for c in case.contact.pairs
            ),
        ),
        run=RunControl(**case.run.model_dump()),
        tolerances=dict(case.tolerances),
        overrules=dict(case.needs),
    )


def _vector(numbers: list[float]) -> tuple[float, float, float]:
    x, y, z = numbers
    return x, y, z


def dump_case(scene: Scene) -> str:
    """Return the text of a case file that loads back to an equal scene (under the same name).

    Raises
    ------
    InputError
        If the scene cannot be written: two materials of one name, or something that no case file may say.
    """
    parts = [_entries({"title": scene.title, "source": scene.source, "gravity": scene.gravity})]
    for material in _materials(scene).values():
        parts.append(_table(f"[materials.{_key(material.name)}]", _settings(material, skip={"name"})))
    for p in scene.particles:
        settings = _settings(p, skip={"material", "radius"})
        settings = {
            "name": settings.pop("name"),
            "material": p.material.name,
            "diameter": 2.0 * p.radius,
            **settings,
        }
        parts.append(_table("[[particles]]", settings))
    for w in scene.walls:
        settings = _settings(w, skip={"material"}) | {"material": "rigid" if w.material is None else w.material.name}
        parts.append(_table("[[walls]]", settings))
    contact = scene.contact
    settings = {"law": contact.law, "e_n": contact.e_n, "end": contact.end}
    if contact.k_n is None:
        settings["method"] = contact.method
    parts.append(_table("[contact]", settings | _settings(contact, skip={"method_options", "pairs"} | {*settings})))
    parts.append(_table("[contact.options]", contact.method_options) if contact.method_options else "")
    parts += [_table("[[contact.pairs]]", _settings(choice)) for choice in contact.pairs]
    parts.append(_table("[run]", _settings(scene.run)))
    parts.append(_table("[tolerances]", scene.tolerances) if scene.tolerances else "")
    parts.append(_table("[needs]", scene.overrules) if scene.overrules else "")
    text = "\n".join(part for part in parts if part)
    try:
        back = parse_case(text, name=scene.name, where=f"scene {scene.name!r}")
    except CaseFileError as error:
        raise InputError(f"the scene cannot be written as a case file: {error}") from error
    if back != scene:
        different = [f.name for f in fields(Scene) if getattr(back, f.name) != getattr(scene, f.name)]
        raise InputError(
            f"scene {scene.name!r}: a case file cannot hold its {', '.join(different)} "
            "(a method beside a prescribed k_n, arrays as material data ...): expected consistent numbers"
        )
    return text


def _materials(scene: Scene) -> dict[str, Material]:
    found: dict[str, Material] = {}
    for body in scene.bodies:
        if body.material is not None and found.setdefault(body.material.name, body.material) != body.material:
            raise InputError(
                f"scene {scene.name!r}: two different materials are called {body.material.name!r}: "
                "expected a name for each"
            )
    return found


def _settings(thing: Any, skip: Iterable[str] = ()) -> dict[str, Any]:
    """The fields of a dataclass that are not None and differ from their defaults."""
    values = {f.name: (getattr(thing, f.name), f.default) for f in fields(thing) if f.name not in set(skip)}
    return {
        name: value
        for name, (value, default) in values.items()
        if value is not None and (default is MISSING or value != default)
    }


def _table(header: str, settings: Mapping[str, Any]) -> str:
    return f"{header}\n{_entries(settings)}"


def _entries(settings: Mapping[str, Any]) -> str:
    return "".join(f"{_key(key)} = {_value(value)}\n" for key, value in settings.items())


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _value(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(map(_value, value))}]"
    return repr(value) if isinstance(value, int) else repr(float(value))
