import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import kncal
from kncal import InputError, Material, pair, wall_pair

GLASS = Material(young=70e9, poisson=0.22, density=2500.0)
STEEL = Material(young=210e9, poisson=0.3, density=7800.0)
RADII = np.array([1e-3, 2e-3, 3e-3])
radii = st.floats(1e-6, 1.0)


def test_equal_pair_closed_form():
    both = pair(GLASS, 1e-3)
    mass = 2500.0 * 4 / 3 * math.pi * 1e-9
    assert both.m_eff == pytest.approx(mass / 2, rel=1e-14)
    assert both.R_eff == pytest.approx(0.5e-3, rel=1e-14)
    assert both.E_eff == pytest.approx(70e9 / (2 * (1 - 0.22**2)), rel=1e-14)
    assert both.k_h == pytest.approx(4 / 3 * both.E_eff * math.sqrt(0.5e-3), rel=1e-14)


def test_mindlin_ratio_of_equal_materials():
    assert pair(GLASS, 1e-3).k_t_ratio == pytest.approx(2 * (1 - 0.22) / (2 - 0.22), rel=1e-14)


@given(radii, radii)
def test_pair_is_symmetric(r_1, r_2):
    one, two = pair(GLASS, r_1, STEEL, r_2), pair(STEEL, r_2, GLASS, r_1)
    for name in ("m_eff", "R_eff", "E_eff", "G_eff", "R_min", "R_sum", "wave_speed", "size_ratio"):
        assert getattr(one, name) == pytest.approx(getattr(two, name), rel=1e-14)


@given(radii)
def test_wall_is_the_limit_of_a_large_sphere(r):
    wall, large = wall_pair(GLASS, r, STEEL), pair(GLASS, r, STEEL, 1e3)
    # 1/R_eff and 1/m_eff differ by R/R_2 and (R/R_2)^3 rho/rho_2
    assert large.R_eff == pytest.approx(wall.R_eff, rel=1.1 * r / 1e3 + 1e-15)
    assert large.m_eff == pytest.approx(wall.m_eff, rel=1e-8)
    assert large.E_eff == pytest.approx(wall.E_eff, rel=1e-14)


def test_rigid_wall_is_the_limit_of_a_stiff_wall():
    stiff = Material(young=1e13, poisson=0.0, density=1e6)
    rigid = wall_pair(GLASS, 1e-3, None)
    assert rigid.E_eff == pytest.approx(70e9 / (1 - 0.22**2), rel=1e-14)
    assert wall_pair(GLASS, 1e-3, stiff).E_eff == pytest.approx(rigid.E_eff, rel=1.1 * 70e9 / 1e13)


def test_same_material_wall_is_half_as_stiff_as_rigid():
    assert wall_pair(GLASS, 1e-3, GLASS).E_eff == pytest.approx(wall_pair(GLASS, 1e-3).E_eff / 2, rel=1e-14)


def test_arrays_broadcast():
    r = np.geomspace(1e-4, 1e-2, 5)
    both = pair(GLASS, r[:, None], GLASS, r[None, :])
    assert np.shape(both.k_h) == (5, 5)
    assert np.allclose(both.k_h, np.transpose(both.k_h), rtol=1e-14)
    assert both.k_h[1, 3] == pytest.approx(pair(GLASS, r[1], GLASS, r[3]).k_h, rel=1e-14)


def test_smaller_yield_strength_counts():
    soft = Material(young=70e9, poisson=0.22, density=2500.0, yield_strength=1e8)
    hard = Material(young=70e9, poisson=0.22, density=2500.0, yield_strength=5e8)
    assert pair(soft, 1e-3, hard, 1e-3).yield_strength == 1e8
    assert pair(GLASS, 1e-3, hard, 1e-3).yield_strength == 5e8
    assert pair(GLASS, 1e-3).yield_strength is None


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("young", 70.0, "70 GPa is 70e9"),
        ("young", 70e3, None),
        ("young", -1.0, "young"),
        ("young", float("nan"), "finite"),
        ("young", float("inf"), "finite"),
        ("young", "70e9", "real number"),
        ("young", True, "real number"),
        ("young", None, "real number"),
        ("poisson", 0.51, "[0, 0.5]"),
        ("poisson", -0.1, "[0, 0.5]"),
        ("density", 2.5, "2500"),
        ("density", 0.0, "density"),
        ("yield_strength", 0.0, "yield_strength"),
        ("yield_strength", 1e-320, "yield_strength"),
        ("young", [], "at least one value"),
        ("young", [[70e9, 1e9], [2e9]], "equal length"),
    ],
)
def test_bad_material(key, value, words):
    arguments = {"young": 70e9, "poisson": 0.2, "density": 2500.0} | {key: value}
    if words is None:
        Material(**arguments)
        return
    with pytest.raises(InputError) as caught:
        Material(**arguments)
    assert key in str(caught.value)
    assert words in str(caught.value)
    assert isinstance(caught.value, kncal.KncalError)


@pytest.mark.parametrize("radius", [0.0, -1e-3, float("nan"), float("inf"), "1", 1e9, [1e-3, 0.0], 1e-110, 1e-320, []])
def test_bad_radius(radius):
    with pytest.raises(InputError, match="radius_1"):
        pair(GLASS, radius)
    with pytest.raises(InputError, match="radius"):
        wall_pair(GLASS, radius)


def test_bad_element_of_an_array_is_named():
    with pytest.raises(InputError, match=r"element \[1\]"):
        pair(GLASS, [1e-3, -1.0, 2e-3])


def test_a_second_radius_has_the_same_range():
    with pytest.raises(InputError, match="radius_2"):
        pair(GLASS, 1.0, GLASS, 1e-320)
    smallest = pair(GLASS, 1e-9, STEEL, 1e3)
    assert min(smallest.m_eff, smallest.R_eff, smallest.k_h) > 0.0


def test_shapes_that_do_not_fit_are_named():
    with pytest.raises(InputError, match=r"young \(2,\).*density \(3,\)"):
        Material(young=[70e9, 80e9], poisson=0.2, density=[2500.0, 2600.0, 2700.0])
    many = Material(young=[70e9, 80e9], poisson=0.2, density=2500.0)
    for refused, words in (
        (lambda: pair(GLASS, RADII, GLASS, RADII[:2]), r"radius_1 \(3,\), radius_2 \(2,\)"),
        (lambda: pair(many, RADII), r"material_1 \(2,\), radius_1 \(3,\)"),
        (lambda: wall_pair(GLASS, RADII, many), r"radius \(3,\), wall_material \(2,\)"),
    ):
        with pytest.raises(InputError, match=words):
            refused()


@pytest.mark.parametrize("wrong", [None, "steel", 1.0])
def test_what_is_no_material_is_refused(wrong):
    with pytest.raises(InputError, match=r"material_1 .*Material"):
        pair(wrong, 1e-3)
    with pytest.raises(InputError, match=r"material .*Material"):
        wall_pair(wrong, 1e-3)
    if wrong is not None:  # None is the same sphere again, or a rigid wall
        with pytest.raises(InputError, match=r"material_2 .*Material"):
            pair(GLASS, 1e-3, wrong, 1e-3)
        with pytest.raises(InputError, match=r"wall_material .*Material"):
            wall_pair(GLASS, 1e-3, wrong)


def test_a_zero_has_no_sign():
    assert math.copysign(1.0, Material(young=70e9, poisson=-0.0, density=2500.0).poisson) == 1.0


def test_equality_of_scalars_and_arrays():
    assert Material(young=70e9, poisson=0.22, density=2500.0) == GLASS
    assert hash(Material(young=70e9, poisson=0.22, density=2500.0)) == hash(GLASS)
    assert GLASS != STEEL
    assert GLASS != 70e9
    one, same, other = (Material(young=[70e9, e], poisson=0.22, density=2500.0) for e in (80e9, 80e9, 90e9))
    assert one == same
    assert one != other
    assert pair(one, 1e-3) != pair(other, 1e-3)
