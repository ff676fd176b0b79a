"""Flow rates of arrivals at random, and what the walls of a silo carry by Janssen's law."""

from __future__ import annotations

import numpy as np
import pytest

from kncal.core.errors import InputError
from kncal.observe.discharge import discharge
from kncal.observe.wall_forces import silo, upright
from kncal.scene.walls import CylinderWall, DiscWall, PlaneWall, PlateWall

MASS, DT = 1.3e-5, 0.01


def arrivals(rng, rate):
    """What Poisson arrivals of ``rate`` (n,) [1/s] have brought until each time."""
    t = DT * np.arange(len(rate) + 1)
    return t, MASS * np.concatenate([[0.0], np.cumsum(rng.poisson(rate * DT))])


def test_the_interval_of_a_rate_covers_it_as_often_as_it_says():
    rng, rate, hits = np.random.default_rng(1), 2000.0, 0
    for _ in range(120):
        found = discharge(*arrivals(rng, np.full(400, rate))).rate
        assert found.reliable
        hits += abs(found.mean - rate * MASS) <= found.uncertainty
    assert hits >= 106, "95 % less three standard deviations of chance"


def test_only_the_steady_part_counts():
    """A flow that begins late and slowly, is steady, and falls while the vessel runs empty."""
    rng = np.random.default_rng(2)
    rate = 3000.0 * np.concatenate([np.zeros(50), np.linspace(0.1, 1.0, 40), np.ones(500), np.linspace(1.0, 0, 120)])
    t, out = arrivals(rng, np.concatenate([rate, np.zeros(100)]))
    found = discharge(t, out)
    assert 0.6 < found.begin < 1.2 and 5.6 < found.end < 6.7
    assert found.rate.mean == pytest.approx(3000.0 * MASS, rel=0.015)
    assert abs(found.rate.mean - 3000.0 * MASS) < 2.0 * found.rate.uncertainty


def test_what_does_not_flow_has_no_rate():
    t = DT * np.arange(200)
    with pytest.raises(InputError, match="passed"):
        discharge(t, np.zeros(200))
    few = np.zeros(200)
    few[100:103] = MASS * np.arange(1, 4)
    few[103:] = few[102]
    with pytest.raises(InputError, match="intervals"):
        discharge(t, few)


@pytest.mark.parametrize("length", [0.01, 0.05])
def test_walls_that_follow_janssen_give_his_length_and_the_sum_is_the_weight(length):
    per_height, top = 12.0, 0.2
    edges = np.linspace(0.0, 0.25, 51)
    low, high = np.minimum(edges[:-1], top), np.minimum(edges[1:], top)
    depth = top - edges.clip(max=top)
    through = per_height * length * (1.0 - np.exp(-depth / length))
    weight = per_height * (high - low)
    carried = weight - (through[:-1] - through[1:])
    found = silo(edges, weight, carried)
    assert found.through == pytest.approx(through, abs=1e-12)
    assert found.length == pytest.approx(length, rel=0.02)
    assert found.top == pytest.approx(top, rel=1e-6)
    assert found.limit == pytest.approx(per_height * length, rel=0.02)
    assert found.through[0] + carried.sum() == pytest.approx(weight.sum(), rel=1e-12)


def test_smooth_walls_carry_nothing_and_an_empty_silo_has_no_length():
    edges = np.linspace(0.0, 0.2, 21)
    assert silo(edges, np.ones(20), np.zeros(20)).length == np.inf
    with pytest.raises(InputError, match="bins"):
        silo(edges, np.zeros(20), np.zeros(20))


def test_walls_stand_or_are_floors_against_gravity():
    up, tilted = (0.0, 0.0, 1.0), (0.5, 0.0, np.sqrt(0.75))
    floor, side = (PlaneWall(shape="plane", material="rigid", axis=axis, position=0.0) for axis in "zx")
    assert [upright(floor, up), upright(floor, tilted), upright(side, up)] == [False, False, True]
    assert upright(CylinderWall(shape="cylinder", radius=1.0), up) is True
    assert upright(DiscWall(shape="disc", centre=(0.0, 0.0, 0.0), radius=1.0), up) is False
    plate = PlateWall(shape="plate", corner=(0.0, 0.0, 0.0), edge_1=(1.0, 0.0, 0.0), edge_2=(0.0, 0.0, 1.0))
    assert upright(plate, up) is True and upright(None, up) is None
