"""What the values of a case file must satisfy together; checks yield (path of the key, what is wrong)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping

import numpy as np

from kncal.core.checks import one_of
from kncal.core.errors import InputError
from kncal.physics.material import Material
from kncal.scene.case_schema import MEASURED, CaseTable, ContactTable, MaterialTable, MeasuredTable
from kncal.scene.metrics import FEW_PARTICLES, METRICS, offered, split_metric
from kncal.scene.needs import OVERRULABLE
from kncal.scene.scene import AXES, ContactChoice, MeasuredSpeed, PairChoice

Path = tuple[str | int, ...]
Problem = tuple[Path, str]

#: What ``material = ...`` of a wall says for a rigid one; no material may have this name.
RIGID = "rigid"


def problems(case: CaseTable) -> list[Problem]:
    """Return everything that is wrong with a case file whose single values are of the right form."""
    return [problem for check in _CHECKS for problem in check(case)]


def make_materials(tables: Mapping[str, MaterialTable]) -> dict[str, Material]:
    """Return the materials by name; `InputError` for a value out of range."""
    return {name: Material(name=name, **dict(table)) for name, table in tables.items()}


def make_contact(table: ContactTable) -> ContactChoice:
    """Return what a ``[contact]`` table says."""
    values = table.model_dump(exclude={"options", "pairs", "method", "v_0", "measured"})
    if table.to_be_measured:
        table_of = table.measured or MeasuredTable.model_validate({})
        values["measured"] = MeasuredSpeed(**table_of.model_dump())
    if table.method is not None:
        values["method"] = table.method
    return ContactChoice(
        **values,
        v_0=None if table.to_be_measured else table.v_0,
        method_options=dict(table.options),
        pairs=tuple(
            PairChoice(between=(c.between[0], c.between[1]), **c.model_dump(exclude={"between"})) for c in table.pairs
        ),
    )


def material_problems(tables: Mapping[str, MaterialTable]) -> Iterator[Problem]:
    """Yield what is wrong with the ``[materials.NAME]`` of any kind of case."""
    for name, table in tables.items():
        if name == RIGID:
            yield ("materials", name), f"{RIGID!r} is the name for a rigid wall: expected another name"
        try:
            Material(name=name, **dict(table))
        except InputError as error:
            key = str(error).partition(" = ")[0]
            yield ("materials", name, key), str(error)


def _materials(case: CaseTable) -> Iterator[Problem]:
    yield from material_problems(case.materials)
    known = tuple(case.materials)
    for i, particle in enumerate(case.particles):
        yield from known_name(("particles", i, "material"), particle.material, known)
    for i, wall in enumerate(case.walls):
        yield from known_name(("walls", i, "material"), wall.material, (*known, RIGID))


def known_name(path: Path, value: str, allowed: Collection[str], label: str = "") -> Iterator[Problem]:
    """Yield a problem if ``value`` is not one of the ``allowed`` names."""
    try:
        one_of(label or str(path[-1]), value, allowed)
    except InputError as error:
        yield path, str(error)


def _names(case: CaseTable) -> Iterator[Problem]:
    # A pair exception may name a body or a material: a name that is both would be ambiguous.
    taken = {name: f"[materials.{name}]" for name in (*case.materials, RIGID)}
    bodies = [("particles", i, p.name) for i, p in enumerate(case.particles)]
    bodies += [("walls", i, w.name) for i, w in enumerate(case.walls)]
    for kind, i, name in bodies:
        if name in taken:
            yield (kind, i, "name"), f"name = {name!r} is taken by {taken[name]}: expected a name of its own"
        taken.setdefault(name, f"{kind}[{i}]")


def contact_problems(contact: ContactTable) -> Iterator[Problem]:
    """Yield what is wrong with the ``[contact]`` of any kind of case, but for the names in its exceptions."""
    from kncal.physics.laws import LAWS
    from kncal.physics.methods import METHODS

    yield from known_name(("contact", "law"), contact.law, LAWS)
    if contact.method is not None:
        yield from known_name(("contact", "method"), contact.method, METHODS)
    if contact.k_n is not None:
        for key, given in (("method", contact.method), ("options", contact.options)):
            if given:
                yield ("contact", key), "given together with k_n: expected one of the two"
    elif (method := contact.method or "mean_overlap") in METHODS:
        try:
            METHODS[method].options(contact.options)
        except InputError as error:
            yield ("contact", "options"), str(error)
    measured = contact.to_be_measured
    if contact.measured is not None and not measured:
        yield ("contact", "measured"), f'given without v_0 = "{MEASURED}": expected both or none of them'
    if measured and contact.k_n is not None:
        yield ("contact", "k_n"), f'given together with v_0 = "{MEASURED}": expected one of the two'
    if contact.law == "hertz":
        for path, e_n in [
            (("contact", "e_n"), contact.e_n),
            *((("contact", "pairs", i, "e_n"), choice.e_n) for i, choice in enumerate(contact.pairs)),
        ]:
            if e_n not in (None, 1.0):
                yield (
                    path,
                    f'e_n = {e_n:g} with law "hertz", which has no damping: expected 1, or law = "tsuji"',
                )


def _contact(case: CaseTable) -> Iterator[Problem]:
    return contact_problems(case.contact)


def _pairs(case: CaseTable) -> Iterator[Problem]:
    spheres = [{p.name, p.material} for p in case.particles]
    walls = [{w.name, w.material} for w in case.walls]
    known = sorted(set().union(*spheres, *walls))
    for i, choice in enumerate(case.contact.pairs):
        path: Path = ("contact", "pairs", i)
        unknown = [name for name in choice.between if name not in known]
        for name in unknown:
            yield from known_name((*path, "between"), name, known)
        if choice.e_n is choice.friction is choice.v_0 is choice.k_n is None:
            yield path, "changes nothing: expected at least one of e_n, friction, v_0, k_n"
        one, two = choice.between
        meet = any(
            (one in a and two in b) or (two in a and one in b)
            for k, a in enumerate(spheres)
            for b in (*spheres[k + 1 :], *walls)
        )
        if not unknown and not meet:
            yield (
                (*path, "between"),
                f"between = {choice.between!r}: expected names of two bodies that can touch "
                "(two particles, or a particle and a wall), or of their materials",
            )


def _run(case: CaseTable) -> Iterator[Problem]:
    given = [key for key in ("until_time", "until_bounces") if getattr(case.run, key) is not None]
    if len(given) != 1:
        found = "both are given" if given else "neither is given"
        yield (
            ("run", *given[1:]),
            f"{found}: expected exactly one of until_time [s] and until_bounces (number of contacts)",
        )


def _geometry(case: CaseTable) -> Iterator[Problem]:
    if len(case.particles) == 1 and not case.walls:
        yield (
            ("particles",),
            "a single particle and no wall: nothing can touch, so there is no contact to calibrate: expected a second "
            "particle or a wall",
        )
    centres = np.array([p.position for p in case.particles], dtype=np.float64)
    radii = np.array([p.diameter / 2.0 for p in case.particles])
    planes = [(w.axis, w.position) for w in case.walls]
    for i, wall in enumerate(case.walls):
        if planes[i] in planes[:i]:
            twin = case.walls[planes.index(planes[i])].name
            yield ("walls", i, "position"), f"the same plane as wall {twin!r}: expected another plane"
        distances = np.abs(centres[:, AXES.index(wall.axis)] - wall.position)
        for k in np.flatnonzero(distances == 0.0):
            yield (
                ("particles", int(k), "position"),
                f"position = {case.particles[int(k)].position}: the centre lies on the plane of wall {wall.name!r}: "
                "expected it on one side of the wall",
            )
    for i in range(len(radii) - 1):
        overlaps = radii[i] + radii[i + 1 :] - np.linalg.norm(centres[i + 1 :] - centres[i], axis=1)
        smaller = np.minimum(radii[i], radii[i + 1 :])
        for k in np.flatnonzero(overlaps >= smaller):
            other = i + 1 + int(k)
            yield (
                ("particles", other, "position"),
                f"position = {case.particles[other].position}: overlaps {case.particles[i].name!r} by "
                f"{overlaps[k]:.6g} m: expected less than the smaller radius, {smaller[k]:g} m",
            )


def _tolerances(case: CaseTable) -> Iterator[Problem]:
    return tolerance_problems(case.tolerances, FEW_PARTICLES)


def tolerance_problems(tolerances: Collection[str], recorded: Collection[str]) -> Iterator[Problem]:
    """Yield what is wrong with the names in ``[tolerances]`` of a case whose runs record ``recorded``."""
    offer = offered(recorded)
    for name in tolerances:
        base, contact = split_metric(name)
        if not (base in offer and METRICS[base].each and contact in range(2, 100) and name == f"{base}_{contact}"):
            yield from known_name(("tolerances", name), name, offer, "metric")


def _needs(case: CaseTable) -> Iterator[Problem]:
    return needs_problems(case.needs)


def needs_problems(needs: Collection[str]) -> Iterator[Problem]:
    """Yield what is wrong with the ``[needs]`` of any kind of case."""
    for name in needs:
        yield from known_name(("needs", name), name, OVERRULABLE, "physics")


_CHECKS: tuple[Callable[[CaseTable], Iterator[Problem]], ...] = (
    _materials, _names, _contact, _pairs, _run, _geometry, _tolerances, _needs,
)  # fmt: skip
