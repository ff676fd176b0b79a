"""The gas cells of a column: where a point lies, and in which order the solver counts cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError, RunError
from kncal.engines.base import GasSetup

Labels = NDArray[np.int32]

#: Parcels stay this far inside the mesh [cells]: the solver looks for a parcel on the boundary for ever.
MARGIN = 1e-3
_FINITE = float(np.finfo(np.float64).max)


class Grid:
    """The cells of a gas set-up.

    Attributes
    ----------
    size : (3,) box [m]; shape : (3,) cells per axis; h : (3,) cell sizes [m]
    count : number of cells; volume : of one cell [m³]
    splits : x indices of the faces between blocks, 0 and nx included; the jet slot is a block of its own
    slot : index of the block over the jet's slot, None without a jet
    inlet_faces : number of cell faces where gas enters
    labels : (nz, ny, nx) the solver's label of each cell (block by block, in a block x fastest)

    Raises
    ------
    InputError
        If a jet does not end on cell faces inside the column, or a layer has more than one cell in y.
    """

    def __init__(self, setup: GasSetup) -> None:
        self.size = np.array(setup.size, dtype=np.float64)
        self.shape = np.array(setup.cells, dtype=np.int64)
        self.h = self.size / self.shape
        self.count = int(self.shape.prod())
        self.volume = float(self.h.prod())
        self._front_back = setup.front_back
        nx, ny, nz = setup.cells
        if setup.front_back == "layer" and ny != 1:
            raise InputError(f"cells = {setup.cells}: a layer has one cell in y, expected ({nx}, 1, {nz})")
        self.splits, self.slot = _split(setup)
        columns = nx if self.slot is None else int(np.diff(self.splits)[self.slot])
        self.inlet_faces = columns * ny
        # First cell and length of the block, by x index
        widths = np.diff(self.splits)
        self._start = np.repeat(self.splits[:-1], widths)
        self._width = np.repeat(widths, widths)
        k, j, i = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
        self.labels = self._label(i, j, k)

    def locate(self, x: Array) -> tuple[Array, Labels]:
        """Return the points moved just inside the mesh (n, 3) [m], and the solver's labels of their cells (n,).

        A periodic column is wrapped in y; in a layer y becomes the middle of the depth.
        """
        low, high = self.limits()
        places, cells = [], []
        for axis in range(3):  # one by one: numpy is slow along an axis of three
            at = x[:, axis]
            if axis == 1 and self._front_back == "periodic":
                at = at % self.size[1]
            elif axis == 1 and self._front_back == "layer":
                at = np.full(len(x), 0.5 * self.size[1])
            at = np.clip(at, low[axis], high[axis])
            places.append(at)
            # High points are still below the last face, whatever the rounding of the division.
            cells.append(np.minimum((at / self.h[axis]).astype(np.int64), self.shape[axis] - 1))
        return np.stack(places, axis=1), self._label(*cells)

    def limits(self) -> tuple[Array, Array]:
        """Return the corners (3,), (3,) of the region where parcels may be [m]."""
        return MARGIN * self.h, self.size - MARGIN * self.h

    def check_inside(self, x: Array) -> None:
        """Refuse particle centres (n, 3) that are not finite or have left the column.

        Raises
        ------
        RunError
            Naming the first such particle.
        """
        bad = np.zeros(len(x), dtype=bool)
        for axis in range(3):
            slack = 1e-9 * self.size[axis]
            low, high = -slack, self.size[axis] + slack
            if axis == 1 and self._front_back == "periodic":
                low, high = -_FINITE, _FINITE
            at = x[:, axis]
            bad |= ~((at >= low) & (at <= high))  # so is what is not a number
        if bad.any():
            row = int(np.argmax(bad))
            box = " x ".join(f"{value:g}" for value in self.size)
            raise RunError(
                f"{int(bad.sum())} of {len(x)} particles are outside the gas column ({box} m), the first is particle "
                f"{row + 1} at {x[row].tolist()} m: they passed a wall (time step too long, or contact too soft)",
                "lost-particles",
            )

    def to_field(self, values: Array) -> Array:
        """Return cell values in the solver's order, (count,) or (count, 3), as (nz, ny, nx) or (nz, ny, nx, 3)."""
        field: Array = values.take(self.labels, axis=0)
        return field

    def _label(self, i: NDArray[np.int64], j: NDArray[np.int64], k: NDArray[np.int64]) -> Labels:
        ny, nz = self.shape[1], self.shape[2]
        start, width = self._start.take(i), self._width.take(i)
        labels: Labels = (start * (ny * nz) + (i - start) + width * (j + ny * k)).astype(np.int32)
        return labels


def _split(setup: GasSetup) -> tuple[NDArray[np.int64], int | None]:
    """Return the x indices of the block faces, and the index of the block over the slot."""
    nx = setup.cells[0]
    if setup.jet is None:
        return np.array([0, nx]), None
    h = setup.size[0] / nx
    faces = [setup.jet.x_low / h, setup.jet.x_high / h]
    low, high = (round(face) for face in faces)
    if any(abs(face - round(face)) > 1e-6 for face in faces) or not 0 <= low < high <= nx:
        raise InputError(
            f"jet from x = {setup.jet.x_low:g} to {setup.jet.x_high:g} m: expected both on cell faces (multiples of "
            f"{h:g} m) inside 0 to {setup.size[0]:g} m, the first below the second; move the slot or change the cells"
        )
    splits = sorted({0, low, high, nx})
    return np.array(splits), splits.index(low)
