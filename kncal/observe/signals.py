"""Numbers from the signals of a bed: the spectrum of the pressure, the overlaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.record.series import BedSeries

#: Mean square speed below which particles without gas are at rest, over g d.
AT_REST = 1e-4
#: A mass that changes by more than this share is not steady.
_PASSING = 0.05
#: Shortest signal and number of parts that a spectrum is made of.
_MIN_SPECTRUM, _PARTS = 64, 3


@dataclass(frozen=True, kw_only=True)
class Spectrum:
    """Power spectral density of the inlet pressure.

    Attributes
    ----------
    frequency : (f,) [Hz]; density : (f,) [Pa²/Hz]
    dominant : frequency of the largest peak [Hz]; resolution : distance of two frequencies [Hz]
    """

    frequency: Array
    density: Array
    dominant: float
    resolution: float


@dataclass(frozen=True, kw_only=True)
class OverlapStatistics:
    """Overlaps of all contacts between particles, every contact at every sample counting once.

    Attributes
    ----------
    counted : number of overlaps counted
    mean : [m]; max : largest seen [m]
    edges : (bins + 1,) [m]; histogram : (bins,) counts
    """

    counted: int
    mean: float
    max: float
    edges: Array
    histogram: NDArray[np.int64]


def rows_from(series: BedSeries, begin: float) -> NDArray[np.bool_]:
    """Mark the couplings with t >= ``begin`` [s]."""
    return series.t >= begin - 1e-9 * series.facts.coupling


def evenly(coupling: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mark the frames of the rhythm that the first two begin; one more at the end of a run is none of them."""
    steps = np.diff(coupling)
    if not len(steps):
        return np.ones(len(coupling), dtype=bool)
    return np.concatenate([[True], np.cumsum(steps != steps[0]) == 0])


def bed_kind(series: BedSeries, begin: float) -> str:
    """Return which of `kncal.scene.metrics.KINDS_OF_BEDS` a run is from ``begin`` [s] on."""
    if series.facts.count == 0:
        return "gas"
    if not moving(series, begin):
        return "frozen"
    if series.facts.count == 1:
        return "single"
    if series.facts.gas_density <= 0.0:
        return _kind_of_grains(series, begin)
    return "ramp" if gas_changes(series, begin) else "steady"


def moving(series: BedSeries, begin: float) -> bool:
    """Whether the particles move from ``begin`` [s] on, so that their contacts were recorded."""
    felt = series.floor if series.facts.gas_density > 0.0 else series.contacts  # without gas not all have a floor
    return bool(np.isfinite(felt[rows_from(series, begin)]).all())


def _kind_of_grains(series: BedSeries, begin: float) -> str:
    """Return the kind of many particles without gas."""
    if (rest := rest_begin(series)) is not None and begin >= rest:
        return "resting"
    mass = series.mass[rows_from(series, begin)]
    return "passing" if abs(mass[-1] - mass[0]) > _PASSING * mass.max() else "steady"


def rest_begin(series: BedSeries) -> float | None:
    """Return from when on particles without gas are at rest until the end [s]; None if they are not.

    At rest their mean square speed is below `AT_REST` g d, that of a fall through a twenty-thousandth of a diameter;
    without gravity, below `AT_REST` of its largest. While a wall moves nothing is at rest.
    """
    facts, there = series.facts, series.mass > 0.0
    if facts.gas_density > 0.0 or not len(series.t) or not there[-1]:
        return None
    square = 2.0 * series.kinetic_energy / np.where(there, series.mass, np.inf)
    fast = np.flatnonzero(square > AT_REST * (facts.gravity * facts.diameter or float(square.max())))
    slow = series.t[fast[-1] + 1 :] if len(fast) else series.t
    slow = slow[slow >= facts.driven_until]
    if not len(slow):
        return None
    return 0.0 if len(slow) == len(series.t) else float(slow[0])


def gas_changes(series: BedSeries, begin: float) -> bool:
    """Whether the inlet velocity changes from ``begin`` [s] on, so that averages would be over different states."""
    velocities = series.U_0[rows_from(series, begin)]
    return bool(len(velocities) and np.ptp(velocities) > 0.0)


def pressure_spectrum(series: BedSeries, begin: float) -> Spectrum:
    """Return the spectrum of the inlet pressure from ``begin`` [s] on, by Welch's method.

    Hann windows of a third of the signal, overlapping by half, the linear trend taken off; the peak is refined by a
    parabola through the logarithms of three densities. Source: Welch, IEEE Trans. Audio Electroacoust. 15 (1967) 70.

    Raises
    ------
    InputError
        If the signal is shorter than 64 couplings, or constant.
    """
    from scipy.signal import detrend, welch

    signal = series.p_in[rows_from(series, begin)]
    if len(signal) < _MIN_SPECTRUM:
        raise InputError(f"{len(signal)} couplings: expected at least {_MIN_SPECTRUM} for a spectrum")
    if np.ptp(signal) <= 1e-12 * np.abs(signal).max():
        raise InputError("the inlet pressure is constant: it has no spectrum")
    size = len(signal) // _PARTS
    frequency, density = welch(detrend(signal), fs=1.0 / series.facts.coupling, nperseg=size)
    peak = 1 + int(np.argmax(density[1:]))
    shift = 0.0
    if 1 < peak < len(density) - 1 and (density[peak - 1 : peak + 2] > 0.0).all():
        low, middle, high = np.log(density[peak - 1 : peak + 2])
        bend = low - 2.0 * middle + high
        shift = 0.5 * (low - high) / bend if bend < 0.0 else 0.0
    resolution = float(frequency[1])
    return Spectrum(
        frequency=np.asarray(frequency, dtype=np.float64),
        density=np.asarray(density, dtype=np.float64),
        dominant=float(frequency[peak]) + shift * resolution,
        resolution=resolution,
    )


def overlap_statistics(series: BedSeries, begin: float) -> OverlapStatistics:
    """Return mean, largest and histogram of the overlaps from ``begin`` [s] on; InputError if there was none."""
    rows = rows_from(series, begin)
    histogram = series.histogram[rows].sum(axis=0)
    contacts = series.contacts[rows]
    if not histogram.sum() or not np.nansum(contacts) > 0.0:
        raise InputError("no contact between particles was recorded")
    return OverlapStatistics(
        counted=int(histogram.sum()),
        mean=float(np.nansum(series.overlap_mean[rows] * contacts) / np.nansum(contacts)),
        max=float(np.nanmax(series.overlap_max[rows])),
        edges=np.array(series.facts.histogram_edges),
        histogram=histogram,
    )
