"""What the values of a scene in coupling intervals must satisfy together: one group of particles in one box.

See `kncal.scene.case_checks`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from kncal.core.checks import Array
from kncal.physics.drag import DRAGS
from kncal.physics.statistics import MIN_SAMPLES
from kncal.scene.case_text import toml_value
from kncal.scene.groups import AT_REST, Particles
from kncal.scene.problem import Path, Problem, first_speed, interval, known_name, one_of_two
from kncal.scene.scene import Scene
from kncal.scene.values import MOST_CELLS
from kncal.scene.walls import BoxWall, PlaneWall

#: Solids fraction beyond which no random packing of equal spheres goes; lattices are looser.
DENSEST = 0.64


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
        if size < scene.diameter * (1.0 - 1e-9) and scene.number:
            yield (
                ("walls", _box_name(scene), "size"),
                f"size = {list(box.size)}: {axis} = {size:g}: expected at least a particle's diameter, "
                f"{scene.diameter:g} m",
            )
    yield from one_of_two(name, group)
    if group.settle_k_n is not None and group.place != "settled":
        yield (*path, "settle_k_n"), f'given together with place = "{group.place}": expected "settled"'
    if group.place != "given":
        if group.centres:
            key = "positions" if group.position is None else "position"
            yield (*path, key), f'given together with place = "{group.place}": expected place = "given"'
        elif group.count is None:
            yield (*path, "count"), "missing: expected number of particles"
        volume = scene.number * np.pi / 6.0 * scene.diameter**3
        if volume > DENSEST * box.volume:
            share = volume / box.volume if box.volume > 0.0 else np.inf  # the product of small sides may be 0
            yield (
                (*path, "count"),
                f"count = {scene.number}: fills {share:.3g} of the box: expected at most {DENSEST:g}",
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
    for i, k in _too_close(x, 0.5 * scene.diameter * (1.0 - 1e-12), box.depth if scene.periodic else 0.0):
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
    group = scene.group
    if scene.contact.measured or (scene.number and (not group.frozen or group.place == "settled")):
        yield from first_speed(scene, MIN_SAMPLES * (scene.interval or 0.0))


def _gas(scene: Scene) -> Iterator[Problem]:
    gas, box = scene.gas, scene.box
    if gas is None:
        if not scene.number:
            yield ("particles",), "no particles and no gas: expected one of them"
        elif scene.frozen:
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
    run, coupling = scene.run, scene.run.coupling or 0.0
    yield from interval(scene, "coupling")
    if run.sample_every is not None:
        yield ("run", "sample_every"), "given together with coupling: expected one of the two"
    if run.gas_step is not None and run.gas_step > coupling * (1.0 + 1e-9):
        yield (
            ("run", "gas_step"),
            f"gas_step = {run.gas_step:g}: expected at most the coupling interval, {coupling:g} s",
        )
    if not scene.g and scene.group.place == "settled" and scene.number:
        yield (
            ("gravity",),
            'gravity: 0: nothing settles: expected gravity = [0.0, 0.0, -9.81], or place = "lattice" or "given"',
        )


def in_box(scene: Scene) -> Iterator[Problem]:
    """Yield what is wrong with a scene in coupling intervals."""
    found = list(_coupled(scene))
    yield from found
    if not found:
        for check in (_group, _calibrated, _gas, _times):
            yield from check(scene)


def _box_name(scene: Scene) -> str:
    return next(name for name, wall in scene.walls.items() if isinstance(wall, BoxWall))
