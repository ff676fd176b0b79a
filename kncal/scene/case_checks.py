"""What the values of a scene must satisfy together; checks yield (path of the key, what is wrong).

Only contradictions, and what no engine can run, are refused here. What is possible but unwise is found by
`kncal.scene.limits`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields

import numpy as np

from kncal.core.errors import InputError
from kncal.physics.laws import LAWS
from kncal.physics.material import Material
from kncal.physics.methods import METHODS
from kncal.physics.statistics import MIN_SAMPLES
from kncal.scene.bodies import AXES, RIGID
from kncal.scene.box_checks import in_box
from kncal.scene.case_text import toml_value
from kncal.scene.contact import PairChoice
from kncal.scene.granular_checks import granular
from kncal.scene.groups import ObserveChoice
from kncal.scene.metrics import METRICS, offered, split_metric
from kncal.scene.needs import OVERRULABLE
from kncal.scene.placement import PLACEMENTS
from kncal.scene.problem import Path, Problem, first_speed, interval, known_name, one_of_two
from kncal.scene.records import records_of
from kncal.scene.scene import MOST_SINGLE, Scene
from kncal.scene.values import NAME
from kncal.scene.walls import BoxWall, PlaneWall


def problems(scene: Scene) -> list[Problem]:
    """Return everything that is wrong with a scene whose single values are of the right form."""
    found = [problem for check in _FIRST for problem in check(scene)]
    # the rest counts on materials and names
    return found or [problem for check in _CHECKS for problem in check(scene)]


def _materials(scene: Scene) -> Iterator[Problem]:
    for name, data in scene.materials.items():
        if name == RIGID:
            yield ("materials", name), f"{RIGID!r} is the name for a rigid wall: expected another name"
        try:
            Material(name=name, **vars(data))
        except InputError as error:
            yield ("materials", name, str(error).partition(" = ")[0]), str(error)
    known = tuple(scene.materials)
    for name, group in scene.particles.items():
        yield from known_name(("particles", name, "material"), group.material, known)
        yield from known_name(("particles", name, "place"), group.place, PLACEMENTS)
    for name, wall in scene.walls.items():
        yield from known_name(("walls", name, "material"), wall.material, (*known, RIGID))


def _names(scene: Scene) -> Iterator[Problem]:
    # An exception may name a group, a wall or a material: a name that is two of them would be ambiguous.
    taken = {name: f"[materials.{name}]" for name in (*scene.materials, RIGID)}
    bodies = [("particles", name) for name in scene.particles] + [("walls", name) for name in scene.walls]
    for kind, name in bodies:
        if name in taken:
            yield (kind, name), f"name = {name!r} is taken by {taken[name]}: expected a name of its own"
        taken.setdefault(name, f"[{kind}.{name}]")
    if scene.coupled:
        return
    for name, group in scene.particles.items():  # of several particles each has a name
        own = [f"{name}.{i}" for i in range(1, len(group.centres) + 1)] if len(group.centres) > 1 else []
        for member in (m for m in own if m in taken):
            yield (
                ("particles", name),
                f"its {member!r} is called as {taken[member]}: expected a name of its own",
            )
        if own and not NAME.fullmatch(own[-1]):
            yield ("particles", name), f"a name for {len(own)} particles: expected at most 61 letters"


def _metrics_and_needs(scene: Scene) -> Iterator[Problem]:
    offer = offered(records_of(scene))
    for name in scene.tolerances:
        base, contact = split_metric(name)
        if not (base in offer and METRICS[base].each and contact in range(2, 100) and name == f"{base}_{contact}"):
            yield from known_name(("tolerances", name), name, offer, "metric")
    for name in scene.needs:
        yield from known_name(("needs", name), name, OVERRULABLE, "physics")


def _contact(scene: Scene) -> Iterator[Problem]:
    contact = scene.contact
    yield from known_name(("contact", "law"), contact.law, LAWS)
    yield from known_name(("contact", "method"), contact.method, METHODS)
    if contact.k_n is not None:
        if contact.options:
            yield ("contact", "options"), "given together with k_n: expected one of the two"
        if contact.measured is not None:
            yield ("contact", "k_n"), 'given together with v_0 = "measured": expected one of the two'
    elif contact.method in METHODS:
        try:
            METHODS[contact.method].options(contact.options)
        except InputError as error:
            yield ("contact", "options"), str(error)
    if scene.needs.get("history") is False:
        if contact.tangential_damping == "none":
            text = "there is no tangential_damping, so friction would have neither spring nor dashpot"
            yield ("needs", "history"), f'history = false: {text}: expected contact.tangential_damping = "liggghts"'
        if contact.rolling_model != "cdt":
            text = f'history = false with rolling_model = "{contact.rolling_model}", a spring: expected "cdt"'
            yield ("needs", "history"), text
    if contact.rolling_damping > 0.0 and contact.rolling_model != "epsd":
        why = f'has no meaning for rolling_model = "{contact.rolling_model}": leave it out, or take "epsd"'
        yield ("contact", "rolling_damping"), f"rolling_damping = {contact.rolling_damping:g}: {why}"
    if contact.law == "hertz":
        own: list[tuple[Path, float | None]] = [(("contact", "e_n"), contact.e_n)]
        own += [(("contact", "pairs", i, "e_n"), choice.e_n) for i, choice in enumerate(contact.pairs)]
        for path, e_n in own:
            if e_n not in (None, 1.0):
                yield path, f'e_n = {e_n:g} with law "hertz", which has no damping: expected 1, or law = "tsuji"'


def _exceptions(scene: Scene) -> Iterator[Problem]:
    if not scene.coupled and len(scene.spheres) > MOST_SINGLE:
        return  # `_single` refuses them
    spheres, walls = [set(s.names) for s in scene.spheres], [set(w.names) for w in scene.planes]
    known = sorted({*scene.particles, *scene.walls}.union(*spheres, *walls))
    for i, choice in enumerate(scene.contact.pairs):
        path: Path = ("contact", "pairs", i)
        unknown = [name for name in choice.between if name not in known]
        for name in unknown:
            yield from known_name((*path, "between"), name, known)
        keys = [f.name for f in fields(PairChoice) if f.name != "between"]
        if all(getattr(choice, key) is None for key in keys):
            yield path, f"changes nothing: expected at least one of {', '.join(keys)}"
        one, two = choice.between
        # a sphere that stands for its group meets its own kind
        meet = any(
            (one in a and two in b) or (two in a and one in b)
            for k, a in enumerate(spheres)
            for b in (*spheres[k if scene.coupled else k + 1 :], *walls)
        )
        if not unknown and not meet:
            yield (
                (*path, "between"),
                f"between = {list(choice.between)!r}: expected names of two bodies that can touch (two particles, or "
                "a particle and a wall), or of their groups or materials",
            )


def _run(scene: Scene) -> Iterator[Problem]:
    run = scene.run
    given = [key for key in ("until_time", "until_bounces") if getattr(run, key) is not None]
    if len(given) != 1:
        found = "both are given" if given else "neither is given"
        yield (
            ("run", *given[1:]),
            f"{found}: expected exactly one of until_time [s] and until_bounces (number of contacts)",
        )
    usual: dict[str, float | None] = {"until_bounces": None, "dt": None, "record_every": 1}
    if not scene.coupled:
        usual = {"gas_step": None, "discard": None, "frames_every": 0.01}
    for key, value in usual.items():
        if getattr(run, key) != value:
            needed = "a run that is coupled in intervals" if scene.coupled else "a run without run.coupling"
            yield ("run", key), f"{key} = {getattr(run, key)}: has no meaning for {needed}: leave it out"


def _many_only(scene: Scene) -> Iterator[Problem]:
    """Yield what only a scene of many particles without gas may say."""
    needed = "expected run.sample_every [s] with it, for many particles without gas"
    for name, group in scene.particles.items():
        for key in ("sizes", "mass", "fill", "file", "region", "rate", "start"):
            if getattr(group, key):
                yield ("particles", name, key), f"{key}: {needed}"
        if group.place == "stream":
            yield ("particles", name, "place"), f'place = "stream": {needed}'
        if group.diameter is None and not group.sizes:
            yield ("particles", name, "diameter"), "missing: expected a diameter [m]"
    for name, wall in scene.walls.items():
        if not isinstance(wall, (PlaneWall, BoxWall)):
            yield ("walls", name, "shape"), f'shape = "{wall.shape}": {needed}'
        elif not wall.stays_whole or (isinstance(wall, BoxWall) and any(wall.low)):
            key = next(
                key for key in ("motion", "surface_velocity", "remove_at", "low") if any_of(getattr(wall, key, None))
            )
            yield ("walls", name, key), f"{key}: {needed}"
    for key in ("outlets", "domain"):
        if getattr(scene, key):
            yield (key,), f"{key}: {needed}"
    if scene.observe != ObserveChoice():
        yield ("observe",), f"observe: {needed}"


def any_of(value: object) -> bool:
    """Return whether a value is given: not None, nor a vector of zeros."""
    return any(value) if isinstance(value, tuple) else value is not None


def _single(scene: Scene) -> Iterator[Problem]:
    """What bodies must be of which each is planned and observed by itself."""
    for name, group in scene.particles.items():
        for key, usual in (("place", "given"), ("count", None), ("seed", 1), ("frozen", False), ("settle_k_n", None)):
            if (value := getattr(group, key)) != usual:
                yield (
                    ("particles", name, key),
                    f"{key} = {toml_value(value)}: expected run.coupling [s] and a box with it",
                )
        yield from one_of_two(name, group)
        if not group.centres:
            yield ("particles", name), "position: missing: expected position = [x, y, z] of the centre [m]"
    for name, wall in scene.walls.items():
        if isinstance(wall, BoxWall):
            yield (
                ("walls", name, "shape"),
                'shape = "box": expected run.coupling [s] with it, or planes',
            )
    for key in ("gas", "layer", "periodic"):
        if getattr(scene, key):
            yield (key,), f'{key}: expected run.coupling [s], and a wall of shape "box", with it'
    if (number := len(scene.spheres)) > MOST_SINGLE:
        yield (
            ("particles",),
            f"{number} particles, each of which is planned and observed by itself: expected at most {MOST_SINGLE}, or "
            "run.coupling [s] for a box of many",
        )
        return
    if number == 1 and not scene.walls:
        yield (
            ("particles",),
            "a single particle and no wall: nothing can touch, so there is no contact to calibrate: expected a second "
            "particle or a wall",
        )
    yield from _apart(scene)


def _apart(scene: Scene) -> Iterator[Problem]:
    """Yield centres on a wall, walls in one place, and spheres that overlap by more than a radius."""
    at: list[Path] = [
        ("particles", name, "position") if group.position is not None else ("particles", name, "positions", i)
        for name, group in scene.particles.items()
        for i in range(len(group.centres))
    ]
    spheres = scene.spheres
    centres = np.array([s.position for s in spheres], dtype=np.float64).reshape(-1, 3)
    radii = np.array([s.radius for s in spheres])
    planes = scene.planes
    for i, wall in enumerate(planes):
        twins = [other.name for other in planes[:i] if (other.axis, other.position) == (wall.axis, wall.position)]
        if twins:
            yield ("walls", wall.name, "position"), f"the same plane as wall {twins[0]!r}: expected another plane"
        distances = np.abs(centres[:, AXES.index(wall.axis)] - wall.position)
        for k in np.flatnonzero(distances == 0.0):
            yield (
                at[int(k)],
                f"position = {list(spheres[int(k)].position)}: the centre lies on the plane of wall {wall.name!r}: "
                "expected it on one side of the wall",
            )
    for i in range(len(radii) - 1):
        overlaps = radii[i] + radii[i + 1 :] - np.linalg.norm(centres[i + 1 :] - centres[i], axis=1)
        smaller = np.minimum(radii[i], radii[i + 1 :])
        for k in np.flatnonzero(overlaps >= smaller):
            other = i + 1 + int(k)
            yield (
                at[other],
                f"position = {list(spheres[other].position)}: overlaps {spheres[i].name!r} by {overlaps[k]:.6g} m: "
                f"expected less than the smaller radius, {smaller[k]:g} m",
            )


def _by_kind(scene: Scene) -> Iterator[Problem]:
    if scene.coupled and scene.run.coupling is None:
        yield from granular(scene)
        yield from first_speed(scene, MIN_SAMPLES * (scene.interval or 0.0))
        yield from interval(scene, "sample_every")
        return
    if other := list(_many_only(scene)):
        yield from other
        return
    if not scene.coupled:
        yield from _single(scene)
        return
    yield from in_box(scene)


_FIRST: tuple[Callable[[Scene], Iterator[Problem]], ...] = (_materials, _names)
_CHECKS: tuple[Callable[[Scene], Iterator[Problem]], ...] = (
    _metrics_and_needs, _contact, _run, _by_kind, _exceptions,
)  # fmt: skip
