"""Fields of a bed from its frames: mean voidage, solids velocity, granular temperature, heights of the bed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.record.facts import BedFacts
from kncal.record.series import BedSeries

#: Above the bed the laterally averaged void fraction is larger than this.
FREEBOARD_VOIDAGE = 0.8
#: The pressure line of the bed is fitted where the pressure lies between these shares of its largest value.
PRESSURE_SHARES = (0.2, 0.8)


@dataclass(frozen=True, kw_only=True)
class SolidsFields:
    """Particles averaged over frames in the gas cells; NaN where no particle (for theta: no two) ever was.

    Attributes
    ----------
    frames : number of frames averaged over
    count : (nz, ny, nx) mean number of particle centres
    velocity : (nz, ny, nx, 3) mean over all particles and frames [m/s]
    theta : (nz, ny, nx) granular temperature [m²/s²]
    theta_frames : (frames,) granular temperature of the whole bed, mean over particles [m²/s²]
    """

    frames: int
    count: Array
    velocity: Array
    theta: Array
    theta_frames: Array


def cell_centres(facts: BedFacts) -> tuple[Array, Array, Array]:
    """Return the coordinates of the cell centres along x, y and z [m]."""
    x, y, z = ((np.arange(n) + 0.5) * size / n for n, size in zip(facts.cells, facts.size, strict=True))
    return x, y, z


def frames_from(series: BedSeries, begin: float) -> NDArray[np.int64]:
    """Return the indices of the frames with t >= ``begin`` [s]; InputError if there is none."""
    found: NDArray[np.int64] = np.flatnonzero(series.t_frame >= begin - 1e-9 * series.facts.coupling)
    if not len(found):
        last = f"the last is at {series.t_frame[-1]:g} s" if len(series.t_frame) else "there are no frames"
        raise InputError(f"begin = {begin:g} s: no frame at or after it, {last}; run longer or record frames")
    return found


def mean_voidage(series: BedSeries, begin: float = 0.0) -> Array:
    """Return the time mean void fraction (nz, ny, nx) of the frames from ``begin`` [s] on."""
    frames = frames_from(series, begin)
    mean: Array = _gas(series, series.eps_g, frames).mean(axis=0, dtype=np.float64)
    return mean


def solids_fields(series: BedSeries, begin: float = 0.0) -> SolidsFields:
    """Average the particles of the frames from ``begin`` [s] on.

    The granular temperature is that of the particles in one cell at one instant, theta = <C·C>/D with the velocity C
    relative to the mean of that cell and frame, D = 3 (2 for one layer, which cannot move in y); with
    the factor n/(n - 1) for the mean being that of the same n particles. Motion of a cell as a whole (bubbles, slugs)
    does not count. The definition is that of Gidaspow, "Multiphase Flow and Fluidization" (1994), chapter 9.
    """
    facts = series.facts
    nx, ny, nz = facts.cells
    cells = nx * ny * nz
    dimensions = 2 if facts.front_back == "layer" else 3
    frames = frames_from(series, begin)
    count, momentum = np.zeros(cells), np.zeros((3, cells))
    squares, weights, theta_frames = np.zeros(cells), np.zeros(cells), np.zeros(len(frames))
    for row, frame in enumerate(frames):
        there = series.kind[frame] >= 0
        index = cell_index(facts, series.x[frame][there])
        v = series.v[frame][there].astype(np.float64)
        n = np.bincount(index, minlength=cells)
        total = np.stack([np.bincount(index, weights=v[:, i], minlength=cells) for i in range(3)])
        count += n
        momentum += total
        fluctuation = v - (total / np.maximum(n, 1))[:, index].T
        square = np.bincount(index, weights=np.einsum("ij,ij->i", fluctuation, fluctuation), minlength=cells)
        many = n > 1
        scaled = np.where(many, square * n / np.maximum(n - 1, 1) / dimensions, 0.0)
        squares += scaled
        weights += np.where(many, n, 0)
        theta_frames[row] = scaled.sum() / max(n[many].sum(), 1)
    with np.errstate(invalid="ignore"):  # 0/0 is the NaN that is wanted
        velocity = (momentum / count).T.reshape(nz, ny, nx, 3)
        theta = (squares / weights).reshape(nz, ny, nx)
    return SolidsFields(
        frames=len(frames),
        count=(count / len(frames)).reshape(nz, ny, nx),
        velocity=velocity,
        theta=theta,
        theta_frames=theta_frames,
    )


def velocity_profile(solids: SolidsFields, facts: BedFacts, z: float) -> tuple[Array, Array]:
    """Return x [m] and the mean vertical solids velocity [m/s], both (nx,), in the cell layer at height ``z`` [m].

    Every particle counts once, whatever its y; NaN where no particle ever was.
    """
    size, nz = facts.size[2], facts.cells[2]
    if not 0.0 <= z < size:
        raise InputError(f"z = {z:g} m: expected a height in the column, [0, {size:g})")
    layer = int(z / size * nz)
    count = solids.count[layer]
    flux = np.where(count > 0.0, solids.velocity[layer, :, :, 2] * count, 0.0).sum(axis=0)
    with np.errstate(invalid="ignore"):
        return cell_centres(facts)[0], flux / count.sum(axis=0)


def cell_index(facts: BedFacts, x: NDArray[Any]) -> NDArray[np.int64]:
    """Return the number of the cell (x fastest, then y, then z) of every position (n, 3) [m]."""
    nx, ny = facts.cells[:2]
    at = np.floor(np.asarray(x, dtype=np.float64) / facts.size * facts.cells).astype(np.int64)
    if facts.front_back == "periodic":
        at[:, 1] %= ny
    at = np.clip(at, 0, np.array(facts.cells) - 1)
    index: NDArray[np.int64] = at[:, 0] + nx * (at[:, 1] + ny * at[:, 2])
    return index


def voidage_heights(series: BedSeries, begin: float = 0.0) -> Array:
    """Return (frames,) the height where the laterally averaged void fraction last falls below `FREEBOARD_VOIDAGE` [m].

    Seen from above, linear between cell centres; 0 where no layer is that dense.
    """
    eps_g = _gas(series, series.eps_g, frames_from(series, begin)).mean(axis=(2, 3), dtype=np.float64)
    z = cell_centres(series.facts)[2]
    heights = np.zeros(len(eps_g))
    for frame, profile in enumerate(eps_g):
        dense = np.flatnonzero(profile < FREEBOARD_VOIDAGE)
        if not len(dense):
            continue
        top = int(dense[-1])
        if top == len(z) - 1:
            heights[frame] = series.facts.size[2]
            continue
        share = (FREEBOARD_VOIDAGE - profile[top]) / (profile[top + 1] - profile[top])
        heights[frame] = z[top] + share * (z[top + 1] - z[top])
    return heights


def solids_volume_below(series: BedSeries, heights: Array, begin: float = 0.0) -> Array:
    """Return (frames,) the solids below ``heights`` (frames,) [m], volume over the area of the floor [m]."""
    nz, height = series.facts.cells[2], series.facts.size[2]
    eps_g = _gas(series, series.eps_g, frames_from(series, begin)).mean(axis=(2, 3), dtype=np.float64)
    below = np.concatenate([np.zeros((len(eps_g), 1)), np.cumsum((1.0 - eps_g) * height / nz, axis=1)], axis=1)
    edges = np.linspace(0.0, height, nz + 1)
    return np.array([np.interp(h, edges, filled) for h, filled in zip(heights, below, strict=True)])


def pressure_heights(series: BedSeries, begin: float = 0.0) -> Array:
    """Return (frames,) the height where the pressure line of the bed meets that of the freeboard [m].

    The line is fitted through the laterally averaged pressures between 0.2 and 0.8 of the largest; the freeboard's is
    the weight of the gas above. NaN where fewer than two layers lie in between or the line does not fall.
    """
    facts = series.facts
    pressure = _gas(series, series.p, frames_from(series, begin)).mean(axis=(2, 3), dtype=np.float64)
    z = cell_centres(facts)[2]
    static = facts.gas_density * facts.gravity
    pressure = pressure - static * (facts.size[2] - z)
    heights = np.full(len(pressure), np.nan)
    for frame, profile in enumerate(pressure):
        low, high = (share * profile.max() for share in PRESSURE_SHARES)
        inside = (profile >= low) & (profile <= high)
        if inside.sum() < 2:
            continue
        slope, start = np.polyfit(z[inside], profile[inside], 1)
        if slope < 0.0:
            heights[frame] = -start / slope
    return heights


def _gas(series: BedSeries, field: NDArray[np.float32], frames: NDArray[np.int64]) -> NDArray[np.float32]:
    if len(field) != len(series.t_frame):
        raise InputError("the frames hold no gas fields; expected a run with gas")
    return field[frames]
