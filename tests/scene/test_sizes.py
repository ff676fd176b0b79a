"""Size distributions: their moments against closed forms, and what classes of one diameter keep."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from kncal.core.errors import InputError, ReadError
from kncal.physics.calibration import calibrate
from kncal.physics.material import Material, pair
from kncal.scene.sizes import (
    MOST_CLASSES,
    Classes,
    Lognormal,
    Normal,
    Sieve,
    Sizes,
    classes,
    counts,
    half_width,
    read_sieves,
)

MM = 1e-3


def moment(made: Classes, power: float) -> float:
    return float(made.shares @ made.diameters**power)


def test_shares_by_mass_and_by_number() -> None:
    """One part of 2 mm and one of 1 mm by mass: eight small ones for one large one."""
    by_mass = classes(Sizes(shares=((2 * MM, 0.5), (1 * MM, 0.5))))
    assert by_mass.diameters == pytest.approx([1 * MM, 2 * MM])
    assert by_mass.shares == pytest.approx([8 / 9, 1 / 9])
    assert by_mass.mass_shares == pytest.approx([0.5, 0.5])
    by_number = classes(Sizes(shares=((2 * MM, 0.25), (1 * MM, 0.75)), by="number"))
    assert by_number.shares == pytest.approx([0.75, 0.25])
    assert by_number.volume == pytest.approx(math.pi / 6 * (0.75 + 0.25 * 8) * 1e-9)


def test_normal_keeps_number_and_mass() -> None:
    """The mean cube is that of scipy's truncated normal; the mean diameter within the square of a class' width."""
    made = classes(Sizes(normal=Normal(mean=2 * MM, std=0.2 * MM, low=1.5 * MM, high=2.6 * MM), by="number"))
    exact = stats.truncnorm(-2.5, 3.0, loc=2 * MM, scale=0.2 * MM)
    assert moment(made, 3) == pytest.approx(exact.moment(3), rel=1e-10)
    assert moment(made, 1) == pytest.approx(exact.mean(), rel=0.02**2)
    assert moment(made, 3) ** (1 / 3) > 2 * MM


def test_lognormal_by_mass_and_by_number_are_one_distribution() -> None:
    """Hatch and Choate (1929): by mass the median is exp(3 sigma²) times that by number, sigma the same."""
    sigma, low, high = 0.2, 0.5 * MM, 4 * MM
    given: dict[str, Any] = {"sigma": sigma, "low": low, "high": high}
    by_number = classes(Sizes(lognormal=Lognormal(median=1 * MM, **given), by="number", class_error=0.05))
    median = 1 * MM * math.exp(3 * sigma**2)
    by_mass = classes(Sizes(lognormal=Lognormal(median=median, **given), by="mass", class_error=0.05))
    assert by_mass.diameters == pytest.approx(by_number.diameters, rel=1e-10)
    assert by_mass.shares == pytest.approx(by_number.shares, rel=1e-9, abs=1e-14)
    # the third moment, cut off at z_low and z_high, moves the normal distribution by 3 sigma
    z = np.log(np.array([low, high]) / MM) / sigma
    cut = np.diff(stats.norm.cdf(z - 3 * sigma))[0] / np.diff(stats.norm.cdf(z))[0]
    assert moment(by_number, 3) == pytest.approx(MM**3 * math.exp(4.5 * sigma**2) * cut, rel=1e-9)


def test_smaller_classes_come_closer() -> None:
    """Mass and number stay, and the Sauter mean tends to its exact value with the square of the width."""
    sigma = 0.25
    z = np.log([0.5, 2.5]) / sigma

    def made(error: float) -> Classes:
        one = Lognormal(median=1 * MM, sigma=sigma, low=0.5 * MM, high=2.5 * MM)
        return classes(Sizes(lognormal=one, by="number", class_error=error))

    def exact(power: int) -> float:
        cut = np.diff(stats.norm.cdf(z - power * sigma))[0] / np.diff(stats.norm.cdf(z))[0]
        return float(MM**power * math.exp(0.5 * (power * sigma) ** 2) * cut)

    errors = []
    for error in (0.2, 0.1, 0.05, 0.025):
        one = made(error)
        assert one.volume == pytest.approx(math.pi / 6 * exact(3), rel=1e-9)
        errors.append(abs(moment(one, 3) / moment(one, 2) / (exact(3) / exact(2)) - 1.0))
        assert errors[-1] < error**2
    assert all(b < 0.5 * a for a, b in itertools.pairwise(errors))


@pytest.mark.parametrize("e_n", [0.1, 0.4, 0.9, 1.0])
def test_a_particle_at_the_edge_of_its_class(e_n: float) -> None:
    """With k_n and eta_n of its class a pair of edge particles has k_n and e_n within the error asked for, and no less
    in one of the two: `calibrate` says what it should have."""
    error = 0.02
    glass = Material(name="glass", young=5e6, poisson=0.2, density=2500.0)
    of_class = calibrate(pair(glass, MM), v_0=0.5, e_n=e_n)
    seen = []
    for sign in (-1, 1):
        edge = pair(glass, MM * math.exp(sign * half_width(error, e_n)))
        own = calibrate(edge, v_0=0.5, e_n=e_n)
        zeta = float(of_class.eta_n) / (2.0 * math.sqrt(float(of_class.k_n) * float(edge.m_eff)))
        e = math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2))
        seen += [abs(float(of_class.k_n) / float(own.k_n) - 1.0), abs(e / e_n - 1.0)]
    assert max(seen) == pytest.approx(error, rel=1e-3)


def test_classes_are_as_wide_as_their_error_says(tmp_path: Path) -> None:
    """Also where all the mass is at one end of a class, or a range between two sieves is empty."""
    path = tmp_path / "curve.csv"
    path.write_text("mesh,passing\n0.5,0\n0.52,60\n1.9,60\n2,100\n", encoding="ascii")
    made = classes(Sizes(sieve=Sieve(file=str(path), scale=MM)))
    assert ((made.diameters < 0.52 * MM) | (made.diameters > 1.9 * MM)).all()
    assert made.mass_shares[made.diameters < 1 * MM].sum() == pytest.approx(0.6)
    # between two sieves the share grows with ln(d): so the mean of 1/d³ by mass has a closed form
    inverse = sum(
        part * (1 / a**3 - 1 / b**3) / (3 * math.log(b / a))
        for part, a, b in [(0.6, 0.5 * MM, 0.52 * MM), (0.4, 1.9 * MM, 2 * MM)]
    )
    assert made.mass_shares @ (1 / made.diameters**3) == pytest.approx(inverse, rel=1e-10)


def test_a_curve_of_one_sieve_interval_is_read(tmp_path: Path) -> None:
    path = tmp_path / "curve.csv"
    path.write_bytes(b"\xef\xbb\xbfsize, passing\r\n1,0\r\n\r\n1.5, 50\r\n2,100\r\n")
    size, passing = read_sieves(path, MM)
    assert size == pytest.approx([MM, 1.5 * MM, 2 * MM])
    assert passing == pytest.approx([0.0, 0.5, 1.0])


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("mesh,passing\n1,0\n2\n", "line 3"),
        ("mesh,passing\n1,0\n2,nan\n", "line 3"),
        ("mesh,passing\n1;0\n2;100\n", "line 2"),
        ("mesh,passing\n1,0\n2,101\n", "line 3"),
        ("mesh,passing\n1,0\n1,100\n", "line 3"),
        ("mesh,passing\n1,0\n2,50\n3,40\n", "line 4"),
        ("mesh,passing\n-1,0\n2,100\n", "line 2"),
        ("mesh,passing\n1,10\n2,100\n", "0 %"),
        ("mesh,passing\n1,0\n2,90\n", "100 %"),
        ("", "two"),
    ],
)
def test_bad_curves_are_refused(tmp_path: Path, text: str, line: str) -> None:
    path = tmp_path / "curve.csv"
    path.write_text(text, encoding="ascii")
    with pytest.raises(ReadError, match=rf"curve\.csv.*{line}"):
        read_sieves(path)


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"shares": ((MM, 0.5), (2 * MM, 0.4))},
        {"shares": ((MM, 0.5), (MM, 0.5))},
        {"shares": ((MM, 1.0),), "sieve": Sieve(file="a.csv")},
    ],
)
def test_contradicting_tables_are_refused(given: dict[str, object]) -> None:
    with pytest.raises(InputError, match="expected"):
        Sizes(**given)


def test_cut_offs_must_leave_something() -> None:
    with pytest.raises(InputError, match="low"):
        Normal(mean=MM, std=0.1 * MM, low=2 * MM, high=MM)
    with pytest.raises(InputError, match="cut-offs"):
        Lognormal(median=MM, sigma=0.01, low=2 * MM, high=3 * MM)


def test_too_many_classes_are_refused() -> None:
    wide = Lognormal(median=MM, sigma=1.0, low=0.01 * MM, high=100 * MM)
    with pytest.raises(InputError, match=f"{MOST_CLASSES} classes") as told:
        classes(Sizes(lognormal=wide))
    enough = float(str(told.value).rsplit("=", 1)[1])
    assert classes(Sizes(lognormal=wide, class_error=enough)).diameters.size <= MOST_CLASSES


@given(
    st.lists(st.floats(1e-6, 1.0), min_size=1, max_size=20),
    st.integers(0, 10**6),
)
def test_counts_are_the_shares_within_one_particle(shares: list[float], number: int) -> None:
    share = np.array(shares) / sum(shares)
    found = counts(share, number)
    assert found.sum() == number
    assert (np.abs(found - number * share) < 1.0 + 1e-6).all()
