"""A frozen bed: its pressure gradient at each gas velocity that was held, against Ergun's equation cell by cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.physics.fluidization import EPS_DILUTE, ergun_gradient
from kncal.record.series import BedSeries
from kncal.scene.gas import Gas

#: A gas velocity counts as held after so many couplings, and its gradient needs so many layers of cells.
HELD, LAYERS = 10, 3


@dataclass(frozen=True, kw_only=True)
class Plateau:
    """The pressure gradient at one gas velocity, at the end of the time that it was held.

    Attributes
    ----------
    U_0 : [m/s]; begin, end : from when to when it was held [s]
    low, high : heights between which the gradient was taken, faces between layers of cells [m]
    eps_g : mean void fraction there [-]
    gradient : of the pressure, against the flow and without the weight of the gas [Pa/m]
    ergun : mean of Ergun's gradient, each cell with its own void fraction and velocity [Pa/m]
    ergun_mean : Ergun's gradient at ``U_0`` and ``eps_g`` [Pa/m]: larger than ``gradient``, since more gas
        flows where the packing is loose
    ratio : gradient over ergun [-]; uncertainty : its change between the last two frames [-], the flow's
        steadiness alone
    """

    U_0: float
    begin: float
    end: float
    low: float
    high: float
    eps_g: float
    gradient: float
    ergun: float
    ergun_mean: float
    ratio: float
    uncertainty: float


def ergun_plateaus(series: BedSeries, gas: Gas | None) -> tuple[Plateau, ...]:
    r"""Return the pressure gradient of a frozen bed at every gas velocity > 0 that was held.

    Ergun's equation is that of `kncal.physics.fluidization.ergun_gradient` as a vector, in every cell:

    .. math:: -\frac{\partial p}{\partial z} = \Bigl(150 \frac{\mu (1-\varepsilon)^2}{\varepsilon^3 d^2}
              + 1.75 \frac{\rho_g (1-\varepsilon)\, \varepsilon |u|}{\varepsilon^3 d}\Bigr) \varepsilon u_z

    averaged over layers of cells, against the difference of the layer-mean pressures at the faces below and above them.
    A pressure at a face is the mean of the two cells': that is the gradient that the gas solver's cells feel (Gauss
    with linear interpolation). The layer at the floor, the one at the surface and all above are left out.

    Raises
    ------
    InputError
        If there is no gas or a jet, or no velocity was held for `HELD` couplings with two frames, or the dense part
        of the bed (void fraction below 0.8 in each cell) has fewer than `LAYERS` layers.
    """
    facts = series.facts
    if gas is None or facts.jet:
        raise InputError("no gas" if gas is None else "the gas enters through a jet: no uniform flow through the bed")
    if len(series.eps_g) != len(series.t_frame):
        raise InputError("the frames hold no gas fields")
    held = [(first, last) for first, last in _held(series.U_0) if series.U_0[last] > 0.0]
    found = []
    for first, last in held:
        frames = np.flatnonzero((series.frame_coupling > first) & (series.frame_coupling <= last + 1))
        if len(frames) < 2:
            continue
        found.append(_plateau(series, gas, first, last, frames[-2:]))
    if not found:
        raise InputError(
            f"no gas velocity was held for {HELD} couplings and two frames: expected a ramp with level parts"
            " (gas.ramp), or frames closer together (run.frames_every)"
        )
    return tuple(found)


def _held(U_0: Array) -> list[tuple[int, int]]:
    """Return first and last row of every stretch of at least `HELD` rows of equal velocity."""
    edges = np.flatnonzero(np.diff(U_0) != 0.0)
    firsts, lasts = np.concatenate([[0], edges + 1]), np.concatenate([edges, [len(U_0) - 1]])
    return [(int(a), int(b)) for a, b in zip(firsts, lasts, strict=True) if b - a + 1 >= HELD]


def _plateau(series: BedSeries, gas: Gas, first: int, last: int, frames: NDArray[np.int64]) -> Plateau:
    facts = series.facts
    h = facts.size[2] / facts.cells[2]
    layers = _dense_layers(series.eps_g[frames[-1]].astype(np.float64))
    before, now = (_gradients(series, gas, int(frame), layers) for frame in frames)
    ratio = now[0] / now[1]
    eps_g = float(series.eps_g[frames[-1]][layers].mean(dtype=np.float64))
    U_0 = float(series.U_0[last])
    return Plateau(
        U_0=U_0,
        begin=float(series.t[first]) - facts.coupling,
        end=float(series.t[last]),
        low=layers.start * h,
        high=layers.stop * h,
        eps_g=eps_g,
        gradient=now[0],
        ergun=now[1],
        ergun_mean=float(ergun_gradient(U_0, eps_g, facts.diameter, gas.density, gas.viscosity)),
        ratio=ratio,
        uncertainty=abs(ratio - before[0] / before[1]),
    )


def _dense_layers(eps_g: Array) -> slice:
    """Return the layers of cells inside the bed: from the second to the last but one of those that are all dense."""
    dense = eps_g.max(axis=(1, 2)) < EPS_DILUTE
    top = int(np.argmin(dense)) if not dense.all() else len(dense)
    if top - 2 < LAYERS:
        raise InputError(
            f"{max(top - 2, 0)} layers of gas cells inside the bed: expected at least {LAYERS}; use more particles or"
            " flatter cells"
        )
    return slice(1, top - 1)


def _gradients(series: BedSeries, gas: Gas, frame: int, layers: slice) -> tuple[float, float]:
    """Return the pressure gradient over ``layers`` of one frame, without the weight of the gas, and Ergun's [Pa/m]."""
    facts = series.facts
    eps = series.eps_g[frame, layers].astype(np.float64)
    U = series.U[frame, layers].astype(np.float64)
    around = slice(layers.start - 1, layers.stop + 1)
    pressure = series.p[frame, around].mean(axis=(1, 2), dtype=np.float64)
    d, solids = facts.diameter, 1.0 - eps
    u, speed = eps * U[..., 2], eps * np.linalg.norm(U, axis=-1)
    viscous = 150.0 * gas.viscosity * solids**2 / (eps**3 * d**2)
    cells = (viscous + 1.75 * gas.density * solids * speed / (eps**3 * d)) * u
    below, above = 0.5 * (pressure[0] + pressure[1]), 0.5 * (pressure[-2] + pressure[-1])
    height = len(eps) * facts.size[2] / facts.cells[2]
    gradient = (below - above) / height - facts.gas_density * facts.gravity
    return float(gradient), float(cells.mean())
