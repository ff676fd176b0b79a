"""The ways to find the linear stiffness k_n: one row each, with source, what it keeps equal and where it fails.

Every method gives kappa, with k_n = kappa k_h^(4/5) m_eff^(1/5) v_0^(2/5). M, A, T_c stand for the dimensionless
maximum overlap, mean overlap and duration of the linear contact (units v_0/omega, v_0/omega, 1/omega), and
x_max, x_mean, tau_c for those of the reference contact (see `kncal.physics.impact`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from kncal.core.checks import Range, one_of
from kncal.core.errors import InputError
from kncal.core.registry import Registry
from kncal.physics.impact import DimensionlessImpact
from kncal.physics.material import FloatOrArray, Pair, plain

#: Strain-energy equivalence with elastic Hertz: kappa = (4/5)^(4/5).
KAPPA_STRAIN_ENERGY = 0.8**0.8

#: What options may be: a range (wide, but every stiffness within it is a finite number), or words.
OPTIONS: Mapping[str, Range | tuple[str, ...]] = {
    "fraction": Range(1e-9, 1.0, hint="a fraction of the length, usually 0.001 to 0.01"),
    "of": ("diameter", "sum_of_radii"),
    "t_c": Range(1e-15, 1e6, "s", "a contact usually lasts 1e-6 to 1e-3 s"),
    "force": Range(1e-30, 1e20, "N", "for example the weight of a particle"),
    "factor": Range(1e-9, 1e6, hint="1 by convention"),
}


@dataclass(frozen=True, eq=False)
class MethodInputs:
    """What a method may use: the pair, the speed, both dimensionless impacts and its own options.

    Attributes
    ----------
    pair : Pair
    v_0 : impact speed [m/s]
    base : k_h^(4/5) m_eff^(1/5) v_0^(2/5) [N/m]
    scale : the reference contact's m_eff v_0²/L² over ``base`` [-] (1 for Hertz-type laws)
    reference, linear : DimensionlessImpact
    options : checked options of the method
    """

    pair: Pair
    v_0: FloatOrArray
    base: FloatOrArray
    scale: FloatOrArray
    reference: DimensionlessImpact
    linear: DimensionlessImpact
    options: Mapping[str, Any]


@dataclass(frozen=True)
class Method:
    """One way to find k_n.

    Attributes
    ----------
    name, title, source : identification
    keeps, loses, avoid : what stays equal to the reference, what does not, where not to use it
    kappa : MethodInputs -> kappa [-]
    required, optional : names of its options (optional ones with their defaults)
    """

    name: str
    title: str
    source: str
    keeps: str
    loses: str
    avoid: str
    kappa: Callable[[MethodInputs], FloatOrArray]
    required: tuple[str, ...] = ()
    optional: Mapping[str, Any] | None = None

    def own(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return those of the options that this method takes."""
        return {name: value for name, value in given.items() if name in (*self.required, *(self.optional or {}))}

    def options(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the complete options, checked; raise `InputError` for unknown, missing or bad ones."""
        optional = dict(self.optional or {})
        known = {*self.required, *optional}
        for name in given:
            if name not in known:
                expected = ", ".join(sorted(known)) or "none"
                raise InputError(f"method {self.name!r} has no option {name!r}: expected options: {expected}")
        for name in self.required:
            if name not in given:
                raise InputError(f"method {self.name!r} needs the option {name!r}: {self.title}")
        return {name: _option(name, value) for name, value in (optional | dict(given)).items()}


def _option(name: str, value: Any) -> FloatOrArray | str:
    allowed = OPTIONS[name]
    return plain(allowed.check(name, value)) if isinstance(allowed, Range) else one_of(name, value, allowed)


def _mean_overlap(q: MethodInputs) -> FloatOrArray:
    return q.scale * (q.linear.x_mean / q.reference.x_mean) ** 2


def _max_overlap(q: MethodInputs) -> FloatOrArray:
    return q.scale * (q.linear.x_max / q.reference.x_max) ** 2


def _contact_duration(q: MethodInputs) -> FloatOrArray:
    return q.scale * (q.linear.tau_c / q.reference.tau_c) ** 2


def _strain_energy(q: MethodInputs) -> FloatOrArray:
    return KAPPA_STRAIN_ENERGY


def _max_overlap_secant(q: MethodInputs) -> FloatOrArray:
    # k_h sqrt(x_max L) with L = v_0 sqrt(m/(scale base)); base^(5/4) = k_h m^(1/4) sqrt(v_0)
    return np.sqrt(q.reference.x_max) * np.asarray(q.scale) ** -0.25


def _limited_overlap(q: MethodInputs) -> FloatOrArray:
    length = 2.0 * q.pair.R_min if q.options["of"] == "diameter" else q.pair.R_sum
    fraction: FloatOrArray = q.options["fraction"]
    return q.pair.m_eff * (q.linear.x_max * q.v_0 / (fraction * length)) ** 2 / q.base


def _contact_time(q: MethodInputs) -> FloatOrArray:
    t_c: FloatOrArray = q.options["t_c"]
    return q.pair.m_eff * (q.linear.tau_c / t_c) ** 2 / q.base


def _static_load(q: MethodInputs) -> FloatOrArray:
    force: FloatOrArray = q.options["force"]
    return np.cbrt(q.pair.k_h**2 * force) / q.base


def _youngs_modulus(q: MethodInputs) -> FloatOrArray:
    factor: FloatOrArray = q.options["factor"]
    return factor * q.pair.E_eff * q.pair.R_eff / q.base


_PAPER = "Navarro & Braun, Powder Technol. 246 (2013) 707–722, by the paper's method as reconstructed"

_ROWS = (
    Method(
        name="mean_overlap",
        title="equal time-mean overlap",
        source=_PAPER,
        keeps="the overlap averaged over the contact (time mean, contact end as chosen), and e_n",
        loses="maximum overlap (2 % smaller near e_n = 1) and duration (5 % longer)",
        avoid="e_n below about 0.1 with the overlap end: kappa diverges",
        kappa=_mean_overlap,
    ),
    Method(
        name="max_overlap",
        title="equal maximum overlap",
        source=_PAPER,
        keeps="the maximum overlap, and e_n",
        loses="duration (7 % longer near e_n = 1) and mean overlap",
        avoid="matching contact durations, e.g. heat transfer in contact",
        kappa=_max_overlap,
    ),
    Method(
        name="contact_duration",
        title="equal contact duration",
        source=_PAPER + "; the condition of Stevens & Hrenya, Powder Technol. 154 (2005) 99–109",
        keeps="the duration t_c, and e_n",
        loses="maximum (6 % smaller near e_n = 1) and mean overlap (5 % smaller)",
        avoid="e_n below about 0.1 with the overlap end: kappa goes to zero",
        kappa=_contact_duration,
    ),
    Method(
        name="strain_energy",
        title="equal elastic energy at the elastic Hertz maximum overlap",
        source="Lan & Rosato, Phys. Fluids 7 (1995) 1818; the formula of LIGGGHTS model `hooke`",
        keeps="strain energy at maximum overlap of the undamped contact; equals max_overlap at e_n = 1",
        loses="for e_n < 1 the overlap: the damping is not in the formula",
        avoid="e_n well below 1",
        kappa=_strain_energy,
    ),
    Method(
        name="limited_overlap",
        title="maximum overlap limited to a fraction of the diameter or of the sum of radii",
        source="after Lan & Rosato, Phys. Fluids 9 (1997) 3615 and Dury & Ristow; prefactor by the exact "
        "damped maximum overlap M",
        keeps="delta_max = fraction · length at v_0, and e_n",
        loses="every link to the material: a numerical choice",
        avoid="stresses, sound speed, or anything that depends on stiffness",
        kappa=_limited_overlap,
        required=("fraction",),
        optional={"of": "diameter"},
    ),
    Method(
        name="max_overlap_secant",
        title="secant of the Hertz curve at its maximum overlap, k_h sqrt(delta_max)",
        source="secant definition F_max/delta_max; undamped 5/4 of strain_energy",
        keeps="the elastic force at the reference's maximum overlap",
        loses="the overlap itself (the linear contact penetrates 11 % less near e_n = 1)",
        avoid="matching overlaps or durations",
        kappa=_max_overlap_secant,
    ),
    Method(
        name="contact_time",
        title="given contact duration t_c",
        source="Schäfer, Dippel & Wolf, J. Phys. I France 6 (1996) 5–20 (overlap end); "
        "Schwager & Pöschel, Granul. Matter 9 (2007) 465 (force end)",
        keeps="the duration you give, and e_n",
        loses="every link to the material",
        avoid="choosing t_c from the time step you can afford without looking at delta_max",
        kappa=_contact_time,
        required=("t_c",),
    ),
    Method(
        name="static_load",
        title="secant of the Hertz curve at a resting force, k_h^(2/3) F^(1/3)",
        source="Hertz law, Johnson, Contact Mechanics (1985), ch. 4",
        keeps="the overlap under the resting force",
        loses="everything about impacts at v_0",
        avoid="flows dominated by collisions",
        kappa=_static_load,
        required=("force",),
    ),
    Method(
        name="youngs_modulus",
        title="proportional to the modulus, factor · E_eff · R_eff",
        source="after Buchholtz & Pöschel, Physica A 202 (1994) 390; prefactor is a convention (1 by default)",
        keeps="stiffness independent of the speed",
        loses="right at one speed only; stiffer than an impact asks for by about (E_eff/(rho v_0²))^(1/5)",
        avoid="matching any property of an impact",
        kappa=_youngs_modulus,
        optional={"factor": 1.0},
    ),
)

#: The methods by name; packages add theirs by entry points of the group ``kncal.methods``.
METHODS = Registry("method", Method, *_ROWS, group="kncal.methods")
