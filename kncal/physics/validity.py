"""What limits the validity of a calibration: small named checks that say what they saw; they never change a number."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kncal.core.errors import ValidityError
from kncal.physics.impact import DimensionlessImpact
from kncal.physics.laws.base import ContactLaw
from kncal.physics.material import FloatOrArray

if TYPE_CHECKING:
    from kncal.physics.calibration import Calibration

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


def check_validity(
    calibration: Calibration, law: ContactLaw, linear: DimensionlessImpact
) -> tuple[ValidityWarning, ...]:
    """Return every limit that applies to ``calibration``.

    Raises
    ------
    ValidityError
        If an overlap, of the reference or of the linear contact, reaches the smaller radius.
    """
    return tuple(_checks(calibration, law, linear))


def _checks(c: Calibration, law: ContactLaw, linear: DimensionlessImpact) -> Iterator[ValidityWarning]:
    pair, reference = c.pair, c.reference
    e_n = np.asarray(c.e_n)
    damped = e_n < 1.0

    for name, delta in (("reference", reference.delta_max), ("linear", c.delta_max)):
        ratio = np.asarray(delta / pair.R_min)
        if (meaningless := ratio >= OVERLAP_MEANINGLESS).any():
            raise ValidityError(
                f"the overlap of the {name} contact ({law.name if name == 'reference' else 'linear'}) reaches the "
                f"radius of the smaller sphere, {ratio.max():.4g} of it{_where(meaningless)}: expected to stay "
                "below; lower v_0, or take a stiffer material or method"
            )
        yield from _warn(
            ratio > OVERLAP_DOUBTFUL,
            ratio,
            "overlap-large",
            f"maximum overlap of the {name} contact is {{:.3g}} of the smaller radius (doubtful above 0.1)",
        )

    radius = np.asarray(pair.R_min)
    yield from _warn(
        radius > RADIUS_DOUBTFUL, radius, "radius-large", "a radius of {:.3g} m: lengths are in m, 1 mm is 1e-3"
    )

    speed_ratio = np.asarray(c.v_0 / pair.wave_speed)
    yield from _warn(
        speed_ratio > SPEED_RATIO_DOUBTFUL,
        speed_ratio,
        "impact-fast",
        "impact speed is {:.3g} of the elastic wave speed: not quasi-static, and most materials yield earlier",
    )

    if pair.yield_strength is not None and law.stiffness_exponent > 1.0:
        pressure = 2.0 / np.pi * pair.E_eff * np.sqrt(reference.delta_max / pair.R_eff)
        ratio = np.asarray(pressure / (YIELD_PRESSURE * pair.yield_strength))
        yield from _warn(
            ratio > 1.0,
            ratio,
            "yield",
            "peak Hertz pressure is {:.3g} times the onset of yield: the contact is plastic, k_n too stiff",
        )

    if c.method in ("mean_overlap", "contact_duration") and c.end == "overlap":
        yield from _warn(
            e_n < RESTITUTION_SMALL,
            1.0 - e_n,
            "restitution-small",
            f"{c.method} is ill-posed for e_n below {RESTITUTION_SMALL} at the overlap end (1 - e_n up to {{:.3g}}): "
            "use max_overlap",
        )

    omega = np.asarray(np.sqrt(c.k_n / pair.m_eff))
    gravity_ratio = STANDARD_GRAVITY / (omega * c.v_0)
    yield from _warn(
        gravity_ratio > GRAVITY_RATIO_DOUBTFUL,
        gravity_ratio,
        "gravity-overlap",
        "overlap under the particle's own weight is {:.3g} of the impact's (g/(omega v_0)): use static_load "
        "or a larger v_0 for resting contacts",
    )

    size_ratio = np.asarray(pair.size_ratio)
    yield from _warn(
        size_ratio >= SIZE_RATIO_DOUBTFUL,
        size_ratio,
        "size-ratio",
        "size ratio {:.3g}: one k_n or gamman for all pairs would be wrong (use the matrix form), and velocity "
        "Verlet with half-step velocities shows artefacts in tangential damping",
    )

    if c.end == "overlap":
        attraction = np.asarray(linear.C * e_n / linear.x_max)
        yield from _warn(
            attraction > ATTRACTION_NOTABLE,
            attraction,
            "attraction",
            "the dashpot pulls at the end of the contact with {:.3g} of the spring's largest force (unphysical, "
            "standard in most codes; end='force' cuts it)",
        )

    zeta = np.asarray(c.zeta)
    yield from _warn(
        zeta > 1.0,
        zeta,
        "overdamped",
        "the linear contact is overdamped (damping ratio up to {:.3g}): the target code must cut attraction off, and "
        "needs a time step well below 2 m_eff/eta_n",
    )

    if law.e_depends_on_speed:
        yield from _warn(
            damped,
            np.asarray(c.v_0),
            "restitution-of-one-speed",
            f"{law.name}: e_n belongs to the speed it is given for (v_0 up to {{:.3g}} m/s), not to the material",
        )
    if law.name == "hertz":
        yield from _warn(
            damped,
            1.0 - e_n,
            "elastic-reference",
            "the reference is elastic Hertz, only the linear contact has e_n (1 - e_n up to {:.3g}): "
            "law 'tsuji' damps both",
        )


def _warn(where: NDArray[np.bool_], value: FloatOrArray, code: str, message: str) -> Iterator[ValidityWarning]:
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
