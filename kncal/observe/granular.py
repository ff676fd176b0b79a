"""What a run of many particles without gas shows: its state, and what is read from its frames, outlets and walls.

A run is *resting* where its particles have come to rest: then the last frame is measured, and the width is the spread
of parts of it. Else values are averages over the frames of the window. What is dear in a frame is taken from
`MOST_FRAMES` of them, so that it costs the same whatever the length of the run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.observe.averages import Window
from kncal.observe.coarse_graining import Profile, layer_exponent, profile
from kncal.observe.discharge import Discharge, discharge
from kncal.observe.estimate import Estimate, averaged
from kncal.observe.grains import Grains, Space
from kncal.observe.mixing import MixingCurve, Mixture, cells_of, mixture
from kncal.observe.packing import Packed, packed
from kncal.observe.signals import bed_kind, evenly, rows_from
from kncal.observe.surface import (
    SurfaceFit,
    angles_of_parts,
    cone_fit,
    only,
    parts_of_cone,
    parts_of_slope,
    slope_fit,
)
from kncal.observe.wall_forces import Silo, silo, upright
from kncal.physics.statistics import MIN_SAMPLES, Average, average, average_of_samples, start_up
from kncal.record.series import BedSeries
from kncal.scene.scene import Scene
from kncal.scene.walls import BoxWall, CylinderWall

#: Most frames that are looked at for what is dear in each, and for the mixing curve.
MOST_FRAMES, MOST_MIXTURES = 50, 100
#: Parts of the frames of a run whose profiles give a width.
_PARTS = 8
#: A wall with more than this share of its force in the lowest bins is a floor there.
_FLOOR = 0.6
#: Walls that carry less than this share of the weight make no silo.
_SILO = 0.05


@dataclass(frozen=True, kw_only=True)
class GrainObservations:
    """What is seen of many particles without gas. What the run has no data for raises `InputError` with the reason.

    Attributes
    ----------
    series : the signals and frames; scene : what of them is asked for
    window : what is averaged over
    """

    series: BedSeries
    scene: Scene
    window: Window

    @cached_property
    def space(self) -> Space:
        """The box that is simulated."""
        facts = self.series.facts
        (x, y, z), (a, b, c) = facts.low, np.add(facts.low, facts.size).tolist()
        around = ("x" in facts.periodic, "y" in facts.periodic, "z" in facts.periodic)
        return Space(low=(x, y, z), high=(a, b, c), periodic=around, up=facts.up)

    @property
    def width(self) -> float:
        """Width of coarse graining [m]."""
        return self.scene.observe.width or self.scene.d_max

    @cached_property
    def resting(self) -> bool:
        """Whether the particles are at rest in the window."""
        return self.kind == "resting"

    @cached_property
    def kind(self) -> str:
        """One of `kncal.scene.metrics.KINDS_OF_BEDS`."""
        return bed_kind(self.series, self.window.begin)

    # --- frames ---------------------------------------------------------------------------------------------------

    def frames(self, of: NDArray[np.int64]) -> Iterator[Grains]:
        """Yield frames by their numbers, one at a time, of the particles that are there."""
        series, facts = self.series, self.series.facts
        radii, masses = np.array(facts.radii), np.array(facts.masses)
        for frame in of:
            kind = np.asarray(series.kind[frame], dtype=np.int64)
            (row,) = np.nonzero(kind >= 0)
            x, v, spin = (np.asarray(part[frame], dtype=np.float64)[row] for part in (series.x, series.v, series.spin))
            kind = kind[row]
            t = float(series.t_frame[frame])
            yield Grains(t=t, x=x, v=v, spin=spin, radius=radii[kind], mass=masses[kind], kind=kind, row=row)

    def flowing(self, of: NDArray[np.int64]) -> Iterator[Grains]:
        """Yield frames without the particles that are held in place."""
        held = np.array([self.scene.particles[name].frozen for name in self.series.facts.groups])
        for frame in self.frames(of):
            yield only(frame, ~held[frame.kind]) if held.any() else frame

    @cached_property
    def of_window(self) -> NDArray[np.int64]:
        """Numbers of the frames of the window (of the steady flow, where particles run out), at most `MOST_FRAMES`."""
        t, slack = self.series.t_frame, 1e-9 * self.series.facts.coupling
        begin, end = self.window.begin, float(self.series.t[-1])
        if self.kind == "passing":
            with suppress(InputError):  # they come in, and none passes an outlet
                begin, end = self.flow.begin, self.flow.end
        found = np.flatnonzero((t >= begin - slack) & (t <= end + slack))
        return _thinned(found[evenly(self.series.frame_coupling[found])], MOST_FRAMES)

    @cached_property
    def last(self) -> Grains:
        """The last frame."""
        if not len(self.series.t_frame):
            raise InputError("no frame was recorded: expected one; set run.frames_every")
        (found,) = self.frames(np.array([len(self.series.t_frame) - 1]))
        if not len(found.x):
            raise InputError("no particle is left in the last frame: expected some")
        return found

    @cached_property
    def shown(self) -> Grains:
        """The frame for pictures: the last one, or one from the middle of the flow where particles run in or out."""
        if self.kind != "passing":
            return self.last
        found = list(self.frames(self.of_window[len(self.of_window) // 2 :][:1]))
        return found[0] if found else self.last

    @cached_property
    def looked(self) -> NDArray[np.int64]:
        """Numbers of the frames that show the state: the last one at rest, else those of the window."""
        return np.array([len(self.series.t_frame) - 1]) if self.resting else self.of_window

    def state(self, values: Array, parts: Callable[[Grains], Array]) -> Estimate:
        """Return a quantity (frames,) of the frames `looked` at: one value with the spread of its parts, or a mean."""
        if not self.resting:
            return self.over_frames(values)
        try:
            spread = average_of_samples(parts(self.last))
        except InputError as error:
            return Estimate(value=float(values[-1]), reliable=False, why=f"no width from parts of the frame: {error}")
        why = spread.why.replace("samples", "parts of the last frame")
        width, reliable = spread.uncertainty, spread.reliable
        return Estimate(value=float(values[-1]), width=width, reliable=reliable, why=why, chance=True)

    def over_frames(self, values: Array) -> Estimate:
        """Return the average of a quantity of each frame of the window."""
        if len(values) < MIN_SAMPLES:
            raise InputError(
                f"{len(values)} evenly spaced frames in the window: expected at least {MIN_SAMPLES}; "
                "set a shorter run.frames_every, or a later run.until_time"
            )
        if not np.isfinite(values).all():
            raise InputError("not defined in every frame")
        return self.averaged(average(self.series.t_frame[self.of_window], values, 0.0))

    def over_rows(self, values: Array) -> Estimate:
        """Return the average of a signal per interval in the window.

        At rest forces still relax when nothing moves any more: the signal's own start-up is left out, and what its
        halves differ by is no chance, so the width is at least that.
        """
        t = self.series.t[-len(values) :]
        if not self.resting:
            return self.averaged(average(t, values, self.window.begin))
        inside = np.flatnonzero(t >= self.window.begin)
        kept = inside[min(start_up(values[inside]), max(len(inside) - MIN_SAMPLES, 0)) :]
        found = average(t[kept], values[kept])
        first, second = np.array_split(values[kept], 2)
        drift = abs(float(second.mean() - first.mean())) + abs(float(values[-1] - second.mean()))
        return self.averaged(replace(found, uncertainty=max(found.uncertainty, drift)))

    def averaged(self, found: Average) -> Estimate:
        """Return an average as an estimate, with what is to be doubted about the whole run."""
        if self.window.doubt:
            found = replace(found, reliable=False, why="; ".join(filter(None, (self.window.doubt, found.why))))
        estimate = averaged(found, self.window.begin, float(self.series.t[-1]))
        # where particles run out a longer run sees no more of them
        lasting = None if self.kind == "passing" else estimate.average
        return replace(estimate, started=not self.window.doubt, average=lasting)

    # --- parts that figures draw ------------------------------------------------------------------------------------

    @cached_property
    def flow(self) -> Discharge:
        """Mass through the outlets where particles leave, all together; of planes that only count, the one most pass.

        What passes a plane and leaves behind it counts once.
        """
        t, mass = self.series.t, self.series.out_mass
        if not mass.shape[1]:
            raise InputError("no outlets: expected one, where a mass flow is to be measured")
        leave = np.array([self.scene.outlets[name].delete for name in self.series.facts.outlets], dtype=bool)
        out = mass[:, leave].sum(axis=1) if leave.any() else mass[:, int(mass[-1].argmax())]
        return discharge(np.concatenate([[0.0], t]), np.concatenate([[0.0], out]))

    def fit(self, grains: Grains) -> SurfaceFit:
        """Fit the free surface that the case asks for."""
        choice, space = self.scene.observe, self.space
        if choice.surface == "cone":
            return cone_fit(grains, space, self.centre, self.width)
        if choice.surface == "slope":
            return slope_fit(grains, space, "xyz".index(choice.axis), self.width)
        raise InputError("observe.surface is not given: expected slope or cone, where an angle is to be measured")

    @property
    def centre(self) -> tuple[float, float, float]:
        """The point that a heap is about [m]; 0 along the vertical."""
        a, b = self.scene.observe.centre
        vertical = self.space.axis_of()
        found = [a, b]
        found.insert(vertical, 0.0)
        return (found[0], found[1], found[2])

    def angles(self, grains: Grains) -> Array:
        """Return the angles [degrees] of parts of the surface."""
        if self.scene.observe.surface == "cone":
            masks = parts_of_cone(grains, self.space, self.centre)
        else:
            masks = parts_of_slope(grains, self.space, "xyz".index(self.scene.observe.axis), 4.0 * self.scene.d_max)
        return angles_of_parts(self.fit, grains, masks)

    @cached_property
    def profile(self) -> Profile:
        """Along the axis that the case asks for, over the frames of the window (of the last, of a run at rest)."""
        return self._profile(self.of_window)

    def _profile(self, frames: NDArray[np.int64]) -> Profile:
        axis, flat = "xyz".index(self.scene.observe.profile), 2 if self.scene.layer else 3
        return profile(lambda: self.flowing(frames), self.space, axis, self.width, flat=flat)

    @cached_property
    def part_profiles(self) -> tuple[Profile, ...]:
        """The profile of each of eight parts of the window."""
        return tuple(self._profile(part) for part in np.array_split(self.of_window, _PARTS) if len(part))

    @cached_property
    def exponents(self) -> Array:
        """Exponents of the flowing layer, of parts of the window."""
        axis = "xyz".index(self.scene.observe.profile)
        flow = self.profile.flow
        if not self.space.periodic[flow] or self.space.periodic[axis] or flow == axis:
            raise InputError("no layer that flows along a periodic direction: it has no profile of its own")
        away = 3.0 * self.scene.d_max
        return np.array([layer_exponent(part, self.space.up[axis], away)[0] for part in self.part_profiles])

    @cached_property
    def packings(self) -> tuple[Packed, ...]:
        """The packing in every frame `looked` at."""
        contact = self.scene.contact
        rubs = contact.friction or any(pair.friction for pair in contact.pairs)
        least = 2 if rubs else 3 if self.scene.layer else 4
        return tuple(
            packed(frame, self.space, self.width, self.resolution, least) for frame in self.frames(self.looked)
        )

    @cached_property
    def fits(self) -> tuple[SurfaceFit, ...]:
        """The surface in every frame `looked` at."""
        return tuple(self.fit(frame) for frame in self.frames(self.looked))

    @property
    def resolution(self) -> float:
        """Distance that two positions of a frame are known to [m]: they are kept in single precision."""
        return float(np.abs([self.space.low, self.space.high]).max()) * float(np.finfo(np.float32).eps)

    @cached_property
    def groups(self) -> NDArray[np.int64]:
        """The group of every species; where there is one group only, every species is one."""
        names = list(self.series.facts.groups)
        order = list(dict.fromkeys(names))
        return np.arange(len(names)) if len(order) == 1 else np.array([order.index(name) for name in names])

    def mixture(self, grains: Grains) -> Mixture:
        """Return how well the groups of a frame are mixed."""
        _, group = np.unique(self.groups[grains.kind], return_inverse=True)
        return mixture(group.astype(np.int64), cells_of(grains.x, self.scene.observe.cell_number))

    @cached_property
    def mixing(self) -> MixingCurve:
        """How the groups mix over the whole run, frames without two groups left out."""
        found = []
        even = np.flatnonzero(evenly(self.series.frame_coupling))
        for frame in self.flowing(_thinned(even, MOST_MIXTURES)):
            try:
                found.append((frame.t, self.mixture(frame)))
            except InputError:
                continue
        if not found:
            raise InputError("no frame has two groups of enough particles: expected some for a mixing index")
        each = [one for _, one in found]
        return MixingCurve(
            t=np.array([t for t, _ in found]),
            lacey=np.array([one.lacey for one in each]),
            error=np.array([one.error for one in each]),
            chance=each[-1].chance,
        )

    @cached_property
    def carried(self) -> tuple[Array, Array]:
        """Vertical force of the particles on walls, positive downwards, of every interval [N].

        Two arrays: (intervals,) on floors, (intervals, bins) on the rest. Of a box or a mesh that is mostly loaded in
        the two lowest bins that are loaded at all, what it carries there is on a floor.
        """
        down = -(self.series.wall_force @ np.asarray(self.space.up))
        rows = rows_from(self.series, self.window.begin)
        mean = np.abs(down[rows].mean(axis=0))
        loaded = np.flatnonzero(mean.sum(axis=0) > 1e-3 * mean.sum())
        if not len(loaded):
            raise InputError("no particle pushes on a wall")
        below = loaded[0] + 2
        floor, side = np.zeros(len(down)), down.copy()
        for k, name in enumerate(self.series.facts.walls):
            stands = upright(self.scene.walls.get(name), self.space.up)
            low = stands is None and mean[k, :below].sum() > _FLOOR * mean[k].sum()
            of = slice(None) if stands is False else slice(below if low else 0)
            floor += down[:, k, of].sum(axis=1)
            side[:, k, of] = 0.0
        return floor, side.sum(axis=1)

    @cached_property
    def silo(self) -> Silo:
        """The law of Janssen, fitted to the mean of the window."""
        rows, g = rows_from(self.series, self.window.begin), self.series.facts.gravity
        share = float(self.carried[1][rows].sum() / sum(part[rows].sum() for part in self.carried))
        if share < _SILO:
            raise InputError(
                f"the side walls carry {share:.2g} of the weight: expected a silo, where they carry {_SILO:g}"
            )
        frames = [self.last] if self.resting else list(self.frames(_thinned(self.of_window, MIN_SAMPLES)))
        up = np.asarray(self.space.up)
        weights = [np.histogram(f.x @ up, self.series.facts.heights, weights=f.mass * g)[0] for f in frames]
        return silo(self.series.facts.heights, np.mean(weights, axis=0), self.carried[1][rows].mean(axis=0))

    @property
    def hydraulic_diameter(self) -> float:
        """4 A/P of the cross-section of the one cylinder or box [m]; sides that are periodic are not of P."""
        vertical, found = self.space.axis_of(), []
        for wall in self.scene.walls.values():
            if isinstance(wall, CylinderWall) and "xyz".index(wall.axis) == vertical:
                found.append(2.0 * wall.radius)
            elif isinstance(wall, BoxWall):
                a, b = (i for i in range(3) if i != vertical)
                sides = [0.0 if self.space.periodic[i] else 2.0 / wall.size[i] for i in (a, b)]
                found.append(4.0 / sum(sides))
        if len(found) != 1:
            raise InputError(f"{len(found)} upright cylinders and boxes: expected one for a hydraulic diameter")
        return found[0]


def _thinned(frames: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return at most ``most`` of some evenly spaced frames, evenly spaced too, the last among them."""
    step = -(-len(frames) // most)
    return frames[::-1][:: max(step, 1)][::-1]
