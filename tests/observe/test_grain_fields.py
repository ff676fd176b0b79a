"""Coarse-grained fields and free surfaces against ideal ones."""

from __future__ import annotations

import numpy as np
import pytest
from seen_grains import D, grains

from kncal.core.errors import InputError
from kncal.observe.coarse_graining import grid_for, local_temperature, profile
from kncal.observe.grains import Space
from kncal.observe.mixing import cells_of
from kncal.observe.surface import angles_of_parts, cone_fit, parts_of_cone, parts_of_slope, slope_fit

BOX = Space(low=(0.0, 0.0, 0.0), high=(0.06, 0.02, 0.05), periodic=(False, True, False), up=(0.0, 0.0, 1.0))


def uniform(rng, n, low, high):
    return rng.uniform(low, high, (n, 3))


@pytest.mark.parametrize("periodic", [(False, False, False), (True, False, True)])
@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_the_integral_of_the_density_is_the_mass(periodic, dimensions):
    rng = np.random.default_rng(1)
    at, mass = rng.uniform(-0.01, 0.07, (500, dimensions)), rng.uniform(1.0, 2.0, (500, 2))  # some are outside
    grid = grid_for([0.0] * dimensions, [0.06] * dimensions, periodic[:dimensions], 3e-3)
    field = grid.spread(at, mass)
    total = field.reshape(-1, 2).sum(axis=0) * grid.cell
    assert total == pytest.approx(mass.sum(axis=0), rel=1e-12)


def test_the_kernel_has_the_width_that_is_stated():
    rng = np.random.default_rng(2)
    grid, width = grid_for([0.0], [0.06], [False], 2e-3), 2e-3
    at = rng.uniform(0.029, 0.031, (4000, 1))  # phases within cells
    (x,), density = grid.centres, grid.spread(at, np.ones((4000, 1)))[:, 0] * grid.cell / 4000
    mean = (x * density).sum()
    variance = ((x - mean) ** 2 * density).sum() - at.var()
    # a Gaussian that is cut off at 3 has 0.9733 of its variance
    assert np.sqrt(variance) == pytest.approx(width * np.sqrt(0.9733), rel=0.02)


def test_a_linear_shear_has_its_rate_and_no_temperature():
    rate = 12.0

    def frames():
        local = np.random.default_rng(4)
        for k in range(20):
            x = uniform(local, 1500, BOX.low, BOX.high)
            v = np.zeros_like(x)
            v[:, 0] = rate * x[:, 2]
            yield grains(x, v, t=0.1 * k)

    found = profile(frames, BOX, 2, 2.0 * D)
    inner = (found.at > 0.014) & (found.at < 0.036)
    assert found.shear_rate[inner, 0] == pytest.approx(rate, rel=0.05)
    assert found.shear_rate[inner, 0].mean() == pytest.approx(rate, rel=0.005)
    assert found.shear_rate[inner, 1:] == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(found.shear_rate[0]).all() and np.isnan(found.temperature[0])
    # what the shear would add without the place of each particle: (rate w)²/3
    assert found.temperature[inner].max() < 0.02 * (rate * 2.0 * D) ** 2 / 3.0
    assert found.density.sum() * (found.at[1] - found.at[0]) == pytest.approx(1500 * grains(np.zeros((1, 3))).mass[0])


def test_temperature_is_the_variance_per_direction_also_in_a_shear():
    def frames():
        rng = np.random.default_rng(5)
        for k in range(30):
            x = uniform(rng, 1000, BOX.low, BOX.high)
            v = rng.normal(0.0, 0.02, x.shape)
            v[:, 0] += 3.0 * x[:, 2]
            yield grains(x, v, t=0.1 * k)

    found = profile(frames, BOX, 2, 2.0 * D)
    inner = (found.at > 0.014) & (found.at < 0.036)
    assert found.temperature[inner].mean() == pytest.approx(0.02**2, rel=0.03)
    half = found.spread[inner, 0]  # 95 % intervals of the mean velocity hold the true one nearly always
    assert (np.abs(found.velocity[inner, 0] - 3.0 * found.at[inner]) < 2.0 * half).mean() > 0.9


def test_the_local_temperature_is_free_of_flow_and_of_bias():
    rng = np.random.default_rng(15)
    x = uniform(rng, 4000, BOX.low, BOX.high)
    turning = np.cross([0.0, 30.0, 0.0], x) + 5.0 * x[:, [2]] * [1.0, 0.0, 0.0] + [0.1, 0.2, 0.3]
    cell = cells_of(x, 25)
    assert local_temperature(x, turning, cell) < 1e-20
    found = [local_temperature(x, turning + rng.normal(0.0, 0.02, x.shape), cell) for _ in range(20)]
    assert np.mean(found) == pytest.approx(0.02**2, abs=4.0 * np.std(found) / np.sqrt(20))
    layer = x * [1.0, 0.0, 1.0]
    flat = [
        local_temperature(layer, rng.normal(0.0, 0.02, x.shape) * [1, 0, 1], cells_of(layer, 25), 2) for _ in range(20)
    ]
    assert np.mean(flat) == pytest.approx(0.02**2, abs=4.0 * np.std(flat) / np.sqrt(20))
    with pytest.raises(InputError, match="four"):
        local_temperature(x[:4], x[:4], np.zeros(4, dtype=np.int64))


def test_a_grid_says_what_it_cannot_be():
    with pytest.raises(InputError, match="cells"):
        grid_for([0.0] * 3, [1.0] * 3, [False] * 3, 1e-3)
    with pytest.raises(InputError, match="positive"):
        grid_for([0.0], [1.0], [False], 0.0)


def slope(rng, angle, axis=1, n=6000):
    """Particles at random, below a plane at an angle, with some that roll and fly above it."""
    x = uniform(rng, n, BOX.low, BOX.high)
    below = x[x[:, 2] < 0.025 + np.tan(np.radians(angle)) * (x[:, 0] - 0.03)]
    flying = uniform(rng, 60, BOX.low, BOX.high)
    return np.concatenate([below, flying])


@pytest.mark.parametrize("angle", [0.0, 5.0, 25.0, 35.0])
def test_a_plane_slope_has_its_angle_whatever_flies_above_it(angle):
    rng = np.random.default_rng(int(angle) + 6)
    found = []
    for _ in range(12):
        fit = slope_fit(grains(slope(rng, angle)), BOX, 1, D)
        found.append(np.degrees(np.arctan(fit.slope * fit.across[0])))
    error = np.std(found, ddof=1) / np.sqrt(12)
    assert error < 0.6
    assert np.mean(found) == pytest.approx(angle, abs=3.5 * error + 0.2)


def test_the_roughness_of_one_surface_tells_how_well_its_angle_is_known():
    hits = 0
    for seed in range(40):
        fit = slope_fit(grains(slope(np.random.default_rng(100 + seed), 25.0)), BOX, 1, D)
        hits += abs(fit.angle - 25.0) <= fit.error
        assert fit.error < 5.0
    assert hits >= 33, "95 % less three standard deviations"


def test_the_surface_of_a_tilted_scene_is_measured_against_gravity():
    rng, tilt = np.random.default_rng(7), np.radians(12.0)
    x = slope(rng, 0.0)
    box = Space(low=BOX.low, high=BOX.high, periodic=BOX.periodic, up=(float(np.sin(tilt)), 0.0, float(np.cos(tilt))))
    assert slope_fit(grains(x), box, 1, D).angle == pytest.approx(12.0, abs=0.7)
    with pytest.raises(InputError, match="gravity"):
        slope_fit(grains(x), BOX, 2, D)


@pytest.mark.parametrize("angle", [20.0, 32.0])
def test_a_cone_has_its_angle_and_its_sectors_agree(angle):
    rng = np.random.default_rng(8)
    box = Space(low=(-0.05, -0.05, 0.0), high=(0.05, 0.05, 0.05), periodic=(False,) * 3, up=(0.0, 0.0, 1.0))
    tangent, means, truth = np.tan(np.radians(angle)), [], []
    for _ in range(6):
        x = uniform(rng, 40_000, box.low, box.high)
        r = np.hypot(x[:, 0] - 0.004, x[:, 1])
        heap = grains(np.concatenate([x[x[:, 2] < tangent * (0.035 - r)], uniform(rng, 40, box.low, box.high)]))
        centre = (0.004, 0.0, 0.0)
        truth.append(cone_fit(heap, box, centre, D).angle)
        parts = angles_of_parts(lambda g, c=centre: cone_fit(g, box, c, D), heap, parts_of_cone(heap, box, centre))
        assert len(parts) == 6
        means.append(parts.mean())
    assert np.mean(truth) == pytest.approx(angle, abs=0.6)
    assert np.mean(means) == pytest.approx(angle, abs=0.8)


def test_slices_share_out_all_particles_and_are_thick_enough():
    heap = grains(slope(np.random.default_rng(9), 25.0))
    masks = parts_of_slope(heap, BOX, 1, 4.0 * D)
    assert len(masks) == 2 and (np.sum(masks, axis=0) == 1).all()
    assert len(parts_of_slope(heap, BOX, 1, 1.0)) == 1


def test_nothing_has_no_surface():
    with pytest.raises(InputError):
        slope_fit(grains(np.zeros((0, 3))), BOX, 1, D)
    with pytest.raises(InputError, match="columns"):
        slope_fit(grains(np.full((3, 3), 0.01)), BOX, 1, D)
