"""Observables of made-up beds: forces, heights, fluctuations, spectrum and overlaps that are known beforehand."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from bed_runs import EDGES, bubbling, correlated, disc_fraction, facts, series
from hypothesis import given, settings
from hypothesis import strategies as st

from kncal.core.errors import InputError
from kncal.observe.averages import observe_bed, voidage_difference
from kncal.observe.fields import (
    cell_index,
    mean_voidage,
    pressure_heights,
    solids_fields,
    velocity_profile,
    voidage_heights,
)
from kncal.observe.signals import overlap_statistics, pressure_spectrum


@pytest.fixture(scope="module")
def bed():
    return bubbling(facts(), 1)


def balanced(of, couplings: int, momentum, drag, floor, walls):
    """A run whose inlet pressure carries what the gas gives to the particles, and the gas itself."""
    gas_weight = of.gas_density * of.gravity * (np.prod(of.size) - of.count * np.pi / 6.0 * of.diameter**3)
    p_in = (drag + gas_weight) / (of.size[0] * of.size[1])
    return series(of, couplings, momentum_z=momentum, drag_z=drag, floor=floor, walls=walls, p_in=p_in)


def test_free_fall_closes():
    """No force of gas or floor: the momentum of the particles falls by their weight."""
    of = facts()
    t, nothing = np.arange(1, 101) * of.coupling, np.zeros(100)
    found = observe_bed(balanced(of, 100, -of.weight * t, nothing, nothing, nothing), 0.0)
    assert found.estimates["weight_closure"].value == pytest.approx(0.0, abs=1e-12)
    assert found.estimates["weight_balance"].value == pytest.approx(0.0, abs=1e-12)


def test_a_fixed_bed_stands_on_gas_floor_and_walls():
    of = facts()
    part = of.weight * np.ones(50)
    run = balanced(of, 50, 0.0 * part, 0.7 * part, 0.2 * part, 0.1 * part)
    found = observe_bed(run, 0.0).estimates
    assert found["weight_balance"].value == pytest.approx(1.0)
    assert found["floor_share"].value == pytest.approx(0.2)
    assert found["weight_closure"].value == pytest.approx(0.0, abs=1e-12)
    jet = observe_bed(replace(run, facts=replace(of, jet=True)), 0.0).estimates["weight_closure"]
    assert jet.value is None
    assert "jet" in jet.why


@settings(max_examples=25)
@given(first=st.integers(1, 80), seed=st.integers(0, 1000))
def test_the_balance_closes_over_any_window_of_any_motion(first: int, seed: int):
    of = facts()
    rng = np.random.default_rng(seed)
    gas, floor, walls = rng.normal(size=(3, 200)) * of.weight
    momentum = np.cumsum(gas + floor + walls - of.weight) * of.coupling
    run = balanced(of, 200, momentum, gas, floor, walls)
    assert abs(observe_bed(run, run.t[first]).estimates["weight_closure"].value) < 1e-10


def test_a_lost_force_shows_in_the_closure(bed):
    assert abs(observe_bed(bed, 0.5).estimates["weight_closure"].value) < 1e-12
    damaged = observe_bed(replace(bed, p_in=bed.p_in - 0.03 * bed.facts.weight / bed.facts.floor_area), 1.0)
    assert damaged.estimates["weight_closure"].value == pytest.approx(-0.03, rel=0.01)


def test_balance_refusals(bed):
    for changed, reason in (
        (replace(bed, facts=replace(bed.facts, gravity=0.0)), "no weight"),
        (replace(bed, floor=np.full(4000, np.nan)), "not move|frozen"),
    ):
        seen = observe_bed(changed, 0.0)
        found = seen.estimates.get("weight_balance")
        assert re.search(reason, seen.why_not("weight_balance") if found is None else found.why)


@pytest.mark.parametrize("frequency", [2.0, 3.3, 7.7])
def test_dominant_frequency_of_a_noisy_oscillation(frequency: float):
    of = facts()
    t = np.arange(1, 6001) * of.coupling
    p = 500.0 + 3.0 * t + 20.0 * np.sin(2.0 * np.pi * frequency * t) + 10.0 * correlated(6000, 5.0, 1)
    found = pressure_spectrum(series(of, 6000, p_in=p), 1.0)
    assert found.dominant == pytest.approx(frequency, abs=0.3 * found.resolution)
    # Parseval: the area under the density is the variance about the trend
    area = found.density.sum() * found.resolution
    assert area == pytest.approx(20.0**2 / 2.0 + 10.0**2, rel=0.15)


def test_spectrum_refusals(bed):
    with pytest.raises(InputError, match="at least 64"):
        pressure_spectrum(bed, 3.99)
    with pytest.raises(InputError, match="constant"):
        pressure_spectrum(series(facts(), 100, p_in=np.full(100, 3.0)), 0.0)


def test_overlaps_of_known_distribution():
    """Exponential overlaps of mean 5 µm."""
    mean, rng = 5e-6, np.random.default_rng(0)
    overlaps = rng.exponential(mean, size=(200, 500)).clip(max=9.9e-5)
    run = series(
        facts(),
        200,
        overlap_mean=overlaps.mean(axis=1),
        overlap_max=overlaps.max(axis=1),
        contacts=np.full(200, 500.0),
        histogram=np.stack([np.histogram(row, bins=EDGES)[0] for row in overlaps]),
    )
    found = overlap_statistics(run, 0.0)
    assert found.counted == 100_000
    assert found.mean == pytest.approx(overlaps.mean())
    assert found.max == overlaps.max()
    half = overlap_statistics(run, run.t[100])
    assert half.counted == 50_000


def test_no_contacts_are_no_statistics():
    with pytest.raises(InputError, match="no contact"):
        overlap_statistics(series(facts(), 20), 0.0)


def test_granular_temperature_is_that_of_the_fluctuations_alone():
    """Gaussian velocities of variance theta per direction on a shear flow with one velocity per cell."""
    of = facts(count=20_000, cells=(6, 2, 6), size=(0.06, 0.02, 0.06))
    rng = np.random.default_rng(5)
    theta = 0.04
    x = rng.random((3, of.count, 3)) * of.size
    flow = np.floor(x[..., 0] / 0.01)
    v = rng.normal(scale=np.sqrt(theta), size=x.shape)
    v[..., 2] += flow
    found = solids_fields(series(of, 3, x=x, v=v))
    assert found.frames == 3
    assert found.count.sum() == pytest.approx(of.count)
    np.testing.assert_allclose(found.theta_frames, theta, rtol=0.03)
    np.testing.assert_allclose(found.theta, theta, rtol=0.15)
    np.testing.assert_allclose(found.velocity[..., 2], np.broadcast_to(np.arange(6.0), (6, 2, 6)), atol=0.05)
    x_profile, v_z = velocity_profile(found, of, 0.03)
    np.testing.assert_allclose(x_profile, 0.005 + 0.01 * np.arange(6))
    np.testing.assert_allclose(v_z, np.arange(6.0), atol=0.05)


def test_a_layer_has_two_directions_to_fluctuate_in():
    of = facts(count=20_000, cells=(6, 1, 6), front_back="layer")
    rng = np.random.default_rng(6)
    x = rng.random((1, of.count, 3)) * of.size
    v = rng.normal(scale=0.1, size=x.shape) * [1.0, 0.0, 1.0]
    assert solids_fields(series(of, 1, x=x, v=v)).theta_frames[0] == pytest.approx(0.01, rel=0.03)


def test_pairs_have_no_bias():
    """Two particles per cell: without n/(n - 1) half of the fluctuation would be missing."""
    of = facts(count=20_000, cells=(100, 1, 100))
    rng = np.random.default_rng(7)
    at = np.repeat(np.arange(10_000), 2)
    x = np.stack([(at % 100 + 0.5) * 6e-4, np.full(20_000, 5e-3), (at // 100 + 0.5) * 1.2e-3], axis=1)
    v = rng.normal(scale=0.1, size=x.shape)
    assert solids_fields(series(of, 1, x=x[None], v=v[None])).theta_frames[0] == pytest.approx(0.01, rel=0.03)


def test_empty_cells_are_not_a_number_and_lone_particles_have_no_temperature():
    of = facts(count=1, cells=(2, 1, 2))
    found = solids_fields(series(of, 1, x=np.full((1, 1, 3), 1e-3), v=np.full((1, 1, 3), 2.0)))
    assert np.isnan(found.theta).all()
    assert found.velocity[0, 0, 0, 2] == 2.0
    assert np.isnan(found.velocity[1]).all()
    assert np.isnan(velocity_profile(found, of, 0.1)[1]).all()
    with pytest.raises(InputError, match="column"):
        velocity_profile(found, of, 0.12)


def test_cells_are_numbered_x_first_and_periodic_depth_wraps():
    of = facts(cells=(2, 3, 4), size=(2.0, 3.0, 4.0))
    centres = [(i + 0.5, j + 0.5, k + 0.5) for k in range(4) for j in range(3) for i in range(2)]
    np.testing.assert_array_equal(cell_index(of, np.array(centres)), np.arange(24))
    outside = np.array([[0.5, -0.5, 0.5]])
    assert cell_index(of, outside)[0] == 0
    assert cell_index(replace(of, front_back="periodic"), outside)[0] == 4


@pytest.mark.parametrize("height", [0.031, 0.05, 0.0777])
def test_heights_of_a_bed_with_a_sharp_surface(height: float):
    """The surface lies inside a cell: the voidage crosses 0.8 within half a cell of it; the pressure line is exact."""
    of = facts()
    cell = of.size[2] / of.cells[2]
    bottom = np.arange(of.cells[2]) * cell
    z = bottom + 0.5 * cell
    solids = 0.55 * np.clip((height - bottom) / cell, 0.0, 1.0)
    shape = (1, of.cells[2], 1, of.cells[0])
    eps_g = np.broadcast_to((1.0 - solids)[None, :, None, None], shape)
    static = of.gas_density * of.gravity * (of.size[2] - z)
    p = np.broadcast_to((static + 400.0 * np.maximum(1.0 - z / height, 0.0))[None, :, None, None], shape)
    run = series(of, 1, eps_g=eps_g, p=p, x=np.zeros((1, of.count, 3)))
    assert voidage_heights(run)[0] == pytest.approx(height, abs=0.5 * cell)
    assert pressure_heights(run)[0] == pytest.approx(height, rel=1e-4)


def test_heights_of_nothing_and_of_a_full_column():
    of = facts()
    shape = (1, of.cells[2], 1, of.cells[0])
    empty = series(of, 1, eps_g=np.ones(shape), p=np.zeros(shape))
    assert voidage_heights(empty)[0] == 0.0
    assert np.isnan(pressure_heights(empty)[0])
    assert voidage_heights(series(of, 1, eps_g=np.full(shape, 0.4)))[0] == of.size[2]


def test_mean_voidage_is_over_the_frames_after_the_start_up():
    of = facts()
    shape = (of.cells[2], 1, of.cells[0])
    eps_g = np.stack([np.full(shape, value) for value in (0.9, 0.4, 0.6)])
    run = series(of, 30, every=10, eps_g=eps_g)
    np.testing.assert_allclose(mean_voidage(run, 0.02), 0.5)
    with pytest.raises(InputError, match="no frame"):
        mean_voidage(run, 0.04)
    with pytest.raises(InputError, match="no gas fields"):
        mean_voidage(series(facts(gas_density=0.0), 3, x=np.zeros((3, 500, 3))))


def test_all_of_a_bubbling_bed(bed):
    found = observe_bed(bed)
    # the floor force starts at 0.38 of the weight and falls with a time constant of 0.15 s
    assert 0.3 < found.begin < 1.5
    assert found.window.by == "floor"
    assert not [name for name, each in found.estimates.items() if each.value is None]
    near = {
        "z_mean": 0.03,
        "z_95": 0.057,
        "bed_height": 0.06,
        "height_pressure": 0.06,
        "kinetic_energy": 1e-4,
        "overlap_mean": 5e-6,
        "granular_temperature": 0.0025,
        "bubble_number": 1.0,
        "bubble_diameter": 0.016,
        "bubble_velocity": 0.2,
        "bubble_share": np.pi * 0.008**2 / (0.06 * 0.06),
        "contacts": 50.0,
        "floor_share": 0.08,
        "dominant_frequency": 3.0,
    }
    for name, value in near.items():
        assert found.estimates[name].value == pytest.approx(value, rel=0.05), name
    assert found.estimates["overlap_max"].value == bed.overlap_max[bed.t >= found.begin].max()
    assert abs(found.estimates["weight_closure"].value) < 1e-12


def test_a_given_start_up_is_taken(bed):
    found = observe_bed(bed, discard=2.0)
    assert (found.begin, found.window.by) == (2.0, "given")
    assert found.estimates["z_mean"].average.discarded == pytest.approx(2.0)
    assert found.estimates["bed_height"].average.length == pytest.approx(2.0, abs=0.05)
    with pytest.raises(InputError, match="run longer"):
        observe_bed(bed, discard=3.995)


def test_what_is_not_there_is_missing_with_a_reason():
    of = facts(gas_density=0.0)
    t = np.arange(1, 201) * of.coupling
    dry = observe_bed(series(of, 200, z_mean=0.03 + 0.001 * correlated(200, 2.0, 1), floor=np.full(200, of.weight)))
    assert dry.estimates["pressure_drop"].why == "no gas"
    assert "no contact" in dry.estimates["overlap_max"].why
    assert dry.get("bubbles") is None
    assert dry.estimates["floor_share"].value == pytest.approx(1.0)
    nothing = np.full(200, np.nan)
    frozen = series(facts(), 200, floor=nothing, walls=nothing, contacts=nothing, overlap_mean=nothing, p_in=t)
    still = observe_bed(frozen, discard=0.0)
    assert "floor_share" not in still.estimates
    assert "frozen" in still.why_not("floor_share")
    assert still.estimates["pressure_drop"].value is not None
    quiet = observe_bed(series(facts(), 200, every=10, eps_g=np.full((20, 48, 1, 24), 0.4)), discard=0.0)
    assert quiet.estimates["bubble_number"].value == 0.0
    assert quiet.estimates["bubble_velocity"].why.startswith("0 bubbles")


def test_an_endless_start_up_makes_everything_unreliable():
    t = np.arange(1, 2001) * 1e-3
    run = series(facts(), 2000, z_mean=0.03 * np.exp(-t / 2.0) + 1e-5 * correlated(2000, 2.0, 1))
    found = observe_bed(run)
    assert found.window.by == "z_mean"
    assert not any(each.reliable for each in found.estimates.values() if each.value is not None)
    assert "start-up of z_mean" in found.estimates["kinetic_energy"].why


def test_a_changing_gas_velocity_has_no_averages(bed):
    """They would be over different states, however small their uncertainty."""
    ramp = replace(bed, U_0=np.linspace(0.2, 0.8, 4000))
    found = observe_bed(ramp, discard=1.0)
    assert found.kind == "ramp"
    assert {name for name, each in found.estimates.items() if each.average} <= {"overlap_max", "weight_closure"}
    assert "different states" in found.why_not("pressure_drop")
    assert observe_bed(ramp).begin == 0.0  # nothing is a start-up, or all of it
    steady = replace(bed, U_0=np.minimum(ramp.U_0, ramp.U_0[999]))  # reached at 1 s
    assert observe_bed(steady, discard=1.0).estimates["pressure_drop"].reliable


def test_noise_has_no_dominant_frequency():
    noise = series(facts(), 6000, p_in=500.0 + np.random.default_rng(2).normal(size=6000))
    found = observe_bed(noise, discard=0.0)
    assert found.estimates["dominant_frequency"].value is None
    assert "no peak" in found.estimates["dominant_frequency"].why
    t = noise.t
    tone = replace(noise, p_in=noise.p_in + 3.0 * np.sin(2.0 * np.pi * 4.0 * t))
    assert observe_bed(tone, discard=0.0).estimates["dominant_frequency"].reliable


def test_frames_out_of_rhythm_are_not_averaged(bed):
    moved = bed.frame_coupling.copy()
    moved[-1] -= 7
    odd = observe_bed(replace(bed, frame_coupling=moved, t_frame=moved * 1e-3), discard=1.0)
    assert odd.estimates["bed_height"].average.length == pytest.approx(3.0, abs=0.03)


def test_voidage_fields_of_equal_beds_differ_by_sampling_alone():
    of = facts()
    rng = np.random.default_rng(1)
    noise = 0.1 * rng.normal(size=(2, 100, of.cells[2], 1, of.cells[0]))
    a, b = (series(of, 100, eps_g=0.5 + part) for part in noise)
    rms, expected = voidage_difference(a, b, 0.0, 0.0)
    assert expected == pytest.approx(0.1 * np.sqrt(2.0 / 100.0), rel=0.1)
    assert rms == pytest.approx(expected, rel=0.15)
    raised = replace(b, eps_g=b.eps_g + np.float32(0.1) * disc_fraction(of, (0.03, 0.06), 0.02).astype(np.float32))
    more, same = voidage_difference(a, raised, 0.0, 0.0)
    share = np.mean(disc_fraction(of, (0.03, 0.06), 0.02) ** 2)
    assert more == pytest.approx(np.hypot(rms, 0.1 * np.sqrt(share)), rel=0.05)
    assert same == pytest.approx(expected, rel=1e-4)
    with pytest.raises(InputError, match="same grid"):
        voidage_difference(a, series(facts(cells=(2, 1, 2)), 3), 0.0, 0.0)
