"""The LIGGGHTS deck ``in.liggghts`` of any scene, and the file with its particles.

Both kinds of model fill one small description, `Deck`; one template writes it, with blocks for what is needed. The
linear and the Hertz deck differ in the normal law, its numbers and the time step, in nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from kncal.core.checks import Array
from kncal.core.shipped import folder as shipped_folder
from kncal.core.templating import number, render
from kncal.engines.liggghts.deck_checks import check_bed, check_model, check_run, check_start
from kncal.engines.liggghts.deck_description import Deck, Particles, Side
from kncal.engines.liggghts.deck_flow import DeckOutlet, deck_outlets, deck_streams, primes
from kncal.engines.liggghts.deck_tables import STYLES, AtomType, atom_types, contact_context, hertz_style
from kncal.engines.liggghts.deck_walls import (
    DeckWall,
    box_of,
    change_lines,
    change_times,
    changed,
    deck_walls,
    last_change,
    mesh_walls_line,
    mesh_words,
    move_lines,
    output_lines,
)
from kncal.engines.liggghts.schedule import schedule
from kncal.record.liggghts_log import END_MARKER
from kncal.scene.model import Plan
from kncal.scene.placement import Start
from kncal.scene.shapes import Bounds, write_stl
from kncal.scene.wall_limits import SKIN
from kncal.scene.walls import PlaneWall

DECK, SCRIPT, DATA, RESTART = "in.liggghts", "Allrun", "particles.data", "particles.restart"
#: Distance in diameters within which an opened contact is forgotten. The gap grows by v dt in a step, and with N steps
#: per contact and overlap x d, v dt is about pi x d/N: 0.016 d for x = 0.1, N = 20.
NEAR = 1.05
#: Of many particles without gas it is smaller where they are slow for their step, since each pair within it costs: what
#: a gap grows in a step at so many times the speed of the calibration, at least so much.
FASTER, LEAST_NEAR = 4.0, 1.005
#: Bins of space per particle, for neighbour lists and for sorting: LIGGGHTS takes bins of half the cutoff, and visits
#: all of them each time. In a large column that costs more than the particles do, and ends at its limit of their
#: number. A settled bed fills some four bins of that size with each particle.
BINS_PER_PARTICLE = 100.0


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
        walls=[
            DeckWall(
                name=w.name,
                kind=index[w.name],
                fix=f"wall_{i}",
                axis=w.axis,
                position=w.position,
                wall=PlaneWall(axis=w.axis, position=w.position, material="rigid"),
            )
            for i, w in enumerate(scene.planes, start=1)
        ],
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
        near=NEAR,
        skin=2.0 * min(p.radius for p in particles),
        schedule=schedule(model),
    )


def bed_deck(
    model: Plan,
    start: Start | None = None,
    *,
    time: float = 0.0,
    by_hand: bool = False,
    ranks: int = 1,
) -> Deck:
    """Describe the deck of a model of many particles, in intervals.

    Parameters
    ----------
    model : Plan
    start : the particles that are there at the start; None: from the file `RESTART`
    time : of a run that goes on [s]: what happened to walls until then is in force
    by_hand : whether the deck itself runs to the end, with what happens on the way; else kncal drives it
    ranks : that share the particles

    Raises
    ------
    RenderError
        If LIGGGHTS would accept a number but not simulate it.
    """
    scene = model.scene
    check_bed(model)
    walls = deck_walls(
        scene.walls,
        model.species.index,
        extent=scene.extent,
        open_axes=scene.open_axes,
        radius=0.5 * scene.d_min,
        path_of=scene.path_of,
    )
    periodic = "".join(axis for axis in "xyz" if axis in scene.periodic)
    box = box_of(scene.extent, walls, periodic, model.n_steps * model.dt, model.coupling)
    return Deck(
        scene=scene.name,
        kind=model.kind,
        style=hertz_style(model.contacts.values()) if model.kind == "hertz" else "hooke/stiffness",
        types=atom_types(model.species),
        contacts=model.contacts,
        walls=walls,
        streams=deck_streams(model),
        outlets=deck_outlets(model, box),
        gas=scene.run.coupling is not None,
        box=_sides(box),
        periodic=periodic,
        processors=parts_of(box[1] - box[0], scene.up, ranks),
        gravity=scene.gravity,
        dt=model.dt,
        steps=model.n_steps if by_hand else None,
        interval=model.steps_per_coupling,
        time=time,
        frames_every=model.frames_every * model.steps_per_coupling,
        start=None if start is None else Particles(kinds=start.kind, x=start.x, v=start.v, spin=start.spin),
        count=scene.number,
        skin=SKIN * scene.d_min,
        d_min=scene.d_min,
        near=NEAR if scene.run.coupling is not None else _near(model),
        bin_size=_bin_size(box, scene.d_max, SKIN * scene.d_min, scene.number),
    )


def parts_of(size: Array, up: Array, ranks: int) -> tuple[int, int, int]:
    """Return into how many parts a box of ``size`` (3,) [m] is cut on each axis, with the least area of cuts.

    It is not cut across the axis along ``up``: particles lie below, and those above would have nothing to do.
    """
    whole = int(np.argmax(np.abs(up)))
    one, two = (axis for axis in range(3) if axis != whole)
    ways = [(n, ranks // n) for n in range(1, ranks + 1) if ranks % n == 0]
    best = min(ways, key=lambda way: (way[0] - 1) * size[two] + (way[1] - 1) * size[one])
    parts = [1, 1, 1]
    parts[one], parts[two] = best
    return parts[0], parts[1], parts[2]


def _near(model: Plan) -> float:
    speeds = [c.v_0 for c in model.contacts.values()]
    fastest = max((v for v in speeds if v is not None), default=None)
    if fastest is None or None in speeds:
        return NEAR
    return min(NEAR, max(LEAST_NEAR, 1.0 + FASTER * fastest * model.dt / model.scene.d_min))


def _sides(box: Bounds) -> tuple[Side, Side, Side]:
    (x_low, y_low, z_low), (x_high, y_high, z_high) = box[0].tolist(), box[1].tolist()
    return (x_low, x_high), (y_low, y_high), (z_low, z_high)


def _bin_size(box: Bounds, d: float, skin: float, number: int) -> float:
    own = 0.5 * (d + skin)
    needed = float((np.prod(box[1] - box[0]) / (BINS_PER_PARTICLE * max(number, 1))) ** (1.0 / 3.0))
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
    if deck.start is not None and not deck.start.names and len(deck.start.x):
        texts[DATA] = data_text(deck, deck.start)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="ascii")
    surfaces: list[DeckWall | DeckOutlet] = [*deck.walls, *deck.outlets]
    for surface in surfaces:
        if surface.triangles is not None:
            write_stl(surface.triangles, folder / surface.file)
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
    by_hand = deck.steps is not None and deck.interval > 0
    context = contacts | {
        "one_line": False,
        "scene": deck.scene,
        "kind": deck.kind,
        "names": {"data": DATA, "restart": RESTART},
        "start": "restart" if start is None else "atoms" if start.names else "data" if len(start.x) else "nothing",
        "particles": _created(deck, start) if start is not None and start.names else [],
        "driven": deck.steps is None,
        "many": deck.interval > 0,
        "gas": deck.gas,
        "frozen": [i for i, kind in enumerate(deck.types, start=1) if kind.held],
        "box": [list(side) for side in deck.box],
        "boundary": " ".join("p" if axis in deck.periodic else "m" if deck.grows else "f" for axis in "xyz"),
        "processors": list(deck.processors),
        "skin": deck.skin,
        "few": deck.few,
        "bin": deck.bin_size,
        "near": deck.near,
        "gravity": {"size": g, "direction": [value / g for value in deck.gravity] if g else []},
        "dt": deck.dt,
        "n_steps": deck.steps,
        "thermo_every": deck.thermo_every,
        "schedule": deck.schedule,
        "end_marker": END_MARKER,
    }
    context |= _wall_context(deck, by_hand) | _flow_context(deck)
    context["mesh_line"] = mesh_walls_line(
        [wall for wall in deck.walls if wall.there(deck.time, deck.every)],
        str(context["selectors"]),
        str(context["switches"]),
    )
    return context | (_by_hand(deck, context) if by_hand else {})


def _wall_context(deck: Deck, by_hand: bool) -> dict[str, object]:
    there = [wall for wall in deck.walls if wall.there(deck.time, deck.every)]
    kept = by_hand or (deck.steps is None and not deck.gas)
    lines = [
        line
        for wall in there
        if wall.is_mesh
        for line in move_lines(wall, last_change(wall.wall, deck.time, deck.every), deck.time, deck.every)
    ]
    return {
        "primitives": [
            {
                "name": wall.name,
                "side": wall.side,
                "fix": wall.fix,
                "type": wall.kind + 1,
                "words": wall.primitive,
                "kept": kept or (deck.has_floor and wall is deck.walls[0] and not by_hand and deck.steps is None),
            }
            for wall in there
            if not wall.is_mesh
        ],
        "meshes": [
            {"name": wall.name, "fix": wall.fix, "words": mesh_words(wall, deck.d_min), "number": len(wall.triangles)}
            for wall in there
            if wall.triangles is not None
        ],
        "floor": deck.has_floor,
        "moves": lines,
    }


def _flow_context(deck: Deck) -> dict[str, object]:
    deletes = [outlet.fix for outlet in deck.outlets if outlet.deletes]
    outlets = [line for outlet in deck.outlets for line in outlet.lines()]
    if deletes and not deck.streams:
        # An empty box has no size of particles, and LIGGGHTS ends at the next set-up.
        largest = max((t for t in deck.types if t.radius), key=lambda t: t.radius or 0.0)
        diameter, density = _size(largest)
        (seed,) = primes((0,), 1)
        outlets.append(
            f"fix           size all particletemplate/sphere {seed} atom_type 1 density constant {number(density)} "
            f"radius constant {number(0.5 * diameter)}"
        )
    return {
        "streams": [line for stream in deck.streams for line in stream.lines(by_hand=deck.steps is not None)],
        "outlets": outlets,
        "deletes": bool(deletes),
        "deleting": deletes,
        "inserting": [stream.fix for stream in deck.streams],
        "count": 0 if deck.start is None else len(deck.start.x),
    }


def _by_hand(deck: Deck, context: Mapping[str, object]) -> dict[str, object]:
    """What a deck that runs to the end by itself records, and what happens on its way."""
    outputs = [line for wall in deck.walls for line in output_lines(wall, deck.interval)]
    outputs += [
        f"fix           out_{outlet.fix} all ave/time {deck.interval} 1 {deck.interval} f_{outlet.fix}[1] "
        f"f_{outlet.fix}[2] file outlet_{outlet.name}.txt"
        for outlet in deck.outlets
    ]
    assert deck.steps is not None  # noqa: S101  # by hand
    selectors, switches = str(context["selectors"]), str(context["switches"])
    times = [time for time in change_times(deck.walls, deck.every) if time < deck.steps * deck.dt * (1.0 - 1e-9)]
    marks = [round(time / deck.dt) for time in times]
    lines = [change_lines(deck.walls, time, deck.every, selectors, switches, recorded=True) for time in times]
    parts = [
        {"time": time, "lines": own, "steps": end - begin, "walls": changed(deck.walls, time, deck.every)}
        for time, own, begin, end in zip([0.0, *times], [[], *lines], [0, *marks], [*marks, deck.steps], strict=True)
    ]
    return {"outputs": outputs, "frames_every": deck.frames_every, "parts": parts}


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
    lines += ["", "Atoms", ""] if len(start.x) else []
    lines += [
        f"{i} {kind + 1} {words[kind]} {x:.17g} {y:.17g} {z:.17g}"
        for i, (kind, (x, y, z)) in enumerate(zip(start.kinds.tolist(), start.x.tolist(), strict=True), 1)
    ]
    if start.v.any() or start.spin.any():
        rows = np.hstack([start.v, start.spin]).tolist()
        lines += ["", "Velocities", ""]
        lines += [f"{i} " + " ".join(f"{value:.17g}" for value in row) for i, row in enumerate(rows, 1)]
    return "\n".join(lines) + "\n"
