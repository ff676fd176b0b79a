"""What a bed did: averages with uncertainty, and all else that is reported of one run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.observe.bubbles import Bubbles, BubbleTracks, find_bubbles, follow
from kncal.observe.fields import (
    SolidsFields,
    frames_from,
    mean_voidage,
    pressure_heights,
    solids_fields,
    voidage_heights,
)
from kncal.observe.fluidization_curve import FluidizationCurve, fluidization_curve
from kncal.observe.packed_bed import Plateau, ergun_plateaus
from kncal.observe.settling import FinalVelocity, final_velocity
from kncal.observe.signals import (
    Balance,
    OverlapStatistics,
    Spectrum,
    bed_kind,
    force_balance,
    gas_changes,
    overlap_statistics,
    pressure_spectrum,
    rows_from,
)
from kncal.physics.statistics import LONG_START_UP, MIN_SAMPLES, Average, average, average_of_samples, start_up
from kncal.record.series import BedSeries
from kncal.scene.bed_scene import Gas
from kncal.scene.metrics import why_not

#: Signals whose start-ups are detected; the longest is left out of everything.
START_UP_OF = ("p_in", "floor", "z_mean", "kinetic_energy")
#: Parts of a run whose largest overlaps, or dominant frequencies, are compared.
_PARTS = 5
#: A peak of the spectrum is one if it is this many times the median: that of white noise is five to six times.
_PEAK = 10.0

_T = TypeVar("_T")


@dataclass(frozen=True, kw_only=True)
class BedObservations:
    """All that is reported of one bed run.

    Attributes
    ----------
    kind : one of `kncal.scene.metrics.KINDS_OF_BEDS`; changes : whether the gas velocity changes after ``begin``
    begin : start-up left out before this time [s]
    begin_by : "given", or the signal of `START_UP_OF` that took longest to settle; "given" too where nothing is left
        out: of a single particle, a frozen bed and a ramp
    averages : name -> Average; names and units of `kncal.scene.metrics.METRICS`
    missing : name -> why there is none
    balance : Balance or None; spectrum : Spectrum or None; overlaps : OverlapStatistics or None
    eps_g : (nz, ny, nx) time mean void fraction, or None
    solids : SolidsFields or None; bubbles, tracks : or None
    final : of a single particle; plateaus : of a frozen bed, one per gas velocity that was held; curve : of
        a ramp; each None, or empty, for what it is not of
    """

    kind: str
    changes: bool
    begin: float
    begin_by: str
    averages: Mapping[str, Average]
    missing: Mapping[str, str]
    balance: Balance | None
    spectrum: Spectrum | None
    overlaps: OverlapStatistics | None
    eps_g: Array | None
    solids: SolidsFields | None
    bubbles: Bubbles | None
    tracks: BubbleTracks | None
    final: FinalVelocity | None
    plateaus: tuple[Plateau, ...]
    curve: FluidizationCurve | None


def observe_bed(series: BedSeries, discard: float | None = None, gas: Gas | None = None) -> BedObservations:
    """Observe a run after its start-up: until ``discard`` [s], or as detected.

    What the run has no data for is in ``missing`` with the reason, not an error. ``gas`` of the scene is needed for
    what is compared with a drag law: ``final``, ``plateaus`` and ``curve``.

    Raises
    ------
    InputError
        If fewer than `MIN_SAMPLES` couplings remain.
    """
    begin, begin_by, doubt = window_start(series, discard)
    kind, changes = bed_kind(series, begin), gas_changes(series, begin)
    facts = series.facts
    rows = rows_from(series, begin)
    if rows.sum() < MIN_SAMPLES:
        raise InputError(
            f"{rows.sum()} couplings from {begin:g} s on, of a run of {len(rows)}: expected at least {MIN_SAMPLES}; "
            "run longer, or discard less"
        )
    no_gas = "" if facts.gas_density > 0.0 else "no gas"
    frozen = "" if np.isfinite(series.floor[rows]).all() else "no contacts were recorded (particles do not move)"
    found = _Collector(series, begin, doubt, kind, changes)
    found.rows("pressure_drop", series.p_in, no_gas)
    floating = "" if facts.weight > 0.0 else "no gravity"
    if not floating:
        found.rows("floor_share", series.floor / facts.weight, frozen)
    for name in ("z_mean", "z_95", "kinetic_energy"):
        found.rows(name, getattr(series, name))
    for name in ("overlap_mean", "contacts"):
        found.rows(name, getattr(series, name), frozen)
    spectrum = found.attempt("dominant_frequency", lambda: pressure_spectrum(series, begin))
    if spectrum is not None:
        dominant = found.attempt("dominant_frequency", lambda: _dominant(series, begin, spectrum))
        if dominant is not None:
            found.keep("dominant_frequency", dominant)
    overlaps = found.attempt("overlap_max", lambda: overlap_statistics(series, begin))
    if overlaps is not None:
        found.keep("overlap_max", _largest(series.overlap_max[rows]))
    heights = found.frames("bed_height", lambda: voidage_heights(series, begin))
    found.frames("height_pressure", lambda: pressure_heights(series, begin))
    solids = found.attempt("granular_temperature", lambda: solids_fields(series, begin))
    if solids is not None:
        found.frames("granular_temperature", lambda: solids.theta_frames)
    bubbles = found.attempt("bubble_number", lambda: find_bubbles(series, begin))
    tracks = None
    if bubbles is not None and heights is not None:
        found.frames("bubble_number", lambda: bubbles.number)
        below = np.maximum(heights, facts.diameter) * facts.floor_area
        found.frames("bubble_share", lambda: bubbles.total_volume / below)
        tracks = follow(bubbles)
        for name, values in (("bubble_diameter", tracks.diameter), ("bubble_velocity", tracks.velocity)):
            found.bubbles(name, values)
    final = found.attempt("velocity", lambda: final_velocity(series, gas)) if kind == "single" else None
    plateaus = found.attempt("ergun_ratio", lambda: ergun_plateaus(series, gas)) if kind == "frozen" else None
    curve = found.attempt("U_mf", lambda: fluidization_curve(series, gas)) if kind == "ramp" else None
    return BedObservations(
        kind=kind,
        changes=changes,
        begin=begin,
        begin_by=begin_by,
        averages=found.averages,
        missing=found.missing,
        balance=None if frozen or floating else force_balance(series, begin),
        spectrum=spectrum,
        overlaps=overlaps,
        eps_g=mean_voidage(series, begin) if kind in ("steady", "frozen") and len(series.eps_g) else None,
        solids=solids,
        bubbles=bubbles,
        tracks=tracks,
        final=final,
        plateaus=plateaus or (),
        curve=curve,
    )


def window_start(series: BedSeries, discard: float | None = None) -> tuple[float, str, str]:
    """Return the time [s] from which a run is averaged, what says so (see `BedObservations`), and a doubt or "".

    That is ``discard`` [s], or where the start-up ends as detected; 0 for a single particle, a frozen bed, a ramp.
    """
    if discard is not None:
        return discard, "given", ""
    begin, begin_by, doubt = _begin(series)
    if bed_kind(series, begin) in ("single", "frozen") or gas_changes(series, begin):
        return 0.0, "given", ""
    return begin, begin_by, doubt


def voidage_difference(a: BedSeries, b: BedSeries, begin_a: float, begin_b: float) -> tuple[float, float]:
    """Return the rms difference of two mean void fraction fields, and what of it sampling alone would give.

    The second is from the spread of the means of five equal parts of each run, cell by cell: a difference
    not clearly larger than it is none.

    Raises
    ------
    InputError
        If the grids differ, or a run has fewer than `MIN_SAMPLES` frames.
    """
    if a.facts.cells != b.facts.cells:
        raise InputError(f"cells {a.facts.cells} and {b.facts.cells}: expected runs on the same grid")
    parts = 5
    means, noise = [], 0.0
    for series, begin in ((a, begin_a), (b, begin_b)):
        frames = frames_from(series, begin)
        if len(frames) < MIN_SAMPLES or len(series.eps_g) != len(series.t_frame):
            raise InputError(f"{len(frames)} frames with gas after {begin:g} s: expected at least {MIN_SAMPLES}")
        means.append(mean_voidage(series, begin))
        split = np.stack([series.eps_g[part].mean(axis=0, dtype=np.float64) for part in np.array_split(frames, parts)])
        noise += float(split.var(axis=0, ddof=1).mean()) / parts
    return float(np.sqrt(np.mean((means[0] - means[1]) ** 2))), float(np.sqrt(noise))


class _Collector:
    """Averages by name, and the reasons for those that there are none of; ``doubt`` is added to all."""

    def __init__(self, series: BedSeries, begin: float, doubt: str, kind: str, changes: bool) -> None:
        self.series = series
        self.begin = begin
        self.doubt = doubt
        self.kind = kind
        self.changes = changes
        self.averages: dict[str, Average] = {}
        self.missing: dict[str, str] = {}

    def rows(self, name: str, values: Array, reason: str = "") -> None:
        """Average a signal per coupling, unless there is a reason not to."""
        if reason := why_not(name, self.kind, self.changes) or reason:
            self.missing[name] = reason
        else:
            self.keep(name, average(self.series.t, values, self.begin))

    def frames(self, name: str, compute: Callable[[], Array]) -> Array | None:
        """Average a signal per frame, and return it."""
        values = self.attempt(name, compute)
        if values is None:
            return None
        of = frames_from(self.series, self.begin)
        even = _evenly(self.series.frame_coupling[of])
        if not np.isfinite(values[even]).all():
            self.missing[name] = "not defined in every frame"
        elif even.sum() < MIN_SAMPLES:
            self.missing[name] = f"{even.sum()} evenly spaced frames, {MIN_SAMPLES} are needed"
        else:
            self.keep(name, average(self.series.t_frame[of][even], values[even], self.begin))
        return values

    def bubbles(self, name: str, values: Array) -> None:
        """Average a value per bubble."""
        if len(values) < 2:
            self.missing[name] = f"{len(values)} bubbles could be followed, 2 are needed"
        else:
            self.keep(name, average_of_samples(values))

    def attempt(self, name: str, compute: Callable[[], _T]) -> _T | None:
        """Return what ``compute`` does; if its input is not there, or this bed has no such thing, keep the reason."""
        if reason := why_not(name, self.kind, self.changes):
            self.missing[name] = reason
            return None
        try:
            return compute()
        except InputError as error:
            self.missing[name] = str(error)
            return None

    def keep(self, name: str, found: Average) -> None:
        """Keep an average, with the doubt about the whole run."""
        if self.doubt:
            found = replace(found, reliable=False, why="; ".join(part for part in (self.doubt, found.why) if part))
        self.averages[name] = found


def _begin(series: BedSeries) -> tuple[float, str, str]:
    """Return the end of the longest start-up [s], whose it is, and a doubt if it fills half of the run."""
    signals = {name: getattr(series, name) for name in START_UP_OF}
    ends = {name: start_up(values) for name, values in signals.items() if len(values) and np.isfinite(values).all()}
    if not ends:
        return 0.0, "no signal", ""
    name = max(ends, key=lambda key: ends[key])
    late = ends[name] >= LONG_START_UP * len(series.t)
    doubt = f"the start-up of {name} seems to fill half of the run or more" if late else ""
    return float(series.t[ends[name]]) if ends[name] else 0.0, name, doubt


def _evenly(coupling: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mark the frames of the rhythm that the first two begin; one more at the end of a run is none of them."""
    steps = np.diff(coupling)
    if not len(steps):
        return np.ones(len(coupling), dtype=bool)
    return np.concatenate([[True], np.cumsum(steps != steps[0]) == 0])


def _largest(overlap_max: Array) -> Average:
    """Return the largest overlap; how uncertain it is tells the spread of the largest of five parts of the run."""
    parts = average_of_samples([part.max() for part in np.array_split(overlap_max, _PARTS)])
    return replace(parts, mean=float(overlap_max.max()))


def _dominant(series: BedSeries, begin: float, spectrum: Spectrum) -> Average:
    """Return the dominant frequency, uncertain by the resolution of the spectrum; reliable from ten periods on.

    Raises
    ------
    InputError
        If no peak stands out.
    """
    length = int(rows_from(series, begin).sum()) * series.facts.coupling
    periods = spectrum.dominant * length
    density = spectrum.density[1:]
    doubts = []
    if periods < 10.0:
        doubts.append(f"only {periods:.0f} periods in {length:.3g} s, 10 are needed")
    if density.max() < _PEAK * np.median(density):
        raise InputError("no peak stands out of the spectrum")
    return Average(
        mean=spectrum.dominant,
        uncertainty=spectrum.resolution,
        standard_error=0.5 * spectrum.resolution,
        std=spectrum.resolution,
        n_effective=periods,
        correlation_time=0.5 / spectrum.dominant,
        length=length,
        discarded=begin,
        reliable=not doubts,
        why="; ".join(doubts),
    )
