"""Packings at rest as probes: spheres of one or two sizes that lie in a box, carried by their contacts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import RunError
from kncal.physics.material import sphere_mass
from kncal.scene.bodies import AXES, Particle, Wall
from kncal.scene.model import PairContact, Plan
from kncal.scene.plan import plan
from kncal.scene.scene import Scene
from kncal.study.stability.probes import NUDGE, STRONGEST, Ingredients, Probe, probe_of, probe_scene

#: Small spheres of a packing, and the most of them beneath a large one.
COUNT, MOST = 27, 95
#: Overlap under the weight of the packing over the diameter of the smallest sphere. Of this order is what the load
#: itself takes from the stiffness sideways.
SHARE = 1e-3
#: Friction coefficient of contacts that stick: the largest that a case may have.
STICKS = 10.0
#: Largest force that is not balanced, over the smallest weight.
_AT_REST = 1e-6
#: Starts that are tried before it is said that no packing comes to rest.
_TRIES = 4


@dataclass(frozen=True)
class _Springs:
    """Every pair of spheres and every sphere at every wall: force k delta^n."""

    radius: Array
    weight: Array
    first: NDArray[np.intp]
    second: NDArray[np.intp]
    k: Array
    walls: Array
    k_walls: Array
    n: float

    def energy(self, flat: Array) -> tuple[float, Array]:
        """Return the energy [J] and its gradient [N] at the centres ``flat`` (3 n,) [m]."""
        x = flat.reshape(-1, 3)
        d = x[self.first] - x[self.second]
        length = np.linalg.norm(d, axis=1)
        delta = np.maximum(self.radius[self.first] + self.radius[self.second] - length, 0.0)
        force = self.k * delta**self.n
        push = (force / np.maximum(length, np.finfo(float).tiny))[:, None] * d
        gradient = np.zeros_like(x)
        np.add.at(gradient, self.first, -push)
        np.add.at(gradient, self.second, push)
        total = float((force * delta).sum()) / (self.n + 1.0) + float((self.weight * x[:, 2]).sum())
        gradient[:, 2] += self.weight
        for axis in range(3):
            for side, place in enumerate(self.walls[axis]):
                sign = 1.0 - 2.0 * side
                deep = np.maximum(self.radius - sign * (x[:, axis] - place), 0.0)
                held = self.k_walls * deep**self.n
                total += float((held * deep).sum()) / (self.n + 1.0)
                gradient[:, axis] -= sign * held
        return total, gradient.ravel()

    def stiffness(self, flat: Array) -> Array:
        """Return the second derivative of the energy (3 n, 3 n) [N/m]."""
        x = flat.reshape(-1, 3)
        K = np.zeros((flat.size, flat.size))
        d = x[self.first] - x[self.second]
        length = np.linalg.norm(d, axis=1)
        delta = self.radius[self.first] + self.radius[self.second] - length
        for c in np.flatnonzero(delta > 0.0):
            normal = d[c] / length[c]
            along = np.outer(normal, normal)
            tangent = self.n * self.k[c] * delta[c] ** (self.n - 1.0)
            block = tangent * along - self.k[c] * delta[c] ** self.n / length[c] * (np.eye(3) - along)
            i, j = slice(3 * self.first[c], 3 * self.first[c] + 3), slice(3 * self.second[c], 3 * self.second[c] + 3)
            K[i, i] += block
            K[j, j] += block
            K[i, j] -= block
            K[j, i] -= block
        for axis in range(3):
            for side, place in enumerate(self.walls[axis]):
                deep = np.maximum(self.radius - (1.0 - 2.0 * side) * (x[:, axis] - place), 0.0)
                at = 3 * np.arange(len(x)) + axis
                K[at, at] += np.where(deep > 0.0, self.n * self.k_walls * deep ** (self.n - 1.0), 0.0)
        return K


def packing(
    given: Ingredients, kind: str, e_n: float, *, size_ratio: float = 1.0, sticks: bool = False, seed: int = 1
) -> Probe:
    """Return a packing at rest under gravity, nudged a little; ``sticks``: with tangential springs that never slip.

    A sphere that is ``size_ratio`` times as large as the others lies on them.

    The energy of springs and weights is made as small as it gets from random places, so that every contact is in
    equilibrium to 1e-6 of a weight, in either model.

    Raises
    ------
    RunError
        If no packing comes to rest.
    """
    friction = STICKS if sticks else 0.0
    name = f"packing-{size_ratio:g}{'-sticks' if sticks else ''}-{kind}"
    for attempt in range(_TRIES):
        draw = np.random.default_rng([seed, attempt])
        radii, sides, start = _start(given.radius, size_ratio, draw)
        dummy = _scene(given, name, e_n, radii, start, sides, np.zeros_like(start), 1.0, 0.0)
        model = plan(dummy, (kind,))[kind]
        g = _gravity(model, given, radii, sides)
        springs = _springs(model, radii, sides, g)
        x = _at_rest(springs, start)
        if x is None:
            continue
        # of the speed of a particle that swings by a part of the overlap which its weight makes
        inner = model.between("s0", "s1")
        delta = inner.overlap_under(float(springs.weight.min()))
        omega = np.sqrt(inner.n * inner.k * delta ** (inner.n - 1.0) / inner.m_eff)
        nudges = draw.uniform(-1.0, 1.0, x.shape) * NUDGE * omega * delta * (radii.min() / radii[:, None]) ** 3
        made = _scene(given, name, e_n, radii, x, sides, nudges, g, friction)
        return probe_of(made, kind, e_n, _most_contacts(made), pressed=True, size_ratio=size_ratio)
    raise RunError(f"{name}: none of {_TRIES} random packings comes to rest: expected another material or e_n")


def _start(radius: float, ratio: float, draw: np.random.Generator) -> tuple[Array, Array, Array]:
    """Radii, sides of the box (3,) from 0 [m], and random centres, the large ones low."""
    width = max(6.0, 2.02 * ratio) * radius
    small = np.full(min(max(COUNT, round(0.8 * (0.5 * width / radius) ** 2)), MOST), radius)
    high = 4.0 * float((8.0 * small**3).sum()) / width**2 + 4.0 * radius
    x = radius + draw.uniform(size=(len(small), 3)) * (np.array([width, width, high]) - 2.0 * radius)
    if ratio == 1.0:
        return small, np.array([width, width, high]), x
    big = ratio * radius
    top = np.array([[0.5 * width, 0.5 * width, high + big]])
    return np.append(small, big), np.array([width, width, high + 2.0 * big]), np.vstack([x, top])


def _scene(
    given: Ingredients, name: str, e_n: float, radii: Array, x: Array, sides: Array, v: Array, g: float, friction: float
) -> Scene:
    spheres = tuple(
        Particle(name=f"s{i}", material=given.material, radius=float(r), position=tuple(p), velocity=tuple(w))
        for i, (r, p, w) in enumerate(zip(radii, x.tolist(), (v + 0.0).tolist(), strict=True))
    )
    walls = tuple(
        Wall(name=f"{axis}-{end}", axis=axis, position=place, material=given.wall)
        for axis, side in zip(AXES, sides.tolist(), strict=True)
        for end, place in (("low", 0.0), ("high", side))
    )
    return probe_scene(given, name, e_n, spheres, walls, (0.0, 0.0, -g), friction=friction)


def _gravity(model: Plan, given: Ingredients, radii: Array, sides: Array) -> float:
    """Gravity [m/s²] that presses the lowest small spheres by about `SHARE` of their diameter."""
    c = model.between("s0", "s1")
    mass = float(sphere_mass(given.material, float((radii**3).sum()) ** (1.0 / 3.0)))
    below = sides[0] * sides[1] / (4.0 * radii.min() ** 2) if radii.min() == radii.max() else 3.0
    return min(float(c.k * (SHARE * 2.0 * radii.min()) ** c.n * below / mass), STRONGEST)


def _springs(model: Plan, radii: Array, sides: Array, g: float) -> _Springs:
    number = len(radii)
    first, second = np.triu_indices(number, 1)
    contact: Callable[[str, str], PairContact] = model.between
    return _Springs(
        radius=radii,
        weight=np.array([float(sphere_mass(p.material, p.radius)) for p in model.scene.spheres]) * g,
        first=first,
        second=second,
        k=np.array([contact(f"s{i}", f"s{j}").k for i, j in zip(first, second, strict=True)]),
        walls=np.stack([np.zeros(3), sides], axis=1),
        k_walls=np.array([contact(f"s{i}", "z-low").k for i in range(number)]),
        n=contact("s0", "s1").n,
    )


def _at_rest(springs: _Springs, start: Array) -> Array | None:
    """Centres (n, 3) [m] in equilibrium, or None: by descent of the energy, then by the balance of forces itself."""
    from scipy.optimize import minimize, root

    length = float(springs.radius.min())
    scale = float(springs.weight.min()) * length

    def energy(u: Array) -> Any:
        value, gradient = springs.energy(u * length)
        return value / scale, gradient * length / scale

    def balance(u: Array) -> Any:
        return energy(u)[1], springs.stiffness(u * length) * length**2 / scale

    options: Any = {"maxiter": 30_000, "maxfun": 60_000, "ftol": 0.0, "gtol": 1e-4}
    u: Array = minimize(energy, start.ravel() / length, jac=True, method="L-BFGS-B", options=options).x
    u = root(balance, u, jac=True, method="hybr").x
    return (u * length).reshape(-1, 3) if np.abs(energy(u)[1]).max() < _AT_REST else None


def _most_contacts(scene: Scene) -> int:
    found = dict.fromkeys((p.name for p in scene.spheres), 0)
    for a, b in scene.body_pairs():
        apart = (
            np.linalg.norm(np.subtract(a.position, b.position)) - b.radius
            if isinstance(b, Particle)
            else abs(a.position["xyz".index(b.axis)] - b.position)
        )
        for body in (a, b):
            if apart < a.radius and body.name in found:
                found[body.name] += 1
    return max(found.values())
