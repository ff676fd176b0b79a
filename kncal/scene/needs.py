"""Which physics a scene requires, and why. A pure function of the scene; it starts no solver."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kncal.core.checks import Array, one_of
from kncal.physics.fluidization import terminal_velocity
from kncal.scene.bodies import Particle, Wall
from kncal.scene.motion import Contact, directions, friction_of, motion_of, normal_of, particles_in, relative_space
from kncal.scene.scene import Scene
from kncal.scene.species import listed

if TYPE_CHECKING:
    import pandas as pd

#: The physics that `decide` looks at, in the order of its table: of a few bodies, and of a bed. The last two of a bed
#: are the solvers that follow from the rest.
_OF_CONTACTS = ("tangential", "rolling", "tangential_damping", "history", "cohesion", "damping")
PHYSICS = (*_OF_CONTACTS, "rotation", "gravity", "walls", "pair_contacts", "gas")
BED_PHYSICS = ("gas", "motion", "settling", "contacts", *_OF_CONTACTS, "depth", "coupling", "liggghts", "openfoam")
#: Those where a user may know better; the others are facts of the scene, or follow from these.
OVERRULABLE = ("tangential", "rolling", "history")


@dataclass(frozen=True)
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
    items : one `Need` per name of `PHYSICS`, or of `BED_PHYSICS`
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
        If ``scene.needs`` names something that cannot be overruled.
    """
    for name in scene.needs:
        one_of("physics to overrule", name, OVERRULABLE)
    return _of_coupled(scene) if scene.coupled else _of_single(scene)


def untouched_walls(scene: Scene) -> tuple[str, ...]:
    """Return the names of the walls that nothing can touch, in the order of the scene."""
    touched = {body.name for contact in motion_of(scene)[1] for body in contact}
    return tuple(wall.name for wall in scene.planes if wall.name not in touched)


def _overruled(item: Need, overrules: Mapping[str, bool]) -> Need:
    """The decision with the user's own in its place, if there is one."""
    wish = overrules.get(item.name, item.used)
    return Need(item.name, wish, item.reason, overruled=wish != item.used)


def _of_single(scene: Scene) -> Needs:
    space, contacts = motion_of(scene)
    tangential, why_tangential = _tangential(scene, space, contacts)
    tangential_used = scene.needs.get("tangential", tangential)
    rolling, why_rolling = _rolling(scene, contacts, tangential_used)
    rolling_used = scene.needs.get("rolling", rolling)
    rotation = tangential_used or rolling_used
    why_rotation = (
        "friction at the surface exerts a torque"
        if tangential_used
        else "rolling friction exerts a torque"
        if rolling_used
        else "no contact exerts a torque: spins stay as they are"
    )
    damping = _damping(scene, contacts)
    own = (
        Need("tangential", tangential, why_tangential),
        Need("rolling", rolling, why_rolling),
        *_that_follow(scene, bool(contacts), tangential_used, rolling_used, damping.used),
        damping,
        Need("rotation", rotation, why_rotation),
        _gravity(scene),
        _walls(scene, contacts),
        _pair_contacts(scene, contacts),
        Need("gas", False, "the scene has no gas"),
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
        dimensions_reason=shape[rank] + ("" if rank in (0, 3) else f" ({directions(space)})"),
        items=tuple(_overruled(item, scene.needs) for item in own),
    )


def _restitution(scene: Scene, contact: Contact) -> float:
    choice = scene.choice_for(*contact)
    return scene.contact.e_n if choice is None or choice.e_n is None else choice.e_n


def _tangential(scene: Scene, space: Array, contacts: list[Contact]) -> tuple[bool, str]:
    if not contacts:
        return False, "nothing can touch"
    rubbed = [c for c in contacts if friction_of(scene, c) > 0.0]
    if not rubbed:
        return False, "no friction between bodies that can touch"
    relative = relative_space(scene, space, contacts)
    for a, b in rubbed:
        normal = normal_of((a, b)) / np.linalg.norm(normal_of((a, b)))
        where = f"{a.name!r} and {b.name!r}"
        # the rims of both: spins against each other may let them go alike
        turns = [np.multiply(p.radius, p.spin) for p in particles_in([(a, b)])]
        rims = np.cross(turns, normal)
        if np.linalg.norm(rims.sum(axis=0)) > 1e-9 * np.linalg.norm(turns):
            spinning = particles_in([(a, b)])[int(np.argmax(np.linalg.norm(rims, axis=1)))]
            return True, f"friction, and {spinning.name!r} spins: the surfaces of {where} slide on each other"
        if relative.shape[1] > 1:
            return True, f"friction, and {where} can meet at an angle: their surfaces can slide on each other"
    return False, "friction, but every contact is head-on, and no spin lets one surface slide on another"


def _rolling(scene: Scene, contacts: list[Contact], tangential: bool) -> tuple[bool, str]:
    if max(_exceptions(scene, "rolling_friction")) == 0.0:
        return False, "the rolling friction coefficient is 0"
    if tangential:
        return True, "a rolling friction coefficient, and particles that can be set rolling"
    for a, b in contacts:
        for p in particles_in([(a, b)]):
            if np.linalg.norm(np.cross(p.spin, normal_of((a, b)))) > 0.0:
                return True, f"a rolling friction coefficient, and {p.name!r} spins in its contact"
    return False, "a rolling friction coefficient, but nothing can be set rolling"


def _that_follow(scene: Scene, contacts: bool, tangential: bool, rolling: bool, damping: bool) -> tuple[Need, ...]:
    """Tangential damping, history and cohesion: what a user says of them, and what the rest leaves of it."""
    contact = scene.contact
    if contact.tangential_damping == "none":
        damped, why = False, "the case asks for none: energy is lost by sliding alone"
    elif not tangential:
        damped, why = False, "there is no tangential force to damp"
    elif not damping:
        damped, why = False, "e_n is 1 in every contact: no damping in either direction"
    else:
        damped, why = True, f'"{contact.tangential_damping}": a contact that sticks loses energy too'
    springs = {"the tangential spring": tangential, "the spring against rolling": rolling and _rolls_by_spring(scene)}
    kept = [name for name, used in springs.items() if used]
    memory = f"{' and '.join(kept)} remember{'s' if len(kept) == 1 else ''} the way since the contact began"
    cohesive = contacts and max(_exceptions(scene, "cohesion_energy_density")) > 0.0
    attraction = "attraction by contact area (sjkr)" if cohesive else "the cohesion energy density is 0"
    return (
        Need("tangential_damping", damped, why),
        Need("history", bool(kept), memory if kept else "no force of a contact depends on what was before"),
        Need("cohesion", cohesive, attraction if contacts else "there are no contacts"),
    )


def _rolls_by_spring(scene: Scene) -> bool:
    return scene.contact.rolling_model != "cdt"


def _gravity(scene: Scene) -> Need:
    size = float(np.linalg.norm(scene.gravity))
    return Need(
        "gravity",
        size > 0.0,
        f"the scene's gravity is {size:g} m/s²" if size else "no gravity",
    )


def _walls(scene: Scene, contacts: list[Contact]) -> Need:
    touched = sorted({b.name for _, b in contacts if isinstance(b, Wall)})
    if touched:
        reason = f"{', '.join(map(repr, touched))} can be touched"
    else:
        reason = "no wall can be touched" if scene.planes else "the scene has no walls"
    return Need("walls", bool(touched), reason)


def _pair_contacts(scene: Scene, contacts: list[Contact]) -> Need:
    meeting = [(a.name, b.name) for a, b in contacts if isinstance(b, Particle)]
    if meeting:
        reason = f"{meeting[0][0]!r} and {meeting[0][1]!r} can meet"
    else:
        reason = "a single particle" if len(scene.spheres) == 1 else "the particles pass each other"
    return Need("pair_contacts", bool(meeting), reason)


def _damping(scene: Scene, contacts: list[Contact]) -> Need:
    smallest = min((_restitution(scene, c) for c in contacts), default=1.0)
    if not contacts:
        reason = "nothing can touch"
    else:
        reason = f"e_n = {smallest:g}" + (": contacts lose energy" if smallest < 1.0 else ": no energy is lost")
    return Need("damping", smallest < 1.0, reason)


# --- coupled in intervals


def _of_coupled(scene: Scene) -> Needs:
    gas, motion, settling = scene.gas is not None, *_moving(scene)
    contacts, why_contacts = _coupled_contacts(scene, motion.used or settling.used)
    tangential = _overruled(_coupled_tangential(scene, contacts), scene.needs)
    rolling = _overruled(_coupled_rolling(scene, tangential.used), scene.needs)
    damping = _coupled_damping(scene, contacts)
    work = "moves the particles" if motion.used else "settles the packing, before the gas starts"
    items = (
        Need("gas", gas, "the case has a [gas]" if gas else "the case has no [gas]"),
        motion,
        settling,
        Need("contacts", contacts, why_contacts),
        tangential,
        rolling,
        *(
            _overruled(n, scene.needs)
            for n in _that_follow(scene, contacts, tangential.used, rolling.used, damping.used)
        ),
        damping,
        *([_depth(scene)] if scene.run.coupling is not None else _of_walls(scene)),
        _coupling(gas, motion.used, bool(scene.number)),
        Need("liggghts", moved := motion.used or settling.used, work if moved else "nothing moves but the gas"),
        Need("openfoam", gas, "moves the gas" if gas else "there is no gas"),
    )
    plane = scene.front_back == "layer"
    return Needs(
        dimensions=2 if plane else 3,
        dimensions_reason="one layer of particles, held in its plane (xz); they stay spheres"
        if plane
        else "nothing confines the motion",
        items=items,
    )


def _moving(scene: Scene) -> tuple[Need, Need]:
    settles = scene.number > 0 and scene.settles
    places = ", ".join(dict.fromkeys(f'"{group.place}"' for group in scene.particles.values()))
    if not scene.number:
        moves, why = False, "there are no particles"
    elif scene.frozen:
        moves, why = False, "the particles are frozen where they are"
    else:
        number = sum(c.number for c in scene.classes if c.group not in scene.held)
        moves, why = True, f"{number} particles are free to move"
    return (
        Need("motion", moves, why),
        Need(
            "settling",
            settles,
            f"the packing settles from {'a loose lattice' if scene.run.coupling else 'random places'}"
            if settles
            else f"the packing is {places}"
            if scene.number
            else "there are no particles",
        ),
    )


def _coupled_contacts(scene: Scene, moves: bool) -> tuple[bool, str]:
    if not moves:
        return False, "nothing moves, so no contact changes"
    if scene.number > 1:
        return True, f"{scene.number} particles meet"
    reach = _reach(scene)
    if reach is not None and reach[0] < reach[1]:
        return False, f"a single particle that drifts {reach[0]:.3g} m, with {reach[1]:.3g} m free in its way"
    return True, "a single particle that may reach a wall"


def _reach(scene: Scene) -> tuple[float, float] | None:
    """Largest drift of a single particle released at rest, and the free way in that direction [m]; None: not known.

    In gas of constant uniform speed its velocity goes from 0 to U_0 less the terminal velocity without passing it;
    a tenth is added for the gas that the particle itself moves.
    """
    particles, gas = scene.group, scene.gas
    if gas is None or gas.jet is not None or gas.ramp or not particles.centres or scene.g == 0.0:
        return None
    fall = float(terminal_velocity(scene.diameter, scene.density, gas.density, gas.viscosity, scene.g))
    drift = gas.U_0 - fall
    z = particles.centres[0][2]
    free = (scene.box.height - z if drift > 0.0 else z) - 0.5 * scene.diameter
    return 1.1 * abs(drift) * (scene.run.until_time or math.inf), free


def _exceptions(scene: Scene, key: str) -> list[float]:
    """The case's number ``key`` and those of its exceptions."""
    contact = scene.contact
    return [getattr(contact, key), *(v for c in contact.pairs if (v := getattr(c, key)) is not None)]


def _coupled_tangential(scene: Scene, contacts: bool) -> Need:
    if not contacts:
        used, reason = False, "there are no contacts"
    elif max(_exceptions(scene, "friction")) > 0.0:
        used, reason = True, "friction, and particles that meet at any angle"
    else:
        used, reason = False, "the friction coefficient is 0 in every contact"
    return Need("tangential", used, reason)


def _coupled_rolling(scene: Scene, tangential: bool) -> Need:
    if max(_exceptions(scene, "rolling_friction")) == 0.0:
        used, reason = False, "the rolling friction coefficient is 0"
    elif tangential:
        used, reason = True, "a rolling friction coefficient, and particles that are set rolling by friction"
    else:
        used, reason = False, "a rolling friction coefficient, but no friction sets the particles rolling"
    return Need("rolling", used, reason)


def _coupled_damping(scene: Scene, contacts: bool) -> Need:
    smallest = min(_exceptions(scene, "e_n"))
    if not contacts:
        return Need("damping", False, "there are no contacts")
    lossy = smallest < 1.0
    reason = f"e_n = {smallest:g}: " + ("contacts lose energy" if lossy else "no energy is lost")
    return Need("damping", lossy, reason)


def _depth(scene: Scene) -> Need:
    reasons = {
        "walls": (True, "walls in front and at the back"),
        "periodic": (True, "periodic in depth"),
        "layer": (False, "one layer: no wall in front or at the back, no motion and no gas flow in depth"),
    }
    used, reason = reasons[scene.front_back]
    return Need("depth", used, reason)


def _of_walls(scene: Scene) -> tuple[Need, ...]:
    """What the walls, the ends and the sources of a scene without gas require."""
    streams = [name for name, group in scene.particles.items() if group.place == "stream"]
    moving = [name for name, wall in scene.walls.items() if wall.motion or any(wall.surface_velocity)]
    removed = [name for name, wall in scene.walls.items() if wall.remove_at is not None]
    rows: tuple[tuple[str, Sequence[str], str, str], ...] = (
        ("walls", tuple(scene.walls), "can be touched", "there are no walls"),
        ("wall_motion", moving, "in motion", "no wall moves"),
        ("wall_removal", removed, "taken away during the run", "no wall is taken away"),
        ("insertion", streams, "flowing in during the run", "nothing flows in"),
        ("outlets", tuple(scene.outlets), "counting what passes", "there are no outlets"),
        ("periodic", scene.periodic, "periodic", "no axis is periodic"),
    )
    return tuple(
        Need(name, bool(found), f"{what}: {listed(found)}" if found else without) for name, found, what, without in rows
    )


def _coupling(gas: bool, motion: bool, particles: bool) -> Need:
    if not gas:
        used, reason = False, "there is no gas"
    elif motion:
        used, reason = True, "gas and particles drive each other: momentum is exchanged both ways"
    else:
        used = False
        reason = "the particles rest: the gas flows around them" if particles else "there are no particles"
    return Need("coupling", used, reason)
