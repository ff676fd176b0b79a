"""From a pair, a speed and a restitution to the equivalent linear spring and dashpot, and what limits its validity.

The limits are small named checks that say what they saw; they never change a number.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kncal.core.checks import Array, common_shape, in_range, instance, one_of, positive_result
from kncal.core.errors import ValidityError
from kncal.physics.impact import NO_REBOUND, DimensionlessImpact, dimensionless_impact
from kncal.physics.laws import LAWS
from kncal.physics.laws.base import ContactLaw
from kncal.physics.material import FloatOrArray, Pair, plain
from kncal.physics.methods import KAPPA_STRAIN_ENERGY, METHODS, MethodInputs

if TYPE_CHECKING:
    import pandas as pd

#: Contact ends: overlap back to zero, or force back to zero (attraction cut off).
ENDS = ("overlap", "force")
#: Impact speeds served [m/s]: from nearly at rest to far beyond every elastic wave.
SPEEDS = (1e-12, 1e5)
#: Overlap over the smaller radius at which Hertz theory is doubtful, and at which it has no meaning.
OVERLAP_DOUBTFUL, OVERLAP_MEANINGLESS = 0.1, 1.0
#: Impact speed over elastic wave speed above which a contact is no longer quasi-static.
SPEED_RATIO_DOUBTFUL = 1e-2
#: Restitution below which mean overlap and duration are ill-posed at the overlap end (kappa -> inf or 0).
RESTITUTION_SMALL = 0.1
#: g/(omega v_0) above which the resting load matters as much as the impact.
GRAVITY_RATIO_DOUBTFUL = 0.1
#: Radius [m] above which a sphere is asked about: a bead of 1 mm given as 1 has one of a metre.
RADIUS_DOUBTFUL = 0.25
#: Size ratio from which velocity Verlet with half-step velocities shows artefacts in tangential terms
#: (arXiv 2410.14798).
SIZE_RATIO_DOUBTFUL = 3.0
#: Attraction at the end of the contact over the spring's largest force, from which it is worth a word.
ATTRACTION_NOTABLE = 0.05
#: Hertz: yield begins below the surface at a maximum pressure of 1.60 yield strengths (von Mises, nu = 0.3;
#: Johnson, Contact Mechanics (1985), section 6.1).
YIELD_PRESSURE = 1.60
STANDARD_GRAVITY = 9.80665
PAIR_SOURCE = "made by kncal.pair or kncal.wall_pair"


@dataclass(frozen=True)
class ValidityWarning:
    """One limit of a result.

    Attributes
    ----------
    code : short stable name, e.g. "overlap-large"
    message : one sentence for a person, with the largest value seen
    count : number of elements concerned (1 for a scalar calibration)
    where : which elements, broadcasts against the calibration's shape
    """

    code: str
    message: str
    count: int
    where: NDArray[np.bool_] = field(repr=False, compare=False)

    def __str__(self) -> str:
        """Return the message."""
        return self.message

    def to_dict(self) -> dict[str, str | int]:
        """Return a JSON-ready dict."""
        return {"code": self.code, "message": self.message, "count": self.count}


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceContact:
    """The reference contact at the same impact, in physical units.

    Attributes
    ----------
    C : dimensionless damping number [-]
    t_c, delta_max, delta_mean, delta_end : [s], [m], [m], [m]
    """

    C: FloatOrArray
    t_c: FloatOrArray
    delta_max: FloatOrArray
    delta_mean: FloatOrArray
    delta_end: FloatOrArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """The linear spring–dashpot equivalent to a reference contact, and what to think of it.

    Floats for scalar input; otherwise arrays of the broadcast shape of all inputs (``pair`` stays as it was given).

    Attributes
    ----------
    k_n : linear normal stiffness [N/m]
    eta_n : dashpot coefficient [N s/m], F = k_n delta + eta_n delta_dot, giving e_n at this ``end``
    kappa : k_n/(k_h^(4/5) m_eff^(1/5) v_0^(2/5)) [-]
    t_c, delta_max, delta_mean : of the *linear* contact at v_0 [s], [m], [m]
    delta_end : overlap at which the linear contact ends [m] (0 for the overlap end)
    reference : ReferenceContact, the same numbers of the reference law
    warnings : what limits the validity of this result
    pair, v_0, e_n, law, method, end : the inputs; ``contact_law`` is the law itself
    """

    k_n: FloatOrArray
    eta_n: FloatOrArray
    kappa: FloatOrArray
    t_c: FloatOrArray
    delta_max: FloatOrArray
    delta_mean: FloatOrArray
    delta_end: FloatOrArray
    reference: ReferenceContact
    warnings: tuple[ValidityWarning, ...]
    pair: Pair
    v_0: FloatOrArray
    e_n: FloatOrArray
    law: str
    method: str
    end: str
    contact_law: ContactLaw = field(repr=False)

    @property
    def gamma_n(self) -> FloatOrArray:
        """Damping per effective mass, eta_n/m_eff [1/s]: the `gamman` of LIGGGHTS, right for this pair only."""
        return self.eta_n / self.pair.m_eff

    @property
    def zeta(self) -> FloatOrArray:
        """Damping ratio eta_n/(2 sqrt(k_n m_eff)) of the linear contact [-]."""
        return plain(np.asarray(self.eta_n / (2.0 * np.sqrt(self.k_n * self.pair.m_eff))))

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready dict (arrays become lists, warnings become dicts with code and message)."""
        numbers = {name: _listed(getattr(self, name)) for name in (*COLUMNS, "v_0", "e_n")}
        reference = {f.name: _listed(getattr(self.reference, f.name)) for f in fields(self.reference)}
        pair = {n: _listed(getattr(self.pair, n)) for n in ("m_eff", "R_eff", "E_eff", "k_h")}
        return {
            "law": self.law,
            "method": self.method,
            "end": self.end,
            **numbers,
            "reference": reference,
            "pair": pair | {"is_wall": self.pair.is_wall},
            "warnings": [w.to_dict() for w in self.warnings],
        }

    def to_frame(self) -> pd.DataFrame:
        """Return one row per calibration; the columns carry the names of the attributes (SI units)."""
        import pandas as pd

        columns: dict[str, Any] = {"law": self.law, "method": self.method, "end": self.end}
        for name in ("v_0", "e_n", *COLUMNS):
            columns[name] = np.ravel(getattr(self, name))
        for name in ("t_c", "delta_max", "delta_mean"):
            columns[f"reference_{name}"] = np.ravel(getattr(self.reference, name))
        columns["warnings"] = self._codes()
        return pd.DataFrame(columns)

    def _codes(self) -> list[str]:
        """Codes of the warnings that concern each element, joined by "; "."""
        shape = np.shape(self.k_n)
        codes = np.full(np.size(self.k_n), "", dtype=object)
        for warning in self.warnings:
            concerned = np.broadcast_to(warning.where, shape).ravel()
            codes[concerned] += f"; {warning.code}"
        return [text.removeprefix("; ") for text in codes]


#: Numbers of the linear contact, in the order of tables.
COLUMNS = ("k_n", "eta_n", "kappa", "t_c", "delta_max", "delta_mean", "delta_end")


def calibrate(
    pair: Pair,
    *,
    v_0: ArrayLike,
    e_n: ArrayLike,
    law: str | ContactLaw = "tsuji",
    method: str = "mean_overlap",
    end: str = "overlap",
    **method_options: Any,
) -> Calibration:
    """Find the linear spring and dashpot equivalent to a reference contact.

    k_n = kappa k_h^(4/5) m_eff^(1/5) v_0^(2/5), with kappa by ``method`` (see `kncal.physics.methods`), and
    eta_n = 2 zeta(e_n, end) sqrt(k_n m_eff). Both contacts have the same mass, speed, restitution and contact end.

    Parameters
    ----------
    pair : Pair
        From `kncal.pair` or `kncal.wall_pair`.
    v_0 : float or array
        Normal impact speed [m/s], 1e-12 to 1e5.
    e_n : float or array
        Normal coefficient of restitution, 1e-12 to 1 (for most laws from 1e-3 on).
    law : str or ContactLaw
        Reference law. "hertz" has no damping of its own: for e_n < 1 the elastic reference is kept, the spring gets
        the damping of e_n, and a warning says so. For the linear laws ("linear", "walton_braun") the loading
        stiffness is the strain-energy one of the pair.
    method : str
        How k_n is found.
    end : {"overlap", "force"}
        Where the contact ends: at zero overlap, or at zero force (attraction cut off). Choose what the target code
        does: LIGGGHTS and MFIX end at zero overlap, LIGGGHTS with ``limitForce on`` and YADE at zero force.
    **method_options
        Options of the method, e.g. ``fraction=0.01`` for limited_overlap; numbers may be arrays.

    Raises
    ------
    InputError
        For a value that is not finite or out of range, arrays that do not broadcast, or an unknown name.
    ValidityError
        If an overlap reaches the radius of the smaller sphere.
    """
    instance("pair", pair, Pair, PAIR_SOURCE)
    speed = plain(in_range("v_0", v_0, *SPEEDS, unit="m/s", hint="a resting contact: method 'static_load'"))
    restitution = plain(in_range("e_n", e_n, 0.0, 1.0, low_open=True, hint=NO_REBOUND))
    one_of("end", end, ENDS)
    chosen = METHODS.find(method)
    options = chosen.options(method_options)
    contact_law = LAWS.find(law)
    shape = common_shape(pair=pair, v_0=speed, e_n=restitution, **options)
    reference = dimensionless_impact(
        contact_law, np.ones_like(restitution) if contact_law.elastic else restitution, end
    )
    linear = dimensionless_impact("linear", restitution, end)
    base = _base(pair, speed)
    scale = _scale(contact_law)
    kappa = chosen.kappa(
        MethodInputs(pair=pair, v_0=speed, base=base, scale=scale, reference=reference, linear=linear, options=options)
    )
    k_n = kappa * base
    positive_result("k_n [N/m]", k_n, " or ".join(("pair", "v_0", "e_n", *options)))
    time = np.sqrt(pair.m_eff / k_n)
    found = Calibration(
        k_n=_full(k_n, shape),
        eta_n=_full(linear.C * (k_n * time), shape),
        kappa=_full(kappa, shape),
        reference=ReferenceContact(
            C=_full(reference.C, shape), **_physical(reference, np.sqrt(pair.m_eff / (scale * base)), speed, shape)
        ),
        warnings=(),
        pair=pair,
        v_0=_full(speed, shape),
        e_n=_full(restitution, shape),
        law=contact_law.name,
        method=chosen.name,
        end=end,
        contact_law=contact_law,
        **_physical(linear, time, speed, shape),
    )
    return replace(found, warnings=tuple(_limits(found, linear)))


def calibrate_all(
    pair: Pair, *, v_0: float, e_n: float, law: str = "tsuji", end: str = "overlap", options: Mapping[str, Any]
) -> dict[str, Calibration | ValidityError]:
    """Calibrate by every method whose required options are among ``options`` (those of any method).

    Returns
    -------
    dict
        Method -> its calibration, or why it has no valid result.
    """
    found: dict[str, Calibration | ValidityError] = {}
    for name, method in METHODS.items():
        own = method.own(options)
        if all(option in own for option in method.required):
            try:
                found[name] = calibrate(pair, v_0=v_0, e_n=e_n, law=law, method=name, end=end, **own)
            except ValidityError as error:
                found[name] = error
    return found


def reference_stiffness(pair: Pair, v_0: FloatOrArray, law: ContactLaw) -> FloatOrArray:
    """m_eff v_0²/L² of the reference contact [N/m], L its length unit; for a linear law its (loading) spring."""
    return _scale(law) * _base(pair, v_0)


def _base(pair: Pair, v_0: FloatOrArray) -> FloatOrArray:
    return pair.k_h**0.8 * pair.m_eff**0.2 * v_0**0.4


def _scale(law: ContactLaw) -> float:
    return KAPPA_STRAIN_ENERGY if law.stiffness_exponent == 1.0 else 1.0


def _physical(
    impact: DimensionlessImpact, time: FloatOrArray, speed: FloatOrArray, shape: tuple[int, ...]
) -> dict[str, FloatOrArray]:
    """Duration [s] and overlaps [m] of an impact from its unit of time [s] and its speed."""
    length = speed * time
    return {
        "t_c": _full(impact.tau_c * time, shape),
        "delta_max": _full(impact.x_max * length, shape),
        "delta_mean": _full(impact.x_mean * length, shape),
        "delta_end": _full(impact.x_end * length, shape),
    }


def _full(value: FloatOrArray, shape: tuple[int, ...]) -> FloatOrArray:
    """Return ``value`` with ``shape``: a float for (), else an array of its own."""
    array: Array = np.asarray(value, dtype=np.float64)
    return plain(array if array.shape == shape else np.broadcast_to(array, shape).copy())


def _listed(value: FloatOrArray) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else float(value)


def _limits(c: Calibration, linear: DimensionlessImpact) -> Iterator[ValidityWarning]:
    """Say every limit that applies; `ValidityError` if an overlap reaches the smaller radius."""
    for name, law, delta in (("reference", c.law, c.reference.delta_max), ("linear", "linear", c.delta_max)):
        ratio = np.asarray(delta / c.pair.R_min)
        if (meaningless := ratio >= OVERLAP_MEANINGLESS).any():
            raise ValidityError(
                f"the overlap of the {name} contact ({law}) reaches the "
                f"radius of the smaller sphere, {ratio.max():.4g} of it{_where(meaningless)}: expected to stay "
                "below; lower v_0, or take a stiffer material or method"
            )
        text = f"maximum overlap of the {name} contact is {{:.3g}} of the smaller radius (doubtful above 0.1)"
        yield from _warn("overlap-large", ratio > OVERLAP_DOUBTFUL, ratio, text)
    for code, where, value, message in (*_of_bodies(c), *_of_impact(c, linear), *_of_law(c)):
        yield from _warn(code, where, value, message)


#: code, where it applies, the value that the message tells the largest of
_Limit = tuple[str, NDArray[np.bool_], Array, str]


def _of_bodies(c: Calibration) -> Iterator[_Limit]:
    radius = np.asarray(c.pair.R_min)
    yield "radius-large", radius > RADIUS_DOUBTFUL, radius, "a radius of {:.3g} m: lengths are in m, 1 mm is 1e-3"
    ratio = np.asarray(c.v_0 / c.pair.wave_speed)
    message = "impact speed is {:.3g} of the elastic wave speed: not quasi-static, and most materials yield earlier"
    yield "impact-fast", ratio > SPEED_RATIO_DOUBTFUL, ratio, message
    if c.pair.yield_strength is not None and c.contact_law.stiffness_exponent > 1.0:
        pressure = 2.0 / np.pi * c.pair.E_eff * np.sqrt(c.reference.delta_max / c.pair.R_eff)
        ratio = np.asarray(pressure / (YIELD_PRESSURE * c.pair.yield_strength))
        message = "peak Hertz pressure is {:.3g} times the onset of yield: the contact is plastic, k_n too stiff"
        yield "yield", ratio > 1.0, ratio, message


def _of_impact(c: Calibration, linear: DimensionlessImpact) -> Iterator[_Limit]:
    e_n = np.asarray(c.e_n)
    if c.method in ("mean_overlap", "contact_duration") and c.end == "overlap":
        message = (
            f"{c.method} is ill-posed for e_n below {RESTITUTION_SMALL} at the overlap end (1 - e_n up to {{:.3g}}): "
            "use max_overlap"
        )
        yield "restitution-small", e_n < RESTITUTION_SMALL, 1.0 - e_n, message
    ratio = np.asarray(STANDARD_GRAVITY / (np.sqrt(c.k_n / c.pair.m_eff) * c.v_0))
    message = (
        "overlap under the particle's own weight is {:.3g} of the impact's (g/(omega v_0)): use static_load "
        "or a larger v_0 for resting contacts"
    )
    yield "gravity-overlap", ratio > GRAVITY_RATIO_DOUBTFUL, ratio, message
    ratio = np.asarray(c.pair.size_ratio)
    message = (
        "size ratio {:.3g}: one k_n or gamman for all pairs would be wrong (use the matrix form), and velocity "
        "Verlet with half-step velocities shows artefacts in tangential damping"
    )
    yield "size-ratio", ratio >= SIZE_RATIO_DOUBTFUL, ratio, message
    if c.end == "overlap":
        ratio = np.asarray(linear.C * e_n / linear.x_max)
        message = (
            "the dashpot pulls at the end of the contact with {:.3g} of the spring's largest force (unphysical, "
            "standard in most codes; end='force' cuts it)"
        )
        yield "attraction", ratio > ATTRACTION_NOTABLE, ratio, message
    zeta = np.asarray(c.zeta)
    message = (
        "the linear contact is overdamped (damping ratio up to {:.3g}): the target code must cut attraction off, and "
        "needs a time step well below 2 m_eff/eta_n"
    )
    yield "overdamped", zeta > 1.0, zeta, message


def _of_law(c: Calibration) -> Iterator[_Limit]:
    e_n = np.asarray(c.e_n)
    if c.contact_law.e_depends_on_speed:
        message = f"{c.law}: e_n belongs to the speed it is given for (v_0 up to {{:.3g}} m/s), not to the material"
        yield "restitution-of-one-speed", e_n < 1.0, np.asarray(c.v_0), message
    if c.contact_law.elastic:
        message = (
            "the reference is elastic Hertz, only the linear contact has e_n (1 - e_n up to {:.3g}): "
            "law 'tsuji' damps both"
        )
        yield "elastic-reference", e_n < 1.0, 1.0 - e_n, message


def _warn(code: str, where: NDArray[np.bool_], value: Array, message: str) -> Iterator[ValidityWarning]:
    if not where.any():
        return
    where, value = np.broadcast_arrays(where, value)
    worst = float(np.max(value[where]))
    text = message.format(worst) + (_where(where) if where.ndim else "")
    yield ValidityWarning(code, text, int(np.count_nonzero(where)), where)


def _where(where: NDArray[np.bool_]) -> str:
    if where.ndim == 0:
        return ""
    first = [int(i) for i in np.argwhere(where)[0]]
    return f" ({np.count_nonzero(where)} of {where.size} elements, first at {first})"
