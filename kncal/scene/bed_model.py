"""A bed with numbers, for one model ("linear" or "hertz"): what both solvers need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from kncal.scene.bed_scene import BedScene
from kncal.scene.model import PairContact


@dataclass(frozen=True, kw_only=True)
class BedModel:
    """One model of a bed.

    Attributes
    ----------
    scene : BedScene
    kind : "linear" or "hertz"
    contacts : ("particles", "particles") and ("particles", "walls") -> PairContact (see `kncal.scene.model`)
    dt : DEM step [s]
    steps_per_coupling : DEM steps per coupling interval
    coupling : coupling interval [s], exactly ``steps_per_coupling * dt``
    gas_steps : gas steps per coupling interval
    couplings : number of couplings in the run
    frames_every : couplings between recorded frames
    """

    scene: BedScene
    kind: str
    contacts: Mapping[tuple[str, str], PairContact]
    dt: float
    steps_per_coupling: int
    coupling: float
    couplings: int
    frames_every: int
    gas_steps: int = 1

    @property
    def gas_step(self) -> float:
        """Time step of the gas [s]."""
        return self.coupling / self.gas_steps
