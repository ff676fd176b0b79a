"""Size distributions of a group of particles, and the classes of one diameter each that stand for them.

A class has the diameter whose cube is the mean cube of its particles. So each class, and so the group, keeps its number
of particles and its mass; means of other powers (mean diameter, Sauter mean) differ by the square of a class' width.

How wide a class may be: k_n and eta_n of a class are used for particles at its edges, whose diameter differs by a
factor f. By dimensions k_n at a given speed grows as the size of a pair (as R_eff^(2/5) m_eff^(1/5) for every method),
so it is wrong by f - 1 at most: if both partners are at an edge, or the other is a wall. e_n follows from the damping
ratio zeta = eta_n/(2 sqrt(k_n m_eff)), and m_eff grows as f³ at most: with the numbers of its class a particle has zeta
f^(-3/2). `half_width` is the ln f that keeps both errors below the one asked for.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from kncal.core.checks import Array, in_range, short
from kncal.core.errors import InputError, ReadError
from kncal.core.files import read_limited
from kncal.scene.values import Length, Number, Share, Text, above_zero, checked_class, within

#: Every two classes have a contact of their own: more are no longer readable, in a deck or a report.
MOST_CLASSES = 50
#: Of a sieve curve.
MOST_BYTES, MOST_SIEVES = 1024**2, 1000
#: Below this e_n the error of e_n decides how wide a class is, above it that of k_n.
USUAL_E_N = 0.5
#: Nothing of a normal distribution is looked for farther from its middle [standard deviations].
_FAR = 8.0
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


@checked_class
class Normal:
    """``sizes.normal``: a normal distribution of the diameter between two cut-offs."""

    mean: Length = Field(description="mean diameter, before it is cut off [m]")
    std: Length = Field(description="standard deviation of the diameter, before it is cut off [m]")
    low: Length = Field(description="smallest diameter [m]")
    high: Length = Field(description="largest diameter [m]")

    @model_validator(mode="after")
    def _is_there(self) -> Normal:
        _in_reach(self.low, self.high, self.mean - _FAR * self.std, self.mean + _FAR * self.std)
        return self


@checked_class
class Lognormal:
    """``sizes.lognormal``: a normal distribution of the diameter's logarithm between two cut-offs."""

    median: Length = Field(description="median diameter, before it is cut off [m]")
    sigma: Annotated[Number, above_zero(high=3.0)] = Field(
        description="standard deviation of ln(diameter), before it is cut off [-]: ln of the geometric one"
    )
    low: Length = Field(description="smallest diameter [m]")
    high: Length = Field(description="largest diameter [m]")

    @model_validator(mode="after")
    def _is_there(self) -> Lognormal:
        reach = math.exp(_FAR * self.sigma)
        _in_reach(self.low, self.high, self.median / reach, self.median * reach)
        return self


@checked_class
class Sieve:
    """``sizes.sieve``: a sieve curve; between two sieves the share grows with the logarithm of the diameter."""

    file: Text = Field(
        description="a CSV file in the case's folder: a line of names, then size of a mesh, percent that passes it"
    )
    scale: Annotated[Number, above_zero("m")] = Field(
        default=1.0, description="what the file's unit of size is [m]: 1e-3 for mm"
    )


def _in_reach(low: float, high: float, least: float, most: float) -> None:
    if not low < high:
        raise ValueError(f"expected low = {low:g} below high = {high:g} (for one size: diameter)")
    if not (low < most and high > least):
        raise ValueError(
            f"expected cut-offs that leave something: low = {low:g} to high = {high:g} is more than {_FAR:g} standard "
            "deviations from the middle"
        )


@checked_class
class Sizes:
    """``[particles.NAME.sizes]``: several sizes in place of one diameter, by exactly one of its four ways."""

    shares: Annotated[tuple[tuple[Length, Share], ...], Field(max_length=MOST_CLASSES)] = Field(
        default=(), description="[[diameter [m], share], ...]; the shares add up to 1"
    )
    normal: Normal | None = Field(default=None, description="[particles.NAME.sizes.normal] with mean, std, low, high")
    lognormal: Lognormal | None = Field(
        default=None, description="[particles.NAME.sizes.lognormal] with median, sigma, low, high"
    )
    sieve: Sieve | None = Field(default=None, description="[particles.NAME.sizes.sieve] with file")
    by: Literal["mass", "number"] = Field(default="mass", description='what is distributed: "mass" or "number"')
    class_error: Annotated[Number, within(1e-3, 0.5)] = Field(
        default=0.02,
        description="a distribution becomes classes of one diameter each, so narrow that k_n and e_n of no particle "
        "are farther than this from those of its class [-]",
    )

    @model_validator(mode="after")
    def _one_way(self) -> Sizes:
        ways = ("shares", "normal", "lognormal", "sieve")
        given = [way for way in ways if getattr(self, way)]
        if len(given) != 1:
            raise ValueError(f"expected exactly one of {', '.join(ways)}, not {' and '.join(given) or 'none'}")
        if self.shares:
            diameters, shares = zip(*self.shares, strict=True)
            if len(set(diameters)) < len(diameters):
                raise ValueError(f"expected each diameter once in shares, not {short(diameters)}")
            if abs((total := math.fsum(shares)) - 1.0) > 1e-6:
                raise ValueError(f"expected shares that add up to 1, not {total:.10g}")
        return self


class Classes(NamedTuple):
    """Sizes as classes: ``diameters`` [m] that increase, and the ``shares`` of the number of particles, both (k,)."""

    diameters: Array
    shares: Array

    @property
    def volume(self) -> float:
        """Mean volume of a particle [m³]."""
        return float(np.pi / 6.0 * self.shares @ self.diameters**3)

    @property
    def mass_shares(self) -> Array:
        """Shares of the mass (k,)."""
        mass = self.shares * self.diameters**3
        return np.asarray(mass / mass.sum())


def classes(sizes: Sizes, path_of: Callable[[str], Path] = Path, e_n: float = USUAL_E_N) -> Classes:
    """Return the classes of a size distribution.

    Parameters
    ----------
    sizes : Sizes
    path_of : where a file that the case names lies
    e_n : the smallest normal restitution of the group's contacts [-]

    Raises
    ------
    ReadError
        If the sieve curve cannot be read; the text names file and line.
    InputError
        If the error asked for takes more than `MOST_CLASSES` classes.
    """
    if sizes.shares:
        diameters, given = np.array(sorted(sizes.shares)).T
        number = given / diameters**3 if sizes.by == "mass" else given
        return Classes(diameters, number / number.sum())
    density, knots = _density(sizes, path_of)
    width = half_width(sizes.class_error, e_n)
    least = max(1, math.ceil(math.log(knots[-1] / knots[0]) / (2.0 * width) - 1e-9))
    for count in range(min(least, MOST_CLASSES), MOST_CLASSES + 1):
        made, widest = _classes(density, knots, count, by_mass=sizes.by == "mass")
        if widest <= width:  # a class' diameter is not in its middle
            return made
    raise _too_many(knots, sizes.class_error, e_n, widest / width)


def merged(diameters: Array, class_error: float, e_n: float = USUAL_E_N) -> tuple[Classes, NDArray[np.int64]]:
    """Return classes of single particles' diameters (n,) [m], and the number of the class of each (n,).

    Up to `MOST_CLASSES` different diameters stay as they are (equal to 1e-6); more become classes as those of a
    distribution do.

    Raises
    ------
    InputError
        If the error asked for takes more than `MOST_CLASSES` classes.
    """
    order = np.argsort(diameters, kind="stable")
    d = np.asarray(diameters)[order]
    new = np.diff(np.log(d), prepend=-np.inf) > 1e-6
    made = d[new]
    if made.size > MOST_CLASSES:
        new, made = _bins(d, class_error, e_n)
    kind = np.empty(d.size, dtype=np.int64)
    kind[order] = np.cumsum(new) - 1
    return Classes(made, np.bincount(kind) / d.size), kind


def _bins(d: Array, class_error: float, e_n: float) -> tuple[NDArray[np.bool_], Array]:
    """Return which of rising diameters (n,) begin a class, and the diameter of each class (k,)."""
    width, place = half_width(class_error, e_n), np.log(d / d[0])
    for count in range(min(max(1, math.ceil(place[-1] / (2.0 * width) - 1e-9)), MOST_CLASSES), MOST_CLASSES + 1):
        new = np.diff(np.minimum(np.floor(place * (count / place[-1])), count - 1), prepend=-1.0) > 0.0
        starts = np.flatnonzero(new)
        made = d[0] * np.cbrt(np.add.reduceat((d / d[0]) ** 3, starts) / np.diff(starts, append=d.size))
        highest = d[np.append(starts[1:], d.size) - 1]
        widest = float(np.max(np.log(np.maximum(highest / made, made / d[starts]))))
        if widest <= width:
            return new, made
    raise _too_many(d, class_error, e_n, widest / width)


def _too_many(diameters: Array, class_error: float, e_n: float, times: float) -> InputError:
    return InputError(
        f"sizes: diameters from {diameters[0]:g} to {diameters[-1]:g} m take more than {MOST_CLASSES} classes for "
        f"class_error = {class_error:g} at e_n = {e_n:g}: expected closer limits, or class_error = "
        f"{1.05 * class_error * times:.2g}"
    )


def half_width(class_error: float, e_n: float) -> float:
    """Return the largest |ln(diameter/class diameter)| that keeps k_n and e_n of a particle (module text).

    ``class_error``: largest relative error of both [-].
    """
    in_range("class_error", class_error, 0.0, 0.999, low_open=True)
    in_range("e_n", e_n, 0.0, 1.0, low_open=True)
    width = math.log1p(class_error)  # of k_n, at the lower edge: f - 1
    if e_n == 1.0:
        return width

    def damping(e: float) -> float:
        """Damping ratio of a linear contact that ends at zero overlap."""
        return -math.log(e) / math.hypot(math.pi, math.log(e))

    for e in (e_n * (1.0 - class_error), e_n * (1.0 + class_error)):
        if e < 1.0:
            width = min(width, 2.0 / 3.0 * abs(math.log(damping(e) / damping(e_n))))
    return width


def counts(shares: Array, number: int) -> NDArray[np.int64]:
    """Return how many of ``number`` particles each class has (k,): its share within one particle, together all."""
    exact = number * np.asarray(shares) / np.sum(shares)
    whole = np.floor(exact + 1e-9).astype(np.int64)  # 3 shares of 0.1 of 10 are 3 particles
    first = np.argsort(whole - exact, kind="stable")[: number - int(whole.sum())]
    whole[first] += 1
    return whole


def _density(sizes: Sizes, path_of: Callable[[str], Path]) -> tuple[Callable[[Array], Array], Array]:
    """Return the density over ln(diameter) up to a factor, and the diameters (m,) between which it is smooth [m]."""
    if sizes.sieve is not None:
        mesh, passing = read_sieves(path_of(sizes.sieve.file), sizes.sieve.scale)
        steps = np.diff(passing) / np.diff(np.log(mesh))
        used = np.flatnonzero(steps)
        mesh, steps = mesh[used[0] : used[-1] + 2], steps[used[0] : used[-1] + 1]

        def stepwise(d: Array) -> Array:
            return np.asarray(steps[np.clip(np.searchsorted(mesh, d, side="right") - 1, 0, steps.size - 1)])

        return stepwise, mesh
    if sizes.lognormal is not None:
        one = sizes.lognormal
        log_median, sigma = math.log(one.median), one.sigma
        reach = math.exp(_FAR * sigma)
        low, high = max(one.low, one.median / reach), min(one.high, one.median * reach)
        fine = math.ceil(math.log(high / low) / sigma)
        return lambda d: np.exp(-0.5 * ((np.log(d) - log_median) / sigma) ** 2), np.geomspace(low, high, fine + 1)
    assert sizes.normal is not None  # noqa: S101  # by the check of `Sizes`
    mean, std = sizes.normal.mean, sizes.normal.std
    low, high = max(sizes.normal.low, mean - _FAR * std), min(sizes.normal.high, mean + _FAR * std)
    fine = math.ceil((high - low) / std)
    return lambda d: d * np.exp(-0.5 * ((d - mean) / std) ** 2), np.linspace(low, high, fine + 1)


def _classes(density: Callable[[Array], Array], knots: Array, count: int, *, by_mass: bool) -> tuple[Classes, float]:
    """Return the ``count`` classes of equal ratio that hold something, and the largest |ln(edge/diameter)|."""
    edges = np.geomspace(knots[0], knots[-1], count + 1)
    edges[0], edges[-1] = knots[0], knots[-1]
    cells = np.unique(np.concatenate([edges, knots]))
    middle, half = 0.5 * np.log(cells[1:] * cells[:-1]), 0.5 * np.diff(np.log(cells))
    d = np.exp(middle[:, None] + half[:, None] * _NODES)
    given = density(d)
    if by_mass:
        number, mass = (given / d**3) @ _WEIGHTS * half, given @ _WEIGHTS * half
    else:
        number, mass = given @ _WEIGHTS * half, (given * d**3) @ _WEIGHTS * half
    filled = number > 0.0
    owner = np.searchsorted(edges, np.exp(middle), side="right")[filled] - 1
    _, starts = np.unique(owner, return_index=True)
    ends = np.append(starts[1:], owner.size) - 1
    numbers, masses = np.add.reduceat(number[filled], starts), np.add.reduceat(mass[filled], starts)
    diameters = np.cbrt(masses / numbers)
    low, high = cells[:-1][filled][starts], cells[1:][filled][ends]
    widest = float(np.max(np.log(np.maximum(high / diameters, diameters / low))))
    return Classes(diameters, numbers / numbers.sum()), widest


def read_sieves(path: Path, scale: float = 1.0) -> tuple[Array, Array]:
    """Read a sieve curve from a CSV file: a line of names, then rows of mesh size and percent that passes.

    Returns
    -------
    size, passing : mesh sizes [m] that increase, and the shares of what was sieved that pass, from 0 to 1, (n,)

    Raises
    ------
    ReadError
        If the file is missing, too large, or not that; the text names the file and the line.
    """
    expected = "a line of names, then lines of two numbers: size of the mesh, percent that passes"
    try:
        text = read_limited(path, MOST_BYTES, f"a CSV file, {expected}").decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ReadError(f"{path}: not UTF-8 text ({error.reason}); expected a CSV file, {expected}") from error
    rows: list[tuple[float, float]] = []
    for number, fields in enumerate(csv.reader(text.splitlines()), start=1):
        where = f"{path}, line {number}: {short(','.join(fields))}"
        if number == 1 or not any(map(str.strip, fields)):
            continue
        try:
            size, passing = map(float, fields)
        except ValueError:
            raise ReadError(f"{where}; expected two numbers with a comma between, decimals with a point") from None
        if not 2e-9 <= size * scale <= 1e3:
            raise ReadError(f"{where}; expected a mesh from 2e-9 to 1000 m, not {size * scale:g} m (see scale)")
        if not 0.0 <= passing <= 100.0:
            raise ReadError(f"{where}; expected a percentage from 0 to 100")
        if rows and (size <= rows[-1][0] or passing < rows[-1][1]):
            raise ReadError(f"{where}; expected meshes that increase, and no less passing than the line above")
        rows.append((size, passing))
        if len(rows) > MOST_SIEVES:
            raise ReadError(f"{where}; expected at most {MOST_SIEVES} sieves")
    if len(rows) < 2 or rows[0][1] != 0.0 or rows[-1][1] != 100.0:
        raise ReadError(
            f"{path}: {len(rows)} sieves{f', {rows[0][1]:g} to {rows[-1][1]:g} %' if rows else ''}; expected at least "
            f"two, the first with 0 %, the last with 100 %; {expected}"
        )
    size, passing = np.array(rows).T
    return size * scale, passing / 100.0
