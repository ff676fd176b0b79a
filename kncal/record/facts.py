"""What stays the same during the run of a bed and is needed to understand its numbers."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from kncal.core.checks import Array
from kncal.scene.model import Plan
from kncal.scene.scene import Depth
from kncal.scene.values import Cells, Flag, Length, Number, Seconds, Size, Whole, Word, checked_class


@checked_class
class BedFacts:
    """What stays the same during a run and is needed to understand its numbers.

    Attributes
    ----------
    name : of the scene; kind : "linear" or "hertz"
    size : box (x, y, z) [m]; cells : gas cells per axis; front_back : what bounds it in y
    count : particles; diameter [m]; density of the particles [kg/m³]; gravity [m/s²]
    gas_density : [kg/m³], 0 without gas
    jet : whether the gas enters through a jet, so that ``p_in`` is the pressure at its slot only
    coupling : interval between couplings [s]
    histogram_edges : (bins + 1,) edges of the overlap histogram [m]
    impact_edges : (bins + 1,) edges of the histograms of impact speeds [m/s]; empty: they were not recorded
    """

    name: Word
    kind: Word
    size: Size
    cells: Cells
    front_back: Depth
    count: Annotated[Whole, Field(ge=0)]
    diameter: Length
    density: Number
    gravity: Number
    gas_density: Number
    jet: Flag
    coupling: Seconds
    histogram_edges: Annotated[tuple[Number, ...], Field(min_length=2)]
    impact_edges: tuple[Number, ...] = ()

    @property
    def impact_bins(self) -> int:
        """Number of bins of the histograms of impact speeds, 0 where they were not recorded."""
        return max(len(self.impact_edges) - 1, 0)

    @property
    def floor_area(self) -> float:
        """Area of the floor [m²]."""
        return self.size[0] * self.size[1]

    @property
    def mass(self) -> float:
        """Mass of all particles [kg]."""
        return self.count * self.density * np.pi / 6.0 * self.diameter**3

    @property
    def weight(self) -> float:
        """Weight of all particles [N]."""
        return self.mass * self.gravity


def bed_facts(model: Plan, histogram_edges: Array, impact_edges: Array) -> BedFacts:
    """Collect the facts of a model.

    ``histogram_edges`` (bins + 1,) [m] as the particle side counts overlaps; ``impact_edges`` (bins + 1,) [m/s] as it
    counts impact speeds, empty where it does not.
    """
    scene = model.scene
    return BedFacts(
        name=scene.name,
        kind=model.kind,
        size=scene.box.size,
        cells=scene.cells,
        front_back=scene.front_back,
        count=scene.number,
        diameter=scene.diameter,
        density=scene.density,
        gravity=scene.g,
        gas_density=scene.gas.density if scene.gas else 0.0,
        jet=bool(scene.gas and scene.gas.jet),
        coupling=model.coupling,
        histogram_edges=tuple(float(edge) for edge in histogram_edges),
        impact_edges=tuple(float(edge) for edge in impact_edges),
    )
