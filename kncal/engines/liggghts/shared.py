"""The memory that kncal and the process with LIGGGHTS share."""

from __future__ import annotations

import math
import mmap
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.engines.liggghts.impacts import BINS, POWERS

#: Overlap bins per decade, and the smallest overlap that is told apart from nothing, in diameters.
BINS_PER_DECADE, DECADES = 20, 8
_OVERLAP_BINS = DECADES * BINS_PER_DECADE + 1


def histogram_edges(diameter: float) -> Array:
    """Return the edges of the overlap bins [m]: 0, then 20 a decade from 1e-8 to 1 diameter (the smallest one)."""
    decades = np.arange(DECADES * BINS_PER_DECADE + 1) / BINS_PER_DECADE - DECADES
    return np.concatenate(([0.0], diameter * 10.0**decades))


class Sizes(NamedTuple):
    """Numbers of particles that will ever be there, pairs of species, walls whose forces are kept, and heights."""

    particles: int
    pairs: int
    walls: int
    heights: int

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the arrays, by name, in their order."""
        vector = (self.particles, 3)
        return {
            "x": vector,
            "v": vector,
            "spin": vector,
            "force": vector,
            "histogram": (_OVERLAP_BINS,),
            "impacts": (self.pairs, BINS),
            "impact_sums": (self.pairs, POWERS),
            "wall_force": (self.walls, self.heights, 3),
            "kind": (self.particles,),
        }

    @property
    def bytes(self) -> int:
        """Bytes of all of them."""
        return 8 * sum(math.prod(shape) for shape in self.shapes.values())


@dataclass(frozen=True)
class Shared:
    """The mapping that parent and child share: the particles by row, and what was looked at.

    ``x``, ``v``, ``spin``, ``kind`` as in `kncal.record.steps.ParticleState`; ``force``: (n, 3) of the gas [N];
    ``histogram``: (bins,) overlaps; ``impacts``: (pairs, bins) speeds of new contacts (see
    `kncal.engines.liggghts.impacts`); ``impact_sums``: (pairs, 3) sums of v, v², v³ of them; ``wall_force``: (walls,
    heights, 3) [N].
    """

    x: Array
    v: Array
    spin: Array
    force: Array
    histogram: Array
    impacts: Array
    impact_sums: Array
    wall_force: Array
    kind: NDArray[np.int64]

    @classmethod
    def over(cls, buffer: mmap.mmap, sizes: Sizes) -> Shared:
        """Return views of ``buffer``, which keep it open."""
        views: dict[str, NDArray[Any]] = {}
        begin = 0
        for name, shape in sizes.shapes.items():
            kind, number = (np.int64 if name == "kind" else np.float64), math.prod(shape)
            views[name] = np.frombuffer(buffer, dtype=kind, count=number, offset=begin).reshape(shape)
            begin += 8 * number
        return cls(**views)
