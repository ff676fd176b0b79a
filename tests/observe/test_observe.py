"""The estimators on sampled closed forms, and the metrics of runs against mechanics."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from comparisons import run_data
from hypothesis import given
from hypothesis import strategies as st
from models import R, finer, head_on, mass, model, on_wall, with_bodies

from kncal.core.errors import InputError
from kncal.engines.builtin.integrator import integrate
from kncal.observe.contacts import measure_contact, observe, overlaps
from kncal.observe.difference import rows_between
from kncal.observe.run_data import RunData
from kncal.observe.truth import exact_metrics, exact_motion, exact_trajectory, predicted_errors
from kncal.record.frames import Trajectory
from kncal.scene.exact import ExactSolution, gross_sliding, slip_end, solve
from kncal.scene.model import Plan
from kncal.scene.scene import Scene

KINDS = ("linear", "hertz")


def half_sine(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Undamped linear contact from t = 0 to pi: sin t, and straight on outside."""
    delta = np.where(t < 0.0, t, np.where(t > math.pi, math.pi - t, np.sin(t)))
    return delta, np.where(t < 0.0, 1.0, np.where(t > math.pi, -1.0, np.cos(t)))


@given(steps=st.floats(12.0, 300.0), phase=st.floats(0.0, 1.0))
def test_half_sine_is_measured_to_fourth_order(steps: float, phase: float) -> None:
    h = math.pi / steps
    t = h * (np.arange(-3, int(steps) + 6) - phase)
    found = measure_contact(t, *half_sine(t))
    assert bool(found.started)
    assert bool(found.ended)
    assert float(found.t_start) == pytest.approx(0.0, abs=1e-12)
    assert float(found.t_c) == pytest.approx(math.pi, rel=1e-12)
    assert float(found.v_in) == pytest.approx(1.0, rel=1e-12)
    assert float(found.v_out) == pytest.approx(1.0, rel=1e-12)
    # errors of cubic Hermite interpolation: h⁴/384 |f''''| in the value, h⁴/720 in the mean
    assert float(found.delta_max) == pytest.approx(1.0, abs=1.01 * h**4 / 384.0 + 1e-14)
    assert float(found.delta_mean) == pytest.approx(2.0 / math.pi, abs=1.01 * h**4 / 720.0 * 2.0 / math.pi + 1e-14)


def test_batches_are_measured_like_single_series() -> None:
    phases = np.linspace(0.0, 0.9, 6).reshape(2, 3)
    t = 0.1 * (np.arange(-2, 40) - phases[..., None])
    delta, rate = half_sine(t)
    together = measure_contact(t, delta, rate)
    assert together.t_c.shape == (2, 3)
    for i in np.ndindex(2, 3):
        alone = measure_contact(t[i], delta[i], rate[i])
        for field in dataclasses.fields(alone):
            assert getattr(together, field.name)[i] == getattr(alone, field.name), field.name


@given(g=st.floats(-0.5, 3.0), lead=st.floats(0.01, 0.4), tail=st.floats(0.01, 0.4))
def test_free_flight_beside_the_contact_is_ballistic(g: float, lead: float, tail: float) -> None:
    # parabolas outside, with the closing speed 1 at t = 0 and the leaving speed 0.8 at t = pi
    t = np.array([-lead, 0.5, 1.5, 2.5, math.pi + tail])
    delta = np.array([-lead + 0.5 * g * lead**2, 0.4, 0.9, 0.5, -0.8 * tail + 0.5 * g * tail**2])
    rate = np.array([1.0 - g * lead, 0.8, 0.0, -0.7, -0.8 + g * tail])
    if delta[0] >= 0.0 or delta[-1] >= 0.0 or rate[0] <= 0.0 or rate[-1] >= 0.0:
        return
    found = measure_contact(t, delta, rate, pull_in=g, pull_out=g)
    assert float(found.t_start) == pytest.approx(0.0, abs=1e-12)
    assert float(found.t_c) == pytest.approx(math.pi, rel=1e-12)
    assert float(found.v_in) == pytest.approx(1.0, rel=1e-10)
    assert float(found.v_out) == pytest.approx(0.8, rel=1e-10)


def test_contacts_that_are_cut_off_say_so() -> None:
    t = 0.1 * (np.arange(-2, 40) - 0.3)
    delta, rate = half_sine(t)
    early = measure_contact(t[:18], delta[:18], rate[:18])
    assert bool(early.started)
    assert not bool(early.ended)
    assert math.isnan(float(early.v_out))
    assert float(early.t_c) == pytest.approx(t[17], rel=1e-12)
    late = measure_contact(t[10:], delta[10:], rate[10:])
    assert not bool(late.started)
    assert float(late.t_start) == t[10]
    assert float(late.v_in) == rate[10]
    assert float(late.t_start + late.t_c) == pytest.approx(math.pi, rel=1e-12)


@pytest.mark.parametrize("frames", [0, 1, 5])
def test_a_series_without_a_contact_is_refused(frames: int) -> None:
    with pytest.raises(InputError, match="delta: expected"):
        measure_contact(np.arange(float(frames)), -np.ones(frames), np.zeros(frames))


def as_trajectory(given_: Plan, solution: ExactSolution, times: np.ndarray) -> Trajectory:
    """Frames of an exact motion with the force of free flight, which is what counts beside a contact."""
    x, v = solution.at(times)
    particles = given_.scene.spheres
    weight = np.array([mass(p) for p in particles])[:, None] * np.array(given_.scene.gravity)
    return Trajectory(
        names=solution.names,
        step=np.arange(times.size),
        t=times,
        x=x,
        v=v,
        spin=np.zeros_like(x),
        force=np.broadcast_to(weight, x.shape),
        radius=np.array([p.radius for p in particles]),
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("end", ["overlap", "force"])
def test_exact_frames_give_the_exact_contacts(kind: str, end: str) -> None:
    scene = on_wall(gap=1e-3, velocity=(0.0, 0.0, 0.0), gravity=9.81)
    given_ = model(scene, kind, t_end=0.05, e_n=0.8, end=end)
    solution = solve(given_, 0.05)
    seen = observe(given_, as_trajectory(given_, solution, np.linspace(0.0, 0.05, 12001)))
    assert len(seen.contacts) == len(solution.contacts) >= 2
    for ours, exact in zip(seen.contacts, solution.contacts, strict=True):
        assert ours.t_start == pytest.approx(exact.t_start, rel=1e-9)
        for name, rel in (("v_in", 1e-9), ("v_out", 1e-8), ("t_c", 1e-7), ("delta_max", 1e-6), ("delta_mean", 1e-4)):
            assert getattr(ours, name) == pytest.approx(getattr(exact, name), rel=rel), name


def test_exact_frames_of_an_oblique_pair() -> None:
    scene = head_on()
    second = dataclasses.replace(scene.spheres[1], position=(2.05 * R, 0.4 * R, 0.0))
    given_ = model(with_bodies(scene, spheres=(scene.spheres[0], second)), "linear", t_end=8e-4, e_n=0.8)
    solution = solve(given_, 8e-4)
    seen = observe(given_, as_trajectory(given_, solution, np.linspace(0.0, 8e-4, 4001)))
    ours, exact = seen.contacts[0], solution.contacts[0]
    for name, rel in (("t_start", 1e-6), ("v_in", 1e-6), ("v_out", 1e-6), ("t_c", 1e-6), ("delta_max", 1e-7)):
        assert getattr(ours, name) == pytest.approx(getattr(exact, name), rel=rel), name
    # without friction the angular momentum of the relative motion, r w_t, is kept while the normal turns
    assert seen.metrics["tangential_restitution"] == pytest.approx(1.0, abs=1e-4)
    assert seen.metrics["spin_out"] == 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_metrics_of_a_bouncing_bead(kind: str) -> None:
    scene = on_wall(gap=2e-3, velocity=(0.0, 0.0, 0.0), gravity=9.81)
    given_ = model(scene, kind, t_end=0.085, e_n=0.9)
    seen = observe(given_, integrate(given_))
    heights = [v for k, v in seen.metrics.items() if k.startswith("rebound_height")]
    assert len(heights) == len(seen.contacts) >= 2
    # the apex is what the frames reach (a frame lies within flight_every/2 steps of it), and v_out²/(2 g)
    x = integrate(dataclasses.replace(given_, flight_every=1)).x[:, 0, 2]
    times = np.arange(given_.n_steps + 1) * given_.dt
    first, second = seen.contacts[:2]
    between = (times > first.t_start + first.t_c) & (times < second.t_start)
    assert heights[0] == pytest.approx(x[between].max() - R, rel=1e-7)
    assert heights[0] == pytest.approx(seen.metrics["v_out"] ** 2 / (2.0 * 9.81), rel=1e-9)
    assert seen.metrics["e_n_2"] == seen.contacts[1].e_n
    assert seen.metrics["t_c_2"] == seen.contacts[1].t_c
    assert "tangential_restitution" not in seen.metrics
    assert "slip_end_time" not in seen.metrics


def test_start_of_a_contact_is_found_between_steps() -> None:
    # velocity Verlet is exact up to the first frame in contact, so the touch is, whatever the step
    for factor in (1.0, 1.37, 2.9):
        given_ = finer(model(on_wall(gap=1.234e-5, gravity=9.81), "hertz", t_end=4e-4, e_n=0.7), factor)
        event = observe(given_, integrate(given_)).contacts[0]
        v = math.sqrt(1.0 + 2.0 * 9.81 * 1.234e-5)
        assert event.v_in == pytest.approx(v, rel=1e-12)
        assert event.t_start == pytest.approx((v - 1.0) / 9.81, rel=1e-9)
        assert event.t_c / given_.dt % 1.0 != 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_slip_ends_as_the_closed_form_says(kind: str) -> None:
    contact = model(on_wall(), kind, t_end=1.0).between("bead", "floor")
    rest = (contact.m_eff * 9.81 / contact.k) ** (1.0 / contact.n)
    scene = on_wall(gap=-rest, velocity=(0.06, 0.08, 0.0), gravity=9.81)
    given_ = model(scene, kind, t_end=0.012, friction=0.4, record_every=5)
    seen = observe(given_, integrate(given_))
    end = slip_end(0.1, 0.4, 9.81)
    # the lever is R - delta/2, and the tangential spring has to be stretched first
    stretch = math.sqrt(contact.m_eff / (contact.k_t * (rest**0.5 if kind == "hertz" else 1.0)))
    assert seen.metrics["slip_end_speed"] == pytest.approx(end.speed, rel=1e-3)
    assert seen.metrics["slip_end_time"] == pytest.approx(end.time, abs=3.0 * stretch)
    assert seen.metrics["slip_end_time"] == pytest.approx(end.time, rel=0.01)
    short = observe(given_, integrate(dataclasses.replace(given_, n_steps=given_.n_steps // 4)))
    assert "slip_end_time" not in short.metrics


@pytest.mark.parametrize("kind", KINDS)
def test_oblique_metrics_of_gross_sliding(kind: str) -> None:
    # v_t/v_n = 2, far above 7/2 mu (1 + e)
    scene = on_wall(velocity=(1.2, -1.6, -1.0))
    given_ = finer(model(scene, kind, t_end=6e-4, friction=0.05), 10)
    seen = observe(given_, integrate(given_))
    closed = gross_sliding(1.0, 2.0, friction=0.05, e_n=1.0, radius=R)
    assert seen.metrics["tangential_restitution"] == pytest.approx(closed.tangential_restitution, abs=5e-4)
    assert seen.metrics["rebound_angle"] == pytest.approx(closed.rebound_angle, rel=5e-4)
    # the lever is shorter by delta/2
    lever = 1.0 - 0.5 * seen.contacts[0].delta_max / R
    assert closed.spin * lever * 0.99 < seen.metrics["spin_out"] < closed.spin
    assert seen.metrics["v_out"] == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_a_ball_that_only_spins_leaves_sideways(kind: str) -> None:
    # the contact point goes with 2 m/s along (3, 4); forward is there, and the centre goes back
    spin = np.array([0.8, -0.6, 0.0]) * 2.0 / R
    scene = on_wall(velocity=(0.0, 0.0, -1.0), spin=tuple(spin))
    given_ = finer(model(scene, kind, t_end=6e-4, friction=0.05), 10)
    seen = observe(given_, integrate(given_))
    closed = gross_sliding(1.0, 0.0, friction=0.05, e_n=1.0, radius=R, spin=-2.0 / R)
    assert "tangential_restitution" not in seen.metrics
    assert seen.metrics["rebound_angle"] == pytest.approx(closed.rebound_angle, rel=5e-3)
    # the friction takes 5/2 mu (1 + e) v_n from the rim, less what the lever is shorter by, up to delta/2
    missing = 0.25 * 0.5 * seen.contacts[0].delta_max / R
    assert closed.slip < seen.metrics["slip_out"] < closed.slip + missing
    assert closed.spin - missing / R < seen.metrics["spin_out"] < closed.spin
    exact = exact_metrics(given_, exact_motion(given_))
    assert exact is not None
    assert exact["slip_out"] == pytest.approx(closed.slip, rel=1e-6)


def test_contact_that_never_ends() -> None:
    given_ = model(on_wall(), "linear", t_end=1e-4, e_n=0.9)
    seen = observe(given_, integrate(given_))
    assert [c.complete for c in seen.contacts] == [False]
    assert set(seen.metrics) == {"delta_max", "delta_mean"}
    assert seen.contacts[0].e_n is None
    assert seen.contacts[0].v_out is None
    assert seen.to_dict()["contacts"][0]["e_n"] is None


def test_tables_and_series() -> None:
    given_ = model(head_on(), "hertz", t_end=8e-4, e_n=0.9)
    trajectory = integrate(given_)
    seen = observe(given_, trajectory)
    data = json.loads(json.dumps(seen.to_dict(), allow_nan=False))
    assert data["metrics"] == dict(seen.metrics)
    assert data["contacts"][0]["pair"] == ["a", "b"]
    frame = seen.to_frame()
    assert list(frame["body_1"]) == ["a"]
    assert frame.loc[0, "e_n"] == seen.contacts[0].e_n
    series = overlaps(given_.scene, trajectory)["a", "b"]
    assert np.array_equal(series.delta, seen.series["a", "b"].delta)
    assert np.array_equal(series.delta, 2 * R - np.abs(trajectory.x[:, 1, 0] - trajectory.x[:, 0, 0]))
    slope = np.gradient(series.delta, series.t)
    inside = slice(2, -2)
    assert np.abs(slope - series.delta_dot)[inside].max() < 0.05
    empty = observe(given_, integrate(dataclasses.replace(given_, n_steps=2)))
    assert empty.contacts == ()
    assert dict(empty.metrics) == {}
    assert list(empty.to_frame().columns) == list(frame.columns)


def test_the_predicted_error_of_a_contact_has_those_of_all_earlier_ones() -> None:
    """A lossless contact after a lossy one: its own error is small, that of the speed that it starts with is not."""
    scene = on_wall(gap=1e-3)
    lid = dataclasses.replace(scene.planes[0], name="lid", position=4.0 * R, material=None)
    scene = with_bodies(scene, planes=(*scene.planes, lid))
    e_n = {("bead", "floor"): 0.5, ("bead", "lid"): 1.0}
    given_ = model(scene, "linear", t_end=0.01, e_n=e_n, steps_per_contact=20.0)
    seen = observe(given_, exact_trajectory(given_, solve(given_, 0.01)))
    assert [event.pair for event in seen.contacts[:2]] == [("bead", "floor"), ("bead", "lid")]
    errors = predicted_errors(given_, seen)
    assert errors["e_n_2"] < 0.1 * errors["e_n"]
    assert errors["v_out_2"] >= errors["v_out"]


def exact_run(scene: Scene) -> RunData:
    given_ = model(scene, "linear", t_end=0.01, e_n=0.5)
    frames = exact_trajectory(given_, solve(given_, 0.01))
    return dataclasses.replace(
        run_data("linear", {}, frames, scene=scene), model=given_, contacts=observe(given_, frames)
    )


def test_a_row_of_one_of_several_pairs_says_who_met() -> None:
    scene = on_wall(gap=1e-3)
    lid = dataclasses.replace(scene.planes[0], name="lid", position=4.0 * R)
    both = exact_run(with_bodies(scene, planes=(*scene.planes, lid)))
    texts = {row.metric: row.text for row in rows_between(both, both, {})}
    assert texts["e_n"].endswith("(bead–floor)")
    assert texts["e_n_2"].endswith("(bead–lid)")
    alone = exact_run(scene)
    assert "bead" not in "".join(row.text for row in rows_between(alone, alone, {}))
