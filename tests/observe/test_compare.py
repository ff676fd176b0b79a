"""The algebra of a comparison on runs made by hand: every expected number is a closed form."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from comparisons import path, run_data, uniform
from hypothesis import given
from hypothesis import strategies as st
from models import R, head_on, on_wall

from kncal.core.errors import InputError, KncalError, RunError
from kncal.observe.compare import compare
from kncal.scene.metrics import METRICS, metric_text, metric_unit, split_metric

VALUES = {"e_n": 0.9, "t_c": 1e-4, "delta_max": 2e-5, "v_out": 0.9, "spin_out": 0.0, "t_c_2": 1.1e-4}
positive = st.floats(1e-9, 1e9)


def test_a_run_equals_itself_exactly():
    run = run_data("hertz", VALUES, exact=VALUES, predicted=dict.fromkeys(VALUES, 0.01))
    result = compare(run, run, {**dict.fromkeys(VALUES, 0.0), "trajectory": 0.0})
    assert [row.difference.value for row in result.rows] == [0.0] * (len(VALUES) + 2)
    assert {row.verdict for row in result.judged} == {"ok"}
    assert result.within
    assert (result.speed.steps, result.speed.cpu) == (1.0, 1.0)
    assert [row.difference.value for row in result.exact] == [0.0] * (2 * len(VALUES))


@given(a=positive, b=positive)
def test_differences_are_relative_to_hertz(a: float, b: float):
    row = compare(run_data("linear", {"t_c": a}), run_data("hertz", {"t_c": b}), {}).row("t_c")
    assert row.difference.value == pytest.approx(a / b - 1.0, rel=1e-9, abs=1e-15)
    assert row.basis == "relative to hertz"
    assert (row.run.value, row.reference.value) == (a, b)


@given(a=st.floats(1e-3, 1e3), b=st.floats(1e-3, 1e3))
def test_swapped_runs_give_the_inverse_ratio(a: float, b: float):
    runs = run_data("linear", {"v_out": a}), run_data("hertz", {"v_out": b})
    there, back = compare(*runs, {}).row("v_out"), compare(*reversed(runs), {}).row("v_out")
    assert (1.0 + there.difference.value) * (1.0 + back.difference.value) == pytest.approx(1.0, rel=1e-9)


@given(share=st.floats(0.001, 0.5), sign=st.sampled_from([-1.0, 1.0]))
def test_the_verdict_turns_at_the_tolerance(share: float, sign: float):
    runs = run_data("linear", {"e_n": 1.0 + sign * share}), run_data("hertz", {"e_n": 1.0})
    difference = abs(compare(*runs, {}).row("e_n").difference.value)
    assert compare(*runs, {"e_n": difference}).within
    below = compare(*runs, {"e_n": math.nextafter(difference, 0.0)})
    assert not below.within
    assert below.row("e_n").verdict == "outside"
    assert below.verdict.sentence.startswith("Outside tolerance")


def test_one_failure_among_many_fails_the_whole():
    linear, hertz = run_data("linear", {**VALUES, "t_c_2": 1.3e-4}), run_data("hertz", VALUES)
    limits = dict.fromkeys(VALUES, 0.1)
    result = compare(linear, hertz, limits)
    assert [row.metric for row in result.rows if row.verdict == "outside"] == ["t_c_2"]
    assert not result.within
    assert compare(linear, hertz, {k: v for k, v in limits.items() if k != "t_c_2"}).within


def test_without_tolerances_nothing_is_judged():
    result = compare(run_data("linear", {"e_n": 0.1}), run_data("hertz", {"e_n": 0.9}), {})
    assert result.within and not result.judged
    assert result.verdict.sentence.startswith("Not judged")


def test_tolerances_come_from_the_scene_unless_given():
    scene = replace(on_wall(), tolerances={"e_n": 0.01})
    runs = run_data("linear", {"e_n": 0.8}, scene=scene), run_data("hertz", {"e_n": 0.9}, scene=scene)
    assert not compare(*runs).within
    assert compare(*runs, {"e_n": 0.2}).within


@pytest.mark.parametrize(
    ("linear", "hertz", "who"),
    [
        ({}, {"e_n": 0.9}, "linear: no e_n in the run"),
        ({"e_n": 0.9}, {}, "hertz: no e_n in the run"),
        ({"e_n": math.nan}, {"e_n": 0.9}, "linear: e_n is not finite"),
        ({"e_n": 0.9}, {"e_n": math.inf}, "hertz: e_n is not finite"),
    ],
)
def test_a_tolerance_that_cannot_be_judged_is_a_failure_with_a_reason(linear, hertz, who):
    result = compare(run_data("linear", linear), run_data("hertz", hertz), {"e_n": 10.0})
    row = result.row("e_n")
    assert (row.verdict, row.difference.value, result.within) == ("missing", None, False)
    assert who in row.reason
    assert who in result.verdict.sentence
    assert compare(run_data("linear", linear), run_data("hertz", hertz), {}).within


def test_a_misspelt_tolerance_is_not_skipped():
    result = compare(run_data("linear", VALUES), run_data("hertz", VALUES), {"delta_mx": 1.0})
    assert not result.within
    assert "delta_mx" in result.verdict.sentence


@pytest.mark.parametrize(
    ("metric", "value", "scale"),
    [
        ("spin_out", 3.0, 1.0 / R),  # largest speed 1 m/s over the radius
        ("slip_end_speed", 0.25, 1.0),
        ("tangential_restitution", 0.125, 1.0),
        ("rebound_angle", 0.5, 1.0),
        ("delta_max", 0.5 * R, R),
        ("rebound_height", 1.0, 2.0),  # the bead moves 2 m
        ("slip_end_time", 1.0, 2.0),  # the run lasts 2 s
    ],
)
@pytest.mark.parametrize("zero", [0.0, 1e-300])
def test_a_zero_reference_is_judged_on_a_natural_scale(metric, value, scale, zero):
    runs = run_data("linear", {metric: value}), run_data("hertz", {metric: zero})
    row = compare(*runs, {metric: 1.0}).row(metric)
    assert row.difference.value == pytest.approx(value / scale)
    assert row.basis.startswith("absolute")
    both = compare(runs[1], runs[1], {metric: 0.0})
    assert both.within and both.row(metric).difference.value == 0.0


def test_a_zero_reference_without_a_scale_cannot_be_judged():
    runs = run_data("linear", {"something": 1.0}), run_data("hertz", {"something": 0.0})
    assert compare(*runs, {"something": 1.0}).row("something").verdict == "missing"


@given(ratio=st.floats(0.5, 2.0), frames=st.tuples(st.integers(2, 40), st.integers(2, 40)))
def test_trajectory_of_two_uniform_motions(ratio: float, frames: tuple[int, int]):
    # |v_1 - v_2| t, largest at the end T: over the extent v_2 T that is |ratio - 1|; its rms is that over sqrt(3)
    linear = run_data("linear", {}, uniform(3.0 * ratio, 2.0, frames[0]))
    hertz = run_data("hertz", {}, uniform(3.0, 2.0, frames[1]))
    result = compare(linear, hertz, {})
    assert result.row("trajectory").scale == pytest.approx(6.0)
    assert result.row("trajectory").difference.value == pytest.approx(abs(ratio - 1.0), abs=1e-12)
    # trapezoidal rule for t² on m intervals or more: too large by 1/(2 m²) of the mean square at most
    rms, m = result.row("trajectory_rms").difference.value, max(frames) - 1
    exact = abs(ratio - 1.0) / math.sqrt(3.0)
    assert exact * (1.0 - 1e-9) - 1e-12 <= rms <= exact * math.sqrt(1.0 + 0.5 / m**2) * (1.0 + 1e-9) + 1e-12


def test_a_flight_needs_no_dense_frames():
    def flight(t):
        return path(t, 2.0 * np.asarray(t) - 4.905 * np.asarray(t) ** 2, 2.0 - 9.81 * np.asarray(t))

    result = compare(
        run_data("linear", {}, flight([0.0, 1.0])), run_data("hertz", {}, flight(np.linspace(0.0, 1.0, 77))), {}
    )
    assert result.row("trajectory").difference.value < 1e-14


def test_only_the_common_time_is_compared():
    linear, hertz = run_data("linear", {}, uniform(1.0, 1.0)), run_data("hertz", {}, uniform(2.0, 4.0))
    result = compare(linear, hertz, {})
    assert result.row("trajectory").difference.value == pytest.approx(1.0 / 8.0)  # 1 m apart after 1 s, 8 m in all


def test_no_common_time_fails_a_trajectory_tolerance():
    late = replace(uniform(), t=uniform().t + 10.0)
    result = compare(run_data("linear", {}, late), run_data("hertz", {}), {"trajectory": 1.0})
    assert result.row("trajectory").verdict == "missing"
    assert "no common time" in result.row("trajectory").reason


def test_trajectories_at_rest_are_measured_by_the_radius():
    still = path([0.0, 1.0], [0.0, 0.0], [0.0, 0.0])
    moved = path([0.0, 1.0], [0.1 * R, 0.1 * R], [0.0, 0.0])
    result = compare(run_data("linear", {}, moved), run_data("hertz", {}, still), {})
    assert result.row("trajectory").difference.value == pytest.approx(0.1)
    assert "smallest radius" in result.row("trajectory").basis


def test_exact_and_predicted_stand_beside_the_difference():
    linear = run_data("linear", {"t_c": 1.02}, exact={"t_c": 1.0}, predicted={"t_c": 0.05})
    hertz = run_data("hertz", {"t_c": 2.2}, exact={"t_c": 2.0}, predicted={"t_c": 0.05})
    result = compare(linear, hertz, {"t_c": 0.01})
    row = result.row("t_c")
    assert row.exact_difference == pytest.approx((1.0 - 2.0) / 2.2)
    assert row.difference.width == pytest.approx(0.05 * (1.02 + 2.2) / 2.2)
    assert row.reason == ""  # far outside: no matter of steps
    of_linear, of_hertz = result.exact
    assert (of_linear.difference.value, of_linear.verdict) == (pytest.approx(0.02), "ok")
    assert (of_hertz.difference.value, of_hertz.verdict) == (pytest.approx(0.1), "outside")
    assert any("t_c (hertz)" in sentence for sentence in result.verdict.all)


def test_a_tolerance_below_the_discretisation_error_decides_nothing():
    predicted = {"t_c": 0.05}
    linear = run_data("linear", {"t_c": 2.21}, predicted=predicted)
    hertz = run_data("hertz", {"t_c": 2.2}, predicted=predicted)
    found = compare(linear, hertz, {"t_c": 0.01})
    assert (found.row("t_c").verdict, found.state, found.within) == ("undecided", "undecided", False)
    assert "more steps per contact" in found.verdict.sentence
    assert compare(linear, hertz, {"t_c": 0.2}).within
    assert compare(hertz, hertz, {"t_c": 0.01}).row("t_c").verdict == "ok"


def test_what_limits_the_contacts_that_happened_is_in_the_verdict():
    from kncal.scene.contact_event import ContactEvent

    event = ContactEvent(
        pair=("bead", "floor"),
        t_start=0.0,
        t_c=1.0,
        delta_max=1e-6,
        delta_mean=5e-7,
        v_in=1.0,
        v_out=1.0,
        e_n=1.0,
        complete=True,
    )
    texts = {"yield": "the contact is plastic", "attraction": "the dashpot pulls"}

    def limited(kind, met):
        data = run_data(kind, {"e_n": 0.9})
        contacts = {pair: replace(c, warnings=texts) for pair, c in data.model.contacts.items()}
        observations = replace(data.observations, contacts=(event,) if met else ())
        return replace(data, model=replace(data.model, contacts=contacts), contacts=observations)

    assert list(limited("linear", True).model.named) == [("bead", "floor")]
    said = " ".join(compare(limited("linear", True), limited("hertz", True), {}).verdict.all)
    assert "bead–floor: the contact is plastic" in said
    assert "pulls" not in said  # nearly every damped contact has it: it stands in the tables
    silent = " ".join(compare(limited("linear", False), limited("hertz", False), {}).verdict.all)
    assert "no contact happened" in silent
    assert "plastic" not in silent


def test_a_large_difference_without_a_tolerance_is_named():
    linear, hertz = (run_data(kind, {"e_n": 0.9, "t_c": t_c}) for kind, t_c in (("linear", 2.0), ("hertz", 1.0)))
    said = " ".join(compare(linear, hertz, {"e_n": 0.1}).verdict.points)
    assert "no tolerance judges" in said
    assert "t_c, +100 %" in said


def test_an_exact_value_that_the_run_does_not_reach_stays_visible():
    (row,) = compare(run_data("linear", {}, exact={"e_n": 0.9}), run_data("hertz", {}), {}).exact
    assert (row.run.value, row.difference.value, row.verdict) == (None, None, "-")


def test_cost_and_speed():
    linear = run_data("linear", {}, steps=1000, cpu=2.0, cpu_samples=(2.0, 4.0, 3.0))
    hertz = run_data("hertz", {}, steps=4000, cpu=9.0, cpu_samples=(9.0, 12.0, 15.0))
    result = compare(linear, hertz, {})
    cost = result.costs[0]
    assert (cost.cpu_seconds, cost.cpu_low, cost.cpu_high, cost.runs) == (3.0, 2.0, 4.0, 3)
    assert cost.cpu_per_step == pytest.approx(3e-3)
    assert cost.steps_per_contact == pytest.approx(50.0)  # the model is planned with t_c/50
    speed = result.speed
    assert (speed.steps, speed.cpu, speed.cpu_low, speed.cpu_high) == (4.0, 4.0, 9.0 / 4.0, 15.0 / 2.0)
    assert not speed.caveats


def test_doubtful_costs_are_called_doubtful():
    fast = compare(run_data("linear", {}, cpu=0.0), run_data("hertz", {}, cpu=0.0), {})
    assert fast.speed.cpu is None
    assert "too short" in fast.verdict.points[0]
    short = compare(run_data("linear", {}, cpu=0.4), run_data("hertz", {}, cpu=0.8), {})
    assert short.speed.cpu == pytest.approx(2.0)
    assert any("steps" in text for text in short.speed.caveats)
    coarse = run_data("hertz", {})
    coarse = replace(coarse, result=replace(coarse.result, dt=2.0 * coarse.result.dt))
    uneven = compare(run_data("linear", {}), coarse, {})
    assert any("steps per contact" in text for text in uneven.speed.caveats)


def test_a_failed_run_is_not_compared():
    with pytest.raises(RunError, match=r"hertz.*'failed'.*ERROR: lost atoms"):
        compare(run_data("linear", {}), run_data("hertz", {}, status="failed"), {})


def test_different_bodies_are_not_compared():
    other = replace(on_wall(), gravity=(0.0, 0.0, -1.0))
    with pytest.raises(InputError, match="gravity"):
        compare(run_data("linear", {}), run_data("hertz", {}, scene=other), {})
    with pytest.raises(InputError, match="particles"):
        compare(run_data("linear", {}), run_data("hertz", {}, scene=head_on()), {})


@pytest.mark.parametrize("bad", [-0.1, math.nan, math.inf, "5 %", None, True])
def test_bad_tolerances_are_refused_by_name(bad):
    with pytest.raises(KncalError, match="t_c"):
        compare(run_data("linear", VALUES), run_data("hertz", VALUES), {"t_c": bad})


def test_the_result_is_plain_json_and_a_table():
    linear = run_data("linear", {**VALUES, "e_n_2": math.nan}, exact={"e_n": 0.9})
    result = compare(linear, run_data("hertz", VALUES), {"t_c": 0.1, "nothing": 0.1})
    data = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert data["within"] is False
    assert [row["metric"] for row in data["rows"]] == [row.metric for row in result.rows]
    frame = result.to_frame()
    assert list(frame["metric"]) == [row.metric for row in result.rows]
    assert frame.set_index("metric").loc["nothing", "verdict"] == "missing"


def test_names_of_metrics():
    assert split_metric("t_c") == ("t_c", 1)
    assert split_metric("rebound_height_12") == ("rebound_height", 12)
    assert metric_unit("delta_max_3") == "m"
    assert metric_text("t_c_2") == "contact duration, contact 2"
    assert all(metric.unit and metric.text for metric in METRICS.values())


@pytest.mark.parametrize("metric", ["t_c", "trajectory"])
def test_an_unknown_row_names_those_there_are(metric):
    with pytest.raises(InputError, match=metric):
        compare(run_data("linear", {"t_c": 1.0}), run_data("hertz", {"t_c": 1.0}), {}).row("nope")
