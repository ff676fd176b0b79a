"""What a trade is made of: candidates, their cost and errors, and what softness does to the physics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from kncal.study.variants import Variant


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """One contact, at one time step, whose cost and errors are asked for.

    Attributes
    ----------
    name : unique in a trade, also the variant's name
    how : "reference", the method's name, "softened", "limited_overlap" or "reduced_modulus"
    factor : k_n over that of the case's own method, or E over the real one [-]; None for the reference
    steps_per_contact : N, with the same meaning for every model
    variant : what is run
    """

    name: str
    how: str
    factor: float | None
    steps_per_contact: float
    variant: Variant

    @property
    def model(self) -> str:
        """Contact model, "linear" or "hertz"."""
        return self.variant.model


@dataclass(frozen=True, kw_only=True)
class MetricError:
    """The error of one metric of a candidate against the reference.

    Attributes
    ----------
    metric, unit : name, and unit of ``value`` and ``reference``
    value, reference : of the two runs, None if it could not be computed
    error : (value - reference)/scale [-], None if it could not be computed
    uncertainty : half-width of its 95 % confidence interval [-]: sampling of the averages of a bed (both runs); of
        single contacts the discretisation error of the reference itself
    basis : what the scale is
    reason : why it could not be computed, or what to know
    """

    metric: str
    unit: str
    value: float | None
    reference: float | None
    error: float | None
    uncertainty: float | None
    basis: str
    reason: str = ""

    def verdict(self, tolerance: float) -> str:
        """Return "ok" (the whole interval is within), "outside" (all of it is), "undecided" or "missing"."""
        if self.error is None:
            return "missing"
        width = self.uncertainty or 0.0
        if abs(self.error) + width <= tolerance:
            return "ok"
        return "outside" if abs(self.error) - width > tolerance else "undecided"


@dataclass(frozen=True, kw_only=True)
class Sign:
    """One way in which softness changes the physics.

    Attributes
    ----------
    name : "overlap_share", "leaking", "contact_number", "sound_speed_ratio" ...
    value : what was found, in ``unit``
    limit : where it begins to matter; ``source``: of this limit
    changed : whether it is beyond the limit
    text : one sentence
    """

    name: str
    value: float
    unit: str
    limit: float
    source: str
    changed: bool
    text: str


@dataclass(frozen=True, kw_only=True)
class TradePoint:
    """A candidate with what was measured.

    Attributes
    ----------
    candidate : Candidate
    status, message : "completed", or why there are no numbers ("refused", "failed", "timed_out", "skipped" ...)
    k_n : stiffness of the shortest contact: k_n [N/m], or for Hertz the secant k_h sqrt(delta_max) at v_0 [N/m]
    steps, dt : [-], [s]
    cpu_seconds : CPU time of each run [s]; of a bed that was run in part: extrapolated to its whole time
    ran_share : simulated share of the case's time [-]
    errors : metric -> MetricError
    signs : what softness did to the physics
    """

    candidate: Candidate
    status: str
    message: str = ""
    k_n: float | None = None
    steps: int | None = None
    dt: float | None = None
    cpu_seconds: tuple[float, ...] = ()
    ran_share: float = 1.0
    errors: Mapping[str, MetricError] = field(default_factory=dict)
    signs: tuple[Sign, ...] = ()

    @property
    def completed(self) -> bool:
        """Whether there are numbers."""
        return self.status == "completed"
