"""What single values of a scene may be: checked numbers, names and lines of text, for the classes of a scene."""

from __future__ import annotations

import re
from functools import wraps
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, cast, dataclass_transform

import numpy as np
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, Strict, ValidationError
from pydantic.dataclasses import dataclass

from kncal.core.checks import Range, positive, short
from kncal.core.errors import InputError

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

#: Names reach folders, decks and reports.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
NAME_EXPECTED = "expected a name of 1 to 64 letters, digits, '.', '_' or '-', starting with a letter or digit"

_T = TypeVar("_T")


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(Field,))
def checked_class(cls: type[_T]) -> type[_T]:
    """Make a class of a scene: what it is made of is checked against its fields, and stays.

    Unknown keys, NaN and infinity are refused; `InputError` where somebody makes one in Python, from a case file
    pydantic's own error, of which `kncal.scene.case_errors` makes lines.
    """
    made: Any = dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))(cls)
    checking = made.__init__

    @wraps(checking)
    def init(self: Any, **given: Any) -> None:
        try:
            checking(self, **given)
        except ValidationError as error:
            found = error.errors(include_url=False)
            raise InputError("; ".join(_told(cls.__name__, e) for e in found)) from None

    made.__init__ = init
    return cast("type[_T]", made)


def _told(name: str, error: ErrorDetails) -> str:
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in error["loc"])
    given = "" if error["type"] in ("missing", "unexpected_keyword_argument") else f" = {short(error['input'])}"
    text = str(error.get("ctx", {}).get("error", error["msg"]))
    found = re.search(r"\bexpected .*", text, re.S)
    return f"{name}{key}{given}: {found[0] if found else text}"


def _name(text: str) -> str:
    if not NAME.fullmatch(text):
        raise ValueError(NAME_EXPECTED)
    return text


def _line(text: str) -> str:
    if not text.isprintable() or len(text) > 300:
        raise ValueError("expected one line of at most 300 printable characters")
    return text


def _option(value: float | str) -> float | str:
    if isinstance(value, str):
        return _name(value)
    positive("value", value)
    return value


def within(low: float, high: float, unit: str = "", hint: str = "") -> AfterValidator:
    """Return a validator for a number in [low, high]."""
    return AfterValidator(Range(low, high, unit, hint))


def above_zero(unit: str = "", hint: str = "", high: float = np.inf) -> AfterValidator:
    """Return a validator for a number in (0, high]."""
    return AfterValidator(Range(0.0, high, unit, hint, low_open=True))


def _integer(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError("expected a whole number")
    return value


# Strict: text or a boolean is no number, and a number is no text.
Number = Annotated[float, Strict()]
Whole = Annotated[int, Strict()]
Flag = Annotated[bool, Strict()]
Word = Annotated[str, Strict()]
Name = Annotated[Word, AfterValidator(_name)]
Text = Annotated[Word, AfterValidator(_line)]
Option = Annotated[Number | Word, AfterValidator(_option)]
Restitution = Annotated[Number, within(1e-3, 1.0, hint="90 % is 0.9; a contact with less than 0.001 hardly ever ends")]
Friction = Annotated[Number, within(0.0, 10.0)]
Cohesion = Annotated[Number, within(0.0, 1e12, "J/m³")]
Speed = Annotated[Number, above_zero("m/s", high=1e4)]
Stiffness = Annotated[Number, above_zero("N/m")]
Seconds = Annotated[Number, above_zero("s")]
#: A step may be no longer than anybody has time.
Step = Annotated[Number, above_zero("s", high=1e3)]
Time = Annotated[Number, within(0.0, 1e6, "s")]
Length = Annotated[Number, within(2e-9, 1e3, "m", "1 mm is 1e-3")]
Coordinate = Annotated[Number, within(-1e4, 1e4, "m", "1 mm is 1e-3")]
Share = Annotated[Number, above_zero(high=1.0)]
Tolerance = Annotated[Number, above_zero()]
#: Parcels that may share a particle's volume.
Parcels = Annotated[Literal[1, 8, 27], BeforeValidator(_integer)]
GasSpeed = Annotated[Number, within(0.0, 1e3, "m/s")]
#: From a gas at a thousandth of an atmosphere to mercury; from hydrogen, and a little below, to glycerine and pitch.
GasDensity = Annotated[Number, within(1e-4, 2e4, "kg/m³", "air: 1.2")]
GasViscosity = Annotated[Number, within(1e-7, 1e2, "Pa s", "air: 1.8e-5")]

_Ms = Annotated[Number, within(-1e4, 1e4, "m/s")]
_RadS = Annotated[Number, within(-1e8, 1e8, "rad/s")]
_Ms2 = Annotated[Number, within(-1e5, 1e5, "m/s²")]
Position = tuple[Coordinate, Coordinate, Coordinate]
Velocity = tuple[_Ms, _Ms, _Ms]
Spin = tuple[_RadS, _RadS, _RadS]
Acceleration = tuple[_Ms2, _Ms2, _Ms2]
Size = tuple[Length, Length, Length]

#: More gas cells than this are no work for one core.
MOST_CELLS_PER_AXIS, MOST_CELLS = 10_000, 1_000_000
_Cells = Annotated[Whole, within(1, MOST_CELLS_PER_AXIS)]
Cells = tuple[_Cells, _Cells, _Cells]
RampPoint = tuple[Time, GasSpeed]
MOST_RAMP = 1000
Ramp = Annotated[tuple[RampPoint, ...], Field(max_length=MOST_RAMP)]
