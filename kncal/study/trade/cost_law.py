"""Where the law of cost ~ k_n^(1/2) holds: slopes of steps and CPU time over the stiffness, with intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.core.units import quantity
from kncal.observe.estimate import Estimate
from kncal.report.style import model_name
from kncal.study.trade.trade import Trade, TradePoint

#: The exponent of the law: t_c ~ k_n^(-1/2), so the number of steps goes with k_n^(1/2).
LAW = 0.5
#: A slope whose 95 % interval is wider than this to either side says nothing about the law.
RESOLVED = 0.1
#: Fewest stiffnesses for a slope with an interval.
_FEWEST = 3


@dataclass(frozen=True, kw_only=True)
class CostFit:
    """CPU time = start + per_step * steps.

    Attributes
    ----------
    start : what every run costs, whatever its steps [s]
    per_step : [s]
    runs : number of timed runs
    """

    start: Estimate
    per_step: Estimate
    runs: int

    @property
    def half_steps(self) -> float | None:
        """Number of steps at which the start is half of the time; None where start or time per step is not resolved."""
        start, per_step = self.start.value, self.per_step.value
        resolved = self.start.significant and self.per_step.significant
        return start / per_step if resolved and start and per_step and min(start, per_step) > 0.0 else None


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
    def over(self) -> str:
        """The range in words."""
        return f"{quantity(self.k_low, 'N/m', 3)} to {quantity(self.k_high, 'N/m', 3)}"

    @property
    def holds(self) -> bool:
        """Whether it agrees with 1/2 and is narrow enough to say so."""
        return (self.exponent.width or 0.0) <= RESOLVED and includes(self.exponent, LAW)


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
    fixed : what every run costs, whatever its steps, in words
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
    fixed: str = ""

    @property
    def sentences(self) -> tuple[str, ...]:
        """The law in words."""
        name, of = model_name(self.family).capitalize(), f"N = {self.steps_per_contact:g}"
        texts = []
        if self.by_steps is not None:
            more = [("CPU time as k_n^", self.by_cpu), (f"CPU time without {self.fixed} as k_n^", self.by_net_cpu)]
            goes = "".join(f", {what}{_shown(found.exponent)}" for what, found in more if found is not None)
            texts.append(
                f"{name}, {of}: the steps go as k_n^{_shown(self.by_steps.exponent)}{goes}, from {self.by_steps.over}."
            )
        if self.fit is not None:
            half, runs = self.fit.half_steps, f"from {self.fit.runs} runs"
            start, per_step = (f"({e.value:.3g} ± {e.width:.2g}) s" for e in (self.fit.start, self.fit.per_step))
            texts.append(f"{name}: CPU time = {start} for {self.fixed} + {per_step} per step, {runs}.")
            if half is not None:
                texts[-1] += f" Below {half:.2g} steps more than half of it is {self.fixed}."
        if self.by_cpu is not None:
            texts.append(
                f"{name}: the CPU time goes as k_n^(1/2) nowhere (in no range of three stiffnesses or more is the"
                f" exponent 1/2 and known to ±{RESOLVED:g})."
                if self.holds is None
                else f"{name}: the CPU time goes as k_n^(1/2) from {self.holds.over}"
                f" (exponent {_shown(self.holds.exponent)})."
            )
        return tuple(texts)


def _shown(found: Estimate) -> str:
    return f"({found.value:.3f} ± {found.width:.2g})"


def includes(found: Estimate, value: float) -> bool:
    """Whether ``value`` is within the interval of an estimate."""
    return abs(value - (found.value or 0.0)) <= (found.width or 0.0)


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
    return Slope(exponent=Estimate(value=exponent, width=width), k_low=float(x.min()), k_high=float(x.max()))


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
        start=Estimate(value=float(a), width=float(width[0])),
        per_step=Estimate(value=float(b / scale), width=float(width[1] / scale)),
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
            found.append(_law(family, n, by_n[n], _fit(model), trade.fixed))
    return tuple(found)


def _fit(points: Iterable[TradePoint]) -> CostFit | None:
    runs = [(float(p.steps), cpu) for p in points if p.steps and p.completed for cpu in p.cpu_seconds if cpu > 0.0]
    return fit_cost(*zip(*runs, strict=True)) if len({steps for steps, _ in runs}) >= _FEWEST else None


def _law(family: str, n: float, points: Iterable[TradePoint], fit: CostFit | None, fixed: str) -> Law:
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
        fixed=fixed,
    )


def _net(k_n: Sequence[float], cpu: Sequence[float], fit: CostFit) -> Slope | None:
    """Return the slope of the CPU time less the start, over the stiffnesses at which the start is less than half."""
    start = fit.start.value or 0.0
    clear = [k for k in set(k_n) if all(c > 2.0 * start for x, c in zip(k_n, cpu, strict=True) if x == k)]
    if len(clear) < _FEWEST:
        return None
    return slope(*zip(*((k, c - start) for k, c in zip(k_n, cpu, strict=True) if k in clear), strict=True))


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
