"""From a pair, a speed and a restitution to the equivalent linear spring and dashpot."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kncal.checks import Array, in_range, one_of
from kncal.contact.base import ContactLaw
from kncal.contact.registry import get_law
from kncal.impact import DimensionlessImpact, dimensionless_impact
from kncal.material import FloatOrArray, Pair, plain
from kncal.methods import KAPPA_STRAIN_ENERGY, MethodInputs, get_method
from kncal.validity import ValidityWarning, check_validity

if TYPE_CHECKING:
    import pandas as pd

#: Contact ends: overlap back to zero, or force back to zero (attraction cut off).
ENDS = ("overlap", "force")


@dataclass(frozen=True, kw_only=True)
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


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """The linear spring–dashpot equivalent to a reference contact, and what to think of it.

    Floats for scalar input; otherwise arrays of the broadcast shape of all inputs.

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
        numbers = {name: _listed(getattr(self, name)) for name in (*_COLUMNS, "v_0", "e_n")}
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

        shape = np.shape(self.k_n)
        columns: dict[str, Any] = {"law": self.law, "method": self.method, "end": self.end}
        for name in ("v_0", "e_n", *_COLUMNS):
            columns[name] = np.broadcast_to(getattr(self, name), shape).ravel()
        for name in ("t_c", "delta_max", "delta_mean"):
            columns[f"reference_{name}"] = np.broadcast_to(getattr(self.reference, name), shape).ravel()
        columns["warnings"] = "; ".join(w.code for w in self.warnings)
        return pd.DataFrame(columns)


_COLUMNS = ("k_n", "eta_n", "kappa", "t_c", "delta_max", "delta_mean", "delta_end")


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

    k_n = kappa k_h^(4/5) m_eff^(1/5) v_0^(2/5), with kappa by ``method`` (see `kncal.methods`), and
    eta_n = 2 zeta(e_n, end) sqrt(k_n m_eff). Both contacts have the same mass, speed, restitution and contact end.

    Parameters
    ----------
    pair : Pair
        From `kncal.pair` or `kncal.wall_pair`.
    v_0 : float or array
        Normal impact speed [m/s], > 0.
    e_n : float or array
        Normal coefficient of restitution, in (0, 1].
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
        Options of the method, e.g. ``fraction=0.01`` for limited_overlap.

    Raises
    ------
    InputError
        For a value that is not finite or out of range, or an unknown name.
    ValidityError
        If an overlap reaches the radius of the smaller sphere.
    """
    speed = plain(
        in_range("v_0", v_0, 0.0, 1e5, low_open=True, unit="m/s", hint="a resting contact: method 'static_load'")
    )
    restitution = plain(in_range("e_n", e_n, 0.0, 1.0, low_open=True))
    one_of("end", end, ENDS)
    chosen = get_method(method)
    options = chosen.options(method_options)
    contact_law = get_law(law)

    elastic = contact_law.name == "hertz"
    reference = dimensionless_impact(contact_law, np.ones_like(restitution) if elastic else restitution, end)
    linear = dimensionless_impact("linear", restitution, end)
    base = pair.k_h**0.8 * pair.m_eff**0.2 * speed**0.4
    scale = KAPPA_STRAIN_ENERGY if contact_law.stiffness_exponent == 1.0 else 1.0

    kappa = chosen.kappa(
        MethodInputs(pair=pair, v_0=speed, base=base, scale=scale, reference=reference, linear=linear, options=options)
    )
    k_n = _broadcast(kappa * base, kappa, restitution, base)
    kappa = _broadcast(kappa, k_n)
    time = np.sqrt(pair.m_eff / k_n)
    length = speed * time
    reference_time = np.sqrt(pair.m_eff / (scale * base))
    calibration = Calibration(
        k_n=k_n,
        eta_n=plain(np.asarray(linear.C * (k_n * time))),
        kappa=kappa,
        t_c=plain(np.asarray(linear.tau_c * time)),
        delta_max=plain(np.asarray(linear.x_max * length)),
        delta_mean=plain(np.asarray(linear.x_mean * length)),
        delta_end=plain(np.asarray(linear.x_end * length)),
        reference=_reference(reference, reference_time, speed),
        warnings=(),
        pair=pair,
        v_0=speed,
        e_n=restitution,
        law=contact_law.name,
        method=chosen.name,
        end=end,
        contact_law=contact_law,
    )
    return replace(calibration, warnings=check_validity(calibration, contact_law, linear))


def _reference(impact: DimensionlessImpact, time: FloatOrArray, speed: FloatOrArray) -> ReferenceContact:
    length = speed * time
    return ReferenceContact(
        C=impact.C,
        t_c=plain(np.asarray(impact.tau_c * time)),
        delta_max=plain(np.asarray(impact.x_max * length)),
        delta_mean=plain(np.asarray(impact.x_mean * length)),
        delta_end=plain(np.asarray(impact.x_end * length)),
    )


def _broadcast(value: FloatOrArray, *others: FloatOrArray) -> FloatOrArray:
    shape = np.broadcast_shapes(np.shape(value), *(np.shape(o) for o in others))
    array: Array = np.asarray(value, dtype=np.float64)
    return plain(array if array.shape == shape else np.broadcast_to(array, shape).copy())


def _listed(value: FloatOrArray) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else float(value)
