"""What scenes of many particles without gas run into: limits for `kncal.scene.limits`."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from kncal.core.checks import Array
from kncal.scene.bodies import AXES
from kncal.scene.contact_limits import overlap_at
from kncal.scene.finding import Finding
from kncal.scene.groups import Region
from kncal.scene.model import Plan
from kncal.scene.scene import Scene
from kncal.scene.shapes import bounds_of, distance_to, faces
from kncal.scene.wall_motion import fastest
from kncal.scene.walls import MeshWall, Oscillation

#: Overlap of the hardest impact over the smaller radius: a contact of so much is none (refused), or a soft one.
IMPACT_LARGEST, IMPACT_LARGE = 1.0, 0.2
#: Share of a stream's region that its particles may fill when the next ones are put there.
STREAM_LARGE = 0.2
#: Phases of an oscillation that are too few to tell its mean.
FEW_PHASES = 4
#: Points of a region that are tried.
_TRIED = 4000
#: A mesh of so many diameters is often one in mm.
_HUGE = 2000.0
#: A mesh so many times wider than the domain that the case gives has nothing to do with it.
_LOST = 50.0


def fastest_speed(scene: Scene, interval: float) -> tuple[float, str]:
    """Return a speed that nothing in the scene exceeds by itself [m/s], and from what.

    That of a fall over the whole height of the domain with the speed of the start, or of the fastest wall.
    """
    low, high = scene.extent
    bounded = np.array([axis not in scene.periodic for axis in AXES])
    height = float(np.abs(scene.up) @ (bounded * (high - low)))
    start = max(math.hypot(*group.velocity) for group in scene.particles.values())
    found = {f"a fall over {height:.3g} m": math.sqrt(2.0 * scene.g * height + start**2)}
    for name, wall in scene.walls.items():
        if wall.motion:
            nodes = faces(wall, path_of=scene.path_of, extent=scene.extent, radius=0.5 * scene.d_min).reshape(-1, 3)
            found[f"the wall {name!r}"] = fastest(wall, nodes, scene.run.until_time or 0.0, interval)
        elif any(wall.surface_velocity):
            found[f"the belt {name!r}"] = math.hypot(*wall.surface_velocity)
    name = max(found, key=found.__getitem__)
    return found[name], name


def impacts(plan: Plan) -> Iterator[Finding]:
    """Find contacts too soft for the fastest impact that the scene may have."""
    speed, why = fastest_speed(plan.scene, plan.coupling)
    worst: tuple[float, Finding] | None = None
    for (a, b), contact in plan.named.items():
        overlap = overlap_at(contact, speed)
        share = 0.0 if overlap is None else overlap / (0.5 * plan.scene.d_min)
        if share > IMPACT_LARGE and (worst is None or share > worst[0]):
            passes = share >= IMPACT_LARGEST
            worst = (
                share,
                Finding(
                    "fast-impact",
                    "warn",
                    f"{a}–{b}: an impact at {speed:.3g} m/s ({why}) makes an overlap of {share:.2g} of the smallest "
                    f"radius{', so particles may pass through each other' if passes else ''}: expected at most "
                    f"{IMPACT_LARGE:g} if impacts are that fast; take a stiffer contact, or a lower domain",
                ),
            )
    if worst is not None:
        yield worst[1]


def strays(scene: Scene) -> Iterator[Finding]:
    """Find walls that cannot be touched, or are so large that their unit of length is in doubt."""
    low, high = scene.extent
    for name, wall in scene.walls.items():
        lower, upper = bounds_of(wall, scene.path_of)
        if (upper < low).any() or (lower > high).any():
            yield Finding(
                "wall-outside",
                "refuse",
                f"the wall {name!r}, from {_short(lower)} to {_short(upper)} m, lies outside the domain, "
                f"{_short(low)} to {_short(high)} m: expected it inside, or a larger [domain]",
            )
        elif isinstance(wall, MeshWall) and (size := float((upper - lower).max())) > _HUGE * scene.d_max:
            lost = scene.domain is not None and size > _LOST * float((high - low).max())
            yield Finding(
                "wall-huge",
                "refuse" if lost else "warn",
                f"the mesh of the wall {name!r} is {size:g} m wide, {size / scene.d_max:.3g} diameters: is its file in "
                "mm? Then scale = 1e-3",
            )


def _short(point: Array) -> str:
    return f"[{', '.join(f'{value:.4g}' for value in point)}]"


def _hit(scene: Scene, region: Region) -> str:
    """Return the name of a wall that a region reaches into, "" if there is none: tried at points all over it."""
    low, high = region.bounds
    points = np.random.default_rng(1).uniform(low, high, (_TRIED, 3))
    points = points[region.inside(points, 0.5 * scene.d_min)]
    for name, wall in scene.walls.items():
        gap = distance_to(wall, points, path_of=scene.path_of, open_axes=scene.open_axes)
        if len(points) and float(gap.min()) < 0.45 * scene.d_min:
            return name
    return ""


def streams(scene: Scene) -> Iterator[Finding]:
    """Find streams that are denser than particles can be inserted without touching.

    The mass that flows by is rate = ρ φ A v: A the cross-section of the region along the velocity, φ the share of its
    volume that is particles.
    """
    for name, group in scene.particles.items():
        if group.place != "stream" or group.rate is None or group.region is None:
            continue
        if hit := _hit(scene, group.region):
            yield Finding(
                "stream-wall",
                "refuse",
                f"the region of the stream {name!r} reaches into the wall {hit!r}: particles would be inserted in it, "
                "or behind it: expected a region clear of walls",
            )
        speed = math.hypot(*group.velocity)
        low, high = group.region.bounds
        along = np.abs(np.array(group.velocity)) / speed if speed else np.abs(scene.up)
        length = float(along @ (high - low))
        speed = math.sqrt(speed**2 + 2.0 * scene.g * length)  # of those that leave it, fallen or not
        if speed == 0.0:
            yield Finding(
                "stream-dense",
                "refuse",
                f"the stream {name!r} has no velocity, and there is no gravity: nothing leaves its region: expected a "
                "velocity",
            )
            continue
        share = group.rate / (scene.materials[group.material].density * group.region.volume / length * speed)
        if share > STREAM_LARGE:
            yield Finding(
                "stream-dense",
                "refuse",
                f"the stream {name!r} of {group.rate:g} kg/s would fill {share:.2g} of its region: expected at most "
                f"{STREAM_LARGE:g}, so that particles can be inserted without touching; take a larger region, a higher "
                "velocity or a smaller rate",
            )


def phases(plan: Plan) -> Iterator[Finding]:
    """Find looks and frames that meet an oscillating wall in the same few phases all the time.

    Averages over them would be those of these phases.
    """
    looks = {"run.sample_every": 1, "run.frames_every": plan.frames_every}
    for name, wall in plan.scene.walls.items():
        for motion in wall.motion:
            if not isinstance(motion, Oscillation):
                continue
            for key, intervals in looks.items():
                turns, number = intervals * plan.coupling / motion.period, plan.couplings // intervals
                for few in range(1, FEW_PHASES + 1):
                    drift = number * abs(turns - round(few * turns) / few)
                    if round(few * turns) and drift < 0.5 / few:
                        yield Finding(
                            "few-phases",
                            "warn",
                            f"{key}: {intervals * plan.coupling:.4g} s see the wall {name!r}, which oscillates in "
                            f"{motion.period:g} s, in {few} of its phases only, and averages are those of them: "
                            "expected a time that is no simple part or multiple of the period",
                        )
                        break
