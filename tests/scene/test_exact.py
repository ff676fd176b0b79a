"""The event-driven solution and the closed forms: against each other, and against textbook mechanics."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from models import GLASS, R, head_on, mass, model, on_wall, with_bodies
from scipy.linalg import expm
from scipy.special import beta, lambertw

from kncal.core.errors import InputError, ValidityError
from kncal.scene.bodies import Particle, Wall
from kncal.scene.exact import bounce_time, damped_bounce, gross_sliding, slip_end, solve
from kncal.scene.model import Plan
from kncal.scene.scene import Scene

KINDS = ("linear", "hertz")
RESTITUTIONS = st.floats(0.1, 1.0)


@settings(max_examples=12)
@given(e_n=st.floats(0.3, 1.0), height=st.floats(1e-4, 0.05), g=st.floats(0.5, 20.0))
def test_bounces_under_gravity_are_the_damped_oscillator(e_n: float, height: float, g: float) -> None:
    scene = on_wall(gap=height, velocity=(0.0, 0.0, 0.0), gravity=g)
    given_ = model(scene, "linear", t_end=1.0, e_n=e_n)
    contact = given_.between("bead", "floor")
    v = math.sqrt(2.0 * g * height)
    t = v / g
    expected = []
    for _ in range(2):
        bounce = damped_bounce(m=contact.m_eff, k_n=contact.k, eta_n=contact.c, g=g, v_0=v)
        expected.append((t, bounce))
        v = bounce.v_out
        t += bounce.t_c + 2.0 * v / g
    solution = solve(given_, t)
    for event, (start, bounce) in zip(solution.contacts, expected, strict=False):
        assert event.complete
        assert event.t_start == pytest.approx(start, rel=1e-10)
        assert event.v_in == pytest.approx(bounce.v_out / bounce.e_n, rel=1e-10)
        for name in ("t_c", "v_out", "e_n", "delta_max", "delta_mean"):
            assert getattr(event, name) == pytest.approx(getattr(bounce, name), rel=1e-9), name
    assert len(solution.contacts) >= 2
    assert bounce_time(given_, 2) == pytest.approx(t - v / g, rel=1e-10)


@settings(max_examples=15)
@given(e_n=RESTITUTIONS, speed=st.floats(1e-3, 1.0))
def test_overlap_end_gives_the_restitution_asked_for(e_n: float, speed: float) -> None:
    for kind in KINDS:
        for scene in (on_wall(velocity=(0.0, 0.0, -speed)), head_on(speed, radius_2=3 * R)):
            event = solve(model(scene, kind, t_end=1.0, e_n=e_n), 1e-3 / speed + 0.02).contacts[0]
            assert event.complete
            assert event.e_n == pytest.approx(e_n, rel=1e-9)
            assert event.v_in == pytest.approx(speed, rel=1e-13)


def test_elastic_hertz_impact() -> None:
    # Landau & Lifshitz, Theory of Elasticity, section 9: energy at the turning point, and the beta function
    given_ = model(on_wall(), "hertz", t_end=1e-3)
    contact = given_.between("bead", "floor")
    delta_max = (1.25 * contact.m_eff / contact.k) ** 0.4
    event = solve(given_, 1e-3).contacts[0]
    assert event.delta_max == pytest.approx(delta_max, rel=1e-11)
    assert event.t_c == pytest.approx(0.8 * beta(0.4, 0.5) * delta_max, rel=1e-10)
    assert event.delta_mean == pytest.approx(delta_max * beta(0.8, 0.5) / beta(0.4, 0.5), rel=1e-10)


@settings(max_examples=10)
@given(e_n=RESTITUTIONS)
def test_force_end_of_the_linear_law(e_n: float) -> None:
    # Schwager & Poeschel: e = exp(-2 zeta arccos(zeta)/sqrt(1 - zeta²)), then coasting over the overlap that is left
    given_ = model(head_on(), "linear", t_end=1e-3, e_n=e_n, end="force")
    c = given_.between("a", "b")
    zeta = c.c / (2.0 * math.sqrt(c.k * c.m_eff))
    omega = math.sqrt(c.k / c.m_eff)
    theta = math.acos(zeta) / math.sqrt(1.0 - zeta**2)
    e = math.exp(-2.0 * zeta * theta)
    event = solve(given_, 1e-3).contacts[0]
    assert event.e_n == pytest.approx(e, rel=1e-10)
    assert event.t_c == pytest.approx((2.0 * theta + 2.0 * zeta) / omega, rel=1e-10)
    assert event.delta_max == pytest.approx(math.exp(-zeta * theta) / omega, rel=1e-10)


@pytest.mark.parametrize("C", [0.2, 1.5, 8.0])
def test_hunt_crossley_has_its_closed_form(C: float) -> None:
    # m dv/dt = -k delta^1.5 (1 + c/k v): (1 + e) C = ln((1 + C)/(1 - C e)), C = c v_0/k
    given_ = model(on_wall(), "hertz", t_end=1e-2)
    contact = given_.between("bead", "floor")
    law = dataclasses.replace(contact, law="hunt_crossley", p=1.5, c=C * contact.k)
    event = solve(dataclasses.replace(given_, contacts={(0, 1): law}), 1e-2).contacts[0]
    e = (1.0 + lambertw(-(1.0 + C) * math.exp(-(1.0 + C)), 0).real) / C
    assert event.e_n == pytest.approx(e, rel=1e-9)


def test_stiff_springs_bounce_like_hard_spheres() -> None:
    scene = on_wall(gap=0.02, velocity=(0.0, 0.0, 0.0), gravity=9.81)
    stiff = model(scene, "linear", t_end=1.0, e_n=0.8, k_n=1e9)
    for k in (1, 2, 3):
        x, v = solve(stiff, bounce_time(stiff, k)).at(bounce_time(stiff, k))
        assert abs(v[0, 0, 2]) < 1e-9
        assert x[0, 0, 2] - R == pytest.approx(0.02 * 0.8 ** (2 * k), rel=2e-4)


def stacked(*, e_n: float = 0.9) -> Plan:
    """Two stacked beads pressed between two plates, after the verification case DEM03 of MFIX."""
    r = 0.5e-3
    heavy, light = (dataclasses.replace(GLASS, name=f"glass-{rho:g}", density=rho) for rho in (20000.0, 10000.0))
    scene = Scene.of(
        name="stacked",
        spheres=(
            Particle(name="low", material=heavy, radius=r, position=(0.0, 0.0, 0.45e-3)),
            Particle(name="up", material=light, radius=r, position=(0.0, 0.0, 1.35e-3)),
        ),
        planes=(
            Wall(name="floor", axis="z", position=0.0, material=GLASS),
            Wall(name="lid", axis="z", position=1.8e-3, material=GLASS),
        ),
        gravity=(0.0, 0.0, -9.80665),
    )
    return model(scene, "linear", t_end=1e-3, e_n=e_n)


@pytest.mark.parametrize("e_n", [1.0, 0.9, 0.5])
def test_stacked_particles_follow_the_matrix_exponential(e_n: float) -> None:
    given_ = stacked(e_n=e_n)
    pair_, floor, lid = (given_.between(*k) for k in (("low", "up"), ("low", "floor"), ("up", "lid")))
    m_1, m_2 = (mass(p) for p in given_.scene.spheres)
    r, length, g, k = 0.5e-3, 1.8e-3, 9.80665, pair_.k
    # y = (y_1, y_2, v_1, v_2, 1)
    a = np.zeros((5, 5))
    a[0, 2] = a[1, 3] = 1.0
    a[2] = np.array([-2.0 * k, k, -floor.c - pair_.c, pair_.c, k * r - 2.0 * k * r]) / m_1
    a[3] = np.array([k, -2.0 * k, pair_.c, -lid.c - pair_.c, 2.0 * k * r + k * (length - r)]) / m_2
    a[2, 4] -= g
    a[3, 4] -= g
    solution = solve(given_, 1e-3)
    free = min((c.t_start + c.t_c for c in solution.contacts if c.v_out is not None), default=1e-3)
    assert free > 1.5e-4
    times = np.linspace(0.0, free, 40)
    x, v = solution.at(times)
    start = np.array([0.45e-3, 1.35e-3, 0.0, 0.0, 1.0])
    exact = np.array([expm(a * t) @ start for t in times])
    assert np.abs(x[:, :, 2] - exact[:, :2]).max() < 1e-10 * 1e-4
    assert np.abs(v[:, :, 2] - exact[:, 2:4]).max() < 1e-9 * np.abs(exact[:, 2:4]).max()


@pytest.mark.parametrize("kind", KINDS)
def test_oblique_collision_without_friction_conserves_all(kind: str) -> None:
    scene = head_on(radius_2=2 * R)
    second = dataclasses.replace(scene.spheres[1], position=(3.1e-3, 1e-3, 0.5e-3), velocity=(-1.0, 0.1, 0.2))
    scene = with_bodies(scene, spheres=(scene.spheres[0], second))
    given_ = model(scene, kind, t_end=3e-3)
    solution = solve(given_, 3e-3)
    assert [c.complete for c in solution.contacts] == [True]
    contact, event = given_.between("a", "b"), solution.contacts[0]
    times = np.linspace(0.0, 3e-3, 400)
    x, v = solution.at(times)
    m = np.array([mass(p) for p in scene.spheres])
    delta = np.maximum(3 * R - np.linalg.norm(x[:, 1] - x[:, 0], axis=1), 0.0)
    energy = 0.5 * np.einsum("i,tik->t", m, v**2) + contact.k * delta ** (contact.n + 1.0) / (contact.n + 1.0)
    momentum = np.einsum("i,tik->tk", m, v)
    angular = np.cross(x, m[:, None] * v).sum(axis=1)
    assert delta.max() > 0.9 * event.delta_max
    assert np.ptp(energy) < 1e-10 * energy[0]
    assert np.ptp(momentum, axis=0).max() < 1e-12 * np.abs(momentum).max()
    assert np.ptp(angular, axis=0).max() < 1e-10 * np.abs(angular).max()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("end", ["overlap", "force"])
def test_a_bead_hit_from_both_sides_stays(kind: str, end: str) -> None:
    # two contacts start and end at the same instants
    beads = tuple(
        Particle(name=name, material=GLASS, radius=R, position=(x, 0.0, 0.0), velocity=(v, 0.0, 0.0))
        for name, x, v in (("left", -2.01 * R, 1.0), ("mid", 0.0, 0.0), ("right", 2.01 * R, -1.0))
    )
    given_ = model(Scene.of(name="row", spheres=beads), kind, t_end=2e-3, e_n=0.7, end=end)
    solution = solve(given_, 2e-3)
    x, v = solution.at(np.linspace(0.0, 2e-3, 50))
    assert [c.complete for c in solution.contacts] == [True, True]
    assert np.abs(x[:, 1]).max() < 1e-15
    assert np.abs(x[:, 0] + x[:, 2]).max() < 1e-14
    assert v[-1, 2, 0] == pytest.approx(-v[-1, 0, 0], rel=1e-11)
    assert v[-1, 2, 0] > 0.5


def test_dense_output_meets_its_events_and_its_derivative() -> None:
    solution = solve(model(on_wall(gravity=9.81), "hertz", t_end=1e-3, e_n=0.8), 1e-3)
    event = solution.contacts[0]
    edges = np.array([event.t_start, event.t_start + event.t_c])
    x, v = solution.at(edges)
    assert np.abs(x[:, 0, 2] - R).max() < 1e-16
    assert v[:, 0, 2] == pytest.approx([-event.v_in, event.v_out], rel=1e-10)
    times = np.linspace(*edges, 50)[1:-1]
    h = 1e-4 * event.t_c
    slope = (solution.at(times + h)[0] - solution.at(times - h)[0]) / (2.0 * h)
    assert slope == pytest.approx(solution.at(times)[1], abs=1e-6)


def test_it_says_when_a_particle_stays_in_contact() -> None:
    given_ = model(on_wall(gap=1e-4, velocity=(0.0, 0.0, 0.0), gravity=9.81), "linear", t_end=2.0, e_n=0.5)
    solution = solve(given_, 2.0)
    contact = given_.between("bead", "floor")
    rest = contact.m_eff * 9.81 / contact.k
    assert solution.rest_time is not None
    assert "at rest in contact" in solution.statement
    assert not solution.contacts[-1].complete
    assert solution.contacts[-1].delta_mean == pytest.approx(rest, rel=1e-3)
    assert solution.at(2.0)[0][0, 0, 2] == pytest.approx(R - rest, abs=1e-8 * rest)
    ended = len(solution.contacts) - 1
    assert ended >= 1
    assert bounce_time(given_, ended) < solution.rest_time
    with pytest.raises(
        ValidityError,
        match=rf"only {ended} of the {ended + 1} contacts end \(at rest.*until_bounces of at most {ended}",
    ):
        bounce_time(given_, ended + 1)


def test_bounce_time_without_gravity_and_without_another_touch() -> None:
    given_ = model(on_wall(), "linear", t_end=1e-3)
    event = solve(given_, 1e-3).contacts[0]
    assert bounce_time(given_, 1) == pytest.approx(event.t_start + 1.5 * event.t_c, rel=1e-13)
    with pytest.raises(ValidityError, match=r"only 1 of the 2 contacts end \(nothing touches any more"):
        bounce_time(given_, 2)


def test_an_elastic_particle_that_only_swings_never_bounces() -> None:
    given_ = model(on_wall(gap=-1.5e-7, velocity=(0.0, 0.0, 0.0), gravity=9.81), "linear", t_end=1.0)
    with pytest.raises(ValidityError, match=r"only 0 of the 1 contacts end \(in contact"):
        bounce_time(given_, 1)


def test_refusals() -> None:
    rough = model(on_wall(velocity=(0.1, 0.0, -1.0)), "linear", t_end=1e-3, friction=0.3)
    with pytest.raises(ValidityError, match=r"bead–floor touch .* tangential velocity and friction 0\.3"):
        solve(rough, 1e-3)
    assert solve(model(on_wall(), "linear", t_end=1e-3, friction=0.3), 1e-3).contacts[0].complete
    with pytest.raises(ValidityError, match="reaches the radius"):
        solve(model(on_wall(), "linear", t_end=1.0, k_n=1.0), 1.0)
    solution = solve(model(on_wall(), "linear", t_end=1e-3), 1e-3)
    for bad in (-1e-9, 1.1e-3, math.nan):
        with pytest.raises(InputError, match="times"):
            solution.at(bad)
    with pytest.raises(InputError, match="t_end"):
        solve(model(on_wall(), "linear", t_end=1e-3), -1.0)


@given(u=st.floats(1e-3, 1e2), mu=st.floats(0.01, 2.0), g=st.floats(0.1, 100.0))
def test_slip_ends_when_the_momentum_balance_says(u: float, mu: float, g: float) -> None:
    end = slip_end(u, mu, g)
    # rolling; impulse of the friction; angular momentum about the contact point, (7/5) m u R from m u_0 R
    assert end.omega_r == pytest.approx(end.speed)
    assert u - end.speed == pytest.approx(mu * g * end.time)
    assert 1.4 * end.speed == pytest.approx(u)


@given(v=st.floats(0.1, 10.0), e=st.floats(0.05, 1.0), mu=st.floats(0.01, 0.5), extra=st.floats(1.0, 5.0))
def test_gross_sliding_keeps_the_angular_momentum(v: float, e: float, mu: float, extra: float) -> None:
    least = 3.5 * mu * (1.0 + e) * v
    after = gross_sliding(v, least * extra * (1.0 + 1e-9), friction=mu, e_n=e, radius=R)
    v_t = least * extra * (1.0 + 1e-9)
    assert after.v_t + 0.4 * R * after.spin == pytest.approx(v_t)
    assert v_t - after.v_t == pytest.approx(mu * (v + after.v_n))
    # still slipping forward, and just not for the steepest impact
    assert after.v_t - R * after.spin >= -1e-9 * v_t
    assert after.tangential_restitution == pytest.approx(after.v_t / v_t)
    assert math.tan(after.rebound_angle) == pytest.approx(after.v_t / after.v_n)
    with pytest.raises(ValidityError, match="slip/v_n"):
        gross_sliding(v, 0.99 * least, friction=mu, e_n=e, radius=R)


@given(v=st.floats(0.1, 10.0), e=st.floats(0.05, 1.0), v_t=st.floats(0.0, 5.0), backspin=st.floats(0.0, 1e4))
def test_gross_sliding_of_a_spinning_ball_is_that_of_its_slip(v: float, e: float, v_t: float, backspin: float) -> None:
    slip = v_t + R * backspin
    mu = slip / (7.0 * (1.0 + e) * v)  # half of what would stop the slip
    after = gross_sliding(v, v_t, friction=mu, e_n=e, radius=R, spin=-backspin)
    assert after.slip == pytest.approx(after.v_t - R * after.spin)
    assert after.slip == pytest.approx(0.5 * slip)
    # about the contact point
    assert after.v_t + 0.4 * R * after.spin == pytest.approx(v_t - 0.4 * R * backspin, abs=1e-9 * (1.0 + slip))
    assert (after.tangential_restitution is None) == (v_t == 0.0)


def test_closed_forms_refuse() -> None:
    with pytest.raises(ValidityError, match="stays in contact"):
        damped_bounce(m=1.0, k_n=100.0, eta_n=5.0, g=9.81, v_0=1e-3)
    with pytest.raises(ValidityError, match="critical damping"):
        damped_bounce(m=1.0, k_n=100.0, eta_n=20.0, g=0.0, v_0=1.0)
    with pytest.raises(InputError, match="friction"):
        slip_end(1.0, 0.0, 9.81)
    with pytest.raises(InputError, match="e_n"):
        gross_sliding(1.0, 1.0, friction=0.1, e_n=1.1, radius=R)


def test_a_run_of_so_many_contacts_has_so_many() -> None:
    """Two balls above each other bounce on the floor and on each other: the next contact comes before the apex."""
    fall = dict(material=GLASS, radius=R, velocity=(0.0, 0.0, -1.0))
    low = Particle(name="low", position=(0.0, 0.0, 1.02 * R), **fall)  # type: ignore[arg-type]
    high = Particle(name="high", position=(0.0, 0.0, 3.2 * R), **fall)  # type: ignore[arg-type]
    floor = Wall(name="floor", axis="z", position=0.0, material=GLASS)
    scene = Scene.of((low, high), (floor,), name="pair", gravity=(0.0, 0.0, -9.81))
    given_ = model(scene, "linear", t_end=1.0, e_n=0.9, k_n=1e5)
    for n in (1, 2, 3):
        contacts = solve(given_, bounce_time(given_, n)).contacts
        assert len(contacts) == n
        assert all(event.complete for event in contacts)


def test_a_contact_with_a_third_body_in_it_has_no_restitution() -> None:
    """A ball falls on one that rests on the floor: what the floor gives back is not of the resting ball's approach."""
    still = Particle(name="still", material=GLASS, radius=R, position=(0.0, 0.0, R))
    hit = Particle(name="hit", material=GLASS, radius=R, position=(0.0, 0.0, 3.1 * R), velocity=(0.0, 0.0, -1.0))
    floor = Wall(name="floor", axis="z", position=0.0, material=GLASS)
    scene = Scene.of((still, hit), (floor,), name="hit", gravity=(0.0, 0.0, -9.81))
    contacts = solve(model(scene, "linear", t_end=1.0, e_n=0.9), 1e-3).contacts
    meanwhile = [c for c in contacts if c.pair == ("still", "floor") and c.v_in < 0.1]
    assert meanwhile
    assert all(c.e_n is None for c in meanwhile)
    assert all(c.e_n is None or 0.0 < c.e_n <= 1.0 + 1e-9 for c in contacts)
