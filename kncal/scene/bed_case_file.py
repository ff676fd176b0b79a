"""case.toml <-> BedScene, as `kncal.scene.case_file` for single contacts: what a user wrote is checked here, once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kncal.core.checks import short
from kncal.core.errors import CaseFileError, InputError
from kncal.scene.bed_scene import BedParticles, BedRun, BedScene, Column, Gas, Jet
from kncal.scene.case_text import contact_tables, entries, material_tables, parse_toml, read_case, settings, table

if TYPE_CHECKING:
    from kncal.scene.bed_schema import BedTable, GasTable


def load_bed(case: str | Path, *, name: str | None = None) -> BedScene:
    """Read the case file of a bed: a file, a folder with one, or a shipped case's name; see `kncal.load_case`.

    Raises
    ------
    CaseFileError
        If there is no such case, or it is not a valid bed: with file, line, key, value and what is expected.
    """
    text, name, where = read_case(case, name)
    return parse_bed(text, name=name, where=where)


def parse_bed(text: str, *, name: str, where: str = "case", tables: Mapping[str, Any] | None = None) -> BedScene:
    """Return the bed that the text of a case file describes; ``where`` stands for the file in messages.

    ``tables``: the tables of the text, where some values in them are not the text's.

    Raises
    ------
    CaseFileError
        If the text is not a valid bed, or ``name`` not a valid name.
    """
    from pydantic import ValidationError

    from kncal.scene.bed_case_checks import problems
    from kncal.scene.bed_schema import BedTable
    from kncal.scene.case_errors import fault, placed, refusal
    from kncal.scene.case_schema import NAME, NAME_EXPECTED

    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise CaseFileError(f"{where}: name of the case (its folder) = {short(name)}: {NAME_EXPECTED}")
    tables = parse_toml(text, where) if tables is None else tables
    try:
        case = BedTable.model_validate(tables)
    except ValidationError as error:
        raise refusal(where, text, [fault(e, tables, BedTable) for e in error.errors(include_url=False)]) from None
    if faults := problems(case):
        raise refusal(where, text, [placed(path, message) for path, message in faults])
    return _scene(case, name)


def _scene(case: BedTable, name: str) -> BedScene:
    from kncal.scene.case_checks import make_contact, make_materials

    materials = make_materials(case.materials)
    column, particles = case.column, case.particles
    return BedScene(
        name=name,
        title=case.title,
        source=case.source,
        column=Column(
            **column.model_dump(exclude={"cells", "wall_material"}),
            cells=(column.cells[0], column.cells[1], column.cells[2]),
            # "rigid" is no material's name (checked), so it gives None
            wall_material=materials.get(column.wall_material),
        ),
        particles=BedParticles(
            **particles.model_dump(exclude={"material", "positions"}),
            material=materials[particles.material],
            positions=tuple((x, y, z) for x, y, z in particles.positions),
        ),
        gas=None if case.gas is None else _gas(case.gas),
        gravity=case.gravity,
        contact=make_contact(case.contact),
        run=BedRun(**case.run.model_dump()),
        tolerances=dict(case.tolerances),
        overrules=dict(case.needs),
    )


def _gas(gas: GasTable) -> Gas:
    return Gas(
        **gas.model_dump(exclude={"ramp", "jet"}),
        ramp=tuple((time, velocity) for time, velocity in gas.ramp),
        jet=None if gas.jet is None else Jet(**gas.jet.model_dump()),
    )


def dump_bed(scene: BedScene) -> str:
    """Return the text of a case file that loads back to an equal bed (under the same name).

    Raises
    ------
    InputError
        If the bed cannot be written: two materials of one name, or something that no case file may say.
    """
    column, particles, gas = scene.column, scene.particles, scene.gas
    parts = [entries({"title": scene.title, "source": scene.source, "gravity": scene.gravity})]
    parts += material_tables((particles.material, column.wall_material), scene.name)
    wall = {} if column.wall_material is None else {"wall_material": column.wall_material.name}
    parts.append(table("[column]", settings(column, skip={"wall_material"}) | wall))
    first = {"count": particles.count, "diameter": particles.diameter, "material": particles.material.name}
    parts.append(table("[particles]", first | settings(particles, skip=first)))
    if gas is not None:
        parts.append(table("[gas]", settings(gas, skip={"jet"})))
        if gas.jet is not None:
            parts.append(table("[gas.jet]", settings(gas.jet)))
    parts += contact_tables(scene.contact)
    parts.append(table("[run]", settings(scene.run)))
    parts.append(table("[tolerances]", scene.tolerances) if scene.tolerances else "")
    parts.append(table("[needs]", scene.overrules) if scene.overrules else "")
    text = "\n".join(part for part in parts if part)
    try:
        back = parse_bed(text, name=scene.name, where=f"bed {scene.name!r}")
    except CaseFileError as error:
        raise InputError(f"the bed cannot be written as a case file: {error}") from error
    if back != scene:
        different = [f.name for f in fields(BedScene) if getattr(back, f.name) != getattr(scene, f.name)]
        raise InputError(
            f"bed {scene.name!r}: a case file cannot hold its {', '.join(different)} "
            "(a method beside a prescribed k_n, arrays as material data ...): expected consistent numbers"
        )
    return text
