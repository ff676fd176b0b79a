"""Whether a body went through another one, from frames: solvers let it happen without a word."""

from __future__ import annotations

import numpy as np

from kncal.core.checks import Array
from kncal.record.frames import Trajectory
from kncal.scene.bodies import AXES, Particle, Wall
from kncal.scene.model import Plan

#: What a run died of in which a body went through another one (see `kncal.record.outcome.FAILURES`).
PASSED_THROUGH = "passed-through"


def passages(model: Plan, trajectory: Trajectory) -> tuple[str, ...]:
    """Return a sentence about each pair of which one went through the other: the overlap reached the smaller radius.

    Looked at are the frames, and the straight way between two of them: in contact there is one after each step or few,
    and in free flight bodies do move straight relative to one another.
    """
    found = []
    index = {name: i for i, name in enumerate(trajectory.names)}
    for a, b in model.scene.body_pairs():
        x = trajectory.x[:, index[a.name]]
        if isinstance(b, Wall):
            least, allowed = _to_wall(x, a, b), 0.0
        else:
            least, allowed = _apart(x - trajectory.x[:, index[b.name]]), max(a.radius, b.radius)
        inside = np.flatnonzero(least <= allowed)
        if inside.size:
            k = int(inside[0])
            found.append(
                f"{a.name}–{b.name}: the overlap reached the radius at step {int(trajectory.step[k])}, the particle "
                "went through: expected a stiffer contact for this impact, or a smaller time step"
            )
    return tuple(found)


def _to_wall(x: Array, a: Particle, wall: Wall) -> Array:
    axis = AXES.index(wall.axis)
    side = 1.0 if a.position[axis] > wall.position else -1.0
    return side * (x[:, axis] - wall.position)


def _apart(d: Array) -> Array:
    """Smallest distance from each frame to the next, on a straight way; of the last frame the distance itself."""
    way, length = np.diff(d, axis=0), np.linalg.norm(d, axis=1)
    square = np.einsum("fk,fk->f", way, way)
    along = -np.einsum("fk,fk->f", d[:-1], way)
    share = np.clip(np.divide(along, square, out=np.zeros_like(square), where=square > 0.0), 0.0, 1.0)
    return np.append(np.linalg.norm(d[:-1] + share[:, None] * way, axis=1), length[-1])
