"""How particles are packed: solids fraction, its profile, contacts of each particle, fabric, overlaps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.observe.coarse_graining import grid_for
from kncal.observe.grains import Grains, Space
from kncal.observe.mixing import cells_of
from kncal.observe.surface import bulk_value

_T = TypeVar("_T", bound=np.generic)
#: What is nearer than this many widths of the kernel to a wall or a surface is not bulk.
AWAY = 2.0


@dataclass(frozen=True, kw_only=True)
class Bulk:
    """What lies inside a packing, away from walls and surfaces, found from the solids fraction alone.

    Attributes
    ----------
    fraction : solids fraction [-]; parts : (p,) of eight parts of it, fewer of a small one
    grains : (n,) which particles lie in it
    volume : of the bulk [m³]
    """

    fraction: float
    parts: Array
    grains: NDArray[np.bool_]
    volume: float


@dataclass(frozen=True, kw_only=True)
class Contacts:
    """The contacts between particles.

    Attributes
    ----------
    pairs : (c, 2) rows of the two particles
    normal : (c, 3) unit vectors from the first to the second
    overlap : (c,) [m]; share : (c,) overlap over the smaller diameter [-]
    """

    pairs: NDArray[np.int64]
    normal: Array
    overlap: Array
    share: Array


@dataclass(frozen=True, kw_only=True)
class Packed:
    """The packing of one frame, in its bulk.

    Attributes
    ----------
    bulk : Bulk
    coordination : mean number of contacts of a particle that is no rattler
    precision : how much of it hangs on whether pairs at the limit of the positions' precision touch
    rattlers : share of particles that carry nothing
    anisotropy, chance : see `anisotropy`; NaN without contacts
    each : (p, 2) coordination and rattlers of eight parts of the bulk
    """

    bulk: Bulk
    coordination: float
    precision: float
    rattlers: float
    anisotropy: float
    chance: float
    each: Array


def packed(grains: Grains, space: Space, width: float, resolution: float, least: int) -> Packed:
    """Return the packing of a frame.

    Parameters
    ----------
    width : of the coarse-graining kernel [m]
    resolution : to which positions are known [m]
    least : contacts without which a particle carries nothing: D + 1 without friction, 2 with it

    Raises
    ------
    InputError
        If there is no bulk.
    """
    inside = bulk(grains, space, width)
    found = contacts(grains, space, resolution)
    carry, number = backbone(found, ~inside.grains, least)
    rows = np.flatnonzero(inside.grains)
    if len(rows) < 2:
        raise InputError("fewer than two particles are farther inside: expected a larger packing")
    sure = number - np.bincount(found.pairs[np.abs(found.overlap) <= resolution].ravel(), minlength=len(number))

    def numbers(part: NDArray[np.int64]) -> tuple[float, float, tuple[float, float]]:
        those = part[carry[part]]
        among = np.zeros(len(carry), dtype=bool)
        among[those] = True
        touching = among[found.pairs].any(axis=1)
        turned = anisotropy(found.normal[touching]) if touching.any() else (np.nan, np.nan)
        return float(number[those].mean()) if len(those) else 0.0, 1.0 - len(those) / max(len(part), 1), turned

    mean, rattlers, turned = numbers(rows)
    cell = cells_of(grains.x[rows], max(len(rows) // 8, 1))
    lost = mean - float(sure[rows[carry[rows]]].mean()) if carry[rows].any() else 0.0
    return Packed(
        bulk=inside,
        coordination=mean,
        precision=lost,
        rattlers=rattlers,
        anisotropy=turned[0],
        chance=turned[1],
        each=np.array([numbers(rows[cell == k])[:2] for k in range(int(cell.max()) + 1)]),
    )


def bulk(grains: Grains, space: Space, width: float) -> Bulk:
    """Return the bulk of a packing and its solids fraction; ``width`` of the coarse-graining kernel [m].

    Bulk are the cells that are farther than `AWAY` widths, along each axis, from where the fraction falls below half of
    the bulk's own value: from walls and surfaces, whatever their shape. There the smoothed fraction is that of the
    packing but for the tail of the kernel.

    Raises
    ------
    InputError
        If nothing is that far inside.
    """
    from scipy.ndimage import distance_transform_cdt

    if not len(grains.x):
        raise InputError("no particle is there: expected a packing")
    grid = grid_for(*_room(grains.x, space, width), space.periodic, width)
    solids = grid.spread(space.wrapped(grains.x), grains.volume[:, None])[..., 0]
    dense = solids >= 0.5 * bulk_value(solids)
    around = [(n, n) if p else (1, 1) for n, p in zip(grid.cells, space.periodic, strict=True)]
    padded = np.pad(dense, [(0, 0) if p else (1, 1) for p in space.periodic])
    padded = np.pad(padded, [pad if p else (0, 0) for pad, p in zip(around, space.periodic, strict=True)], mode="wrap")
    inside = slice_back(distance_transform_cdt(padded), around) * grid.step.min() > AWAY * width
    inside |= np.full(grid.cells, bool(dense.all() and all(space.periodic)))
    if not inside.any():
        raise InputError(
            f"nothing is farther than {AWAY * width:g} m from a wall or surface: expected a larger packing"
        )
    places = np.argwhere(inside).astype(np.float64)
    part = cells_of(places, max(len(places) // 8, 1)) if len(places) > 1 else np.zeros(len(places), np.int64)
    return Bulk(
        fraction=float(solids[inside].mean()),
        parts=np.bincount(part, weights=solids[inside]) / np.bincount(part),
        grains=inside.ravel()[grid.index(space.wrapped(grains.x))],
        volume=float(inside.sum()) * grid.cell,
    )


def slice_back(field: NDArray[_T], around: list[tuple[int, int]]) -> NDArray[_T]:
    """Return a field (3 dimensions) without the cells that were put around it."""
    return field[tuple(slice(low, n - high) for (low, high), n in zip(around, field.shape, strict=True))]


def _room(x: Array, space: Space, width: float) -> tuple[list[float], list[float]]:
    """Return corners round particles with room for the kernel, so that nothing is reflected; periodic sides stay."""
    low = np.where(space.periodic, space.low, x.min(axis=0) - 4.0 * width)
    high = np.where(space.periodic, space.high, x.max(axis=0) + 4.0 * width)
    return low.tolist(), high.tolist()


def contacts(grains: Grains, space: Space, beyond: float = 0.0) -> Contacts:
    """Return all contacts between particles: pairs nearer than the sum of their radii plus ``beyond`` [m]."""
    from scipy.spatial import cKDTree

    if not len(grains.x):
        empty = np.zeros(0)
        return Contacts(pairs=np.zeros((0, 2), np.int64), normal=np.zeros((0, 3)), overlap=empty, share=empty)
    x = space.wrapped(grains.x)
    inside = x - np.asarray(space.low)
    inside[(inside >= space.size) & space.periodic] = 0.0  # by rounding
    tree = cKDTree(inside, boxsize=np.where(space.periodic, space.size, 0.0))
    reach = 2.0 * float(grains.radius.max()) + beyond
    pairs: NDArray[np.int64] = tree.query_pairs(reach, output_type="ndarray").astype(np.int64)
    delta = space.nearest(x[pairs[:, 1]] - x[pairs[:, 0]])
    distance = np.linalg.norm(delta, axis=1)
    radii = grains.radius[pairs]
    overlap = radii.sum(axis=1) - distance
    touch = (overlap > -beyond) & (distance > 0.0)
    return Contacts(
        pairs=pairs[touch],
        normal=delta[touch] / distance[touch, None],
        overlap=overlap[touch],
        share=overlap[touch] / (2.0 * radii[touch].min(axis=1)),
    )


def backbone(found: Contacts, held: NDArray[np.bool_], least: int) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Return which particles (n,) carry something, and the number of contacts (n,) with such that each of them has.

    The others are rattlers: they have fewer than ``least`` contacts with particles that carry, found by leaving them
    out until no more are. ``held`` (n,) are never rattlers: those at walls, whose other contacts are not known.
    """
    carry = np.ones(len(held), dtype=bool)
    while True:
        both = carry[found.pairs].all(axis=1)
        number = np.bincount(found.pairs[both].ravel(), minlength=len(held)).astype(np.int64)
        loose = carry & ~held & (number < least)
        if not loose.any():
            return carry, number
        carry &= ~loose


def fabric(normal: Array) -> Array:
    """Return the fabric tensor (3, 3) of contacts: the mean of n n, with the trace 1."""
    if not len(normal):
        raise InputError("no contact: expected some for a fabric tensor")
    return normal.T @ normal / len(normal)


def anisotropy(normal: Array) -> tuple[float, float]:
    """Return sqrt(3/2 a:a) with a = 15/2 (F - I/3) of the fabric tensor F, and what chance alone gives of so many.

    The second is taken off in the mean square, so that the first is 0 for an isotropic fabric. a is that of Bathurst &
    Rothenburg (Mech. Mater. 9 (1990) 65) for a distribution of normals (1 + n a n)/4 pi.
    """
    tensor = fabric(normal)
    square = float((tensor**2).sum())
    chance = (1.0 - square) / max(len(normal) - 1, 1)
    excess = max(square - 1.0 / 3.0 - chance, 0.0)
    return float(7.5 * np.sqrt(1.5 * excess)), float(7.5 * np.sqrt(1.5 * chance))
