"""One wording for every refusal of a bad argument: its name, the value, what was expected, and what to do."""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kncal.core.errors import InputError

Array = NDArray[np.float64]
_T = TypeVar("_T")

#: Most numbers that an argument, or arguments together, may have: all that is computed of them takes about 0.5 GiB.
MOST_VALUES = 1_000_000
#: Dimensions that numpy has at most.
_DEEPEST = 64

#: What may be written into solver input as a name: nothing in it can be a command.
NAME_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


def as_floats(name: str, value: ArrayLike) -> Array:
    """Return ``value`` as a float array of any shape; refuse what is not a finite real number.

    Raises
    ------
    InputError
        If a value is not a number, complex, boolean, NaN, infinite or masked, lists are ragged, there is none, or more
        than `MOST_VALUES`.
    """
    if (count := _count(value)) > MOST_VALUES:
        raise InputError(f"{name} has {count:.3g} values: expected at most {MOST_VALUES:,}; give them in parts")
    if np.ma.is_masked(value):
        raise InputError(f"{name} has masked elements: expected a number in each; leave the masked ones out")
    try:
        given = np.asarray(value)
    except Exception as error:  # ragged lists; an object of somebody else may raise anything
        raise InputError(f"{name} = {short(value)}: expected a number, or rows of equal length of them") from error
    if given.size == 0:
        raise InputError(f"{name} has shape {given.shape}: expected at least one value")
    if given.dtype.kind not in "iuf":
        raise InputError(f"{name} = {short(value)}: expected a real number (or an array of them), in SI units")
    with np.errstate(over="ignore"):  # of longer floats; told below
        numbers = given.astype(np.float64)
    bad = ~np.isfinite(numbers)
    if bad.any():
        raise InputError(f"{name} = {_first(numbers, bad)}: expected a finite number")
    return numbers


def _count(value: object) -> float:
    """Number of values in an array or in lists in lists (judged by the first of each), without making an array."""
    size = getattr(value, "size", None)
    if isinstance(size, int):
        return size
    count = 1.0
    for _ in range(_DEEPEST):
        if not isinstance(value, (list, tuple, range)) or not value:
            break
        count *= float(len(value)) if not isinstance(value, range) else (value[-1] - value[0]) / value.step + 1.0
        value = value[0]
    return count


def in_range(
    name: str,
    value: ArrayLike,
    low: float,
    high: float,
    *,
    low_open: bool = False,
    unit: str = "",
    hint: str = "",
) -> Array:
    """Return ``value`` as a float array whose every element lies in [low, high] (or (low, high] if ``low_open``).

    Raises
    ------
    InputError
        Naming the argument, the first offending value (with its index in an array) and the range.
    """
    numbers = as_floats(name, value)
    bad = ((numbers <= low) if low_open else (numbers < low)) | (numbers > high)
    if bad.any():
        bracket = "(" if low_open else "["
        upper = "inf)" if high == np.inf else f"{high:g}]"
        text = f"{name} = {_first(numbers, bad)}: expected a value in {bracket}{low:g}, {upper}"
        text += f" {unit}" if unit else ""
        raise InputError(f"{text}; {hint}" if hint else text)
    return numbers + 0.0  # a zero, not a negative one: its sign would reach decks


def positive(name: str, value: ArrayLike, *, unit: str = "", hint: str = "") -> Array:
    """Return ``value`` as a float array of positive finite numbers; see `in_range` for the error."""
    return in_range(name, value, 0.0, np.inf, low_open=True, unit=unit, hint=hint)


@dataclass(frozen=True)
class Range:
    """The numbers that a value may be, [low, high] or (low, high]; a check, which the reference pages read too."""

    low: float
    high: float
    unit: str = ""
    hint: str = ""
    low_open: bool = False

    def check(self, name: str, value: ArrayLike) -> Array:
        """Return ``value`` as a float array; see `in_range` for the error."""
        return in_range(name, value, self.low, self.high, low_open=self.low_open, unit=self.unit, hint=self.hint)

    def __call__(self, value: float) -> float:
        """Return a number as it is, checked; 0 for -0."""
        self.check("value", value)
        return value + 0


def single(name: str, value: ArrayLike) -> float:
    """Return ``value`` as a float; refuse what is not one finite real number (also an array of one)."""
    numbers = as_floats(name, value)
    if numbers.ndim != 0:
        raise InputError(f"{name} has shape {numbers.shape}: expected a single number")
    return float(numbers)


def common_shape(**given: Any) -> tuple[int, ...]:
    """Return the shape that checked arguments (numbers, or objects with a ``shape``) broadcast to.

    Raises
    ------
    InputError
        Naming the arguments that are arrays, with their shapes, if they do not fit together or are too many.
    """
    shapes = {name: np.shape(value) for name, value in given.items()}
    seen = ", ".join(f"{name} {shape}" for name, shape in shapes.items() if shape)
    try:
        shape = np.broadcast_shapes(*shapes.values())
    except ValueError:
        raise InputError(f"shapes do not fit together: {seen}; expected shapes that broadcast") from None
    if (count := math.prod(shape)) > MOST_VALUES:
        raise InputError(f"{seen} make {count:.3g} values together: expected at most {MOST_VALUES:,}; split them")
    return shape


def whole(name: str, value: object, low: int, high: int) -> int:
    """Return ``value`` as an int; refuse what is not a whole number in [low, high]."""
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool) or not low <= value <= high:
        raise InputError(f"{name} = {short(value)}: expected a whole number from {low} to {high}")
    return int(value)


def positive_result(what: str, value: ArrayLike, arguments: str) -> None:
    """Refuse a result that is not finite and positive: the ``arguments`` are beyond what floats can hold."""
    numbers = np.asarray(value)
    bad = ~(np.isfinite(numbers) & (numbers > 0.0))
    if bad.any():
        raise InputError(f"{what} would be {_first(numbers, bad)}: expected a less extreme {arguments}")


def instance(name: str, value: object, kind: type[_T], source: str) -> _T:
    """Return ``value`` if it is a ``kind``; else `InputError`, saying what makes one (``source``)."""
    if isinstance(value, kind):
        return value
    raise InputError(f"{name} = {short(value)}: expected a {kind.__name__} ({source})")


def plain_name(name: str, value: object) -> str:
    """Return ``value`` if it is a name of 1 to 64 letters, digits, ``.``, ``_`` or ``-``, else raise `InputError`."""
    if isinstance(value, str) and NAME_PATTERN.fullmatch(value):
        return value
    raise InputError(
        f"{name} {short(value)}: expected a name of at most 64 letters (A-Z, a-z), digits, '.', '_' and '-', starting "
        "with a letter or a digit (names are written into solver input)"
    )


def one_of(name: str, value: object, allowed: Collection[str]) -> str:
    """Return ``value`` if it is one of the ``allowed`` names, else raise `InputError` with the nearest name."""
    if isinstance(value, str) and value in allowed:
        return value
    raise InputError(f"{name} = {short(value)}: expected one of {', '.join(sorted(allowed))}{nearest(value, allowed)}")


#: What others call things, without underscores: what kncal calls them.
_ALIASES = {
    "restitution": "e_n", "coefficientofrestitution": "e_n", "cor": "e_n", "stiffness": "k_n", "mu": "friction",
    "frictioncoefficient": "friction", "nu": "poisson", "poissonsratio": "poisson", "youngsmodulus": "young",
    "e": "young", "rho": "density", "impactvelocity": "v_0", "impactspeed": "v_0", "superficialvelocity": "U_0",
    "gidaspow": "ErgunWenYu", "ergun": "ErgunWenYu", "wenyu": "ErgunWenYu", "hunt": "hunt_crossley", "timestep": "dt",
}  # fmt: skip


def nearest(name: object, allowed: Collection[str]) -> str:
    """Return "; did you mean 'e_n'?" for what is another word for, or looks like, one of ``allowed``; else ""."""
    import difflib

    if not isinstance(name, str):
        return ""
    plain = _plain(name)
    near = [one for one in allowed if _plain(one) == plain or _ALIASES.get(plain) == one]
    near = near or difflib.get_close_matches(name[:100], list(allowed), n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


def _plain(name: str) -> str:
    return re.sub("[^a-z0-9]", "", name[:100].lower())


def short(value: object, most: int = 70) -> str:
    """Return a value as Python writes it, on a line of ``most`` characters, harmless on a terminal."""
    try:
        text = repr(value)  # escapes control characters and line separators
    except Exception:  # a number of too many digits, lists too deep, an object that cannot say what it is
        text = f"<{type(value).__name__}>"
    text = " ".join(text.split()) if "\n" in text else text
    return text if len(text) <= most else f"{text[: most - 3]}..."


def _first(numbers: Array, bad: NDArray[np.bool_]) -> str:
    if numbers.ndim == 0:
        return f"{float(numbers):g}"
    index = tuple(int(i) for i in np.argwhere(bad)[0])
    return f"{float(numbers[index]):g} (element {list(index)} of an array of shape {numbers.shape})"
