"""Numbers from the signals of a bed: the balance of forces, the spectrum of the pressure, the overlaps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.record.series import BedSeries

#: Percentiles of the overlaps.
PERCENTILES = (50.0, 90.0, 95.0, 99.0, 99.9)
#: Shortest signal and number of parts that a spectrum is made of.
_MIN_SPECTRUM, _PARTS = 64, 3


@dataclass(frozen=True, kw_only=True)
class Balance:
    """The vertical forces on the particles over a window, each relative to their weight W.

    Attributes
    ----------
    begin, end : of the window [s]
    gas : force of the gas, buoyancy included; floor, walls : force on the floor, on side walls and lid
    momentum : change of the particles' momentum over the length of the window
    closure : gas + floor + walls - 1 - momentum
    pressure : p_in times floor area less the weight of the gas between the particles; None without gas or with a jet,
        where p_in is not the pressure on the whole floor
    pressure_closure : the same as ``closure`` with ``pressure`` in place of ``gas``: it also has the gas momentum
        in it (flux and change) and the friction of the gas on walls
    """

    begin: float
    end: float
    gas: float
    floor: float
    walls: float
    momentum: float
    closure: float
    pressure: float | None
    pressure_closure: float | None


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
    percentiles : percentage -> overlap [m], linear within a bin of the histogram
    edges : (bins + 1,) [m]; histogram : (bins,) counts
    """

    counted: int
    mean: float
    max: float
    percentiles: Mapping[float, float]
    edges: Array
    histogram: NDArray[np.int64]


def rows_from(series: BedSeries, begin: float) -> NDArray[np.bool_]:
    """Mark the couplings with t >= ``begin`` [s]."""
    return series.t >= begin - 1e-9 * series.facts.coupling


def bed_kind(series: BedSeries, begin: float) -> str:
    """Return which of `kncal.scene.metrics.KINDS_OF_BEDS` a run is from ``begin`` [s] on."""
    if series.facts.count == 0:
        return "gas"
    rows = rows_from(series, begin)
    if not np.isfinite(series.floor[rows]).all():
        return "frozen"
    if series.facts.count == 1:
        return "single"
    return "ramp" if gas_changes(series, begin) else "steady"


def gas_changes(series: BedSeries, begin: float) -> bool:
    """Whether the inlet velocity changes from ``begin`` [s] on, so that averages would be over different states."""
    velocities = series.U_0[rows_from(series, begin)]
    return bool(len(velocities) and np.ptp(velocities) > 0.0)


def force_balance(series: BedSeries, begin: float, end: float | None = None) -> Balance:
    """Balance the vertical forces on the particles over the couplings with ``begin`` <= t <= ``end`` [s].

    Newton's second law for all particles together: gas + floor + walls - weight = change of momentum over time. The gas
    force is held constant in each interval and those of floor and walls are means over it, so the sum is exact but for
    rounding. The pressure form replaces the gas force by what the gas' own momentum balance says
    it is in the mean: p_in A less the weight of the gas (DPMFoam's pressure holds the weight of all of the column;
    the part displaced by the particles is the buoyancy in their force).

    Raises
    ------
    InputError
        If fewer than two couplings lie in the window, or the floor force was not recorded.
    """
    facts = series.facts
    if not facts.weight > 0.0:
        raise InputError("gravity is 0: expected particles with a weight to balance")
    inside = rows_from(series, begin)
    if end is not None:
        inside &= series.t <= end + 1e-9 * facts.coupling
    rows = np.flatnonzero(inside)
    if len(rows) < 2:
        raise InputError(f"begin = {begin:g} s, end = {end}: {len(rows)} couplings; expected at least 2 in the window")
    rows = rows[1:]  # the first is where the momentum is counted from
    weight = facts.weight
    gas, floor = float(series.drag_z[rows].mean()) / weight, float(series.floor[rows].mean()) / weight
    walls = float(series.walls[rows].mean()) / weight
    if not np.isfinite(floor + walls):
        raise InputError("the forces on floor and walls are not recorded: expected a run with moving particles")
    length = facts.coupling * len(rows)
    momentum = float(series.momentum_z[rows[-1]] - series.momentum_z[rows[0] - 1]) / length / weight
    pressure = None
    if facts.gas_density > 0.0 and not facts.jet:
        gas_volume = float(np.prod(facts.size)) - facts.mass / facts.density
        gas_weight = facts.gas_density * facts.gravity * gas_volume
        pressure = (float(series.p_in[rows].mean()) * facts.floor_area - gas_weight) / weight
    return Balance(
        begin=float(series.t[rows[0] - 1]),
        end=float(series.t[rows[-1]]),
        gas=gas,
        floor=floor,
        walls=walls,
        momentum=momentum,
        closure=gas + floor + walls - 1.0 - momentum,
        pressure=pressure,
        pressure_closure=None if pressure is None else pressure + floor + walls - 1.0 - momentum,
    )


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
    """Return mean, largest and percentiles of the overlaps from ``begin`` [s] on; InputError if there was none."""
    rows = rows_from(series, begin)
    histogram = series.histogram[rows].sum(axis=0)
    contacts = series.contacts[rows]
    if not histogram.sum() or not np.nansum(contacts) > 0.0:
        raise InputError("no contact between particles was recorded")
    edges = np.array(series.facts.histogram_edges)
    largest = float(np.nanmax(series.overlap_max[rows]))
    values = np.minimum(_quantiles(edges, histogram, np.array(PERCENTILES) / 100.0), largest)
    return OverlapStatistics(
        counted=int(histogram.sum()),
        mean=float(np.nansum(series.overlap_mean[rows] * contacts) / np.nansum(contacts)),
        max=largest,
        percentiles=dict(zip(PERCENTILES, values.tolist(), strict=True)),
        edges=edges,
        histogram=histogram,
    )


def _quantiles(edges: Array, histogram: NDArray[np.int64], shares: Array) -> Array:
    """Return where the cumulative histogram reaches ``shares``, linear within a bin, the lower end of empty bins."""
    filled = histogram > 0
    cumulative = np.concatenate([[0.0], np.cumsum(histogram[filled]) / histogram.sum()])
    at = np.clip(np.searchsorted(cumulative, shares, side="left") - 1, 0, int(filled.sum()) - 1)
    low, high = edges[:-1][filled][at], edges[1:][filled][at]
    values: Array = low + (high - low) * (shares - cumulative[at]) / (cumulative[at + 1] - cumulative[at])
    return values
