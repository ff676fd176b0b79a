"""What a trade is made of: candidates, their cost and errors, and what softness does to the physics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from kncal.observe.estimate import Estimate
from kncal.observe.row import Row
from kncal.observe.softness import Sign
from kncal.study.variants import Variant

#: Shares of the calibrated k_n, or of the real modulus, that a trade tries.
FACTORS = tuple(1.0 / share for share in (1, 3, 10, 30, 100, 300, 1000, 3000, 10_000))

#: Steps per contact that a trade tries.
STEPS = (10.0, 20.0, 50.0, 100.0)

#: Shares of the diameter that the largest overlap may have, by `limited_overlap`.
OVERLAPS = (0.001, 0.01, 0.05)

#: Told in one line what is done now.
Tell = Callable[[str], None]


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
class TradePoint:
    """A candidate with what was measured.

    Attributes
    ----------
    candidate : Candidate
    status, message : "completed", or why there are no numbers ("refused", "failed", "timed_out", "skipped" ...)
    k_n : stiffness of the shortest contact: k_n [N/m], or for Hertz the secant k_h sqrt(delta_max) at v_0 [N/m]
    steps, dt : [-], [s]
    cpu_seconds : CPU time of each run [s]; of one that was run in part: extrapolated to its whole time
    ran_share : simulated share of the case's time [-]
    errors : metric -> Row of this run and the reference, judged. The width of its difference is the 95 % confidence
        interval of averages (both runs); of single contacts what is left of the reference's discretisation error, and
        what another sub-step phase of first touch could add
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
    errors: Mapping[str, Row] = field(default_factory=dict)
    signs: tuple[Sign, ...] = ()

    @property
    def completed(self) -> bool:
        """Whether there are numbers."""
        return self.status == "completed"

    @property
    def judged(self) -> Mapping[str, Row]:
        """The errors that have a tolerance."""
        return {metric: row for metric, row in self.errors.items() if row.tolerance is not None}


@dataclass(frozen=True, kw_only=True)
class TradeOptions:
    """What is asked of a trade.

    Attributes
    ----------
    tolerances : metric -> largest allowed abs(error) [-]; empty: those of the case
    reference : ``KEY=VALUE`` that make the materials real where the case's are softened already
    steps : steps per contact N to try [-]
    factors : shares of k_n and of the modulus to try [-]
    overlaps : shares of the diameter for `limited_overlap` [-]
    rounds : how often each run whose CPU time is wanted is repeated
    budget : wall-clock time for everything [s]; None: as long as it takes
    workers : runs at a time; None: one per core
    engine : of single contacts; ``transport``: of beds
    """

    tolerances: Mapping[str, float] = field(default_factory=dict)
    reference: tuple[str, ...] = ()
    steps: tuple[float, ...] = STEPS
    factors: tuple[float, ...] = FACTORS
    overlaps: tuple[float, ...] = OVERLAPS
    rounds: int = 3
    budget: float | None = None
    workers: int | None = None
    engine: str = "liggghts"
    transport: str = "auto"


@dataclass(frozen=True, kw_only=True)
class ErrorSplit:
    """Where the error of one metric of one point comes from [-]; each part measured by changing one thing.

    Attributes
    ----------
    metric : name
    total : the point's error
    discretisation : at its N against the same contact converged in N
    softness : this contact against the same model unsoftened, both converged
    model : the linear model, unsoftened, against the reference, both converged; None: the same model
    interaction : total minus the parts that are known
    missing : parts that could not be measured, in words
    """

    metric: str
    total: Estimate
    discretisation: Estimate | None = None
    softness: Estimate | None = None
    model: Estimate | None = None
    interaction: float | None = None
    missing: tuple[str, ...] = ()

    @property
    def parts(self) -> Mapping[str, Estimate | None]:
        """The parts by name."""
        return {"discretisation": self.discretisation, "softness": self.softness, "model": self.model}


@dataclass(frozen=True, kw_only=True)
class Convergence:
    """How the reference's step was found.

    Attributes
    ----------
    steps_per_contact : N tried, ascending [-]
    values : metric -> its value at each N
    chosen : N of the reference
    left : metric -> what is left of the discretisation error at ``chosen`` [-], relative like its error
    threshold : what no metric was to move by more than from one N to the next [-]
    converged : whether that was reached
    """

    steps_per_contact: tuple[float, ...]
    values: Mapping[str, tuple[float | None, ...]]
    chosen: float
    left: Mapping[str, float]
    threshold: float
    converged: bool

    @property
    def sentence(self) -> str:
        """How far the reference converged."""
        within, worst = f"{100.0 * self.threshold:.2g} %", max(self.left, key=self.left.__getitem__, default=None)
        left = "" if worst is None else f" Its own error is at most {100.0 * self.left[worst]:.2g} % ({worst})."
        if self.converged:
            how = f"converged at N = {self.chosen:g}: no judged metric moved by more than {within} from half that N."
        else:
            how = f"has not converged to {within} at N = {self.chosen:g}, the finest that was tried."
        return f"The reference {how}{left}"


@dataclass(frozen=True, kw_only=True)
class Trade:
    """Everything a trade found; `kncal.study.trade.front` and `kncal.study.trade.cost_law` draw the conclusions.

    Attributes
    ----------
    case, title : of the case
    cost : what points are ordered by: "cpu_seconds", or "steps" where a run is mostly the start of the solver, whose
        noise would order them
    fixed : what every run costs, whatever its steps, in words
    reference : Hertz with the real modulus at a converged step; its ``errors`` are empty
    convergence : how its step was found; None: its N was given
    points : the candidates, in the order tried; Hertz at the real modulus is "reduced_modulus" with factor 1
    tolerances : metric -> largest allowed abs(error) [-]
    splits : name of a candidate -> the split of each of its errors that could be measured
    caveats : sentences on what to keep in mind
    options : as asked
    wall_seconds : what all of it took [s]
    """

    case: str
    title: str
    cost: str
    fixed: str
    reference: TradePoint
    convergence: Convergence | None
    points: tuple[TradePoint, ...]
    tolerances: Mapping[str, float]
    splits: Mapping[str, tuple[ErrorSplit, ...]] = field(default_factory=dict)
    caveats: tuple[str, ...] = ()
    options: TradeOptions = field(default_factory=TradeOptions)
    wall_seconds: float = 0.0

    @property
    def estimated(self) -> bool:
        """Whether errors are those of averages, whose intervals a longer run narrows."""
        return any(row.difference.chance for point in self.points for row in point.errors.values())

    def point(self, name: str) -> TradePoint | None:
        """Return the point of the candidate called ``name``, or None."""
        return next((point for point in self.points if point.candidate.name == name), None)
