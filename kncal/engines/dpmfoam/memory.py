"""The shared memory between kncal and the adapter in a live DPMFoam: one mapping without a name.

The layout is also that of ``adapter/kncalExchange.C``; whoever changes one changes the other, and `VERSION` in both.
"""

from __future__ import annotations

import mmap
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.engines.dpmfoam.forces import Parcels

VERSION = 1
# bytes: version, parcels, room for parcels, cells, inlet faces, padding (int32); inlet velocity, CPU time (float64)
_HEADER = 64
_PARCELS, _INLET, _CPU = 1, 3, 4  # where the number of parcels is in it, as int32; and the other two, as float64


class ExchangeMemory:
    """The mapping, seen from Python. Having no name, nothing of it is left behind, however its users end.

    Attributes
    ----------
    descriptor : of the memory, for the child to inherit
    room : number of parcels that fit

    The arrays, by name (those behind the semicolon are the solver's):
    x, v (room, 3) [m], [m/s]; diameter, density, weight, cell (room,) as in `kncal.engines.dpmfoam.forces.Parcels`;
    v_new (room, 3); U, U_trans (cells, 3); eps_g, p, U_coeff (cells,); p_inlet (inlet faces,) in the solver's units.
    """

    def __init__(self, room: int, cells: int, inlet_faces: int) -> None:
        self.room = room
        m, c, f = room, cells, inlet_faces
        shapes: dict[str, tuple[int, ...]] = {
            "x": (m, 3),
            "v": (m, 3),
            "diameter": (m,),
            "density": (m,),
            "weight": (m,),
            "v_new": (m, 3),
            "U": (c, 3),
            "eps_g": (c,),
            "p": (c,),
            "U_trans": (c, 3),
            "U_coeff": (c,),
            "p_inlet": (f,),
        }
        reals = sum(int(np.prod(shape)) for shape in shapes.values())
        size = _HEADER + 8 * reals + 4 * m
        self.descriptor = os.memfd_create("kncal-exchange")
        try:
            os.ftruncate(self.descriptor, size)
            self._map = mmap.mmap(self.descriptor, size)
        except BaseException:
            os.close(self.descriptor)
            raise
        self._arrays: dict[str, NDArray[Any]] = {
            "integers": np.ndarray((_HEADER // 4,), "<i4", self._map),
            "numbers": np.ndarray((_HEADER // 8,), "<f8", self._map),
        }
        offset = _HEADER
        for name, shape in shapes.items():
            self._arrays[name] = np.ndarray(shape, "<f8", self._map, offset)
            offset += self._arrays[name].nbytes
        self._arrays["cell"] = np.ndarray((m,), "<i4", self._map, offset)
        self._arrays["integers"][:5] = VERSION, 0, m, c, f
        self.set_inlet(np.nan)

    def put(self, parcels: Parcels) -> None:
        """Lay down the parcels of the coming step; there must be `room` for them."""
        count = len(parcels.x)
        for name in ("x", "v", "diameter", "density", "weight", "cell"):
            self._arrays[name][:count] = getattr(parcels, name)
        self._arrays["integers"][_PARCELS] = count

    def set_inlet(self, velocity: float) -> None:
        """Ask for an inlet velocity [m/s] in the coming steps; NaN: as the case says."""
        self._arrays["numbers"][_INLET] = velocity

    def count(self) -> int:
        """Return the number of parcels after the step."""
        return int(self._arrays["integers"][_PARCELS])

    def cpu_seconds(self) -> float:
        """Return the CPU time that the adapter itself has taken in the solver's process [s]."""
        return float(self._arrays["numbers"][_CPU])

    def take(self, name: str, count: int | None = None) -> Array:
        """Return a copy of (the first ``count`` rows of) an array that the solver has written."""
        return np.array(self._arrays[name][:count])

    def close(self) -> None:
        """Give the memory back; may be called twice."""
        if self.descriptor >= 0:
            self._arrays.clear()  # no view of a mapping may outlive it
            self._map.close()
            os.close(self.descriptor)
            self.descriptor = -1
