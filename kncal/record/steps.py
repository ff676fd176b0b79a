"""What gas and particles say of one coupling interval.

Row order: every particle array has one row for each particle that will ever be there, always the same one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array

#: Momentum booked on particles and on the gas may differ by this share of the bed's weight: rounding only.
REACTION_LIMIT = 1e-10
#: Momentum that the gas received and no particle was given, as a share of the weight.
NOT_PASSED_LIMIT = 1e-3


@dataclass(frozen=True, kw_only=True)
class GasStep:
    """What one gas step did.

    Attributes
    ----------
    force : (n, 3) force of the gas on each particle, buoyancy included [N]
    p_in : area mean of the gauge pressure at the inlet patch (jet: the jet patch) [Pa]
    reaction_error : |sum of the drag booked on particles + that booked on the gas| [N], rounding only
    not_passed : |momentum per time that the gas received and no particle was given| [N]
    solids_error : relative difference of the solid volume in the void fraction field to that of the particles [-]
    eps_g_min : smallest void fraction [-]
    courant_max : largest Courant number U dt/h of the step [-]
    """

    force: Array
    p_in: float
    reaction_error: float
    not_passed: float
    solids_error: float
    eps_g_min: float
    courant_max: float


@dataclass(frozen=True, kw_only=True)
class GasFields:
    """Gas fields after the last step; cells in the order x fastest, then y, then z.

    Attributes
    ----------
    eps_g : (nz, ny, nx) void fraction; p : (nz, ny, nx) gauge pressure [Pa]; U : (nz, ny, nx, 3) [m/s]
    """

    eps_g: Array
    p: Array
    U: Array


class ParticleState(NamedTuple):
    """All particles at one time; NaN in the rows of those that are not there: not yet inserted, or gone.

    Attributes
    ----------
    x, v, spin : (n, 3) [m], [m/s], [rad/s]; periodic coordinates within the domain
    kind : (n,) number of each one's species, -1 for those that are not there
    """

    x: Array
    v: Array
    spin: Array
    kind: NDArray[np.int64]

    @classmethod
    def at_rest(cls, x: Array) -> ParticleState:
        """Return particles at rest at ``x`` (n, 3) [m], all of the first species."""
        return cls(x, np.zeros_like(x), np.zeros_like(x), np.zeros(len(x), dtype=np.int64))


@dataclass(frozen=True, kw_only=True)
class DemStep:
    """Contacts during one coupling interval, and what passed outlets until its end.

    Pairs are those of `kncal.record.facts.BedFacts.pairs`; walls, outlets and heights are those of its lists.

    Attributes
    ----------
    floor_force : force of the particles on the floor, time mean over the interval [N], positive downwards; NaN for a
        scene that has none
    other_walls_force : likewise on all other walls; what the momentum balance of the particles leaves for them, NaN
        where particles come or go
    contacts : number of particle-particle contacts (mean over the samples)
    overlap_max, overlap_mean : over the interval's samples of all particle-particle contacts [m]
    histogram : (bins,) counts of overlaps, summed over the samples; edges in `Dem.histogram_edges`
    watched : time in which new contacts were watched for [s]
    impacts : (pairs, bins) counts of the impact speeds of new contacts, by pair of species; edges in
        `Dem.impact_edges`
    impact_sums : (pairs, 3) sums over the same impacts of v [m/s], v² and v³
    out_number, out_mass : (outlets,) number and mass [kg] of the particles that passed each since the start
    wall_force : (walls, heights, 3) force of the particles on each wall, by height, at the end of the interval [N]
    """

    floor_force: float
    other_walls_force: float
    contacts: float
    overlap_max: float
    overlap_mean: float
    histogram: Array
    watched: float
    impacts: Array
    impact_sums: Array
    out_number: Array
    out_mass: Array
    wall_force: Array
