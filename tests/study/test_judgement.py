"""Verdicts on parts: the whole interval decides, and a short run is undecided, not lucky."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from compared_beds import MEANS, run_data
from hypothesis import given
from hypothesis import strategies as st

from kncal.observe.estimate import Estimate
from kncal.observe.row import Row
from kncal.study.trim.effects import effects
from kncal.study.trim.judgement import cost_text, describe, judge_part
from kncal.study.trim.trim import OFF, ON, OTHER, CostChange, Part, worst_of

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


def effect(
    metric: str,
    verdict: str,
    change: float | None = 0.01,
    width: float | None = 0.001,
    *,
    tried: float | None = 1.01,
    full: float | None = 1.0,
    needed_end: float | None = None,
    **values: Any,
) -> Row:
    return Row(
        metric=metric,
        unit="–",
        text="",
        run=Estimate(value=tried),
        reference=Estimate(value=full),
        difference=Estimate(value=change, width=width, needed_end=needed_end),
        verdict=verdict,
        **({"tolerance": 0.05} | values),
    )


def test_the_verdict_and_its_words_follow_what_was_tried() -> None:
    free, moved = (effect("e_n", "ok"),), (effect("e_n", "ok"), effect("t_c", "outside", 0.12))
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
    free = (effect("e_n", "ok"),)
    saving = replace(COST, cpu=-0.16, cpu_low=-0.2, cpu_high=-0.1)
    assert judge_part(part(), free, saving).verdict == "keep"
    assert judge_part(part(), free, replace(saving, cpu_high=0.01)).verdict == "leave out"  # not for certain
    assert judge_part(part(ON), free, saving).verdict == "not needed"


def test_one_undecided_metric_leaves_the_part_undecided_unless_another_changes() -> None:
    open_ = effect("z_95", "undecided", needed_end=3.0)
    found = judge_part(part(), (effect("e_n", "ok"), open_), COST)
    assert found.verdict == "undecided"
    assert "3 s" in found.sentence and "run.until_time" in found.sentence
    assert judge_part(part(), (open_, effect("t_c", "outside")), COST).verdict == "keep"


def test_a_metric_that_is_gone_without_the_part_keeps_it() -> None:
    gone = effect("pressure_drop", "outside", None, tried=None, width=None, reason="no gas")
    sentence = judge_part(part(), (gone,), COST).sentence
    assert "pressure_drop" in sentence and "no gas" in sentence


def test_unjudged_changes_are_told() -> None:
    aside = effect("spin_out", "-", 0.5, tolerance=None)
    outcome, text = describe((effect("e_n", "ok"), aside))
    assert outcome == "free"
    assert "spin_out +50.00 ± 0.10 %" in text
    assert describe((aside,))[0] == "undecided"  # nothing was judged


def test_no_effect_at_all_needs_no_tolerance() -> None:
    same = effect("e_n", "ok", 0.0, 0.0, tolerance=None)
    assert describe((same, same))[0] == "free"
    nothing = effect("slip", "-", None, full=None, tried=None, width=None, tolerance=None)
    assert describe((nothing,))[0] == "undecided"  # nothing could be compared: that is no equality


def test_where_cpu_times_say_nothing_the_steps_are_told() -> None:
    assert cost_text(replace(COST, cpu=None, steps=0.05)) == "+5 % steps"
    assert cost_text(replace(COST, cpu=None)) == "no more steps"
    assert cost_text(COST, output=True).endswith("2 kB against 1 kB")


def test_the_deciding_effect_is_the_changed_one_even_if_another_is_less_certain() -> None:
    vague = effect("z_95", "undecided", 0.02, width=5.0)
    clear = effect("e_n", "outside", 0.06)
    assert worst_of((vague, clear)) is clear


# --- beds: signals of known means ---------------------------------------------------------------------------

TOLERANCES = {"z_mean": 0.05, "pressure_drop": 0.05}


def by_metric(*given: Any, **options: Any) -> dict[str, Row]:
    return {row.metric: row for row in effects(*given, **options)}


def test_a_bed_against_itself_has_no_effect_whatever_its_length() -> None:
    bed = run_data("linear", 1)
    rows = effects(bed, bed, TOLERANCES | {"velocity": 0.1})
    assert {(row.verdict, row.difference.value) for row in rows if row.tolerance is not None} == {("ok", 0.0)}
    assert describe(rows)[0] == "free"


def test_known_differences_between_beds_are_found_and_equal_means_are_not_called_different() -> None:
    full = run_data("linear", 1)
    higher = run_data("linear", 2, means=MEANS | {"z_mean": 1.3 * MEANS["z_mean"]})
    found = by_metric(higher, full, TOLERANCES)
    assert found["z_mean"].verdict == "outside"
    assert found["z_mean"].difference.value == pytest.approx(0.3, abs=2.0 * found["z_mean"].difference.deciding)
    assert found["pressure_drop"].verdict in ("ok", "undecided")
    other = by_metric(run_data("linear", 3), full, TOLERANCES)
    assert "outside" not in {other[name].verdict for name in TOLERANCES}


def test_without_a_tolerance_a_difference_that_is_not_seen_in_a_bed_decides_nothing() -> None:
    full, other = run_data("linear", 1), run_data("linear", 3)
    assert describe(effects(other, full, {}))[0] != "free"


def test_what_cannot_be_compared_is_said() -> None:
    full, other = run_data("linear", 1), run_data("linear", 3)
    found = by_metric(other, full, {"contacts": 0.1}, lost={"contacts": "goes with the depth"})
    assert (found["contacts"].verdict, found["contacts"].difference.value) == ("undecided", None)
    assert found["contacts"].reason == "goes with the depth"


@given(
    change=st.floats(-1.0, 1.0).filter(bool),
    width=st.floats(0.0, 1.0),
    tolerance=st.floats(1e-6, 1.0),
)
def test_ok_means_the_whole_interval_and_outside_none_of_it(change: float, width: float, tolerance: float) -> None:
    from kncal.study.trim.effects import _resolved

    row = effect("e_n", "-", change, None, tolerance=tolerance)
    found = _resolved(row, {"e_n": width}, recorded=False)
    low, high = abs(change) - width, abs(change) + width
    slack = 1e-11  # rounding counts as uncertainty
    if found.verdict == "ok":
        assert high <= tolerance + slack
    elif found.verdict == "outside":
        assert low >= tolerance - slack
    else:
        assert low <= tolerance + slack
        assert high >= tolerance - slack
