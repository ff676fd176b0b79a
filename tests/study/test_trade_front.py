"""The Pareto front, the cheapest point inside, what it saves, and what is tolerated."""

import dataclasses
import math
import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from trades import point, trade

from kncal.core.errors import InputError
from kncal.observe.softness import Sign
from kncal.observe.tolerances import parse_tolerances
from kncal.scene.metrics import COUPLED, FEW_PARTICLES
from kncal.study.trade.answer import answer, to_dict
from kncal.study.trade.front import conclude, failing, inside, pareto, reach, verdict, worst_ratio
from kncal.study.trade.report import shown_points

# few values, so that ties happen
NUMBERS = st.sampled_from([1.0, 2.0, 3.0, 5.0, 8.0]) | st.floats(1e-3, 1e3)


def dominates(a, b):
    return a[0] <= b[0] and a[1] <= b[1] and a != b


@given(st.lists(st.tuples(NUMBERS, NUMBERS), max_size=30))
def test_a_point_is_on_the_front_if_and_only_if_nothing_dominates_it(points):
    front = pareto([c for c, _ in points], [e for _, e in points])
    assert len(set(front)) == len(front)
    for i, p in enumerate(points):
        assert (i in front) == (not any(dominates(q, p) for q in points))
        if i not in front:
            assert any(dominates(points[j], p) for j in front)
    assert [points[i][0] for i in front] == sorted(points[i][0] for i in front)


TRIPLES = st.lists(st.tuples(st.integers(1, 1000), st.floats(-2.0, 2.0), st.floats(0.0, 1.0)), min_size=1, max_size=20)


@given(TRIPLES)
def test_the_chosen_point_is_inside_and_no_cheaper_one_is(triples):
    points = [point(f"p{k}", steps, {"e_n": (e, u)}) for k, (steps, e, u) in enumerate(triples)]
    made = trade(points, {"e_n": 1.0})
    found = conclude(made)
    sure = [p for p, (_, e, u) in zip(made.points, triples, strict=True) if abs(e) + u <= 1.0]
    if not sure:
        assert found.chosen is None
        assert found.nearest is not None
        assert [row.metric for row in failing(found.nearest)] == ["e_n"]
        # the nearest is no farther than any other
        assert all(worst_ratio(found.nearest) <= worst_ratio(p) for p in made.points)
    else:
        assert found.chosen in sure
        assert found.chosen.steps == min(p.steps for p in sure)
        assert found.chosen.candidate.name in found.front


def test_every_metric_counts_and_undecided_is_not_inside():
    tolerances = {"e_n": 0.01, "t_c": 0.1}
    within = point("within", 100, {"e_n": 0.005, "t_c": -0.05})
    one_out = point("one_out", 10, {"e_n": 0.005, "t_c": -0.2})
    undecided = point("undecided", 20, {"e_n": (0.009, 0.005), "t_c": 0.0})
    missing = point("missing", 5, {"e_n": 0.0})
    made = trade([within, one_out, undecided, missing], tolerances)
    assert [verdict(p) for p in made.points] == ["inside", "outside", "undecided", "missing"]
    assert [inside(p) for p in made.points] == [True, False, False, False]
    assert worst_ratio(made.points[3]) == math.inf
    found = conclude(made)
    assert found.chosen.candidate.name == "within"
    # by e_n alone the cheapest is the one that lacks t_c
    assert found.by_metric["e_n"][0] == "missing"


def test_a_failed_run_is_never_chosen():
    lost = dataclasses.replace(point("lost", 1, {"e_n": 0.0}), status="failed")
    assert conclude(trade([lost, point("kept", 10, {"e_n": 0.0})], {"e_n": 0.1})).chosen.candidate.name == "kept"


def test_the_saving_is_by_round_so_that_a_slow_round_of_the_machine_cancels():
    slow = (10.0, 30.0, 10.0)  # the second round took three times as long, for every run
    reference = point("reference", 4000, {}, cpu=slow, how="reference", model="hertz")
    chosen = point("chosen", 1000, {"e_n": 0.0}, cpu=tuple(s / 4.0 for s in slow))
    practice = point(
        "hertz-N50", 2000, {"e_n": 0.0}, cpu=tuple(s / 2.0 for s in slow), how="reduced_modulus", factor=1.0, n=50.0
    )
    found = conclude(trade([chosen, practice], {"e_n": 0.1}, reference=reference))
    over_reference, over_practice = found.speed_ups
    assert over_reference.steps == 4.0
    assert (over_reference.cpu.low, over_reference.cpu.median, over_reference.cpu.high) == (4.0, 4.0, 4.0)
    assert over_practice.cpu.median == 2.0
    assert "N = 50" in over_practice.over


def test_points_are_ordered_by_what_cost_means_for_the_scene():
    a = point("a", 100, {"e_n": 0.0}, cpu=(9.0,))
    b = point("b", 200, {"e_n": 0.0}, cpu=(1.0,))
    assert conclude(trade([a, b], {"e_n": 0.1})).chosen.candidate.name == "a"
    assert conclude(trade([a, b], {"e_n": 0.1}, cost="cpu_seconds")).chosen.candidate.name == "b"


def sign(changed, name="overlap_share"):
    return Sign(name=name, value=1.0, limit=0.5, source="made", changed=changed, text=f"{name} is 1.")


def test_softness_turns_between_two_factors():
    points = [
        point(f"p{k}", 100, {"e_n": 0.0}, factor=f, signs=[sign(f < 0.05)])
        for k, f in enumerate([1.0, 0.1, 0.01, 0.001])
    ]
    (turn,) = conclude(trade(points, {"e_n": 0.1})).turns
    assert (turn.at, turn.above) == (0.01, 0.1)


def test_what_the_reference_shows_already_is_no_matter_of_softness():
    reference = point("reference", 100, {}, how="reference", model="hertz", signs=[sign(True)])
    points = [point("soft", 100, {"e_n": 0.0}, factor=0.1, signs=[sign(True), sign(True, "leaking")])]
    found = trade(points, {"e_n": 0.1}, reference=reference)
    assert [turn.sign for turn in conclude(found).turns] == ["leaking"]
    texts = answer(found, conclude(found), ()).points
    assert any("reference" in text and "overlap_share" in text for text in texts)
    assert any("leaking" in text and "overlap_share" not in text for text in texts)


def test_next_to_a_chosen_contact_that_is_too_soft_stands_the_cheapest_that_is_not():
    points = [
        point("too_soft", 10, {"e_n": 0.0}, factor=0.01, signs=[sign(True)]),
        point("soft", 40, {"e_n": 0.0}, factor=0.1, signs=[sign(False)]),
        point("hard", 90, {"e_n": 0.0}, factor=1.0, signs=[sign(False)]),
    ]
    made = trade(points, {"e_n": 0.1})
    found = conclude(made)
    assert (found.chosen.candidate.name, found.unchanged.candidate.name) == ("too_soft", "soft")
    assert any(
        "leaves the physics unchanged" in text and "4 times the steps" in text
        for text in answer(made, found, ()).points
    )


def test_what_nothing_meets_is_said_with_metric_and_amount():
    made = trade(
        [point("near", 10, {"e_n": 0.03, "t_c": 0.0}), point("far", 5, {"e_n": 0.3})], {"e_n": 0.01, "t_c": 0.1}
    )
    found = conclude(made)
    assert found.nearest.candidate.name == "near"
    assert reach(found.nearest, "e_n") == pytest.approx(3.0)
    (text,) = answer(made, found, ()).points
    assert "e_n +3 %" in text and "1 % allowed" in text and "t_c" not in text
    assert to_dict(made, found, ())["chosen"] is None


def ran(name, cpu, errors, needed=None, **changes):
    """A point of a bed of which a tenth of 2 s ran, and what the whole takes."""
    made = point(name, 200_000, errors, cpu=cpu, **changes)
    errors = {
        m: replace(e, difference=replace(e.difference, needed_end=needed, chance=True)) for m, e in made.errors.items()
    }
    return replace(made, dt=1e-5, ran_share=0.1, errors=errors)


TOP = ran("reference", (100.0,), {}, how="reference", model="hertz")


def test_of_a_bed_undecided_is_not_called_outside_and_what_decides_is_said():
    points = [
        ran("wrong", (10.0,), {"z": (0.5, 0.1)}),
        ran("open", (40.0,), {"z": (0.01, 0.4)}, needed=1.5, factor=0.3),
        ran("dear", (60.0,), {"z": (0.0, 0.2)}, needed=1.2, factor=1.0),
    ]
    made = trade(points, {"z": 0.05}, cost="cpu_seconds", reference=TOP)
    found = conclude(made)
    # the cheapest that may be inside, though another is nearer
    assert (found.promising.candidate.name, found.nearest.candidate.name) == ("open", "dear")
    said = answer(made, found, ())
    assert (said.state, len(said.points)) == ("undecided", 2)
    assert re.search(r"1 [^,]*outside, 2 [^,]*undecided", said.sentence)
    assert "± 40 %" in said.points[0]
    # 1.3 s of 2 s are lacking of both: 0.65 (40 + 100) s
    assert all(words in said.points[1] for words in ("1.5 s", "91 CPU s", "--budget"))
    data = to_dict(made, found, ())
    assert (data["promising"], data["needed_end_time"]) == ("open", 1.5)


@pytest.mark.parametrize(("needed", "said"), [(4.0, ("run.until_time to 4", "2.8e+02 CPU s")), (None, ("not known",))])
def test_a_bed_too_short_to_decide_names_the_end_time(needed, said):
    made = trade(
        [ran("open", (40.0,), {"z": (0.01, 0.4)}, needed=needed)], {"z": 0.05}, cost="cpu_seconds", reference=TOP
    )
    assert all(words in answer(made, conclude(made), ()).points[1] for words in said)


def test_a_bed_of_which_all_is_outside_says_so():
    made = trade([ran("wrong", (10.0,), {"z": (0.5, 0.1)})], {"z": 0.05}, cost="cpu_seconds", reference=TOP)
    found = conclude(made)
    assert found.promising is None
    said = answer(made, found, ())
    assert said.state == "outside"
    assert "decide" not in "".join(said.all)


def test_of_averages_all_that_ran_stands_in_the_table():
    far = [ran("dear", (60.0,), {"z": (0.0, 9.0)}), ran("cheap", (10.0,), {"z": (5.0, 0.1)})]
    beds = trade(far, {"z": 0.05}, cost="cpu_seconds", reference=TOP)
    assert [p.candidate.name for p in shown_points(beds, conclude(beds))] == ["cheap", "dear"]
    sure = trade([point("far", 10, {"z": (5.0, 0.1)})], {"z": 0.05})
    assert shown_points(sure, conclude(sure)) == []


def test_tolerances_by_name_and_by_word():
    assert parse_tolerances(["restitution=1%", "overlap = 0.05", "t_c_2=3%"], FEW_PARTICLES) == pytest.approx(
        {"e_n": 0.01, "delta_max": 0.05, "delta_mean": 0.05, "t_c_2": 0.03}
    )
    assert parse_tolerances(["pressure=5%"], COUPLED) == {"pressure_drop": 0.05}


@pytest.mark.parametrize(
    ("text", "bed", "hint"),
    [
        ("restitution", False, "METRIC=SHARE"),
        ("restitution=0", False, "above 0"),
        ("restitution=-1%", False, "above 0"),
        ("restitution=nan", False, "above 0"),
        ("restitution=inf%", False, "above 0"),
        ("restitutoin=1%", False, "did you mean 'restitution'"),
        ("pressure_drop=1%", False, "expected one of"),
        ("restitution=1%", True, "expected one of"),
    ],
)
def test_a_bad_tolerance_is_refused_with_what_is_expected(text, bed, hint):
    with pytest.raises(InputError, match=hint):
        parse_tolerances([text], COUPLED if bed else FEW_PARTICLES)


def test_a_tolerance_given_twice_is_refused():
    with pytest.raises(InputError, match="e_n has one already"):
        parse_tolerances(["restitution=1%", "e_n=2%"], FEW_PARTICLES)
