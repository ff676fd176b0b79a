"""The LIGGGHTS deck of a bed, and the file with its particles.

The linear and the Hertz deck differ in the normal law, its numbers and the time step, in nothing else.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from kncal.core.checks import Array
from kncal.core.shipped import folder as shipped_folder
from kncal.core.templating import number, render
from kncal.engines.liggghts.deck import HARD_LIMIT, RIGID, SOFT_LIMIT, tsuji_restitution
from kncal.engines.liggghts.deck_checks import expect, expect_same, require_tsuji
from kncal.engines.liggghts.impacts import Side
from kncal.record.liggghts_log import END_MARKER
from kncal.scene.bed_model import BedModel
from kncal.scene.bed_scene import DEPTHS, BedScene
from kncal.scene.model import PairContact

DECK, DATA, RESTART = "bed.in", "particles.data", "particles.restart"
#: The two pairs of a bed, and the atom type of each side.
PARTICLES, WALLS = ("particles", "particles"), ("particles", "walls")
#: Neighbour skin in diameters: fewer rebuilds than 0.1, fewer pairs than 0.5.
SKIN = 0.25
#: Distance in diameters within which an opened contact is forgotten. The gap grows by v dt in a step, and with N steps
#: per contact and overlap x d, v dt is about pi x d/N: 0.016 d for x = 0.1, N = 20.
NEAR = 1.05
#: Up to so many particles each is compared with each, and none are sorted: there is nothing to gain.
FEW = 20
#: Bins of space per particle, for neighbour lists and for sorting: LIGGGHTS takes bins of half the cutoff, and visits
#: all of them each time. In a large column that costs more than the particles do, and ends at its limit of their
#: number. A settled bed fills some four bins of that size with each particle.
BINS_PER_PARTICLE = 100.0
#: A periodic column is at least so many diameters deep: no particle may touch another and its image.
LEAST_PERIODIC = 3.0

Entry = dict[str, object]


def write_deck(model: BedModel, folder: Path, positions: Array | None = None, velocities: Array | None = None) -> None:
    """Write ``bed.in`` into ``folder`` and, unless it starts from a restart, ``particles.data``.

    Parameters
    ----------
    model : BedModel
    folder : Path
        Exists.
    positions : (n, 3) centres [m]; None: the deck reads ``particles.restart``, which the caller puts there
    velocities : (n, 3) [m/s]; None: at rest

    Raises
    ------
    RenderError
        If LIGGGHTS cannot simulate the model, or would take other numbers than the model's; nothing is written.
    """
    text = deck_text(model, restart=positions is None)
    data = "" if positions is None else data_text(model.scene, positions, velocities)
    (folder / DECK).write_text(text, encoding="ascii")
    if data:
        (folder / DATA).write_text(data, encoding="ascii")


def deck_text(model: BedModel, *, restart: bool = False) -> str:
    """Return the deck ``bed.in``.

    Raises
    ------
    RenderError
        As `write_deck`.
    """
    return render(shipped_folder("templates") / "liggghts", f"{DECK}.j2", deck_context(model, restart=restart))


def deck_context(model: BedModel, *, restart: bool = False) -> dict[str, object]:
    """Return the values that the template ``bed.in.j2`` needs: plain numbers, names, lists and dicts.

    Raises
    ------
    RenderError
        As `write_deck`.
    """
    scene = model.scene
    contacts = _checked(model)
    hertz = model.kind == "hertz"
    ends = {contact.end for contact in contacts.values()}
    expect(len(ends) == 1, scene.name, f"contact ends {' and '.join(sorted(ends))}", "one contact end for all pairs")
    switches = ["limitForce on"] if "force" in ends else []
    switches += ["tangential_damping off"] if hertz else ["absolute_damping on", "tangential_damping off"]
    properties = _hertz_properties(scene, contacts) if hertz else _linear_properties(contacts)
    young = [value for p in properties if p["name"] == "youngsModulus" for value in p["rows"][0]]  # type: ignore[index]
    common = [_pairwise("coefficientFriction", {k: c.friction for k, c in contacts.items()})]
    rolling = any(c.rolling_friction > 0.0 for c in contacts.values())
    if rolling:
        common.append(_pairwise("coefficientRollingFriction", {k: c.rolling_friction for k, c in contacts.items()}))
    return {
        "scene": scene.name,
        "kind": model.kind,
        "names": {"deck": DECK, "data": DATA, "restart": RESTART},
        "law": "hertz" if hertz else "hooke/stiffness",
        "switches": " ".join(switches),
        "selectors": "tangential history" + (" rolling_friction cdt" if rolling else ""),
        "properties": properties,
        "common": common,
        "soft": any(value < SOFT_LIMIT for value in young),
        "hard": any(value > HARD_LIMIT for value in young),
        "periodic": scene.column.front_back == "periodic",
        "restart": restart,
        "skin": SKIN * scene.particles.diameter,
        "few": scene.particles.count <= FEW,
        "bin": bin_size(scene),
        "near": NEAR,
        "walls": walls(scene),
        "gravity": scene.gravity,
        "dt": model.dt,
        "thermo_every": 1000,
        "end_marker": END_MARKER,
    }


def bin_size(scene: BedScene) -> float:
    """Return the edge of the bins of neighbour lists and sorting [m], 0 for LIGGGHTS' own: half the cutoff."""
    column, particles = scene.column, scene.particles
    own = 0.5 * (1.0 + SKIN) * particles.diameter
    box = column.width * column.depth * column.height
    needed = float((box / (BINS_PER_PARTICLE * max(particles.count, 1))) ** (1.0 / 3.0))
    return needed if needed > own else 0.0


def data_text(scene: BedScene, positions: Array, velocities: Array | None = None) -> str:
    """Return ``particles.data``: box, particles (ids 1 to n in row order), velocities, with every digit."""
    column, particles = scene.column, scene.particles
    d, rho = number(particles.diameter), number(float(particles.material.density))
    lines = [
        f"Particles of bed {scene.name}, in m, kg/m3, m/s; written by kncal",
        "",
        f"{len(positions)} atoms",
        "2 atom types",
        "",
    ]
    for axis, size in zip("xyz", (column.width, column.depth, column.height), strict=True):
        margin = 0.0 if axis == "y" and column.front_back == "periodic" else particles.diameter
        lines.append(f"{number(-margin)} {number(size + margin)} {axis}lo {axis}hi")
    lines += ["", "Atoms", ""]
    lines += [f"{i} 1 {d} {rho} {x:.17g} {y:.17g} {z:.17g}" for i, (x, y, z) in enumerate(positions.tolist(), 1)]
    if velocities is not None:
        lines += ["", "Velocities", ""]
        lines += [f"{i} {x:.17g} {y:.17g} {z:.17g} 0 0 0" for i, (x, y, z) in enumerate(velocities.tolist(), 1)]
    return "\n".join(lines) + "\n"


def _checked(model: BedModel) -> dict[tuple[str, str], PairContact]:
    """Return the contacts of the two pairs, refusing what LIGGGHTS would run without a word."""
    scene, column = model.scene, model.scene.column
    name, d = scene.name, scene.particles.diameter
    expect(model.kind in ("linear", "hertz"), name, f"model kind {model.kind!r}", "'linear' or 'hertz'")
    expect(column.front_back in DEPTHS, name, f"front_back {column.front_back!r}", f"one of {', '.join(DEPTHS)}")
    expect(math.isfinite(model.dt) and model.dt > 0.0, name, f"dt = {model.dt!r} s", "a finite dt > 0")
    expect(math.isfinite(d) and d > 0.0, name, f"diameter = {d!r} m", "a finite diameter > 0")
    gravity = scene.gravity
    expect(math.isfinite(gravity) and gravity >= 0.0, name, f"gravity = {gravity!r} m/s²", "a finite value >= 0")
    if column.front_back == "periodic":
        expect(
            column.depth >= LEAST_PERIODIC * d,
            name,
            f"periodic depth {column.depth:g} m",
            f"at least {LEAST_PERIODIC:g} diameters ({LEAST_PERIODIC * d:g} m), so that no two particles touch twice",
        )
    for names in (PARTICLES, WALLS):
        expect(names in model.contacts, name, f"no contact of {names[0]} with {names[1]}", "one contact per pair")
        c = model.contacts[names]
        for key in ("k", "m_eff", "R_eff", "E_eff", "G_eff"):
            value = getattr(c, key)
            expect(math.isfinite(value) and value > 0.0, names, f"{key} = {value!r}", "a finite value > 0")
        for key in ("c", "friction", "rolling_friction", "k_t"):
            value = getattr(c, key)
            expect(math.isfinite(value) and value >= 0.0, names, f"{key} = {value!r}", "a finite value >= 0")
        expect(c.end in ("overlap", "force"), names, f"contact end {c.end!r}", "'overlap' or 'force'")
    return {names: model.contacts[names] for names in (PARTICLES, WALLS)}


def _linear_properties(contacts: dict[tuple[str, str], PairContact]) -> list[Entry]:
    for names, c in contacts.items():
        expect(c.law == "linear" and c.n == 1.0, names, f"law {c.law!r} in a linear model", "law 'linear'")
    columns = {
        "kn": {k: c.k for k, c in contacts.items()},
        "kt": {k: c.k_t for k, c in contacts.items()},
        "gamman_abs": {k: c.c for k, c in contacts.items()},
        "gammat_abs": dict.fromkeys(contacts, 0.0),
    }
    return [_pairwise(name, column) for name, column in columns.items()]


def _hertz_properties(scene: BedScene, contacts: dict[tuple[str, str], PairContact]) -> list[Entry]:
    particle, wall = scene.particles.material, scene.column.wall_material
    for names, c in contacts.items():
        require_tsuji(names, c)
        other = particle if names == PARTICLES else wall
        E = 1.0 / float(particle.compliance + (other.compliance if other else 0.0))
        G = 1.0 / float(particle.shear_compliance + (other.shear_compliance if other else 0.0))
        R = scene.particles.diameter / (4.0 if names == PARTICLES else 2.0)
        expect_same(names, "k", c.k, 4.0 / 3.0 * E * math.sqrt(R), "Hertz stiffness (4/3) E_eff sqrt(R_eff)")
        expect_same(names, "k_t", c.k_t, 8.0 * G * math.sqrt(R), "Mindlin stiffness 8 G_eff sqrt(R_eff)")
    young = [float(particle.young), RIGID * float(particle.young) if wall is None else float(wall.young)]
    poisson = [float(particle.poisson), 0.0 if wall is None else float(wall.poisson)]
    return [
        {"name": "youngsModulus", "per": "peratomtype", "rows": [young], "comment": _COMMENTS["youngsModulus"]},
        {"name": "poissonsRatio", "per": "peratomtype", "rows": [poisson], "comment": _COMMENTS["poissonsRatio"]},
        _pairwise("coefficientRestitution", {k: tsuji_restitution(c, k) for k, c in contacts.items()}),
    ]


_COMMENTS = {
    "youngsModulus": "Young's modulus of particles, walls [Pa]; a rigid wall has one that changes nothing any more",
    "poissonsRatio": "Poisson's ratio of particles, walls [-]",
    "coefficientRestitution": "sets the damping [-]; lower than e_n where attraction is cut off (limitForce)",
    "kn": "normal stiffness [N/m]",
    "kt": "tangential stiffness that goes with it [N/m]",
    "gamman_abs": "normal damping coefficient eta_n [N s/m]",
    "gammat_abs": "tangential damping [N s/m]: none, as in the other model",
    "coefficientFriction": "Coulomb friction [-]",
    "coefficientRollingFriction": "rolling friction [-]",
}


def _pairwise(name: str, column: dict[tuple[str, str], float]) -> Entry:
    """Return a property by pairs of types; two walls never touch, LIGGGHTS wants a number all the same."""
    with_walls = column[WALLS]
    rows = [[column[PARTICLES], with_walls], [with_walls, with_walls]]
    return {"name": name, "per": "peratomtypepair", "rows": rows, "comment": _COMMENTS[name]}


def walls(scene: BedScene) -> list[Entry]:
    """Return the walls of the column, the floor first: name, plane and its position [m]."""
    column = scene.column
    places = [("z", 0, 0.0), ("z", 1, column.height), ("x", 0, 0.0), ("x", 1, column.width)]
    if column.front_back == "walls":
        places += [("y", 0, 0.0), ("y", 1, column.depth)]
    return [{"name": f"wall_{axis}{end}", "plane": f"{axis}plane", "position": at} for axis, end, at in places]


def sides(scene: BedScene) -> list[Side]:
    """Return the pairs of walls of the column: axis, and coordinate of the second wall [m]; the first is at 0."""
    column = scene.column
    return [(0, column.width), (2, column.height)] + ([(1, column.depth)] if column.front_back == "walls" else [])


def middle(scene: BedScene) -> float:
    """Return the y of a layer's plane [m]."""
    return 0.5 * scene.column.depth


def as_rows(name: str, value: Array, count: int) -> Array:
    """Return ``value`` as a contiguous (count, 3) float array.

    Raises
    ------
    RenderError
        For another shape, or numbers that are not finite.
    """
    rows = np.ascontiguousarray(value, dtype=np.float64)
    expect(rows.shape == (count, 3), name, f"shape {rows.shape}", f"({count}, 3): one row per particle")
    expect(bool(np.isfinite(rows).all()), name, "numbers that are not finite", "finite numbers")
    return rows
