"""The angle of a free surface: a line through the contour of half the bulk's solids fraction.

The solids are coarse-grained (`kncal.observe.coarse_graining`) in the plane across an axis, or as rings about a
vertical line for a cone. In each column the surface is where the solids fraction falls through half of the bulk's, seen
from the inside: single particles on or above it have no say. The line is that of Theil and Sen (median of all slopes)
over the flank: the columns between the first that are `FLANK` below the top and above the foot.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.observe.coarse_graining import Grid, grid_for
from kncal.observe.grains import Grains, Space

#: Shares of the height between foot and top that are left out at either end, and of the columns of a level surface.
FLANK = (0.15, 0.25)
#: Parts of a surface (sectors, slices) whose own angles give the width of one frame.
PARTS = 6
#: A surface whose heights differ by fewer widths of the kernel is level: its ends are left out by length instead.
_LEVEL = 3.0
_FEWEST = 5


@dataclass(frozen=True, kw_only=True)
class SurfaceFit:
    """A line through a surface, kept so that it can be drawn over the particles.

    Attributes
    ----------
    angle : to the horizontal, positive [degrees]
    error : 95 % half-width by the roughness of the surface alone [degrees]
    choice : how far it moves if less of the flank is fitted [degrees]
    s, h : (columns,) distance across, or from the cone's line, and height of the surface [m]
    fitted : (columns,) which were fitted
    slope, offset : h = offset + slope s [-], [m]
    across : (3,) unit vector of s; zeros for a cone
    """

    angle: float
    error: float
    choice: float
    s: Array
    h: Array
    fitted: NDArray[np.bool_]
    slope: float
    offset: float
    across: tuple[float, float, float]


def plane_directions(up: Sequence[float], axis: int) -> tuple[Array, Array]:
    """Return the unit vectors across ``axis`` (0, 1, 2): horizontal, and up as seen along it.

    Raises
    ------
    InputError
        If gravity is along the axis.
    """
    along = np.eye(3)[axis]
    upwards = np.asarray(up, dtype=np.float64) - along * up[axis]
    if np.linalg.norm(upwards) < 1e-9:
        raise InputError(f"observe.axis is {'xyz'[axis]}, along gravity: expected a horizontal one")
    upwards /= np.linalg.norm(upwards)
    return np.cross(along, upwards), upwards


def slope_fit(grains: Grains, space: Space, axis: int, width: float) -> SurfaceFit:
    """Fit the surface in the plane across ``axis``; ``width`` of the kernel [m].

    Raises
    ------
    InputError
        If fewer than `_FEWEST` columns hold particles, or gravity is along the axis.
    """
    across, upwards = plane_directions(space.up, axis)
    s, h = grains.x @ across, grains.x @ upwards
    grid = _grid_of(s, h, width)
    solids = grid.spread(np.column_stack([s, h]), grains.volume[:, None])[..., 0]
    at, heights = surface(grid, solids)
    return _fitted(at, heights, width, (float(across[0]), float(across[1]), float(across[2])))


def cone_fit(grains: Grains, space: Space, centre: Sequence[float], width: float) -> SurfaceFit:
    """Fit the surface about the vertical line through ``centre`` (3,) [m] as a cone; ``width`` of the kernel [m].

    Raises
    ------
    InputError
        If fewer than `_FEWEST` rings hold particles.
    """
    at, heights = _rings(grains, space, centre, width)
    return _fitted(at, heights, width, (0.0, 0.0, 0.0))


def seen_along(fit: SurfaceFit, grains: Grains, space: Space, centre: Sequence[float]) -> tuple[Array, Array, Array]:
    """Return where particles are in the picture of a fit: s and h [m], and their radii [m].

    Of a cone those are shown that a cut through its line meets.
    """
    if any(fit.across):
        across = np.asarray(fit.across)
        upwards = np.asarray(space.up) - across * float(np.dot(space.up, across))
        return grains.x @ across, grains.x @ (upwards / np.linalg.norm(upwards)), grains.radius
    a, b = _horizontal(space.up)
    delta = grains.x - np.asarray(centre)
    cut = np.abs(delta @ b) <= grains.radius
    return (delta @ a)[cut], (grains.x @ np.asarray(space.up))[cut], grains.radius[cut]


def parts_of_slope(grains: Grains, space: Space, axis: int, least: float) -> list[NDArray[np.bool_]]:
    """Return masks of the slices along ``axis``, each at least ``least`` [m] thick; one of all if there is no room."""
    along = grains.x[:, axis]
    count = int(np.clip((space.high[axis] - space.low[axis]) / least, 1, PARTS))
    edges = np.linspace(space.low[axis], space.high[axis], count + 1)
    part = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, count - 1)
    return [part == k for k in range(count)]


def parts_of_cone(grains: Grains, space: Space, centre: Sequence[float]) -> list[NDArray[np.bool_]]:
    """Return masks of `PARTS` sectors about the vertical line through ``centre`` (3,) [m]."""
    a, b = _horizontal(space.up)
    delta = grains.x - np.asarray(centre)
    part = np.floor((np.arctan2(delta @ b, delta @ a) / (2.0 * np.pi) + 0.5) * PARTS).astype(int) % PARTS
    return [part == k for k in range(PARTS)]


def angles_of_parts(fit: Callable[[Grains], SurfaceFit], grains: Grains, masks: list[NDArray[np.bool_]]) -> Array:
    """Return the angles [degrees] of the parts of a surface that have one."""
    found = []
    for mask in masks:
        try:
            found.append(fit(only(grains, mask)).angle)
        except InputError:
            continue
    return np.array(found)


def only(grains: Grains, mask: NDArray[np.bool_]) -> Grains:
    """Return some of the particles, by a mask (n,)."""
    names = ("x", "v", "spin", "radius", "mass", "kind", "row")
    return Grains(t=grains.t, **{name: getattr(grains, name)[mask] for name in names})


def surface(grid: Grid, solids: Array) -> tuple[Array, Array]:
    """Return positions and heights (columns,) [m] where solids (columns, rows) fall through half of the bulk's value.

    Of each column the longest dense stretch counts, up to its upper end, linear between cells; columns without one
    have no surface.
    """
    s, h = grid.centres
    level = 0.5 * bulk_value(solids)
    at, heights = [], []
    for i, column in enumerate(solids):
        dense = np.concatenate([[0], (column >= level).astype(int), [0]])
        begins, ends = np.flatnonzero(np.diff(dense) == 1), np.flatnonzero(np.diff(dense) == -1)
        if not len(begins):
            continue
        top = int(ends[(ends - begins).argmax()]) - 1
        if top == len(h) - 1:
            continue
        share = (column[top] - level) / (column[top] - column[top + 1])
        at.append(s[i])
        heights.append(h[top] + share * (h[top + 1] - h[top]))
    return np.array(at), np.array(heights)


def bulk_value(field: Array) -> float:
    """Return the value of a field inside a bed: the median of what exceeds half of its 95 % quantile where it is."""
    inside = field[field > 1e-3 * field.max()]
    return float(np.median(inside[inside > 0.5 * np.quantile(inside, 0.95)]))


def _grid_of(s: Array, h: Array, width: float) -> Grid:
    """Return a grid with room for the kernel all round, so that nothing is reflected."""
    if len(s) < 2:
        raise InputError(f"{len(s)} particles: expected a bed with a surface")
    low, high = [s.min(), h.min()], [s.max(), h.max()]
    room = 4.0 * width
    return grid_for(np.subtract(low, room).tolist(), np.add(high, room).tolist(), (False, False), width)


def _horizontal(up: Sequence[float]) -> tuple[Array, Array]:
    upwards = np.asarray(up, dtype=np.float64)
    a = np.cross(upwards, np.eye(3)[int(np.abs(upwards).argmin())])
    a /= np.linalg.norm(a)
    return a, np.cross(upwards, a)


def _rings(grains: Grains, space: Space, centre: Sequence[float], width: float) -> tuple[Array, Array]:
    """Return radii and heights of the surface; the solids of a ring are over its own volume.

    The field is mirrored at the line, so that the kernel sees the other side: each particle counts at r and at -r, over
    half the ring's volume.
    """
    delta = grains.x - np.asarray(centre)
    h = delta @ np.asarray(space.up)
    r = np.linalg.norm(delta - h[:, None] * np.asarray(space.up), axis=1)
    h = h + float(np.dot(centre, space.up))
    grid = _grid_of(np.concatenate([r, -r]), np.concatenate([h, h]), width)
    both = np.column_stack([np.concatenate([r, -r]), np.concatenate([h, h])])
    volume = np.concatenate([grains.volume, grains.volume])
    index, count = grid.index(both), int(np.prod(grid.cells))
    # over the volume before smoothing: a uniform packing is uniform up to the line, where rings are small
    ring = np.pi * np.maximum(np.abs(grid.centres[0]), 0.25 * grid.step[0]) * grid.step[0] * grid.step[1]
    solids = np.bincount(index, weights=volume, minlength=count).reshape(grid.cells) / ring[:, None]
    smooth = grid.spread(_points(grid), (solids * grid.cell).reshape(-1, 1))[..., 0]
    at, heights = surface(grid, smooth)
    outside = at > 0.0
    return at[outside], heights[outside]


def _points(grid: Grid) -> Array:
    return np.stack(np.meshgrid(*grid.centres, indexing="ij"), axis=-1).reshape(-1, len(grid.cells))


def _fitted(s: Array, h: Array, width: float, across: tuple[float, float, float]) -> SurfaceFit:
    from scipy.stats import theilslopes

    lines = []
    for share in FLANK:
        mask = _flank(s, h, width, share)
        if mask.sum() < _FEWEST:
            raise InputError(
                f"{mask.sum()} columns of the surface could be fitted: expected at least {_FEWEST}; set a smaller "
                "observe.width, or take more particles"
            )
        slope = float(theilslopes(h[mask], s[mask]).slope)
        lines.append((slope, float(np.median(h[mask] - slope * s[mask])), mask))
    slope, offset, mask = lines[0]
    angles = [float(np.degrees(np.arctan(abs(line[0])))) for line in lines]
    return SurfaceFit(
        angle=angles[0],
        error=_roughness(s[mask], h[mask], slope, offset, width),
        choice=abs(angles[1] - angles[0]),
        s=s,
        h=h,
        fitted=mask,
        slope=slope,
        offset=offset,
        across=across,
    )


def _roughness(s: Array, h: Array, slope: float, offset: float, width: float) -> float:
    """Return the 95 % half-width [degrees] of the angle of a line through a rough surface.

    Columns nearer than the kernel's correlation length 2 sqrt(pi) w are one sample; the slope of n samples over a
    length L has the standard error sigma sqrt(12/n)/L.
    """
    from scipy.stats import t as student

    length = float(np.ptp(s))
    samples = max(length / (2.0 * np.sqrt(np.pi) * width), 3.0)
    error = float((h - offset - slope * s).std()) * np.sqrt(12.0 / samples) / length
    return float(np.degrees(error / (1.0 + slope**2)) * student.ppf(0.975, samples - 1.0))


def _flank(s: Array, h: Array, width: float, share: float) -> NDArray[np.bool_]:
    """Mark the columns of the flank; those at either end, within two kernels of nothing, are never part of it."""
    inner = (s > s.min() + 2.0 * width) & (s < s.max() - 2.0 * width) if len(s) else np.zeros(0, dtype=bool)
    if inner.sum() < _FEWEST:
        return inner
    low, high = np.quantile(h[inner], [0.02, 0.98])
    if high - low < _LEVEL * width:
        ends = np.quantile(s[inner], [share, 1.0 - share])
        return _between(s, ends[0], ends[1], inner)
    rising = np.polyfit(s[inner], h[inner], 1)[0] > 0.0
    upper, lower = s[inner & (h >= high - share * (high - low))], s[inner & (h <= low + share * (high - low))]
    begin, end = (lower.max(), upper.min()) if rising else (upper.max(), lower.min())
    return _between(s, begin, end, inner)


def _between(s: Array, low: float, high: float, inner: NDArray[np.bool_]) -> NDArray[np.bool_]:
    found: NDArray[np.bool_] = inner & (s >= low) & (s <= high)
    return found
