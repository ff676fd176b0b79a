"""What the case file of a bed may hold: one pydantic model per table (single contacts: `kncal.scene.case_schema`)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from kncal.scene.case_schema import (
    ContactTable,
    MaterialTable,
    MeasuredTable,
    Name,
    PairTable,
    Root,
    Seconds,
    Stiffness,
    Table,
    above_zero,
    within,
)

#: More particles or gas cells than this are no work for one core.
MOST_PARTICLES, MOST_CELLS_PER_AXIS, MOST_RAMP = 1_000_000, 10_000, 1000
MOST_CELLS = 1_000_000

Length = Annotated[float, within(2e-9, 1e3, "m", "1 mm is 1e-3")]
GasSpeed = Annotated[float, within(0.0, 1e3, "m/s")]
#: From a gas at a thousandth of an atmosphere to mercury; from hydrogen, and a little below, to glycerine and pitch.
GasDensity = Annotated[float, within(1e-4, 2e4, "kg/m³", "air: 1.2")]
GasViscosity = Annotated[float, within(1e-7, 1e2, "Pa s", "air: 1.8e-5")]
Coordinate = Annotated[float, within(0.0, 1e3, "m", "1 mm is 1e-3")]
Time = Annotated[float, within(0.0, 1e6, "s")]
_Row = Annotated[list[Coordinate], Field(min_length=3, max_length=3)]
_Point = Annotated[list[Annotated[float, within(0.0, 1e6)]], Field(min_length=2, max_length=2)]


class ColumnTable(Table):
    """``[column]``."""

    width: Length = Field(description="extent in x [m]")
    depth: Length = Field(description="extent in y [m]")
    height: Length = Field(description="extent in z [m]")
    cells: Annotated[list[Annotated[int, within(1, MOST_CELLS_PER_AXIS)]], Field(min_length=3, max_length=3)] = Field(
        description="numbers of gas cells in x, y and z"
    )
    front_back: Literal["walls", "periodic", "layer"] = Field(
        "walls", description='"walls", "periodic" or "layer" (one layer of particles held in its plane)'
    )
    wall_material: Name = Field("rigid", description='the name of a material, or "rigid"')
    gas_walls: Literal["slip", "noSlip"] = Field("slip", description='"slip" or "noSlip"')


class BedParticlesTable(Table):
    """``[particles]``."""

    count: Annotated[int, within(0, MOST_PARTICLES)] = Field(description="number of particles, 0: gas only")
    diameter: Length = Field(description="diameter [m]")
    material: Name = Field(description="the name of a material")
    packing: Literal["settled", "lattice", "given"] = Field(
        "settled", description='"settled", "lattice" or "given" (positions)'
    )
    positions: list[_Row] = Field(
        [], max_length=MOST_PARTICLES, description='[x, y, z] of each particle [m], for packing = "given"'
    )
    settle_k_n: Stiffness | None = Field(
        None, description='stiffness of the spring by which "settled" particles settle [N/m]; none: of the linear run'
    )
    seed: Annotated[int, within(0, 2**31 - 1)] = Field(1, description="seed of the lattice's random offsets")
    frozen: bool = Field(False, description="true: the particles do not move")


class JetTable(Table):
    """``[gas.jet]``."""

    x_low: Coordinate = Field(description="lower end of the slot in x [m]")
    x_high: Coordinate = Field(description="upper end of the slot in x [m]")
    velocity: Annotated[float, within(1e-6, 1e3, "m/s")] = Field(description="gas velocity in the slot [m/s]")


class GasTable(Table):
    """``[gas]``."""

    density: GasDensity = Field(description="density [kg/m³]")
    viscosity: GasViscosity = Field(description="dynamic viscosity [Pa s]")
    U_0: GasSpeed = Field(0.0, description="superficial gas velocity [m/s]")
    ramp: list[_Point] = Field([], max_length=MOST_RAMP, description="[time [s], superficial velocity [m/s]] points")
    jet: JetTable | None = Field(None, description="[gas.jet] with x_low, x_high, velocity")
    drag: str = Field("ErgunWenYu", description="drag law: ErgunWenYu, PlessisMasliyah, or one that a package adds")
    parcels_per_particle: Literal[1, 8, 27] = Field(1, description="parcels that share a particle: 1, 8 or 27")


class BedRunTable(Table):
    """``[run]`` of a bed."""

    end_time: Seconds = Field(description="end time [s]")
    coupling: Seconds = Field(description="coupling interval [s]")
    gas_step: Seconds | None = Field(None, description="longest gas step [s]; none: one per coupling interval")
    discard: Time | None = Field(None, description="start-up left out of averages [s]")
    steps_per_contact: Annotated[float, within(4.0, 1e6, hint="50 is usual")] = Field(
        50.0, description="steps per contact duration [-]"
    )
    frames_every: Seconds = Field(0.01, description="time between recorded frames [s]")


class BedTable(Root):
    """The whole file of a bed."""

    gravity: Annotated[float, within(0.0, 1e5, "m/s²")] = Field(9.81, description="gravity, downwards [m/s²]")
    column: ColumnTable = Field(description="[column] with width, depth, height, cells")
    particles: BedParticlesTable = Field(description="[particles] with count, diameter, material")
    gas: GasTable | None = Field(None, description="[gas]; none: particles only")
    contact: ContactTable = Field(default_factory=lambda: ContactTable.model_validate({}), description="[contact]")
    run: BedRunTable = Field(description="[run] with end_time and coupling")
    tolerances: dict[str, Annotated[float, above_zero()]] = Field(
        {}, description="metric = allowed relative difference"
    )
    needs: dict[str, bool] = Field({}, description="physics = true or false")


BedTable.parts = {
    "column": ColumnTable,
    "particles": BedParticlesTable,
    "gas": GasTable,
    "jet": JetTable,
    "contact": ContactTable,
    "measured": MeasuredTable,
    "pairs": PairTable,
    "run": BedRunTable,
    "materials": MaterialTable,
}
