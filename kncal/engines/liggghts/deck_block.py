"""The contact lines of a LIGGGHTS deck, to paste into a deck of one's own: properties, pair style, time step, walls."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import cast

from kncal.core.checks import in_range, instance, one_of, plain_name, single
from kncal.core.errors import CaseFileError, InputError, RenderError, ValidityError
from kncal.core.templating import number
from kncal.engines.liggghts.deck import (
    HARD_LIMIT,
    LEAST_VELOCITY,
    RIGID,
    SOFT_LIMIT,
    hooke_stiffness,
    spring_restitution,
    tsuji_restitution,
)
from kncal.engines.liggghts.deck_checks import ROUNDING, expect, require_tsuji
from kncal.physics.material import Material
from kncal.physics.matrix import PairMatrix
from kncal.physics.timestep import usual_steps
from kncal.scene.bed_planning import PARTICLES, WALLS, bed_pairs
from kncal.scene.bed_scene import BedScene
from kncal.scene.load import bottom_load
from kncal.scene.model import PairContact
from kncal.scene.pair_contact import PairNumbers, Rest, numbers_of, pair_contact
from kncal.scene.plan import contact_of, first_impact_speed
from kncal.scene.scene import ContactChoice, Scene, Wall
from kncal.scene.species import species_of

#: Normal models of LIGGGHTS, and the kind of `PairContact` that each is made from.
STYLES: Mapping[str, str] = {"hooke/stiffness": "linear", "hooke": "linear", "hertz": "hertz"}
#: k_t/k_n that LIGGGHTS' hooke model can have -> its switch.
_HOOKE_RATIOS = {1.0: "", 2.0 / 7.0: "ktToKnUser on"}
#: How near to such a ratio is that ratio: 2/7 is often written with four digits.
_FEW_DIGITS = 1e-3

Contacts = Mapping[tuple[str, str], PairContact]
Columns = dict[str, dict[tuple[str, str], float]]


@dataclass(frozen=True, kw_only=True)
class BlockType:
    """An atom type of the block: ``material`` is None for a rigid wall."""

    name: str
    material: Material | None
    is_wall: bool = False


def liggghts_block(
    types: Sequence[BlockType], contacts: Contacts, style: str = "hooke/stiffness", steps_per_contact: float = 50.0
) -> str:
    """Return deck lines that give every pair of types its contact in LIGGGHTS 3.8.0, numbers with all their digits.

    Parameters
    ----------
    types : the atom types 1, 2, ... of the deck
    contacts : (name, name) of two types, in any order -> its contact. All of the kind ("linear" or "hertz") that
        ``STYLES`` names for the style. Two walls never touch; of other pairs without a contact the block says so
    style : normal model: "hooke/stiffness", "hooke" (LIGGGHTS finds k_n by strain energy itself) or "hertz"
    steps_per_contact : N of the block's time step, N steps in its shortest contact

    Raises
    ------
    InputError
        For another style, or a name that could be a command.
    RenderError
        If there is no contact, a number is out of its range, or LIGGGHTS would make another contact of these.
    """
    one_of("style", style, STYLES)
    n = float(in_range("steps_per_contact", single("steps_per_contact", steps_per_contact), 1.0, 1e7))
    names = [plain_name("name of a type", t.name) for t in types]
    table = _checked(types, contacts, STYLES[style])
    ends = {c.end for c in table.values()}
    expect(len(ends) == 1, style, f"contacts end at {' and '.join(sorted(ends))}", "one contact end for all pairs")
    force_end = ends == {"force"}
    columns = _COLUMNS[style](table)
    columns["coefficientFriction"] = {pair: c.friction for pair, c in table.items()}
    rolling = any(c.rolling_friction > 0.0 for c in table.values())
    if rolling:
        columns["coefficientRollingFriction"] = {pair: c.rolling_friction for pair, c in table.items()}
    selectors = f"{style} tangential history" + (" rolling_friction cdt" if rolling else "")
    words = ("limitForce on" if force_end else "", _hooke_switch(style, table), "tangential_damping off")
    switches = " ".join(filter(None, words))
    shortest = min(c.t_c for c in table.values())
    size = len(names)
    lines = [
        f'# Contacts for LIGGGHTS 3.8.0, by kncal: paste after "create_box {size} ..." and before the walls of a deck',
        '# with "units si", "newton off" and "communicate single vel yes".',
        f"# atom types: {', '.join(f'{i} = {name}' for i, name in enumerate(names, 1))}",
        *_lacking(types, table),
        *(_elastic(types) if style != "hooke/stiffness" else []),
        *(_property("characteristicVelocity", "scalar", [_velocity(table)]) if style == "hooke" else []),
    ]
    for name, column in columns.items():
        lines += _property(name, f"peratomtypepair {size}", _matrix(names, column))
    lines += [
        f"# limitForce {'on' if force_end else 'off'}: the contact ends at zero {'force' if force_end else 'overlap'}",
        f"pair_style gran model {selectors} {switches}",
        "pair_coeff * *",
        f"# {n:g} steps in the shortest contact, {shortest:.4g} s",
        f"timestep {number(shortest / n)}",
    ]
    if walls := [i for i, t in enumerate(types, 1) if t.is_wall]:
        lines += [
            "# Each wall has the same words, and its own name, type and place:",
            f"# fix NAME all wall/gran model {selectors} primitive type {walls[0]} zplane 0.0 {switches}",
        ]
    return "\n".join(lines) + "\n"


def _checked(types: Sequence[BlockType], contacts: Contacts, kind: str) -> Contacts:
    """Return the contacts of pairs of types that can touch, refusing what LIGGGHTS would run without a word."""
    table: dict[tuple[str, str], PairContact] = {}
    for i, a in enumerate(types):
        for b in types[i:]:
            if a.is_wall and b.is_wall:
                continue
            names = (a.name, b.name)
            c = contacts.get(names, contacts.get((b.name, a.name)))
            if c is None:
                continue
            expect((c.law == "linear") == (kind == "linear"), names, f"law {c.law!r}", f"a {kind} contact")
            for key in ("k", "m_eff", "t_c"):
                value = getattr(c, key)
                expect(math.isfinite(value) and value > 0.0, names, f"{key} = {value!r}", "a finite value > 0")
            for key in ("c", "friction", "rolling_friction", "k_t"):
                value = getattr(c, key)
                expect(math.isfinite(value) and value >= 0.0, names, f"{key} = {value!r}", "a finite value >= 0")
            table[names] = c
    expect(bool(table), kind, "no contact", "one for every two types that meet")
    return table


def _lacking(types: Sequence[BlockType], table: Contacts) -> list[str]:
    known = {*table, *(names[::-1] for names in table)}
    lacking = [
        f"{a.name} with {b.name}"
        for i, a in enumerate(types)
        for b in types[i:]
        if not (a.is_wall and b.is_wall) and (a.name, b.name) not in known
    ]
    return (
        [f"# NOT calibrated, their numbers repeat the largest of the others: {', '.join(lacking)}"] if lacking else []
    )


def _stiffness_columns(table: Contacts) -> Columns:
    return {
        "kn": {names: c.k for names, c in table.items()},
        "kt": {names: c.k_t for names, c in table.items()},
        "gamman": {names: c.c / c.m_eff for names, c in table.items()},
        "gammat": dict.fromkeys(table, 0.0),
    }


def _hooke_columns(table: Contacts) -> Columns:
    V = _velocity(table)
    for names, c in table.items():
        k = hooke_stiffness(c, V)
        if not math.isclose(c.k, k, rel_tol=ROUNDING):
            raise RenderError(
                f"pair {names[0]}, {names[1]}: k_n = {c.k:.6g} N/m, and LIGGGHTS' hooke model makes {k:.6g} N/m of "
                "these materials, by strain energy: expected the method strain_energy, or the style hooke/stiffness"
            )
    return {"coefficientRestitution": {names: spring_restitution(c, names) for names, c in table.items()}}


def _hertz_columns(table: Contacts) -> Columns:
    for names, c in table.items():
        require_tsuji(names, c)
    return {"coefficientRestitution": {names: tsuji_restitution(c, names) for names, c in table.items()}}


_COLUMNS: Mapping[str, Callable[[Contacts], Columns]] = {
    "hooke/stiffness": _stiffness_columns,
    "hooke": _hooke_columns,
    "hertz": _hertz_columns,
}


def _velocity(table: Contacts) -> float:
    """The one impact speed of all pairs [m/s], which LIGGGHTS' hooke model takes."""
    speeds = {c.v_0 for c in table.values()}
    V = speeds.pop()
    if speeds or V is None or V < LEAST_VELOCITY:
        raise RenderError(
            "LIGGGHTS' hooke model has one characteristicVelocity for all pairs, of at least "
            f"{LEAST_VELOCITY:g} m/s: expected one such v_0 for all, or the style hooke/stiffness"
        )
    return V


def _hooke_switch(style: str, table: Contacts) -> str:
    """The switch for k_t/k_n in LIGGGHTS' hooke model, which has no property kt."""
    rubbing = {names: c for names, c in table.items() if c.friction > 0.0}
    if style != "hooke" or not rubbing:
        return ""
    for ratio, switch in _HOOKE_RATIOS.items():
        if all(math.isclose(c.k_t, ratio * c.k, rel_tol=_FEW_DIGITS) for c in rubbing.values()):
            return switch
    (one, other), c = next(iter(rubbing.items()))
    raise RenderError(
        f"pair {one}, {other}: k_t/k_n = {c.k_t / c.k:.4g}: LIGGGHTS' hooke model has 1, or 2/7 with ktToKnUser on, "
        "for all pairs: expected such a k_t_ratio, or the style hooke/stiffness"
    )


def _elastic(types: Sequence[BlockType]) -> list[str]:
    stiffest = max(float(t.material.young) for t in types if t.material is not None)
    young = [RIGID * stiffest if t.material is None else float(t.material.young) for t in types]
    poisson = [0.0 if t.material is None else float(t.material.poisson) for t in types]
    lines = ["soft_particles yes"] if min(young) < SOFT_LIMIT else []
    lines += ["hard_particles yes"] if max(young) > HARD_LIMIT else []
    return [
        *lines,
        *_property("youngsModulus", "peratomtype", young),
        *_property("poissonsRatio", "peratomtype", poisson),
    ]


def _matrix(names: Sequence[str], column: Mapping[tuple[str, str], float]) -> list[float]:
    """The symmetric table by types, row by row; two walls never touch, LIGGGHTS wants a number all the same."""
    never = max(column.values())
    return [column.get((a, b), column.get((b, a), never)) for a in names for b in names]


_COMMENTS = {
    "youngsModulus": "Young's modulus [Pa]; a rigid wall has one that changes nothing any more",
    "poissonsRatio": "Poisson's ratio [-]",
    "coefficientRestitution": "sets the damping [-]; lower than e_n where attraction is cut off (limitForce on)",
    "characteristicVelocity": "impact speed at which the spring stores as much energy as Hertz [m/s]",
    "kn": "normal stiffness k_n [N/m]",
    "kt": "tangential stiffness [N/m]",
    "gamman": "normal damping per effective mass, eta_n/m_eff [1/s]",
    "gammat": "tangential damping [1/s]: none (tangential_damping off), energy is lost by sliding alone",
    "coefficientFriction": "Coulomb friction [-]; 0 where none was given",
    "coefficientRollingFriction": "rolling friction [-]",
}


def _property(name: str, per: str, values: Sequence[float]) -> list[str]:
    return [f"# {_COMMENTS[name]}", f"fix {name} all property/global {name} {per} {' '.join(map(number, values))}"]


def matrix_block(
    matrix: PairMatrix,
    style: str = "hooke/stiffness",
    *,
    friction: float = 0.0,
    k_t_ratio: float | None = None,
    steps_per_contact: float | None = None,
) -> str:
    """Return the block of the pairs of `kncal.calibrate_matrix`.

    Parameters
    ----------
    style : {"hooke/stiffness", "hooke", "hertz"}
        LIGGGHTS' normal model. "hooke" is for the method strain_energy and one ``v_0``; "hertz" is the reference
        contact itself, of the law tsuji or hertz.
    friction : Coulomb coefficient of all pairs [-]
    k_t_ratio : k_t/k_n of the linear styles [-]. None: Mindlin's ratio of each pair; 1 for "hooke", which has only
        1 and 2/7
    steps_per_contact : N of the block's time step; None: `kncal.physics.timestep.usual_steps` of the smallest e_n

    Raises
    ------
    InputError
        For another style, a number out of its range, or a matrix without materials.
    RenderError
        If the model of LIGGGHTS has no such contact.
    """
    instance("matrix", matrix, PairMatrix, "made by kncal.calibrate_matrix")
    kind = STYLES[one_of("style", style, STYLES)]
    if unknown := [name for name in matrix.names if name not in matrix.materials]:
        raise InputError(f"no material of {unknown[0]!r}: expected a matrix made by kncal.calibrate_matrix")
    mu = float(in_range("friction", single("friction", friction), 0.0, 10.0))
    ratio = 1.0 if k_t_ratio is None and style == "hooke" else k_t_ratio
    if ratio is not None:
        ratio = float(in_range("k_t_ratio", single("k_t_ratio", ratio), 0.0, 10.0))
    contacts = {}
    for (a, b), c in matrix.calibrations.items():
        # the law itself, which may be one of the user's own
        choice = ContactChoice(law=cast("str", c.contact_law), end=c.end, k_t_ratio=ratio)
        numbers = PairNumbers(float(c.e_n), mu, float(c.v_0), float(c.k_n))
        contacts[a, b] = pair_contact(choice, c.pair, numbers, kind, Rest(0.0, 0.0), scene="matrix", names=f"{a}, {b}")
    if steps_per_contact is None:
        first = min(matrix.calibrations.values(), key=lambda c: float(c.e_n))
        steps_per_contact = usual_steps(first.contact_law, float(first.e_n), first.end)
    types = [BlockType(name=n, material=matrix.materials[n], is_wall=n in matrix.walls) for n in matrix.names]
    return liggghts_block(types, contacts, style, steps_per_contact)


def case_block(scene: Scene | BedScene, style: str = "hooke/stiffness", steps_per_contact: float = 50.0) -> str:
    """Return the block of a case: a type per material and radius, a type per wall material, every pair's own numbers.

    Also pairs that don't meet in the case get their numbers, since a deck of one's own may let them; friction is the
    case's, whether or not the case needs it.

    Raises
    ------
    CaseFileError
        If a pair of the case has neither an impact speed nor a prescribed k_n.
    ValidityError
        If the overlap of a pair of the case would reach the radius.
    InputError, RenderError
        As `liggghts_block`.
    """
    kind = STYLES[one_of("style", style, STYLES)]
    types, contacts = _bed_contacts(scene, kind) if isinstance(scene, BedScene) else _scene_contacts(scene, kind)
    return liggghts_block(types, contacts, style, steps_per_contact)


def _scene_contacts(scene: Scene, kind: str) -> tuple[list[BlockType], Contacts]:
    species = species_of(scene)
    bodies = [alike[0] for alike in species.members]
    types = [BlockType(name=b.name, material=b.material, is_wall=isinstance(b, Wall)) for b in bodies]
    speed = cache(lambda: first_impact_speed(scene))  # it looks at every pair
    contacts = {}
    for which in species.pairs():
        a, b = species.bodies(which)
        names = (bodies[which[0]].name, bodies[which[1]].name)
        try:
            contacts[names] = contact_of(scene, a, b, kind, lambda _: speed(), 0.0)
        except (CaseFileError, ValidityError):
            if species.meetings(which):  # else nobody asked for it, and the block says that it lacks it
                raise
    return types, contacts


def _bed_contacts(scene: BedScene, kind: str) -> tuple[list[BlockType], Contacts]:
    material, wall = scene.particles.material, scene.column.wall_material
    known = {PARTICLES: material.name, WALLS: "rigid" if wall is None else wall.name}
    types = [
        BlockType(name=PARTICLES, material=material),
        BlockType(name=WALLS, material=wall, is_wall=True),
    ]
    rest = Rest(0.0, bottom_load(scene))
    contacts = {}
    for (a, b), both in bed_pairs(scene).items():
        numbers = numbers_of(scene.contact, scene.contact.exception((a, known[a]), (b, known[b])))
        if numbers.v_0 is None and numbers.k_n is None:
            raise CaseFileError(
                f"{scene.name}: contact of {a} and {b}: expected contact.v_0 [m/s] or contact.k_n [N/m]"
            )
        contacts[a, b] = pair_contact(scene.contact, both, numbers, kind, rest, scene=scene.name, names=f"{a} and {b}")
    return types, contacts
