"""Where particles are at the start, as far as it takes no solver: in a loose heap in a region, or as the case says."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.core.registry import Registry
from kncal.scene.scene import Scene

#: Lattice spacing and the largest random offset on each axis, in diameters: 1.12 - 2 x 0.04 > 1, so none overlap.
SPACING, OFFSET = 1.12, 0.04


@dataclass(frozen=True, kw_only=True)
class Start:
    """The particles at the start of a run; row i is the particle with id i + 1.

    Attributes
    ----------
    x, v, spin : (n, 3) [m], [m/s], [rad/s]
    kind : (n,) index of each one's size class in `Scene.classes`
    """

    x: Array
    v: Array
    spin: Array
    kind: NDArray[np.intp]

    @classmethod
    def at(cls, x: Array, v: Array | None = None, kind: NDArray[np.intp] | None = None) -> Start:
        """Return particles without spin at ``x`` (n, 3) [m], by default at rest, and all of the first class."""
        return cls(
            x=x,
            v=np.zeros_like(x) if v is None else v,
            spin=np.zeros_like(x),
            kind=np.zeros(len(x), dtype=np.intp) if kind is None else kind,
        )


def lattice(scene: Scene) -> Array:
    """Return centres (n, 3) [m] on a loose cubic lattice with small random offsets, filled from the floor up.

    No two particles touch, nor a wall. In a layer all are exactly in the middle plane.

    Raises
    ------
    InputError
        If the column is too small for them.
    """
    box, particles = scene.box, scene.group
    d, n = scene.diameter, scene.number
    layer = scene.front_back == "layer"
    sides = [_Sites.of(box.width, d), _Sites.of(box.depth, d, periodic=scene.front_back == "periodic")]
    sides.append(_Sites.of(box.height, d))
    if layer:
        sides[1] = _Sites(1, 0.5 * box.depth, 0.0)
    room = math.prod(side.number for side in sides)
    if room < n:
        raise InputError(
            f"{scene.name}: a loose lattice of the column {box.width:g} x {box.depth:g} x {box.height:g} m "
            f"has {room} places, the bed {n} particles: expected a larger column (height) or fewer particles"
        )
    # only the places that are taken: a large column has more of them than fit into memory
    grid, rest = np.empty((n, 3)), np.arange(n)
    for axis, side in enumerate(sides):
        rest, place = np.divmod(rest, min(side.number, n))
        grid[:, axis] = side.first + side.spacing * place
    offset = np.random.default_rng(particles.seed).uniform(-OFFSET * d, OFFSET * d, (n, 3))
    if layer:
        offset[:, 1] = 0.0
    return np.ascontiguousarray(grid + offset)


class _Sites(NamedTuple):
    """Lattice sites along one side: their number, the first [m] and the spacing [m]."""

    number: int
    first: float
    spacing: float

    @classmethod
    def of(cls, length: float, d: float, *, periodic: bool = False) -> _Sites:
        """Return the sites along a side of ``length`` [m], with the offset's room at both ends."""
        if periodic:
            number = math.floor(length / (SPACING * d))
            first, spacing = 0.5 * length / max(number, 1), length / max(number, 1)
        else:
            free = length - (1.0 + 2.0 * OFFSET) * d
            number = math.floor(free / (SPACING * d)) + 1 if free >= 0.0 else 0
            first, spacing = (0.5 + OFFSET) * d, SPACING * d
        return cls(number, first, spacing)


def given(scene: Scene) -> Array:
    """Return the centres (n, 3) [m] that the case gives; InputError if they are of another shape or not finite."""
    particles = scene.group
    positions = np.array(particles.centres, dtype=np.float64)
    if positions.shape != (scene.number, 3) or not np.isfinite(positions).all():
        raise InputError(
            f"{scene.name}: positions of shape {positions.shape}: expected ({scene.number}, 3) finite numbers, "
            "x, y, z for each particle"
        )
    return positions


def _later(scene: Scene) -> Array:
    """Return no centres: LIGGGHTS inserts these particles during the run."""
    del scene
    return np.zeros((0, 3))


@dataclass(frozen=True, kw_only=True)
class Placement:
    """A way to place particles: ``place`` returns their centres (n, 3) [m]; ``settles``: an engine lets them down."""

    name: str
    place: Callable[[Scene], Array]
    settles: bool = False


PLACEMENTS = Registry(
    "place",
    Placement,
    Placement(name="settled", place=lattice, settles=True),
    Placement(name="lattice", place=lattice),
    Placement(name="given", place=given),
    Placement(name="stream", place=_later),
)
