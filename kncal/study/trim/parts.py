"""The optional parts of a scene's physics: what each is, how it is switched, and whether it has a meaning here.

A pure function of the scene. What the scene has is tried off; what it leaves out is tried on, so that an omission that
matters is found too. A value of no such order (the drag law) is exchanged for the other one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from kncal.core.checks import one_of
from kncal.physics.drag import DRAGS
from kncal.scene.bed_scene import PARCELS, BedScene
from kncal.scene.contact_limits import FEWEST_FRAMES
from kncal.scene.needs import Needs, decide, untouched_walls
from kncal.scene.scene import ContactChoice, Scene
from kncal.study.trim.base import OFF, ON, OTHER, Part
from kncal.study.variants import Changes

#: Frames are tried this many times as far apart.
SPARSER = 4
#: Metrics of a bed that grow with its depth, or belong to a grid of that depth.
OF_THE_DEPTH = ("kinetic_energy", "contacts", "bubble_number", "eps_g")

#: What ``--parts`` may name, with the kinds of cases that have it.
GROUPS = {
    "tangential": "all",
    "rolling": "all",
    "damping": "all",
    "contact_model": "all",
    "walls": "single contacts",
    "front_back": "beds",
    "depth": "all",
    "gas": "all",
    "drag": "beds",
    "smoothing": "beds",
    "gas_step": "beds",
    "output": "all",
}


def parts_of(scene: Scene | BedScene, model: str, groups: Iterable[str] | None = None) -> tuple[Part, ...]:
    """Return the optional parts of ``scene``, run with the contact ``model``; ``groups``: only these.

    Raises
    ------
    InputError
        If a group is not one of this kind of case.
    """
    found = tuple(_of_bed(scene, model) if isinstance(scene, BedScene) else _of_contacts(scene, model))
    if groups is None:
        return found
    wanted = [one_of("part", name, tuple(dict.fromkeys(part.group for part in found))) for name in groups]
    return tuple(part for part in found if part.group in wanted)


def _part(name: str, text: str, change: str, tried: str, changes: Changes | None = None, *, model: str = "") -> Part:
    return Part(name=name, group=name, text=text, change=change, tried=tried, changes=changes or {}, model=model)


def _not(name: str, text: str, why: str) -> Part:
    return Part(name=name, group=name, text=text, change=OFF, tried="", why_not=why)


def _of_contacts(scene: Scene, model: str) -> Iterator[Part]:
    needs = decide(scene)
    yield from _friction(scene.contact, needs, _frictions(scene.contact))
    yield _damping(scene.contact)
    yield _contact_model(model)
    yield _walls(scene)
    yield _not(
        "depth",
        "third dimension",
        f"LIGGGHTS computes in three dimensions always; {needs.dimensions_reason}",
    )
    yield _not("gas", "gas", "a case of single contacts has none")
    yield _recording(scene)


def _of_bed(scene: BedScene, model: str) -> Iterator[Part]:
    needs = decide(scene)
    yield from _friction(scene.contact, needs, _frictions(scene.contact))
    yield _damping(scene.contact)
    yield _contact_model(model)
    yield _front_back(scene)
    yield _depth(scene)
    yield _gas(scene)
    yield _drag(scene)
    yield from _smoothing(scene)
    yield _gas_step(scene)
    yield _frames(scene)


def _frictions(contact: ContactChoice) -> list[float]:
    return [contact.friction, *(c.friction for c in contact.pairs if c.friction is not None)]


def _friction(contact: ContactChoice, needs: Needs, frictions: list[float]) -> Iterator[Part]:
    """Tangential spring and rolling friction: forced off where they are used, on where there is something to force."""
    coefficients = {"tangential": max(frictions), "rolling": contact.rolling_friction}
    texts = {"tangential": "tangential spring and friction", "rolling": "rolling friction"}
    for name, text in texts.items():
        if coefficients[name] == 0.0:
            yield _not(name, text, "its coefficient is 0 in every contact")
        elif needs.uses(name):  # without the tangential spring nothing is set rolling, so rolling friction goes with it
            yield _part(name, text, OFF, f"without {text}", {f"needs.{name}": False})
        else:
            # one at a time: what can be set rolling by it would get rolling friction as well
            alone = name == "tangential" and coefficients["rolling"] > 0.0 and not needs.uses("rolling")
            others = {"needs.rolling": False} if alone else {}
            yield _part(name, text, ON, f"with {text}", {f"needs.{name}": True, **others})


def _damping(contact: ContactChoice) -> Part:
    text = "damping of contacts"
    rows = [i for i, choice in enumerate(contact.pairs) if choice.e_n not in (None, 1.0)]
    if contact.e_n == 1.0 and not rows:
        return _not("damping", text, "e_n is 1 in every contact")
    changes = {f"contact.pairs.{i}.e_n": 1.0 for i in rows}
    changes |= {"contact.e_n": 1.0} if contact.e_n != 1.0 else {}
    return _part("damping", text, OFF, "e_n = 1 in every contact", changes)


def _contact_model(model: str) -> Part:
    text = "Hertz contact"
    if model == "hertz":
        return _part("contact_model", text, OFF, "the linear contact", model="linear")
    return _part("contact_model", text, ON, "the Hertz contact", model="hertz")


def _walls(scene: Scene) -> Part:
    text = "walls that nothing touches"
    names = untouched_walls(scene)
    if not names:
        why = "every wall can be touched" if scene.walls else "the scene has no walls"
        return _not("walls", text, why)
    return _part("walls", text, OFF, f"without {', '.join(names)}", {f"walls.{name}": None for name in names})


def _recording(scene: Scene) -> Part:
    text, run = "close recording of contacts", scene.run
    every = SPARSER * run.record_every
    if run.steps_per_contact / every < FEWEST_FRAMES:
        return _not("output", text, f"a contact would have fewer than {FEWEST_FRAMES} frames")
    part = _part("output", text, OFF, f"a frame every {every} steps of a contact", {"run.record_every": every})
    return replace(part, output=True)


def _front_back(scene: BedScene) -> Part:
    text, found = "front and back walls", scene.column.front_back
    if found == "layer":
        return _not("front_back", text, "one layer of particles, held in its plane")
    if found == "walls":
        return _part("front_back", text, OFF, "periodic in depth", {"column.front_back": "periodic"})
    return _part("front_back", text, ON, "walls in front and at the back", {"column.front_back": "walls"})


def _depth(scene: BedScene) -> Part:
    """The bed as one layer of particles, with as many of them per floor area."""
    text, column, particles = "depth of the bed", scene.column, scene.particles
    if column.front_back == "layer":
        return _not("depth", text, "the bed is one layer of particles already")
    if particles.count < 2:
        return _not("depth", text, "fewer than two particles")
    if particles.packing == "given":
        return _not("depth", text, "the positions of the particles are given, in three dimensions")
    d = particles.diameter
    count = round(particles.count * d / column.depth)
    if count < 2 or column.depth < 1.5 * d:
        return _not("depth", text, "the bed is hardly deeper than a particle")
    nx, _, nz = column.cells
    part = _part(
        "depth",
        text,
        OFF,
        f"one layer of {count} particles",
        {
            "column.front_back": "layer",
            "column.depth": d,
            "column.cells": [nx, 1, nz],
            "particles.count": count,
        },
    )
    lost = dict.fromkeys(OF_THE_DEPTH, "goes with the depth of the bed, or belongs to its grid")
    return replace(part, lost=lost)


def _gas(scene: BedScene) -> Part:
    if scene.gas is None:
        return _not("gas", "gas", "the case has no [gas]")
    if not scene.particles.count or scene.particles.frozen:
        return _not("gas", "gas", "nothing else moves")
    step = {"run.gas_step": None} if scene.run.gas_step is not None else {}
    return _part("gas", "gas", OFF, "particles only", {"gas": None, **step})


def _coupled(scene: BedScene) -> str:
    """Why a bed has no force of the gas on particles; empty if it has."""
    if scene.gas is None:
        return "the case has no [gas]"
    return "" if scene.particles.count else "there are no particles"


def _drag(scene: BedScene) -> Part:
    text = "drag law"
    if (why := _coupled(scene)) or scene.gas is None:
        return _not("drag", text, why)
    other = next(name for name in DRAGS if name != scene.gas.drag)
    return _part("drag", f"{text} {scene.gas.drag}", OTHER, f"drag by {other}", {"gas.drag": other})


def _smoothing(scene: BedScene) -> Iterator[Part]:
    text = "smoothing of the void fraction"
    if (why := _coupled(scene)) or scene.gas is None:
        yield _not("smoothing", text, why)
        return
    now = scene.gas.parcels_per_particle
    for parcels in PARCELS:
        if parcels != now:
            yield Part(
                name=f"smoothing-{parcels}",
                group="smoothing",
                text=f"{text} by {max(now, parcels)} parcels per particle",
                change=OFF if parcels < now else ON,
                tried=f"{parcels} parcel{'s' if parcels > 1 else ''} per particle",
                changes={"gas.parcels_per_particle": parcels},
            )


def _gas_step(scene: BedScene) -> Part:
    text, run = "finer gas step", scene.run
    if scene.gas is None:
        return _not("gas_step", text, "the case has no [gas]")
    if run.gas_step is not None and run.gas_step < run.coupling:
        return _part("gas_step", text, OFF, "one gas step per coupling interval", {"run.gas_step": None})
    return _part("gas_step", text, ON, "two gas steps per coupling interval", {"run.gas_step": 0.5 * run.coupling})


def _frames(scene: BedScene) -> Part:
    text, run = "close recording of frames", scene.run
    every = SPARSER * run.frames_every
    if run.end_time / every < FEWEST_FRAMES:
        return _not("output", text, f"the run would have fewer than {FEWEST_FRAMES} frames")
    part = _part("output", text, OFF, f"a frame every {every:g} s", {"run.frames_every": every})
    return replace(part, output=True)
