"""Which physics, and which solvers, a bed requires, and why. A pure function of the scene; it starts no solver."""

from __future__ import annotations

from kncal.core.checks import one_of
from kncal.physics.fluidization import terminal_velocity
from kncal.scene.bed_scene import BedScene
from kncal.scene.needs import OVERRULABLE, Need, Needs, overruled

#: What `decide` looks at, in the order of its table. The last two are the solvers that follow from the rest.
BED_PHYSICS = (
    "gas",
    "motion",
    "settling",
    "contacts",
    "tangential",
    "rolling",
    "damping",
    "depth",
    "coupling",
    "liggghts",
    "openfoam",
)


def decide(scene: BedScene) -> Needs:
    """Return what ``scene`` requires, one `Need` per name of `BED_PHYSICS`, with the user's overrules marked.

    Raises
    ------
    InputError
        If `BedScene.overrules` names something that cannot be overruled.
    """
    for name in scene.overrules:
        one_of("physics to overrule", name, OVERRULABLE)
    gas, motion, settling = scene.gas is not None, *_moving(scene)
    contacts, why_contacts = _contacts(scene, motion.used or settling.used)
    tangential = overruled(_tangential(scene, contacts), scene.overrules)
    rolling = overruled(_rolling(scene, tangential.used), scene.overrules)
    items = (
        Need(name="gas", used=gas, reason="the case has a [gas]" if gas else "the case has no [gas]"),
        motion,
        settling,
        Need(name="contacts", used=contacts, reason=why_contacts),
        tangential,
        rolling,
        _damping(scene, contacts),
        _depth(scene),
        _coupling(gas, motion.used, bool(scene.particles.count)),
        Need(
            name="liggghts",
            used=motion.used or settling.used,
            reason="moves the particles"
            if motion.used
            else "settles the packing, before the gas starts"
            if settling.used
            else "nothing moves but the gas",
        ),
        Need(name="openfoam", used=gas, reason="moves the gas" if gas else "there is no gas"),
    )
    plane = scene.column.front_back == "layer"
    return Needs(
        dimensions=2 if plane else 3,
        dimensions_reason="one layer of particles, held in its plane (xz); they stay spheres"
        if plane
        else "nothing confines the motion",
        items=items,
    )


def _moving(scene: BedScene) -> tuple[Need, Need]:
    particles = scene.particles
    settles = particles.count > 0 and particles.packing == "settled"
    if not particles.count:
        moves, why = False, "there are no particles"
    elif particles.frozen:
        moves, why = False, "the particles are frozen where they are"
    else:
        moves, why = True, f"{particles.count} particles are free to move"
    return (
        Need(name="motion", used=moves, reason=why),
        Need(
            name="settling",
            used=settles,
            reason="the packing settles from a loose lattice"
            if settles
            else f'the packing is "{particles.packing}"'
            if particles.count
            else "there are no particles",
        ),
    )


def _contacts(scene: BedScene, moves: bool) -> tuple[bool, str]:
    if not moves:
        return False, "nothing moves, so no contact changes"
    if scene.particles.count > 1:
        return True, f"{scene.particles.count} particles in one column meet"
    reach = _reach(scene)
    if reach is not None and reach[0] < reach[1]:
        return False, f"a single particle that drifts {reach[0]:.3g} m, with {reach[1]:.3g} m free in its way"
    return True, "a single particle that may reach a wall"


def _reach(scene: BedScene) -> tuple[float, float] | None:
    """Largest drift of a single particle released at rest, and the free way in that direction [m]; None: not known.

    In gas of constant uniform speed its velocity goes from 0 to U_0 less the terminal velocity without passing it;
    a tenth is added for the gas that the particle itself moves.
    """
    particles, gas = scene.particles, scene.gas
    if gas is None or gas.jet is not None or gas.ramp or not particles.positions or scene.gravity == 0.0:
        return None
    fall = float(
        terminal_velocity(particles.diameter, particles.material.density, gas.density, gas.viscosity, scene.gravity)
    )
    drift = gas.U_0 - fall
    z = particles.positions[0][2]
    free = (scene.column.height - z if drift > 0.0 else z) - 0.5 * particles.diameter
    return 1.1 * abs(drift) * scene.run.end_time, free


def _exceptions(scene: BedScene, key: str) -> list[float]:
    """The case's number ``key`` and those of its exceptions."""
    contact = scene.contact
    return [getattr(contact, key), *(v for c in contact.pairs if (v := getattr(c, key)) is not None)]


def _tangential(scene: BedScene, contacts: bool) -> Need:
    if not contacts:
        used, reason = False, "there are no contacts"
    elif max(_exceptions(scene, "friction")) > 0.0:
        used, reason = True, "friction, and particles that meet at any angle"
    else:
        used, reason = False, "the friction coefficient is 0 in every contact"
    return Need(name="tangential", used=used, reason=reason)


def _rolling(scene: BedScene, tangential: bool) -> Need:
    if scene.contact.rolling_friction == 0.0:
        used, reason = False, "the rolling friction coefficient is 0"
    elif tangential:
        used, reason = True, "a rolling friction coefficient, and particles that are set rolling by friction"
    else:
        used, reason = False, "a rolling friction coefficient, but no friction sets the particles rolling"
    return Need(name="rolling", used=used, reason=reason)


def _damping(scene: BedScene, contacts: bool) -> Need:
    smallest = min(_exceptions(scene, "e_n"))
    if not contacts:
        return Need(name="damping", used=False, reason="there are no contacts")
    lossy = smallest < 1.0
    reason = f"e_n = {smallest:g}: " + ("contacts lose energy" if lossy else "no energy is lost")
    return Need(name="damping", used=lossy, reason=reason)


def _depth(scene: BedScene) -> Need:
    reasons = {
        "walls": (True, "walls in front and at the back"),
        "periodic": (True, "periodic in depth"),
        "layer": (False, "one layer: no wall in front or at the back, no motion and no gas flow in depth"),
    }
    used, reason = reasons[scene.column.front_back]
    return Need(name="depth", used=used, reason=reason)


def _coupling(gas: bool, motion: bool, particles: bool) -> Need:
    if not gas:
        used, reason = False, "there is no gas"
    elif motion:
        used, reason = True, "gas and particles drive each other: momentum is exchanged both ways"
    else:
        used = False
        reason = "the particles rest: the gas flows around them" if particles else "there are no particles"
    return Need(name="coupling", used=used, reason=reason)
