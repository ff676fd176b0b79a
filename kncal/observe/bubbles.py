"""Bubbles in the void fraction of a bed: found, measured, followed from frame to frame.

A bubble is a connected region of cells (sharing faces) with a void fraction above a threshold that is not connected
to the freeboard. What is as small as a cell or two is noise and left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array, in_range
from kncal.core.errors import InputError
from kncal.observe.fields import cell_centres, frames_from
from kncal.record.facts import BedFacts
from kncal.record.series import BedSeries

#: Void fraction above which a cell belongs to a bubble.
BUBBLE_VOIDAGE = 0.7
#: Smaller regions are left out [cells].
MIN_CELLS = 4
#: Rise velocity of a single bubble over sqrt(g D): Davidson and Harrison, "Fluidised Particles" (1963).
RISE = 0.711
#: A bubble may rise this many times faster than a single one, and change its volume by this factor, between two frames.
FASTEST, GROWTH = 3.0, 2.0
#: A track of fewer frames has no rise velocity.
MIN_TRACK = 3


@dataclass(frozen=True, kw_only=True)
class Bubbles:
    """All bubbles of all frames, one row each, by frame.

    Attributes
    ----------
    threshold : void fraction above which a cell is bubble
    t_frame : (frames,) of the frames searched [s]; step : time between them [s]
    frame : (bubbles,) index into ``t_frame``
    centre : (bubbles, 3) centre of volume [m]
    volume : (bubbles,) [m³]
    diameter : (bubbles,) of the cylinder through the depth of the same volume for a bubble that reaches from the
        front to the back, else of the sphere [m]
    at_floor : (bubbles,) whether it touches the floor: a jet, or a bubble that has not come off yet
    track : (bubbles,) number of the track; the same bubble in successive frames has the same
    """

    threshold: float
    t_frame: Array
    step: float
    frame: NDArray[np.int64]
    centre: Array
    volume: Array
    diameter: Array
    at_floor: NDArray[np.bool_]
    track: NDArray[np.int64]

    @property
    def number(self) -> Array:
        """(frames,) number of bubbles that have come off the floor."""
        number = np.bincount(self.frame[~self.at_floor], minlength=len(self.t_frame))
        return np.asarray(number, dtype=np.float64)

    @property
    def total_volume(self) -> Array:
        """(frames,) volume of all bubbles that have come off the floor [m³]."""
        free = ~self.at_floor
        volume = np.bincount(self.frame[free], weights=self.volume[free], minlength=len(self.t_frame))
        return np.asarray(volume, dtype=np.float64)


@dataclass(frozen=True, kw_only=True)
class BubbleTracks:
    """Bubbles followed over at least `MIN_TRACK` frames after they came off the floor, one row each.

    Attributes
    ----------
    diameter : (tracks,) mean [m]
    velocity : (tracks,) rise velocity, slope of height over time by least squares [m/s]
    height : (tracks,) mean height of the centre [m]
    frames : (tracks,) number of frames
    """

    diameter: Array
    velocity: Array
    height: Array
    frames: NDArray[np.int64]


def find_bubbles(series: BedSeries, begin: float = 0.0, threshold: float = BUBBLE_VOIDAGE) -> Bubbles:
    """Find the bubbles of the frames from ``begin`` [s] on and follow them.

    Two regions of successive frames are the same bubble if each is the other's nearest to where a single bubble would
    have risen to, if it moved sideways by at most half its diameter (and a cell), upwards by at most three times the
    single bubble's way (and a cell), and changed its volume by at most a factor of two.

    Raises
    ------
    InputError
        If ``threshold`` is not between 0 and 1, or there are no frames with gas.
    """
    from scipy import ndimage

    in_range("threshold", threshold, 0.0, 1.0)
    frames = frames_from(series, begin)
    if len(series.eps_g) != len(series.t_frame):
        raise InputError("the frames hold no void fraction; expected a run with gas")
    facts = series.facts
    within = np.zeros((3, 3, 3, 3), dtype=bool)
    within[1] = ndimage.generate_binary_structure(3, 1)  # regions do not connect through time
    labels, count = _label(series.eps_g[frames] > threshold, within)
    if facts.front_back == "periodic" and facts.cells[1] > 1:
        labels, count = _join(labels[:, :, 0, :], labels[:, :, -1, :], labels, count)
    keep = np.bincount(labels.ravel(), minlength=count + 1) >= MIN_CELLS
    keep[0] = False
    keep[np.unique(labels[:, -1])] = False
    # new labels from 1, 0 for all that is left out
    labels = np.where(keep, np.cumsum(keep, dtype=np.int64), 0)[labels]
    where = np.nonzero(labels)
    label = labels[where] - 1
    count = int(keep.sum())
    cells: Array = np.bincount(label, minlength=count).astype(np.float64)
    volume: Array = cells * float(np.prod(np.array(facts.size) / facts.cells))
    frame = np.zeros(count, dtype=np.int64)
    frame[label] = where[0]
    at_floor = np.zeros(count, dtype=bool)
    at_floor[label[where[1] == 0]] = True
    t_frame = series.t_frame[frames]
    found = Bubbles(
        threshold=threshold,
        t_frame=t_frame,
        step=float(np.median(np.diff(t_frame))) if len(t_frame) > 1 else 0.0,
        frame=frame,
        centre=_centres(facts, where, label, cells),
        volume=volume,
        diameter=_diameters(facts, where[2], label, volume),
        at_floor=at_floor,
        track=np.zeros(count, dtype=np.int64),
    )
    found.track[:] = _tracks(facts, found)
    return found


def follow(bubbles: Bubbles) -> BubbleTracks:
    """Return diameter and rise velocity of every bubble that was seen in at least `MIN_TRACK` frames."""
    rows = []
    for track in np.unique(bubbles.track):
        of = np.flatnonzero((bubbles.track == track) & ~bubbles.at_floor)
        if len(of) < MIN_TRACK:
            continue
        t, z = bubbles.t_frame[bubbles.frame[of]], bubbles.centre[of, 2]
        rows.append((bubbles.diameter[of].mean(), np.polyfit(t - t[0], z, 1)[0], z.mean(), len(of)))
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    return BubbleTracks(
        diameter=table[:, 0], velocity=table[:, 1], height=table[:, 2], frames=table[:, 3].astype(np.int64)
    )


def _label(inside: NDArray[np.bool_], within: NDArray[np.bool_]) -> tuple[NDArray[np.int64], int]:
    from scipy import ndimage

    labels, count = ndimage.label(inside, structure=within)
    return np.asarray(labels, dtype=np.int64), int(count)


def _join(
    front: NDArray[np.int64], back: NDArray[np.int64], labels: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int64], int]:
    """Give regions that meet through the periodic boundary one label."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    meet = (front > 0) & (back > 0)
    pairs = (front[meet], back[meet])
    graph = coo_array((np.ones(len(pairs[0]), dtype=np.int8), pairs), shape=(count + 1, count + 1))
    joined, component = connected_components(graph, directed=False)
    # component 0 is that of label 0, the cells outside all regions: it meets nothing and comes first
    return component.astype(np.int64)[labels], int(joined) - 1


def _centres(facts: BedFacts, where: tuple[NDArray[np.int64], ...], label: NDArray[np.int64], cells: Array) -> Array:
    x, y, z = cell_centres(facts)
    at = [x[where[3]], y[where[2]], z[where[1]]]
    centre = np.stack([np.bincount(label, weights=a, minlength=len(cells)) / cells for a in at], axis=1)
    if facts.front_back == "periodic":  # the mean on a circle
        depth = facts.size[1]
        angle = 2.0 * np.pi * at[1] / depth
        c, s = (np.bincount(label, weights=f(angle), minlength=len(cells)) for f in (np.cos, np.sin))
        centre[:, 1] = np.arctan2(s, c) / (2.0 * np.pi) * depth % depth
    return centre


def _diameters(facts: BedFacts, y: NDArray[np.int64], label: NDArray[np.int64], volume: Array) -> Array:
    ny, depth = facts.cells[1], facts.size[1]
    layers = np.zeros((len(volume), ny), dtype=bool)
    layers[label, y] = True
    cylinder = np.sqrt(4.0 * volume / (np.pi * depth))
    sphere = np.cbrt(6.0 * volume / np.pi)
    diameter: Array = np.where(layers.all(axis=1), cylinder, sphere)
    return diameter


def _tracks(facts: BedFacts, bubbles: Bubbles) -> NDArray[np.int64]:
    """Return a track number for every bubble, from 0."""
    track = np.arange(len(bubbles.frame), dtype=np.int64)
    first = np.searchsorted(bubbles.frame, np.arange(len(bubbles.t_frame) + 1))
    for frame in range(len(bubbles.t_frame) - 1):
        before = slice(first[frame], first[frame + 1])
        after = slice(first[frame + 1], first[frame + 2])
        for i, j in _same(facts, bubbles, before, after):
            track[first[frame + 1] + j] = track[first[frame] + i]
    numbers: NDArray[np.int64] = np.unique(track, return_inverse=True)[1].astype(np.int64)
    return numbers


def _same(facts: BedFacts, bubbles: Bubbles, before: slice, after: slice) -> list[tuple[int, int]]:
    """Return pairs of indices into the two slices."""
    if before.start == before.stop or after.start == after.stop:
        return []
    cell = np.array(facts.size) / facts.cells
    diameter = bubbles.diameter[before, None]
    way = bubbles.centre[after][None] - bubbles.centre[before][:, None]
    if facts.front_back == "periodic":
        way[..., 1] -= facts.size[1] * np.round(way[..., 1] / facts.size[1])
    rise = RISE * np.sqrt(facts.gravity * diameter) * bubbles.step
    growth = bubbles.volume[after][None] / bubbles.volume[before, None]
    possible = (
        (np.abs(way[..., 0]) <= 0.5 * diameter + cell[0])
        & (np.abs(way[..., 1]) <= 0.5 * diameter + cell[1])
        & (way[..., 2] >= -cell[2])
        & (way[..., 2] <= FASTEST * rise + cell[2])
        & (growth <= GROWTH)
        & (growth >= 1.0 / GROWTH)
    )
    way[..., 2] -= rise
    distance = np.where(possible, np.linalg.norm(way, axis=2), np.inf)
    nearest = distance.argmin(axis=1)
    mutual = distance.argmin(axis=0)
    return [(i, int(j)) for i, j in enumerate(nearest) if mutual[j] == i and np.isfinite(distance[i, j])]
