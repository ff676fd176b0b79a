"""Averages against processes whose answers are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bed_runs import correlated, integrated
from hypothesis import given, settings
from hypothesis import strategies as st

from kncal.core.errors import InputError
from kncal.physics.statistics import (
    average,
    average_of_samples,
    correlation_samples,
    needed_length,
    start_up,
)


def times(n: int, step: float = 1e-3) -> np.ndarray:
    return step * np.arange(1, n + 1)


@pytest.mark.parametrize("tau", [0.5, 5.0, 30.0])
def test_correlation_time_of_ar1(tau: float):
    found = np.mean([correlation_samples(correlated(20_000, tau, seed)) for seed in range(10)])
    assert found == pytest.approx(integrated(tau), rel=0.1)


@pytest.mark.parametrize(("tau", "n", "least"), [(1.0, 500, 0.93), (10.0, 2000, 0.93), (20.0, 400, 0.90)])
def test_intervals_cover_the_truth_as_often_as_they_promise(tau: float, n: int, least: float):
    """95 % promised; 1000 seeds scatter by 0.7 %; the last run has 10 independent samples only, and says so."""
    covered = []
    for seed in range(1000):
        found = average(times(n), correlated(n, tau, seed), discard=0.0)
        covered.append(abs(found.mean) <= found.uncertainty)
    assert least <= np.mean(covered) <= 0.99


def test_standard_error_is_that_of_the_correlated_mean():
    """Var(mean) = 2 tau sigma²/n of a long AR(1); independent samples would give a tenth of it."""
    tau, n = 5.0, 5000
    expected = math.sqrt(2.0 * integrated(tau) / n)
    found = [average(times(n), correlated(n, tau, seed), discard=0.0) for seed in range(100)]
    assert np.mean([a.standard_error for a in found]) == pytest.approx(expected, rel=0.08)
    assert np.median([a.n_effective for a in found]) == pytest.approx(n / (2.0 * integrated(tau)), rel=0.25)
    assert np.median([a.correlation_time for a in found]) == pytest.approx(1e-3 * integrated(tau), rel=0.25)


def test_a_slow_component_under_a_fast_oscillation_is_seen():
    """The windowed autocorrelation of an oscillation ends at its first lobe; the batches must see the rest.

    The slow component has 10 independent samples only, so less than 95 % may be covered, but not much.
    """
    n = 6000
    t = times(n)
    assert correlation_samples(np.sin(2.0 * np.pi * t / 0.03) + 0.5 * correlated(n, 300.0, 0)) < 100.0
    covered = 0
    for seed in range(400):
        y = np.sin(2.0 * np.pi * t / 0.03 + seed) + 0.5 * correlated(n, 300.0, seed)
        found = average(t, y, discard=0.0)
        covered += abs(found.mean) <= found.uncertainty
    assert covered >= 0.87 * 400


def test_white_noise_counts_every_sample():
    y = np.random.default_rng(3).normal(size=4000)
    found = average(times(4000), y, discard=0.0)
    assert found.n_effective > 1500
    assert found.reliable
    assert found.length == pytest.approx(4.0)


@settings(max_examples=30)
@given(scale=st.floats(1e-6, 1e6), shift=st.floats(-1e3, 1e3), step=st.floats(1e-6, 10.0))
def test_units_do_not_matter(scale: float, shift: float, step: float):
    y = correlated(600, 4.0, 1)
    plain, scaled = average(times(600), y), average(times(600, step), scale * (y + shift))
    assert scaled.mean == pytest.approx(scale * (plain.mean + shift), rel=1e-6, abs=1e-9 * scale)
    assert scaled.uncertainty == pytest.approx(scale * plain.uncertainty, rel=1e-3)
    assert scaled.correlation_time == pytest.approx(plain.correlation_time * step / 1e-3, rel=1e-3)
    assert scaled.discarded == pytest.approx(plain.discarded * step / 1e-3)


def test_start_up_is_found_and_left_out():
    n = 4000
    for seed in range(20):
        y = correlated(n, 5.0, seed) + 20.0 * np.exp(-np.arange(n) / 150.0)
        first = start_up(y)
        assert 300 < first < n // 2  # at 300 the transient is still 2.7 standard deviations
        found = average(times(n), y)
        assert found.discarded == pytest.approx(1e-3 * (first + 1))
        assert abs(found.mean) < 3.0 * found.uncertainty
        with_it = average(times(n), y, discard=0.0)
        assert with_it.mean > 0.6  # the transient's area: 20*150/4000 = 0.75


def test_without_a_start_up_little_is_left_out():
    left_out = [start_up(correlated(4000, 5.0, seed)) / 4000 for seed in range(40)]
    assert np.median(left_out) < 0.1


def test_smooth_tail_is_not_cut_off_without_end():
    """exp(-i/100): a noise-free approach is over when it is below the thousandth, not at half of the run."""
    first = start_up(1.0 + np.exp(-np.arange(5000) / 100.0))
    assert 500 < first < 1500


def test_drift_and_shortness_are_unreliable():
    drifting = average(times(2000), np.linspace(0.0, 1.0, 2000) + 0.1 * correlated(2000, 1.0, 1), discard=0.0)
    assert not drifting.reliable
    assert "drift" in drifting.why
    short = average(times(200), correlated(200, 30.0, 1), discard=0.0)
    assert not short.reliable
    assert "independent samples" in short.why
    endless = average(times(1000), np.exp(-np.arange(1000) / 800.0) + 1e-3 * correlated(1000, 1.0, 1))
    assert not endless.reliable
    assert "start-up" in endless.why


def test_constant_signals_have_no_error():
    found = average(times(50), np.full(50, 7.0))
    assert (found.mean, found.uncertainty, found.discarded, found.reliable) == (7.0, 0.0, 0.0, True)
    settled = average(times(50), 7.0 + 1e-8 * np.exp(-np.arange(50.0)))
    assert 0.0 <= settled.uncertainty <= 1e-8
    assert settled.reliable


def test_whole_periods_leave_an_error_of_nearly_nothing_but_finite_numbers():
    found = average(times(1600), np.sin(2.0 * np.pi * np.arange(1600) / 100.0), discard=0.0)
    assert abs(found.mean) < 1e-12
    assert 0.0 < found.uncertainty < 0.01
    assert math.isfinite(found.n_effective)


def test_needed_length_gives_the_precision_it_predicts():
    ratios = []
    for seed in range(20):
        pilot = average(times(4000), correlated(4000, 4.0, seed), discard=0.0)
        precision = 0.5 * pilot.uncertainty
        n = round(needed_length(pilot, precision) / 1e-3)
        longer = average(times(n), correlated(n, 4.0, 1000 + seed), discard=0.0)
        ratios.append(longer.uncertainty / precision)
    assert np.median(ratios) == pytest.approx(1.0, abs=0.2)


def test_independent_samples():
    rng = np.random.default_rng(1)
    covered = 0
    for _ in range(300):
        found = average_of_samples(rng.normal(5.0, 2.0, size=6))
        covered += abs(found.mean - 5.0) <= found.uncertainty
    assert 0.91 <= covered / 300 <= 0.985
    assert not average_of_samples([1.0, 2.0]).reliable
    with pytest.raises(InputError, match="at least 2"):
        average_of_samples([1.0])


@pytest.mark.parametrize(
    ("t", "y", "discard", "message"),
    [
        (np.arange(20.0), np.zeros(19), None, "shapes"),
        (np.arange(5.0), np.zeros(5), None, "at least 10"),
        (np.arange(20.0) ** 2, np.zeros(20), None, "evenly spaced"),
        (-np.arange(20.0), np.zeros(20), None, "evenly spaced"),
        (np.arange(20.0), np.full(20, np.nan), None, "finite"),
        (np.arange(20.0), np.zeros(20), 15.0, "leaves 5 of 20"),
    ],
)
def test_refusals(t, y, discard, message):
    with pytest.raises(InputError, match=message):
        average(t, y, discard)


def test_refuses_a_precision_of_nothing():
    with pytest.raises(InputError, match="precision"):
        needed_length(average(times(100), correlated(100, 1.0, 1)), 0.0)
    with pytest.raises(InputError, match="not over time"):
        needed_length(average_of_samples([1.0, 2.0, 4.0]), 0.1)
