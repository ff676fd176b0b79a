"""Filled regions: every sphere inside, off the walls, and none in another, looked for pair by pair."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest
from numpy.typing import NDArray

from kncal.core.errors import InputError
from kncal.scene.filling import fill

Array = NDArray[np.float64]
pytestmark = pytest.mark.slow


class Block:
    """A box, or the upright cylinder in it."""

    def __init__(self, size: tuple[float, float, float], *, round_: bool = False) -> None:
        self.size, self.round = np.array(size), round_

    @property
    def bounds(self) -> tuple[Array, Array]:
        return np.zeros(3), self.size

    def inside(self, points: Array, margin: Array | float = 0.0) -> Array:
        gap = np.minimum(points, self.size - points)
        if self.round:
            away = 0.5 * self.size[0] - np.linalg.norm(points[:, :2] - 0.5 * self.size[:2], axis=1)
            return np.asarray(np.minimum(gap[:, 2], away) >= margin)
        return np.asarray(gap.min(axis=1) >= margin)


def least_gap(x: Array, radii: Array, period: Array | None = None) -> float:
    """Over every pair, and every image of it."""
    shifts = [np.zeros(3)]
    if period is not None:
        shifts = [np.array(s) * period for s in itertools.product(*[(-1, 0, 1) if p else (0,) for p in period])]
    least = np.inf
    for shift in shifts:
        distance = np.linalg.norm(x[:, None] - x[None] + shift, axis=2)
        gap = distance - radii[:, None] - radii[None]
        if not shift.any():
            np.fill_diagonal(gap, np.inf)
        least = min(least, float(gap.min()))
    return least


def share(radii: Array, volume: float) -> float:
    return float(4.0 / 3.0 * np.pi * np.sum(radii**3)) / volume


@pytest.mark.parametrize("filled", [0.2, 0.4])
def test_a_box_of_two_sizes(filled: float) -> None:
    """Up to 0.3 by chance alone, above it by pushing apart."""
    radii = np.repeat([0.04, 0.08], [400, 50])
    side = (share(radii, 1.0) / filled) ** (1 / 3)
    x = fill(Block((side,) * 3), radii, 1)
    assert least_gap(x, radii) >= 0.0
    assert np.all((x >= radii[:, None]) & (x <= side - radii[:, None]))
    assert np.array_equal(x, fill(Block((side,) * 3), radii, 1))
    assert not np.array_equal(x, fill(Block((side,) * 3), radii, 2))


def test_a_periodic_box_holds_more() -> None:
    radii = np.full(200, 0.05)
    side = (share(radii, 1.0) / 0.55) ** (1 / 3)
    x = fill(Block((side,) * 3), radii, 1, periods={axis: (0.0, side) for axis in range(3)})
    assert least_gap(x, radii, np.full(3, side)) >= 0.0
    near = np.min(np.minimum(x, side - x), axis=0)
    assert np.all((near >= 0.0) & (near < 0.05))  # spheres lie across the faces, centres inside


def test_a_cylinder_with_a_wall_and_spheres_in_it() -> None:
    """What is there already stays where it is, and a tilted wall is not touched."""
    radii, normal = np.full(150, 0.05), np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)
    held = np.array([[0.5, 0.5, 1.5]])

    def free(points: Array, r: Array) -> NDArray[np.bool_]:
        return np.asarray((points - np.array([0.5, 0.5, 0.5])) @ normal >= r)

    x = fill(Block((1.0, 1.0, 2.0), round_=True), radii, 1, free=free, taken=(held, np.array([0.2])))
    assert least_gap(np.vstack([x, held]), np.append(radii, 0.2)) >= 0.0
    assert free(x, radii).all()
    assert np.linalg.norm(x[:, :2] - 0.5, axis=1).max() <= 0.45


def test_places_are_even() -> None:
    """Far below the first contact numbers in eighths of a periodic box are those of chance: chi² of 7 freedoms."""
    radii = np.full(4000, 1e-3)
    x = fill(Block((1.0, 1.0, 1.0)), radii, 1, periods={axis: (0.0, 1.0) for axis in range(3)})
    numbers = np.bincount((x > 0.5) @ [1, 2, 4], minlength=8)
    assert np.sum((numbers - 500.0) ** 2 / 500.0) < 24.3  # 0.1 %


@pytest.mark.parametrize(("count", "side"), [(1000, 0.5), (130, 0.5)])
def test_too_many_say_how_many_fit(count: int, side: float) -> None:
    """The number that is told does fit."""
    radii = np.full(count, 0.05)
    with pytest.raises(InputError, match="fit") as told:
        fill(Block((side,) * 3), radii, 1)
    found = re.search(r"about (\d+) of them", str(told.value))
    assert found is not None
    assert 0 < int(found[1]) < count
    small = int(0.7 * int(found[1]))
    assert len(fill(Block((side,) * 3), radii[:small], 1)) == small


def test_no_room_at_all_is_told() -> None:
    with pytest.raises(InputError, match="about 0 of them"):
        fill(Block((0.05, 1.0, 1.0)), np.full(3, 0.05), 1)
