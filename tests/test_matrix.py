import math

import numpy as np
import pytest

from kncal import InputError, Material, calibrate, calibrate_matrix, pair, wall_pair

GLASS = Material(young=70e9, poisson=0.22, density=2500.0)
STEEL = Material(young=210e9, poisson=0.3, density=7800.0)
MATRIX = calibrate_matrix(
    {"small": (GLASS, 1e-3), "large": (STEEL, 3e-3)}, {"floor": STEEL, "rigid": None}, v_0=0.5, e_n=0.9
)


def test_every_pair_has_its_own_numbers():
    assert MATRIX.names == ("small", "large", "floor", "rigid")
    assert set(MATRIX.calibrations) == {
        ("small", "small"),
        ("small", "large"),
        ("large", "large"),
        ("small", "floor"),
        ("small", "rigid"),
        ("large", "floor"),
        ("large", "rigid"),
    }
    k_n = MATRIX.matrix("k_n")
    assert np.array_equal(k_n, k_n.T)
    assert (k_n > 0).all()
    assert k_n[0, 1] == calibrate(pair(GLASS, 1e-3, STEEL, 3e-3), v_0=0.5, e_n=0.9).k_n
    assert k_n[0, 3] == calibrate(wall_pair(GLASS, 1e-3), v_0=0.5, e_n=0.9).k_n
    assert MATRIX["rigid", "small"] is MATRIX["small", "rigid"]


def test_gamman_gives_the_wanted_restitution_in_every_pair():
    # e = exp(-pi zeta/sqrt(1 - zeta²)) with zeta = gamman sqrt(m_eff/k_n)/2, as hooke/stiffness computes it
    for calibration in MATRIX.calibrations.values():
        zeta = calibration.gamma_n / 2 * math.sqrt(calibration.pair.m_eff / calibration.k_n)
        assert math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2)) == pytest.approx(0.9, rel=1e-10)


def test_one_gamman_for_all_would_be_wrong_at_a_wall():
    # the known 0.8615: same k_n and gamman at a wall of twice the effective mass
    both = calibrate(pair(GLASS, 1e-3), v_0=0.5, e_n=0.9)
    zeta = both.gamma_n / 2 * math.sqrt(2 * both.pair.m_eff / both.k_n)
    assert math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2)) == pytest.approx(0.8615, abs=5e-5)


def test_shortest_contact_time_and_values_per_pair():
    assert MATRIX.t_c == min(c.t_c for c in MATRIX.calibrations.values())
    own = calibrate_matrix({"a": (GLASS, 1e-3)}, {"w": None}, v_0={("w", "a"): 1.0, ("a", "a"): 0.1}, e_n=0.8)
    assert own["a", "w"].v_0 == 1.0
    assert own["a", "a"].v_0 == 0.1


def test_liggghts_block_holds_the_matrix_with_all_digits():
    block = MATRIX.liggghts()
    line = next(x for x in block.splitlines() if " kn " in x and "property/global" in x)
    numbers = np.array([float(x) for x in line.split()[7:]]).reshape(4, 4)
    assert np.array_equal(numbers, MATRIX.matrix("k_n"))


def test_frame_and_warnings_name_their_pair():
    frame = MATRIX.to_frame()
    assert len(frame) == 7
    assert list(frame.columns[:2]) == ["type_1", "type_2"]
    assert any(w.startswith("small–large: size ratio") for w in MATRIX.warnings)


def test_bad_matrix():
    with pytest.raises(InputError, match="at least one"):
        calibrate_matrix({}, v_0=1.0, e_n=0.9)
    with pytest.raises(InputError, match="distinct"):
        calibrate_matrix({"a": (GLASS, 1e-3)}, {"a": None}, v_0=1.0, e_n=0.9)
    with pytest.raises(InputError, match="a–b"):
        calibrate_matrix({"a": (GLASS, 1e-3), "b": (GLASS, 1e-3)}, v_0={("a", "a"): 1.0}, e_n=0.9)
    with pytest.raises(InputError, match="no contact"):
        MATRIX["floor", "rigid"]
