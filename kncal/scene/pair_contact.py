"""From what a case says about one pair to the numbers of its contact: shared by single contacts and beds."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

from kncal.core.errors import CaseFileError
from kncal.physics import cohesion
from kncal.physics.calibration import OVERLAP_DOUBTFUL, Calibration, calibrate
from kncal.physics.impact import dimensionless_impact
from kncal.physics.laws import LAWS
from kncal.physics.laws.base import ContactLaw
from kncal.physics.material import Pair, sphere_mass
from kncal.physics.tangential import TANGENTIAL_DAMPING
from kncal.physics.timestep import contact_time
from kncal.scene.bodies import Body, Particle
from kncal.scene.contact import ContactChoice, PairChoice
from kncal.scene.model import PairContact

#: Relative difference of the overlaps, and so of the areas of cohesion, of the two contacts that is worth a word.
COHESION_AREA = 0.1


class PairNumbers(NamedTuple):
    """What the case says about one pair.

    e_n [-], friction [-], v_0 [m/s] and k_n [N/m] where prescribed, rolling friction [-], cohesion energy density
    [J/m³].
    """

    e_n: float
    friction: float
    v_0: float | None
    k_n: float | None
    rolling_friction: float = 0.0
    cohesion_energy_density: float = 0.0


class Rest(NamedTuple):
    """What a pair is pressed together by without any impact: ``overlap`` at t = 0 [m] and ``load`` [N]."""

    overlap: float
    load: float


def numbers_of(contact: ContactChoice, exception: PairChoice | None) -> PairNumbers:
    """Return the numbers of one pair: the case's choice, or what its exception says instead.

    Raises
    ------
    CaseFileError
        If the impact speed is still to be measured.
    """
    if contact.measured is not None:
        raise CaseFileError(
            'contact.v_0 = "measured": a speed that is still to be measured; kncal kn, render, run and compare of the '
            "case measure it first: here expected a number [m/s], such as the one that kncal kn of the case ends with"
        )
    own = {key: getattr(contact, key) for key in PairNumbers._fields}
    if exception is not None:
        own |= {key: value for key in own if (value := getattr(exception, key)) is not None}
    return PairNumbers(**own)


def calibration_for(
    contact: ContactChoice, both: Pair, numbers: PairNumbers, law: ContactLaw | None = None
) -> Calibration | None:
    """Return the calibration of one pair, or None where the case prescribes k_n without an impact speed.

    ``law``: in place of the one that ``contact`` names.
    """
    e_n, v_0, k_n = numbers.e_n, numbers.v_0, numbers.k_n
    reference = law or contact.law
    if v_0 is None:
        return None
    if k_n is not None:
        # A prescribed stiffness is a contact of the duration that this stiffness gives.
        t_c = contact_time(k_n, both.m_eff, e_n, contact.end)
        return calibrate(both, v_0=v_0, e_n=e_n, law=reference, method="contact_time", end=contact.end, t_c=t_c)
    return calibrate(both, v_0=v_0, e_n=e_n, law=reference, method=contact.method, end=contact.end, **contact.options)


def resting_time(both: Pair, rest: Rest, scene: str, names: str) -> float:
    """Half period of a small oscillation of a Hertz contact about its resting overlap [s].

    That is the start overlap, or what ``load`` presses together: pi sqrt(m_eff/(1.5 k_h sqrt(delta))), from the
    tangent of k_h delta^1.5. ``scene`` and ``names`` (of the two bodies) are for the error.

    Raises
    ------
    CaseFileError
        If nothing presses the two together.
    """
    k_h, m_eff = float(both.k_h), float(both.m_eff)
    delta = max(rest.overlap, (rest.load / k_h) ** (2.0 / 3.0))
    if delta <= 0.0:
        raise CaseFileError(
            f"{scene}: no speed, no overlap and no gravity between {names} to choose a time "
            "step from: expected contact.v_0 [m/s]"
        )
    return math.pi * math.sqrt(m_eff / (1.5 * k_h * math.sqrt(delta)))


def pair_contact(
    contact: ContactChoice,
    both: Pair,
    numbers: PairNumbers,
    kind: str,
    rest: Rest,
    *,
    scene: str,
    names: str,
    law: ContactLaw | None = None,
) -> PairContact:
    """Return the contact of one pair in the model ``kind``, "linear" or "hertz".

    Parameters
    ----------
    contact : the case's choice; ``numbers`` of this pair (`numbers_of`)
    both : Pair
    rest : for the duration of a Hertz contact without an impact speed, or of bodies pressed together from the start
    scene, names : of the scene and of the two bodies ("'one' and 'other'"), for messages
    law : in place of the one that ``contact`` names

    Raises
    ------
    CaseFileError
        If the hertz model has no reference law of that kind, or its damping or duration needs an impact speed.
    """
    calibration = calibration_for(contact, both, numbers, law)
    if kind == "linear":
        made = _linear(contact, both, numbers, calibration)
    else:
        made = _hertz(both, numbers, calibration, law or LAWS.find(contact.law), contact.end, rest, scene, names)
    warnings = {} if calibration is None else {w.code: str(w) for w in calibration.warnings}
    found = PairContact(
        **made._asdict(),
        end=contact.end,
        e_n=numbers.e_n if made.law != "hertz" else 1.0,
        v_0=numbers.v_0,
        m_eff=float(both.m_eff),
        R_eff=float(both.R_eff),
        E_eff=float(both.E_eff),
        G_eff=float(both.G_eff),
        friction=numbers.friction,
        rolling_friction=numbers.rolling_friction,
        c_t=TANGENTIAL_DAMPING[contact.tangential_damping](made.c, made.n, made.k, made.k_t),
        rolling_model=contact.rolling_model,
        rolling_damping=contact.rolling_damping,
        cohesion=numbers.cohesion_energy_density,
        warnings=warnings,
    )
    if found.cohesion == 0.0:
        return found
    depth = None if calibration is None else float(calibration.reference.delta_max)
    return _cohesive(found, depth, keeps_force=contact.cohesion_keeps == "force")


class _Elastic(NamedTuple):
    """The normal law of a contact and its tangential spring, as `PairContact` names them."""

    law: str
    k: float
    n: float
    c: float
    p: float
    t_c: float
    delta_max: float | None
    k_t: float


def _linear(contact: ContactChoice, both: Pair, numbers: PairNumbers, calibration: Calibration | None) -> _Elastic:
    m_eff, ratio = float(both.m_eff), contact.k_t_ratio
    k = numbers.k_n if numbers.k_n is not None else float(calibration.k_n)  # type: ignore[union-attr]
    return _Elastic(
        law="linear",
        k=k,
        n=1.0,
        c=float(dimensionless_impact("linear", numbers.e_n, contact.end).C) * math.sqrt(k * m_eff),
        p=0.0,
        t_c=float(contact_time(k, m_eff, numbers.e_n, contact.end)),
        delta_max=None if calibration is None else float(calibration.delta_max),
        k_t=k * float(both.k_t_ratio if ratio is None else ratio),
    )


def _hertz(
    both: Pair,
    numbers: PairNumbers,
    calibration: Calibration | None,
    law: ContactLaw,
    end: str,
    rest: Rest,
    scene: str,
    names: str,
) -> _Elastic:
    if law.stiffness_exponent == 1.0:
        raise CaseFileError(
            f"{scene}: contact.law = {law.name!r}: expected a Hertz-type reference law for the "
            "hertz run (tsuji, hertz, kuwabara_kono, hunt_crossley)"
        )
    if numbers.v_0 is None and law.e_depends_on_speed:
        raise CaseFileError(f"{scene}: law {law.name!r} needs contact.v_0 [m/s], since its e_n depends on the speed")
    k, m_eff, p = float(both.k_h), float(both.m_eff), law.damping_exponent or 0.0
    speed = numbers.v_0 if numbers.v_0 is not None else 1.0
    length = (m_eff * speed**2 / k) ** 0.4
    C = float(dimensionless_impact(law, 1.0 if law.name == "hertz" else numbers.e_n, end).C)
    if calibration is None:
        t_c, delta_max = resting_time(both, rest, scene, names), None
    else:
        t_c, delta_max = float(calibration.reference.t_c), float(calibration.reference.delta_max)
        if rest.overlap > delta_max:
            # pressed together harder than an impact at v_0 would: stiffer, so shorter
            t_c = min(t_c, resting_time(both, rest, scene, names))
    return _Elastic(
        law=law.name,
        k=k,
        n=1.5,
        c=C * m_eff * speed / length ** (p + 1.0),
        p=p,
        t_c=t_c,
        delta_max=delta_max,
        k_t=8.0 * float(both.G_eff) * math.sqrt(float(both.R_eff)),
    )


def _cohesive(contact: PairContact, depth: float | None, *, keeps_force: bool) -> PairContact:
    """Return a contact with what is to be said of its cohesion, and the energy density that keeps the force.

    ``depth``: largest overlap of the Hertz contact at v_0 [m]; None where no impact speed is known.
    """
    said: dict[str, str] = {}
    k, n, R_eff, density = contact.k, contact.n, contact.R_eff, contact.cohesion
    if n == 1.0 and depth and contact.delta_max:
        same = cohesion.same_force(density, depth, contact.delta_max)
        deeper = contact.delta_max / depth
        if keeps_force:
            density = same
        elif abs(deeper - 1.0) > COHESION_AREA:
            said["cohesion-area"] = (
                f"the linear contact overlaps {deeper:.3g} times as deep as Hertz at v_0 = {contact.v_0:g} m/s, and "
                f"cohesion pulls by area: expected a cohesion energy density of {same:.4g} J/m³ for the same force in "
                'this contact; contact.cohesion_keeps = "force" takes it'
            )
    if n == 1.0:
        pulled = cohesion.share(k, n, density, R_eff, 1.0)
        said["cohesion-linear"] = (
            f"cohesion pulls with {pulled:.3g} of the force by which the spring pushes, at every overlap: a linear "
            "contact at rest does not stick; take the hertz model where particles are to hang on each other"
        )
    elif (deep := cohesion.resting_overlap(k, n, density, R_eff) / R_eff) > OVERLAP_DOUBTFUL:
        said["cohesion-overlap"] = (
            f"cohesion alone holds an overlap of {deep:.3g} R_eff: expected at most {OVERLAP_DOUBTFUL:g}; take a "
            "smaller cohesion energy density or a stiffer material"
        )
    return replace(contact, cohesion=density, warnings={**contact.warnings, **said})


def bond_number(contact: PairContact, bodies: Iterable[Body], g: float) -> float | None:
    """Return the force that pulls a contact open at rest over the weight of the lighter body; None without weight."""
    masses = [float(sphere_mass(body.material, body.radius)) for body in bodies if isinstance(body, Particle)]
    return None if g == 0.0 else contact.pull_off() / (min(masses) * g)


def smooth(contact: PairContact, *, tangential: bool, rolling: bool, damped: bool, spring: bool) -> PairContact:
    """Return the contact without the friction, the tangential damping and spring that a scene doesn't need."""
    return replace(
        contact,
        friction=contact.friction if tangential else 0.0,
        rolling_friction=contact.rolling_friction if rolling else 0.0,
        c_t=contact.c_t if damped else 0.0,
        spring=spring or not tangential,
    )
