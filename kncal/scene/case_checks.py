"""What the values of a scene must satisfy together; checks yield (path of the key, what is wrong).

Only contradictions, and what no engine can run, are refused here. What is possible but unwise is found by
`kncal.scene.limits`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator

import numpy as np

from kncal.core.checks import Array, one_of
from kncal.core.errors import InputError
from kncal.physics.drag import DRAGS
from kncal.physics.laws import LAWS
from kncal.physics.material import Material
from kncal.physics.methods import METHODS
from kncal.physics.statistics import MIN_SAMPLES
from kncal.scene.bodies import AXES, RIGID
from kncal.scene.case_text import toml_value
from kncal.scene.metrics import COUPLED, FEW_PARTICLES, METRICS, offered, split_metric
from kncal.scene.needs import OVERRULABLE
from kncal.scene.placement import PLACEMENTS
from kncal.scene.scene import AT_REST, MOST_SINGLE, Particles, Scene
from kncal.scene.values import MOST_CELLS, NAME
from kncal.scene.walls import BoxWall, PlaneWall

Path = tuple[str | int, ...]
Problem = tuple[Path, str]

#: Solids fraction beyond which no random packing of equal spheres goes; lattices are looser.
DENSEST = 0.64


def problems(scene: Scene) -> list[Problem]:
    """Return everything that is wrong with a scene whose single values are of the right form."""
    found = [problem for check in _FIRST for problem in check(scene)]
    # the rest counts on materials and names
    return found or [problem for check in _CHECKS for problem in check(scene)]


def known_name(path: Path, value: str, allowed: Collection[str], label: str = "") -> Iterator[Problem]:
    """Yield a problem if ``value`` is not one of the ``allowed`` names."""
    try:
        one_of(label or str(path[-1]), value, allowed)
    except InputError as error:
        yield path, str(error)


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
    offer = offered(COUPLED if scene.coupled else FEW_PARTICLES)
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
        if choice.e_n is choice.friction is choice.v_0 is choice.k_n is None:
            yield path, "changes nothing: expected at least one of e_n, friction, v_0, k_n"
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


def _single(scene: Scene) -> Iterator[Problem]:
    """What bodies must be of which each is planned and observed by itself."""
    for name, group in scene.particles.items():
        for key, usual in (("place", "given"), ("count", None), ("seed", 1), ("frozen", False), ("settle_k_n", None)):
            if (value := getattr(group, key)) != usual:
                yield (
                    ("particles", name, key),
                    f"{key} = {toml_value(value)}: expected run.coupling [s] and a box with it",
                )
        yield from _one_of_two(name, group)
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


def _one_of_two(name: str, group: Particles) -> Iterator[Problem]:
    if group.position is not None and group.positions:
        yield ("particles", name, "position"), "given together with positions: expected one of them"


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


# --- coupled in intervals: one group of particles in one box


def _coupled(scene: Scene) -> Iterator[Problem]:
    """What can be run in coupling intervals: one group in one box, gravity downwards."""
    boxes = [name for name, wall in scene.walls.items() if isinstance(wall, BoxWall)]
    planes = [name for name, wall in scene.walls.items() if isinstance(wall, PlaneWall)]
    if len(boxes) != 1:
        yield (
            ("walls", *boxes[1:2]),
            f'{len(boxes)} walls of shape "box": expected exactly one with run.coupling: [walls.column] with '
            'shape = "box" and size = [width, depth, height]',
        )
    for name in planes:
        yield ("walls", name), 'a plane with run.coupling: expected only the wall of shape "box"'
    for name in list(scene.particles)[1:]:
        yield ("particles", name), "a second group with run.coupling: expected one group of equal spheres"
    for key, allowed in (("periodic", ((), ("y",))), ("layer", (None, "y"))):
        if (value := getattr(scene, key)) not in allowed:
            yield (key,), f"{key} = {toml_value(value)}: expected only y, the depth"
    if scene.periodic and scene.layer:
        yield ("layer",), "given together with periodic: expected one of them"
    x, y, z = scene.gravity
    if x or y or z > 0.0:
        yield ("gravity",), f"gravity = {list(scene.gravity)}: expected it downwards, [0, 0, -g], with run.coupling"


def _group(scene: Scene) -> Iterator[Problem]:
    """Numbers and places of the particles in the box."""
    (name, group), box = next(iter(scene.particles.items())), scene.box
    path: Path = ("particles", name)
    for key in ("velocity", "spin"):
        if getattr(group, key) != AT_REST:
            yield (*path, key), f"{key} = {list(getattr(group, key))}: expected none: particles start at rest in a box"
    for axis, size in zip(("width", "depth", "height"), box.size, strict=True):
        if size < group.diameter * (1.0 - 1e-9) and group.number:
            yield (
                ("walls", _box_name(scene), "size"),
                f"size = {list(box.size)}: {axis} = {size:g}: expected at least a particle's diameter, "
                f"{group.diameter:g} m",
            )
    yield from _one_of_two(name, group)
    if group.settle_k_n is not None and group.place != "settled":
        yield (*path, "settle_k_n"), f'given together with place = "{group.place}": expected "settled"'
    if group.place != "given":
        if group.centres:
            key = "positions" if group.position is None else "position"
            yield (*path, key), f'given together with place = "{group.place}": expected place = "given"'
        elif group.count is None:
            yield (*path, "count"), "missing: expected number of particles"
        volume = group.number * np.pi / 6.0 * group.diameter**3
        if volume > DENSEST * box.volume:
            share = volume / box.volume if box.volume > 0.0 else np.inf  # the product of small sides may be 0
            yield (
                (*path, "count"),
                f"count = {group.number}: fills {share:.3g} of the box: expected at most {DENSEST:g}",
            )
        return
    if group.count is None and not group.centres:
        yield (*path, "count"), "missing: expected number of particles, or position or positions of them"
    elif group.count not in (None, len(group.centres)):
        yield (*path, "positions"), f"{len(group.centres)} of them: expected as many as count, {group.count}"
    elif group.centres:
        yield from _places(scene, path, group, box)


def _places(scene: Scene, path: Path, group: Particles, box: BoxWall) -> Iterator[Problem]:
    """Yield given centres outside of the box, off the layer, or too close."""
    x = np.array(group.centres, dtype=np.float64)
    one = group.position is not None

    def at(k: int) -> tuple[Path, str]:
        return ((*path, "position"), "position") if one else ((*path, "positions", k), f"positions[{k}]")

    outside = ((x <= 0.0) | (x >= box.size)).any(axis=1)
    for k in np.flatnonzero(outside)[:3]:
        where, key = at(int(k))
        yield where, f"{key} = {x[k].tolist()}: expected a centre inside the box"
    off = np.flatnonzero(np.abs(x[:, 1] - 0.5 * box.depth) > 1e-9 * box.depth)
    if scene.layer and off.size:
        where, key = at(int(off[0]))
        yield where, f"{key}: y = {x[off[0], 1]:g}: expected {0.5 * box.depth:g}, the middle plane of the layer"
    for i, k in _too_close(x, 0.5 * group.diameter * (1.0 - 1e-12), box.depth if scene.periodic else 0.0):
        where, key = at(k)
        yield where, f"{key} = {x[k].tolist()}: overlaps positions[{i}] by more than a radius: expected less"


def _too_close(x: Array, limit: float, period: float = 0.0) -> list[tuple[int, int]]:
    """Return up to three pairs of rows of ``x`` (n, 3) that are closer than ``limit``; ``period`` in y, 0 for none.

    n particles in one place are n²/2 pairs. So first it is looked for two in one box whose diagonal is the limit; where
    each box holds one at most, few can be close to any.
    """
    boxes = np.floor(x * (math.sqrt(3.0) / limit))
    _, first, places = np.unique(boxes, axis=0, return_index=True, return_inverse=True)
    earlier = first[places.reshape(-1)]
    if len(shared := np.flatnonzero(earlier != np.arange(len(x)))):
        return [(int(earlier[k]), int(k)) for k in shared[:3]]
    from scipy.spatial import cKDTree

    if period:
        x = np.stack([x[:, 0], x[:, 1] % period, x[:, 2]], axis=1)
    return sorted(cKDTree(x, boxsize=np.array([0.0, period, 0.0])).query_pairs(limit))[:3]


def _calibrated(scene: Scene) -> Iterator[Problem]:
    """Yield what lacks for contacts to be calibrated: no first impact is known of particles that are placed later."""
    contact, group, coupling = scene.contact, scene.group, scene.run.coupling or 0.0
    if (measured := contact.measured) is not None:
        for key, what in (("start", "a first guess of v_0 [m/s]"), ("run_time", "the time to measure over [s]")):
            if getattr(measured, key) is None:
                yield ("contact", "measured", key), f"missing: expected {what}: a bed has no first impact"
        if measured.run_time is not None and measured.run_time < (least := 2 * MIN_SAMPLES * coupling):
            # at most half of a run is start-up
            yield (
                ("contact", "measured", "run_time"),
                f"run_time = {measured.run_time:g}: expected at least {2 * MIN_SAMPLES} couplings, {least:g} s",
            )
    elif group.number and (not group.frozen or group.place == "settled") and contact.v_0 is contact.k_n is None:
        yield (
            ("contact", "v_0"),
            "missing: expected the impact speed to calibrate at [m/s], typical of this bed (0.1 to 1 is usual), or a "
            "prescribed contact.k_n [N/m]: a bed has no first impact to take it from",
        )


def _gas(scene: Scene) -> Iterator[Problem]:
    gas, box = scene.gas, scene.box
    if gas is None:
        if not scene.group.number:
            yield ("particles",), "no particles and no gas: expected one of them"
        elif scene.group.frozen:
            yield ("particles", *scene.particles, "frozen"), "true, and no gas: nothing moves: expected [gas], or false"
        return
    yield from known_name(("gas", "drag"), gas.drag, DRAGS)
    if (cells := math.prod(gas.cells)) > MOST_CELLS:
        yield ("gas", "cells"), f"cells = {list(gas.cells)}: {cells} in all: expected at most {MOST_CELLS}"
    if scene.layer and gas.cells[1] != 1:
        yield (
            ("gas", "cells"),
            f"cells = {list(gas.cells)}: expected one cell in y with a layer, which has no gas motion in y",
        )
    if scene.density <= gas.density:
        yield ("gas", "density"), f"density = {gas.density:g}: expected less than the particles' {scene.density:g}"
    ways = {"U_0": gas.U_0 > 0.0, "ramp": bool(gas.ramp), "jet": gas.jet is not None}
    if sum(ways.values()) > 1:
        both = [name for name, used in ways.items() if used]
        yield ("gas", both[-1]), f"given together with {both[0]}: expected one of U_0, ramp and jet"
    times = np.array([point[0] for point in gas.ramp])
    if np.any(np.diff(times) <= 0.0):
        yield ("gas", "ramp"), f"ramp: times {times.tolist()}: expected them to increase"
    if (jet := gas.jet) is not None and not 0.0 <= jet.x_low < jet.x_high <= box.width * (1.0 + 1e-12):
        yield (
            ("gas", "jet", "x_high"),
            f"x_high = {jet.x_high:g}: expected above x_low = {jet.x_low:g} (at least 0) and at most the width, "
            f"{box.width:g} m",
        )


def _times(scene: Scene) -> Iterator[Problem]:
    run, end, coupling = scene.run, scene.run.until_time or math.inf, scene.run.coupling or 0.0
    if coupling > end:
        yield ("run", "coupling"), f"coupling = {coupling:g}: expected at most until_time, {end:g} s"
    if run.gas_step is not None and run.gas_step > coupling * (1.0 + 1e-9):
        yield (
            ("run", "gas_step"),
            f"gas_step = {run.gas_step:g}: expected at most the coupling interval, {coupling:g} s",
        )
    if run.discard is not None and run.discard >= end:
        yield ("run", "discard"), f"discard = {run.discard:g}: expected less than until_time, {end:g} s"
    if not scene.g and scene.group.place == "settled" and scene.group.number:
        yield (
            ("gravity",),
            'gravity: 0: nothing settles: expected gravity = [0.0, 0.0, -9.81], or place = "lattice" or "given"',
        )


def _by_kind(scene: Scene) -> Iterator[Problem]:
    if not scene.coupled:
        yield from _single(scene)
        return
    found = list(_coupled(scene))
    yield from found
    if not found:
        for check in (_group, _calibrated, _gas, _times):
            yield from check(scene)


def _box_name(scene: Scene) -> str:
    return next(name for name, wall in scene.walls.items() if isinstance(wall, BoxWall))


_FIRST: tuple[Callable[[Scene], Iterator[Problem]], ...] = (_materials, _names)
_CHECKS: tuple[Callable[[Scene], Iterator[Problem]], ...] = (
    _metrics_and_needs, _contact, _run, _by_kind, _exceptions,
)  # fmt: skip
