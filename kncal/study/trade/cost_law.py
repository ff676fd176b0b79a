"""Where the law of cost ~ k_n^(1/2) holds: slopes of steps and CPU time over the stiffness, with intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.study.trade.trade import Trade, TradePoint

#: The exponent of the law: t_c ~ k_n^(-1/2), so the number of steps goes with k_n^(1/2).
LAW = 0.5
#: A slope whose 95 % interval is wider than this to either side says nothing about the law.
RESOLVED = 0.1
#: Fewest stiffnesses for a slope with an interval.
_FEWEST = 3


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A number and the half-width of its 95 % confidence interval, in the same unit."""

    value: float
    uncertainty: float

    def includes(self, value: float) -> bool:
        """Whether ``value`` is within the interval."""
        return abs(value - self.value) <= self.uncertainty


@dataclass(frozen=True, kw_only=True)
class CostFit:
    """CPU time = start + per_step * steps.

    Attributes
    ----------
    start : what every run costs, whatever its steps [s]: the solver's start, of a bed gas and exchange
    per_step : [s]
    runs : number of timed runs
    """

    start: Estimate
    per_step: Estimate
    runs: int

    @property
    def half_steps(self) -> float | None:
        """Number of steps at which the start is half of the time; None where start or time per step is not resolved."""
        if min(self.start.value - self.start.uncertainty, self.per_step.value - self.per_step.uncertainty) <= 0.0:
            return None
        return self.start.value / self.per_step.value


@dataclass(frozen=True, kw_only=True)
class Slope:
    """How a cost goes with stiffness: exponent over a range of k_n.

    Attributes
    ----------
    exponent : d ln(cost)/d ln(k_n) [-]
    k_low, k_high : the range of k_n that it was found over [N/m]
    """

    exponent: Estimate
    k_low: float
    k_high: float

    @property
    def holds(self) -> bool:
        """Whether it agrees with 1/2 and is narrow enough to say so."""
        return self.exponent.uncertainty <= RESOLVED and self.exponent.includes(LAW)


@dataclass(frozen=True, kw_only=True)
class Law:
    """The law of cost for one family of contacts that differ in stiffness alone.

    Attributes
    ----------
    family : "linear" or "hertz"
    steps_per_contact : N of its points
    k_n : stiffness of each point, ascending [N/m]
    steps, cpu_seconds : of each point (CPU: the median of its rounds, NaN where none was timed) [-], [s]
    cpu_range : smallest and largest CPU time of its rounds [s], or NaN
    fit : start and time per step, from all timed points of the model at any N; None with too few
    by_steps, by_cpu : slope over all points, of the steps and of the CPU time as measured
    by_net_cpu : of the CPU time less the start, over the points of which the start is less than half
    holds : the widest range of k_n in which the slope of the CPU time as measured agrees with 1/2; None: nowhere
    bed : whether it is of a coupled bed, where what every run costs is gas and exchange at each coupling
    """

    family: str
    steps_per_contact: float
    k_n: tuple[float, ...]
    steps: tuple[int, ...]
    cpu_seconds: tuple[float, ...]
    cpu_range: tuple[tuple[float, float], ...]
    fit: CostFit | None
    by_steps: Slope | None
    by_cpu: Slope | None
    by_net_cpu: Slope | None
    holds: Slope | None
    bed: bool = False

    @property
    def sentences(self) -> tuple[str, ...]:
        """The law in words."""
        from kncal.core.units import quantity

        name = {"linear": "Linear", "hertz": "Hertz"}[self.family]
        fixed = "gas and exchange at the couplings" if self.bed else "the start"
        texts = []
        if self.by_steps is not None:
            texts.append(
                f"{name}, N = {self.steps_per_contact:g}: the number of steps goes with k_n^"
                f"{_shown(self.by_steps.exponent)} from {quantity(self.by_steps.k_low, 'N/m', 3)} to "
                f"{quantity(self.by_steps.k_high, 'N/m', 3)}"
            )
            if self.by_cpu is not None:
                texts[-1] += f", the CPU time as measured with k_n^{_shown(self.by_cpu.exponent)}"
            if self.by_net_cpu is not None:
                texts[-1] += f", less {fixed} with k_n^{_shown(self.by_net_cpu.exponent)}"
            texts[-1] += "."
        if self.fit is not None:
            start, per_step = self.fit.start, self.fit.per_step
            of = " for gas and exchange, which cost the same whatever the contact" if self.bed else ""
            texts.append(
                f"{name}: CPU time = ({start.value:.3g} ± {start.uncertainty:.2g}) s{of} + "
                f"({per_step.value:.3g} ± {per_step.uncertainty:.2g}) s per step, from {self.fit.runs} runs."
            )
            if self.fit.half_steps is not None:
                verb = "are" if self.bed else "is"
                texts[-1] += f" Below {self.fit.half_steps:.2g} steps {fixed} {verb} more than half of it."
        if self.by_cpu is not None:
            if self.holds is None:
                texts.append(
                    "In no range of k_n does the CPU time measurably follow k_n^(1/2) (three stiffnesses or more, "
                    f"exponent known to ±{RESOLVED:g})."
                )
            else:
                texts.append(
                    f"The CPU time follows k_n^(1/2) from {quantity(self.holds.k_low, 'N/m', 3)} to "
                    f"{quantity(self.holds.k_high, 'N/m', 3)} (exponent {_shown(self.holds.exponent)})."
                )
        return tuple(texts)


def _shown(estimate: Estimate) -> str:
    return f"({estimate.value:.3f} ± {estimate.uncertainty:.2g})"


def slope(k_n: Sequence[float] | Array, cost: Sequence[float] | Array) -> Slope:
    """Return the log-log slope of positive costs over stiffness, by least squares, with its 95 % interval (Student t).

    Raises
    ------
    InputError
        With fewer than three samples, fewer than two stiffnesses, or a value that is not above zero.
    """
    from scipy.stats import t

    x, y = np.asarray(k_n, dtype=np.float64), np.asarray(cost, dtype=np.float64)
    if x.size < _FEWEST or x.size != y.size or np.unique(x).size < 2 or not (min(x.min(), y.min()) > 0.0):
        raise InputError("slope: expected three positive costs or more, of two stiffnesses or more")
    u, w = np.log(x) - np.log(x).mean(), np.log(y) - np.log(y).mean()
    squares = float(u @ u)
    exponent = float(u @ w) / squares
    spread = float(np.sum((w - exponent * u) ** 2)) / (x.size - 2)
    width = float(t.ppf(0.975, x.size - 2)) * float(np.sqrt(spread / squares))
    return Slope(exponent=Estimate(value=exponent, uncertainty=width), k_low=float(x.min()), k_high=float(x.max()))


def fit_cost(steps: Sequence[float] | Array, cpu_seconds: Sequence[float] | Array) -> CostFit:
    """Fit CPU time = a + b steps by least squares of relative errors (times spread in proportion to their size).

    Raises
    ------
    InputError
        With fewer than three runs, two numbers of steps, or a time that is not above zero.
    """
    from scipy.stats import t

    x, y = np.asarray(steps, dtype=np.float64), np.asarray(cpu_seconds, dtype=np.float64)
    if x.size < _FEWEST or x.size != y.size or np.unique(x).size < 2 or not y.min() > 0.0:
        raise InputError("fit of the cost: expected three runs or more, of two numbers of steps or more, times > 0")
    scale = x.max()
    matrix = np.column_stack([np.ones_like(x), x / scale]) / y[:, None]
    # the pseudo-inverse: of two unknowns on well-scaled columns
    inverse = np.linalg.pinv(matrix)
    a, b = inverse @ np.ones_like(y)
    spread = np.sum((matrix @ [a, b] - 1.0) ** 2) / (x.size - 2)
    width = float(t.ppf(0.975, x.size - 2)) * np.sqrt(spread * np.diag(inverse @ inverse.T))
    return CostFit(
        start=Estimate(value=float(a), uncertainty=float(width[0])),
        per_step=Estimate(value=float(b / scale), uncertainty=float(width[1] / scale)),
        runs=int(x.size),
    )


def laws(trade: Trade) -> tuple[Law, ...]:
    """Return the law of the softened linear contacts and that of Hertz at reduced moduli, each at one N.

    Of several N the one counts at which most stiffnesses were timed, then most were run, then the finest.
    """
    linear = [p for p in trade.points if p.candidate.model == "linear" and p.candidate.how != "limited_overlap"]
    own = {p.candidate.how for p in linear if p.candidate.factor == 1.0}
    families = {
        "linear": [p for p in linear if p.candidate.how == "softened" or p.candidate.how in own],
        "hertz": [p for p in trade.points if p.candidate.how == "reduced_modulus"],
    }
    found = []
    for family, points in families.items():
        known = [p for p in points if p.completed and p.k_n and p.steps and p.candidate.factor]
        by_n: dict[float, list[TradePoint]] = {}
        for point in known:
            by_n.setdefault(point.candidate.steps_per_contact, []).append(point)
        if by_n:
            n = max(by_n, key=lambda n: (sum(bool(p.cpu_seconds) for p in by_n[n]), len(by_n[n]), n))
            model = [trade.reference] * (family == "hertz") + [p for p in trade.points if p.candidate.model == family]
            found.append(_law(family, n, by_n[n], _fit(model), bed=trade.bed))
    return tuple(found)


def _fit(points: Iterable[TradePoint]) -> CostFit | None:
    runs = [(float(p.steps), cpu) for p in points if p.steps and p.completed for cpu in p.cpu_seconds if cpu > 0.0]
    return fit_cost(*zip(*runs, strict=True)) if len({steps for steps, _ in runs}) >= _FEWEST else None


def _law(family: str, n: float, points: Iterable[TradePoint], fit: CostFit | None, *, bed: bool) -> Law:
    ordered = sorted(points, key=lambda p: p.k_n or 0.0)
    timed = [p for p in ordered if p.cpu_seconds]
    k = [p.k_n or np.nan for p in ordered]
    # every timed run counts by itself: the interval knows the spread of the rounds
    k_runs = [p.k_n or np.nan for p in timed for _ in p.cpu_seconds]
    cpu_runs = [cpu for p in timed for cpu in p.cpu_seconds]
    enough = len({p.k_n for p in timed}) >= _FEWEST
    return Law(
        family=family,
        steps_per_contact=n,
        k_n=tuple(k),
        steps=tuple(p.steps or 0 for p in ordered),
        cpu_seconds=tuple(float(np.median(p.cpu_seconds)) if p.cpu_seconds else np.nan for p in ordered),
        cpu_range=tuple(
            (min(p.cpu_seconds), max(p.cpu_seconds)) if p.cpu_seconds else (np.nan, np.nan) for p in ordered
        ),
        fit=fit,
        by_steps=slope(k, [float(p.steps or 0) for p in ordered]) if len(set(k)) >= _FEWEST else None,
        by_cpu=slope(k_runs, cpu_runs) if enough else None,
        by_net_cpu=None if fit is None or not enough else _net(k_runs, cpu_runs, fit),
        holds=widest(k_runs, cpu_runs) if enough else None,
        bed=bed,
    )


def _net(k_n: Sequence[float], cpu: Sequence[float], fit: CostFit) -> Slope | None:
    """Return the slope of the CPU time less the start, over the stiffnesses at which the start is less than half."""
    clear = [k for k in set(k_n) if all(c > 2.0 * fit.start.value for x, c in zip(k_n, cpu, strict=True) if x == k)]
    if len(clear) < _FEWEST:
        return None
    pairs = [(k, c - fit.start.value) for k, c in zip(k_n, cpu, strict=True) if k in clear]
    return slope(*zip(*pairs, strict=True))


def widest(k_n: Sequence[float], cost: Sequence[float]) -> Slope | None:
    """Return the slope over the widest range of neighbouring stiffnesses that agrees with 1/2; None: there is none.

    A range counts from three stiffnesses on, and only if its slope is known to ±`RESOLVED`; of equally wide ones the
    stiffest.
    """
    levels = sorted(set(k_n))
    best: Slope | None = None
    for i in range(len(levels)):
        for j in range(i + _FEWEST, len(levels) + 1):
            inside = [(k, c) for k, c in zip(k_n, cost, strict=True) if levels[i] <= k <= levels[j - 1]]
            found = slope(*zip(*inside, strict=True))
            if found.holds and (best is None or found.k_high / found.k_low >= best.k_high / best.k_low):
                best = found
    return best
