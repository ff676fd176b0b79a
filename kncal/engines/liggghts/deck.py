"""The LIGGGHTS deck ``in.liggghts`` of any scene, and the file with its particles.

Both kinds of model fill one small description, `Deck`; one template writes it, with blocks for what is needed. The
linear and the Hertz deck differ in the normal law, its numbers and the time step, in nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.shipped import folder as shipped_folder
from kncal.core.templating import number, render
from kncal.engines.liggghts.deck_checks import check_bed, check_model, check_run, check_start
from kncal.engines.liggghts.deck_tables import STYLES, AtomType, Contacts, atom_types, contact_context, hertz_style
from kncal.engines.liggghts.schedule import schedule
from kncal.record.liggghts_log import END_MARKER
from kncal.scene.bodies import Vector
from kncal.scene.model import Plan
from kncal.scene.placement import Start
from kncal.scene.scene import Scene

DECK, SCRIPT, DATA, RESTART = "in.liggghts", "Allrun", "particles.data", "particles.restart"
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

Side = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class DeckWall:
    """A plane wall: ``kind`` is the index of its atom type, ``axis`` is x, y or z, ``position`` [m]."""

    name: str
    kind: int
    axis: str
    position: float


@dataclass(frozen=True, kw_only=True)
class Particles:
    """Where particles are at the start: arrays (n, 3) in m, m/s, rad/s, and the index (n,) of each one's atom type.

    ``names`` of a few that the deck itself creates; without names they are read from `DATA`.
    """

    kinds: NDArray[np.intp]
    x: Array
    v: Array
    spin: Array
    names: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Deck:
    """What a deck says, whatever kind of scene it is of.

    Attributes
    ----------
    scene, kind : names of the scene and of its model
    style : LIGGGHTS' normal model, one of `STYLES`
    types : atom types, those of particles first
    contacts, unmet : by pairs of types (see `contact_context`)
    tangential : whether contacts have friction and tangential springs
    walls : the first is the one whose reaction is summed up for kncal
    box : lower and upper end on each axis [m]; periodic : the axes that are, as "y" or "xy"
    grows : whether the box grows with the particles, so that none can leave it
    gravity : vector [m/s²]
    dt : time step [s]; steps : number of steps, None: by hand as many as asked for, and kncal drives it as a library,
        with the forces of the gas
    thermo_every : steps between lines of the log
    start : Particles; None: from the file `RESTART`
    count : number of particles; skin : of neighbour lists [m]
    bin_size : edge of the bins of neighbour lists and sorting [m], 0 for LIGGGHTS' own
    schedule : when frames are recorded (see `kncal.engines.liggghts.schedule`); None: kncal reads the particles itself
    """

    scene: str
    kind: str
    style: str
    types: Sequence[AtomType]
    contacts: Contacts
    unmet: Contacts = field(default_factory=dict)
    tangential: bool = True
    walls: Sequence[DeckWall]
    box: tuple[Side, Side, Side]
    periodic: str = ""
    grows: bool = False
    gravity: Vector
    dt: float
    steps: int | None = None
    thermo_every: int = 1000
    start: Particles | None
    count: int
    skin: float
    bin_size: float = 0.0
    schedule: Mapping[str, object] | None = None


def scene_deck(model: Plan, linear_style: str) -> Deck:
    """Describe the deck of a model of a scene of a few bodies.

    Raises
    ------
    RenderError
        If LIGGGHTS would accept a number but not simulate it.
    """
    scene, species = model.scene, model.species
    check_model(model)
    check_start(scene)
    needs, particles = model.needs, scene.spheres
    margin = 2.0 * max(p.radius for p in particles)
    sides = [[p.position[axis] for p in particles] for axis in range(3)]
    x_side, y_side, z_side = ((min(side) - margin, max(side) + margin) for side in sides)
    index = species.index
    return Deck(
        scene=scene.name,
        kind=model.kind,
        style=hertz_style(model.contacts.values()) if model.kind == "hertz" else linear_style,
        types=atom_types(species),
        contacts=model.contacts,
        unmet=model.unmet,
        tangential=needs.uses("tangential"),
        walls=[DeckWall(name=w.name, kind=index[w.name], axis=w.axis, position=w.position) for w in scene.planes],
        box=(x_side, y_side, z_side),
        grows=True,
        gravity=scene.gravity if needs.uses("gravity") else (0.0, 0.0, 0.0),
        dt=model.dt,
        steps=model.n_steps,
        thermo_every=max(1, model.n_steps // 100),
        start=Particles(
            kinds=np.array([index[p.name] for p in particles]),
            x=np.array([p.position for p in particles]),
            v=np.array([p.velocity for p in particles]),
            spin=np.array([p.spin for p in particles]),
            names=tuple(p.name for p in particles),
        ),
        count=len(particles),
        skin=2.0 * min(p.radius for p in particles),
        schedule=schedule(model),
    )


def bed_deck(model: Plan, start: Start | None = None) -> Deck:
    """Describe the deck of a model of a bed, with particles at their ``start``, or from a restart.

    Raises
    ------
    RenderError
        If LIGGGHTS would accept a number but not simulate it.
    """
    scene, box = model.scene, model.scene.box
    check_bed(model)
    d = scene.diameter
    places = [("floor", "z", 0.0), ("lid", "z", box.height), ("left", "x", 0.0), ("right", "x", box.width)]
    places += [("front", "y", 0.0), ("back", "y", box.depth)] if scene.front_back == "walls" else []
    periodic = "y" if scene.front_back == "periodic" else ""
    x_side, y_side, z_side = (
        (0.0, size) if axis in periodic else (-d, size + d) for axis, size in zip("xyz", box.size, strict=True)
    )
    return Deck(
        scene=scene.name,
        kind=model.kind,
        style=hertz_style(model.contacts.values()) if model.kind == "hertz" else "hooke/stiffness",
        types=atom_types(model.species),
        contacts=model.contacts,
        walls=[DeckWall(name=name, kind=1, axis=axis, position=at) for name, axis, at in places],
        box=(x_side, y_side, z_side),
        periodic=periodic,
        gravity=(0.0, 0.0, -scene.g),
        dt=model.dt,
        start=None if start is None else Particles(kinds=start.kind, x=start.x, v=start.v, spin=start.spin),
        count=scene.number,
        skin=SKIN * d,
        bin_size=_bin_size(scene),
    )


def _bin_size(scene: Scene) -> float:
    own = 0.5 * (1.0 + SKIN) * scene.diameter
    needed = float((scene.box.volume / (BINS_PER_PARTICLE * max(scene.number, 1))) ** (1.0 / 3.0))
    return needed if needed > own else 0.0


def write_deck(deck: Deck, folder: Path, *, ranks: int = 1, oversubscribe: bool = False, steps: int = 0) -> None:
    """Write ``in.liggghts``, ``Allrun`` and, if the deck reads it, ``particles.data`` into ``folder``, which exists.

    ``ranks``, ``oversubscribe``: of ``Allrun``; ``steps``: what it runs by hand if the deck does not say how many.

    Raises
    ------
    RenderError
        If LIGGGHTS cannot simulate the model, or would take other numbers than the model's; nothing is written.
    """
    context = deck_context(deck) | {"ranks": ranks, "oversubscribe": oversubscribe, "default_steps": steps}
    templates = shipped_folder("templates") / "liggghts"
    texts = {name: render(templates, f"{name}.j2", context) for name in (DECK, SCRIPT)}
    if deck.start is not None and not deck.start.names:
        texts[DATA] = data_text(deck, deck.start)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="ascii")
    (folder / SCRIPT).chmod(0o755)


def deck_text(deck: Deck) -> str:
    """Return the deck ``in.liggghts``.

    Raises
    ------
    RenderError
        As `write_deck`.
    """
    return render(shipped_folder("templates") / "liggghts", f"{DECK}.j2", deck_context(deck))


def deck_context(deck: Deck) -> dict[str, object]:
    """Return the values that the template ``in.liggghts.j2`` needs: plain numbers, names, lists and dicts.

    Raises
    ------
    RenderError
        As `write_deck`.
    """
    check_run(deck.scene, deck.kind, STYLES[deck.style], deck.dt, deck.steps)
    g = math.hypot(*deck.gravity)
    contacts = contact_context(
        deck.scene, deck.types, deck.contacts, deck.style, unmet=deck.unmet, tangential=deck.tangential
    )
    start = deck.start
    return contacts | {
        "one_line": False,
        "scene": deck.scene,
        "kind": deck.kind,
        "names": {"data": DATA, "restart": RESTART},
        "start": "restart" if start is None else "atoms" if start.names else "data",
        "particles": _created(deck, start) if start is not None and start.names else [],
        "driven": deck.steps is None,
        "box": [list(side) for side in deck.box],
        "boundary": " ".join("p" if axis in deck.periodic else "m" if deck.grows else "f" for axis in "xyz"),
        "skin": deck.skin,
        "few": deck.count <= FEW or deck.grows,
        "bin": deck.bin_size,
        "near": NEAR,
        "walls": [{"name": w.name, "type": w.kind + 1, "axis": w.axis, "position": w.position} for w in deck.walls],
        "gravity": {"size": g, "direction": [value / g for value in deck.gravity] if g else []},
        "dt": deck.dt,
        "n_steps": deck.steps,
        "thermo_every": deck.thermo_every,
        "schedule": deck.schedule,
        "end_marker": END_MARKER,
    }


def _size(kind: AtomType) -> tuple[float, float]:
    """Return the diameter [m] and density [kg/m³] of the particles of a type."""
    assert kind.material is not None  # noqa: S101  # only walls may be rigid
    assert kind.radius is not None  # noqa: S101
    return 2.0 * kind.radius, float(kind.material.density)


def _created(deck: Deck, start: Particles) -> list[dict[str, object]]:
    created: list[dict[str, object]] = []
    rows = zip(start.names, start.kinds.tolist(), start.x.tolist(), start.v.tolist(), start.spin.tolist(), strict=True)
    for name, kind, x, v, spin in rows:
        diameter, density = _size(deck.types[kind])
        body = {"name": name, "type": kind + 1, "diameter": diameter, "density": density}
        created.append(body | {"x": x, "v": v, "spin": spin})
    return created


def data_text(deck: Deck, start: Particles) -> str:
    """Return ``particles.data``: box, particles (ids 1 to n in row order), velocities, with every digit."""
    lines = [f"Particles of {deck.scene}, in m, kg/m3, m/s; written by kncal", ""]
    lines += [f"{len(start.x)} atoms", f"{len(deck.types)} atom types", ""]
    lines += [f"{number(low)} {number(high)} {a}lo {a}hi" for a, (low, high) in zip("xyz", deck.box, strict=True)]
    words = [" ".join(map(number, _size(kind))) for kind in deck.types if not kind.is_wall]
    lines += ["", "Atoms", ""]
    lines += [
        f"{i} {kind + 1} {words[kind]} {x:.17g} {y:.17g} {z:.17g}"
        for i, (kind, (x, y, z)) in enumerate(zip(start.kinds.tolist(), start.x.tolist(), strict=True), 1)
    ]
    if start.v.any() or start.spin.any():
        rows = np.hstack([start.v, start.spin]).tolist()
        lines += ["", "Velocities", ""]
        lines += [f"{i} " + " ".join(f"{value:.17g}" for value in row) for i, row in enumerate(rows, 1)]
    return "\n".join(lines) + "\n"
