"""Time steps: physical limits, stability of the iteration, advice for both models, and the error to expect."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from kncal.calibration import PAIR_SOURCE, SPEEDS, Calibration, reference_stiffness
from kncal.checks import Array, common_shape, in_range, instance, one_of, positive, positive_result, single
from kncal.contact.base import ENDS, ContactLaw
from kncal.contact.registry import get_law
from kncal.contact.walton_braun import WaltonBraun
from kncal.errors import InputError
from kncal.impact import dimensionless_impact
from kncal.material import FloatOrArray, Material, Pair, checked_radius, plain
from kncal.measure import measure_contact

#: Sub-step phases of the first touch over which a predicted error is taken ...
PHASES = 24
#: ... for each of these changes of N: a contact of a scene rarely lasts a whole number of steps, and the error is a
#: sawtooth of the fraction left over, whose peaks a coarser sample misses.
OFFSETS = np.linspace(-0.5, 0.5, 21)


def contact_time(k_n: ArrayLike, m_eff: ArrayLike, e_n: ArrayLike, end: str = "overlap") -> FloatOrArray:
    """Duration of a linear contact [s]: T_c(e_n, end) sqrt(m_eff/k_n); pi/(omega sqrt(1 - zeta²)) at the overlap end.

    Schäfer, Dippel & Wolf, J. Phys. I France 6 (1996) 5–20.
    """
    stiffness, mass = positive("k_n", k_n, unit="N/m"), positive("m_eff", m_eff, unit="kg")
    tau_c = dimensionless_impact("linear", e_n, end).tau_c
    common_shape(k_n=stiffness, m_eff=mass, e_n=tau_c)
    with np.errstate(all="ignore"):  # what leaves the range of floats is told below
        t_c = np.asarray(tau_c * np.sqrt(mass / stiffness))
    positive_result("t_c [s]", t_c, "k_n or m_eff")
    return plain(t_c)


def hertz_time(
    pair: Pair, v_0: ArrayLike, e_n: ArrayLike = 1.0, law: str | ContactLaw = "tsuji", end: str = "overlap"
) -> FloatOrArray:
    """Duration of a Hertz-type contact [s]: tau_c L/v_0 with L = (m_eff v_0²/k_h)^(2/5).

    Elastic: 2.8683 (m_eff²/(R_eff E_eff² v_0))^(1/5); Johnson, Contact Mechanics (1985), section 11.4.
    """
    instance("pair", pair, Pair, PAIR_SOURCE)
    speed = in_range("v_0", v_0, *SPEEDS, unit="m/s")
    tau_c = dimensionless_impact(law, e_n, end).tau_c
    common_shape(pair=pair, v_0=speed, e_n=tau_c)
    return plain(np.asarray(tau_c * (pair.m_eff * speed**2 / pair.k_h) ** 0.4 / speed))


def rayleigh_time(material: Material, radius: ArrayLike) -> FloatOrArray:
    """Time for a Rayleigh wave around a sphere [s]: pi R sqrt(rho/G)/(0.1631 nu + 0.8766).

    Formula as used by LIGGGHTS' `fix check/timestep/gran`; steps of 10 to 20 % of it are customary.
    """
    instance("material", material, Material, "made by kncal.Material")
    r = checked_radius("radius", radius)
    common_shape(material=material, radius=r)
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
    common_shape(k_n=stiffness, m_eff=mass, eta_n=damping, contacts=factor)
    with np.errstate(all="ignore"):  # what leaves the range of floats is told below
        omega = np.sqrt(stiffness / mass) * factor
        zeta = damping / (2.0 * np.sqrt(stiffness * mass)) * factor
        # 2 (sqrt(1 + z²) - z) without cancellation for large damping
        limit = np.asarray(2.0 / (np.hypot(1.0, zeta) + zeta) / omega)
    positive_result("the largest stable step [s]", limit, "k_n, m_eff or eta_n")
    return plain(limit)


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeStepAdvice:
    """A time step for the linear and for the reference contact, N steps per contact duration in both.

    Attributes
    ----------
    steps_per_contact : N [-]
    linear, hertz : advised step dt = t_c/N [s]
    linear_limit, hertz_limit : stability limits [s] with ``contacts`` contacts per particle
        (for the reference contact with its stiffest spring, loading or unloading, and damping at maximum overlap)
    speed_up : hertz/linear, the ratio of the numbers of steps [-]
    contacts : contacts per particle of the limits
    warnings : what to do where an advised step is not below its limit; empty if ``stable``
    """

    steps_per_contact: float
    linear: FloatOrArray
    hertz: FloatOrArray
    linear_limit: FloatOrArray
    hertz_limit: FloatOrArray
    contacts: float
    warnings: tuple[str, ...]

    @property
    def speed_up(self) -> FloatOrArray:
        """How many times fewer steps the linear contact needs."""
        return self.linear / self.hertz

    @property
    def stable(self) -> bool:
        """Whether both steps are below their limits, everywhere."""
        return not self.warnings


def advise_time_step(
    calibration: Calibration, steps_per_contact: float = 50.0, contacts: float = 12.0
) -> TimeStepAdvice:
    """Advise dt for N steps per contact, with the same meaning of N for the linear and the reference contact.

    Raises
    ------
    InputError
        If N is below 1 (no contact would be resolved), or N or contacts is not a single finite number.
    """
    c = instance("calibration", calibration, Calibration, "made by kncal.calibrate")
    n = float(in_range("steps_per_contact", single("steps_per_contact", steps_per_contact), 1.0, 1e7))
    z = single("contacts", contacts)
    linear, linear_limit = c.t_c / n, verlet_limit(c.k_n, c.pair.m_eff, c.eta_n, z)
    hertz, hertz_limit = c.reference.t_c / n, verlet_limit(*_stiffest(c), z)
    return TimeStepAdvice(
        steps_per_contact=n,
        linear=linear,
        hertz=hertz,
        linear_limit=linear_limit,
        hertz_limit=hertz_limit,
        contacts=z,
        warnings=(*_unstable("linear", linear, linear_limit, n, z), *_unstable("reference", hertz, hertz_limit, n, z)),
    )


def _stiffest(c: Calibration) -> tuple[FloatOrArray, FloatOrArray, FloatOrArray]:
    """Stiffness [N/m], mass [kg] and damping [N s/m] of the reference contact where it is stiffest: at delta_max."""
    law, mass = c.contact_law, c.pair.m_eff
    stiffness = reference_stiffness(c.pair, c.v_0, law)
    if isinstance(law, WaltonBraun):
        # Unloading has the stiffer spring; energy is lost between the springs, not in a dashpot.
        return stiffness / c.e_n**2, mass, 0.0
    x_max = c.reference.delta_max / (c.v_0 * np.sqrt(mass / stiffness))
    tangent = law.stiffness_exponent * stiffness * x_max ** (law.stiffness_exponent - 1.0)
    p = law.damping_exponent
    damping = 0.0 if p is None else c.reference.C * np.sqrt(stiffness * mass) * x_max**p
    return tangent, mass, damping


def _unstable(name: str, step: FloatOrArray, limit: FloatOrArray, n: float, contacts: float) -> Iterator[str]:
    excess = float(np.max(np.asarray(step) / limit))
    if excess >= 1.0:
        yield (
            f"the step of the {name} contact, t_c/{n:g}, is {excess:.3g} of the largest stable one with {contacts:g} "
            f"contacts per particle: expected more than {n * excess:.4g} steps per contact"
        )


@dataclass(frozen=True, kw_only=True)
class PredictedError:
    """What velocity Verlet does to one impact at N steps per contact.

    Relative deviations from the exact contact over sampled sub-step phases of first touch, N varied by half a step
    to either side: ``mean`` over them, and ``worst`` (largest absolute value). The worst of a sample is a few percent
    below the worst there is.

    Attributes
    ----------
    mean, worst : mapping e_n, t_c, delta_max, delta_mean -> relative error [-]; cannot be changed
    """

    law: str
    e_n: float
    end: str
    steps_per_contact: float
    mean: Mapping[str, float]
    worst: Mapping[str, float]


def predict_error(
    law: str | ContactLaw, e_n: float, steps_per_contact: float = 50.0, end: str = "overlap"
) -> PredictedError:
    """Predict the discretisation error of restitution, duration and overlaps at N steps per contact.

    The iteration of LIGGGHTS, LAMMPS and MFIX's EULER (velocity Verlet, damping from half-step velocities) is
    stepped in dimensionless form from sampled sub-step phases of first touch; what is measured uses the same
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
        For a law with a history (walton_braun), N below 3 or an unstable N (contact never ends), or an e_n or N that
        is not a single number in its range.
    """
    n = float(in_range("steps_per_contact", single("steps_per_contact", steps_per_contact), 3.0, 1e5))
    contact_law = get_law(law)
    if isinstance(contact_law, WaltonBraun):
        raise InputError(f"law = {contact_law.name!r}: expected a law without history for the predicted error")
    return _predict(contact_law, single("e_n", e_n), n, one_of("end", end, ENDS))


@lru_cache(maxsize=512)
def _predict(law: ContactLaw, e_n: float, n: float, end: str) -> PredictedError:
    impact = dimensionless_impact(law, e_n, end)
    # A run is observed until the overlap is back at zero: after a force end the bodies coast there at speed e_n.
    coasting = impact.x_end / e_n
    duration = float(impact.tau_c + coasting)
    exact = {
        "e_n": e_n,
        "t_c": duration,
        "delta_max": float(impact.x_max),
        "delta_mean": float(impact.x_mean * impact.tau_c + 0.5 * impact.x_end * coasting) / duration,
    }
    dt = np.repeat(float(impact.tau_c) / (n + OFFSETS), PHASES)
    times, x, v = _verlet(law, float(impact.C), dt, n, end)
    measured = measure_contact(times, x, v)
    found = {
        "e_n": measured.v_out / measured.v_in,
        "t_c": measured.t_c,
        "delta_max": measured.delta_max,
        "delta_mean": measured.delta_mean,
    }
    errors = {name: found[name] / value - 1.0 for name, value in exact.items()}
    return PredictedError(
        law=law.name,
        e_n=e_n,
        end=end,
        steps_per_contact=n,
        mean=MappingProxyType({name: float(np.mean(values)) for name, values in errors.items()}),
        worst=MappingProxyType({name: float(np.max(np.abs(values))) for name, values in errors.items()}),
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
