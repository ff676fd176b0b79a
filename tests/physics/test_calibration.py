"""Calibration against its definition: both contacts are integrated in physical units and compared."""

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import kncal
from kncal import InputError, Material, ValidityError, calibrate, pair, wall_pair
from kncal.physics.methods import METHODS

GLASS = Material(young=70e9, poisson=0.22, density=2500.0)
STEEL = Material(young=210e9, poisson=0.3, density=7800.0)
PAIR = pair(GLASS, 1e-3)
EXPONENT = {"tsuji": 0.25, "kuwabara_kono": 0.5, "hunt_crossley": 1.5, "hertz": 0.0, "linear": 0.0}
OPTIONS = {
    "limited_overlap": {"fraction": 0.005},
    "contact_time": {"t_c": 1e-5},
    "static_load": {"force": 1e-3},
}


def impact_by_ode(k, n, c, p, m, v, end):
    """Duration, maximum and mean overlap and rebound/impact speed of m δ'' + c δ^p δ' + k δ^n = 0 by DOP853.

    Scaled by t = v-free units so that tolerances mean the same for every contact.
    """
    T = (m / (k * v ** (n - 1))) ** (1 / (n + 1))
    L = v * T
    stiff, damp = k * L**n * T / (m * v), c * L**p * T / m

    def rhs(_, y):
        x = max(y[0], 0.0)
        return [y[1], -(stiff * x**n + damp * x**p * y[1]), y[0]]

    def over(_, y):
        if end == "overlap" or p >= n:  # with p >= n the force vanishes only with the overlap
            return y[0]
        x = max(y[0], 0.0)
        return stiff * x ** (n - p) + damp * y[1]

    over.terminal, over.direction = True, -1

    def top(_, y):
        return y[1]

    top.direction = -1
    # A force event exists from the start on (spring 0, dashpot > 0), so only its falling zero counts.
    solution = solve_ivp(
        rhs, (0.0, 1e3), [0.0, 1.0, 0.0], "DOP853", events=(over, top), rtol=1e-12, atol=1e-14, max_step=0.05
    )
    t_c = solution.t_events[0][-1]
    x_max = solution.y_events[1][0][0]
    v_end, integral = solution.y_events[0][-1][1:]
    return t_c * T, x_max * L, integral / t_c * L, -v_end


@pytest.mark.parametrize("end", ["overlap", "force"])
@pytest.mark.parametrize("law", ["tsuji", "kuwabara_kono", "hunt_crossley"])
@pytest.mark.parametrize("method", ["mean_overlap", "max_overlap", "contact_duration"])
def test_both_contacts_agree_in_what_the_method_keeps(method, law, end):
    rng = np.random.default_rng([len(method), len(law), len(end)])
    for _ in range(3):
        e_n, v_0, r = rng.uniform(0.3, 0.98), rng.uniform(0.05, 2.0), rng.uniform(1e-4, 1e-2)
        contact = [pair(GLASS, r, STEEL, 2 * r), wall_pair(GLASS, r, STEEL)][rng.integers(2)]
        result = calibrate(contact, v_0=v_0, e_n=e_n, law=law, method=method, end=end)
        m = contact.m_eff
        L = (m * v_0**2 / contact.k_h) ** 0.4
        p = EXPONENT[law]
        c_n = result.reference.C * m * v_0 / L ** (p + 1)
        linear = impact_by_ode(result.k_n, 1.0, result.eta_n, 0.0, m, v_0, end)
        hertz = impact_by_ode(contact.k_h, 1.5, c_n, p, m, v_0, end)
        for got, expected in (
            ((result.t_c, result.delta_max, result.delta_mean, e_n), linear),
            ((result.reference.t_c, result.reference.delta_max, result.reference.delta_mean, e_n), hertz),
        ):
            assert got == pytest.approx(expected, rel=1e-8)
        kept = {"contact_duration": 0, "max_overlap": 1, "mean_overlap": 2}[method]
        assert linear[kept] == pytest.approx(hertz[kept], rel=1e-8)


def test_elastic_kappa_closed_forms():
    # (M/x_max)², (T_c/tau_c)², (A/x_mean)² with M = 1, T_c = pi, A = 2/pi and the elastic Hertz integrals
    from scipy.special import beta

    x_max = 1.25**0.4
    tau_c = 0.8 * x_max * beta(0.4, 0.5)
    x_mean = x_max * beta(0.8, 0.5) / beta(0.4, 0.5)
    expected = {
        "max_overlap": 1 / x_max**2,
        "contact_duration": (math.pi / tau_c) ** 2,
        "mean_overlap": (2 / math.pi / x_mean) ** 2,
        "strain_energy": 0.8**0.8,
        "max_overlap_secant": 1.25**0.2,
    }
    for method, kappa in expected.items():
        for law in ("hertz", "tsuji", "kuwabara_kono", "hunt_crossley"):
            assert calibrate(PAIR, v_0=1.0, e_n=1.0, law=law, method=method).kappa == pytest.approx(kappa, rel=1e-10)


def test_strain_energy_is_the_formula_of_hooke():
    R, E, m, v = PAIR.R_eff, PAIR.E_eff, PAIR.m_eff, 0.7
    hooke = 16 / 15 * math.sqrt(R) * E * (15 * m * v**2 / (16 * math.sqrt(R) * E)) ** 0.2
    assert calibrate(PAIR, v_0=v, e_n=0.8, method="strain_energy").k_n == pytest.approx(hooke, rel=1e-13)


def test_strain_energy_stores_the_same_energy():
    v = 0.7
    delta = (1.25 * PAIR.m_eff * v**2 / PAIR.k_h) ** 0.4  # 2/5 k_h delta^2.5 = m v²/2
    k_n = calibrate(PAIR, v_0=v, e_n=1.0, method="strain_energy").k_n
    assert 0.5 * k_n * delta**2 == pytest.approx(0.4 * PAIR.k_h * delta**2.5, rel=1e-13)


def test_published_worked_example_of_the_energy_formula():
    # EDEM help, linear spring: m = 7.63e-3 kg, R = 9 mm, E = 2.6e8 Pa, v = 3 m/s -> 2.0e5 N/m (two digits printed)
    density = 7.63e-3 / (4 / 3 * math.pi * 9e-3**3)
    contact = pair(Material(young=2.6e8, poisson=0.25, density=density), 9e-3)
    assert calibrate(contact, v_0=3.0, e_n=1.0, method="strain_energy").k_n == pytest.approx(2.0e5, rel=0.025)


@pytest.mark.parametrize("method", sorted(METHODS))
@pytest.mark.parametrize("law", ["linear", "hertz", "tsuji", "kuwabara_kono", "hunt_crossley", "walton_braun"])
@pytest.mark.parametrize("end", ["overlap", "force"])
def test_every_law_method_end_is_finite_positive_and_vectorises(method, law, end):
    e_n = np.array([[0.2, 0.5, 0.9, 1.0]])
    v_0 = np.array([[0.1], [1.0], [3.0]])
    options = OPTIONS.get(method, {})
    result = calibrate(PAIR, v_0=v_0, e_n=e_n, law=law, method=method, end=end, **options)
    for name in ("k_n", "kappa", "t_c", "delta_max", "delta_mean"):
        values = np.asarray(getattr(result, name))
        assert np.isfinite(values).all(), name
        assert (values > 0).all(), name
    assert np.shape(result.k_n) == np.shape(result.kappa) == (3, 4)
    assert (np.asarray(result.eta_n)[:, :3] > 0).all()
    assert (np.asarray(result.eta_n)[:, 3] == 0).all()
    scalar = calibrate(PAIR, v_0=1.0, e_n=0.5, law=law, method=method, end=end, **options)
    assert isinstance(scalar.k_n, float)
    for name in ("k_n", "eta_n", "kappa", "t_c", "delta_max", "delta_mean"):
        whole = np.broadcast_to(getattr(result, name), (3, 4))
        assert getattr(scalar, name) == pytest.approx(whole[1, 1], rel=1e-12)


@given(
    st.floats(0.05, 1.0),
    st.floats(0.01, 1.0),
    st.sampled_from(["mean_overlap", "max_overlap", "contact_duration", "strain_energy", "max_overlap_secant"]),
    st.sampled_from(["tsuji", "kuwabara_kono", "hunt_crossley"]),
    st.sampled_from(["overlap", "force"]),
)
@settings(max_examples=60, deadline=None)
def test_scaling_laws(e_n, v_0, method, law, end):
    # k_n ~ E^(4/5) R^(...) v^(2/5); eta_n ~ sqrt(k_n m)
    def solve(E=70e9, r=1e-3, v=v_0, rho=2500.0):
        contact = pair(Material(young=E, poisson=0.22, density=rho), r)
        return calibrate(contact, v_0=v, e_n=e_n, law=law, method=method, end=end)

    base = solve()
    assert solve(E=35e9).k_n == pytest.approx(base.k_n * 0.5**0.8, rel=1e-11)
    assert solve(v=2 * v_0).k_n == pytest.approx(base.k_n * 2**0.4, rel=1e-11)
    assert solve(r=2e-3).k_n == pytest.approx(base.k_n * 2, rel=1e-11)  # k_h^0.8 m^0.2 ~ R^0.4 R^0.6
    assert solve(rho=5000.0).k_n == pytest.approx(base.k_n * 2**0.2, rel=1e-11)
    assert solve(r=2e-3).eta_n == pytest.approx(base.eta_n * 4, rel=1e-11)
    assert solve(r=2e-3).t_c == pytest.approx(base.t_c * 2, rel=1e-11)


@given(st.floats(0.02, 1.0), st.sampled_from(["overlap", "force"]))
@settings(max_examples=30, deadline=None)
def test_wall_of_the_same_material_is_two_to_the_three_fifths_stiffer(e_n, end):
    sphere, wall = PAIR, wall_pair(GLASS, 1e-3, GLASS)
    ratio = calibrate(wall, v_0=1.0, e_n=e_n, end=end).k_n / calibrate(sphere, v_0=1.0, e_n=e_n, end=end).k_n
    assert ratio == pytest.approx(2**0.6, rel=1e-12)


def test_limited_overlap_limits_the_overlap():
    unequal = pair(GLASS, 1e-3, STEEL, 3e-3)
    for end in ("overlap", "force"):
        result = calibrate(unequal, v_0=1.0, e_n=0.7, method="limited_overlap", end=end, fraction=0.01)
        assert result.delta_max == pytest.approx(0.01 * 2e-3, rel=1e-12)
        result = calibrate(
            unequal, v_0=1.0, e_n=0.7, method="limited_overlap", end=end, fraction=0.01, of="sum_of_radii"
        )
        assert result.delta_max == pytest.approx(0.01 * 4e-3, rel=1e-12)


def test_contact_time_static_load_and_modulus_keep_what_they_say():
    for end in ("overlap", "force"):
        given_time = calibrate(PAIR, v_0=1.0, e_n=0.7, method="contact_time", t_c=2e-5, end=end)
        assert given_time.t_c == pytest.approx(2e-5, rel=1e-12)
    force = 0.01
    k_n = calibrate(PAIR, v_0=1.0, e_n=0.7, method="static_load", force=force).k_n
    assert force / k_n == pytest.approx((force / PAIR.k_h) ** (2 / 3), rel=1e-12)
    slow, fast = (calibrate(PAIR, v_0=v, e_n=0.7, method="youngs_modulus", factor=0.1) for v in (0.1, 1.0))
    assert slow.k_n == pytest.approx(fast.k_n, rel=1e-12)
    assert slow.k_n == pytest.approx(0.1 * PAIR.E_eff * PAIR.R_eff, rel=1e-12)


def test_schaefer_formulas_at_the_overlap_end():
    e_n, t_c, m = 0.6, 2e-5, PAIR.m_eff
    result = calibrate(PAIR, v_0=1.0, e_n=e_n, method="contact_time", t_c=t_c)
    assert result.k_n == pytest.approx(m * (math.pi**2 + math.log(e_n) ** 2) / t_c**2, rel=1e-12)
    assert result.eta_n == pytest.approx(-2 * m * math.log(e_n) / t_c, rel=1e-12)


def test_linear_reference_is_its_own_equivalent():
    for method in ("mean_overlap", "max_overlap", "contact_duration"):
        result = calibrate(PAIR, v_0=1.0, e_n=0.6, law="linear", method=method)
        assert result.kappa == pytest.approx(0.8**0.8, rel=1e-12)
        assert result.t_c == pytest.approx(result.reference.t_c, rel=1e-12)


def test_own_law_is_accepted_where_a_name_is():
    from kncal.physics.laws import LAWS

    own = LAWS["tsuji"]
    assert calibrate(PAIR, v_0=1.0, e_n=0.8, law=own).k_n == calibrate(PAIR, v_0=1.0, e_n=0.8).k_n


def test_gamma_n_is_per_effective_mass():
    result = calibrate(PAIR, v_0=1.0, e_n=0.8)
    assert result.gamma_n * PAIR.m_eff == pytest.approx(result.eta_n, rel=1e-14)
    assert result.zeta == pytest.approx(-math.log(0.8) / math.hypot(math.pi, math.log(0.8)), rel=1e-12)


def test_dict_and_frame():
    result = calibrate(PAIR, v_0=[0.5, 1.0], e_n=0.5)
    data = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert data["k_n"] == list(result.k_n)
    assert {"code", "message", "count"} <= set(data["warnings"][0])
    frame = result.to_frame()
    assert list(frame["k_n"]) == list(result.k_n)
    assert len(frame) == 2
    assert isinstance(calibrate(PAIR, v_0=1.0, e_n=0.5).to_dict()["k_n"], float)


@pytest.mark.parametrize(
    "bad", [0.0, -1.0, float("nan"), float("inf"), "fast", None, [1.0, -1.0], 1j, True, 5e-324, []]
)
def test_bad_speed(bad):
    with pytest.raises(InputError, match="v_0"):
        calibrate(PAIR, v_0=bad, e_n=0.9)


@pytest.mark.parametrize("bad", [0.0, -0.5, 1.0000001, float("nan"), float("inf"), "0.9", None, [0.5, 1.5], 90, 5e-324])
def test_bad_restitution(bad):
    with pytest.raises(InputError, match="e_n"):
        calibrate(PAIR, v_0=1.0, e_n=bad)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"law": "herz"}, "hertz"),
        ({"method": "mean"}, "mean_overlap"),
        ({"end": "both"}, "overlap"),
        ({"method": "contact_time"}, "t_c"),
        ({"method": "limited_overlap"}, "fraction"),
        ({"method": "limited_overlap", "fraction": -0.1}, "fraction"),
        ({"method": "limited_overlap", "fraction": 0.1, "of": "radius"}, "of"),
        ({"method": "static_load", "force": 0.0}, "force"),
        ({"method": "contact_time", "t_c": float("nan")}, "t_c"),
        ({"method": "mean_overlap", "fraction": 0.1}, "fraction"),
        ({"method": "contact_time", "t_c": 1e-200}, "t_c"),
        ({"method": "contact_time", "t_c": 1e200}, "t_c"),
        ({"method": "limited_overlap", "fraction": 1e-200}, "fraction"),
        ({"method": "static_load", "force": 1e300}, "force"),
        ({"method": "youngs_modulus", "factor": 1e300}, "factor"),
        ({"method": "contact_time", "t_c": []}, "t_c"),
    ],
)
def test_bad_names_and_options(arguments, words):
    with pytest.raises(InputError, match=words):
        calibrate(PAIR, **({"v_0": 1.0, "e_n": 0.9} | arguments))


EXTREMES = [
    wall_pair(Material(young=1e13, poisson=0.5, density=1e6), 1e3),
    pair(Material(young=1e3, poisson=0.0, density=10.0), 1e-9),
]


@pytest.mark.parametrize("method", sorted(METHODS))
@pytest.mark.parametrize("v_0", [1e-12, 1e5])
@pytest.mark.parametrize("contact", EXTREMES)
@pytest.mark.parametrize("side", [0, 1])
def test_the_corners_of_every_range_are_numbers_or_refused(method, v_0, contact, side):
    ends = {"fraction": (1e-9, 1.0), "t_c": (1e-15, 1e6), "force": (1e-30, 1e20), "factor": (1e-9, 1e6)}
    row = METHODS[method]
    options = {k: ends[k][side] for k in (*row.required, *(row.optional or {})) if k in ends}
    for law in ("tsuji", "linear", "walton_braun"):
        for e_n in (1e-12, 1.0):
            try:
                result = calibrate(contact, v_0=v_0, e_n=e_n, law=law, method=method, **options)
            except ValidityError:  # an overlap beyond the radius
                continue
            numbers = [result.k_n, result.kappa, result.t_c, result.delta_max, result.delta_mean]
            assert np.isfinite([*numbers, result.eta_n]).all()
            assert min(numbers) > 0.0


def test_shapes_that_do_not_fit_are_named():
    with pytest.raises(InputError, match=r"v_0 \(2,\), e_n \(3,\)"):
        calibrate(PAIR, v_0=[0.5, 0.6], e_n=[0.9, 0.8, 0.7])
    with pytest.raises(InputError, match=r"pair \(3,\), v_0 \(2,\)"):
        calibrate(pair(GLASS, [1e-3, 2e-3, 3e-3]), v_0=[0.5, 0.6], e_n=0.9)
    with pytest.raises(InputError, match=r"e_n \(3,\), t_c \(2,\)"):
        calibrate(PAIR, v_0=0.5, e_n=[0.9, 0.8, 0.7], method="contact_time", t_c=[1e-5, 2e-5])


@pytest.mark.parametrize("wrong", [1.0, None, GLASS])
def test_what_is_no_pair_is_refused(wrong):
    with pytest.raises(InputError, match=r"pair .*kncal\.pair"):
        calibrate(wrong, v_0=0.5, e_n=0.9)


@pytest.mark.parametrize("law", ["tsuji", "hertz", "linear", "walton_braun"])
def test_every_number_has_the_shape_of_all_inputs(law):
    # each of the inputs alone decides the shape, and so does an array that matters for nothing but a warning
    weak = Material(young=70e9, poisson=0.22, density=2500.0, yield_strength=[1e8, 1e9, 1e10])
    for contact, arguments in (
        (PAIR, {"v_0": [0.5, 1.0, 2.0]}),
        (PAIR, {"e_n": [0.5, 0.7, 0.9]}),
        (PAIR, {"method": "contact_time", "t_c": [1e-5, 2e-5, 3e-5]}),
        (pair(GLASS, [1e-3, 2e-3, 3e-3]), {}),
        (pair(weak, 1e-3), {}),
    ):
        result = calibrate(contact, **({"v_0": 0.5, "e_n": 0.9, "law": law} | arguments))
        for owner in (result, result.reference):
            for f in dataclasses.fields(owner):
                value = getattr(owner, f.name)
                if isinstance(value, (float, np.ndarray)):
                    assert np.shape(value) == (3,), f.name
        assert len(result.to_frame()) == 3
    scalar = calibrate(PAIR, v_0=0.5, e_n=0.9, law=law)
    for owner in (scalar, scalar.reference):
        assert not any(isinstance(getattr(owner, f.name), np.ndarray) for f in dataclasses.fields(owner))


def test_options_may_be_arrays():
    times = np.array([1e-5, 2e-5])
    result = calibrate(PAIR, v_0=0.5, e_n=[[0.9], [0.5], [0.7]], method="contact_time", t_c=times)
    np.testing.assert_allclose(result.t_c, np.broadcast_to(times, (3, 2)), rtol=1e-12)


def test_calibrations_of_arrays_can_be_compared():
    one, other = (calibrate(PAIR, v_0=[0.5, 1.0], e_n=0.9) for _ in range(2))
    assert one == one  # noqa: PLR0124 - what is tested
    assert one != other
    assert one.reference != other.reference


def test_public_names_load_lazily():
    for name in kncal.__all__:
        assert getattr(kncal, name) is not None
    with pytest.raises(AttributeError):
        kncal.nonsense  # noqa: B018
