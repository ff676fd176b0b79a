"""The time-keeping of a trade, by its properties: never more than there is, and more time never buys less."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kncal.core.errors import InputError
from kncal.study.trade.budget import FEWEST, Budget, affordable, limit_of, rounds_of, spread

models = st.lists(st.sampled_from(["linear", "hertz"]), min_size=1, max_size=40)
seconds = st.floats(0.0, 1e6)
lanes = st.integers(1, 8)
overheads = st.floats(0.0, 10.0)


def wall(runs, limit, at_once, overhead):
    """Wall-clock time of runs that all take their limit: those of a model side by side, model after model."""
    return sum(math.ceil(runs.count(model) / at_once) * (limit + overhead) for model in set(runs))


@given(models, seconds, lanes, overheads)
def test_a_round_takes_no_longer_than_it_has(runs, given_seconds, at_once, overhead):
    limit = limit_of(runs, given_seconds, at_once, overhead)
    assert wall(runs, limit, at_once, overhead) <= given_seconds * (1.0 + 1e-9) + 1e-9


@given(models, seconds, lanes, overheads)
def test_rounds_of_growing_length_end_in_time(runs, given_seconds, at_once, overhead):
    """All in the first round, half of them in the next: none takes longer, and each run's limit only grows."""
    count = affordable(runs, given_seconds, at_once, overhead, 1.0)
    alive, rounds, left, before = runs[:count], rounds_of(count), given_seconds, 1.0
    while rounds and alive:
        limit = limit_of(alive, left / rounds, at_once, overhead)
        assert limit >= before * (1.0 - 1e-9) - 1e-9
        left -= wall(alive, limit, at_once, overhead)
        assert left >= -1e-9 * given_seconds
        alive, rounds, before = alive[: max((len(alive) + 1) // 2, FEWEST)], rounds - 1, limit
    assert len(alive) <= FEWEST


@given(models, seconds, seconds, lanes, overheads)
def test_more_time_affords_no_fewer_runs(runs, one, two, at_once, overhead):
    fewer, more = (affordable(runs, s, at_once, overhead, 5.0) for s in sorted((one, two)))
    assert fewer <= more


@given(st.integers(0, 30))
def test_every_place_has_its_turn_once_and_the_first_lie_far_apart(number):
    order = spread(number)
    assert sorted(order) == list(range(number))
    if number >= 7:
        first = sorted(order[:3])
        assert min(b - a for a, b in itertools.pairwise(first)) >= number // 4


class Clock:
    def __init__(self) -> None:
        self.now = 5.0

    def __call__(self) -> float:
        return self.now


def test_a_budget_counts_down_and_no_budget_has_no_end():
    clock = Clock()
    budget = Budget(10.0, clock)
    clock.now += 7.0
    assert (budget.spent(), budget.left()) == (7.0, 3.0)
    clock.now += 7.0
    assert budget.left() == 0.0
    assert Budget(None, clock).left() == math.inf
    with pytest.raises(InputError, match="budget"):
        Budget(0.0)
