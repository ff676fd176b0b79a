"""From a pair, a speed and a restitution to the equivalent linear spring and dashpot."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kncal.core.checks import Array, common_shape, in_range, instance, one_of, positive_result
from kncal.physics.impact import NO_REBOUND, DimensionlessImpact, dimensionless_impact
from kncal.physics.laws import LAWS
from kncal.physics.laws.base import ContactLaw
from kncal.physics.material import FloatOrArray, Pair, plain
from kncal.physics.methods import KAPPA_STRAIN_ENERGY, METHODS, MethodInputs
from kncal.physics.validity import ValidityWarning, check_validity

if TYPE_CHECKING:
    import pandas as pd

#: Contact ends: overlap back to zero, or force back to zero (attraction cut off).
ENDS = ("overlap", "force")
#: Impact speeds served [m/s]: from nearly at rest to far beyond every elastic wave.
SPEEDS = (1e-12, 1e5)
PAIR_SOURCE = "made by kncal.pair or kncal.wall_pair"


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

    elastic = contact_law.name == "hertz"
    reference = dimensionless_impact(contact_law, np.ones_like(restitution) if elastic else restitution, end)
    linear = dimensionless_impact("linear", restitution, end)
    base = _base(pair, speed)
    scale = _scale(contact_law)

    kappa = chosen.kappa(
        MethodInputs(pair=pair, v_0=speed, base=base, scale=scale, reference=reference, linear=linear, options=options)
    )
    k_n = kappa * base
    positive_result("k_n [N/m]", k_n, " or ".join(("pair", "v_0", "e_n", *options)))
    time = np.sqrt(pair.m_eff / k_n)
    length = speed * time
    reference_time = np.sqrt(pair.m_eff / (scale * base))
    calibration = Calibration(
        k_n=_full(k_n, shape),
        eta_n=_full(linear.C * (k_n * time), shape),
        kappa=_full(kappa, shape),
        t_c=_full(linear.tau_c * time, shape),
        delta_max=_full(linear.x_max * length, shape),
        delta_mean=_full(linear.x_mean * length, shape),
        delta_end=_full(linear.x_end * length, shape),
        reference=_reference(reference, reference_time, speed, shape),
        warnings=(),
        pair=pair,
        v_0=_full(speed, shape),
        e_n=_full(restitution, shape),
        law=contact_law.name,
        method=chosen.name,
        end=end,
        contact_law=contact_law,
    )
    return replace(calibration, warnings=check_validity(calibration, contact_law, linear))


def reference_stiffness(pair: Pair, v_0: FloatOrArray, law: ContactLaw) -> FloatOrArray:
    """m_eff v_0²/L² of the reference contact [N/m], L its length unit; for a linear law its (loading) spring."""
    return _scale(law) * _base(pair, v_0)


def _base(pair: Pair, v_0: FloatOrArray) -> FloatOrArray:
    return pair.k_h**0.8 * pair.m_eff**0.2 * v_0**0.4


def _scale(law: ContactLaw) -> float:
    return KAPPA_STRAIN_ENERGY if law.stiffness_exponent == 1.0 else 1.0


def _reference(
    impact: DimensionlessImpact, time: FloatOrArray, speed: FloatOrArray, shape: tuple[int, ...]
) -> ReferenceContact:
    length = speed * time
    return ReferenceContact(
        C=_full(impact.C, shape),
        t_c=_full(impact.tau_c * time, shape),
        delta_max=_full(impact.x_max * length, shape),
        delta_mean=_full(impact.x_mean * length, shape),
        delta_end=_full(impact.x_end * length, shape),
    )


def _full(value: FloatOrArray, shape: tuple[int, ...]) -> FloatOrArray:
    """Return ``value`` with ``shape``: a float for (), else an array of its own."""
    array: Array = np.asarray(value, dtype=np.float64)
    return plain(array if array.shape == shape else np.broadcast_to(array, shape).copy())


def _listed(value: FloatOrArray) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else float(value)
