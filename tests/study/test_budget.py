"""The time-keeping of a trade, by its properties: never more than there is, and more time never buys less."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kncal.core.errors import InputError
from kncal.study.trade.budget import Budget, Work, affordable, allocate, bisection_order, weighted

LONGEST = 2.0
rates = st.floats(1e-2, 1e5)
capacities = st.floats(0.0, 1e6)


@st.composite
def works(draw):
    given_rates = draw(st.lists(rates, min_size=1, max_size=12))
    return [
        Work(
            name=f"run-{k}",
            rate=rate,
            done=draw(st.floats(0.0, LONGEST)),
            weight=draw(st.floats(1.0, 50.0)),
        )
        for k, rate in enumerate(given_rates)
    ]


def cost(given_works, times) -> float:
    return sum(w.rate * (times[w.name] - w.done) for w in given_works)


@given(works(), capacities)
def test_never_plans_more_than_there_is_and_never_takes_back(runs, capacity):
    times = allocate(runs, capacity, LONGEST)
    # a hundred halvings end at rounding of the sum
    assert cost(runs, times) <= capacity + 1e-9 * max(capacity, sum(w.rate for w in runs) * LONGEST)
    assert all(w.done <= times[w.name] <= LONGEST for w in runs)


@given(works(), capacities, capacities)
def test_more_time_makes_no_run_shorter(runs, one, two):
    less, more = (allocate(runs, capacity, LONGEST) for capacity in sorted((one, two)))
    assert all(less[name] <= more[name] * (1.0 + 1e-9) for name in less)


@given(works())
def test_with_time_enough_all_run_to_their_end(runs):
    times = allocate(runs, 2.0 * sum(w.rate for w in runs) * LONGEST, LONGEST)
    assert list(times.values()) == pytest.approx([LONGEST] * len(runs), rel=1e-12)


@given(st.lists(st.tuples(rates, st.floats(1.0, 50.0)), min_size=2, max_size=8))
def test_the_summed_variance_is_least(given_runs):
    """Any other split of the same time between two runs gives a larger sum of w/T (no run at its limit)."""
    runs = [Work(name=str(k), rate=rate, weight=weight) for k, (rate, weight) in enumerate(given_runs)]
    capacity = 1e-3 * LONGEST * min(w.rate for w in runs)
    times = allocate(runs, capacity, LONGEST)
    best = sum(w.weight / times[w.name] for w in runs)
    a, b = runs[0], runs[-1]
    for share in (0.3, -0.3):
        moved = share * min(a.rate * times[a.name], b.rate * times[b.name])
        other = times | {a.name: times[a.name] + moved / a.rate, b.name: times[b.name] - moved / b.rate}
        assert sum(w.weight / other[w.name] for w in runs) > best


def test_of_equal_cost_the_reference_runs_root_n_times_as_long():
    runs = [Work(name=str(k), rate=100.0) for k in range(10)]
    times = allocate(weighted(runs), 100.0, LONGEST)
    assert times["0"] / times["1"] == pytest.approx(3.0)  # nine comparisons rest on it


@given(st.lists(rates, min_size=1, max_size=8), capacities, capacities)
def test_more_time_affords_no_fewer_runs(given_rates, one, two):
    runs = [Work(name=str(k), rate=rate) for k, rate in enumerate(given_rates)]
    fewer, more = (affordable(runs, capacity, LONGEST, 0.5 * LONGEST) for capacity in sorted((one, two)))
    assert fewer <= more
    if fewer:
        times = allocate(weighted(runs[:fewer]), min(one, two), LONGEST)
        assert min(times.values()) >= 0.5 * LONGEST * (1.0 - 1e-9)


class Clock:
    def __init__(self) -> None:
        self.now = 5.0

    def __call__(self) -> float:
        return self.now


def test_a_budget_counts_down_and_no_budget_has_no_end():
    clock = Clock()
    budget = Budget(10.0, clock)
    assert budget.allows(10.0)
    assert not budget.allows(10.1)
    clock.now += 7.0
    assert (budget.spent(), budget.left()) == (7.0, 3.0)
    clock.now += 7.0
    assert budget.left() == 0.0
    assert Budget(None, clock).left() == math.inf
    assert Budget(None, clock).allows(1e99)
    with pytest.raises(InputError, match="budget"):
        Budget(0.0)


FACTORS = tuple(1.0 / 3.0**k for k in range(12))


@given(st.integers(0, 11))
def test_the_edge_is_found_by_halving(edge):
    """Whatever the edge, it takes at most as many runs as halving twelve factors does."""
    inside = {FACTORS[0]: True}
    tried = 0
    while True:
        order = bisection_order(FACTORS, inside)
        bad = [k for k, f in enumerate(FACTORS) if inside.get(f) is False]
        good = max(k for k, f in enumerate(FACTORS) if inside.get(f))
        if min(bad, default=len(FACTORS)) - good == 1:
            break
        factor = order[0]
        inside[factor] = FACTORS.index(factor) <= edge
        tried += 1
    assert good == edge
    assert tried <= math.ceil(math.log2(len(FACTORS)))


@given(st.dictionaries(st.sampled_from(FACTORS), st.booleans()))
def test_every_factor_has_its_turn_once(inside):
    order = bisection_order(FACTORS, inside)
    assert sorted(order) == sorted(set(FACTORS) - set(inside))
