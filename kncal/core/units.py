"""Numbers with units, as people read them: 2.3e-6 m is 2.3 µm."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G", 12: "T"}


def si_prefix(values: ArrayLike, unit: str) -> tuple[float, str]:
    """Return (factor, label) such that factor*values reads well: 3e-6 and "m" give 1e6 and "µm".

    Chosen for the largest finite value. Zero has no prefix; what is beyond pico and tera keeps these. The kilogram has
    a prefix already: 0.002 kg/s are 2 g/s.
    """
    finite = np.abs(np.asarray(values, dtype=np.float64))
    largest = float(finite[np.isfinite(finite)].max(initial=0.0))
    if unit.startswith("kg"):
        if largest >= 1.0 or largest == 0.0:
            return 1.0, unit
        factor, label = si_prefix(1e3 * largest, unit[1:])
        return 1e3 * factor, label
    # + 1e-9: 999.9999999999 µm is 1 mm that lost a bit
    exponent = 0 if largest == 0.0 else 3 * int(np.floor((np.log10(largest) + 1e-9) / 3.0))
    exponent = min(max(exponent, min(_PREFIXES)), max(_PREFIXES))
    return 10.0**-exponent, f"{_PREFIXES[exponent]}{unit}"


def quantity(value: float | None, unit: str, digits: int = 5, *, width: float | None = None) -> str:
    """Return a number with its unit and a fitting prefix; "–" for one that is not there; integers in full.

    The unit "%" takes a share (0.05 is 5 %), "" and "–" are numbers without a unit. With ``width`` both have one
    prefix: "323.36 ± 0.94 mm". An angle has no prefix, nor has a power, of which it would be read as part.
    """
    if value is None or not np.isfinite(value):
        return "–"
    half = width if width is not None and np.isfinite(width) else 0.0
    factor, label = (100.0, "%") if unit == "%" else (1.0, unit.strip("–"))
    if label not in ("", "%") and not unit.startswith("rad") and "²" not in unit.partition("/")[0]:
        factor, label = si_prefix([value, half], unit)
    if half:
        return f"{plus_minus(factor * value, factor * half)} {label}".rstrip()
    if isinstance(value, int) and not label:
        return f"{value:,d}"
    return f"{factor * value:.{3 if unit == '%' else digits}g} {label}".rstrip()


def span(value: float, low: float, high: float, unit: str, digits: int = 4) -> str:
    """Return a number with its interval, all with one prefix: "163.9 (147 to 207.9) N/m"; alone without a width."""
    if not high > low:
        return quantity(value, unit, digits)
    factor, label = si_prefix(value, unit)
    return f"{factor * value:.{digits}g} ({factor * low:.{digits}g} to {factor * high:.{digits}g}) {label}"


def percent(share: float | None) -> str:
    """Return a share with its sign in percent; "–" for one that is not there."""
    if share is None:
        return "–"
    # rounding of the frames' digits, not a difference
    return f"{100.0 * share:+.3g} %" if abs(share) >= 1e-7 else "0 %"


def plus_minus(value: float, width: float, *, signed: bool = False) -> str:
    """Return "105.3 ± 1.2": two digits of the width, and the value to the same decimals."""
    sign = "+" if signed else ""
    if width <= 1e-9 * abs(value):  # rounding
        return f"{value:{sign}.4g} ± 0"
    decimals = 1 - math.floor(math.log10(width))
    if decimals > 6:  # both are mostly zeros
        return f"{value:{sign}.4g} ± {width:.2g}"
    places = max(decimals, 0)
    return f"{round(value, places) + 0.0:{sign}.{places}f} ± {width:.{places}f}"  # + 0.0: no "-0.0"
