"""Verdicts on parts: the whole interval decides, and a short run is undecided, not lucky."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from compared_beds import MEANS, run_data
from hypothesis import given
from hypothesis import strategies as st

from kncal.observe.run_data import observed
from kncal.study.trim.base import OFF, ON, OTHER, CostChange, Effect, Part, worst_of
from kncal.study.trim.effect import bed_effects
from kncal.study.trim.judgement import cost_text, describe, judge_part

COST = CostChange(
    cpu=0.24,
    cpu_low=0.2,
    cpu_high=0.27,
    rounds=3,
    steps=0.0,
    disk=0.0,
    full_cpu=12.4,
    tried_cpu=10.0,
    full_bytes=2000,
    tried_bytes=1000,
)


def part(change: str = OFF, **values: Any) -> Part:
    return Part(name="rolling", group="rolling", text="rolling friction", change=change, tried="without it", **values)


def effect(metric: str, verdict: str, change: float | None = 0.01, **values: Any) -> Effect:
    first: dict[str, Any] = {
        "unit": "–",
        "full": 1.0,
        "tried": 1.01,
        "uncertainty": 0.001,
        "basis": "",
        "tolerance": 0.05,
        "significant": None,
    }
    return Effect(metric=metric, verdict=verdict, change=change, **(first | values))


def test_the_verdict_and_its_words_follow_what_was_tried() -> None:
    free, moved = (effect("e_n", "within"),), (effect("e_n", "within"), effect("t_c", "changed", 0.12))
    for change, without, with_effect in (
        (OFF, "leave out", "keep"),
        (ON, "not needed", "matters"),
        (OTHER, "either", "matters"),
    ):
        assert judge_part(part(change), free, COST).verdict == without
        assert judge_part(part(change), moved, COST).verdict == with_effect
    kept = judge_part(part(), moved, COST)
    assert all(number in kept.sentence for number in ("+24 % CPU", "+20", "+27 %"))
    assert "t_c +12.00 ± 0.10 %" in kept.sentence
    assert kept.worst is not None
    assert kept.worst.metric == "t_c"


def test_what_saves_time_is_kept_though_it_has_no_effect() -> None:
    """Leaving out front and back walls for a periodic depth may cost more than it saves."""
    free = (effect("e_n", "within"),)
    saving = replace(COST, cpu=-0.16, cpu_low=-0.2, cpu_high=-0.1)
    assert judge_part(part(), free, saving).verdict == "keep"
    assert judge_part(part(), free, replace(saving, cpu_high=0.01)).verdict == "leave out"  # not for certain
    assert judge_part(part(ON), free, saving).verdict == "not needed"


def test_one_undecided_metric_leaves_the_part_undecided_unless_another_changes() -> None:
    open_ = effect("z_95", "undecided", needed_end_time=3.0)
    found = judge_part(part(), (effect("e_n", "within"), open_), COST)
    assert found.verdict == "undecided"
    assert "3 s" in found.sentence and "run.end_time" in found.sentence
    assert judge_part(part(), (open_, effect("t_c", "changed")), COST).verdict == "keep"


def test_a_metric_that_is_gone_without_the_part_keeps_it() -> None:
    gone = effect("pressure_drop", "changed", None, tried=None, uncertainty=None, reason="no gas")
    sentence = judge_part(part(), (gone,), COST).sentence
    assert "pressure_drop" in sentence and "no gas" in sentence


def test_unjudged_changes_are_told() -> None:
    aside = effect("spin_out", "-", 0.5, tolerance=None, significant=True)
    outcome, text = describe((effect("e_n", "within"), aside))
    assert outcome == "free"
    assert "spin_out +50.00 ± 0.10 %" in text
    assert describe((aside,))[0] == "undecided"  # nothing was judged


def test_no_effect_at_all_needs_no_tolerance() -> None:
    same = effect("e_n", "none", 0.0, uncertainty=0.0, tolerance=None, significant=False)
    assert describe((same, same))[0] == "free"
    nothing = effect("slip", "-", None, full=None, tried=None, uncertainty=None, tolerance=None)
    assert describe((nothing,))[0] == "undecided"  # nothing could be compared: that is no equality


def test_where_cpu_times_say_nothing_the_steps_are_told() -> None:
    assert cost_text(replace(COST, cpu=None, steps=0.05)) == "+5 % steps"
    assert cost_text(replace(COST, cpu=None)) == "no more steps"
    assert cost_text(COST, output=True).endswith("2 kB against 1 kB")


def test_the_deciding_effect_is_the_changed_one_even_if_another_is_less_certain() -> None:
    vague = effect("z_95", "undecided", 0.02, uncertainty=5.0)
    clear = effect("e_n", "changed", 0.06)
    assert worst_of((vague, clear)) is clear


# --- beds: signals of known means ---------------------------------------------------------------------------

TOLERANCES = {"z_mean": 0.05, "pressure_drop": 0.05}


def test_a_bed_against_itself_has_no_effect_whatever_its_length() -> None:
    bed = observed(run_data("linear", 1))
    effects = bed_effects(bed, bed, TOLERANCES | {"velocity": 0.1}, {})
    assert {e.verdict for e in effects if e.tolerance is not None} == {"none"}
    assert describe(effects)[0] == "free"


def test_known_differences_between_beds_are_found_and_equal_means_are_not_called_different() -> None:
    full = observed(run_data("linear", 1))
    higher = observed(run_data("linear", 2, means=MEANS | {"z_mean": 1.3 * MEANS["z_mean"]}))
    found = {e.metric: e for e in bed_effects(higher, full, TOLERANCES, {})}
    assert found["z_mean"].verdict == "changed"
    assert found["z_mean"].change == pytest.approx(0.3, abs=2.0 * (found["z_mean"].uncertainty or 0.0))
    assert found["pressure_drop"].verdict in ("within", "undecided")
    other = {e.metric: e for e in bed_effects(observed(run_data("linear", 3)), full, TOLERANCES, {})}
    assert "changed" not in {other[name].verdict for name in TOLERANCES}


def test_without_a_tolerance_a_difference_that_is_not_seen_in_a_bed_decides_nothing() -> None:
    full, other = observed(run_data("linear", 1)), observed(run_data("linear", 3))
    effects = bed_effects(other, full, {}, {})
    assert describe(effects)[0] != "free"


def test_what_cannot_be_compared_is_said() -> None:
    full, other = observed(run_data("linear", 1)), observed(run_data("linear", 3))
    found = {e.metric: e for e in bed_effects(other, full, {"contacts": 0.1}, {"contacts": "goes with the depth"})}
    assert (found["contacts"].verdict, found["contacts"].change) == ("undecided", None)
    assert found["contacts"].reason == "goes with the depth"


@given(
    change=st.floats(-1.0, 1.0).filter(bool),
    width=st.floats(0.0, 1.0),
    tolerance=st.floats(1e-6, 1.0),
)
def test_within_means_the_whole_interval_and_changed_none_of_it(change: float, width: float, tolerance: float) -> None:
    from kncal.observe.estimate import Estimate
    from kncal.observe.row import Row
    from kncal.study.trim.effect import _contact_effect

    one, moved = Estimate(value=1.0), Estimate(value=change)
    row = Row(metric="e_n", unit="–", text="", run=one, reference=one, difference=moved, scale=1.0)
    found = _contact_effect(row, width, {"e_n": tolerance})
    low, high = abs(change) - width, abs(change) + width
    slack = 1e-11  # rounding counts as uncertainty
    if found.verdict == "within":
        assert high <= tolerance + slack
    elif found.verdict == "changed":
        assert low >= tolerance - slack
    else:
        assert low <= tolerance + slack
        assert high >= tolerance - slack
