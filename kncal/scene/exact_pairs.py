"""Pieces of an exact motion: the path between two events, and what does not change of a pair of bodies."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.scene.bodies import AXES, Particle, Wall
from kncal.scene.contact_event import Names
from kncal.scene.model import PairContact, Plan


@dataclass(frozen=True)
class Segment:
    """Motion from ``t_0`` to the next segment's start: ballistic, or as ``path`` (displacements, velocities)."""

    t_0: float
    x_0: Array
    v_0: Array
    gravity: Array
    path: Callable[[Array], Array] | None = None

    def at(self, t: Array) -> tuple[Array, Array]:
        """Positions and velocities (times, particles, 3) at ``t`` (times,)."""
        s, shape = t - self.t_0, (t.size, *self.x_0.shape)
        if self.path is not None:
            values = self.path(s)
            half = self.x_0.size
            return self.x_0 + values[:half].T.reshape(shape), values[half : 2 * half].T.reshape(shape)
        s = s[:, None, None]
        return self.x_0 + s * (self.v_0 + 0.5 * s * self.gravity), self.v_0 + s * self.gravity


@dataclass(frozen=True)
class BodyPair:
    """What does not change of one pair of bodies."""

    names: Names
    contact: PairContact
    i: int
    j: int | None
    axis: int
    side: float
    r_sum: float
    deepest: float

    def normal(self, x: Array) -> Array:
        """Unit vector from the second body to the first."""
        if self.j is None:
            return np.asarray(self.side * np.eye(3)[self.axis])
        d = x[self.i] - x[self.j]
        return np.asarray(d / math.sqrt(d @ d))

    def relative(self, v: Array) -> Array:
        """Velocity of the first body relative to the second."""
        return v[self.i] if self.j is None else np.asarray(v[self.i] - v[self.j])

    def change(self, x: Array, u: Array) -> Array:
        """Change of the overlap by displacements ``u`` (..., particles, 3) from ``x``, without cancellation."""
        if self.j is None:
            return np.asarray(-self.side * u[..., self.i, self.axis])
        d, w = x[self.i] - x[self.j], u[..., self.i, :] - u[..., self.j, :]
        near, far = math.sqrt(d @ d), np.linalg.norm(d + w, axis=-1)
        return np.asarray(-(2.0 * w @ d + np.sum(w * w, axis=-1)) / (near + far))


def pairs_of(model: Plan) -> list[BodyPair]:
    """Every pair of bodies, in the order of `Scene.body_pairs`."""
    index = {p.name: i for i, p in enumerate(model.scene.spheres)}
    pairs = []
    for a, b in model.scene.body_pairs():
        contact = model.between(a.name, b.name)
        wall = isinstance(b, Wall)
        axis = AXES.index(b.axis) if isinstance(b, Wall) else 0
        pairs.append(
            BodyPair(
                names=(a.name, b.name),
                contact=contact,
                i=index[a.name],
                j=None if wall else index[b.name],
                axis=axis,
                side=1.0 if isinstance(b, Particle) or a.position[axis] > b.position else -1.0,
                r_sum=a.radius + (b.radius if isinstance(b, Particle) else 0.0),
                deepest=min(a.radius, b.radius) if isinstance(b, Particle) else a.radius,
            )
        )
    return pairs
