"""Time averages of correlated signals with an honest uncertainty.

Every uncertainty here is the half-width of a 95 % confidence interval.

Sources: batch means with Student's t: Schmeiser, Operations Research 30 (1982) 556; integrated autocorrelation time
with a self-consistent window: Sokal in "Functional Integration" (1997), section 3, and why blocks must be longer than
the correlation: Flyvbjerg and Petersen, J. Chem. Phys. 91 (1989) 461; start-up by the least marginal standard error
(MSER): White, Simulation 69 (1997) 323.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from kncal.core.checks import Array, as_floats, positive
from kncal.core.errors import InputError
from kncal.core.units import span

#: Largest and smallest number of batches; more gain little width (t = 2.13 for 16), fewer say little.
BATCHES = (5, 16)
#: A batch must be worth this many independent samples, or it still remembers its neighbours.
SAMPLES_PER_BATCH = 5.0
#: Below this many independent samples an uncertainty is not to be relied upon: its intervals cover 90 %, not 95 %.
RELIABLE_SAMPLES = 25.0
#: Confidence of every interval.
CONFIDENCE = 0.95
#: Fewer samples are refused.
MIN_SAMPLES = 10
#: A start-up of this share of the run may well go on: at most half of a run is looked at.
LONG_START_UP = 0.45
#: Significance at which batch means are said to drift.
_DRIFT = 0.01
_WINDOW = 5.0
#: Leaving out more must improve the standard error by this share of that of all samples.
_IMPROVES = 1e-3
#: A signal that varies by less than this share of its mean is as good as constant.
_CONSTANT = 1e-6


@dataclass(frozen=True, kw_only=True)
class Average:
    """A time average; ``y`` is the unit of the signal.

    Attributes
    ----------
    mean : [y]
    uncertainty : half-width of the 95 % confidence interval of the mean [y]
    standard_error : of the mean [y]
    std : standard deviation of the signal itself [y]
    n_effective : number of independent samples that would give the same standard error
    correlation_time : integrated autocorrelation time [s]; independent samples are twice that apart
    length : time averaged over [s]
    discarded : samples before this time are left out [s]
    reliable : whether the uncertainty may be believed
    why : why not; empty if it may
    """

    mean: float
    uncertainty: float
    standard_error: float
    std: float
    n_effective: float
    correlation_time: float
    length: float
    discarded: float
    reliable: bool
    why: str


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A number with its 95 % confidence interval ``low`` to ``high``; ``why`` it is not to be relied upon, or ""."""

    value: float
    low: float
    high: float
    why: str = ""

    @property
    def uncertainty(self) -> float:
        """Half the width of the interval relative to the value; 0 for a value of 0."""
        return 0.5 * (self.high - self.low) / self.value if self.value else 0.0

    def shown(self, unit: str, digits: int = 4) -> str:
        """Return the number with its interval and ``unit``; see `kncal.core.units.span`."""
        return span(self.value, self.low, self.high, unit, digits)


def average(t: ArrayLike, y: ArrayLike, discard: float | None = None) -> Average:
    """Average a signal over time, with an uncertainty that knows about its correlation.

    Means of 5 to 16 batches, each at least five independent samples long by the windowed autocorrelation, are taken as
    independent; their spread gives the standard error and Student's t the interval. While neighbouring batches are
    correlated by more than chance allows (one standard deviation), batches are made longer: the windowed
    autocorrelation does not see a slow component under a fast oscillation.

    Parameters
    ----------
    t : (n,) array
        Evenly spaced, increasing times [s].
    y : (n,) array
        Finite values.
    discard : float, optional
        Leave out samples with t < discard [s]; None: detect the start-up, see `start_up`.

    Raises
    ------
    InputError
        If shapes differ, times are not evenly spaced, values are not finite, or fewer than `MIN_SAMPLES` remain.
    """
    times, values = _signal(t, y)
    warnings = []
    if discard is None:
        first = start_up(values)
        if first >= LONG_START_UP * len(values):
            warnings.append("the start-up seems to fill half of the run or more")
    else:
        first = int(np.searchsorted(times, discard - 1e-9 * (times[1] - times[0])))
    kept = values[first:]
    if len(kept) < MIN_SAMPLES:
        raise InputError(
            f"discard = {discard!r} s leaves {len(kept)} of {len(values)} samples that end at t = {times[-1]:g} s; "
            f"expected at least {MIN_SAMPLES}: run longer or discard less"
        )
    step = float(times[-1] - times[0]) / (len(times) - 1)
    mean, std = float(kept.mean()), float(kept.std(ddof=1))
    length = len(kept) * step
    discarded = float(times[first]) if first else 0.0
    if std <= _CONSTANT * abs(mean):  # what is left is rounding, or a tail that no longer matters: state all of it
        uncertainty = float(np.ptp(kept))
        standard_error, n_effective = 0.5 * uncertainty, float(len(kept))
    else:
        standard_error, uncertainty, n_effective, drifts = _batch_error(kept)
        if n_effective < RELIABLE_SAMPLES:
            warnings.append(
                f"only {n_effective:.0f} independent samples in {length:.3g} s, {RELIABLE_SAMPLES:.0f} are needed"
            )
        if drifts:
            warnings.append("the signal still drifts")
    return Average(
        mean=mean,
        uncertainty=uncertainty,
        standard_error=standard_error,
        std=std,
        n_effective=n_effective,
        correlation_time=length / (2.0 * n_effective),
        length=length,
        discarded=discarded,
        reliable=not warnings,
        why="; ".join(warnings),
    )


def average_of_samples(values: ArrayLike) -> Average:
    """Average independent samples (n,), such as one value per bubble: mean and Student's t, times are 0.

    Raises
    ------
    InputError
        If there are fewer than two.
    """
    from scipy.stats import t as student

    samples = as_floats("values", values).ravel()
    n = len(samples)
    if n < 2:
        raise InputError(f"values has {n} samples: expected at least 2 for an uncertainty")
    std = float(samples.std(ddof=1))
    standard_error = std / float(np.sqrt(n))
    enough = n >= BATCHES[0]
    return Average(
        mean=float(samples.mean()),
        uncertainty=standard_error * float(student.ppf(0.5 + 0.5 * CONFIDENCE, n - 1)),
        standard_error=standard_error,
        std=std,
        n_effective=float(n),
        correlation_time=0.0,
        length=0.0,
        discarded=0.0,
        reliable=enough,
        why="" if enough else f"only {n} samples, {BATCHES[0]} are needed",
    )


def start_up(y: ArrayLike) -> int:
    """Return the number of samples to leave out at the beginning: where the marginal standard error is least.

    The marginal standard error of the samples from d on is the root of their summed squared deviations over their
    number (MSER). What improves it by less than a thousandth of its first value is not left out: a smooth tail would
    be cut off without end. At most half of the samples are left out.
    """
    values = as_floats("y", y)
    n = len(values)
    kept = np.arange(1, n + 1)
    backwards = values[::-1] - values.mean()  # centred: sums of squares of large values would cancel
    mean = np.cumsum(backwards) / kept
    squares = np.cumsum(backwards**2) - kept * mean**2
    smallest = n - n // 2
    error = np.sqrt(np.maximum(squares, 0.0))[smallest - 1 :] / kept[smallest - 1 :]
    return n - (smallest + int(np.flatnonzero(error <= error.min() + _IMPROVES * error[-1])[-1]))


def correlation_samples(y: ArrayLike) -> float:
    """Return the integrated autocorrelation time in samples, 1/2 + sum of rho_k: 1/2 for independent samples.

    The sum ends at the first lag of at least five times itself (Sokal). Values below 1/2 (alternating signals) are
    raised to 1/2.
    """
    values = as_floats("y", y)
    n = len(values)
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(values - values.mean(), size)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2, size)[:n]
    if covariance[0] <= 0.0:
        return 0.5
    tau = np.cumsum(covariance / covariance[0]) - 0.5
    ends = np.flatnonzero(np.arange(n) >= _WINDOW * tau)
    return max(float(tau[ends[0] if len(ends) else -1]), 0.5)


def needed_length(found: Average, precision: float) -> float:
    """Predict the time to average over for an uncertainty (95 % half-width) of ``precision`` [y].

    The standard error falls with the square root of the length; the length is at least what `RELIABLE_SAMPLES` take.

    Returns
    -------
    float
        Length without the start-up [s].

    Raises
    ------
    InputError
        If ``precision`` is not positive, or ``found`` is no average over time.
    """
    from scipy.stats import t as student

    positive("precision", precision)
    if not found.length > 0.0:
        raise InputError("found is an average of samples, not over time: no length can be predicted for it")
    factor = float(student.ppf(0.5 + 0.5 * CONFIDENCE, BATCHES[1] - 1))
    by_precision = found.length * (factor * found.standard_error / precision) ** 2
    return max(by_precision, 2.0 * RELIABLE_SAMPLES * found.correlation_time)


def _batch_error(y: Array) -> tuple[float, float, float, bool]:
    """Return standard error, half-width, independent samples, and whether the batch means drift."""
    from scipy.stats import linregress
    from scipy.stats import t as student

    n, variance = len(y), float(y.var(ddof=1))
    fewest, most = min(BATCHES[0], n // 2), min(BATCHES[1], n // 2)
    independent = 0.5 * n / correlation_samples(y)
    count = int(np.clip(independent / SAMPLES_PER_BATCH, fewest, most))
    means = _batch_means(y, count)
    while count > fewest and _neighbours(means) > 1.0 / np.sqrt(count):
        count = max(fewest, count // 2)
        means = _batch_means(y, count)
    standard_error = float(means.std(ddof=1)) / np.sqrt(count)
    # Batches of whole periods of an exactly periodic signal have equal means: rounding is no measure of an error.
    standard_error = max(float(standard_error), 1e-3 * float(np.sqrt(variance / n)))
    half_width = standard_error * float(student.ppf(0.5 + 0.5 * CONFIDENCE, count - 1))
    trend = linregress(np.arange(count, dtype=np.float64), means)
    n_effective = min(variance / standard_error**2, float(n))
    return standard_error, half_width, min(n_effective, independent), bool(trend.pvalue < _DRIFT)


def _neighbours(means: Array) -> float:
    """Return the correlation of neighbouring batch means, free of its bias of -1/count for independent ones."""
    deviation = means - means.mean()
    return float((deviation[1:] * deviation[:-1]).sum() / max(float((deviation**2).sum()), 1e-300)) + 1.0 / len(means)


def _batch_means(y: Array, count: int) -> Array:
    """Means of ``count`` equal batches; the few samples that do not fit are left out at the beginning."""
    size = len(y) // count
    means: Array = y[len(y) - size * count :].reshape(count, size).mean(axis=1)
    return means


def _signal(t: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    times, values = as_floats("t", t), as_floats("y", y)
    if times.ndim != 1 or times.shape != values.shape:
        raise InputError(f"t and y have shapes {times.shape} and {values.shape}: expected two equal ones, (n,)")
    if len(times) < MIN_SAMPLES:
        raise InputError(f"y has {len(values)} samples: expected at least {MIN_SAMPLES} for an average; run longer")
    steps = np.diff(times)
    if not (steps > 0.0).all() or np.ptp(steps) > 1e-4 * steps.mean():
        raise InputError(
            f"t: steps between {steps.min():g} and {steps.max():g} s; expected increasing, evenly spaced times"
        )
    return times, values
