"""The gas of a scene, its cells, and how it enters: tables of the case file. SI units, z is up."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from kncal.scene.values import (
    Cells,
    Coordinate,
    GasDensity,
    GasSpeed,
    GasViscosity,
    Number,
    Parcels,
    Ramp,
    Word,
    checked_class,
    within,
)


@checked_class
class Jet:
    """``[gas.jet]``: a slot in the floor over the whole depth; gas enters through it only."""

    x_low: Coordinate = Field(description="lower end of the slot in x, on a cell face [m]")
    x_high: Coordinate = Field(description="upper end of the slot in x, on a cell face [m]")
    velocity: Annotated[Number, within(1e-6, 1e3, "m/s")] = Field(
        description="velocity of the gas in the slot, upwards [m/s]"
    )


@checked_class
class Gas:
    """``[gas]``: the gas in the box, its cells, and how it enters."""

    cells: Cells = Field(description="numbers of gas cells of the box in x, y and z")
    density: GasDensity = Field(description="density [kg/m³]")
    viscosity: GasViscosity = Field(description="dynamic viscosity [Pa s]")
    walls: Literal["slip", "noSlip"] = Field(default="slip", description='of the gas at the walls: "slip" or "noSlip"')
    U_0: GasSpeed = Field(default=0.0, description="superficial velocity over the whole floor [m/s]")
    ramp: Ramp = Field(
        default=(),
        description="[time [s], superficial velocity [m/s]] points, linear in between and constant outside",
    )
    jet: Jet | None = Field(default=None, description="[gas.jet] with x_low, x_high, velocity")
    drag: Word = Field(
        default="ErgunWenYu", description="drag law: ErgunWenYu, PlessisMasliyah, or one that a package adds"
    )
    parcels_per_particle: Parcels = Field(
        default=1, description="parcels that share a particle's volume, for cells near the particle's size: 1, 8 or 27"
    )

    def inlet_at(self, time: float) -> float:
        """Return the superficial velocity through the floor at ``time`` [s]: U_0 or the ramp's [m/s]; 0 with a jet."""
        if not self.ramp:
            return self.U_0
        times, velocities = zip(*self.ramp, strict=True)
        return float(np.interp(time, times, velocities))
