"""From a scene to numbers: contacts, time steps, end times, the user's overrules."""

import math
from dataclasses import replace

import pytest
from models import with_bodies
from shipped import SINGLE

from kncal import CaseFileError, calibrate
from kncal.scene.ballistics import first_touch, initial_overlap
from kncal.scene.case_file import load_case
from kncal.scene.contact import PairChoice
from kncal.scene.needs import decide
from kncal.scene.plan import first_impact_speed, pair_choice, pair_of, plan

FALL = load_case("falling_particle")
OBLIQUE = load_case("oblique_impact")


def test_free_fall_speed():
    ball, floor = FALL.body_pairs()[0]
    time, speed = first_touch(FALL, ball, floor)
    g, h = 9.80665, 0.4
    assert time == pytest.approx(math.sqrt(2 * h / g), rel=1e-12)
    assert speed == pytest.approx(math.sqrt(2 * g * h), rel=1e-12)
    assert first_impact_speed(FALL) == pytest.approx(speed, rel=1e-12)
    assert initial_overlap(ball, floor) == pytest.approx(-h, rel=1e-12)


def test_oblique_speed_is_the_normal_part():
    assert first_impact_speed(OBLIQUE) == pytest.approx(3.9 * math.cos(math.radians(45)), rel=1e-12)


def test_nothing_moves_nothing_touches():
    still = replace(FALL, gravity=(0.0, 0.0, 0.0))
    assert first_impact_speed(still) is None
    with pytest.raises(CaseFileError, match=r"contact\.v_0"):
        plan(still)


def test_a_ball_deep_in_the_wall_is_told_so():
    deep = with_bodies(FALL, spheres=(replace(FALL.spheres[0], position=(0.0, 0.0, 0.003)),))
    with pytest.raises(CaseFileError, match=r"inside 'floor'.*position and diameter"):
        plan(deep)


@pytest.mark.parametrize("case", SINGLE)
def test_plan_of_every_case(case):
    scene = load_case(case)
    models = plan(scene)
    linear, hertz = models["linear"], models["hertz"]
    assert linear.t_end == hertz.t_end
    for model in models.values():
        shortest = min(c.t_c for c in model.contacts.values())
        assert model.dt * scene.run.steps_per_contact == pytest.approx(shortest, rel=1e-12)
        assert model.n_steps * model.dt >= model.t_end * (1 - 1e-9)
        assert (model.n_steps - 1) * model.dt < model.t_end
    for names, contact in linear.contacts.items():
        other = hertz.contacts[names]
        # nothing but the normal law differs
        assert (contact.friction, contact.m_eff, contact.end) == (other.friction, other.m_eff, other.end)
        assert contact.n == 1.0
        assert other.n == 1.5


def test_contact_numbers_are_those_of_the_calibration():
    ball, floor = FALL.body_pairs()[0]
    c = calibrate(pair_of(ball, floor), v_0=first_impact_speed(FALL), e_n=0.9)
    contact = plan(FALL)["linear"].between("ball", "floor")
    assert contact.k == pytest.approx(c.k_n, rel=1e-12)
    assert contact.c == pytest.approx(c.eta_n, rel=1e-12)
    assert contact.t_c == pytest.approx(c.t_c, rel=1e-12)
    # Tsuji: c = C sqrt(m k_h)
    hertz = plan(FALL)["hertz"].between("ball", "floor")
    assert hertz.c == pytest.approx(c.reference.C * math.sqrt(c.pair.m_eff * c.pair.k_h), rel=1e-12)


def test_prescribed_stiffness_is_taken_to_the_last_digit():
    scene = replace(FALL, contact=replace(FALL.contact, k_n=5e4 / 3))
    contact = plan(scene)["linear"].between("ball", "floor")
    assert contact.k == 5e4 / 3
    assert contact.e_n == 0.9


def test_first_exception_that_names_both_bodies_counts():
    exceptions = (PairChoice(between=("floor", "ball"), e_n=0.5), PairChoice(between=("ball", "floor"), e_n=0.6))
    scene = replace(FALL, contact=replace(FALL.contact, pairs=exceptions))
    ball, floor = scene.body_pairs()[0]
    assert pair_choice(scene, ball, floor).e_n == 0.5
    by_material = (PairChoice(between=("rigid", "soft_polymer"), v_0=1.5),)
    scene = replace(FALL, contact=replace(FALL.contact, pairs=by_material))
    assert pair_choice(scene, ball, floor).v_0 == 1.5


def test_overruled_friction_is_gone_from_every_engine():
    assert decide(OBLIQUE).uses("tangential")
    smooth = replace(OBLIQUE, needs={"tangential": False})
    assert all(c.friction == 0.0 for m in plan(smooth).values() for c in m.contacts.values())
    assert all(c.friction == 0.092 for m in plan(OBLIQUE).values() for c in m.contacts.values())


def test_bounces_end_at_an_apex():
    # hard sphere: t_1 (1 + 2 e + 2 e² + e³) after three bounces; a soft contact adds its durations and loses a little
    g, h, e = 9.80665, 0.4, 0.9
    hard = math.sqrt(2 * h / g) * (1 + 2 * e + 2 * e**2 + e**3)
    model = plan(FALL)["linear"]
    assert model.t_end == pytest.approx(hard, rel=0.01)


def test_too_long_a_run_is_refused():
    endless = replace(FALL, run=replace(FALL.run, until_time=1e9, until_bounces=None))
    with pytest.raises(CaseFileError, match="steps"):
        plan(endless)


def test_hertz_run_needs_a_hertz_type_law():
    with pytest.raises(CaseFileError, match="Hertz-type"):
        plan(replace(FALL, contact=replace(FALL.contact, law="walton_braun")))
