"""case.toml <-> Scene: the only place that validates what a user wrote; deeper code trusts the scene.

A refusal names the file, the line where it can, the key, the value and what is expected; all faults at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kncal.core.checks import short
from kncal.core.errors import CaseFileError, InputError
from kncal.scene.bed_scene import BedScene
from kncal.scene.case_text import (
    CASE,
    MOST_BYTES,
    contact_tables,
    entries,
    find_case,
    is_bed,
    material_tables,
    parse_toml,
    read_case,
    settings,
    shipped_cases,
    table,
)
from kncal.scene.scene import Particle, RunControl, Scene, Wall

if TYPE_CHECKING:
    from kncal.scene.case_schema import CaseTable

__all__ = [
    "CASE",
    "MOST_BYTES",
    "dump_case",
    "find_case",
    "load_case",
    "load_scene",
    "parse_case",
    "shipped_cases",
]


def load_case(case: str | Path, *, name: str | None = None, overrides: Sequence[str] = ()) -> Scene | BedScene:
    """Read a case file: a `BedScene` if it has a ``[column]``, else a `Scene`.

    Parameters
    ----------
    case : str or Path
        A case.toml, a folder holding one, or the name of a shipped case.
    name : str, optional
        The scene's name; without it, the folder's name (for a file not called case.toml: its stem).
    overrides : sequence of str
        ``KEY=VALUE``, each in place of what the file says (see `kncal.scene.overrides`), e.g. ``run.end_time=0.2``.

    Raises
    ------
    CaseFileError
        If there is no such case, or it is not valid: with file, line, key, value and what is expected.
    InputError
        If an override is not of its form.
    """
    text, name, where = read_case(case, name)
    tables = parse_toml(text, where)
    from kncal.scene.overrides import overridden, parse_overrides

    changes = parse_overrides(overrides)
    if not changes:
        return _parse(text, tables, name, where)
    try:
        return _parse(text, overridden(tables, changes), name, where)
    except CaseFileError as error:
        raise CaseFileError(f"{error}\n(with {', '.join(map(str, changes))} from outside the file)") from error


def _parse(text: str, tables: Mapping[str, Any], name: str, where: str) -> Scene | BedScene:
    if is_bed(tables):
        from kncal.scene.bed_case_file import parse_bed

        return parse_bed(text, name=name, where=where, tables=tables)
    return parse_case(text, name=name, where=where, tables=tables)


def load_scene(case: str | Path, *, name: str | None = None, overrides: Sequence[str] = ()) -> Scene:
    """Read a case of single contacts, as `load_case` does; a bed is refused with `CaseFileError`."""
    scene = load_case(case, name=name, overrides=overrides)
    if isinstance(scene, BedScene):
        raise CaseFileError(
            f"{case}: a bed, with a [column] of gas and particles: expected a case of single contacts, one of "
            f"{', '.join(shipped_cases(beds=False))} or your own"
        )
    return scene


def parse_case(text: str, *, name: str, where: str = "case", tables: Mapping[str, Any] | None = None) -> Scene:
    """Return the scene that the text of a case file describes; ``where`` stands for the file in messages.

    ``tables``: the tables of the text, where some values in them are not the text's.

    Raises
    ------
    CaseFileError
        If the text is not a valid case, or ``name`` not a valid name.
    """
    from pydantic import ValidationError

    from kncal.scene.case_checks import problems
    from kncal.scene.case_errors import fault, placed, refusal
    from kncal.scene.case_schema import NAME, NAME_EXPECTED, CaseTable

    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise CaseFileError(f"{where}: name of the case (its folder) = {short(name)}: {NAME_EXPECTED}")
    tables = parse_toml(text, where) if tables is None else tables
    try:
        case = CaseTable.model_validate(tables)
    except ValidationError as error:
        raise refusal(where, text, [fault(e, tables) for e in error.errors(include_url=False)]) from None
    if faults := problems(case):
        raise refusal(where, text, [placed(path, message) for path, message in faults])
    return _scene(case, name)


def _scene(case: CaseTable, name: str) -> Scene:
    from kncal.scene.case_checks import make_contact, make_materials

    materials = make_materials(case.materials)
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
        contact=make_contact(case.contact),
        run=RunControl(**case.run.model_dump()),
        tolerances=dict(case.tolerances),
        overrules=dict(case.needs),
    )


def _vector(numbers: list[float]) -> tuple[float, float, float]:
    x, y, z = numbers
    return x, y, z


def dump_case(scene: Scene | BedScene) -> str:
    """Return the text of a case file that loads back to an equal scene (under the same name).

    Raises
    ------
    InputError
        If the scene cannot be written: two materials of one name, or something that no case file may say.
    """
    if isinstance(scene, BedScene):
        from kncal.scene.bed_case_file import dump_bed

        return dump_bed(scene)
    parts = [entries({"title": scene.title, "source": scene.source, "gravity": scene.gravity})]
    parts += material_tables((body.material for body in scene.bodies), scene.name)
    for p in scene.particles:
        values = settings(p, skip={"material", "radius"})
        values = {
            "name": values.pop("name"),
            "material": p.material.name,
            "diameter": 2.0 * p.radius,
            **values,
        }
        parts.append(table("[[particles]]", values))
    for w in scene.walls:
        values = settings(w, skip={"material"}) | {"material": "rigid" if w.material is None else w.material.name}
        parts.append(table("[[walls]]", values))
    parts += contact_tables(scene.contact)
    parts.append(table("[run]", settings(scene.run)))
    parts.append(table("[tolerances]", scene.tolerances) if scene.tolerances else "")
    parts.append(table("[needs]", scene.overrules) if scene.overrules else "")
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
