"""The force of the gas on each particle, from what one step of DPMFoam did to its parcels.

DPMFoam moves the parcels, computes void fraction and drag from them, and steps the gas. The force on particle p in
cell c is then (one gas step of length dt per exchange)

    F_p = m_p (U_after - U_before)/dt  +  w_p R_c  +  V_p rho_g g (upwards)
    R_c = UCoeff_c (U_new - U_old)_c/dt

* The first term is what the drag did to the parcel. DPMFoam books its negative as the gas source UTrans, so action and
  reaction are equal by construction.
* DPMFoam linearises the gas source, UTrans + UCoeff (U_old - U_new); the second part goes to the particles of the cell
  in proportion to their drag coefficients, which are the parts of UCoeff.
* The gas equation of DPMFoam carries the full weight of the gas and the full pressure gradient (Gidaspow's model B),
  and its drag laws contain the pressure gradient force of the flow; what is missing is the buoyancy by the gas's own
  weight.

A particle may be several parcels inside its sphere, each with its share of the volume: a smoother void fraction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import RunError
from kncal.engines.base import GasSetup
from kncal.engines.dpmfoam.grid import Grid, Labels
from kncal.physics.drag import DRAGS
from kncal.record.steps import GasFields, GasStep


@dataclass(frozen=True, kw_only=True)
class Parcels:
    """What goes to the solver; the parcels of particle i are the rows i k … i k + k - 1, k = parcels per particle.

    Attributes
    ----------
    x, v : (N, 3) positions just inside the mesh [m], velocities [m/s]
    cell : (N,) the solver's cell labels
    diameter, density : (N,) of the whole particle [m], [kg/m³]
    weight : (N,) particles per parcel, 1/k [-]
    """

    x: Array
    v: Array
    cell: Labels
    diameter: Array
    density: Array
    weight: Array


class Exchange:
    """Parcels from particles before a gas step, forces on particles after it. Keeps the gas velocity in between.

    Attributes
    ----------
    grid : Grid
    U_old : (cells, 3) gas velocity before the coming step [m/s], in the solver's order; set it when a state is loaded
    """

    def __init__(self, setup: GasSetup) -> None:
        self.setup = setup
        self.grid = Grid(setup)
        self.U_old: Array = np.zeros((self.grid.count, 3))
        self.U_old[:, 2] = setup.inlet
        self._offsets = satellite_offsets(setup.parcels_per_particle)
        # Of the last step; a field in its grid is made only where one is asked for.
        self._eps_g: Array | None = None
        self._p: Array | None = None

    def parcels(self, x: Array, v: Array, diameter: Array, density: Array) -> Parcels:
        """Make the parcels of particles at ``x`` [m] with ``v`` [m/s] (n, 3), ``diameter`` [m], ``density`` (n,).

        Raises
        ------
        RunError
            If a particle's centre is outside the column.
        """
        self.grid.check_inside(x)
        k = len(self._offsets)
        if k > 1:
            satellites = np.tile(self._offsets, (len(x), 1))
            x, v, diameter, density = (np.repeat(array, k, axis=0) for array in (x, v, diameter, density))
            x = x + satellites * diameter[:, None]
        x_inside, cell = self.grid.locate(self._away_from_walls(x, v))
        return Parcels(
            x=x_inside,
            v=v,
            cell=cell,
            diameter=diameter,
            density=density,
            weight=np.full(len(x), 1.0 / k),
        )

    def finish(
        self,
        parcels: Parcels,
        v_new_by_parcel: Array,
        U: Array,
        eps_g: Array,
        p: Array,
        U_trans: Array,
        U_coeff: Array,
        p_in: float,
    ) -> GasStep:
        """Turn the result of a gas step into forces, and keep its fields.

        Parameters
        ----------
        parcels : Parcels
            As given to the solver.
        v_new_by_parcel : (N, 3)
            Velocities after the step, in the parcels' order [m/s].
        U, eps_g, p, U_trans, U_coeff : (cells, 3), (cells,), (cells,), (cells, 3), (cells,)
            Of the solver, in its cell order; p kinematic [m²/s²], U_trans [kg m/s], U_coeff [kg]. The first three are
            kept as they are, not copied.
        p_in : float
            Area mean of the kinematic pressure at the inlet patch [m²/s²].

        Raises
        ------
        RunError
            If the solver returned values that are not finite.
        """
        for name, values in (("U", U), ("p", p), ("eps_g", eps_g), ("parcel velocities", v_new_by_parcel)):
            if not np.isfinite(values).all():
                raise RunError(
                    f"DPMFoam returned {name} that are not finite: the gas flow diverged; shorten the step",
                    "not-finite",
                )
        setup, grid, dt = self.setup, self.grid, self.setup.step
        k = setup.parcels_per_particle
        parcel_volume = np.pi / 6.0 * parcels.weight * parcels.diameter**3
        # From here on one row for x, one for y, one for z: numpy is several times quicker along long rows.
        drag = (parcels.density * parcel_volume / dt) * _rows(v_new_by_parcel - parcels.v)
        rest = (U_coeff / dt) * _rows(U - self.U_old)
        shared = self._share(parcels, eps_g) * rest.take(parcels.cell, axis=1)
        given = drag + shared
        volume = parcel_volume
        if k > 1:  # the parcels of a particle are neighbours
            given, volume = given.reshape(3, -1, k).sum(axis=2), volume.reshape(-1, k).sum(axis=1)
        given[2] += volume * setup.density * setup.gravity
        solids, field_solids = float(volume.sum()), float((1.0 - eps_g).sum()) * grid.volume
        reaction = drag.sum(axis=1) + _rows(U_trans).sum(axis=1) / dt
        not_passed = rest.sum(axis=1) - shared.sum(axis=1)
        if setup.front_back == "layer":  # nothing moves out of the plane, not even by rounding
            given[1] = reaction[1] = not_passed[1] = 0.0
        self.U_old, self._eps_g, self._p = U, eps_g, p
        return GasStep(
            force=np.stack(tuple(given), axis=1),
            p_in=float(setup.density * p_in),
            reaction_error=float(np.linalg.norm(reaction)),
            not_passed=float(np.linalg.norm(not_passed)),
            solids_error=abs(field_solids - solids) / solids if solids else field_solids / (grid.count * grid.volume),
            eps_g_min=float(eps_g.min()),
            courant_max=float((np.abs(_rows(U)) / grid.h[:, None]).sum(axis=0).max() * dt),
        )

    def fields(self) -> GasFields:
        """Return the fields of the last finished step.

        Raises
        ------
        RunError
            If there was none.
        """
        if self._eps_g is None or self._p is None:
            raise RunError("there are no gas fields before the first gas step")
        field = self.grid.to_field
        return GasFields(eps_g=field(self._eps_g), p=field(self.setup.density * self._p), U=field(self.U_old))

    def _away_from_walls(self, x: Array, v: Array) -> Array:
        """Shift parcels that would reach the boundary in this step.

        One that did would bounce, and its change of velocity would not be the drag alone; at an open patch it would
        be lost. The shift is at most the way of one step, which must be short against a cell in any case.
        """
        low, high = self.grid.limits()
        columns = []
        for axis in range(3):
            at = x[:, axis]
            if not (axis == 1 and self.setup.front_back == "periodic"):
                way = v[:, axis] * self.setup.step
                at = np.clip(at, low[axis] - np.minimum(way, 0.0), high[axis] - np.maximum(way, 0.0))
            columns.append(at)
        return np.stack(columns, axis=1)

    def _share(self, parcels: Parcels, eps_g: Array) -> Array:
        """Return each parcel's part of the drag coefficient of its cell (N,), sum 1 over a cell.

        As the solver found it: with the gas velocity before the step.
        """
        setup, cell = self.setup, parcels.cell
        if not len(cell):
            return np.zeros(0)
        x, y, z = _rows(self.U_old).take(cell, axis=1) - _rows(parcels.v)
        slip = np.sqrt(x * x + y * y + z * z)
        d = parcels.diameter
        per_slip = DRAGS[setup.drag].per_slip
        b = parcels.weight * d**3 * per_slip(eps_g.take(cell), slip, d, setup.density, setup.viscosity)
        share: Array = b / np.bincount(cell, b, self.grid.count).take(cell)
        return share


def _rows(vectors: Array) -> Array:
    """Return (n, 3) vectors as (3, n) contiguous rows."""
    return np.ascontiguousarray(vectors.T)


def satellite_offsets(count: int) -> Array:
    """Return the offsets (count, 3) of a particle's parcels from its centre, in diameters: 1, 8 or 27, on a cube.

    Their spread is that of the solid sphere, sum of x²/count = d²/20 on each axis, so the void fraction they make has
    the right second moment; all lie inside the sphere.
    """
    side = round(count ** (1.0 / 3.0))
    steps = np.arange(side) - 0.5 * (side - 1)
    mean_square = float((steps**2).mean())
    line = steps * np.sqrt(0.05 / mean_square) if mean_square else steps
    return np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
