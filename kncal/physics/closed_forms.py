"""Closed forms of single problems: the end of slip, gross sliding, the damped bounce under gravity."""

from __future__ import annotations

import math
from dataclasses import dataclass

from kncal.core.checks import in_range, positive
from kncal.core.errors import ValidityError


@dataclass(frozen=True, kw_only=True)
class SlipEnd:
    """When a sliding sphere begins to roll: ``time`` [s], ``speed`` of the centre and of the rim [m/s]."""

    time: float
    speed: float
    omega_r: float


def slip_end(u_0: float, friction: float, g: float) -> SlipEnd:
    """Return when a solid sphere that starts to slide at ``u_0`` without spin rolls.

    Constant friction mu g decelerates the centre, and (5/2) mu g accelerates the rim, I = (2/5) m R²: slip ends at
    t = 2 u_0/(7 mu g) with u = omega R = (5/7) u_0. Textbook mechanics; the test DEM04 of MFIX's verification manual.

    Parameters
    ----------
    u_0 : speed at t = 0 [m/s]
    friction : Coulomb coefficient mu [-]
    g : gravity towards the plane [m/s²]

    Raises
    ------
    InputError
        If an argument is not positive and finite.
    """
    u = float(positive("u_0", u_0, unit="m/s"))
    mu, pull = float(positive("friction", friction)), float(positive("g", g, unit="m/s²"))
    return SlipEnd(time=2.0 * u / (7.0 * mu * pull), speed=5.0 / 7.0 * u, omega_r=5.0 / 7.0 * u)


@dataclass(frozen=True, kw_only=True)
class GrossSliding:
    """After an oblique impact that slides throughout, everything forward: velocities [m/s] of the centre, ``spin``
    [rad/s] about the axis of rolling forward, ``slip`` of the contact point [m/s], angle of the centre from the normal.

    ``tangential_restitution``: None if the centre does not move along the wall before.
    """

    v_n: float
    v_t: float
    spin: float
    slip: float
    tangential_restitution: float | None
    rebound_angle: float


def gross_sliding(
    v_n: float, v_t: float, *, friction: float, e_n: float, radius: float, spin: float = 0.0
) -> GrossSliding:
    """Return the motion of a solid sphere after an oblique impact on a wall that slides to its end.

    The tangential impulse is mu times the normal one, m (1 + e_n) v_n: it takes mu (1 + e_n) v_n from the speed of the
    centre, adds (5/2) mu (1 + e_n) v_n/R to the spin, and so takes (7/2) mu (1 + e_n) v_n from the slip (rigid-body
    impulses; Foerster et al., Phys. Fluids 6 (1994) 1108). The force must not pull, or |F| would rub the other way:
    exact for an undamped contact or one without attraction.

    Parameters
    ----------
    v_n, v_t : normal and tangential speed before the impact [m/s]
    friction, e_n : Coulomb coefficient and normal restitution [-]
    radius : [m]
    spin : before the impact, about the axis of rolling forward [rad/s]; negative: backspin

    Raises
    ------
    InputError
        If an argument is out of range.
    ValidityError
        If the slip v_t - R spin is below (7/2) mu (1 + e_n) v_n: the contact would stick before its end.
    """
    normal, tangential = float(positive("v_n", v_n, unit="m/s")), float(in_range("v_t", v_t, 0.0, math.inf, unit="m/s"))
    mu, r = float(in_range("friction", friction, 0.0, 1e3)), float(positive("radius", radius, unit="m"))
    e = float(in_range("e_n", e_n, 0.0, 1.0, low_open=True))
    before = tangential - r * float(in_range("spin", spin, -math.inf, math.inf, unit="rad/s"))
    lost = mu * (1.0 + e) * normal
    if before < 3.5 * lost:
        raise ValidityError(
            f"slip/v_n = {before / normal:.4g}: expected at least 7/2 mu (1 + e_n) = {3.5 * lost / normal:.4g} for "
            "sliding to the end; below it the tangential spring decides, integrate the model instead"
        )
    return GrossSliding(
        v_n=e * normal,
        v_t=tangential - lost,
        spin=spin + 2.5 * lost / r,
        slip=before - 3.5 * lost,
        tangential_restitution=1.0 - lost / tangential if tangential else None,
        rebound_angle=math.atan2(tangential - lost, e * normal),
    )


@dataclass(frozen=True, kw_only=True)
class DampedBounce:
    """One contact of the linear law under gravity.

    Attributes
    ----------
    t_c : duration [s], to zero overlap
    v_out : leaving speed [m/s]
    e_n : v_out/v_0 [-]
    delta_max, delta_mean : maximum and time mean of the overlap [m]
    """

    t_c: float
    v_out: float
    e_n: float
    delta_max: float
    delta_mean: float


def damped_bounce(*, m: float, k_n: float, eta_n: float, g: float, v_0: float) -> DampedBounce:
    """Return the contact of a sphere of mass ``m`` that meets a wall at ``v_0`` under gravity ``g``, linear law.

    delta = delta_s + exp(-zeta omega s) (-delta_s cos w s + (v_0 - zeta omega delta_s)/w sin w s), delta_s = m g/k_n,
    w = omega sqrt(1 - zeta²), to the first return to zero; delta_mean from the balance of momentum,
    k_n ∫delta ds = m (v_0 + v_out) + m g t_c. The damped oscillator; verification cases DEM01, DEM02 of MFIX.

    Parameters
    ----------
    m, k_n, eta_n : mass [kg], stiffness [N/m], damping coefficient [N s/m]
    g : gravity towards the wall, 0 or more [m/s²]
    v_0 : speed at first touch [m/s]

    Raises
    ------
    InputError
        If an argument is out of range.
    ValidityError
        If the contact is overdamped, or gravity holds the sphere so that it does not come off.
    """
    from scipy.optimize import brentq

    mass, k, v = (float(positive(*a)) for a in (("m", m), ("k_n", k_n), ("v_0", v_0)))
    eta, pull = float(in_range("eta_n", eta_n, 0.0, math.inf)), float(in_range("g", g, 0.0, math.inf))
    omega = math.sqrt(k / mass)
    zeta = eta / (2.0 * math.sqrt(k * mass))
    if zeta >= 1.0:
        raise ValidityError(f"eta_n = {eta:g}: expected less than critical damping, {2.0 * math.sqrt(k * mass):g}")
    w, rest = omega * math.sqrt(1.0 - zeta**2), mass * pull / k
    sine = (v - zeta * omega * rest) / w

    def overlap(s: float) -> float:
        return rest + math.exp(-zeta * omega * s) * (sine * math.sin(w * s) - rest * math.cos(w * s))

    # the rate is exp(-zeta omega s) (v cos w s - slope sin w s): extrema half a period apart
    slope = zeta * omega * sine - w * rest
    deepest = math.atan2(v, slope) / w
    highest = deepest + math.pi / w
    if overlap(highest) > 0.0:
        raise ValidityError(
            f"v_0 = {v:g} m/s: the sphere stays in contact and comes to rest at delta = {rest:.6g} m: expected a "
            "faster impact"
        )
    t_c = float(brentq(overlap, deepest, highest, xtol=1e-300, rtol=8.9e-16))
    v_out = -math.exp(-zeta * omega * t_c) * (v * math.cos(w * t_c) - slope * math.sin(w * t_c))
    return DampedBounce(
        t_c=t_c,
        v_out=v_out,
        e_n=v_out / v,
        delta_max=overlap(deepest),
        delta_mean=(mass * (v + v_out) + mass * pull * t_c) / (k * t_c),
    )
