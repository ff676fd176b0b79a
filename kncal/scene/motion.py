"""The space that the motion of a few bodies is confined to, and the contacts that can happen in it.

The motion is confined to the smallest space of directions that holds the start velocities, gravity, the
normals of the contacts that can happen, and the surface velocities of spinning particles where friction can
pass them on. No force ever points out of that space, so nothing leaves it.
"""

from __future__ import annotations

from collections.abc import Container

import numpy as np

from kncal.core.checks import Array
from kncal.scene.ballistics import first_touch, initial_overlap
from kncal.scene.bodies import AXES, Particle, Wall
from kncal.scene.scene import Scene

Contact = tuple[Particle, Particle | Wall]


def friction_of(scene: Scene, contact: Contact) -> float:
    """Return the friction coefficient of a contact [-]."""
    choice = scene.choice_for(*contact)
    return scene.contact.friction if choice is None or choice.friction is None else choice.friction


def _basis(vectors: list[Array]) -> Array:
    """Orthonormal basis (3, rank) of the directions of ``vectors``; an angle below 1e-9 counts as zero."""
    units = [np.asarray(v) / n for v in vectors if (n := float(np.linalg.norm(v))) > 0.0]
    if not units:
        return np.zeros((3, 0))
    left, sizes, _ = np.linalg.svd(np.column_stack(units), full_matrices=False)
    return left[:, : int(np.sum(sizes > 1e-9 * sizes[0]))]


def _inside(space: Array, vector: Array) -> float:
    """Length of the part of ``vector`` inside ``space``."""
    return float(np.linalg.norm(space.T @ vector))


def normal_of(contact: Contact) -> Array:
    """Return the direction from the first body of a contact to the second, of any length."""
    a, b = contact
    normal: Array
    normal = np.eye(3)[AXES.index(b.axis)] if isinstance(b, Wall) else np.subtract(b.position, a.position)
    return normal


def motion_of(scene: Scene) -> tuple[Array, list[Contact]]:
    """Return the space of the motion (3, rank) and the contacts that can happen; grown until complete."""
    vectors = [np.asarray(p.velocity) for p in scene.spheres] + [np.asarray(scene.gravity)]
    space, contacts = _basis(vectors), list[Contact]()
    pairs, known = scene.body_pairs(), set[tuple[str, str]]()
    while True:
        others = {name for names in known for name in names}
        possible = [c for c in pairs if _names(c) in known or _can_touch(scene, c, space, others)]
        vectors += [normal_of(c) for c in possible if _names(c) not in known]
        rubbed = [c for c in possible if friction_of(scene, c) > 0.0]
        grown = _basis(vectors + _surface_velocities(rubbed, _basis(vectors)))
        if len(possible) == len(contacts) and grown.shape == space.shape:
            return grown, possible
        # keep the spins' directions: the next round crosses them with the spins again
        vectors, space, contacts = [*vectors, *grown.T], grown, possible
        known = {_names(c) for c in contacts}


def _surface_velocities(contacts: list[Contact], space: Array) -> list[Array]:
    """Directions spin × normal of the particles in ``contacts`` for every direction of ``space``."""
    touching = {p.name: p for p in particles_in(contacts)}
    spins = [np.divide(p.spin, n) for p in touching.values() if (n := float(np.linalg.norm(p.spin))) > 0.0]
    products = [np.cross(spin, normal) for spin in spins for normal in space.T]
    return [v for v in products if np.linalg.norm(v) > 1e-9]


def particles_in(contacts: list[Contact]) -> list[Particle]:
    """Return the particles of contacts."""
    return [body for contact in contacts for body in contact if isinstance(body, Particle)]


def _names(contact: Contact) -> tuple[str, str]:
    return contact[0].name, contact[1].name


def _can_touch(scene: Scene, contact: Contact, space: Array, others: Container[str]) -> bool:
    """Whether two bodies can touch: never "no" where they do; "perhaps" counts as yes.

    ``others``: names of the bodies whose contacts are known to happen.
    """
    a, b = contact
    if initial_overlap(a, b) > 0.0 or first_touch(scene, a, b) is not None:
        return True
    if a.name not in others and b.name not in others:
        return _grazing(scene, contact)  # both fly freely: ballistics has the last word
    normal = normal_of(contact)
    if isinstance(b, Wall):
        return _inside(space, normal) > 1e-9
    # Deflected particles may come together by any motion inside the space; what stands across it stays.
    across = normal - space @ (space.T @ normal)
    return float(np.linalg.norm(across)) < (a.radius + b.radius) * (1.0 - 1e-12)


def _grazing(scene: Scene, contact: Contact) -> bool:
    """Whether two bodies that start just touching are driven into each other by speed or gravity."""
    a, b = contact
    length = a.radius + (0.0 if isinstance(b, Wall) else b.radius)
    if abs(initial_overlap(a, b)) > 1e-12 * length:
        return False
    if isinstance(b, Wall):
        axis = AXES.index(b.axis)
        side = np.sign(a.position[axis] - b.position)
        return bool(side * a.velocity[axis] < 0.0 or (a.velocity[axis] == 0.0 and side * scene.gravity[axis] < 0.0))
    return float(normal_of(contact) @ np.subtract(b.velocity, a.velocity)) < 0.0


def relative_space(scene: Scene, space: Array, contacts: list[Contact]) -> Array:
    """Return the directions of the relative motion in contacts; gravity drops out where no wall is touched."""
    if any(isinstance(b, Wall) for _, b in contacts):
        return space
    velocities = [np.subtract(b.velocity, a.velocity) for a, b in contacts if isinstance(b, Particle)]
    return _basis(velocities + [normal_of(c) for c in contacts])


def directions(space: Array) -> str:
    """Return a space of directions in words."""
    axes = [axis for i, axis in enumerate(AXES) if abs(_inside(space, np.eye(3)[i]) - 1.0) < 1e-9]
    if len(axes) == space.shape[1]:
        return "along " + axes[0] if len(axes) == 1 else "plane " + "".join(axes)
    return "oblique to the axes"
