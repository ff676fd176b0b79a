"""Where a scene starts: the first touch of two bodies by free flight, and what overlaps from the beginning."""

from __future__ import annotations

import math

import numpy as np

from kncal.scene.bodies import AXES, Particle, Wall
from kncal.scene.flight import pair_touch_time, wall_touch_time
from kncal.scene.scene import Scene


def initial_overlap(a: Particle, b: Particle | Wall) -> float:
    """Return the overlap of two bodies at t = 0 [m]; negative where there is a gap."""
    if isinstance(b, Wall):
        return a.radius - abs(a.position[AXES.index(b.axis)] - b.position)
    return a.radius + b.radius - math.dist(a.position, b.position)


def first_touch(scene: Scene, a: Particle, b: Particle | Wall) -> tuple[float, float] | None:
    """Return (time [s], normal closing speed [m/s]) of the first touch of two bodies if nothing else acts on them.

    None if they never touch, touch already, or touch at zero speed.
    """
    if initial_overlap(a, b) >= 0.0:
        return None
    time, speed = _wall_touch(scene, a, b) if isinstance(b, Wall) else _pair_touch(a, b)
    return (time, speed) if math.isfinite(time) and speed > 0.0 else None


def _pair_touch(a: Particle, b: Particle) -> tuple[float, float]:
    d, w = np.subtract(b.position, a.position), np.subtract(b.velocity, a.velocity)
    time = pair_touch_time(tuple(d), tuple(w), a.radius + b.radius)
    if not math.isfinite(time):
        return math.inf, 0.0
    apart = d + w * time
    return time, -float(apart @ w) / float(np.linalg.norm(apart))


def _wall_touch(scene: Scene, a: Particle, wall: Wall) -> tuple[float, float]:
    axis = AXES.index(wall.axis)
    offset = a.position[axis] - wall.position
    side = math.copysign(1.0, offset)
    rate, acceleration = side * a.velocity[axis], side * scene.gravity[axis]
    time = wall_touch_time(abs(offset) - a.radius, rate, acceleration)
    return (time, -(rate + acceleration * time)) if math.isfinite(time) else (math.inf, 0.0)
