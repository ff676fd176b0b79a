"""Every law of the registry against the equation of motion, solved another way, and against physics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from impact_oracle import FORCES, collide

from kncal.core.errors import InputError
from kncal.physics.impact import dimensionless_impact, impact_path
from kncal.physics.laws import LAWS
from kncal.physics.laws.base import ENDS
from kncal.physics.laws.polar import HertzDashpot

DAMPED = [name for name in LAWS if name != "hertz"]
DASHPOTS = [name for name in FORCES if name != "hertz"]
QUANTITIES = ("C", "x_max", "tau_c", "x_mean", "x_end")


def _agrees(law: str | HertzDashpot, name: str, e_n: float, end: str) -> None:
    impact = dimensionless_impact(law, e_n, end)
    force = FORCES.get(name, _own_force)
    # the force never changes sign in this law, so only the overlap can end its contact
    seen = collide(force, impact.C, "overlap" if name == "hunt_crossley" else end, 2.0 * impact.tau_c)
    assert seen["e_n"] == pytest.approx(e_n, rel=1e-10)
    for quantity in ("x_max", "tau_c", "x_mean", "x_end"):
        assert seen[quantity] == pytest.approx(getattr(impact, quantity), rel=1e-10, abs=1e-14), quantity
    assert seen["work"] == pytest.approx(_lost(impact), rel=1e-10, abs=1e-14)


def _lost(impact) -> float:
    """Energy the dashpot must have taken; at the force end the spring still holds some."""
    n = LAWS[impact.law].stiffness_exponent if impact.law in LAWS else 1.5
    return 0.5 * (1.0 - impact.e_n) * (1.0 + impact.e_n) - impact.x_end ** (n + 1.0) / (n + 1.0)


def _own_force(x: float, v: float, C: float) -> float:
    return math.copysign(abs(x) ** 1.5, x) + C * abs(x) * v


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("name", DASHPOTS)
@settings(max_examples=25)
@given(e_n=st.floats(0.01, 0.999))
def test_time_domain_integration_gives_the_same_impact(name: str, end: str, e_n: float) -> None:
    _agrees(name, name, e_n, end)


@pytest.mark.parametrize("name", DASHPOTS)
@pytest.mark.parametrize("e_n", [1.0, 1.0 - 1e-9, 1.0 - 1e-5])
def test_nearly_elastic_impacts_agree_with_time_domain_integration(name: str, e_n: float) -> None:
    _agrees(name, name, e_n, "overlap")


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("e_n", [0.02, 0.3, 0.97])
def test_a_law_of_the_user_is_solved_as_exactly(e_n: float, end: str) -> None:
    own = HertzDashpot(name="own", damping_exponent=1.0, e_depends_on_speed=True)
    assert LAWS.find(own) is own
    _agrees(own, "own", e_n, end)


# Thirteen digits, derived independently of this code and by two methods.
REFERENCE = [
    ("tsuji", "overlap", 0.5, 0.4817692577646, 0.860990772995, 3.51853154483, 0.5299218364804, 0.0),
    ("tsuji", "force", 0.5, 0.570813678782, 0.828613504335, 2.822842698094, 0.5965649634437, 0.3667511640521),
    ("kuwabara_kono", "overlap", 0.5, 0.6264926149269, 0.8586036504647, 3.538074367402, 0.5279824988312, 0.0),
    (
        "kuwabara_kono",
        "force",
        0.9,
        0.09283810649976,
        1.048848776773,
        3.161475392131,
        0.6732585910559,
        0.08355429584979,
    ),
    ("hunt_crossley", "force", 0.5, 1.432750533271, 0.8479929129779, 3.603560584046, 0.5220420734663, 0.0),
]


@pytest.mark.parametrize("row", REFERENCE, ids=lambda row: f"{row[0]}-{row[1]}")
def test_reference_values(row: tuple) -> None:
    law, end, e_n, *expected = row
    impact = dimensionless_impact(law, e_n, end)
    assert [getattr(impact, q) for q in QUANTITIES] == pytest.approx(expected, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("name", DAMPED)
def test_the_elastic_limit_is_met_exactly_and_continuously(name: str, end: str) -> None:
    at_one = dimensionless_impact(name, 1.0, end)
    assert at_one.C == 0.0 and at_one.x_end == 0.0
    elastic = "hertz" if LAWS[name].stiffness_exponent == 1.5 else None
    limits = (1.0, np.pi, 2.0 / np.pi)
    if elastic:
        hertz = dimensionless_impact("hertz", 1.0, end)
        limits = (hertz.x_max, hertz.tau_c, hertz.x_mean)
    assert (at_one.x_max, at_one.tau_c, at_one.x_mean) == pytest.approx(limits, rel=1e-12)
    near = dimensionless_impact(name, 1.0 - 2.0**-40, end)
    assert (near.x_max, near.tau_c, near.x_mean) == pytest.approx(limits, rel=1e-8)


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize(
    ("name", "slope"),
    [
        # (4/5) x_max(elastic)^(p+1) B(2(p+1)/5, 3/2) for Hertz-type laws; pi/2 for zeta = C/2; 2 e (1-e) for 1-e^2
        ("tsuji", np.pi / np.sqrt(5.0)),
        ("kuwabara_kono", 1.15344885809529),
        ("hunt_crossley", 2.0 / 3.0),
        ("linear", np.pi / 2.0),
        ("walton_braun", 0.5),
    ],
)
@pytest.mark.parametrize("loss", [2.0**-30, 2.0**-50])
def test_first_order_damping_keeps_its_digits_next_to_one(name: str, slope: float, end: str, loss: float) -> None:
    C = dimensionless_impact(name, 1.0 - loss, end).C
    assert slope * C == pytest.approx(loss, rel=max(3.0 * loss, 1e-12))


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("name", DAMPED)
def test_scalar_and_vector_agree_and_shapes_are_kept(name: str, end: str) -> None:
    e_n = np.random.default_rng(5).uniform(0.001, 1.0, (7, 3))
    many = dimensionless_impact(name, e_n, end)
    for quantity in QUANTITIES:
        values = getattr(many, quantity)
        assert values.shape == e_n.shape
        singles = [getattr(dimensionless_impact(name, float(e), end), quantity) for e in e_n.ravel()]
        assert all(type(value) is float for value in singles)
        np.testing.assert_allclose(values.ravel(), singles, rtol=1e-14)


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("name", DAMPED)
def test_order(name: str, end: str) -> None:
    impact = dimensionless_impact(name, np.linspace(0.001, 1.0, 20001), end)
    assert (np.diff(impact.C) < 0.0).all(), "less restitution needs more damping"
    assert (impact.x_mean < impact.x_max).all()
    assert (impact.x_end <= impact.x_max).all() and (impact.x_end >= 0.0).all()
    if name != "walton_braun":
        assert (np.diff(impact.x_max) > 0.0).all(), "a dashpot shortens the way"


@pytest.mark.parametrize("name", DAMPED)
@given(e_n=st.floats(0.01, 1.0))
def test_the_force_end_comes_no_later_and_needs_no_less_damping(name: str, e_n: float) -> None:
    force, overlap = (dimensionless_impact(name, e_n, end) for end in ("force", "overlap"))
    assert force.tau_c <= overlap.tau_c * (1.0 + 1e-12)
    assert force.C >= overlap.C * (1.0 - 1e-12)


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("e_n", [0.05, 0.6, 1.0])
def test_the_path_is_the_motion_of_the_force(name: str, end: str, e_n: float) -> None:
    if name == "hertz":
        e_n = 1.0
    impact = dimensionless_impact(name, e_n, end)
    path = impact_path(name, e_n, end, n=20001)
    assert path.tau.shape == path.x.shape == path.x_dot.shape == path.force.shape == (20001,)
    assert (path.tau[0], path.x[0], path.x_dot[0]) == (0.0, 0.0, 1.0)
    assert path.tau[-1] == impact.tau_c
    assert path.x_dot[-1] == pytest.approx(-e_n, rel=1e-8)
    assert path.x[-1] == pytest.approx(impact.x_end, abs=1e-9)
    assert path.x.max() == pytest.approx(impact.x_max, rel=1e-6)
    # momentum: the impulse of the force is the change of velocity; trapezoid rule, whose error is O(h^2) but
    # for the jump of the slope where a law switches
    assert np.trapezoid(path.force, path.tau) == pytest.approx(1.0 + e_n, rel=2e-4)
    assert np.trapezoid(path.x, path.tau) / impact.tau_c == pytest.approx(impact.x_mean, rel=1e-6)


@given(x=st.floats(-1.0, 1.0), v=st.floats(-1.0, 1.0), C=st.floats(0.0, 5.0))
def test_forces(x: float, v: float, C: float) -> None:
    for name, force in FORCES.items():
        expected = force(x, v, C) if x >= 0.0 else 0.0
        if name == "hertz":
            expected = max(x, 0.0) ** 1.5
        got = LAWS[name].force(np.array([x, x]), np.array([v, v]), C)
        np.testing.assert_allclose(got, [expected, expected], rtol=1e-13, atol=1e-300)


def test_every_law_says_what_it_is() -> None:
    for name, law in LAWS.items():
        assert law.name == name and law.title and law.source and law.note
        assert law.stiffness_exponent in (1.0, 1.5)
    assert [name for name, law in LAWS.items() if law.e_depends_on_speed] == ["kuwabara_kono", "hunt_crossley"]
    assert [name for name, law in LAWS.items() if law.damping_exponent is None] == ["hertz", "walton_braun"]


@pytest.mark.parametrize("p", [None, 0.2, 1.5, float("nan")])
def test_a_damping_exponent_out_of_range_is_refused(p: float | None) -> None:
    with pytest.raises(InputError, match="damping_exponent"):
        HertzDashpot(name="own", damping_exponent=p)


def test_a_spring_that_is_not_hertz_is_refused() -> None:
    with pytest.raises(InputError, match="stiffness_exponent"):
        HertzDashpot(name="own", damping_exponent=0.5, stiffness_exponent=1.0)
