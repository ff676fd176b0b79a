"""Time steps: physical limits, stability of the iteration, advice for both models, and the error to expect."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from kncal.calibration import Calibration
from kncal.checks import Array, in_range, positive
from kncal.contact.base import ContactLaw
from kncal.contact.registry import get_law
from kncal.errors import InputError
from kncal.impact import dimensionless_impact
from kncal.material import FloatOrArray, Material, Pair, plain
from kncal.measure import measure_contact

#: Sub-step phases of the first touch over which a predicted error is taken ...
PHASES = 24
#: ... for each of these changes of N: a contact of a scene rarely lasts a whole number of steps, and an undamped one
#: that does is integrated better than any other.
OFFSETS = (-0.5, -0.25, 0.0, 0.25, 0.5)


def contact_time(k_n: ArrayLike, m_eff: ArrayLike, e_n: ArrayLike, end: str = "overlap") -> FloatOrArray:
    """Duration of a linear contact [s]: T_c(e_n, end) sqrt(m_eff/k_n); pi/(omega sqrt(1 - zeta²)) at the overlap end.

    Schäfer, Dippel & Wolf, J. Phys. I France 6 (1996) 5–20.
    """
    stiffness, mass = positive("k_n", k_n, unit="N/m"), positive("m_eff", m_eff, unit="kg")
    return plain(np.asarray(dimensionless_impact("linear", e_n, end).tau_c * np.sqrt(mass / stiffness)))


def hertz_time(
    pair: Pair, v_0: ArrayLike, e_n: ArrayLike = 1.0, law: str | ContactLaw = "tsuji", end: str = "overlap"
) -> FloatOrArray:
    """Duration of a Hertz-type contact [s]: tau_c L/v_0 with L = (m_eff v_0²/k_h)^(2/5).

    Elastic: 2.8683 (m_eff²/(R_eff E_eff² v_0))^(1/5); Johnson, Contact Mechanics (1985), section 11.4.
    """
    speed = positive("v_0", v_0, unit="m/s")
    tau_c = dimensionless_impact(law, e_n, end).tau_c
    return plain(np.asarray(tau_c * (pair.m_eff * speed**2 / pair.k_h) ** 0.4 / speed))


def rayleigh_time(material: Material, radius: ArrayLike) -> FloatOrArray:
    """Time for a Rayleigh wave around a sphere [s]: pi R sqrt(rho/G)/(0.1631 nu + 0.8766).

    Formula as used by LIGGGHTS' `fix check/timestep/gran`; steps of 10 to 20 % of it are customary.
    """
    r = positive("radius", radius, unit="m")
    speed = np.sqrt(material.shear / material.density)
    return plain(np.asarray(np.pi * r / (speed * (0.1631 * material.poisson + 0.8766))))


def verlet_limit(k_n: ArrayLike, m_eff: ArrayLike, eta_n: ArrayLike = 0.0, contacts: float = 1) -> FloatOrArray:
    """Largest stable step of velocity Verlet with half-step velocities [s].

    One contact: omega dt < 2 (sqrt(1 + zeta²) - zeta), from the eigenvalues of the iteration. With z contacts per
    particle omega and zeta grow by at most sqrt(z) (Gershgorin bound on the stiffness matrix, equal pairs).

    Parameters
    ----------
    k_n, m_eff, eta_n : [N/m], [kg], [N s/m]
    contacts : contacts per particle z, >= 1 (12 for a dense packing of equal spheres)
    """
    stiffness, mass = positive("k_n", k_n, unit="N/m"), positive("m_eff", m_eff, unit="kg")
    damping = in_range("eta_n", eta_n, 0.0, np.inf, unit="N s/m")
    factor = np.sqrt(in_range("contacts", contacts, 1.0, 1e3))
    omega = np.asarray(np.sqrt(stiffness / mass) * factor)
    zeta = damping / (2.0 * np.sqrt(stiffness * mass)) * factor
    # 2 (sqrt(1 + z²) - z) without cancellation for large damping
    return plain(np.asarray(2.0 / (np.hypot(1.0, zeta) + zeta) / omega))


@dataclass(frozen=True, kw_only=True)
class TimeStepAdvice:
    """A time step for the linear and for the reference contact, N steps per contact duration in both.

    Attributes
    ----------
    steps_per_contact : N [-]
    linear, hertz : advised step dt = t_c/N [s]
    linear_limit, hertz_limit : stability limits [s] with ``contacts`` contacts per particle
        (for the reference contact with its tangent stiffness and damping at maximum overlap)
    speed_up : hertz/linear, the ratio of the numbers of steps [-]
    contacts : contacts per particle of the limits
    """

    steps_per_contact: float
    linear: FloatOrArray
    hertz: FloatOrArray
    linear_limit: FloatOrArray
    hertz_limit: FloatOrArray
    contacts: float

    @property
    def speed_up(self) -> FloatOrArray:
        """How many times fewer steps the linear contact needs."""
        return self.linear / self.hertz

    @property
    def stable(self) -> bool:
        """Whether both steps are below their limits, everywhere."""
        return bool(np.all(self.linear < self.linear_limit) and np.all(self.hertz < self.hertz_limit))


def advise_time_step(
    calibration: Calibration, steps_per_contact: float = 50.0, contacts: float = 12.0
) -> TimeStepAdvice:
    """Advise dt for N steps per contact, with the same meaning of N for the linear and the reference contact.

    Raises
    ------
    InputError
        If N is below 1 (no contact would be resolved) or not finite.
    """
    n = float(in_range("steps_per_contact", steps_per_contact, 1.0, 1e7))
    c, pair, reference = calibration, calibration.pair, calibration.reference
    law = c.contact_law
    if law.stiffness_exponent > 1.0:
        tangent = np.asarray(1.5 * pair.k_h * np.sqrt(reference.delta_max))
        p = law.damping_exponent or 0.0
        length = (pair.m_eff * c.v_0**2 / pair.k_h) ** 0.4
        damping = np.asarray(reference.C * (pair.m_eff * c.v_0 / length) * (reference.delta_max / length) ** p)
    else:
        tangent, damping = np.asarray(c.k_n), np.asarray(c.eta_n)
    return TimeStepAdvice(
        steps_per_contact=n,
        linear=c.t_c / n,
        hertz=reference.t_c / n,
        linear_limit=verlet_limit(c.k_n, pair.m_eff, c.eta_n, contacts),
        hertz_limit=verlet_limit(tangent, pair.m_eff, damping, contacts),
        contacts=contacts,
    )


@dataclass(frozen=True, kw_only=True)
class PredictedError:
    """What velocity Verlet does to one impact at N steps per contact.

    Relative deviations from the exact contact over the sub-step phases of first touch, N varied by half a step to
    either side: ``mean`` over them, and ``worst`` (largest absolute value).

    Attributes
    ----------
    mean, worst : mapping e_n, t_c, delta_max, delta_mean -> relative error [-]
    """

    law: str
    e_n: float
    end: str
    steps_per_contact: float
    mean: dict[str, float]
    worst: dict[str, float]


@lru_cache(maxsize=512)
def predict_error(
    law: str | ContactLaw, e_n: float, steps_per_contact: float = 50.0, end: str = "overlap"
) -> PredictedError:
    """Predict the discretisation error of restitution, duration and overlaps at N steps per contact.

    The iteration of LIGGGHTS, LAMMPS and MFIX's EULER (velocity Verlet, damping from half-step velocities) is
    stepped in dimensionless form from several sub-step phases of first touch; what is measured uses the same
    estimators as a run's observations. A damped contact is first order in 1/N, an undamped one higher.

    Parameters
    ----------
    law : a contact law without history, or its name (all but "walton_braun")
    e_n : restitution, one number
    steps_per_contact : N >= 3
    end : contact end

    Raises
    ------
    InputError
        For a law with a history (walton_braun), or N below 3 or an unstable N (contact never ends).
    """
    n = float(in_range("steps_per_contact", steps_per_contact, 3.0, 1e5))
    contact_law = get_law(law)
    impact = dimensionless_impact(contact_law, e_n, end)
    if contact_law.name == "walton_braun":
        raise InputError("law = 'walton_braun': expected a law without history for the predicted error")
    # A run is observed until the overlap is back at zero: after a force end the bodies coast there at speed e_n.
    coasting = impact.x_end / e_n
    duration = float(impact.tau_c + coasting)
    exact = {
        "e_n": float(e_n),
        "t_c": duration,
        "delta_max": float(impact.x_max),
        "delta_mean": float(impact.x_mean * impact.tau_c + 0.5 * impact.x_end * coasting) / duration,
    }
    dt = np.repeat(float(impact.tau_c) / (n + np.array(OFFSETS)), PHASES)
    times, x, v = _verlet(contact_law, float(impact.C), dt, n, end)
    measured = measure_contact(times, x, v)
    found = {
        "e_n": measured.v_out / measured.v_in,
        "t_c": measured.t_c,
        "delta_max": measured.delta_max,
        "delta_mean": measured.delta_mean,
    }
    errors = {name: found[name] / value - 1.0 for name, value in exact.items()}
    return PredictedError(
        law=contact_law.name,
        e_n=float(e_n),
        end=end,
        steps_per_contact=n,
        mean={name: float(np.mean(values)) for name, values in errors.items()},
        worst={name: float(np.max(np.abs(values))) for name, values in errors.items()},
    )


def _verlet(law: ContactLaw, C: float, dt: Array, n: float, end: str) -> tuple[Array, Array, Array]:
    """Step all phases and offsets side by side, each with its ``dt`` (runs,), until each has separated.

    Returns times, overlaps and rates, each (runs, frames).
    """
    # nearly the whole range from 0 to 1: the worst phase of a force that jumps at touch is at its ends
    x: Array = -np.tile(np.linspace(1e-3, 1.0 - 1e-3, PHASES), len(OFFSETS)) * dt
    v = np.ones_like(dt)
    a = np.zeros_like(dt)
    limit = int(np.ceil(n * 4 + 50))
    xs, vs = [x - dt, x], [v, v]
    for _ in range(limit):
        half = v + 0.5 * dt * a
        x = x + dt * half
        touching = x > 0.0
        force = np.where(touching, law.force(np.maximum(x, 0.0), half, C), 0.0)
        if end == "force":
            force = np.maximum(force, 0.0)
        a = -force
        v = half + 0.5 * dt * a
        xs.append(x)
        vs.append(v)
        if ((x <= 0.0) & (v < 0.0)).all():
            xs.append(x + dt * v)
            vs.append(v)
            return dt[:, None] * np.arange(-1.0, len(xs) - 1.0), np.array(xs).T, np.array(vs).T
    raise InputError(f"steps_per_contact = {n:g}: the discrete contact does not end; expected more steps per contact")
