"""Time steps against eigenvalues, exact contact durations, and the order of the iteration."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kncal import InputError, Material, advise_time_step, calibrate, pair, predict_error, wall_pair
from kncal.physics.timestep import contact_time, hertz_time, rayleigh_time, verlet_limit

GLASS = Material(young=70e9, poisson=0.22, density=2500.0)
PAIR = pair(GLASS, 1e-3)


def test_contact_time_closed_form():
    k, m, e = 1e4, 1e-5, 0.7
    zeta = -math.log(e) / math.hypot(math.pi, math.log(e))
    expected = math.pi / math.sqrt(k / m) / math.sqrt(1 - zeta**2)
    assert contact_time(k, m, e) == pytest.approx(expected, rel=1e-12)
    assert contact_time(k, m, 1.0) == pytest.approx(math.pi * math.sqrt(m / k), rel=1e-12)
    assert contact_time([k, 4 * k], m, e)[1] == pytest.approx(expected / 2, rel=1e-12)


def test_hertz_time_has_the_right_dimension():
    # 2.8683 (m²/(R E² v))^(1/5), and the scaling t_c ~ v^(-1/5) R E^(-2/5)
    m, R, E = PAIR.m_eff, PAIR.R_eff, PAIR.E_eff
    assert hertz_time(PAIR, 0.5) == pytest.approx(2.868266 * (m**2 / (R * E**2 * 0.5)) ** 0.2, rel=1e-6)
    assert hertz_time(PAIR, 16.0) == pytest.approx(hertz_time(PAIR, 0.5) / 2, rel=1e-12)
    assert hertz_time(pair(GLASS, 1e-2), 0.5) == pytest.approx(10 * hertz_time(PAIR, 0.5), rel=1e-12)


def test_rayleigh_time():
    G = 70e9 / (2 * 1.22)
    assert rayleigh_time(GLASS, 1e-3) == pytest.approx(
        math.pi * 1e-3 * math.sqrt(2500 / G) / (0.1631 * 0.22 + 0.8766), rel=1e-14
    )


def amplification(omega_dt, zeta):
    """Largest eigenvalue of one step of velocity Verlet with half-step velocities in the damping force."""
    w, c = omega_dt**2, 2 * zeta * omega_dt  # dt²k/m, dt·eta/m; state (x, v·dt, a·dt²)
    half = np.array([[0.0, 1.0, 0.5], [0, 0, 0], [0, 0, 0]])[0]
    x = np.array([1.0, 0.0, 0.0]) + half
    a = -w * x - c * half
    v = half + 0.5 * a
    return np.abs(np.linalg.eigvals(np.array([x, v, a]))).max()


@given(st.floats(0.0, 5.0))
@settings(deadline=None)
def test_verlet_limit_is_where_an_eigenvalue_leaves_the_unit_circle(zeta):
    k, m = 4e3, 1e-3
    omega = math.sqrt(k / m)
    limit = verlet_limit(k, m, 2 * zeta * math.sqrt(k * m)) * omega
    assert amplification(0.999 * limit, zeta) <= 1.0 + 1e-7
    assert amplification(1.001 * limit, zeta) > 1.0


def test_verlet_limit_of_several_contacts_bounds_a_lattice():
    # fcc without tangential springs: largest omega² is 8 k/m_p = 4 · (2k/m_p); the bound says sqrt(12) > 2
    k, m_p = 1.0, 1.0
    m_eff = m_p / 2
    exact = 2.0 / math.sqrt(8 * k / m_p)
    assert verlet_limit(k, m_eff, contacts=12) <= exact
    assert verlet_limit(k, m_eff, contacts=12) == pytest.approx(verlet_limit(k, m_eff) / math.sqrt(12), rel=1e-13)


@pytest.mark.parametrize("law", ["tsuji", "kuwabara_kono", "hunt_crossley", "hertz", "linear", "walton_braun"])
def test_advice_means_the_same_n_for_both(law):
    c = calibrate(PAIR, v_0=0.5, e_n=0.8, law=law)
    advice = advise_time_step(c, 40)
    assert advice.linear * 40 == pytest.approx(c.t_c, rel=1e-14)
    assert advice.hertz * 40 == pytest.approx(c.reference.t_c, rel=1e-14)
    assert advice.stable
    assert not advise_time_step(c, 1).stable
    assert advice.speed_up == pytest.approx(c.t_c / c.reference.t_c, rel=1e-14)


def test_own_law_from_calibration_to_prediction():
    from kncal.physics.laws import LAWS
    from kncal.physics.laws.polar import HertzDashpot

    own = HertzDashpot(name="mine", damping_exponent=0.5)  # Kuwabara–Kono by another name
    c, known = (calibrate(PAIR, v_0=0.5, e_n=0.8, law=law) for law in (own, "kuwabara_kono"))
    assert c.k_n == pytest.approx(known.k_n, rel=1e-12)
    assert advise_time_step(c).hertz_limit == pytest.approx(advise_time_step(known).hertz_limit, rel=1e-12)
    assert predict_error(own, 0.8).worst == pytest.approx(predict_error(LAWS["kuwabara_kono"], 0.8).worst, rel=1e-9)


def test_duration_method_buys_no_larger_step():
    c = calibrate(PAIR, v_0=0.5, e_n=0.8, method="contact_duration")
    assert advise_time_step(c).speed_up == pytest.approx(1.0, rel=1e-10)


@pytest.mark.parametrize("law", ["linear", "tsuji", "kuwabara_kono", "hunt_crossley"])
@pytest.mark.parametrize("end", ["overlap", "force"])
def test_predicted_error_of_a_damped_contact_is_first_order(law, end):
    coarse, fine = (predict_error(law, 0.7, n, end) for n in (100, 800))
    order = {name: math.log(coarse.worst[name] / fine.worst[name]) / math.log(8) for name in ("delta_max", "e_n")}
    assert 0.8 < order["delta_max"] < 1.7
    assert order["e_n"] > 0.8  # Hunt–Crossley, smooth at touch and separation, does better
    assert abs(coarse.mean["e_n"]) <= coarse.worst["e_n"] < 0.02


@pytest.mark.parametrize("law", ["linear", "hertz"])
def test_predicted_error_of_an_elastic_contact_is_of_higher_order(law):
    coarse, fine = predict_error(law, 1.0, 25), predict_error(law, 1.0, 100)
    assert math.log(coarse.worst["e_n"] / fine.worst["e_n"]) / math.log(4) > 1.8
    if law == "linear":
        # The discrete invariant v² - omega² delta (v dt - delta) bounds the error of e_n by (pi/N)²/8.
        for predicted in (coarse, fine):
            bound = (math.pi / (predicted.steps_per_contact - 0.5)) ** 2 / 8
            assert 0.5 * bound < predicted.worst["e_n"] <= 1.01 * bound


def test_predicted_error_agrees_with_published_error_table():
    # Averages over sub-step phases for the linear contact, velocity Verlet. The published maximum is the largest frame,
    # which misses the peak between frames by (omega dt)²/24 on average; the estimator here interpolates it.
    for e, n, mean_e, worst_e, mean_max in (
        (0.9, 20, None, 9.2e-3, -2.7e-3),
        (0.9, 100, None, 1.8e-3, -5.5e-4),
        (0.5, 50, -2.3e-3, 7.5e-3, -8.7e-3),
    ):
        predicted = predict_error("linear", e, n)
        assert predicted.mean["delta_max"] == pytest.approx(mean_max + (math.pi / n) ** 2 / 24, rel=0.05)
        # the published runs last a whole number of steps; the prediction also looks half a step to either side
        assert worst_e <= predicted.worst["e_n"] * e * 1.02 <= 2.2 * worst_e
        if mean_e is not None:
            assert predicted.mean["e_n"] * e == pytest.approx(mean_e, rel=0.2)


@pytest.mark.parametrize("n", [0.5, 0.0, float("nan"), -5])
def test_bad_steps_per_contact(n):
    with pytest.raises(InputError, match="steps_per_contact"):
        advise_time_step(calibrate(PAIR, v_0=1.0, e_n=0.9), n)
    with pytest.raises(InputError, match="steps_per_contact"):
        predict_error("linear", 0.9, n)


def test_no_prediction_for_a_law_with_history():
    with pytest.raises(InputError, match="walton_braun"):
        predict_error("walton_braun", 0.9, 50)


def test_wall_is_slower_than_pair_by_mass():
    # linear, same k_n: t_c ~ sqrt(m_eff)
    wall = wall_pair(GLASS, 1e-3, GLASS)
    ratio = contact_time(1e4, wall.m_eff, 0.9) / contact_time(1e4, PAIR.m_eff, 0.9)
    assert ratio == pytest.approx(math.sqrt(2), rel=1e-12)


@pytest.mark.parametrize("e_n", [1.0, 0.9, 0.5])
@pytest.mark.parametrize("n", [25, 50])
def test_predicted_worst_is_nearly_the_worst_of_many_random_impacts(e_n, n):
    # velocity Verlet with half-step velocities, written out again: any phase, any N within half a step
    zeta = -math.log(e_n) / math.hypot(math.pi, math.log(e_n))
    rng = np.random.default_rng(n)
    dt = math.pi / math.sqrt(1 - zeta**2) / (n + rng.uniform(-0.5, 0.5, 20000))
    x, v, a = -rng.uniform(0.0, 1.0, dt.size) * dt, np.ones_like(dt), np.zeros_like(dt)
    for _ in range(2 * n):
        half = v + 0.5 * dt * a
        x = x + dt * half
        a = np.where(x > 0, -x - 2 * zeta * half, 0.0)
        v = half + 0.5 * dt * a
    seen = np.abs(-v / e_n - 1).max()
    predicted = predict_error("linear", e_n, n).worst["e_n"]
    assert 0.93 * seen < predicted < 1.01 * seen


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"e_n": [0.5, 0.6]}, "e_n"),
        ({"e_n": np.array([0.5])}, "e_n"),
        ({"e_n": None}, "e_n"),
        ({"e_n": 2.0}, "e_n"),
        ({"steps_per_contact": [10, 20]}, "steps_per_contact"),
        ({"steps_per_contact": {}}, "steps_per_contact"),
        ({"law": []}, "law"),
        ({"end": ["overlap"]}, "end"),
    ],
)
def test_a_prediction_is_of_one_impact(arguments, words):
    with pytest.raises(InputError, match=words):
        predict_error(**({"law": "tsuji", "e_n": 0.9} | arguments))


def test_a_prediction_is_made_once_and_stays_as_it_is():
    one = predict_error("tsuji", 0.9, 50)
    assert predict_error(law="tsuji", e_n=0.9, steps_per_contact=50.0) is one
    for numbers in (one.mean, one.worst):
        with pytest.raises(TypeError):
            numbers["e_n"] = 0.0


def test_the_limit_of_a_linear_reference_is_of_its_own_spring():
    # a linear reference has the strain-energy stiffness of the pair, whatever the calibrated spring is
    own = advise_time_step(calibrate(PAIR, v_0=0.5, e_n=0.6, method="strain_energy")).linear_limit
    soft = calibrate(PAIR, v_0=0.5, e_n=0.6, law="linear", method="contact_time", t_c=1e-4)
    assert advise_time_step(soft).hertz_limit == pytest.approx(own, rel=1e-12)


@pytest.mark.parametrize("e_n", [1.0, 0.5, 0.2])
def test_the_limit_of_two_springs_is_of_the_stiffer_one_and_has_no_damping(e_n):
    k_1 = calibrate(PAIR, v_0=0.5, e_n=1.0, method="strain_energy").k_n
    c = calibrate(PAIR, v_0=0.5, e_n=e_n, law="walton_braun", method="contact_time", t_c=1e-4)
    assert advise_time_step(c, contacts=3).hertz_limit == pytest.approx(
        verlet_limit(k_1 / e_n**2, PAIR.m_eff, 0.0, 3), rel=1e-12
    )


def test_the_limit_of_a_hertz_contact_is_of_its_tangent_at_the_largest_overlap():
    c = calibrate(PAIR, v_0=0.5, e_n=0.7, law="hunt_crossley")
    deepest = c.reference.delta_max
    L = (PAIR.m_eff * 0.5**2 / PAIR.k_h) ** 0.4
    damping = c.reference.C * PAIR.m_eff * 0.5 / L**2.5 * deepest**1.5
    expected = verlet_limit(1.5 * PAIR.k_h * math.sqrt(deepest), PAIR.m_eff, damping, 12)
    assert advise_time_step(c).hertz_limit == pytest.approx(expected, rel=1e-12)


def test_an_advised_step_above_the_limit_is_told():
    c = calibrate(PAIR, v_0=[0.5, 1.0], e_n=0.8)
    assert advise_time_step(c, 40).warnings == ()
    bad = advise_time_step(c, 5)
    assert len(bad.warnings) == 2
    assert "linear" in bad.warnings[0]
    assert "reference" in bad.warnings[1]
    # the number of steps it asks for is enough, and hardly more than enough
    enough = max(float(w.split("more than ")[1].split()[0]) for w in bad.warnings)
    assert advise_time_step(c, 1.001 * enough).stable
    assert not advise_time_step(c, 0.999 * enough).stable
    # a strongly damped contact with cut-off attraction needs more steps than any fixed N has
    assert advise_time_step(calibrate(PAIR, v_0=0.5, e_n=0.01, end="force"), 10).warnings


@pytest.mark.parametrize("bad", [[10, 20], np.array([10.0]), "10", {}])
def test_advice_is_for_one_number_of_steps(bad):
    c = calibrate(PAIR, v_0=0.5, e_n=0.9)
    with pytest.raises(InputError, match="steps_per_contact"):
        advise_time_step(c, bad)
    with pytest.raises(InputError, match="contacts"):
        advise_time_step(c, 50, bad)


def test_what_is_no_pair_material_or_calibration_is_refused():
    for refused, words in (
        (lambda: hertz_time(1.0, 0.5), "pair"),
        (lambda: rayleigh_time(1.0, 1e-3), "material"),
        (lambda: advise_time_step(PAIR), "calibration"),
    ):
        with pytest.raises(InputError, match=words):
            refused()


def test_times_of_shapes_that_do_not_fit_are_refused():
    two, three = [1.0, 2.0], [0.7, 0.8, 0.9]
    for refused in (
        lambda: contact_time(two, 1e-6, three),
        lambda: hertz_time(PAIR, two, three),
        lambda: hertz_time(pair(GLASS, [1e-3, 2e-3]), 0.5, three),
        lambda: verlet_limit(two, three),
        lambda: rayleigh_time(Material(young=[7e10, 8e10], poisson=0.2, density=2500.0), [1e-3, 2e-3, 3e-3]),
    ):
        with pytest.raises(InputError, match=r"\(2,\).*\(3,\)|\(3,\).*\(2,\)"):
            refused()


def test_times_beyond_floats_are_refused():
    for refused in (
        lambda: contact_time(1e-300, 1e300, 0.9),
        lambda: contact_time(1e300, 1e-300, 0.9),
        lambda: verlet_limit(1e-300, 1e300),
        lambda: verlet_limit(1.0, 1e-300, 1e300),
        lambda: hertz_time(PAIR, 1e-300),
        lambda: rayleigh_time(GLASS, 1e300),
    ):
        with pytest.raises(InputError):
            refused()
