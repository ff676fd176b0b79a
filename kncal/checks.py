"""One wording for every refusal of a bad number: argument, value, range, and what to do."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kncal.errors import InputError

Array = NDArray[np.float64]


def as_floats(name: str, value: ArrayLike) -> Array:
    """Return ``value`` as a float array of any shape; refuse what is not a finite real number.

    Raises
    ------
    InputError
        If a value is not a number, complex, boolean, NaN or infinite.
    """
    given = np.asarray(value)
    if given.dtype.kind not in "iuf":
        raise InputError(f"{name} = {value!r}: expected a real number (or an array of them), in SI units")
    numbers = given.astype(np.float64)
    bad = ~np.isfinite(numbers)
    if bad.any():
        raise InputError(f"{name} = {_first(numbers, bad)}: expected a finite number")
    return numbers


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
    return numbers


def positive(name: str, value: ArrayLike, *, unit: str = "", hint: str = "") -> Array:
    """Return ``value`` as a float array of positive finite numbers; see `in_range` for the error."""
    return in_range(name, value, 0.0, np.inf, low_open=True, unit=unit, hint=hint)


def one_of(name: str, value: object, allowed: Collection[str]) -> str:
    """Return ``value`` if it is one of the ``allowed`` names, else raise `InputError` with the nearest name."""
    if isinstance(value, str) and value in allowed:
        return value
    import difflib

    near = difflib.get_close_matches(str(value), list(allowed), n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise InputError(f"{name} = {value!r}: expected one of {', '.join(sorted(allowed))}{hint}")


def _first(numbers: Array, bad: NDArray[np.bool_]) -> str:
    if numbers.ndim == 0:
        return f"{float(numbers):g}"
    index = tuple(int(i) for i in np.argwhere(bad)[0])
    return f"{float(numbers[index]):g} (element {list(index)} of an array of shape {numbers.shape})"
