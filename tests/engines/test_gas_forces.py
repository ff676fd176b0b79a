"""The exchange between particles and gas cells, without a solver: geometry, momentum, drag laws."""

from __future__ import annotations

import gas_columns as columns
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kncal.core.errors import InputError, RunError
from kncal.engines.dpmfoam.case import check_setup
from kncal.engines.dpmfoam.forces import Exchange, Parcels, satellite_offsets
from kncal.engines.dpmfoam.grid import Grid
from kncal.physics.drag import DRAGS
from kncal.record.steps import GasStep
from kncal.scene.gas import Jet


@given(st.integers(1, 9), st.integers(1, 4), st.integers(1, 7), st.integers(0, 8), st.integers(1, 9), st.booleans())
def test_a_cell_centre_lies_in_its_own_cell(nx: int, ny: int, nz: int, low: int, high: int, jet: bool) -> None:
    low, high = min(low, nx - 1), min(max(high, low + 1), nx)
    h = 1e-3
    slot = Jet(x_low=low * h, x_high=max(high, low + 1) * h, velocity=1.0) if jet else None
    grid = Grid(columns.setup((nx, ny, nz), h, jet=slot, inlet=0.0))
    assert sorted(grid.labels.ravel()) == list(range(nx * ny * nz))
    k, j, i = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
    centres = (np.stack([i, j, k], axis=-1).reshape(-1, 3) + 0.5) * h
    x, cell = grid.locate(centres)
    assert np.array_equal(x, centres)
    assert np.array_equal(cell, grid.labels.ravel())
    values = np.arange(grid.count, dtype=float)
    assert np.array_equal(grid.to_field(values).ravel(), values[cell])
    if not jet:
        assert np.array_equal(grid.labels, i + nx * (j + ny * k))


@given(st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3))
def test_a_point_is_inside_the_cell_that_is_named(fractions: list[float]) -> None:
    setup = columns.setup((7, 3, 11))
    grid = Grid(setup)
    x, cell = grid.locate(np.array([fractions]) * grid.size)
    k, j, i = (int(index[0]) for index in np.nonzero(grid.labels == cell[0]))
    low = np.array([i, j, k]) * grid.h
    assert (x[0] >= low - 1e-12).all() and (x[0] <= low + grid.h + 1e-12).all()
    assert (x[0] > 0.0).all() and (x[0] < grid.size).all()


def test_periodic_depth_wraps_and_a_layer_stays_in_its_plane() -> None:
    x = np.array([[4e-3, -1e-3, 7e-3], [4e-3, 5e-3, 7e-3]])
    inside, cell = Grid(columns.setup((5, 2, 15), front_back="periodic")).locate(x)
    assert inside[0] == pytest.approx(inside[1], rel=1e-12) and cell[0] == cell[1]
    layer = Grid(columns.setup((5, 1, 15), front_back="layer"))
    inside, _ = layer.locate(np.array([[4e-3, 1.7e-3, 7e-3]]))
    assert inside[0, 1] == 1.5e-3


@pytest.mark.parametrize("bad", [[-1e-4, 1e-3, 1e-3], [1e-3, 6.1e-3, 1e-3], [1e-3, 1e-3, np.nan]])
def test_particles_outside_the_column_are_named(bad: list[float]) -> None:
    x = np.array([[1e-3, 1e-3, 1e-3], bad])
    with pytest.raises(RunError, match=r"1 of 2 particles .* particle 2 at"):
        Exchange(columns.setup()).parcels(x, 0 * x, *columns.alike(x))


@pytest.mark.parametrize("count", [1, 8, 27])
def test_satellites_have_the_moments_of_the_sphere(count: int) -> None:
    offsets = satellite_offsets(count)
    assert offsets.shape == (count, 3)
    assert np.linalg.norm(offsets, axis=1).max() < 0.5  # in diameters: inside the sphere
    assert np.abs(offsets.mean(axis=0)).max() < 1e-16
    if count > 1:  # the second moment of a solid sphere: R²/5 on each axis, no mixed ones
        assert offsets.T @ offsets / count == pytest.approx(np.eye(3) * 0.25 / 5.0, abs=1e-15)


@pytest.mark.parametrize("count", [1, 8, 27])
def test_parcels_carry_the_mass_and_cannot_reach_a_wall(count: int) -> None:
    setup = columns.setup(parcels_per_particle=count)
    rng = np.random.default_rng(2)
    x = rng.uniform(0.0, 1.0, (300, 3)) * setup.size
    v = rng.normal(0.0, 2.0, x.shape)
    diameter, density = rng.uniform(0.5e-3, 2e-3, 300), rng.uniform(500.0, 3000.0, 300)
    parcels = Exchange(setup).parcels(x, v, diameter, density)
    particle = np.arange(len(parcels.x)) // setup.parcels_per_particle
    mass = np.bincount(particle, parcels.weight * parcels.density * parcels.diameter**3)
    assert mass == pytest.approx(density * diameter**3, rel=1e-14)
    for end in (parcels.x, parcels.x + setup.step * parcels.v):
        assert (end > 0.0).all() and (end < setup.size).all()
    free = np.linalg.norm(parcels.x - x[particle], axis=1)
    assert (free <= 0.5 * diameter[particle] + setup.step * 10.0 + 1e-5).all()


def finished(
    exchange: Exchange, parcels: Parcels, seed: int, lose: float = 0.0
) -> tuple[GasStep, dict[str, np.ndarray]]:
    """A made-up gas step that books what its parcels gained, but for ``lose`` [kg m/s] in each direction."""
    rng, cells = np.random.default_rng(seed), exchange.grid.count
    v_new = parcels.v + rng.normal(0.0, 0.1, parcels.v.shape)
    mass = parcels.weight * parcels.density * np.pi / 6.0 * parcels.diameter**3
    gain = mass[:, None] * (v_new - parcels.v)
    U_trans = np.stack([np.bincount(parcels.cell, -column, cells) for column in gain.T], axis=1)
    U_trans[0] += lose
    U_coeff = np.bincount(parcels.cell, rng.uniform(0.0, 1e-9, len(mass)), cells)
    U, U_before = rng.normal(0.0, 1.0, (cells, 3)), np.array(exchange.U_old)
    solids = np.bincount(parcels.cell, mass / parcels.density, cells) / exchange.grid.volume
    p = rng.normal(0.0, 1.0, cells)
    step = exchange.finish(parcels, v_new, U, 1.0 - solids, p, U_trans, U_coeff, 7.0)
    return step, {"U_trans": U_trans, "rest": U_coeff[:, None] * (U - U_before), "U": U, "p": p}


@given(st.integers(0, 2**31), st.sampled_from([1, 8, 27]), st.sampled_from(["ErgunWenYu", "PlessisMasliyah"]))
def test_momentum_given_is_momentum_taken(seed: int, count: int, drag: str) -> None:
    setup = columns.setup(parcels_per_particle=count, drag=drag)
    rng = np.random.default_rng(seed)
    x = columns.packing(setup.size)[::5]
    v = rng.normal(0.0, 1.0, x.shape)
    exchange = Exchange(setup)
    step, gas = finished(exchange, exchange.parcels(x, v, *columns.alike(x)), seed)
    buoyancy = len(x) * columns.VOLUME * columns.RHO_G * columns.G
    taken = (gas["U_trans"] - gas["rest"]).sum(axis=0) / setup.step
    scale = np.abs(gas["U_trans"]).sum() / setup.step
    assert step.force.sum(axis=0) + taken == pytest.approx([0.0, 0.0, buoyancy], abs=1e-12 * scale)
    assert step.reaction_error < 1e-12 * scale and step.not_passed < 1e-12 * scale
    assert step.solids_error < 1e-12
    assert step.p_in == pytest.approx(7.0 * columns.RHO_G, rel=1e-15)
    assert np.array_equal(exchange.U_old, gas["U"])
    assert exchange.fields().p[3, 1, 2] == pytest.approx(columns.RHO_G * gas["p"][2 + 5 * (1 + 2 * 3)], rel=1e-15)


def test_momentum_that_gets_lost_is_reported() -> None:
    setup = columns.setup()
    x = columns.packing(setup.size)[::5]
    exchange = Exchange(setup)
    step, _ = finished(exchange, exchange.parcels(x, 0 * x, *columns.alike(x)), 0, lose=1e-9)
    assert step.reaction_error == pytest.approx(np.sqrt(3.0) * 1e-9 / setup.step, rel=1e-6)
    # Gas coefficients where no particle is: nobody can be given the remainder.
    one = x[:1]
    parcels = exchange.parcels(one, 0 * one, *columns.alike(one))
    zeros, cells = np.zeros((exchange.grid.count, 3)), exchange.grid.count
    coeff = np.zeros(cells)
    coeff[parcels.cell[0] + 1] = 2e-9
    U = exchange.U_old + np.array([0.0, 0.0, 0.5])
    step = exchange.finish(parcels, parcels.v, U, np.ones(cells), zeros[:, 0], zeros, coeff, 0.0)
    assert step.not_passed == pytest.approx(2e-9 * 0.5 / setup.step, rel=1e-12)
    assert step.solids_error == 1.0


def test_a_diverged_gas_is_refused() -> None:
    exchange = Exchange(columns.setup())
    x = columns.packing(exchange.setup.size)[:3]
    parcels = exchange.parcels(x, 0 * x, *columns.alike(x))
    cells = exchange.grid.count
    U = np.full((cells, 3), np.nan)
    with pytest.raises(RunError, match="U that are not finite"):
        exchange.finish(parcels, parcels.v, U, np.ones(cells), np.zeros(cells), 0 * U, np.zeros(cells), 0.0)


@given(st.floats(0.35, 0.79), st.floats(0.0, 5.0))
def test_dense_drag_is_ergun(eps: float, U_0: float) -> None:
    # Force balance of a homogeneous bed: the pressure gradient carries all particles' drag, and model B's includes it.
    beta = float(DRAGS["ErgunWenYu"].per_slip(np.array(eps), np.array(U_0 / eps), np.array(columns.D), 1.2, 1.8e-5))
    ergun = 150.0 * (1 - eps) ** 2 * 1.8e-5 * U_0 / (eps**3 * columns.D**2)
    ergun += 1.75 * (1 - eps) * 1.2 * U_0**2 / (eps**3 * columns.D)
    assert (1.0 - eps) * beta * U_0 / eps == pytest.approx(ergun, rel=1e-12)


def test_limits_of_the_drag_laws() -> None:
    d, still = np.array(columns.D), np.array(0.0)
    stokes = 18.0 * columns.MU / columns.D**2
    assert DRAGS["ErgunWenYu"].per_slip(np.array(1.0), still, d, 1.2, columns.MU) == pytest.approx(stokes, rel=1e-12)
    # Published as A = 180 to 207 and B = 1.8 to 1.9 for packed grains, against Ergun's 150 and 1.75
    eps = np.array(0.42)
    unit = columns.MU / (0.42 * columns.D**2)
    A = DRAGS["PlessisMasliyah"].per_slip(eps, still, d, 1.2, columns.MU) / unit * 0.42 / 0.58
    assert 175.0 < A < 210.0
    fast = np.array(1e7)
    B = DRAGS["PlessisMasliyah"].per_slip(eps, fast, d, 1.2, columns.MU) / unit / (1.2 * 1e7 * columns.D / columns.MU)
    assert 1.7 < B < 1.95
    assert np.isfinite(DRAGS["PlessisMasliyah"].per_slip(np.array(1.0), np.array(1.0), d, 1.2, columns.MU))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"density": -1.0}, "density"),
        ({"viscosity": float("nan")}, "viscosity"),
        ({"step": 0.0}, "step"),
        ({"size": (0.1, 0.0, 0.1)}, "size"),
        ({"cells": (5, 2, 0)}, "cells"),
        ({"cells": (5, 2.0, 3)}, "cells"),
        ({"front_back": "layer"}, "one cell in y"),
        ({"front_back": "open"}, "front_back"),
        ({"drag": 'ErgunWenYu { } libs ("x.so"); y'}, "drag"),
        ({"walls": "wet"}, "walls"),
        ({"parcels_per_particle": 4}, "parcels_per_particle"),
        ({"jet": Jet(x_low=1e-3, x_high=6e-3, velocity=1.0), "inlet": 0.0}, "on cell faces"),
        ({"jet": Jet(x_low=6e-3, x_high=6e-3, velocity=1.0), "inlet": 0.0}, "on cell faces"),
        ({"jet": Jet(x_low=3e-3, x_high=18e-3, velocity=1.0), "inlet": 0.0}, "on cell faces"),
        ({"jet": Jet(x_low=3e-3, x_high=6e-3, velocity=1.0)}, "inlet"),
    ],
)
def test_impossible_set_ups_are_refused(changes: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        check_setup(columns.setup(**changes))
