"""What a case file may hold: one pydantic model per table; strict numbers in SI units, checked names.

Only the form of each value is checked here; what values must satisfy together is in `kncal.scene.case_checks`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidatorFunctionWrapHandler, WrapValidator

from kncal.core.checks import Range, positive

#: Names end up in folder names, decks and web pages: letters, digits and a few harmless signs.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
NAME_EXPECTED = "expected a name of 1 to 64 letters, digits, '.', '_' or '-', starting with a letter or digit"

#: More bodies than this are no scene of single contacts: each may touch each, and every pair is planned and observed.
MOST_PARTICLES, MOST_WALLS, MOST_PAIRS = 100, 20, 200


def _name(text: str) -> str:
    if not NAME.fullmatch(text):
        raise ValueError(NAME_EXPECTED)
    return text


def _line(text: str) -> str:
    if not text.isprintable() or len(text) > 300:
        raise ValueError("expected one line of at most 300 printable characters")
    return text


def within(low: float, high: float, unit: str = "", hint: str = "") -> AfterValidator:
    """Return a validator for a number in [low, high]."""
    return AfterValidator(Range(low, high, unit, hint))


def above_zero(unit: str = "", hint: str = "", high: float = np.inf) -> AfterValidator:
    """Return a validator for a number in (0, high]."""
    return AfterValidator(Range(0.0, high, unit, hint, low_open=True))


def _or_measured(value: object, check: ValidatorFunctionWrapHandler) -> object:
    if isinstance(value, str) and value != MEASURED:
        raise ValueError(f'expected a speed in m/s, without quotes or unit, or "{MEASURED}"')
    return value if value == MEASURED else check(value)


def _option(value: float | str) -> float | str:
    if isinstance(value, str):
        return _name(value)
    positive("value", value)
    return value


Name = Annotated[str, AfterValidator(_name)]
Text = Annotated[str, AfterValidator(_line)]
Restitution = Annotated[float, within(1e-3, 1.0, hint="a contact with less hardly ever ends")]
Friction = Annotated[float, within(0.0, 10.0)]
Speed = Annotated[float, above_zero("m/s", high=1e4)]
#: What ``contact.v_0`` says where the speed is to be measured.
MEASURED = "measured"
Stiffness = Annotated[float, above_zero("N/m")]
Seconds = Annotated[float, above_zero("s")]
THREE = Field(min_length=3, max_length=3)
Position = Annotated[list[Annotated[float, within(-1e4, 1e4, "m", "1 mm is 1e-3")]], THREE]
Velocity = Annotated[list[Annotated[float, within(-1e4, 1e4, "m/s")]], THREE]
Spin = Annotated[list[Annotated[float, within(-1e8, 1e8, "rad/s")]], THREE]
Acceleration = Annotated[list[Annotated[float, within(-1e5, 1e5, "m/s²")]], THREE]


class Table(BaseModel):
    """Base of every table: refuses unknown keys, text or booleans for numbers, NaN and infinity."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class MaterialTable(Table):
    """``[materials.NAME]``; the ranges are those of `kncal.physics.material.Material`."""

    young: float = Field(description="Young's modulus [Pa]")
    poisson: float = Field(description="Poisson's ratio [-]")
    density: float = Field(description="density [kg/m³]")
    yield_strength: float | None = Field(None, description="yield strength [Pa]")


class ParticleTable(Table):
    """``[[particles]]``."""

    name: Name = Field(description="the particle's name")
    material: Name = Field(description="the name of a material")
    diameter: Annotated[float, within(2e-9, 1e3, "m", "1 mm is 1e-3")] = Field(description="diameter [m]")
    position: Position = Field(description="[x, y, z] of the centre [m]")
    velocity: Velocity = Field([0.0, 0.0, 0.0], description="[x, y, z] of the velocity [m/s]")
    spin: Spin = Field([0.0, 0.0, 0.0], description="[x, y, z] of the angular velocity [rad/s]")


class WallTable(Table):
    """``[[walls]]``."""

    name: Name = Field(description="the wall's name")
    axis: Literal["x", "y", "z"] = Field(description='the plane\'s normal: "x", "y" or "z"')
    position: Annotated[float, within(-1e4, 1e4, "m", "1 mm is 1e-3")] = Field(
        description="coordinate of the plane [m]"
    )
    material: Name = Field(description='the name of a material, or "rigid"')


class PairTable(Table):
    """``[[contact.pairs]]``."""

    between: Annotated[list[Name], Field(min_length=2, max_length=2)] = Field(
        description="two names of particles, walls or materials"
    )
    e_n: Restitution | None = Field(None, description="normal restitution [-]")
    friction: Friction | None = Field(None, description="Coulomb friction coefficient [-]")
    v_0: Speed | None = Field(None, description="impact speed to calibrate at [m/s]")
    k_n: Stiffness | None = Field(None, description="prescribed linear stiffness [N/m]")


class MeasuredTable(Table):
    """``[contact.measured]``."""

    statistic: Literal["energy_weighted", "mean", "p99"] = Field(
        "energy_weighted", description='of the impact speeds: "energy_weighted" mean, "mean" or "p99"'
    )
    start: Speed | None = Field(None, description="first guess of v_0 [m/s]")
    run_time: Seconds | None = Field(None, description="end time of a measuring round [s]")
    tolerance: Annotated[float, above_zero(high=1.0)] = Field(
        0.02, description="relative change of k_n below which it has settled [-]"
    )
    rounds: Annotated[int, within(1, 50)] = Field(6, description="most rounds")


class ContactTable(Table):
    """``[contact]``; the names of law and method are checked against the registries."""

    law: str = Field("tsuji", description="reference contact law")
    e_n: Restitution = Field(1.0, description="normal restitution [-]")
    end: Literal["overlap", "force"] = Field("overlap", description='contact end: "overlap" or "force"')
    method: str | None = Field(None, description="how k_n is found")
    v_0: Annotated[Speed, WrapValidator(_or_measured)] | None = Field(
        None, description="impact speed to calibrate at [m/s]"
    )
    measured: MeasuredTable | None = Field(None, description='[contact.measured], for v_0 = "measured"')
    k_n: Stiffness | None = Field(None, description="prescribed linear stiffness [N/m]")
    friction: Friction = Field(0.0, description="Coulomb friction coefficient [-]")
    k_t_ratio: Annotated[float, within(0.0, 10.0)] | None = Field(None, description="k_t/k_n [-]")
    rolling_friction: Friction = Field(0.0, description="rolling friction coefficient [-]")
    options: dict[Name, Annotated[float | str, AfterValidator(_option)]] = Field(
        {}, description="options of the method"
    )
    pairs: list[PairTable] = Field([], max_length=MOST_PAIRS, description="exceptions for single pairs")

    @property
    def to_be_measured(self) -> bool:
        """Whether ``v_0`` is the word instead of a number."""
        return str(self.v_0) == MEASURED


class RunTable(Table):
    """``[run]``."""

    steps_per_contact: Annotated[float, within(4.0, 1e6, hint="50 is usual")] = Field(
        50.0, description="steps per contact duration [-]"
    )
    until_time: Seconds | None = Field(None, description="end time [s]")
    until_bounces: Annotated[int, within(1, 1000)] | None = Field(None, description="number of contacts")
    dt: Seconds | None = Field(None, description="time step [s]")
    record_every: Annotated[int, within(1, 1e6)] = Field(1, description="steps between recorded frames")


class Root(Table):
    """What the whole file of every kind of case has; ``parts``: the tables below it, by the key that holds them."""

    parts: ClassVar[Mapping[str, type[Table]]] = {}

    title: Text = Field("", description="one line: what the case is")
    source: Text = Field("", description="one line: where its parameters come from")
    materials: dict[Name, MaterialTable] = Field(min_length=1, description="at least one [materials.NAME]")


class CaseTable(Root):
    """The whole file of a case of single contacts."""

    gravity: Acceleration = Field([0.0, 0.0, 0.0], description="[x, y, z] of gravity [m/s²]")
    particles: list[ParticleTable] = Field(
        min_length=1, max_length=MOST_PARTICLES, description="at least one [[particles]]"
    )
    walls: list[WallTable] = Field([], max_length=MOST_WALLS, description="[[walls]]")
    contact: ContactTable = Field(default_factory=lambda: ContactTable.model_validate({}), description="[contact]")
    run: RunTable = Field(description="[run] with until_time or until_bounces")
    tolerances: dict[str, Annotated[float, above_zero()]] = Field(
        {}, description="metric = allowed relative difference"
    )
    needs: dict[str, bool] = Field({}, description="physics = true or false")


CaseTable.parts = {
    "particles": ParticleTable,
    "walls": WallTable,
    "contact": ContactTable,
    "measured": MeasuredTable,
    "pairs": PairTable,
    "run": RunTable,
}


def table_at(path: tuple[str | int, ...], root: type[Root] = CaseTable) -> type[Table]:
    """Return the table whose key or inside ``path`` is: ``("walls", 0, "axis")`` -> `WallTable`."""
    if path[:1] == ("materials",) and len(path) > 2:
        return MaterialTable
    tables = [part for part in path[:-1] if part in root.parts]
    return root.parts[str(tables[-1])] if tables else root


def description(path: tuple[str | int, ...], root: type[Root] = CaseTable) -> str:
    """Return what the key at ``path`` means, with its unit; "" for a key that kncal doesn't know."""
    while path and isinstance(path[-1], int):
        path = path[:-1]
    field = table_at(path, root).model_fields.get(str(path[-1])) if path else None
    return (field.description or "") if field is not None else ""
