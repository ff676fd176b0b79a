"""Which physics a scene requires, and why. A pure function of the scene; it knows no solver.

The motion is confined to the smallest space of directions that holds the start velocities, gravity, the
normals of the contacts that can happen, and the surface velocities of spinning particles where friction can
pass them on. No force ever points out of that space, so nothing leaves it.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kncal.core.checks import Array, one_of
from kncal.scene.ballistics import first_touch, initial_overlap
from kncal.scene.scene import AXES, Particle, Scene, Wall

if TYPE_CHECKING:
    import pandas as pd

#: The physics that `decide` looks at, in the order of its table.
PHYSICS = ("tangential", "rotation", "rolling", "gravity", "walls", "pair_contacts", "damping", "gas")
#: Those where a user may know better; the others are facts of the scene, or follow from these.
OVERRULABLE = ("tangential", "rolling")

_Contact = tuple[Particle, Particle | Wall]


@dataclass(frozen=True, kw_only=True)
class Need:
    """One kind of physics: whether it is used, why, and whether the user decided against kncal.

    ``reason`` is kncal's own, one sentence; it stands even where ``overruled``.
    """

    name: str
    used: bool
    reason: str
    overruled: bool = False


@dataclass(frozen=True, kw_only=True)
class Needs:
    """What a scene requires; made by `decide`.

    Attributes
    ----------
    dimensions : 1, 2 or 3: the motion stays on a line, in a plane, or in neither
    dimensions_reason : why, one sentence
    items : one `Need` per name of `PHYSICS`; of a bed, see `kncal.scene.bed_needs`
    """

    dimensions: int
    dimensions_reason: str
    items: tuple[Need, ...]

    def uses(self, name: str) -> bool:
        """Return whether a kind of physics is used; `InputError` for a name that is not among the items."""
        one_of("physics", name, [item.name for item in self.items])
        return next(item.used for item in self.items if item.name == name)

    def rows(self) -> list[dict[str, str]]:
        """Return the rows of a table: physics, needed ("yes", "no", a number), why, decided_by."""
        first = {
            "physics": "dimensions",
            "needed": str(self.dimensions),
            "why": self.dimensions_reason,
            "decided_by": "kncal",
        }
        return [
            first,
            *(
                {
                    "physics": item.name,
                    "needed": "yes" if item.used else "no",
                    "why": item.reason,
                    "decided_by": "user" if item.overruled else "kncal",
                }
                for item in self.items
            ),
        ]

    def to_frame(self) -> pd.DataFrame:
        """Return `rows` as a table."""
        import pandas as pd

        return pd.DataFrame(self.rows())


def decide(scene: Scene) -> Needs:
    """Return the physics that ``scene`` requires, with a reason for each, and the user's overrules marked.

    Raises
    ------
    InputError
        If `Scene.overrules` names something that cannot be overruled.
    """
    for name in scene.overrules:
        one_of("physics to overrule", name, OVERRULABLE)
    space, contacts = _motion(scene)
    tangential, why_tangential = _tangential(scene, space, contacts)
    tangential_used = scene.overrules.get("tangential", tangential)
    rolling, why_rolling = _rolling(scene, contacts, tangential_used)
    rolling_used = scene.overrules.get("rolling", rolling)
    rotation = tangential_used or rolling_used
    why_rotation = (
        "friction at the surface exerts a torque"
        if tangential_used
        else "rolling friction exerts a torque"
        if rolling_used
        else "no contact exerts a torque: spins stay as they are"
    )
    own = (
        Need(name="tangential", used=tangential, reason=why_tangential),
        Need(name="rotation", used=rotation, reason=why_rotation),
        Need(name="rolling", used=rolling, reason=why_rolling),
        _gravity(scene),
        _walls(scene, contacts),
        _pair_contacts(scene, contacts),
        _damping(scene, contacts),
        Need(name="gas", used=False, reason="the scene has no gas"),
    )
    rank = space.shape[1]
    shape = (
        "nothing moves",
        "the motion stays on a line",
        "the motion stays in a plane",
        "nothing confines the motion",
    )
    return Needs(
        dimensions=max(rank, 1),
        dimensions_reason=shape[rank] + ("" if rank in (0, 3) else f" ({_directions(space)})"),
        items=tuple(overruled(item, scene.overrules) for item in own),
    )


def untouched_walls(scene: Scene) -> tuple[str, ...]:
    """Return the names of the walls that nothing can touch, in the order of the scene."""
    touched = {body.name for contact in _motion(scene)[1] for body in contact}
    return tuple(wall.name for wall in scene.walls if wall.name not in touched)


def overruled(item: Need, overrules: Mapping[str, bool]) -> Need:
    """Return kncal's decision with the user's own in its place, if there is one."""
    wish = overrules.get(item.name, item.used)
    return Need(name=item.name, used=wish, reason=item.reason, overruled=wish != item.used)


def _friction(scene: Scene, contact: _Contact) -> float:
    choice = scene.choice_for(*contact)
    return scene.contact.friction if choice is None or choice.friction is None else choice.friction


def _restitution(scene: Scene, contact: _Contact) -> float:
    choice = scene.choice_for(*contact)
    return scene.contact.e_n if choice is None or choice.e_n is None else choice.e_n


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


def _normal(contact: _Contact) -> Array:
    a, b = contact
    normal: Array
    normal = np.eye(3)[AXES.index(b.axis)] if isinstance(b, Wall) else np.subtract(b.position, a.position)
    return normal


def _motion(scene: Scene) -> tuple[Array, list[_Contact]]:
    """Return the space of the motion (3, rank) and the contacts that can happen; grown until complete."""
    vectors = [np.asarray(p.velocity) for p in scene.particles] + [np.asarray(scene.gravity)]
    space, contacts = _basis(vectors), list[_Contact]()
    pairs, known = scene.body_pairs(), set[tuple[str, str]]()
    while True:
        others = {name for names in known for name in names}
        possible = [c for c in pairs if _names(c) in known or _can_touch(scene, c, space, others)]
        vectors += [_normal(c) for c in possible if _names(c) not in known]
        rubbed = [c for c in possible if _friction(scene, c) > 0.0]
        grown = _basis(vectors + _surface_velocities(rubbed, _basis(vectors)))
        if len(possible) == len(contacts) and grown.shape == space.shape:
            return grown, possible
        # keep the spins' directions: the next round crosses them with the spins again
        vectors, space, contacts = [*vectors, *grown.T], grown, possible
        known = {_names(c) for c in contacts}


def _surface_velocities(contacts: list[_Contact], space: Array) -> list[Array]:
    """Directions spin × normal of the particles in ``contacts`` for every direction of ``space``."""
    touching = {p.name: p for p in _particles(contacts)}
    spins = [np.divide(p.spin, n) for p in touching.values() if (n := float(np.linalg.norm(p.spin))) > 0.0]
    products = [np.cross(spin, normal) for spin in spins for normal in space.T]
    return [v for v in products if np.linalg.norm(v) > 1e-9]


def _particles(contacts: list[_Contact]) -> list[Particle]:
    return [body for contact in contacts for body in contact if isinstance(body, Particle)]


def _names(contact: _Contact) -> tuple[str, str]:
    return contact[0].name, contact[1].name


def _can_touch(scene: Scene, contact: _Contact, space: Array, others: Container[str]) -> bool:
    """Whether two bodies can touch: never "no" where they do; "perhaps" counts as yes.

    ``others``: names of the bodies whose contacts are known to happen.
    """
    a, b = contact
    if initial_overlap(a, b) > 0.0 or first_touch(scene, a, b) is not None:
        return True
    if a.name not in others and b.name not in others:
        return _grazing(scene, contact)  # both fly freely: ballistics has the last word
    normal = _normal(contact)
    if isinstance(b, Wall):
        return _inside(space, normal) > 1e-9
    # Deflected particles may come together by any motion inside the space; what stands across it stays.
    across = normal - space @ (space.T @ normal)
    return float(np.linalg.norm(across)) < (a.radius + b.radius) * (1.0 - 1e-12)


def _grazing(scene: Scene, contact: _Contact) -> bool:
    """Whether two bodies that start just touching are driven into each other by speed or gravity."""
    a, b = contact
    length = a.radius + (0.0 if isinstance(b, Wall) else b.radius)
    if abs(initial_overlap(a, b)) > 1e-12 * length:
        return False
    if isinstance(b, Wall):
        axis = AXES.index(b.axis)
        side = np.sign(a.position[axis] - b.position)
        return bool(side * a.velocity[axis] < 0.0 or (a.velocity[axis] == 0.0 and side * scene.gravity[axis] < 0.0))
    return float(_normal(contact) @ np.subtract(b.velocity, a.velocity)) < 0.0


def _tangential(scene: Scene, space: Array, contacts: list[_Contact]) -> tuple[bool, str]:
    if not contacts:
        return False, "nothing can touch"
    rubbed = [c for c in contacts if _friction(scene, c) > 0.0]
    if not rubbed:
        return False, "no friction between bodies that can touch"
    relative = _relative_space(scene, space, contacts)
    for a, b in rubbed:
        normal = _normal((a, b)) / np.linalg.norm(_normal((a, b)))
        where = f"{a.name!r} and {b.name!r}"
        for p in _particles([(a, b)]):
            if np.linalg.norm(np.cross(p.spin, normal)) > 1e-9 * np.linalg.norm(p.spin):
                return True, f"friction, and {p.name!r} spins: the surfaces of {where} slide on each other"
        if relative.shape[1] > 1:
            return True, f"friction, and {where} can meet at an angle: their surfaces can slide on each other"
    return False, "friction, but every contact is head-on and without spin: no surface slides on another"


def _relative_space(scene: Scene, space: Array, contacts: list[_Contact]) -> Array:
    """Directions of the relative motion in contacts; gravity drops out where no wall is touched."""
    if any(isinstance(b, Wall) for _, b in contacts):
        return space
    velocities = [np.subtract(b.velocity, a.velocity) for a, b in contacts if isinstance(b, Particle)]
    return _basis(velocities + [_normal(c) for c in contacts])


def _rolling(scene: Scene, contacts: list[_Contact], tangential: bool) -> tuple[bool, str]:
    if scene.contact.rolling_friction == 0.0:
        return False, "the rolling friction coefficient is 0"
    if tangential:
        return True, "a rolling friction coefficient, and particles that can be set rolling"
    for a, b in contacts:
        for p in _particles([(a, b)]):
            if np.linalg.norm(np.cross(p.spin, _normal((a, b)))) > 0.0:
                return True, f"a rolling friction coefficient, and {p.name!r} spins in its contact"
    return False, "a rolling friction coefficient, but nothing can be set rolling"


def _gravity(scene: Scene) -> Need:
    size = float(np.linalg.norm(scene.gravity))
    return Need(
        name="gravity",
        used=size > 0.0,
        reason=f"the scene's gravity is {size:g} m/s²" if size else "no gravity",
    )


def _walls(scene: Scene, contacts: list[_Contact]) -> Need:
    touched = sorted({b.name for _, b in contacts if isinstance(b, Wall)})
    if touched:
        reason = f"{', '.join(map(repr, touched))} can be touched"
    else:
        reason = "no wall can be touched" if scene.walls else "the scene has no walls"
    return Need(name="walls", used=bool(touched), reason=reason)


def _pair_contacts(scene: Scene, contacts: list[_Contact]) -> Need:
    meeting = [(a.name, b.name) for a, b in contacts if isinstance(b, Particle)]
    if meeting:
        reason = f"{meeting[0][0]!r} and {meeting[0][1]!r} can meet"
    else:
        reason = "a single particle" if len(scene.particles) == 1 else "the particles pass each other"
    return Need(name="pair_contacts", used=bool(meeting), reason=reason)


def _damping(scene: Scene, contacts: list[_Contact]) -> Need:
    smallest = min((_restitution(scene, c) for c in contacts), default=1.0)
    if not contacts:
        reason = "nothing can touch"
    else:
        reason = f"e_n = {smallest:g}" + (": contacts lose energy" if smallest < 1.0 else ": no energy is lost")
    return Need(name="damping", used=smallest < 1.0, reason=reason)


def _directions(space: Array) -> str:
    axes = [axis for i, axis in enumerate(AXES) if abs(_inside(space, np.eye(3)[i]) - 1.0) < 1e-9]
    if len(axes) == space.shape[1]:
        return "along " + axes[0] if len(axes) == 1 else "plane " + "".join(axes)
    return "oblique to the axes"
