"""The law of cost: exponents and intervals of data whose law is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trades import point, trade

from kncal.core.errors import InputError
from kncal.study.trade.cost_law import RESOLVED, fit_cost, includes, laws, slope, widest

K = np.logspace(2, 6, 9)


@given(st.floats(-1.0, 1.0), st.floats(1e-6, 1e3))
def test_an_exact_power_law_is_found_exactly(exponent, factor):
    found = slope(K, factor * K**exponent)
    # rounding only: logarithms of 1e-6 to 1e9 carry a few 1e-15 each
    assert found.exponent.value == pytest.approx(exponent, abs=1e-12)
    assert found.exponent.width < 1e-9


def test_the_interval_covers_the_true_exponent_as_often_as_it_says():
    rng = np.random.default_rng(1)
    trials = 400
    inside = sum(
        includes(slope(K, 3.0 * K**0.5 * np.exp(rng.normal(0.0, 0.05, K.size))).exponent, 0.5) for _ in range(trials)
    )
    # binomial: 0.95 ± four standard deviations of 400 trials
    assert inside / trials == pytest.approx(0.95, abs=4.0 * np.sqrt(0.95 * 0.05 / trials))


def test_the_fit_of_start_and_steps_covers_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(2)
    steps = np.repeat(np.logspace(2, 6, 7), 3)
    trials, inside = 400, np.zeros(2)
    for _ in range(trials):
        found = fit_cost(steps, (0.1 + 1e-6 * steps) * (1.0 + rng.normal(0.0, 0.05, steps.size)))
        inside += [includes(found.start, 0.1), includes(found.per_step, 1e-6)]
    # weights from the noisy times themselves bias the fit by their variance (0.05² = 0.25 %), a tenth of its interval
    assert inside / trials == pytest.approx([0.95, 0.95], abs=4.0 * np.sqrt(0.95 * 0.05 / trials) + 0.02)


def test_the_law_holds_only_where_the_steps_outweigh_the_start():
    # cost = start + k^(1/2): the local exponent is (1/2)/(1 + start/k^(1/2)), nearly 0 below k = start², 1/2 above
    rng = np.random.default_rng(4)
    k = np.repeat(np.logspace(0, 12, 25), 3)
    cost = (1e3 + np.sqrt(k)) * np.exp(rng.normal(0.0, 0.05, k.size))  # three rounds with a spread of 5 %
    found = widest(k, cost)
    # at k = 1e6 the local exponent is 1/4, farther from 1/2 than a slope over half a decade is known
    assert found.k_low > 1e6
    assert found.k_high == k[-1]
    assert includes(found.exponent, 0.5) and found.exponent.width <= RESOLVED
    # below it, where the start outweighs the steps, there is no such range
    assert widest(k[:36], cost[:36]) is None
    assert not slope(k, cost).holds


def test_a_slope_that_is_not_known_well_enough_does_not_hold():
    rng = np.random.default_rng(3)
    noisy = K**0.5 * np.exp(rng.normal(0.0, 2.0, K.size))
    assert slope(K, noisy).exponent.width > RESOLVED
    assert not slope(K, noisy).holds


def test_the_family_of_a_trade_is_the_softened_contacts_at_one_n():
    cost = {k: (0.5 + 1e-3 * np.sqrt(k) * 100.0) for k in K}
    points = [
        point(
            f"p{i}-{n:g}",
            round(100 * np.sqrt(k) * n),
            {"e_n": 0.0},
            cpu=(cost[k] * n, 1.01 * cost[k] * n),
            n=n,
            k_n=k,
            factor=k / K[-1],
            how="mean_overlap" if k == K[-1] else "softened",
        )
        for i, k in enumerate(K)
        for n in (10.0, 20.0)
    ]
    other = point("other", 7, {"e_n": 0.0}, cpu=(1e6, 1e6), how="contact_duration", factor=1.07, k_n=7.0)
    (law,) = laws(trade([*points, other], {"e_n": 0.1}))
    assert law.family == "linear"
    assert law.steps_per_contact == 20.0
    assert law.k_n == tuple(sorted(K))
    # rounding to whole steps: half a step of 20 000 at least
    assert law.by_steps.exponent.value == pytest.approx(0.5, abs=1e-4)


@pytest.mark.parametrize("bad", [[1.0, 2.0], [1.0, 1.0, 1.0], [0.0, 1.0, 2.0]])
def test_too_few_stiffnesses_give_no_slope(bad):
    with pytest.raises(InputError, match="expected three positive costs"):
        slope(bad, [1.0] * len(bad))


def test_what_every_run_costs_has_its_name():
    """Of a single contact the solver's start; of a bed the gas, and what is exchanged with it."""
    points = [
        point(f"p{k}", 10**k, {"e_n": 0.0}, cpu=(10.0 + 10.0 ** (k - 3),), k_n=10.0 ** (2 * k), factor=10.0**-k)
        for k in range(2, 7)
    ]
    for fixed in ("the start of the solver", "gas and exchange"):
        text = " ".join(laws(trade(points, {"e_n": 0.1}, fixed=fixed))[0].sentences)
        assert f"for {fixed}" in text and f"more than half of it is {fixed}" in text
