"""What theory says about the largest stable step: the bound that kncal advises by, and the limit of one arrangement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.physics.material import sphere_mass
from kncal.physics.tangential import LIGHTER
from kncal.physics.timestep import verlet_limit
from kncal.scene.bodies import AXES, Wall
from kncal.scene.contact_limits import sticking_limit
from kncal.scene.model import PairContact, Plan

#: A spectral radius of one is found but for rounding: double eigenvalues (free motion) are split by sqrt(1e-16).
_ROUNDING = 1e-6
#: Halvings of an interval of two decades: to a part in 1e6.
_HALVINGS = 22


@dataclass(frozen=True, kw_only=True)
class Touching:
    """One contact of a model at t = 0, linearised about its overlap.

    Attributes
    ----------
    first, second : indices of the particles; ``second`` is None at a wall
    normal : (3,) unit vector from the second body to the first
    stiffness, damping : tangent of the normal force [N/m], [N s/m]
    m_eff : [kg]
    k_t, c_t : the same along the surface, 0 without friction
    """

    first: int
    second: int | None
    normal: Array
    stiffness: float
    damping: float
    m_eff: float
    k_t: float = 0.0
    c_t: float = 0.0


def touching(model: Plan) -> list[Touching]:
    """Return the contacts of a model at t = 0."""
    index = {p.name: i for i, p in enumerate(model.scene.spheres)}
    found = []
    for a, b in model.scene.body_pairs():
        c = model.between(a.name, b.name)
        if isinstance(b, Wall):
            axis = AXES.index(b.axis)
            n = np.zeros(3)
            n[axis] = 1.0 if a.position[axis] > b.position else -1.0
            delta, second = a.radius - abs(a.position[axis] - b.position), None
        else:
            d = np.subtract(a.position, b.position)
            length = float(np.linalg.norm(d))
            delta, n, second = a.radius + b.radius - length, d / length, index[b.name]
        if delta > 0.0:
            k, eta = tangent(c, delta)
            found.append(
                Touching(
                    first=index[a.name],
                    second=second,
                    normal=n,
                    stiffness=k,
                    damping=eta,
                    m_eff=c.m_eff,
                    k_t=c.k_t * delta ** (c.n - 1.0) if c.friction > 0.0 else 0.0,
                    c_t=c.c_t * delta**c.p if c.friction > 0.0 else 0.0,
                )
            )
    return found


def _across(normal: Array) -> Array:
    """Two unit vectors (2, 3) at right angles to another and to each other."""
    one = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    one /= np.linalg.norm(one)
    return np.stack([one, np.cross(normal, one)])


def _way(t: Touching, along: Array, number: int) -> Array:
    """How fast a contact opens, or slips, in a direction: by the velocities, then the surface velocities R omega."""
    way = np.zeros(6 * number)
    for body, sign in ((t.first, 1.0), (t.second, -1.0)):
        if body is not None:
            way[3 * body : 3 * body + 3] = sign * along
            # (omega x -R n) of the first body, (omega x R n) of the second, less: alike for both
            way[3 * (number + body) : 3 * (number + body) + 3] = np.cross(along, t.normal)
    return way


def tangent(contact: PairContact, delta: float) -> tuple[float, float]:
    """Return the stiffness [N/m] and the damping [N s/m] of a contact at an overlap [m]."""
    return contact.n * contact.k * delta ** (contact.n - 1.0), contact.c * delta**contact.p


def advised_limit(model: Plan, contacts: float) -> float:
    """Return the largest step [s] that `kncal.physics.timestep.verlet_limit` allows, for the contacts there at t = 0.

    With friction also for tangential springs that stick.

    Raises
    ------
    InputError
        If nothing touches.
    """
    there = touching(model)
    if not there:
        raise InputError(f"{model.scene.name}: nothing touches at t = 0: expected a pressed scene")
    along = [verlet_limit(LIGHTER * t.k_t, t.m_eff, LIGHTER * t.c_t, contacts) for t in there if t.k_t > 0.0]
    return float(min([*along, *(verlet_limit(t.stiffness, t.m_eff, t.damping, contacts) for t in there)]))


def impact_limit(model: Plan, contacts: float = 1.0) -> float:
    """Return the same for all contacts of a scene, at the largest overlap of an impact at v_0 [s]."""
    pressed = [(c, c.delta_max) for c in model.contacts.values() if c.delta_max]
    if not pressed:
        raise InputError(f"{model.scene.name}: no contact has an impact speed: expected contact.v_0 [m/s]")
    numbers = [(*tangent(c, delta), c.m_eff) for c, delta in pressed]
    normal = min(float(verlet_limit(k, m, eta, contacts)) for k, eta, m in numbers)
    return min(normal, *(sticking_limit(c, delta, contacts) for c, delta in pressed))


def arrangement_limit(model: Plan) -> float:
    """Return the largest stable step [s] of the contacts there at t = 0, linearised, in this very arrangement.

    The iteration v' = v - dt M^-1 (K x + D v), x' = x + dt v' (velocity Verlet with damping from half-step velocities)
    is stable as long as no eigenvalue of its matrix is larger than one. K and D are those of normal springs and
    dashpots; the sideways weakening by the load itself, of the order overlap over diameter, is left out.

    Raises
    ------
    InputError
        If nothing touches.
    """
    there = touching(model)
    guess = advised_limit(model, 1.0)
    number = len(model.scene.spheres)
    size = 3 * number * (2 if any(t.k_t for t in there) else 1)
    K, D = np.zeros((size, size)), np.zeros((size, size))
    for t in there:
        rows = [(t.normal, t.stiffness, t.damping)]
        rows += [(along, t.k_t, t.c_t) for along in _across(t.normal)] if t.k_t else []
        for along, k, c in rows:
            way = _way(t, along, number)[:size]
            K += k * np.outer(way, way)
            D += c * np.outer(way, way)
    mass = np.repeat([float(sphere_mass(p.material, p.radius)) for p in model.scene.spheres], 3)
    # spins count by the velocity of the surface, R omega: their inertia is that of 2/5 of the mass
    m = np.concatenate([mass, 0.4 * mass])[:size]
    low, high = 0.05 * guess, 5.0 * guess
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _radius(K, D, m, middle) <= 1.0 + _ROUNDING else (low, middle)
    return low


def _radius(K: Array, D: Array, m: Array, dt: float) -> float:
    """Spectral radius of one step; x in units of dt v."""
    size = len(m)
    a = -(dt**2) * K / m[:, None]
    b = np.eye(size) - dt * D / m[:, None]
    step = np.block([[np.eye(size) + a, b], [a, b]])
    return float(np.abs(np.linalg.eigvals(step)).max())
