"""What the values of a scene of many particles without gas must satisfy together; see `kncal.scene.case_checks`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kncal.core.errors import CaseFileError, InputError, ReadError
from kncal.scene.bodies import AXES
from kncal.scene.groups import MOST_PARTICLES, Particles
from kncal.scene.problem import Path, Problem
from kncal.scene.scene import Scene
from kncal.scene.walls import WALLS, BoxWall, PlaneWall


def granular(scene: Scene) -> Iterator[Problem]:
    """Yield what is wrong with a scene that goes on in intervals, without gas."""
    for key in ("gas", "layer"):
        if getattr(scene, key):
            yield (key,), f"{key}: has no meaning with run.sample_every: expected run.coupling with it"
    for name, group in scene.particles.items():
        yield from _group(scene, ("particles", name), group)
    for name, wall in scene.walls.items():
        yield from ((("walls", name, *path), text) for path, text in WALLS[wall.shape].problems(wall))
    found = list(_domain(scene))
    yield from found
    if not found:  # sizes and bounds are known
        yield from _boxes(scene)
        yield from _twins(scene)
        yield from _too_large(scene)


def _group(scene: Scene, path: Path, group: Particles) -> Iterator[Problem]:
    if group.file is None and (group.diameter is None) == (group.sizes is None):
        found = "both are given" if group.sizes else "neither is given"
        yield (*path, "diameter"), f"{found}: expected either a diameter or sizes"
    if group.frozen and (scene.frozen or group.place not in ("given", "lattice")):
        yield (
            (*path, "frozen"),
            f'true, with place = "{group.place}": expected "given" or "lattice", and another group that moves',
        )
    numbers = [key for key in ("count", "mass", "fill") if getattr(group, key) is not None]
    if group.place == "given":
        if bool(group.centres) == (group.file is not None):
            yield path, 'position: expected one of position, positions and file with place = "given"'
        for key in ("velocity", "spin"):
            if group.file is not None and any(getattr(group, key)):
                yield (*path, key), f"{key}: given together with file: expected it in columns of the file"
        if numbers and not (numbers == ["count"] and group.count == len(group.centres)):
            yield (*path, numbers[0]), f"{numbers[0]}: given together with where each particle is: leave it out"
    else:
        for key in ("file", "position", "positions"):
            if getattr(group, key):
                yield (*path, key), f'given together with place = "{group.place}": expected place = "given"'
        if len(numbers) != 1:
            yield path, f"{' and '.join(numbers) or 'none'} given: expected one of count, mass and fill"
        yield from _placed(scene, path, group)
    yield from _by_place(scene, path, group)


def _by_place(scene: Scene, path: Path, group: Particles) -> Iterator[Problem]:
    """Yield what belongs to another way of placing."""
    if group.scale != 1.0 and group.file is None:
        yield (*path, "scale"), "given without file: expected the file whose unit of length it is"
    for key, place in (("rate", "stream"), ("start", "stream"), ("settle_k_n", "settled")):
        if group.place != place and getattr(group, key):
            yield (*path, key), f'given together with place = "{group.place}": expected "{place}"'
    if group.place == "stream" and group.rate is None:
        yield (*path, "rate"), "missing: expected the mass per time of the stream [kg/s]"
    for key in ("velocity", "spin"):
        if group.place == "settled" and any(getattr(group, key)):
            yield (*path, key), f"{key} = {list(getattr(group, key))}: expected none: settled particles are at rest"
    if group.place == "settled" and not (scene.g or scene.presses):
        yield (
            ("gravity",),
            'gravity: 0: nothing settles: expected gravity, place = "lattice" or "given", or all three axes periodic, '
            "where particles are pressed together",
        )


def _placed(scene: Scene, path: Path, group: Particles) -> Iterator[Problem]:
    """Yield what lacks for a group to be put into its region."""
    boxes = [wall for wall in scene.walls.values() if isinstance(wall, BoxWall)]
    if group.region is None and len(boxes) != 1:
        yield (*path, "region"), 'missing: expected [particles.NAME.region], or one wall of shape "box" to be put into'
    if group.fill is not None and group.region is None:
        yield (*path, "fill"), "given without region: expected the region whose volume it is a share of"
    if group.region is not None:
        low, high = group.region.bounds
        if not (low < high).all():
            yield (
                (*path, "region"),
                f"region: from {low.tolist()} to {high.tolist()}: expected every high above its low",
            )


def _too_large(scene: Scene) -> Iterator[Problem]:
    """Yield particles that are larger than the region they are put into."""
    for name, group in scene.particles.items():
        if group.region is None:
            continue
        low, high = group.region.bounds
        largest = max(c.diameter for c in scene.classes if c.group == name)
        if largest > float((high - low).min()) * (1.0 + 1e-9):
            key = "diameter" if group.sizes is None else "sizes"
            yield (
                ("particles", name, key),
                f"{key}: {largest:g} m is more than the {float((high - low).min()):g} m of their region: expected "
                "smaller particles (4 mm is 4e-3), or a larger region",
            )


def _twins(scene: Scene) -> Iterator[Problem]:
    """Yield names and planes that are there twice, and belts that leave their plane."""
    taken = {name: f"[particles.{name}]" for name in scene.particles} | {n: f"[walls.{n}]" for n in scene.walls}
    for name in scene.outlets:
        if name in taken:
            yield ("outlets", name), f"name = {name!r} is taken by {taken[name]}: expected a name of its own"
    for group in scene.particles:
        for found in (c.name for c in scene.classes if c.group == group and c.name != group and c.name in taken):
            yield ("particles", group), f"its size {found!r} is called as {taken[found]}: expected a name of its own"
    planes: dict[tuple[str, float], str] = {}
    for name, wall in scene.walls.items():
        if not isinstance(wall, PlaneWall):
            continue
        if wall.surface_velocity[AXES.index(wall.axis)]:
            yield (
                ("walls", name, "surface_velocity"),
                f"surface_velocity = {list(wall.surface_velocity)}: expected none in {wall.axis}, along its normal",
            )
        if (other := planes.setdefault((wall.axis, wall.position), name)) != name:
            yield ("walls", name, "position"), f"the same plane as wall {other!r}: expected another plane"


def _boxes(scene: Scene) -> Iterator[Problem]:
    """Yield boxes that do not fill a period: they have no walls there."""
    for name, wall in scene.walls.items():
        if not isinstance(wall, BoxWall):
            continue
        for k in map(AXES.index, scene.periodic):
            low, high = scene.extent[0][k], scene.extent[1][k]
            if abs(wall.low[k] - low) > 1e-9 * (high - low) or abs(wall.high[k] - high) > 1e-9 * (high - low):
                yield (
                    ("walls", name, "size"),
                    f"from {wall.low[k]:g} to {wall.high[k]:g} m in {AXES[k]}, which is periodic from {low:g} to "
                    f"{high:g} m: expected a box that fills it",
                )


def _domain(scene: Scene) -> Iterator[Problem]:
    """Yield periods that nothing tells, sizes that cannot be read, and a domain that is none."""
    if scene.domain is not None and not (np.array(scene.domain.low) < np.array(scene.domain.high)).all():
        yield ("domain", "high"), f"high = {list(scene.domain.high)}: expected above low = {list(scene.domain.low)}"
    boxes = [wall for wall in scene.walls.values() if isinstance(wall, BoxWall)]
    if scene.periodic and scene.domain is None and len(boxes) != 1:
        yield ("periodic",), 'given without a domain: expected [domain] with low and high, or one wall of shape "box"'
    if len(set(scene.periodic)) < len(scene.periodic):
        yield ("periodic",), f"periodic = {list(scene.periodic)}: expected each axis once"
    try:
        classes = scene.classes
    except (ReadError, CaseFileError, InputError) as error:
        yield ("particles",), str(error)
        return
    for name in scene.particles:
        if not sum(c.number for c in classes if c.group == name):
            yield ("particles", name), "not one particle: expected a larger count, mass or fill, or to leave it out"
    if (number := scene.number) > MOST_PARTICLES:
        yield ("particles",), f"{number} particles: expected at most {MOST_PARTICLES}"
    for name, outlet in scene.outlets.items():
        k = AXES.index(outlet.axis)
        if not scene.extent[0][k] < outlet.position < scene.extent[1][k]:
            yield (
                ("outlets", name, "position"),
                f"position = {outlet.position:g}: expected it inside the domain, between {scene.extent[0][k]:g} and "
                f"{scene.extent[1][k]:g} m in {outlet.axis}",
            )
    for axis in map(AXES.index, scene.periodic):
        low, high = scene.extent
        if classes and high[axis] - low[axis] < 3.0 * scene.d_max:
            yield (
                ("periodic",),
                f"{AXES[axis]} is periodic over {high[axis] - low[axis]:g} m, less than three diameters: a particle "
                "would meet its own images: expected a longer period",
            )
