"""Contacts as LIGGGHTS 3.8.0 takes them: atom types, the normal model's words, and its numbers by pairs of types.

Force laws as LIGGGHTS codes them (delta > 0 overlap, v approach speed, b = -ln e/sqrt(pi² + ln² e)):

``hooke/stiffness`` with ``absolute_damping``: F = kn delta + gamman_abs v; without: F = kn delta + m_eff gamman v.
``hertz``: F = (4/3) Y sqrt(R) delta^1.5 + 2 sqrt(5/6) b sqrt(2 Y sqrt(R delta) m) v, the Tsuji form:
C = c/sqrt(m k_h) = sqrt(5) b.
``hertz/stiffness``: F = sqrt(R delta) (kn delta + m gamman v), the Kuwabara–Kono form: C x^(1/2) x_dot.
``hooke``: F = kn delta + 2 b sqrt(m kn) v with kn = (16/15) sqrt(R) Y (15 m V²/(16 sqrt(R) Y))^(1/5).

The tangential spring is kt, sqrt(R delta) kt, 8 G sqrt(R delta) (``hertz``), or kn or 2/7 kn (``hooke``). While it
sticks, its damping is gammat_abs or m gammat, sqrt(R delta) m gammat, 2 sqrt(5/6) b sqrt(8 G sqrt(R delta) m), or that
of the normal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from kncal.core.errors import RenderError
from kncal.engines.liggghts.deck_checks import ROUNDING, expect_same, require_law
from kncal.engines.plan_checks import check_contact, expect
from kncal.physics.laws import LAWS
from kncal.physics.material import Material, pair, sphere_mass, wall_pair
from kncal.physics.tangential import TANGENTIAL_DAMPING
from kncal.scene.bodies import Particle
from kncal.scene.model import PairContact
from kncal.scene.species import SpeciesTable

#: Normal models of LIGGGHTS, and the kind of contact that each is made from.
STYLES: Mapping[str, str] = {
    "hooke/stiffness": "linear", "hooke": "linear", "hertz": "hertz", "hertz/stiffness": "hertz",
}  # fmt: skip
#: The linear law as a normal model of its own; "hooke" makes the same law of other numbers.
LINEAR = "hooke/stiffness"
#: LIGGGHTS refuses a coefficientRestitution of 0.05 and below.
LEAST_RESTITUTION = 0.05
#: Young's modulus beyond which LIGGGHTS (units si) wants `soft_particles yes` or `hard_particles yes` [Pa].
SOFT_LIMIT, HARD_LIMIT = 5e6, 1e9
#: LIGGGHTS refuses a smaller characteristicVelocity [m/s].
LEAST_VELOCITY = 1e-2
#: A wall this much stiffer than the softest particle changes E_eff by less than rounding does.
RIGID = 1e17
#: k_t/k_n that LIGGGHTS' hooke model can have -> its switch; and how near to such a ratio is that ratio: 2/7 is often
#: written with four digits.
_HOOKE_RATIOS, _FEW_DIGITS = {1.0: "", 2.0 / 7.0: "ktToKnUser on"}, 1e-3

TypePair = tuple[int, int]
Names = tuple[str, str]
Contacts = Mapping[TypePair, PairContact]
Entry = dict[str, object]


@dataclass(frozen=True, kw_only=True)
class AtomType:
    """An atom type.

    Attributes
    ----------
    name : for errors and comments
    material : None for a rigid wall
    radius : of its particles [m]; None for walls, or where nothing is known of it
    is_wall : whether walls are of this type; two walls never touch
    held : whether its particles are frozen: LIGGGHTS takes their mass as infinite
    bodies : names of what is of this type, for a comment
    """

    name: str
    material: Material | None
    radius: float | None = None
    is_wall: bool = False
    held: bool = False
    bodies: tuple[str, ...] = ()


def atom_types(species: SpeciesTable) -> list[AtomType]:
    """Return an atom type for each species, called as the first of its bodies."""
    return [
        AtomType(
            name=body.name,
            material=body.material,
            radius=body.radius if isinstance(body, Particle) else None,
            is_wall=not isinstance(body, Particle),
            held=isinstance(body, Particle) and body.frozen,
            bodies=tuple(alike.name for alike in bodies),
        )
        for bodies in species.members
        for body in bodies[:1]
    ]


def hertz_style(contacts: Iterable[PairContact]) -> str:
    """Return the normal model of Hertz contacts: that of their law; "hertz", which says what it is, for another law."""
    names = {law.liggghts for c in contacts if (law := LAWS.get(c.law)) is not None}
    return names.pop() if len(names) == 1 and names <= set(STYLES) else "hertz"


def contact_context(
    where: str,
    types: Sequence[AtomType],
    contacts: Contacts,
    style: str,
    *,
    unmet: Contacts | None = None,
    tangential: bool = True,
    absolute: bool = True,
) -> dict[str, object]:
    """Return what the templates say of contacts: the normal model's words, and its numbers by types and their pairs.

    A pair of types that is neither in ``contacts`` nor can be taken from ``unmet`` is in ``lacking``. It and two walls
    repeat the largest number of the others, since LIGGGHTS wants one for every pair of types.

    Parameters
    ----------
    where : name of the scene, for errors
    types : the atom types 1, 2, ...
    contacts : (i, j) with i <= j, from 0 -> contact of these two types
    style : one of `STYLES`
    unmet : contacts of pairs that the scene has no use for: those that LIGGGHTS cannot do are left out
    tangential : whether contacts have friction and tangential springs
    absolute : whether damping is written as eta_n [N s/m], as in kncal's own decks, or per effective mass [1/s], as
        LIGGGHTS takes it by default

    Raises
    ------
    RenderError
        If a number is out of its range, or LIGGGHTS would make another contact of these.
    """
    expect(bool(contacts), where, "no contact to take numbers from", "a contact for every two types that meet")
    end = _one(where, "contact.end", "limitForce", (c.end for c in contacts.values()))
    rolling = [c.rolling_model for c in contacts.values() if c.rolling_friction > 0.0]
    law = _Law(
        style=style,
        tangential=tangential,
        damped=tangential and any(c.c_t > 0.0 for c in contacts.values()),
        rolling=_one(where, "contact.rolling_model", "rolling_friction", rolling) if rolling else "",
        cohesion=any(c.cohesion > 0.0 for c in contacts.values()),
        absolute=absolute,
        velocity=_characteristic_velocity(where, contacts.values()) if style == "hooke" else math.nan,
    )
    expect(
        tangential or law.rolling in ("", "cdt"),
        where,
        f"rolling_model = {law.rolling!r} without tangential springs",
        'rolling_model = "cdt", or friction: LIGGGHTS has its rolling springs beside tangential ones only',
    )
    columns, lacking = _columns(types, contacts, unmet or {}, law)
    elastic = _elastic(types) if not style.endswith("/stiffness") else {}
    properties = [_property(name, "peratomtype", [values]) for name, values in elastic.items()]
    if style == "hooke":
        properties.append(_property("characteristicVelocity", "scalar", [[law.velocity]]))
    every = range(len(types))
    for name, column in columns.items():
        filler = max(column.values())
        rows = [[column.get((min(i, j), max(i, j)), filler) for j in every] for i in every]
        properties.append(_property(name, "peratomtypepair", rows, style))
    return _words(where, contacts, law, force_end=end == "force") | {
        "types": [
            {"name": t.name, "role": "walls" if t.is_wall else "particles", "bodies": list(t.bodies)} for t in types
        ],
        "lacking": [[i + 1, j + 1] for i, j in lacking],
        "soft": any(value < SOFT_LIMIT for value in elastic.get("youngsModulus", [])),
        "hard": any(value > HARD_LIMIT for value in elastic.get("youngsModulus", [])),
        "properties": properties,
        "tangential": tangential,
    }


def _words(where: str, contacts: Contacts, law: _Law, *, force_end: bool) -> dict[str, object]:
    """Return the words that choose the model, its parts first and then its switches, as LIGGGHTS wants them."""
    hooke_switch = ""
    if law.style == "hooke" and law.tangential:
        hooke_switch = _hooke_switch(where, contacts, ROUNDING if law.absolute else _FEW_DIGITS)
    switches = {
        "limitForce on": force_end,
        "absolute_damping on": law.style == "hooke/stiffness" and law.absolute,
        hooke_switch: bool(hooke_switch),
        "tangential_damping off": law.tangential and not law.damped,
    }
    memory = "history" if all(c.spring for c in contacts.values()) else "no_history"
    selectors = [law.style, f"tangential {memory if law.tangential else 'off'}"]
    selectors += ["cohesion sjkr"] if law.cohesion else []
    selectors += [f"rolling_friction {law.rolling}"] if law.rolling else []
    return {
        "force_end": force_end,
        "selectors": " ".join(selectors),
        "switches": " ".join(word for word, wanted in switches.items() if wanted),
    }


@dataclass(frozen=True, kw_only=True)
class _Law:
    """What LIGGGHTS is to make of the contacts; ``velocity``: its characteristicVelocity [m/s]."""

    style: str
    tangential: bool
    damped: bool
    rolling: str
    cohesion: bool
    absolute: bool
    velocity: float


def _one(where: str, key: str, word: str, values: Iterable[str]) -> str:
    """The one value of all contacts."""
    found = sorted(set(values))
    expect(len(found) == 1, where, f"{key}: {' and '.join(found)}", f"one: LIGGGHTS has one {word} for all contacts")
    return found[0]


def _columns(
    types: Sequence[AtomType], contacts: Contacts, unmet: Contacts, law: _Law
) -> tuple[dict[str, dict[TypePair, float]], list[TypePair]]:
    """Return the numbers of each property by pairs of types, and the pairs that have none."""
    known = {(i, j): _numbers(types[i], types[j], contact, law) for (i, j), contact in contacts.items()}
    lacking = []
    for i, j in _pairs(types):
        if (i, j) not in known:
            try:
                known[i, j] = _numbers(types[i], types[j], unmet[i, j], law)
            except (KeyError, RenderError):
                lacking.append((i, j))
    names = next(iter(known.values()))
    return {name: {which: found[name] for which, found in known.items()} for name in names}, lacking


def _numbers(one: AtomType, other: AtomType, c: PairContact, law: _Law) -> dict[str, float]:
    names = (one.name, one.bodies[1] if one is other and len(one.bodies) > 1 else other.name)
    check_contact(names, c)
    found = _NUMBERS[law.style](names, c, one, other, law)
    if law.tangential:
        found["coefficientFriction"] = c.friction
    if law.rolling:
        found["coefficientRollingFriction"] = c.rolling_friction
    if law.rolling == "epsd":
        found["coefficientRollingViscousDamping"] = c.rolling_damping
    if law.cohesion:
        found["cohesionEnergyDensity"] = c.cohesion
    return found


def _pairs(types: Sequence[AtomType]) -> list[TypePair]:
    """Every pair of types that can touch at all."""
    every = range(len(types))
    return [(i, j) for i in every for j in every[i:] if not (types[i].is_wall and types[j].is_wall)]


def tsuji_restitution(contact: PairContact, names: Names) -> float:
    """Return the coefficientRestitution whose Tsuji damping in LIGGGHTS is exactly ``contact.c``.

    C = c/sqrt(m_eff k_h) = sqrt(5) b, e = exp(-pi b/sqrt(1 - b²)): the overlap-end relation for either end.

    Raises
    ------
    RenderError
        If C >= sqrt(5), or e <= 0.05, which LIGGGHTS refuses.
    """
    return _restitution(contact, names, contact.c / math.sqrt(5.0 * contact.m_eff * contact.k))


def spring_restitution(contact: PairContact, names: Names) -> float:
    """Return the coefficientRestitution whose damping of LIGGGHTS' `hooke` is exactly ``contact.c``, 2 b sqrt(m_eff k).

    Raises
    ------
    RenderError
        As `tsuji_restitution`.
    """
    return _restitution(contact, names, contact.c / (2.0 * math.sqrt(contact.m_eff * contact.k)))


def _restitution(contact: PairContact, names: Names, b: float) -> float:
    e = math.exp(-math.pi * b / math.sqrt(1.0 - b * b)) if b < 1.0 else 0.0
    if e <= LEAST_RESTITUTION:
        asked = f"e_n = {contact.e_n:g} with contact end {contact.end!r}"
        raise RenderError(
            f"pair {names[0]}, {names[1]}: {asked} needs damping that this LIGGGHTS model does not have (its "
            f"coefficientRestitution would be {e:.4g}; it wants more than {LEAST_RESTITUTION:g}): choose a "
            f"larger e_n, {'the hooke/stiffness style, ' if contact.n == 1.0 else ''}or run this model with the "
            "builtin engine"
        )
    # The inverse of the formula that gave c: the same number but for rounding; the asked one reads better.
    return contact.e_n if abs(e - contact.e_n) < 1e-14 else min(e, 1.0)


def _linear_numbers(names: Names, c: PairContact, one: AtomType, other: AtomType, law: _Law) -> dict[str, float]:
    require_law(names, c, LINEAR)
    k_t, c_t = (c.k_t, c.c_t) if law.tangential else (0.0, 0.0)
    if law.absolute:
        return {"kn": c.k, "kt": k_t, "gamman_abs": c.c, "gammat_abs": c_t}
    return {"kn": c.k, "kt": k_t, "gamman": c.c / c.m_eff, "gammat": c_t / c.m_eff}


def _root_numbers(names: Names, c: PairContact, one: AtomType, other: AtomType, law: _Law) -> dict[str, float]:
    require_law(names, c, law.style)
    k_t, c_t = (c.k_t, c.c_t) if law.tangential else (0.0, 0.0)
    root, m = math.sqrt(c.R_eff), c.m_eff
    return {"kn": c.k / root, "kt": k_t / root, "gamman": c.c / (m * root), "gammat": c_t / (m * root)}


def _expect_damping(names: Names, c: PairContact, law: _Law, own: float) -> None:
    """Refuse another tangential damping than the model's own."""
    if law.damped and c.friction > 0.0:
        meaning = f"tangential damping of LIGGGHTS' model {law.style}"
        expect_same(names, "c_t", c.c_t, own, f'{meaning} (tangential_damping = "liggghts")')


def _hertz_numbers(names: Names, c: PairContact, one: AtomType, other: AtomType, law: _Law) -> dict[str, float]:
    require_law(names, c, law.style)
    _check_elastic(names, c, one, other)
    k_h = 4.0 / 3.0 * c.E_eff * math.sqrt(c.R_eff)
    expect_same(names, "k", c.k, k_h, "Hertz stiffness (4/3) E_eff sqrt(R_eff)")
    if law.tangential:
        expect_same(names, "k_t", c.k_t, 8.0 * c.G_eff * math.sqrt(c.R_eff), "Mindlin stiffness 8 G_eff sqrt(R_eff)")
    _expect_damping(names, c, law, TANGENTIAL_DAMPING["liggghts"](c.c, c.n, c.k, c.k_t))
    return {"coefficientRestitution": tsuji_restitution(c, names)}


def _hooke_numbers(names: Names, c: PairContact, one: AtomType, other: AtomType, law: _Law) -> dict[str, float]:
    require_law(names, c, LINEAR)
    _check_elastic(names, c, one, other)
    stiff = math.sqrt(c.R_eff) * c.E_eff
    k = 16.0 / 15.0 * stiff * (15.0 * c.m_eff * law.velocity**2 / (16.0 * stiff)) ** 0.2
    meaning = "stiffness that LIGGGHTS' hooke model finds by strain energy"
    expect_same(names, "k", c.k, k, f"{meaning}: take the method strain_energy, or the style hooke/stiffness")
    _expect_damping(names, c, law, c.c)
    return {"coefficientRestitution": spring_restitution(c, names)}


_Numbers = Callable[[Names, PairContact, AtomType, AtomType, _Law], dict[str, float]]
_NUMBERS: Mapping[str, _Numbers] = {
    "hooke/stiffness": _linear_numbers,
    "hertz/stiffness": _root_numbers,
    "hertz": _hertz_numbers,
    "hooke": _hooke_numbers,
}


def _check_elastic(names: Names, contact: PairContact, one: AtomType, other: AtomType) -> None:
    """Refuse an effective mass, radius or modulus that is not what LIGGGHTS makes of the materials."""
    if one.material is None or one.radius is None or not (other.is_wall or other.radius):
        return  # nothing is known to compare with
    if other.is_wall:
        own = wall_pair(one.material, one.radius, other.material)
    else:
        own = pair(one.material, one.radius, other.material, other.radius)
    if one.held != other.held and other.material is not None and other.radius is not None:
        own = replace(
            own, m_eff=sphere_mass(*((other.material, other.radius) if one.held else (one.material, one.radius)))
        )
    for key in ("m_eff", "R_eff", "E_eff", "G_eff"):
        expect_same(names, key, getattr(contact, key), float(getattr(own, key)), "value of these two bodies")


def _characteristic_velocity(where: str, contacts: Iterable[PairContact]) -> float:
    """The one impact speed of all pairs [m/s], which LIGGGHTS' hooke model takes."""
    speeds = {c.v_0 for c in contacts}
    V = speeds.pop() if len(speeds) == 1 else None
    if V is None or V < LEAST_VELOCITY:
        raise RenderError(
            f"{where}: LIGGGHTS' hooke model has one characteristicVelocity of at least {LEAST_VELOCITY:g} m/s for all "
            "contacts: expected one v_0 for all pairs (contact.v_0), or the hooke/stiffness style"
        )
    return V


def _hooke_switch(where: str, contacts: Contacts, near: float) -> str:
    """The switch for k_t/k_n in LIGGGHTS' hooke model, which has no property kt."""
    ratios = [c.k_t / c.k for c in contacts.values() if c.friction > 0.0]
    for ratio, switch in _HOOKE_RATIOS.items():
        if all(math.isclose(found, ratio, rel_tol=near) for found in ratios):
            return switch
    raise RenderError(
        f"{where}: k_t/k_n = {ratios[0]:.4g}: LIGGGHTS' hooke model has 1, or 2/7 with ktToKnUser on, for all pairs: "
        "expected such a k_t_ratio, or the style hooke/stiffness"
    )


def _elastic(types: Sequence[AtomType]) -> dict[str, list[float]]:
    rigid = RIGID * max(float(t.material.young) for t in types if t.material is not None and not t.is_wall)
    return {
        "youngsModulus": [rigid if t.material is None else float(t.material.young) for t in types],
        "poissonsRatio": [0.0 if t.material is None else float(t.material.poisson) for t in types],
    }


_COMMENTS = {
    "youngsModulus": "Young's modulus [Pa]; a rigid wall has one that changes nothing any more",
    "poissonsRatio": "Poisson's ratio [-]",
    "characteristicVelocity": "impact speed at which the spring stores as much energy as Hertz [m/s]",
    "coefficientRestitution": "sets the damping [-]; lower than e_n where attraction is cut off (limitForce)",
    "kn": "normal stiffness k_n [N/m]",
    "kt": "tangential stiffness k_t [N/m]",
    "gamman_abs": "normal damping coefficient eta_n [N s/m]",
    "gammat_abs": "tangential damping coefficient, of a contact that sticks [N s/m]",
    "gamman": "normal damping per effective mass, eta_n/m_eff [1/s]",
    "gammat": "tangential damping per effective mass, of a contact that sticks [1/s]",
    "coefficientFriction": "Coulomb friction [-]",
    "coefficientRollingFriction": "rolling friction [-]",
    "coefficientRollingViscousDamping": "damping of the spring against rolling, as a share of the critical one [-]",
    "cohesionEnergyDensity": "cohesion energy density [J/m3]",
}


#: The numbers of hertz/stiffness stand beside sqrt(R delta).
_OF_ROOT = {
    "kn": "normal stiffness k_h/sqrt(R_eff) [Pa]",
    "kt": "tangential stiffness 8 G_eff [Pa]",
    "gamman": "normal damping per effective mass, c/(m_eff sqrt(R_eff)) [1/(m s)]",
    "gammat": "tangential damping, likewise [1/(m s)]",
}


def _property(name: str, per: str, rows: list[list[float]], style: str = "") -> Entry:
    comments = _COMMENTS | _OF_ROOT if style == "hertz/stiffness" else _COMMENTS
    return {"name": name, "per": per, "rows": rows, "comment": comments[name]}
