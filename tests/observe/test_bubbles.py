"""Made-up bubbles of known place, size and speed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from bed_runs import disc_fraction, facts, series
from hypothesis import given, settings
from hypothesis import strategies as st

from kncal.core.errors import InputError
from kncal.observe.bubbles import MIN_CELLS, Bubbles, find_bubbles, follow

FINE = facts(cells=(60, 1, 120))  # cells of 1 mm
BED = 0.45


def frames(of, discs, surface: float = 0.1) -> np.ndarray:
    """(frames, nz, ny, nx) void fraction; discs[frame] is a list of (x, z, radius)."""
    z = (np.arange(of.cells[2]) + 0.5) * of.size[2] / of.cells[2]
    background = np.where(z < surface, BED, 1.0)[:, None, None] * np.ones((1, of.cells[1], of.cells[0]))
    fields = []
    for frame in discs:
        solid = background
        for x, height, radius in frame:
            solid = np.maximum(solid, BED + (1.0 - BED) * disc_fraction(of, (x, height), radius))
        fields.append(solid)
    return np.stack(fields)


def bubbles_of(of, discs, every: int = 10, **options) -> Bubbles:
    fields = frames(of, discs)
    return find_bubbles(series(of, every * len(discs), every=every, eps_g=fields), **options)


@settings(max_examples=25)
@given(x=st.floats(0.02, 0.04), z=st.floats(0.02, 0.08), radius=st.floats(0.006, 0.012))
def test_place_and_diameter_of_a_disc(x: float, z: float, radius: float):
    """The threshold 0.7 counts cells that are filled by more than 0.45: half a cell at most is lost or won."""
    found = bubbles_of(FINE, [[(x, z, radius)]])
    assert len(found.frame) == 1
    np.testing.assert_allclose(found.centre[0], [x, 0.005, z], atol=3e-4)
    assert found.diameter[0] == pytest.approx(2.0 * radius, rel=0.05)
    assert found.volume[0] == pytest.approx(math.pi * radius**2 * 0.01, rel=0.1)
    assert not found.at_floor[0]


def test_a_sphere_inside_a_deep_bed_has_the_diameter_of_a_sphere():
    of = facts(size=(0.04, 0.04, 0.06), cells=(40, 40, 60))
    x, y, z = ((np.arange(n) + 0.5) * 1e-3 for n in of.cells)
    r = np.sqrt((x[None, None, :] - 0.02) ** 2 + (y[None, :, None] - 0.02) ** 2 + (z[:, None, None] - 0.03) ** 2)
    found = find_bubbles(series(of, 1, eps_g=np.where(r < 0.008, 1.0, BED)[None]))
    assert found.diameter[0] == pytest.approx(0.016, rel=0.02)
    np.testing.assert_allclose(found.centre[0], [0.02, 0.02, 0.03], atol=1e-6)


@pytest.mark.parametrize("speed", [0.1, 0.3, 0.55])
def test_rise_velocity(speed: float):
    steps = min(20, int(0.07 / (speed * 0.01)))
    discs = [[(0.03, 0.015 + speed * 0.01 * k, 0.008)] for k in range(steps)]
    found = bubbles_of(FINE, discs)
    assert len(np.unique(found.track)) == 1
    tracks = follow(found)
    assert tracks.frames[0] == steps
    assert tracks.velocity[0] == pytest.approx(speed, rel=0.03)
    assert tracks.diameter[0] == pytest.approx(0.016, rel=0.03)
    assert tracks.height[0] == pytest.approx(0.015 + 0.5 * speed * 0.01 * (steps - 1), abs=3e-4)


def test_two_bubbles_keep_their_names_while_one_passes_the_other():
    discs = [[(0.015, 0.02 + 0.004 * k, 0.008), (0.045, 0.04 + 0.001 * k, 0.005)] for k in range(15)]
    tracks = follow(bubbles_of(FINE, discs))
    order = np.argsort(tracks.velocity)
    np.testing.assert_allclose(tracks.velocity[order], [0.1, 0.4], rtol=0.05)
    np.testing.assert_allclose(tracks.diameter[order], [0.010, 0.016], rtol=0.05)


def test_what_merges_ends_its_tracks():
    """Two equal bubbles become one of twice the volume: no track goes on through it with a jump of its centre."""
    apart = [[(0.022, 0.03, 0.006), (0.038, 0.03, 0.006)]] * 4
    merged = [[(0.030, 0.034, 0.006 * math.sqrt(2.2))]] * 4
    found = bubbles_of(FINE, apart + merged)
    assert len(np.unique(found.track)) == 3


def test_the_freeboard_and_what_opens_into_it_are_no_bubbles():
    found = bubbles_of(FINE, [[(0.03, 0.097, 0.008)], [(0.03, 0.05, 0.008)], []])
    np.testing.assert_array_equal(found.number, [0.0, 1.0, 0.0])
    np.testing.assert_array_equal(found.frame, [1])


def test_what_hangs_on_the_floor_is_marked_and_not_counted():
    found = bubbles_of(FINE, [[(0.03, 0.004, 0.008)], [(0.03, 0.015, 0.008)], [(0.03, 0.018, 0.008)]])
    np.testing.assert_array_equal(found.at_floor, [True, False, False])
    np.testing.assert_array_equal(found.number, [0.0, 1.0, 1.0])
    assert found.total_volume[0] == 0.0
    assert not len(follow(found).velocity)  # two frames off the floor are too few


def test_noise_of_single_cells_is_left_out():
    fields = frames(FINE, [[]])
    fields[0, 50, 0, 20] = 0.9
    fields[0, 60, 0, 30 : 30 + MIN_CELLS] = 0.9
    found = find_bubbles(series(FINE, 1, eps_g=fields))
    assert len(found.frame) == 1
    assert found.volume[0] == pytest.approx(MIN_CELLS * 1e-3 * 0.01 * 1e-3)


def test_a_bubble_across_the_periodic_boundary_is_one():
    """Four layers in depth; the bubble fills the first and the last, its centre lies on the boundary."""
    of = facts(cells=(30, 4, 60), front_back="periodic")
    fields = frames(of, [[], []])
    fields[:, 20:26, 0, 10:16] = 1.0
    fields[:, 20:26, 3, 10:16] = 1.0
    periodic = find_bubbles(series(of, 2, eps_g=fields))
    np.testing.assert_array_equal(periodic.frame, [0, 1])
    np.testing.assert_allclose(periodic.centre[:, 1] % 0.01, 0.0, atol=1e-9)
    assert periodic.volume[0] == pytest.approx(2 * 36 * 2e-3 * 2e-3 * 2.5e-3)
    assert len(np.unique(periodic.track)) == 1
    walls = find_bubbles(series(replace(of, front_back="walls"), 2, eps_g=fields))
    assert len(walls.frame) == 4


def test_through_the_periodic_boundary_into_the_freeboard():
    of = facts(cells=(30, 4, 60), front_back="periodic")
    fields = frames(of, [[]])
    fields[0, 20:, 0, 10:16] = 1.0  # a channel to the freeboard in the first layer
    fields[0, 20:26, 3, 10:16] = 1.0  # meets it only through the boundary
    assert not len(find_bubbles(series(of, 1, eps_g=fields)).frame)
    assert len(find_bubbles(series(replace(of, front_back="walls"), 1, eps_g=fields)).frame) == 1


def test_a_higher_threshold_finds_smaller_bubbles():
    soft = np.zeros((1, 120, 1, 60))
    x, z = (np.arange(60) + 0.5) * 1e-3, (np.arange(120) + 0.5) * 1e-3
    soft[0, :, 0, :] = BED + 0.55 * np.exp(-((x[None] - 0.03) ** 2 + (z[:, None] - 0.05) ** 2) / 0.01**2)
    soft[0, 110:] = 1.0
    sizes = [find_bubbles(series(FINE, 1, eps_g=soft), threshold=level).diameter[0] for level in (0.6, 0.7, 0.9)]
    expected = [2.0 * 0.01 * math.sqrt(-math.log((level - BED) / 0.55)) for level in (0.6, 0.7, 0.9)]
    np.testing.assert_allclose(sizes, expected, rtol=0.05)


def test_a_bed_without_bubbles_and_refusals():
    found = bubbles_of(FINE, [[], []])
    assert not len(found.frame)
    assert not len(follow(found).velocity)
    with pytest.raises(InputError, match="threshold"):
        bubbles_of(FINE, [[]], threshold=1.5)
    with pytest.raises(InputError, match="void fraction"):
        find_bubbles(series(facts(gas_density=0.0), 1, x=np.zeros((1, 500, 3))))
