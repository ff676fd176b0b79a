"""Fields of density, velocity and granular temperature from particles, by coarse graining.

A particle's mass is spread over a Gaussian of a stated width w, cut off at 3 w and normalised, so that the integral of
the density is the mass to rounding: at periodic sides it goes round, at others it is reflected. A particle is first
shared between the nearest cells of w/3, which keeps its place, and the cells then smoothed by a kernel that is narrower
by the variance of that, so that both together have the standard deviation w.

Sources: Goldhirsch, Granular Matter 12 (2010) 239; the temperature about the mean velocity at the particle's own place,
which a mean shear does not raise: Artoni & Richard, Phys. Rev. E 91 (2015) 032202.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.observe.grains import Grains, Space

#: Cells per width, the reach of the kernel in widths, and most cells of a grid.
CELLS_PER_WIDTH, REACH, MOST_CELLS = 3, 3.0, 4_000_000
#: Cells with less than this share of the mean density have no velocity.
_EMPTY = 1e-3


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Equal cells in one to three dimensions.

    Attributes
    ----------
    low, high : (D,) corners [m]; cells : their number per dimension
    periodic : whether it is, per dimension
    width : standard deviation of the kernel [m]
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    cells: tuple[int, ...]
    periodic: tuple[bool, ...]
    width: float

    @property
    def step(self) -> Array:
        """(D,) sides of a cell [m]."""
        return np.subtract(self.high, self.low) / self.cells

    @property
    def centres(self) -> tuple[Array, ...]:
        """Coordinates of the cells' centres, one array per dimension [m]."""
        sides = zip(self.low, self.step, self.cells, strict=True)
        return tuple(low + (np.arange(n) + 0.5) * step for low, step, n in sides)

    @property
    def cell(self) -> float:
        """Length, area or volume of a cell [m^D]."""
        return float(np.prod(self.step))

    def index(self, at: Array) -> NDArray[np.int64]:
        """Return the flat numbers (n,) of the cells of points (n, D); what is outside counts in the cell at the edge.

        Points beyond a periodic side go round.
        """
        place = np.floor((at - np.asarray(self.low)) / self.step).astype(np.int64)
        place = np.where(self.periodic, place % self.cells, np.clip(place, 0, np.subtract(self.cells, 1)))
        index: NDArray[np.int64] = np.ravel_multi_index(tuple(place.T), self.cells).astype(np.int64)
        return index

    def spread(self, at: Array, amounts: Array) -> Array:
        """Return the densities (*cells, k) of ``amounts`` (n, k) at points (n, D), per length, area or volume.

        The integral of each over the grid is the sum of its amounts to rounding.
        """
        from scipy.ndimage import gaussian_filter

        fields = np.zeros((int(np.prod(self.cells)), amounts.shape[1]))
        place = (at - np.asarray(self.low)) / self.step - 0.5
        first, last = np.floor(place).astype(np.int64), np.subtract(self.cells, 1)
        for corner in product((0, 1), repeat=len(self.cells)):
            share = np.abs(1 - np.array(corner) - (place - first)).prod(axis=1)
            cell = np.where(self.periodic, (first + corner) % self.cells, np.clip(first + corner, 0, last))
            index = np.ravel_multi_index(tuple(cell.T), self.cells)
            for k, amount in enumerate(amounts.T):
                fields[:, k] += np.bincount(index, weights=share * amount, minlength=len(fields))
        fields = fields.reshape(*self.cells, amounts.shape[1]) / self.cell
        narrower = np.sqrt(np.maximum(self.width**2 - self.step**2 / 6.0, 0.0))  # sharing blurs by step²/6
        smooth: Array = gaussian_filter(
            fields,
            (*(narrower / self.step), 0.0),
            mode=[*("wrap" if around else "reflect" for around in self.periodic), "nearest"],
            truncate=REACH,
        )
        return smooth


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Means over frames along one direction.

    Attributes
    ----------
    axis : 0, 1, 2 for x, y, z; at : (cells,) positions along it [m]; width : of the kernel [m]
    frames : number averaged over
    density : (cells,) mass per length [kg/m]; fraction : (cells,) solids over the volume of the box there [-]
    velocity : (cells, 3) mean velocity, weighted by mass [m/s]; NaN where nothing is
    shear_rate : (cells, 3) its slope along the axis [1/s]
    temperature : (cells,) granular temperature, per direction [m²/s²]; both are NaN where nothing is, and within two
        widths of a side that is not periodic, where reflection flattens the velocity
    spread : (cells, 3) half-width of the 95 % interval of the velocity, from blocks of the frames; NaN with few
    """

    axis: int
    at: Array
    width: float
    frames: int
    density: Array
    fraction: Array
    velocity: Array
    shear_rate: Array
    temperature: Array
    spread: Array

    @property
    def flow(self) -> int:
        """The direction (0, 1, 2) of the largest mean velocity."""
        return int(np.abs(np.nan_to_num(self.velocity).mean(axis=0)).argmax())


def grid_for(
    low: Sequence[float], high: Sequence[float], periodic: Sequence[bool], width: float, most: int = MOST_CELLS
) -> Grid:
    """Return a grid over a box of (D,) corners [m] for a kernel of ``width`` [m]: cells of a third of it, or more.

    Raises
    ------
    InputError
        If the width is not positive, or larger than a third of a periodic side, or takes more than ``most`` cells.
    """
    size = np.subtract(high, low)
    if not width > 0.0 or not (size > 0.0).all():
        raise InputError(f"width = {width:g} m in a box of {size.tolist()} m: expected positive lengths")
    cells = np.maximum(np.ceil(size / width * CELLS_PER_WIDTH - 1e-9), 1).astype(int)
    if np.prod(cells.astype(np.float64)) > most:
        raise InputError(f"width = {width:g} m takes {cells.tolist()} cells: expected at most {most:g}; make it wider")
    return Grid(
        low=tuple(map(float, low)),
        high=tuple(map(float, high)),
        cells=tuple(int(n) for n in cells),
        periodic=tuple(map(bool, periodic)),
        width=width,
    )


def profile(
    frames: Callable[[], Iterable[Grains]], space: Space, axis: int, width: float, blocks: int = 8, flat: int = 3
) -> Profile:
    """Average particles over ``frames`` along one axis (0, 1, 2).

    Parameters
    ----------
    frames : gives the frames anew, one at a time: they are gone through twice
    width : of the kernel [m]
    blocks : parts of the frames whose means give the spread
    flat : directions in which particles move, 2 for one layer

    Raises
    ------
    InputError
        If there is no frame.
    """
    grid = grid_for([space.low[axis]], [space.high[axis]], [space.periodic[axis]], width)
    amounts = ((f.x[:, [axis]], np.column_stack([f.mass, f.mass[:, None] * f.v, f.volume])) for f in frames())
    sums = [grid.spread(*one) for one in amounts]
    if not sums:
        raise InputError("no frame: expected at least one")
    total = np.mean(sums, axis=0)
    density, here = total[:, 0], total[:, 0] > _EMPTY * total[:, 0].mean()
    velocity = _over(total[:, 1:4], density, here)
    (at,), squares = grid.centres, np.zeros(len(density))
    for f in frames():
        mean = np.column_stack([_along(grid, f.x[:, axis], at[here], velocity[here, i]) for i in range(3)])
        square = ((f.v - mean) ** 2).sum(axis=1) / flat
        squares += grid.spread(f.x[:, [axis]], (f.mass * square)[:, None])[:, 0] / len(sums)
    ends = np.full(len(at), space.periodic[axis])
    whole = ends | ((at > grid.low[0] + 2.0 * width) & (at < grid.high[0] - 2.0 * width))
    if len(at) < 2:
        raise InputError(f"width = {width:g} m: expected less than half of the box along the axis")
    return Profile(
        axis=axis,
        at=at,
        width=width,
        frames=len(sums),
        density=density,
        fraction=total[:, 4] / float(np.prod(np.delete(space.size, axis))),
        velocity=velocity,
        shear_rate=np.where(whole[:, None], np.gradient(velocity, at, axis=0), np.nan),
        temperature=np.where(whole, _over(squares[:, None], density, here)[:, 0], np.nan),
        spread=_spread(np.array(sums), blocks),
    )


def local_temperature(x: Array, v: Array, cell: NDArray[np.int64], flat: int = 3) -> float:
    """Return the granular temperature of particles about the motion of their neighbours [m²/s²], per direction.

    In each ``cell`` (n,) the velocities are fitted by an affine function of place, so that neither a mean flow nor its
    gradient counts; the mean square of what is left, over the degrees of freedom that the fit leaves, is free of bias.

    Parameters
    ----------
    x, v : (n, 3) [m], [m/s]
    flat : directions in which particles move, 2 for one layer

    Raises
    ------
    InputError
        If every cell has too few particles for the fit.
    """
    order = np.argsort(cell, kind="stable")
    total, freedom = 0.0, 0
    for part in np.split(order, np.flatnonzero(np.diff(cell[order])) + 1):
        place = np.column_stack([np.ones(len(part)), x[part] - x[part].mean(axis=0)])
        fit, _, rank, _ = np.linalg.lstsq(place, v[part], rcond=1e-9)
        total += float(((v[part] - place @ fit) ** 2).sum())
        freedom += len(part) - int(rank)
    if freedom < 1:
        raise InputError("too few particles for a local mean velocity: expected more than four in a cell")
    return total / (flat * freedom)


def layer_exponent(found: Profile, up: float, away: float) -> tuple[float, float]:
    """Return the exponent n of a layer that flows on a base, and its speed at the surface [m/s].

    v = v_b + v_s (1 - ((h - z)/h)^n) by least squares, of the component that moves most, where the density is at least
    half of that inside, ``away`` [m] from base and surface. ``up``: the side of the surface, the sign of the axis. Of
    Bagnold's profile n is 3/2 (Silbert et al., Phys. Rev. E 64 (2001) 051302).

    Raises
    ------
    InputError
        If the layer has fewer than six cells in between, or there is no such fit.
    """
    from scipy.optimize import curve_fit

    if not found.density.any():
        raise InputError("no particles: expected a flowing layer")
    flow = found.velocity[:, found.flow]
    dense = np.flatnonzero(found.density >= 0.5 * np.median(found.density[found.density > 0.5 * found.density.max()]))
    z = (found.at - found.at[dense[0]]) if up > 0.0 else (found.at[dense[-1]] - found.at)
    height = float(found.at[dense[-1]] - found.at[dense[0]])
    core = (z > away) & (z < height - away) & np.isfinite(flow)
    if core.sum() < 6:
        raise InputError(f"a layer of {height:g} m: expected one that is thicker than {2.0 * away:g} m by six cells")

    def speed(z: Array, base: float, slope: float, n: float) -> Array:
        value: Array = base + slope * (1.0 - (1.0 - z / height) ** n)
        return value

    start = (flow[core][0], flow[core][-1] - flow[core][0], 1.5)
    try:
        (base, slope, n), _ = curve_fit(
            speed, z[core], flow[core], start, bounds=([-np.inf] * 2 + [0.1], [np.inf] * 2 + [9.0])
        )
    except RuntimeError as error:
        raise InputError(f"no profile of a flowing layer fits the velocities: {error}") from error
    return float(n), float(base + slope)


def _over(above: Array, density: Array, here: NDArray[np.bool_]) -> Array:
    """Return above/density (cells, k), NaN where nothing is."""
    found: Array = np.where(here[:, None], above / np.where(here, density, 1.0)[:, None], np.nan)
    return found


def _along(grid: Grid, x: Array, at: Array, values: Array) -> Array:
    """Return a field at points (n,), linear between cells and, with a slope, up to the ends."""
    (low,), (high,) = grid.low, grid.high
    if grid.periodic[0]:
        return np.interp(x, at, values, period=high - low)
    if len(at) < 2:
        return np.full(len(x), values[0] if len(at) else 0.0)
    ends = np.array([low, *at, high])
    first = values[0] + (low - at[0]) * (values[1] - values[0]) / (at[1] - at[0])
    last = values[-1] + (high - at[-1]) * (values[-1] - values[-2]) / (at[-1] - at[-2])
    found: Array = np.interp(x, ends, np.array([first, *values, last]))
    return found


def _spread(sums: Array, blocks: int) -> Array:
    """Return the half-widths (cells, 3) of the mean velocity from means of blocks of frames; NaN with fewer than four.

    ``sums`` (frames, cells, 5): mass, momentum, volume.
    """
    from scipy.stats import t as student

    count = min(blocks, len(sums))
    if count < 4:
        return np.full((sums.shape[1], 3), np.nan)
    means = np.array([part.mean(axis=0) for part in np.array_split(sums, count)])
    with np.errstate(invalid="ignore", divide="ignore"):
        velocity = means[:, :, 1:4] / means[:, :, :1]
    found: Array = velocity.std(axis=0, ddof=1) / np.sqrt(count) * float(student.ppf(0.975, count - 1))
    return found
