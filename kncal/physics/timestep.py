"""Time steps: physical limits, stability of the iteration, advice for both models, and the error to expect."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from kncal.core.checks import Array, common_shape, in_range, instance, one_of, positive, positive_result, short, single
from kncal.core.errors import InputError
from kncal.physics.calibration import PAIR_SOURCE, SPEEDS, Calibration, reference_stiffness
from kncal.physics.contact_estimators import measure_contact
from kncal.physics.impact import dimensionless_impact
from kncal.physics.laws import LAWS
from kncal.physics.laws.base import ENDS, ContactLaw
from kncal.physics.laws.walton_braun import WaltonBraun
from kncal.physics.material import FloatOrArray, Material, Pair, checked_radius, plain

#: Steps per contact that are usual; fewer are advised nowhere.
USUAL_STEPS = 50.0
#: Largest error of e_n, over the sub-step phases of first touch, that an advised number of steps may make; a run is
#: warned of twice that, so that nobody is sent after the last tenth of a per cent.
ADVISED_ERROR, WARNED_ERROR = 0.01, 0.02
#: An e_n is called resolved by a step that makes it no more wrong than this.
RESOLVED_ERROR = 0.1
#: Beyond so many steps an error is not predicted but taken to fall as 1/N, the order of a damped contact: the memory of
#: a prediction grows with N.
_MOST_PREDICTED = 1000.0
#: Numbers of steps that are advised: of two digits.
_LADDER = [float(digits * 10**k) for k in range(5) for digits in range(10, 100)]
#: Sub-step phases of the first touch over which a predicted error is taken ...
PHASES = 24
#: ... for each of these changes of N: a contact of a scene rarely lasts a whole number of steps, and the error is a
#: sawtooth of the fraction left over, whose peaks a coarser sample misses.
OFFSETS = np.linspace(-0.5, 0.5, 21)
#: Frames of a series above which fewer of those changes are taken, and most of all series together (0.5 GiB).
_FINE, _MOST_FRAMES = 5_000, 5_000_000


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


class DiscreteContactError(InputError):
    """The iteration of a contact does not end: too few steps for its damping."""


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
    calibration: Calibration, steps_per_contact: float | None = None, contacts: float = 12.0
) -> TimeStepAdvice:
    """Advise dt for N steps per contact, with the same meaning of N for the linear and the reference contact.

    Parameters
    ----------
    calibration : Calibration
    steps_per_contact : N; None: `USUAL_STEPS`, and more where the smallest e_n needs more to be right to
        `ADVISED_ERROR` in both contacts (`advised_steps`)
    contacts : contacts per particle of the stability limits

    Raises
    ------
    InputError
        If N is below 1 (no contact would be resolved), or N or contacts is not a single finite number.
    """
    c = instance("calibration", calibration, Calibration, "made by kncal.calibrate")
    if steps_per_contact is None:
        steps_per_contact = usual_steps(c.contact_law, float(np.min(c.e_n)), c.end)
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
    contact_law = LAWS.find(law)
    if isinstance(contact_law, WaltonBraun):
        raise InputError(f"law = {contact_law.name!r}: expected a law without history for the predicted error")
    return _predict(contact_law, single("e_n", e_n), n, one_of("end", end, ENDS))


def restitution_error(
    law: str | ContactLaw, e_n: float, steps_per_contact: float = USUAL_STEPS, end: str = "overlap"
) -> float | None:
    """Return the largest relative error of e_n that a step makes, over the sub-step phases of first touch [-].

    As `predict_error`, for any N: infinite where the discrete contact does not end or is not resolved (N below 3),
    falling as 1/N beyond 1000 steps. None where nothing is predicted: a law with a history, or without damping where
    e_n is below 1.
    """
    n = float(in_range("steps_per_contact", single("steps_per_contact", steps_per_contact), 0.0, np.inf, low_open=True))
    contact_law, e = LAWS.find(law), single("e_n", e_n)
    if isinstance(contact_law, WaltonBraun) or (contact_law.damping_exponent is None and e < 1.0):
        return None
    if n < 3.0:
        return float("inf")
    impact = dimensionless_impact(contact_law, e, end)
    coasting = float(impact.x_end / (e * impact.tau_c))  # of a force end, see `_predict`
    few = min(n, max(_MOST_PREDICTED / (1.0 + coasting), 20.0))
    try:
        return predict_error(contact_law, e, few, end).worst["e_n"] * (few / n)
    except DiscreteContactError:
        return float("inf")


def advised_steps(
    law: str | ContactLaw, e_n: float, end: str = "overlap", error: float = ADVISED_ERROR
) -> float | None:
    """Return the N, of two digits, from which on e_n is right to ``error`` at any sub-step phase of first touch.

    10 at least: with fewer, duration and overlaps mean little. None where nothing is predicted (`restitution_error`),
    or no N below 1e6 is enough.
    """
    allowed = float(in_range("error", single("error", error), 1e-4, 1.0))

    def found(k: int) -> float:
        return restitution_error(law, e_n, _LADDER[k], end) or 0.0

    if restitution_error(law, e_n, _LADDER[0], end) is None:
        return None
    # The error falls with N, about as 1/N: up by that until it is small enough, then between there and what was not.
    failed, k = -1, 0
    while (error_k := found(k)) > allowed:
        failed, k = k, bisect_left(_LADDER, _LADDER[k] * min(max(error_k / allowed, 1.1), 4.0))
        if k >= len(_LADDER):
            return None
    return _LADDER[bisect_left(range(k), True, lo=failed + 1, key=lambda j: found(j) <= allowed)]


def usual_steps(law: str | ContactLaw, e_n: float, end: str = "overlap") -> float:
    """Return the N to take for a linear and a reference contact of one e_n: `USUAL_STEPS`, or more if e_n needs it."""
    return max(USUAL_STEPS, *(advised_steps(each, e_n, end) or 0.0 for each in ("linear", law)))


def smallest_restitution(
    steps_per_contact: float = USUAL_STEPS, laws: Collection[str | ContactLaw] = ("linear",), end: str = "overlap"
) -> float:
    """Return the smallest e_n, of two digits, that N steps per contact get right to `RESOLVED_ERROR` for all ``laws``.

    What to take in the place of e_n = 0, which no finite damping gives. 1 if there is none below.
    """
    ladder = [k / 1000.0 for k in range(1, 100)] + [k / 100.0 for k in range(10, 100)]
    if not isinstance(laws, (list, tuple, set, frozenset)):
        raise InputError(f"laws = {short(laws)}: expected a list of contact laws")

    def resolved(e_n: float) -> bool:
        found = (restitution_error(law, e_n, steps_per_contact, end) for law in laws)
        return all(error is None or error <= RESOLVED_ERROR for error in found)

    k = bisect_left(ladder, True, key=resolved)  # the error falls as e_n grows
    return ladder[k] if k < len(ladder) else 1.0


def instead_of_zero(steps_per_contact: float, laws: Collection[str | ContactLaw], end: str = "overlap") -> str:
    """Return what to do where e_n = 0 was asked for, in words."""
    least = smallest_restitution(steps_per_contact, laws, end)
    return (
        f"no finite damping lets nothing rebound; the smallest that {steps_per_contact:g} steps per contact give to "
        f"{100.0 * RESOLVED_ERROR:g} % is e_n = {least:g}, and more steps give less"
    )


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
    # of a long series fewer changes of N are taken: its error is small, its memory is not
    frames = n * max(duration / float(impact.tau_c), 1.0)
    offsets = OFFSETS[:: math.ceil(min(frames / _FINE, len(OFFSETS)))]
    dt = np.repeat(float(impact.tau_c) / (n + offsets), PHASES)
    # a strong damping creeps out for long
    times, x, v = _verlet(law, float(impact.C), dt, math.ceil(min(4.0 * frames + 50, _MOST_FRAMES / len(dt))), end)
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


def _verlet(law: ContactLaw, C: float, dt: Array, most: int, end: str) -> tuple[Array, Array, Array]:
    """Step all phases and offsets side by side, each with its ``dt`` (runs,), until each has separated.

    Returns times, overlaps and rates, each (runs, frames); ``most``: steps after which it is given up.
    """
    # nearly the whole range from 0 to 1: the worst phase of a force that jumps at touch is at its ends
    x: Array = -np.tile(np.linspace(1e-3, 1.0 - 1e-3, PHASES), len(dt) // PHASES) * dt
    v = np.ones_like(dt)
    a = np.zeros_like(dt)
    xs, vs = [x - dt, x], [v, v]
    for _ in range(most):
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
    raise DiscreteContactError(
        f"steps_per_contact: the discrete contact does not end in {most} steps; expected more steps per contact, or a "
        "larger e_n"
    )
