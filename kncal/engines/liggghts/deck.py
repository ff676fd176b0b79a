"""What a LIGGGHTS deck says, worked out from a model: atom types, properties, walls, box, recording schedule.
Force laws as LIGGGHTS 3.8.0 codes them (delta > 0 overlap, v approach speed, b = -ln e/sqrt(pi² + ln² e)):

``hooke/stiffness`` with ``absolute_damping``: F = kn delta + gamman_abs v.
``hertz``: F = (4/3) Y sqrt(R) delta^1.5 + 2 sqrt(5/6) b sqrt(2 Y sqrt(R delta) m) v, the Tsuji form:
C = c/sqrt(m k_h) = sqrt(5) b.
``hooke``: F = kn delta + 2 b sqrt(m kn) v with kn = (16/15) sqrt(R) Y (15 m V²/(16 sqrt(R) Y))^(1/5).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from kncal.core.errors import RenderError
from kncal.engines.liggghts.deck_checks import (
    check_elastic,
    check_numbers,
    check_start,
    check_tangential,
    expect,
    expect_same,
    require_tsuji,
)
from kncal.engines.liggghts.schedule import schedule
from kncal.scene.model import Model, PairContact
from kncal.scene.needs import decide
from kncal.scene.scene import Particle, Scene, Wall
from kncal.scene.species import SpeciesPair, SpeciesTable

#: LIGGGHTS refuses a coefficientRestitution of 0.05 and below.
LEAST_RESTITUTION = 0.05
#: Young's modulus beyond which LIGGGHTS (units si) wants `soft_particles yes` or `hard_particles yes` [Pa].
SOFT_LIMIT, HARD_LIMIT = 5e6, 1e9
#: LIGGGHTS refuses a smaller characteristicVelocity [m/s].
LEAST_VELOCITY = 1e-2
#: A wall this much stiffer than the softest particle changes E_eff by less than rounding does.
RIGID = 1e17

Entry = dict[str, object]
Names = tuple[str, str]
Numbers = Mapping[str, float]


def deck_context(model: Model, linear_style: str) -> dict[str, object]:
    """Return the values that the template ``in.liggghts.j2`` needs: plain numbers, names, lists and dicts.

    Raises
    ------
    RenderError
        If LIGGGHTS would accept a number but not simulate it, or cannot simulate the model.
    """
    scene = model.scene
    check_numbers(model)
    check_start(scene)
    style = "hertz" if model.kind == "hertz" else linear_style
    ends = {contact.end for contact in model.contacts.values()}
    if len(ends) > 1:
        raise RenderError(
            f"{scene.name}: contacts end at {' and '.join(sorted(ends))}: kncal writes one limitForce for "
            "all of them; choose one contact.end"
        )
    needs = decide(scene)
    tangential, rolling = needs.uses("tangential"), needs.uses("rolling")
    selectors = f"{style} tangential {'history' if tangential else 'off'}"
    selectors += " rolling_friction cdt" if rolling else ""
    switches = " ".join(
        word
        for word, wanted in (
            ("limitForce on", "force" in ends),
            ("absolute_damping on", style == "hooke/stiffness"),
            ("tangential_damping off", tangential),
        )
        if wanted
    )
    types = model.species
    tables, lacking = pair_tables(model, style, tangential=tangential, rolling=rolling)
    elastic = _elastic(scene, types) if style != "hooke/stiffness" else []
    moduli = [value for entry in elastic if entry["name"] == "youngsModulus" for value in entry["rows"][0]]  # type: ignore[index]
    properties = elastic + [_property(name, "peratomtypepair", rows) for name, rows in tables.items()]
    if style == "hooke":
        properties.append(_property("characteristicVelocity", "scalar", [[_characteristic_velocity(model)]]))
    smallest = 2.0 * min(p.radius for p in scene.particles)
    g = math.hypot(*scene.gravity) if needs.uses("gravity") else 0.0
    return {
        "scene": scene.name,
        "kind": model.kind,
        "soft": any(value < SOFT_LIMIT for value in moduli),
        "hard": any(value > HARD_LIMIT for value in moduli),
        "box": _box(scene),
        "skin": smallest,
        "types": [
            {
                "role": "particles" if isinstance(bodies[0], Particle) else "walls",
                "bodies": [body.name for body in bodies],
            }
            for bodies in types.members
        ],
        "lacking": [[i + 1, j + 1] for i, j in lacking],
        "properties": properties,
        "tangential": tangential,
        "selectors": selectors,
        "switches": switches,
        "walls": [_wall(wall, types) for wall in scene.walls],
        "particles": [_particle(particle, types) for particle in scene.particles],
        "gravity": {"size": g, "direction": [value / g for value in scene.gravity] if g else []},
        "dt": model.dt,
        "n_steps": model.n_steps,
        "thermo_every": max(1, model.n_steps // 100),
        "schedule": schedule(model),
    }


def tsuji_restitution(contact: PairContact, names: tuple[str, str]) -> float:
    """Return the coefficientRestitution whose Tsuji damping in LIGGGHTS is exactly ``contact.c``.

    C = c/sqrt(m_eff k_h) = sqrt(5) b, e = exp(-pi b/sqrt(1 - b²)): the overlap-end relation for either end.

    Raises
    ------
    RenderError
        If C >= sqrt(5), or e <= 0.05, which LIGGGHTS refuses.
    """
    return _restitution(contact, names, contact.c / math.sqrt(5.0 * contact.m_eff * contact.k))


def spring_restitution(contact: PairContact, names: tuple[str, str]) -> float:
    """Return the coefficientRestitution whose damping of LIGGGHTS' `hooke` is exactly ``contact.c``, 2 b sqrt(m_eff k).

    Raises
    ------
    RenderError
        As `tsuji_restitution`.
    """
    return _restitution(contact, names, contact.c / (2.0 * math.sqrt(contact.m_eff * contact.k)))


def hooke_stiffness(contact: PairContact, velocity: float) -> float:
    """Return the k_n that LIGGGHTS' `hooke` model finds by strain energy [N/m], at ``velocity`` [m/s]."""
    stiff = math.sqrt(contact.R_eff) * contact.E_eff
    return float(16.0 / 15.0 * stiff * (15.0 * contact.m_eff * velocity**2 / (16.0 * stiff)) ** 0.2)


def _restitution(contact: PairContact, names: tuple[str, str], b: float) -> float:
    e = math.exp(-math.pi * b / math.sqrt(1.0 - b * b)) if b < 1.0 else 0.0
    if e <= LEAST_RESTITUTION:
        asked = f"e_n = {contact.e_n:g} with contact end {contact.end!r}"
        raise RenderError(
            f"pair {names[0]}, {names[1]}: {asked} needs damping that this LIGGGHTS model does not have (its "
            f"coefficientRestitution would be {e:.4g}; it wants more than {LEAST_RESTITUTION:g}): choose a "
            f"larger e_n, {'the hooke/stiffness style, ' if contact.law == 'linear' else ''}or run this model with the "
            "builtin engine"
        )
    # The inverse of the formula that gave c: the same number but for rounding; the asked one reads better.
    return contact.e_n if abs(e - contact.e_n) < 1e-14 else min(e, 1.0)


def _linear_numbers(scene: Scene, names: Names, c: PairContact, V: float) -> Numbers:
    expect(c.law == "linear" and c.n == 1.0, names, f"law {c.law!r} in a linear model", "law 'linear'")
    return {"kn": c.k, "kt": c.k_t, "gamman_abs": c.c, "gammat_abs": 0.0}


def _hertz_numbers(scene: Scene, names: Names, c: PairContact, V: float) -> Numbers:
    require_tsuji(names, c)
    check_elastic(scene, names, c)
    k_h = 4.0 / 3.0 * c.E_eff * math.sqrt(c.R_eff)
    expect_same(names, "k", c.k, k_h, "Hertz stiffness (4/3) E_eff sqrt(R_eff)")
    return {"coefficientRestitution": tsuji_restitution(c, names)}


def _hooke_numbers(scene: Scene, names: Names, c: PairContact, V: float) -> Numbers:
    if scene.contact.method != "strain_energy":
        raise RenderError(
            f"{scene.name}: LIGGGHTS' hooke model finds k_n by strain energy, the case asks for "
            f"{scene.contact.method!r}: expected contact.method = 'strain_energy', or the "
            "hooke/stiffness style"
        )
    expect(c.law == "linear" and c.n == 1.0, names, f"law {c.law!r} in a linear model", "law 'linear'")
    check_elastic(scene, names, c)
    expect_same(names, "k", c.k, hooke_stiffness(c, V), "stiffness that LIGGGHTS' hooke model will take")
    return {"coefficientRestitution": spring_restitution(c, names)}


_NUMBERS: dict[str, Callable[[Scene, Names, PairContact, float], Numbers]] = {
    "hooke/stiffness": _linear_numbers,
    "hertz": _hertz_numbers,
    "hooke": _hooke_numbers,
}


def pair_tables(
    model: Model, style: str, *, tangential: bool, rolling: bool
) -> tuple[dict[str, list[list[float]]], list[SpeciesPair]]:
    """Return the table of each property by pairs of types, and the pairs of types that have no contact of their own.

    Every pair that the contacts of the scene or `Model.unmet` know gets its own numbers. Two walls never touch; they
    and the pairs that are returned (they cannot be calibrated, or LIGGGHTS cannot do them; in this scene they do not
    meet) repeat the largest number of the others, since LIGGGHTS wants one for every pair of types.

    Raises
    ------
    RenderError
        If LIGGGHTS cannot simulate a contact of the scene, or two contacts of one pair of types differ.
    """
    types = model.species
    V = _characteristic_velocity(model) if style == "hooke" else math.nan

    def numbers(names: Names, c: PairContact) -> Numbers:
        found = dict(_NUMBERS[style](model.scene, names, c, V))
        if tangential:
            check_tangential(names, c, style)
            found["coefficientFriction"] = c.friction
        elif "kt" in found:
            found["kt"] = 0.0
        if rolling:
            found["coefficientRollingFriction"] = c.rolling_friction
        return found

    known: dict[SpeciesPair, tuple[PairContact, Numbers]] = {}
    for names, contact in model.contacts.items():
        which = types.pair_of(names)
        if which not in known:
            known[which] = contact, numbers(names, contact)
        elif contact is not known[which][0]:
            for name, value in numbers(names, contact).items():
                first = known[which][1][name]
                # the same pair the other way round may differ in the last digit
                same = math.isclose(value, first, rel_tol=1e-14)
                expect(same, names, f"{name} = {value!r}", f"{first!r}, as {types.label(which)} has it: bodies alike")
    lacking = []
    for which in types.pairs():
        if which not in known:
            one, other = types.bodies(which)
            try:
                contact = model.unmet[which]
                known[which] = contact, numbers((one.name, other.name), contact)
            except (KeyError, RenderError):
                lacking.append(which)
    expect(bool(known), model.scene.name, "no contact to take numbers from", "a second particle, a wall or contact.v_0")
    size = len(types.members)
    tables = {}
    for name in next(iter(known.values()))[1]:
        column = {which: found[name] for which, (_, found) in known.items()}
        filler = max(column.values())
        tables[name] = [[column.get((min(i, j), max(i, j)), filler) for j in range(size)] for i in range(size)]
    return tables, lacking


def _characteristic_velocity(model: Model) -> float:
    speeds = {contact.v_0 for contact in model.contacts.values()}
    V = speeds.pop() if len(speeds) == 1 else None
    if V is None or speeds or V < LEAST_VELOCITY:
        raise RenderError(
            f"{model.scene.name}: LIGGGHTS' hooke model has one characteristicVelocity of at least "
            f"{LEAST_VELOCITY:g} m/s for all contacts: expected one v_0 for all pairs (contact.v_0), or the "
            "hooke/stiffness style"
        )
    return V


def _elastic(scene: Scene, types: SpeciesTable) -> list[Entry]:
    rigid = RIGID * max(float(p.material.young) for p in scene.particles)
    materials = [bodies[0].material for bodies in types.members]
    young = [rigid if m is None else float(m.young) for m in materials]
    poisson = [0.0 if m is None else float(m.poisson) for m in materials]
    return [
        _property("youngsModulus", "peratomtype", [young]),
        _property("poissonsRatio", "peratomtype", [poisson]),
    ]


_COMMENTS = {
    "youngsModulus": "Young's modulus [Pa]; a rigid wall has one that changes nothing any more",
    "poissonsRatio": "Poisson's ratio [-]",
    "coefficientRestitution": "sets the damping [-]; lower than e_n where attraction is cut off (limitForce)",
    "characteristicVelocity": "impact speed at which the spring stores as much energy as Hertz [m/s]",
    "kn": "normal stiffness [N/m]",
    "kt": "tangential stiffness [N/m]",
    "gamman_abs": "normal damping coefficient eta_n [N s/m]",
    "gammat_abs": "tangential damping [N s/m]: none, as in the other model",
    "coefficientFriction": "Coulomb friction [-]",
    "coefficientRollingFriction": "rolling friction [-]",
}


def _property(name: str, per: str, rows: list[list[float]]) -> Entry:
    return {"name": name, "per": per, "rows": rows, "comment": _COMMENTS[name]}


def _particle(particle: Particle, types: SpeciesTable) -> Entry:
    return {
        "name": particle.name,
        "type": types.index[particle.name] + 1,
        "diameter": 2.0 * particle.radius,
        "density": particle.material.density,
        "x": list(particle.position),
        "v": list(particle.velocity),
        "spin": list(particle.spin),
    }


def _wall(wall: Wall, types: SpeciesTable) -> Entry:
    return {
        "name": wall.name,
        "type": types.index[wall.name] + 1,
        "plane": f"{wall.axis}plane",
        "position": wall.position,
    }


def _box(scene: Scene) -> list[list[float]]:
    margin = 2.0 * max(p.radius for p in scene.particles)
    return [
        [
            min(p.position[axis] for p in scene.particles) - margin,
            max(p.position[axis] for p in scene.particles) + margin,
        ]
        for axis in range(3)
    ]
