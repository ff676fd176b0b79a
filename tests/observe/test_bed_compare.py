"""Comparisons of beds: known differences are found, equal beds are not called different, short runs decide nothing."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from compared_beds import COUPLING, MEANS, SCENE, SPREAD, TAU, ar1, run_data
from hypothesis import given
from hypothesis import strategies as st

from kncal.core.errors import InputError, RunError
from kncal.core.files import write_json
from kncal.observe.compare import Comparison, compare
from kncal.observe.difference import field_difference
from kncal.observe.estimate import Estimate, apart, averaged, decide
from kncal.observe.row import Row, judge
from kncal.physics.statistics import Average, average

pytestmark = pytest.mark.slow


def side(seed: int, mean: float = 10.0, length: float = 40.0, tau: float = TAU) -> Estimate:
    n = round(length / COUPLING)
    t = COUPLING * np.arange(1, n + 1)
    values = mean + ar1(np.random.default_rng(seed), n, tau)
    return averaged(average(t, values, 0.0), 0.0, float(t[-1]))


def known(mean: float, uncertainty: float, reliable: bool = True, length: float = 4.0) -> Estimate:
    found = Average(
        mean=mean,
        uncertainty=uncertainty,
        standard_error=uncertainty / 2.13,  # 16 batches
        std=1.0,
        n_effective=100.0 if reliable else 5.0,
        correlation_time=0.02,
        length=length,
        discarded=0.0,
        reliable=reliable,
        why="" if reliable else "only 5 independent samples",
    )
    return averaged(found, 0.0, length)


def between(a: Estimate, b: Estimate, tolerance: float | None = None) -> Row:
    """Two averages, judged relative to the second."""
    scale = abs(b.value)
    found = apart(a, b, scale, ("linear", "hertz"))
    row = Row(metric="z_mean", unit="m", text="", run=a, reference=b, difference=found, scale=scale, basis="relative")
    return judge(row, tolerance)


def fields(rms: float, noise: float, tolerance: float | None) -> Row:
    return judge(field_difference("eps_g", rms, noise, 4.0), tolerance)


@pytest.fixture(scope="module")
def different() -> Comparison:
    """Equal beds but for the overlap, which is 25 % larger in the linear run."""
    linear = run_data("linear", 1, length=8.0, means={"overlap_mean": 1.25 * MEANS["overlap_mean"]}, tau=0.02)
    return compare(
        linear, run_data("hertz", 2, length=8.0, tau=0.02, cpu=(36.0, 5.0, 1.0)), {"z_mean": 0.05, "overlap_mean": 0.1}
    )


def test_a_known_difference_is_found_with_its_size(different):
    row = different.row("overlap_mean")
    assert row.difference.significant
    assert row.verdict == "outside"
    # twice the 95 % half-width: 1 in 10,000
    assert row.difference.value == pytest.approx(0.25, abs=2.0 * row.difference.width)
    assert different.row("z_mean").verdict == "ok"
    assert different.state == "outside"
    assert not different.within
    assert "overlap_mean +2" in different.verdict.sentence


def test_equal_beds_are_called_different_at_the_stated_rate():
    rows = [between(side(2 * seed), side(2 * seed + 1), None) for seed in range(300)]
    called = sum(row.difference.significant is True for row in rows)
    # one in twenty: 15 of 300; five standard deviations of the binomial above, and not never
    assert 1 <= called <= 15 + 5 * math.sqrt(300 * 0.05 * 0.95)


def test_a_difference_at_the_tolerance_is_hardly_ever_called_ok_or_outside():
    """Two one-sided tests: each wrong answer in at most one of forty."""
    tolerance = 0.05
    verdicts = [between(side(1000 + 2 * s, 10.5), side(1001 + 2 * s, 10.0), tolerance).verdict for s in range(300)]
    for wrong in ("ok", "outside"):
        assert verdicts.count(wrong) <= 7.5 + 5 * math.sqrt(7.5), wrong


def test_doubtful_intervals_taken_wider_keep_their_promise():
    """Three times the stated half-width of an average over few independent samples covers 95 %."""
    hits = []
    for seed in range(400):
        found = side(5000 + seed, 0.0, length=1.5, tau=0.1)  # 7 independent samples
        assert found.value is not None
        if not found.reliable:
            hits.append(abs(found.value) <= found.deciding)
    assert len(hits) > 200
    assert np.mean(hits) > 0.95


def test_short_runs_are_undecided_and_say_how_long_they_must_be():
    """The predicted length does decide: of equal beds run that long most are found within the tolerance."""
    tolerance, decided, undecided = 0.02, 0, 0
    for seed in range(40):
        short = between(side(20000 + seed, length=4.0), side(30000 + seed, length=4.0), tolerance)
        if short.verdict != "undecided":
            continue
        undecided += 1
        assert short.difference.needed_end is not None
        assert short.difference.needed_end > 4.0
        length = min(short.difference.needed_end, 400.0)
        long = between(side(40000 + seed, length=length), side(50000 + seed, length=length), tolerance)
        decided += long.verdict == "ok"
    assert undecided >= 20
    assert decided >= 0.75 * undecided


def test_undecided_is_a_verdict_of_its_own():
    scene = replace(SCENE, tolerances={"z_mean": 0.001})
    found = compare(run_data("linear", 3, scene=scene, bubble=False), run_data("hertz", 4, scene=scene, bubble=False))
    assert found.state == "undecided"
    assert not found.within
    row = found.row("z_mean")
    assert row.difference.width > row.tolerance
    assert found.verdict.sentence.startswith("Undecided: ")
    assert found.needed_end == row.difference.needed_end
    if row.difference.needed_end is not None:
        assert row.difference.needed_end > 4.0
        assert f"{row.difference.needed_end:.3g} s" in found.verdict.sentence


def test_a_run_compared_with_itself_shows_no_difference():
    data = run_data("hertz", 5, tau=0.02, length=8.0, bubble=False)
    found = compare(data, data, {"pressure_drop": 0.05, "z_mean": 0.05})
    for row in found.rows:
        assert row.difference.value in (None, 0.0), row.metric
        assert not row.difference.significant, row.metric
    assert found.within
    assert found.state == "within"


def test_fluctuation_and_overlap_share_are_those_of_the_signals():
    data = run_data("hertz", 6, length=20.0, tau=0.02, bubble=False)
    found = compare(data, data, {})
    row = found.row("pressure_fluctuation")
    assert row.reference.value == pytest.approx(SPREAD * MEANS["p_in"], abs=2.0 * row.reference.width)
    # exponential overlaps: the share above a limit is exp(-limit/mean)
    row = found.row("overlap_share")
    expected = math.exp(-0.01 * SCENE.diameter / MEANS["overlap_mean"])
    assert row.reference.value == pytest.approx(expected, abs=2.0 * row.reference.width + 0.2 * expected)  # bins


def test_the_weight_balance_closes_and_an_open_one_is_reported():
    data = run_data("hertz", 7, bubble=False)
    found = compare(data, data, {})
    assert abs(found.row("weight_closure").reference.value) < 1e-12
    assert all(i.holds for i in found.invariants)
    lost = replace(data, signals=replace(data.series, floor=data.series.floor + 0.02 * data.series.facts.weight))
    found = compare(data, lost, {})
    assert found.row("weight_closure").reference.value == pytest.approx(0.02, rel=1e-9)
    assert [i.name for i in found.invariants if not i.holds] == ["weight_closure"]
    assert any("weight_closure" in text and "trusted" in text for text in found.verdict.all)


def test_momentum_of_the_particles_belongs_to_the_balance():
    """A force that accelerates the bed is no error of the balance."""
    data = run_data("hertz", 8, bubble=False)
    extra = 0.1 * data.series.facts.weight
    moving = replace(data.series, floor=data.series.floor + extra, momentum_z=extra * data.series.t)
    found = compare(data, replace(data, signals=moving), {})
    assert abs(found.row("weight_closure").reference.value) < 1e-9


@pytest.mark.parametrize(
    ("name", "value"), [("reaction_error", 1e-9), ("not_passed", 2e-3), ("solids_error", 1e-3), ("courant_max", 2.5)]
)
def test_one_bad_coupling_breaks_an_invariant(name, value):
    data = run_data("hertz", 9, bubble=False)
    values = getattr(data.series, name).copy()
    values[3] = value
    bad = replace(data, signals=replace(data.series, **{name: values}))
    found = compare(data, bad, {})
    assert [i.name for i in found.invariants if not i.holds] == [name]
    values[3] = np.nan
    found = compare(data, bad, {})
    assert [i.name for i in found.invariants if not i.holds] == [name]


def test_costs_are_split_and_the_speed_is_that_of_the_particles(different):
    assert different.speed.cpu == pytest.approx(36.0 / 12.0)
    assert different.speed.total == pytest.approx(42.0 / 18.0)
    linear, hertz = (d.result.steps for d in different.runs)
    assert different.speed.steps == hertz / linear


def test_the_comparison_is_plain_json(different, tmp_path):
    write_json(tmp_path / "c.json", different.to_dict())
    data = json.loads((tmp_path / "c.json").read_text())
    assert data["state"] == "outside"
    assert data["within"] is False
    assert {r["metric"] for r in data["rows"]} == {r.metric for r in different.rows}
    assert len(different.to_frame()) == len(different.rows)


def test_what_cannot_be_compared_is_refused():
    good = run_data("hertz", 10, bubble=False)
    with pytest.raises(RunError, match="lost atoms"):
        compare(run_data("linear", 11, status="failed", bubble=False), good)
    with pytest.raises(RunError, match="cpu_gas"):
        compare(replace(good, result=replace(good.result, extra={"transport": "live", "cpu_dem": 1.0})), good)
    other = replace(SCENE, gas=None)
    with pytest.raises(InputError, match="differ in their gas"):
        compare(replace(good, model=replace(good.model, scene=other)), good)
    with pytest.raises(InputError, match=r"0\.05 means 5 %"):
        compare(good, good, {"z_mean": -1.0})


def test_a_tolerance_for_what_was_not_observed_fails():
    data = run_data("hertz", 12, bubble=False)
    found = compare(data, data, {"U_mf": 0.1})
    assert found.row("U_mf").verdict == "missing"
    assert found.state == "outside"
    assert not found.within


@given(difference=st.floats(0.0, 1.0), width=st.floats(0.0, 1.0), limit=st.floats(0.0, 1.0), factor=st.floats(0.0, 1.0))
def test_less_uncertainty_never_turns_a_verdict_around(difference, width, limit, factor):
    verdict = decide(difference, width, limit)
    if verdict != "undecided":
        assert decide(difference, factor * width, limit) == verdict
    assert decide(difference, 0.0, limit) == ("ok" if difference <= limit else "outside")


def test_doubtful_averages_need_a_wide_margin():
    assert between(known(1.00, 0.01), known(1.0, 0.01), 0.05).verdict == "ok"
    assert between(known(1.00, 0.02, False), known(1.0, 0.02), 0.05).verdict == "undecided"
    assert between(known(1.00, 0.001, False), known(1.0, 0.001), 0.05).verdict == "ok"
    assert between(known(1.03, 0.01, False), known(1.0, 0.01), None).difference.significant is None
    assert between(known(1.10, 0.01, False), known(1.0, 0.01), None).difference.significant is True


def test_two_start_ups_that_agree_are_no_agreement():
    a, b = known(1.00, 0.001), replace(known(1.0, 0.001), started=False)
    assert between(a, b, 0.05).verdict == between(b, a, 0.05).verdict == "undecided"
    assert between(a, b, 0.05).difference.needed_end is not None
    assert between(replace(known(1.2, 0.001), started=False), b, 0.05).verdict == "outside"


def test_fields_are_judged_less_the_noise_of_sampling():
    assert fields(0.02, 0.02, None).difference.significant is False
    assert fields(0.02, 0.02, 0.03).verdict == "ok"
    assert fields(0.04, 0.02, 0.03).verdict == "undecided"
    assert fields(0.10, 0.02, 0.03).verdict == "outside"


def test_signals_of_both_runs_may_be_of_any_length():
    linear = run_data("linear", 13, length=4.0, bubble=False)
    found = compare(linear, run_data("hertz", 14, length=3.0, bubble=False), {})
    assert found.row("z_mean").difference.value is not None


def test_the_verdict_names_the_largest_difference_that_nobody_judged():
    """Overlaps 30 % larger: seen, and judged by nobody; of two differences seen the larger one is named."""
    linear = run_data("linear", 31, length=40.0, bubble=False, means={"overlap_mean": 1.3 * MEANS["overlap_mean"]})
    hertz = run_data("hertz", 32, length=40.0, bubble=False)
    found = compare(linear, hertz, {"z_mean": 0.05})
    assert found.state == "within"
    seen = {r.metric: abs(r.difference.value) for r in found.rows if r.tolerance is None and r.difference.significant}
    assert seen["overlap_mean"] > 0.2
    assert any(f"no tolerance judges: {max(seen, key=seen.__getitem__)}," in text for text in found.verdict.points)
    judged = compare(linear, hertz, dict.fromkeys(seen, 100.0))
    named = [r for r in judged.rows if any(f"judges: {r.metric}," in text for text in judged.verdict.points)]
    assert not any(r.difference.significant is False for r in named)
    assert not any("no tolerance judges" in text for text in compare(linear, hertz, {}).verdict.all)
