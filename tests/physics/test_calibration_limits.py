"""What a calibration warns of, and what it refuses as no contact."""

import math

import pytest

from kncal import Material, ValidityError, calibrate, pair, wall_pair

GLASS = Material(young=70e9, poisson=0.22, density=2500.0)
PAIR = pair(GLASS, 1e-3)


def codes(**arguments):
    contact = arguments.pop("contact", PAIR)
    return {w.code for w in calibrate(contact, **({"v_0": 0.5, "e_n": 0.95} | arguments)).warnings}


def test_a_plain_case_has_no_warnings():
    assert codes() == set()


def test_each_limit_is_told():
    soft = Material(young=1e6, poisson=0.3, density=2500.0)
    assert "overlap-large" in codes(contact=pair(soft, 1e-3), v_0=1.0)
    assert "impact-fast" in codes(v_0=60.0)
    assert "restitution-small" in codes(e_n=0.05)
    assert "restitution-small" not in codes(e_n=0.05, method="max_overlap")
    assert "gravity-overlap" in codes(v_0=1e-5)
    assert "size-ratio" in codes(contact=pair(GLASS, 1e-3, GLASS, 1e-2))
    assert "attraction" in codes(e_n=0.5)
    assert "attraction" not in codes(e_n=0.5, end="force")
    assert "overdamped" in codes(e_n=0.1, end="force")
    assert "overdamped" not in codes(e_n=0.1, method="max_overlap")
    assert "restitution-of-one-speed" in codes(law="kuwabara_kono")
    assert "elastic-reference" in codes(law="hertz")
    weak = Material(young=70e9, poisson=0.22, density=2500.0, yield_strength=1e6)
    assert "yield" in codes(contact=pair(weak, 1e-3))


def test_yield_begins_at_johnsons_velocity():
    # Johnson (1985), section 11.5: m v_Y²/2 = 53 R³ Y⁵/E*⁴ (printed to two digits, with 1.60 Y)
    strength = 3e8
    material = Material(young=210e9, poisson=0.3, density=7800.0, yield_strength=strength)
    contact = wall_pair(material, 5e-3)
    v_yield = math.sqrt(2 * 53 * contact.R_eff**3 * strength**5 / contact.E_eff**4 / contact.m_eff)
    assert "yield" not in codes(contact=contact, v_0=0.97 * v_yield, e_n=1.0)
    assert "yield" in codes(contact=contact, v_0=1.03 * v_yield, e_n=1.0)


def test_attraction_is_the_dashpot_force_at_the_end():
    # at delta = 0 the force is -eta_n e_n v_0; the spring's largest is k_n delta_max
    result = calibrate(PAIR, v_0=0.5, e_n=0.5)
    share = result.eta_n * 0.5 * 0.5 / (result.k_n * result.delta_max)
    (warning,) = [w for w in result.warnings if w.code == "attraction"]
    assert f"{share:.3g}" in warning.message


def test_overlap_of_a_radius_is_refused():
    soft = Material(young=1e3, poisson=0.3, density=2500.0)
    with pytest.raises(ValidityError, match="smaller sphere"):
        calibrate(pair(soft, 1e-3), v_0=5.0, e_n=0.9)
    with pytest.raises(ValidityError, match="linear"):
        calibrate(PAIR, v_0=1.0, e_n=0.9, method="contact_time", t_c=1.0)


def test_warnings_of_arrays_count_and_locate():
    result = calibrate(PAIR, v_0=[0.5, 60.0, 70.0], e_n=0.95)
    (warning,) = [w for w in result.warnings if w.code == "impact-fast"]
    assert warning.count == 2
    assert "first at [1]" in warning.message


def test_a_force_end_is_overdamped_below_exp_minus_two():
    # critical damping at the force end: e_n = exp(-2), Schwager & Pöschel 2007
    limit = math.exp(-2.0)
    assert "overdamped" not in codes(e_n=limit * 1.001, end="force")
    result = calibrate(PAIR, v_0=0.5, e_n=0.01, end="force")
    (warning,) = [w for w in result.warnings if w.code == "overdamped"]
    assert f"{result.zeta:.3g}" in warning.message
    assert result.zeta > 1.0


def test_a_frame_has_each_warning_in_its_rows_only():
    result = calibrate(PAIR, v_0=[[0.5], [60.0]], e_n=[0.95, 0.5])
    assert list(result.to_frame()["warnings"]) == ["", "attraction", "impact-fast", "impact-fast; attraction"]
    assert calibrate(PAIR, v_0=60.0, e_n=0.5).to_frame()["warnings"].item() == "impact-fast; attraction"
    fast = result.warnings[0]
    assert set(fast.to_dict()) == {"code", "message", "count"}
    assert "where" not in repr(fast)
    assert fast == calibrate(PAIR, v_0=[[0.5], [60.0]], e_n=[0.95, 0.6]).warnings[0]
    assert len({*result.warnings}) == len(result.warnings)


def test_an_overlap_just_beyond_the_radius_reads_as_beyond():
    # delta_max = fraction · 2 R
    with pytest.raises(ValidityError) as caught:
        calibrate(PAIR, v_0=0.5, e_n=0.9, method="limited_overlap", fraction=0.5005)
    assert "1.001" in str(caught.value)
    with pytest.raises(ValidityError) as caught:
        calibrate(PAIR, v_0=0.5, e_n=0.9, method="limited_overlap", fraction=0.5 * (1.0 + 1e-9))
    assert "less than 1" not in str(caught.value)
