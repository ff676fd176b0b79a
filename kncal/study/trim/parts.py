"""The optional parts of a scene's physics: what each is, how it is switched, and whether it has a meaning here.

A pure function of the scene. What the scene has is tried off; what it leaves out is tried on, so that an omission that
matters is found too. A value of no such order (the drag law) is exchanged for the other one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from kncal.core.checks import one_of
from kncal.core.registry import Registry
from kncal.physics.drag import DRAGS
from kncal.scene.contact_limits import FEWEST_FRAMES
from kncal.scene.needs import decide, untouched_walls
from kncal.scene.scene import PARCELS, Scene
from kncal.study.trim.trim import OFF, ON, OTHER, Part
from kncal.study.variants import Changes

#: Frames are tried this many times as far apart.
SPARSER = 4
#: Metrics of a bed that grow with its depth, or belong to a grid of that depth.
OF_THE_DEPTH = ("kinetic_energy", "contacts", "bubble_number", "eps_g")


@dataclass(frozen=True, kw_only=True)
class PartKind:
    """A kind of part that a scene may have.

    Attributes
    ----------
    name : what ``--parts`` calls it
    find : from a scene and its contact model to the parts of this kind
    coupled : True: only coupled scenes have it; False: only the others; None: all
    """

    name: str
    find: Callable[[Scene, str], Iterable[Part]]
    coupled: bool | None = None


def parts_of(scene: Scene, model: str, groups: Iterable[str] | None = None) -> tuple[Part, ...]:
    """Return the optional parts of ``scene``, run with the contact ``model``; ``groups``: only these.

    Raises
    ------
    InputError
        If a group is not one of this kind of case.
    """
    offered = [name for name, kind in PARTS.items() if kind.coupled in (None, scene.coupled)]
    wanted = offered if groups is None else [one_of("part", name, offered) for name in groups]
    return tuple(part for name in offered if name in wanted for part in PARTS[name].find(scene, model))


def _part(name: str, text: str, change: str, tried: str, changes: Changes | None = None, *, model: str = "") -> Part:
    return Part(name=name, group=name, text=text, change=change, tried=tried, changes=changes or {}, model=model)


def _not(name: str, text: str, why: str) -> Part:
    return Part(name=name, group=name, text=text, change=OFF, tried="", why_not=why)


def _friction(name: str, text: str) -> Callable[[Scene, str], Iterator[Part]]:
    """Forced off where it is used, on where there is something to force."""

    def find(scene: Scene, _: str) -> Iterator[Part]:
        contact, needs = scene.contact, decide(scene)
        frictions = [contact.friction, *(c.friction for c in contact.pairs if c.friction is not None)]
        rollings = [contact.rolling_friction, *(c.rolling_friction or 0.0 for c in contact.pairs)]
        coefficients = {"tangential": max(frictions), "rolling": max(rollings)}
        if coefficients[name] == 0.0:
            yield _not(name, text, "its coefficient is 0 in every contact")
        elif needs.uses(name):  # without the tangential spring nothing is set rolling, so rolling friction goes with it
            yield _part(name, text, OFF, f"without {text}", {f"needs.{name}": False})
        else:
            # one at a time: what can be set rolling by it would get rolling friction as well
            alone = name == "tangential" and coefficients["rolling"] > 0.0 and not needs.uses("rolling")
            others = {"needs.rolling": False} if alone else {}
            yield _part(name, text, ON, f"with {text}", {f"needs.{name}": True, **others})

    return find


def _damping(scene: Scene, _: str) -> Iterator[Part]:
    text, contact = "damping of contacts", scene.contact
    rows = [i for i, choice in enumerate(contact.pairs) if choice.e_n not in (None, 1.0)]
    if contact.e_n == 1.0 and not rows:
        yield _not("damping", text, "e_n is 1 in every contact")
        return
    changes = {f"contact.pairs.{i}.e_n": 1.0 for i in rows}
    changes |= {"contact.e_n": 1.0} if contact.e_n != 1.0 else {}
    yield _part("damping", text, OFF, "e_n = 1 in every contact", changes)


def _tangential_damping(scene: Scene, _: str) -> Iterator[Part]:
    name, text, key = "tangential_damping", "tangential damping", "contact.tangential_damping"
    needs = decide(scene)
    if needs.uses(name):
        yield _part(name, text, OFF, f"without {text}", {key: "none"})
    elif needs.uses("tangential") and needs.uses("damping"):
        yield _part(name, text, ON, f"{text} as in LIGGGHTS", {key: "liggghts"})
    else:
        yield _not(name, text, "there is no tangential force, or no damping")


def _history(scene: Scene, _: str) -> Iterator[Part]:
    name, text, needs = "history", "tangential spring with its memory", decide(scene)
    if not needs.uses("tangential"):
        yield _not(name, text, "there is no tangential force")
    elif not needs.uses("tangential_damping"):
        yield _not(name, text, "without tangential damping there is no friction but by the spring")
    elif needs.uses("rolling") and scene.contact.rolling_model != "cdt":
        yield _not(name, text, f"the rolling model {scene.contact.rolling_model} needs it")
    elif needs.uses(name):
        yield _part(name, text, OFF, "friction by a dashpot alone", {"needs.history": False})
    else:
        yield _part(name, text, ON, f"with the {text}", {"needs.history": True})


def _cohesion(scene: Scene, _: str) -> Iterator[Part]:
    key, contact = "cohesion_energy_density", scene.contact
    rows = [i for i, choice in enumerate(contact.pairs) if choice.cohesion_energy_density]
    if contact.cohesion_energy_density == 0.0 and not rows:
        yield _not("cohesion", "cohesion", "its energy density is 0 in every contact")
        return
    changes: Changes = {f"contact.pairs.{i}.{key}": 0.0 for i in rows} | {f"contact.{key}": 0.0}
    yield _part("cohesion", "cohesion", OFF, "without cohesion", changes)


def _contact_model(_: Scene, model: str) -> Iterator[Part]:
    change, other, name = (OFF, "linear", "linear") if model == "hertz" else (ON, "hertz", "Hertz")
    yield _part("contact_model", "Hertz contact", change, f"the {name} contact", model=other)


def _walls(scene: Scene, _: str) -> Iterator[Part]:
    text = "walls that nothing touches"
    if names := untouched_walls(scene):
        yield _part("walls", text, OFF, f"without {', '.join(names)}", {f"walls.{name}": None for name in names})
    else:
        yield _not("walls", text, "every wall can be touched" if scene.walls else "the scene has no walls")


def _sizes(scene: Scene, _: str) -> Iterator[Part]:
    """One size in place of several: the Sauter mean of each group, with as much mass."""
    text, changes = "the distribution of sizes", dict[str, Any]()
    for name, group in scene.particles.items():
        if group.sizes is not None:
            one = replace(scene, particles={name: group})
            key = f"particles.{name}"
            changes |= {f"{key}.sizes": None, f"{key}.diameter": one.diameter}
            count = round(one.volume / (math.pi / 6.0 * one.diameter**3))
            changes |= {f"{key}.count": count} if group.count is not None else {}
    if changes:
        yield _part("sizes", text, OFF, "one size in each group, the Sauter mean", changes)
    else:
        yield _not("sizes", text, "every group has one size")


def _front_back(scene: Scene, _: str) -> Iterator[Part]:
    text, found = "front and back walls", scene.front_back
    if scene.run.coupling is None:
        yield _not("front_back", text, "the particles are not in one box")
    elif found == "layer":
        yield _not("front_back", text, "one layer of particles, held in its plane")
    elif found == "walls":
        yield _part("front_back", text, OFF, "periodic in depth", {"periodic": ["y"]})
    else:
        yield _part("front_back", text, ON, "walls in front and at the back", {"periodic": None})


def _depth(scene: Scene, _: str) -> Iterator[Part]:
    """One layer of particles, with as many of them per floor area."""
    if not scene.coupled:
        why = f"LIGGGHTS computes in three dimensions always; {decide(scene).dimensions_reason}"
        yield _not("depth", "third dimension", why)
        return
    if scene.run.coupling is None:
        yield _not("depth", "third dimension", "the particles are not in one box")
        return
    text, box, group, d = "depth of the bed", scene.box, scene.group, scene.diameter
    count = round(scene.number * d / box.depth)
    why_not = {
        "the bed is one layer of particles already": scene.layer is not None,
        "fewer than two particles": scene.number < 2,
        "the positions of the particles are given, in three dimensions": group.place == "given",
        "the bed is hardly deeper than a particle": count < 2 or box.depth < 1.5 * d,
    }
    if why := next((why for why, is_so in why_not.items() if is_so), ""):
        yield _not("depth", text, why)
        return
    (beads,), (column,) = scene.particles, scene.walls
    layer: dict[str, Any] = {
        "layer": "y",
        f"walls.{column}.size": [box.width, d, box.height],
        f"particles.{beads}.count": count,
    }
    layer |= {"periodic": None} if scene.periodic else {}
    layer |= {} if scene.gas is None else {"gas.cells": [scene.gas.cells[0], 1, scene.gas.cells[2]]}
    lost = dict.fromkeys(OF_THE_DEPTH, "goes with the depth of the bed, or belongs to its grid")
    yield replace(_part("depth", text, OFF, f"one layer of {count} particles", layer), lost=lost)


def _gas(scene: Scene, _: str) -> Iterator[Part]:
    if why := _no_gas(scene):
        yield _not("gas", "gas", why)
    elif not scene.number or scene.frozen:
        yield _not("gas", "gas", "nothing else moves")
    else:
        step = {"run.gas_step": None} if scene.run.gas_step is not None else {}
        yield _part("gas", "gas", OFF, "particles only", {"gas": None, **step})


def _no_gas(scene: Scene) -> str:
    """Why a scene has no gas; empty if it has."""
    return "" if scene.gas is not None else "the case has no [gas]"


def _no_force(scene: Scene) -> str:
    """Why a scene has no force of the gas on particles; empty if it has."""
    return _no_gas(scene) or ("" if scene.number else "there are no particles")


def _drag(scene: Scene, _: str) -> Iterator[Part]:
    text = "drag law"
    if (why := _no_force(scene)) or scene.gas is None:
        yield _not("drag", text, why)
        return
    other = next(name for name in DRAGS if name != scene.gas.drag)
    yield _part("drag", f"{text} {scene.gas.drag}", OTHER, f"drag by {other}", {"gas.drag": other})


def _smoothing(scene: Scene, _: str) -> Iterator[Part]:
    text = "smoothing of the void fraction"
    if (why := _no_force(scene)) or scene.gas is None:
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


def _gas_step(scene: Scene, _: str) -> Iterator[Part]:
    text, run = "finer gas step", scene.run
    if (why := _no_gas(scene)) or run.coupling is None:
        yield _not("gas_step", text, why)
    elif run.gas_step is not None and run.gas_step < run.coupling:
        yield _part("gas_step", text, OFF, "one gas step per coupling interval", {"run.gas_step": None})
    else:
        yield _part("gas_step", text, ON, "two gas steps per coupling interval", {"run.gas_step": 0.5 * run.coupling})


def _output(scene: Scene, _: str) -> Iterator[Part]:
    run = scene.run
    if scene.coupled:
        every = SPARSER * run.frames_every
        text, of, frames, key = "frames", "the run", (run.until_time or 0.0) / every, "run.frames_every"
        how = f"{every:g} s"
    else:
        every = SPARSER * run.record_every
        text, of, frames, key = "contacts", "a contact", run.steps_per_contact / every, "run.record_every"
        how = f"{every} steps of a contact"
    text = f"close recording of {text}"
    if frames < FEWEST_FRAMES:
        yield _not("output", text, f"{of} would have fewer than {FEWEST_FRAMES} frames")
    else:
        yield replace(_part("output", text, OFF, f"a frame every {how}", {key: every}), output=True)


PARTS = Registry(
    "part",
    PartKind,
    PartKind(name="tangential", find=_friction("tangential", "tangential spring and friction")),
    PartKind(name="rolling", find=_friction("rolling", "rolling friction")),
    PartKind(name="tangential_damping", find=_tangential_damping),
    PartKind(name="history", find=_history),
    PartKind(name="cohesion", find=_cohesion),
    PartKind(name="damping", find=_damping),
    PartKind(name="contact_model", find=_contact_model),
    PartKind(name="walls", find=_walls, coupled=False),
    PartKind(name="sizes", find=_sizes, coupled=True),
    PartKind(name="front_back", find=_front_back, coupled=True),
    PartKind(name="depth", find=_depth),
    PartKind(name="gas", find=_gas),
    PartKind(name="drag", find=_drag, coupled=True),
    PartKind(name="smoothing", find=_smoothing, coupled=True),
    PartKind(name="gas_step", find=_gas_step, coupled=True),
    PartKind(name="output", find=_output),
)
