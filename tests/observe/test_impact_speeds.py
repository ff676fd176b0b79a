"""Statistics of impact speeds: intervals that cover, closed forms, what is not there."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from bed_runs import correlated, facts, series

from kncal.core.errors import InputError
from kncal.engines.liggghts.impacts import count_speeds, speed_edges
from kncal.observe.impact_speeds import (
    bed_impact_speeds,
    contact_impact_speeds,
    enduring,
    histogram_quantiles,
    stiffness_at,
)
from kncal.physics.material import Material, pair
from kncal.record.series import BedSeries
from kncal.report.speeds import plot_impact_speeds
from kncal.scene.contact import ContactChoice
from kncal.scene.contact_event import ContactEvent
from kncal.scene.pair_contact import PairNumbers

RECORDED = facts(impact_edges=tuple(speed_edges()))
#: Of p(v) = v/(2 s²) exp(-v²/(4 s²)) with s = 0.1 m/s: mean, E v³/E v², 99th percentile.
S = 0.1
TRUTH = {
    "mean": math.sqrt(math.pi) * S,
    "energy_weighted": 1.5 * math.sqrt(math.pi) * S,
    "p99": 2.0 * S * math.sqrt(math.log(100.0)),
}


def gas(seed: int, couplings: int = 600, rate: float = 20.0, memory: float = 0.0) -> BedSeries:
    """A made-up bed whose particles meet as in a gas; with ``memory`` the gas is hot and busy by turns of so many."""
    rng = np.random.default_rng(seed)
    heat = np.exp(0.15 * correlated(couplings, memory, seed)) if memory else np.ones(couplings)
    impacts, sums = np.zeros((couplings, 2, RECORDED.impact_bins)), np.zeros((couplings, 2, 3))
    for k in range(couplings):
        v = rng.rayleigh(math.sqrt(2.0) * S * heat[k], rng.poisson(rate * heat[k]))
        impacts[k, 0] = count_speeds(v)
        sums[k, 0] = [(v**p).sum() for p in (1, 2, 3)]
    return series(
        RECORDED,
        couplings,
        watched=np.full(couplings, 1e-5),
        impacts=impacts.astype(np.int32),
        impact_sums=sums,
        contacts=np.full(couplings, rate / 1e-5 * 2e-4),
    )


@pytest.mark.slow
@pytest.mark.parametrize("memory", [0.0, 8.0])
def test_intervals_cover_the_truth(memory: float) -> None:
    """Of 60 runs at least 50: fewer happens once in 10 000 times with 95 %, and once in 40 with 90 %."""
    runs = 60
    truth = dict(TRUTH)
    if memory:  # E over heat h = exp(0.15 g): weighted by the rate, which goes with h
        mean = [math.exp(0.5 * (0.15 * p) ** 2) for p in range(5)]
        truth = {
            "mean": TRUTH["mean"] * mean[2] / mean[1],
            "energy_weighted": TRUTH["energy_weighted"] * mean[4] / mean[3],
        }
    covered = dict.fromkeys(truth, 0)
    for seed in range(runs):
        found = bed_impact_speeds(gas(seed, 1200, memory=memory), 0.0)["particles"]
        for name, value in truth.items():
            estimate = found.speeds[name]
            covered[name] += estimate.low <= value <= estimate.high
            assert estimate.low <= estimate.value <= estimate.high
    assert min(covered.values()) >= 50, covered


def test_what_comes_before_the_start_does_not_count() -> None:
    hot, cold = gas(0, 300), gas(1, 300)
    joined = series(
        RECORDED,
        600,
        watched=np.concatenate([hot.watched, cold.watched]),
        impacts=np.concatenate([hot.impacts[:, ::-1], cold.impacts]),
        impact_sums=np.concatenate([hot.impact_sums[:, ::-1], cold.impact_sums]),
    )
    late = bed_impact_speeds(joined, 0.3005)
    assert late["walls"].count == 0
    assert late["walls"].speeds == {}
    assert late["particles"].count == cold.impacts.sum()


def test_few_impacts_are_said_to_be_few() -> None:
    found = bed_impact_speeds(gas(0, 40, rate=1.0), 0.0)["particles"]
    assert "impacts were seen" in found.speeds["mean"].why
    assert "1000 are needed" in found.speeds["p99"].why
    doubtful = bed_impact_speeds(gas(0), 0.0, "the bed still rises")["particles"]
    assert {estimate.why for estimate in doubtful.speeds.values()} == {"the bed still rises"}


def test_without_a_record_it_says_so() -> None:
    with pytest.raises(InputError, match="not recorded"):
        bed_impact_speeds(series(facts(), 50), 0.0)


def test_contacts_that_last_as_long_as_impacts_are_all_explained_by_them() -> None:
    """Little's law: as many contacts as begin in t_c, on average."""
    bed = gas(3)
    binary = enduring(bed, 0.0, 2e-4)
    assert binary is not None
    error = 4.0 / math.sqrt(bed.impacts.sum())
    assert binary.duration == pytest.approx(1.0, abs=error)
    assert binary.share == pytest.approx(0.0, abs=error)
    lasting = enduring(bed, 0.0, 2e-5)
    assert lasting is not None
    assert lasting.duration == pytest.approx(10.0, rel=error)
    assert lasting.share == pytest.approx(0.9, abs=error)
    assert enduring(series(RECORDED, 20), 0.0, 1e-4) is None


def bounces(v: float, e: float, number: int) -> tuple[ContactEvent, ...]:
    return tuple(
        ContactEvent(
            pair=("ball", "floor"), t_start=0.1 * k, t_c=1e-5, delta_max=1e-6, delta_mean=1e-6, v_in=v * e**k,
            v_out=v * e ** (k + 1), e_n=e, complete=True,
        )
        for k in range(number)
    )  # fmt: skip


def test_single_contacts_are_averaged_as_they_are() -> None:
    found = contact_impact_speeds(bounces(2.0, 0.5, 3))
    assert found.count == 3
    assert found.speeds["mean"].value == pytest.approx(2.0 * (1.75 / 3))
    assert found.speeds["energy_weighted"].value == pytest.approx(2.0 * (1.0 + 1 / 8 + 1 / 64) / (1.0 + 1 / 4 + 1 / 16))
    assert found.speeds["mean"].uncertainty == 0.0
    assert found.counts.sum() == 3
    assert contact_impact_speeds(()).speeds == {}


def test_stiffness_follows_the_speed_by_its_power() -> None:
    found = bed_impact_speeds(gas(0), 0.0)["particles"]
    glass = pair(Material(young=70e9, poisson=0.22, density=2500.0), 1e-3)
    rows = stiffness_at(found, ContactChoice(), glass, PairNumbers(0.9, 0.0, None, None))
    first = rows[0].k_n
    assert first is not None
    for row in rows:
        assert row.k_n is not None
        for end in ("value", "low", "high"):
            ratio = getattr(row.v_0, end) / rows[0].v_0.value
            assert getattr(row.k_n, end) == pytest.approx(first.value * ratio**0.4, rel=1e-9)


def test_an_overlap_beyond_the_radius_is_told_not_hidden() -> None:
    found = bed_impact_speeds(gas(0), 0.0)["particles"]
    jelly = pair(Material(young=1e3, poisson=0.3, density=1e6), 1e-3)
    rows = stiffness_at(found, ContactChoice(), jelly, PairNumbers(0.9, 0.0, None, None))
    assert [row.k_n for row in rows if row.problem] == [None] * sum(bool(row.problem) for row in rows)
    assert rows[-1].problem


def test_quantiles_of_a_histogram() -> None:
    """Exact at the edges, in all of an exponential distribution but its last bin, and of one bin."""
    edges, counts = np.array([0.0, 1.0, 2.0, 4.0]), np.array([1.0, 0.0, 3.0])
    assert histogram_quantiles(edges, counts, np.array([0.0, 0.25, 0.625, 1.0])) == pytest.approx([0.0, 1.0, 3.0, 4.0])
    wide = np.array([0.0, 0.5, 2.0, 3.0, 9.0])
    above = np.exp(-wide)
    above[-1] = 0.0
    shares = np.array([0.1, 0.5, 0.8, 0.94])
    assert histogram_quantiles(wide, -np.diff(above), shares) == pytest.approx(-np.log1p(-shares))


def test_the_picture_is_drawn(tmp_path: Path) -> None:
    speeds = bed_impact_speeds(gas(0, 50), 0.0)
    for name in ("speeds.png", "speeds.svg"):
        plot_impact_speeds(speeds, tmp_path / name, "a gas")
        assert (tmp_path / name).stat().st_size > 5000
    with pytest.raises(InputError, match=r"\.png or \.svg"):
        plot_impact_speeds(speeds, tmp_path / "speeds.jpg")
    with pytest.raises(InputError, match="no impact"):
        plot_impact_speeds({}, tmp_path / "none.png")
