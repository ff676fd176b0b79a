"""What the signals of a run show after its start-up: every metric by one table, and the parts that figures draw."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.observe.bubbles import Bubbles, BubbleTracks, find_bubbles, follow
from kncal.observe.estimate import Estimate, averaged, missing
from kncal.observe.fields import (
    SolidsFields,
    frames_from,
    mean_voidage,
    pressure_heights,
    solids_fields,
    solids_volume_below,
    voidage_heights,
)
from kncal.observe.fluidization_curve import FluidizationCurve, fluidization_curve
from kncal.observe.packed_bed import Plateau, ergun_plateaus
from kncal.observe.settling import FinalVelocity, final_velocity
from kncal.observe.signals import (
    OverlapStatistics,
    Spectrum,
    bed_kind,
    evenly,
    gas_changes,
    moving,
    overlap_statistics,
    pressure_spectrum,
    rest_begin,
    rows_from,
)
from kncal.physics.statistics import LONG_START_UP, MIN_SAMPLES, Average, average, average_of_samples, start_up
from kncal.record.series import BedSeries
from kncal.scene.gas import Gas
from kncal.scene.metrics import why_not

#: Signals whose start-ups are detected; the longest is left out of everything.
START_UP_OF = ("p_in", "floor", "z_mean", "kinetic_energy")
#: Contacts with a larger overlap than this share of the diameter are counted in ``overlap_share``.
OVERLAP_LIMIT = 0.01
#: Parts of a run whose largest overlaps, or dominant frequencies, are compared.
_PARTS = 5
#: A peak of the spectrum is one if it is this many times the median: that of white noise is five to six times.
_PEAK = 10.0


class Window(NamedTuple):
    """From when a run is averaged.

    ``begin``: start-up left out before this time [s]. ``by``: "given", or the signal of `START_UP_OF` that took longest
    to settle; "rest" where the particles come to rest; "given" too where nothing is left out: of a single particle, a
    frozen bed, a ramp, and particles that run in or out. ``doubt``: about the whole run, or "".
    """

    begin: float
    by: str
    doubt: str


@dataclass(frozen=True, kw_only=True)
class BedObservations:
    """What is seen in the signals of a run. A part that the run has no data for, or that means nothing for it, raises
    `InputError` with the reason; `get` gives None.

    Attributes
    ----------
    series : the signals; gas : of the scene, needed for what is compared with a drag law
    window : what is averaged over
    """

    series: BedSeries
    gas: Gas | None
    window: Window

    @property
    def begin(self) -> float:
        """Start of the window [s]."""
        return self.window.begin

    @cached_property
    def kind(self) -> str:
        """One of `kncal.scene.metrics.KINDS_OF_BEDS`."""
        return bed_kind(self.series, self.begin)

    @cached_property
    def changes(self) -> bool:
        """Whether the gas velocity changes in the window."""
        return gas_changes(self.series, self.begin)

    @cached_property
    def estimates(self) -> Mapping[str, Estimate]:
        """Every metric of `kncal.scene.metrics.METRICS` that means something for such a bed, by its name."""
        return {name: self._estimate(compute) for name, compute in _METRICS.items() if not self.why_not(name)}

    def why_not(self, metric: str) -> str:
        """Return why ``metric`` means nothing for such a bed; "" if it does."""
        return why_not(metric, self.kind, self.changes)

    def get(self, part: str) -> Any:
        """Return a part by its name, None without it."""
        try:
            return getattr(self, part)
        except InputError:
            return None

    @cached_property
    def spectrum(self) -> Spectrum:
        """Of the inlet pressure."""
        self._means("dominant_frequency")
        return pressure_spectrum(self.series, self.begin)

    @cached_property
    def overlaps(self) -> OverlapStatistics:
        """Of all contacts between particles."""
        self._means("overlap_max")
        return overlap_statistics(self.series, self.begin)

    @cached_property
    def heights(self) -> Array:
        """(frames,) height of the bed [m]."""
        self._means("bed_height")
        return voidage_heights(self.series, self.begin)

    @cached_property
    def eps_g(self) -> Array:
        """(nz, ny, nx) time mean void fraction, of a state that stays."""
        if self.kind not in ("steady", "frozen"):
            raise InputError("the bed changes: a mean void fraction would be one of different states")
        return mean_voidage(self.series, self.begin)

    @cached_property
    def solids(self) -> SolidsFields:
        """Mean motion and granular temperature of the particles."""
        self._means("granular_temperature")
        return solids_fields(self.series, self.begin)

    @cached_property
    def bubbles(self) -> Bubbles:
        """Of all frames."""
        self._means("bubble_number")
        return find_bubbles(self.series, self.begin)

    @cached_property
    def tracks(self) -> BubbleTracks:
        """Bubbles that were followed."""
        return follow(self.bubbles)

    @cached_property
    def final(self) -> FinalVelocity:
        """Of a single particle."""
        self._means("velocity")
        return final_velocity(self.series, self.gas)

    @cached_property
    def plateaus(self) -> tuple[Plateau, ...]:
        """Of a frozen bed: one per gas velocity that was held."""
        self._means("ergun_ratio")
        return ergun_plateaus(self.series, self.gas)

    @cached_property
    def curve(self) -> FluidizationCurve:
        """Of a ramp."""
        self._means("U_mf")
        return fluidization_curve(self.series, self.gas)

    @property
    def worst_plateau(self) -> Plateau:
        """The plateau whose ratio is farthest from 1."""
        return max(self.plateaus, key=lambda p: abs(p.ratio - 1.0))

    def rows(self, values: Array) -> Average:
        """Average a signal per coupling."""
        return average(self.series.t[-len(values) :], values, self.begin)

    def frames(self, values: Array) -> Average:
        """Average a signal per frame of the window, over those that are evenly spaced."""
        of = frames_from(self.series, self.begin)
        even = evenly(self.series.frame_coupling[of])
        if not np.isfinite(values[even]).all():
            raise InputError("not defined in every frame")
        if even.sum() < MIN_SAMPLES:
            raise InputError(f"{even.sum()} evenly spaced frames, {MIN_SAMPLES} are needed")
        return average(self.series.t_frame[of][even], values[even], self.begin)

    def _means(self, metric: str) -> None:
        if reason := self.why_not(metric):
            raise InputError(reason)

    def _estimate(self, compute: Callable[[BedObservations], Average | Estimate]) -> Estimate:
        try:
            found = compute(self)
        except InputError as error:
            return missing(str(error))
        if isinstance(found, Estimate):
            return found
        if self.window.doubt:
            found = replace(found, reliable=False, why="; ".join(filter(None, (self.window.doubt, found.why))))
        return replace(averaged(found, self.begin, float(self.series.t[-1])), started=not self.window.doubt)


def observe_bed(series: BedSeries, discard: float | None = None, gas: Gas | None = None) -> BedObservations:
    """Observe a run after its start-up: until ``discard`` [s], or as detected.

    Raises
    ------
    InputError
        If fewer than `MIN_SAMPLES` couplings remain.
    """
    window = window_start(series, discard)
    rows = rows_from(series, window.begin)
    if rows.sum() < MIN_SAMPLES:
        raise InputError(
            f"{rows.sum()} couplings from {window.begin:g} s on, of a run of {len(rows)}: expected at least"
            f" {MIN_SAMPLES}; run longer, or discard less"
        )
    return BedObservations(series=series, gas=gas, window=window)


def window_start(series: BedSeries, discard: float | None = None) -> Window:
    """Return from when a run is averaged: ``discard`` [s], or where the start-up ends as detected."""
    if discard is not None:
        return Window(discard, "given", "")
    rest = rest_begin(series)
    if rest is not None and rows_from(series, rest).sum() >= MIN_SAMPLES:
        return Window(rest, "rest", "")
    signals = {name: getattr(series, name) for name in START_UP_OF}
    ends = {name: start_up(values) for name, values in signals.items() if len(values) and np.isfinite(values).all()}
    if not ends:
        return Window(0.0, "no signal", "")
    name = max(ends, key=lambda key: ends[key])
    begin = float(series.t[ends[name]]) if ends[name] else 0.0
    if bed_kind(series, begin) in ("single", "frozen", "passing") or gas_changes(series, begin):
        return Window(0.0, "given", "")
    late = ends[name] >= LONG_START_UP * len(series.t)
    return Window(begin, name, f"the start-up of {name} seems to fill half of the run or more" if late else "")


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
    means, noise = [], 0.0
    for series, begin in ((a, begin_a), (b, begin_b)):
        frames = frames_from(series, begin)
        if len(frames) < MIN_SAMPLES or len(series.eps_g) != len(series.t_frame):
            raise InputError(f"{len(frames)} frames with gas after {begin:g} s: expected at least {MIN_SAMPLES}")
        means.append(mean_voidage(series, begin))
        split = np.stack([series.eps_g[part].mean(axis=0, dtype=np.float64) for part in np.array_split(frames, _PARTS)])
        noise += float(split.var(axis=0, ddof=1).mean()) / _PARTS
    return float(np.sqrt(np.mean((means[0] - means[1]) ** 2))), float(np.sqrt(noise))


# --- how each metric is computed ----------------------------------------------------------------------------------


def _one(value: float | None, width: float) -> Estimate:
    """One value of the whole run, with a width of its own kind."""
    if value is None:
        raise InputError("too little of it was seen")
    return Estimate(value=value, width=width, chance=True)


def _pressure(seen: BedObservations) -> Array:
    if seen.series.facts.gas_density <= 0.0:
        raise InputError("no gas")
    return seen.series.p_in


def _of_contacts(seen: BedObservations, values: Array) -> Array:
    """Return what is known of particles that move alone."""
    if not moving(seen.series, seen.begin):
        raise InputError("no contacts were recorded (particles do not move)")
    return values


def _over_weight(seen: BedObservations, force: Array) -> Array:
    """Return forces on the particles over their weight."""
    if not seen.series.facts.weight > 0.0:
        raise InputError("the particles have no weight")
    return _of_contacts(seen, force) / seen.series.facts.weight


def _fluctuation(seen: BedObservations) -> Average:
    """Average the squared deviation of the pressure; the uncertainty of its root follows to first order."""
    pressure = _pressure(seen)
    found = seen.rows((pressure - pressure[rows_from(seen.series, seen.begin)].mean()) ** 2)
    if found.mean <= 0.0:
        return replace(found, mean=0.0)
    std = float(np.sqrt(found.mean))
    slope = 0.5 / std
    return replace(
        found,
        mean=std,
        uncertainty=slope * found.uncertainty,
        standard_error=slope * found.standard_error,
        std=slope * found.std,
    )


def _dominant(seen: BedObservations) -> Average:
    """The dominant frequency, uncertain by the resolution of the spectrum; reliable from ten periods on."""
    spectrum = seen.spectrum
    length = int(rows_from(seen.series, seen.begin).sum()) * seen.series.facts.coupling
    periods = spectrum.dominant * length
    density = spectrum.density[1:]
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
        discarded=seen.begin,
        reliable=periods >= 10.0,
        why="" if periods >= 10.0 else f"only {periods:.0f} periods in {length:.3g} s, 10 are needed",
    )


def _closure(seen: BedObservations) -> Average:
    """The sum of the vertical forces on the particles and their inertia, over their weight.

    Newton's second law for all particles together: gas + floor + walls - weight = change of momentum over time; forces
    are means over each coupling, so the sum is exact but for rounding. The force of the gas is what the gas' own
    momentum balance says it is in the mean: p_in A less the weight of the gas (DPMFoam's pressure holds the weight of
    all of the column; the part displaced by the particles is the buoyancy in their force).
    """
    series, facts = seen.series, seen.series.facts
    pressure = _pressure(seen)
    if facts.jet:
        raise InputError("the gas enters through a jet: the pressure on the rest of the floor is not recorded")
    gas_weight = facts.gas_density * facts.gravity * (float(np.prod(facts.size)) - facts.mass / facts.density)
    forces = pressure * facts.floor_area - gas_weight + series.floor + series.walls
    rate = np.diff(series.momentum_z) / facts.coupling  # the momentum before the first coupling is not recorded
    return seen.rows(_over_weight(seen, forces)[1:] - rate / facts.weight - 1.0)


def _voidage(seen: BedObservations) -> Average:
    """Average the void fraction below the bed height, frame by frame."""
    if not (seen.heights > 0.0).all():
        raise InputError("not defined in every frame: no layer is denser than the freeboard")
    return seen.frames(1.0 - solids_volume_below(seen.series, seen.heights, seen.begin) / seen.heights)


def _bubble_share(seen: BedObservations) -> Average:
    facts = seen.series.facts
    return seen.frames(seen.bubbles.total_volume / (np.maximum(seen.heights, facts.diameter) * facts.floor_area))


def _followed(values: Array) -> Average:
    """Average a value per bubble."""
    if len(values) < 2:
        raise InputError(f"{len(values)} bubbles could be followed, 2 are needed")
    return average_of_samples(values)


def _largest(seen: BedObservations) -> Average:
    """The largest overlap; how uncertain it is tells the spread of the largest of five parts of the run."""
    rows = rows_from(seen.series, seen.begin)
    parts = average_of_samples([part.max() for part in np.array_split(seen.series.overlap_max[rows], _PARTS)])
    return replace(parts, mean=seen.overlaps.max)


def _overlap_share(seen: BedObservations) -> Average:
    """Average the share of overlaps above `OVERLAP_LIMIT`, every contact counting once.

    A ratio of two means: its uncertainty is that of the mean of ``(above - share n)/mean n``, to first order (the
    ratio estimator of survey sampling: Cochran, "Sampling Techniques" (1977), chapter 6).
    """
    facts, histogram = seen.series.facts, seen.series.histogram
    edges = np.array(facts.histogram_edges)
    rows = rows_from(seen.series, seen.begin)
    # the share of each bin above the limit: 1 above, 0 below, linear within
    weight = np.clip((edges[1:] - 2.0 * OVERLAP_LIMIT * min(facts.radii)) / np.diff(edges), 0.0, 1.0)
    above, number = histogram @ weight, histogram.sum(axis=1).astype(np.float64)
    mean = float(number[rows].mean())
    if mean <= 0.0:
        raise InputError("no contact between particles was recorded")
    share = float(above[rows].mean()) / mean
    return seen.rows(share + (above - share * number) / mean)


#: Metric -> how it is computed of what was seen; `InputError` where that is not possible.
_METRICS: Mapping[str, Callable[[BedObservations], Average | Estimate]] = {
    "velocity": lambda s: _one(s.final.velocity, s.final.uncertainty),
    "slip": lambda s: _one(s.final.slip, s.final.slip_uncertainty),
    "ergun_ratio": lambda s: _one(s.worst_plateau.ratio, s.worst_plateau.uncertainty),
    "U_mf": lambda s: _one(s.curve.falling.U_mf, s.curve.falling.uncertainty),
    "U_mf_rising": lambda s: _one(s.curve.rising.U_mf, s.curve.rising.uncertainty),
    "overshoot": lambda s: _one(s.curve.rising.largest - 1.0, s.curve.rising.largest_uncertainty),
    "plateau": lambda s: _one(s.curve.falling.plateau, s.curve.falling.plateau_uncertainty),
    "eps_mf": lambda s: _one(s.curve.falling.eps_g, s.curve.falling.eps_g_uncertainty),
    "pressure_drop": lambda s: s.rows(_pressure(s)),
    "pressure_fluctuation": _fluctuation,
    "dominant_frequency": _dominant,
    "weight_balance": lambda s: s.rows(_over_weight(s, s.series.drag_z + s.series.floor + s.series.walls)),
    "weight_closure": _closure,
    "floor_share": lambda s: s.rows(_over_weight(s, s.series.floor)),
    "z_mean": lambda s: s.rows(s.series.z_mean),
    "z_95": lambda s: s.rows(s.series.z_95),
    "bed_height": lambda s: s.frames(s.heights),
    "height_pressure": lambda s: s.frames(pressure_heights(s.series, s.begin)),
    "voidage": _voidage,
    "bubble_number": lambda s: s.frames(s.bubbles.number),
    "bubble_share": _bubble_share,
    "bubble_diameter": lambda s: _followed(s.tracks.diameter),
    "bubble_velocity": lambda s: _followed(s.tracks.velocity),
    "kinetic_energy": lambda s: s.rows(s.series.kinetic_energy),
    "granular_temperature": lambda s: s.frames(s.solids.theta_frames),
    "contacts": lambda s: s.rows(_of_contacts(s, s.series.contacts)),
    "overlap_mean": lambda s: s.rows(_of_contacts(s, s.series.overlap_mean)),
    "overlap_max": _largest,
    "overlap_share": _overlap_share,
}
