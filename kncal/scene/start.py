"""The particles at the start of a run, as far as it takes no solver: groups in their regions, or as the case says."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.scene.bodies import AXES
from kncal.scene.filling import fill
from kncal.scene.groups import BoxRegion
from kncal.scene.placement import PLACEMENTS, Start
from kncal.scene.scene import Scene
from kncal.scene.shapes import distance_to


def start_of(scene: Scene, rested: Start | None = None) -> Start:
    """Return the particles as they are placed; those of streams are not among them.

    ``rested``: those that have settled, and the frozen ones among them; None: nothing has settled yet.

    Raises
    ------
    InputError
        If there is no room for them, or the case gives them wrongly.
    ReadError
        If a file of the case cannot be read.
    """
    if scene.run.coupling is not None:
        return Start.at(PLACEMENTS.find(scene.group.place).place(scene))
    found: list[Start] = []
    for name, group in scene.particles.items():
        if rested is not None and (group.place == "settled" or group.frozen):
            found.append(_of_group(scene, rested, name))
        else:
            found.extend(_group(scene, name, _joined([*found, *([rested] if rested else [])])))
    start = _joined(found)
    _check(scene, start)
    return start


def _check(scene: Scene, start: Start) -> None:
    """Refuse particles that the case gives outside of the domain, or in one another by more than a radius."""
    from scipy.spatial import cKDTree

    low, high = scene.extent
    outside = np.flatnonzero(((start.x < low) | (start.x > high)).any(axis=1))
    if len(outside):
        k = int(outside[0])
        raise InputError(
            f"{scene.name}: {len(outside)} particles start outside the domain {low.tolist()} to {high.tolist()} m, the "
            f"first of {scene.classes[start.kind[k]].name} at {start.x[k].tolist()}: expected all inside, or a larger "
            "[domain]"
        )
    radii = 0.5 * np.array([c.diameter for c in scene.classes])[start.kind]
    periods = np.array([high[k] - low[k] if axis in scene.periodic else 0.0 for k, axis in enumerate(AXES)])
    inside = np.where(periods > 0.0, (start.x - low) % np.where(periods > 0.0, periods, 1.0), start.x - low)
    pairs = cKDTree(inside, boxsize=periods).query_pairs(2.0 * float(radii.max(initial=0.0)), output_type="ndarray")
    apart = inside[pairs[:, 0]] - inside[pairs[:, 1]]
    apart -= periods * np.round(apart / np.where(periods > 0.0, periods, np.inf))
    one, other = radii[pairs[:, 0]], radii[pairs[:, 1]]
    deep = np.flatnonzero(one + other - np.linalg.norm(apart, axis=1) >= np.minimum(one, other))
    if len(deep):
        i, j = pairs[deep[0]].tolist()
        raise InputError(
            f"{scene.name}: {len(deep)} pairs of particles start in one another by a radius or more, the first at "
            f"{start.x[i].tolist()} and {start.x[j].tolist()}: expected less"
        )
    _check_walls(scene, start, radii)


def _check_walls(scene: Scene, start: Start, radii: Array) -> None:
    """Refuse particles that move and start in a wall by more than half their radius: it would throw them out."""
    held = np.array([scene.particles[c.group].frozen for c in scene.classes])[start.kind]
    for name, wall in scene.walls.items():
        deep = np.flatnonzero(
            (distance_to(wall, start.x, path_of=scene.path_of, open_axes=scene.open_axes) < 0.5 * radii) & ~held
        )
        if len(deep):
            k = int(deep[0])
            raise InputError(
                f"{scene.name}: {len(deep)} particles start in walls.{name} by more than half their radius, the first "
                f"of {scene.classes[start.kind[k]].name} at {start.x[k].tolist()}: expected less"
            )


def _of_group(scene: Scene, start: Start, name: str) -> Start:
    rows = np.array([c.group == name for c in scene.classes])[start.kind]
    return Start(x=start.x[rows], v=start.v[rows], spin=start.spin[rows], kind=start.kind[rows])


def _group(scene: Scene, name: str, there: Start) -> Iterator[Start]:
    """Yield a group, if it is there at the start, beside the particles that are ``there`` already."""
    group = scene.particles[name]
    own = [(i, c) for i, c in enumerate(scene.classes) if c.group == name]
    kind = np.repeat([i for i, _ in own], [c.number for _, c in own])
    if group.place == "stream":
        return
    if group.file is not None:
        given = scene.from_files[name]
        yield Start(x=given.particles.x, v=given.particles.v, spin=given.particles.spin, kind=own[0][0] + given.kind)
        return
    if group.place == "given":
        x = np.array(group.centres, dtype=np.float64)
    else:
        radii = 0.5 * np.array([c.diameter for c in scene.classes])
        region = group.region or BoxRegion(low=scene.box.low, high=scene.box.high)
        periods = {axis: (scene.extent[0][axis], scene.extent[1][axis]) for axis in map(AXES.index, scene.periodic)}
        taken = (there.x, radii[there.kind])
        pressed = scene.presses and group.place == "settled"
        x = fill(region, radii[kind], group.seed, free=_free(scene), periods=periods, taken=taken, pressed=pressed)
    each = np.ones((len(x), 1))
    yield Start(x=x, v=each * np.array(group.velocity), spin=each * np.array(group.spin), kind=kind)


def _free(scene: Scene) -> Callable[[Array, Array], NDArray[np.bool_]]:
    """Return what tells whether spheres at points (n, 3) with radii (n,) touch no wall."""

    def free(points: Array, radii: Array) -> NDArray[np.bool_]:
        found = np.ones(len(points), dtype=bool)
        for wall in scene.walls.values():
            found &= distance_to(wall, points, path_of=scene.path_of, open_axes=scene.open_axes) >= radii
        return found

    return free


def _joined(parts: Sequence[Start]) -> Start:
    none = np.zeros((0, 3))
    x, v, spin = (np.concatenate([none, *(getattr(part, name) for part in parts)]) for name in ("x", "v", "spin"))
    kind = np.concatenate([np.zeros(0, dtype=np.intp), *(part.kind for part in parts)])
    return Start(x=x, v=v, spin=spin, kind=kind)
