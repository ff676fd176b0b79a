"""A bed in a gas velocity that rises and falls: pressure drop against velocity, and U_mf from both branches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.physics.fluidization import minimum_fluidization_velocity, minimum_fluidization_velocity_wen_yu
from kncal.physics.statistics import average_of_samples
from kncal.record.series import BedSeries
from kncal.scene.gas import Gas

#: The packed part of a branch ends at this share of U_mf; U_mf with the other ends shows how much that matters.
PACKED, PACKED_OTHER = 0.8, (0.7, 0.9)
#: The packed part begins at most at this share of U_mf, or too little of its curve is seen.
BEGINS = 0.6
#: The bed is fluidised, and its pressure drop its plateau, above this multiple of U_mf.
FLUIDISED = 1.1
#: Fewest couplings in the packed part, and in the plateau.
FEWEST = 20
#: Couplings over which the pressure drop is averaged before its largest value is taken.
SMOOTH = 20
#: Parts of the plateau whose spread gives its uncertainty.
PARTS = 5


@dataclass(frozen=True, kw_only=True)
class Branch:
    """One branch of a fluidisation curve. Pressure drops are normalised, see `FluidizationCurve`.

    Attributes
    ----------
    U_0, drop : (n,) gas velocity [m/s] and pressure drop [-] in the order of time
    viscous, inertial : of the packed bed, drop = viscous U_0 + inertial U_0² [s/m], [s²/m²]
    U_mf : where that curve reaches 1 [m/s]
    uncertainty : its largest change when the packed part ends at other velocities, and the scatter about
        the curve, added in squares [m/s]
    eps_g, eps_g_uncertainty : mean void fraction of the packed part, from the mean height of the particles, and half
        of the range that it has there [-]
    ergun : U_mf by Ergun's equation at ``eps_g`` [m/s]
    plateau, plateau_uncertainty : mean drop of the fluidised bed, and from the spread of five parts of it [-]; None
        if the branch has too little of it
    U_mf_plateau : where the curve of the packed bed meets that plateau instead of 1 [m/s]; None likewise
    largest, largest_uncertainty : largest mean drop over `SMOOTH` couplings, and how far it is from that over
        twice as many [-]
    """

    U_0: Array
    drop: Array
    viscous: float
    inertial: float
    U_mf: float
    uncertainty: float
    eps_g: float
    eps_g_uncertainty: float
    ergun: float
    plateau: float | None
    plateau_uncertainty: float
    U_mf_plateau: float | None
    largest: float
    largest_uncertainty: float

    def packed_drop(self, U_0: Array) -> Array:
        """Return the normalised drop of the packed bed at ``U_0`` [m/s]."""
        velocity = np.asarray(U_0, dtype=np.float64)
        return self.viscous * velocity + self.inertial * velocity**2


@dataclass(frozen=True, kw_only=True)
class FluidizationCurve:
    """Both branches. Pressure drops are inlet pressure less gas column, over the weight less buoyancy per area.

    Attributes
    ----------
    rising, falling : Branch
    wen_yu : U_mf by the correlation of Wen and Yu [m/s]
    end : of the run [s]
    """

    rising: Branch
    falling: Branch
    wen_yu: float
    end: float


def fluidization_curve(series: BedSeries, gas: Gas | None) -> FluidizationCurve:
    r"""Return the fluidisation curve of a run whose gas velocity rises to its largest value and falls again.

    The usual construction (Kunii and Levenspiel, "Fluidization Engineering" (1991), chapter 3; Richardson in Davidson
    and Harrison, "Fluidization" (1971), chapter 2): the curve of the packed bed is extended to the pressure drop that
    carries the bed. The curve has the form of Ergun's equation, :math:`a U_0 + b U_0^2` with a, b >= 0, by least
    squares through the origin below 0.8 U_mf; a straight line would do for small particles only. What carries
    the bed is its weight less buoyancy over its area. The falling branch is the one to quote: at the beginning
    of the rising one the packing is whatever the start made it, and friction holds it together.

    The void fraction is :math:`1 - V_s/(2 \bar z A)`: mean height :math:`\bar z` of an even bed of solid volume
    :math:`V_s`. The momentum that the gas takes up where it enters the bed is part of its pressure drop.

    Raises
    ------
    InputError
        If there is no gas or a jet, no gravity, or a branch does not hold both the packed and the fluidised bed.
    """
    facts = series.facts
    if gas is None or facts.jet or not facts.weight > 0.0:
        raise InputError("no uniform gas flow against a weight: expected gas from the whole floor, particles, gravity")
    carried = facts.weight * (1.0 - gas.density / facts.density) / facts.floor_area
    drop = (series.p_in - gas.density * facts.gravity * facts.size[2]) / carried
    speed = series.U_0
    tops = np.flatnonzero(speed == speed.max())
    first = int(np.argmax(speed > speed[0]))  # 0 if it never rises
    rows = {"rising": slice(first, int(tops[0]) + 1), "falling": slice(int(tops[-1]), len(drop))}
    branches = {name: _branch(name, series, gas, drop, part) for name, part in rows.items()}
    wen_yu = minimum_fluidization_velocity_wen_yu(
        facts.diameter, facts.density, gas.density, gas.viscosity, facts.gravity
    )
    return FluidizationCurve(**branches, wen_yu=float(wen_yu), end=float(series.t[-1]))


def _branch(name: str, series: BedSeries, gas: Gas, drops: Array, part: slice) -> Branch:
    facts = series.facts
    speed, drop = series.U_0[part], drops[part]
    a, b = _packed(name, speed, drop)
    U_mf = _meets(a, b, 1.0)
    packed = speed <= PACKED * U_mf
    scatter = drop[packed] - a * speed[packed] - b * speed[packed] ** 2
    slope = a + 2.0 * b * U_mf
    # residuals of neighbouring couplings are alike: the curve is taken to be as uncertain as they are large
    deviations = [_meets(*_fit(speed, drop, share * U_mf), 1.0) - U_mf for share in PACKED_OTHER]
    uncertainty = float(np.hypot(max(map(abs, deviations)), float(np.std(scatter)) / slope))
    voids = 1.0 - facts.mass / facts.density / (facts.floor_area * 2.0 * series.z_mean[part][packed])
    eps_g = float(voids.mean())
    ergun = minimum_fluidization_velocity(
        facts.diameter, facts.density, gas.density, gas.viscosity, eps_g, facts.gravity
    )
    fluidised = drop[speed >= FLUIDISED * U_mf]
    plateau, spread, meets = None, 0.0, None
    if len(fluidised) >= FEWEST:
        parts = average_of_samples([p.mean() for p in np.array_split(fluidised, PARTS)])
        plateau, spread = float(fluidised.mean()), parts.uncertainty
        meets = _meets(a, b, plateau) if plateau > 0.0 else None
    largest, smoother = (float(_running(drop, width).max()) for width in (SMOOTH, 2 * SMOOTH))
    return Branch(
        U_0=speed,
        drop=drop,
        viscous=a,
        inertial=b,
        U_mf=U_mf,
        uncertainty=uncertainty,
        eps_g=eps_g,
        eps_g_uncertainty=0.5 * float(np.ptp(voids)),
        ergun=float(ergun),
        plateau=plateau,
        plateau_uncertainty=spread,
        U_mf_plateau=meets,
        largest=largest,
        largest_uncertainty=largest - smoother,
    )


def _running(values: Array, width: int) -> Array:
    """Return the means over ``width`` neighbours, or over all."""
    width = min(width, len(values))
    return np.convolve(values, np.full(width, 1.0 / width), mode="valid")


def _packed(name: str, speed: Array, drop: Array) -> tuple[float, float]:
    """Fit the packed part, whose end is a share of the U_mf that it gives: found by repetition."""
    order = np.argsort(speed, kind="stable")
    reached = np.flatnonzero(np.maximum.accumulate(drop[order]) >= PACKED)
    if not len(reached) or speed.max() <= speed.min():
        raise InputError(
            f"{name} gas velocity: the pressure drop reaches {drop.max():.2g} of the bed's weight per area: expected a"
            " ramp that fluidises the bed"
        )
    U_mf = float(speed[order][reached[0]]) / PACKED**0.5
    for _ in range(50):
        a, b = _fit(speed, drop, PACKED * U_mf)
        last, U_mf = U_mf, _meets(a, b, 1.0)
        if abs(U_mf - last) <= 1e-9 * U_mf:
            break
    lowest = float(speed.min())
    if lowest > BEGINS * U_mf or speed.max() < U_mf:
        raise InputError(
            f"{name} gas velocity: from {lowest:.3g} to {speed.max():.3g} m/s with U_mf about {U_mf:.3g} m/s:"
            f" expected it to begin below {BEGINS:g} U_mf and to end above U_mf"
        )
    return a, b


def _fit(speed: Array, drop: Array, end: float) -> tuple[float, float]:
    """Return a, b >= 0 of drop = a speed + b U² for the part with speed <= ``end``, by least squares."""
    from scipy.optimize import nnls

    part = (speed <= end) & (speed > 0.0)
    if part.sum() < FEWEST:
        raise InputError(
            f"{part.sum()} couplings with a gas velocity below {end:.3g} m/s, {PACKED:g} U_mf: expected at least"
            f" {FEWEST}; begin the ramp lower, or make it slower"
        )
    (a, b), _ = nnls(np.stack([speed[part], speed[part] ** 2], axis=1), drop[part])
    if a + b <= 0.0:
        raise InputError("the pressure drop of the packed bed is not positive: expected it to rise with the velocity")
    return float(a), float(b)


def _meets(a: float, b: float, level: float) -> float:
    """Return speed > 0 with a speed + b U² = level."""
    return float(2.0 * level / (a + np.sqrt(a**2 + 4.0 * b * level)))
