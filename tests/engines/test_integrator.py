"""The integrator: conservation, symmetry, order of convergence, and the iteration of the real LIGGGHTS."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from handmade_decks import rebound_and_overlap, run
from models import GLASS, R, finer, head_on, mass, model, on_wall, with_bodies

from kncal.core.errors import RenderError, RunError
from kncal.engines.builtin import Builtin
from kncal.engines.builtin.integrator import integrate
from kncal.observe.contacts import observe
from kncal.record.frames import Trajectory
from kncal.scene.bodies import Particle, Wall
from kncal.scene.exact import solve
from kncal.scene.model import Plan
from kncal.scene.scene import Scene

KINDS = ("linear", "hertz")


def oblique_pair(radius_2: float = R) -> Scene:
    scene = head_on(radius_2=radius_2)
    first, second = scene.spheres
    moved = dataclasses.replace(
        second,
        position=(R + radius_2 - 1e-6, 2e-4, 1e-4),
        velocity=(-0.7, 0.5, 0.2),
        spin=(10.0, 300.0, 20.0),
    )
    return with_bodies(scene, spheres=(first, moved))


def rebound(given: Plan) -> float:
    leaving, _ = rebound_and_overlap(given, *_x_v(integrate(given)))
    return leaving


def _x_v(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    return trajectory.x, trajectory.v


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("scene", [on_wall(), head_on(), head_on(radius_2=3 * R)], ids=["wall", "pair", "unequal"])
def test_elastic_impact_keeps_the_energy(kind: str, scene: Scene) -> None:
    # the largest possible energy error of the linear law at N steps is (pi/N)²/4, see the next test
    for n in (50.3, 400.7):
        assert abs(rebound(model(scene, kind, t_end=1.5e-3, steps_per_contact=n)) - 1.0) <= (math.pi / n) ** 2 / 8


@pytest.mark.parametrize("n", [7.3, 23.8, 50.0])
@pytest.mark.parametrize("gap", [1e-5, 1.37e-5, 1.71e-5])
def test_elastic_linear_impact_keeps_the_discrete_energy(n: float, gap: float) -> None:
    # Velocity Verlet conserves v² + omega² delta² (1 - (omega dt)²/4); with the half kick at the first and at the last
    # frame in contact this is v² - omega² delta (v dt - delta), v the free speed and delta the overlap of that frame.
    given = model(on_wall(gap=gap), "linear", t_end=1e-3, steps_per_contact=n, flight_every=1)
    contact = given.between("bead", "floor")
    run_ = integrate(given)
    delta = R - run_.x[:, 0, 2]
    inside = np.flatnonzero(delta > 0.0)
    ends = [(delta[inside[0]], -run_.v[0, 0, 2]), (delta[inside[-1]], run_.v[-1, 0, 2])]
    start, end = (v**2 - contact.k / contact.m_eff * d * (v * given.dt - d) for d, v in ends)
    assert end == pytest.approx(start, rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_pair_keeps_momentum_and_angular_momentum(kind: str) -> None:
    scene = oblique_pair(radius_2=2 * R)
    trajectory = integrate(model(scene, kind, t_end=6e-4, e_n=0.7, friction=0.4))
    m = np.array([mass(p) for p in scene.spheres])
    inertia = 0.4 * m * trajectory.radius**2
    momentum = np.einsum("i,fik->fk", m, trajectory.v)
    orbital = np.cross(trajectory.x, m[:, None] * trajectory.v).sum(axis=1)
    angular = orbital + np.einsum("i,fik->fk", inertia, trajectory.spin)
    assert np.ptp(trajectory.v[:, 0], axis=0).max() > 0.1
    assert np.ptp(trajectory.spin[:, 0], axis=0).max() > 10.0
    assert np.abs(momentum - momentum[0]).max() < 1e-13 * np.abs(momentum).max()
    assert np.abs(angular - angular[0]).max() < 1e-12 * np.abs(angular).max()


@pytest.mark.parametrize(
    ("kind", "e_n", "order"),
    [("linear", 0.6, 1), ("hertz", 0.6, 1), ("linear", 1.0, 2), ("hertz", 1.0, 2)],
)
def test_order_of_convergence(kind: str, e_n: float, order: int) -> None:
    start = model(on_wall(), kind, t_end=1e-3, e_n=e_n)

    # the sub-step phase of the first touch scatters the error: take the worst of several
    def worst(factor: float) -> float:
        tries = [finer(start, factor * (1.0 + 0.0137 * k)) for k in range(12)]
        return max(abs(rebound(m) - e_n) for m in tries)

    ratio = worst(1.0) / worst(8.0)
    assert 0.5 * 8**order < ratio
    if order == 1:
        assert ratio < 2.5 * 8


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("end", ["overlap", "force"])
@pytest.mark.parametrize("scene", [on_wall(), head_on()], ids=["wall", "pair"])
def test_small_steps_lead_to_the_exact_motion(kind: str, end: str, scene: Scene) -> None:
    given = model(scene, kind, t_end=5e-4, e_n=0.8, end=end)
    exact = solve(given, given.t_end)

    def distance(m: Plan) -> float:
        run_ = integrate(m)
        inside = run_.t <= exact.t_end
        return float(np.abs(run_.x[inside] - exact.at(run_.t[inside])[0]).max())

    size = exact.contacts[0].delta_max
    assert distance(given) < 0.1 * size
    assert distance(finer(given, 16)) < 0.006 * size


@pytest.mark.parametrize("kind", KINDS)
def test_walls_on_every_axis_and_side_are_the_same(kind: str) -> None:
    def at(axis: str, side: float) -> tuple[float, float]:
        index = "xyz".index(axis)
        position, velocity, gravity = [0.0] * 3, [0.0] * 3, [0.0] * 3
        position[index], velocity[index], gravity[index] = side * 1.01 * R, -side * 0.5, -side * 9.81
        scene = Scene.of(
            name="mirror",
            spheres=(
                Particle(name="p", material=GLASS, radius=R, position=tuple(position), velocity=tuple(velocity)),  # type: ignore[arg-type]
            ),
            planes=(Wall(name="w", axis=axis, position=0.0, material=GLASS),),
            gravity=tuple(gravity),  # type: ignore[arg-type]
        )
        m = model(scene, kind, t_end=8e-4, e_n=0.8)
        return rebound_and_overlap(m, *_x_v(integrate(m)))

    assert {at(axis, side) for axis in "xyz" for side in (1.0, -1.0)} == {at("z", 1.0)}


@pytest.mark.parametrize("kind", KINDS)
def test_oblique_wall_contact_turns_with_the_axes(kind: str) -> None:
    def states(shift: int) -> np.ndarray:
        def turned(a: float, b: float, c: float) -> tuple[float, float, float]:
            x, y, z = np.roll([a, b, c], shift).tolist()
            return x, y, z

        scene = Scene.of(
            name="turned",
            spheres=(
                Particle(
                    name="p",
                    material=GLASS,
                    radius=R,
                    position=turned(0.0, 0.0, 1.01 * R),
                    velocity=turned(0.3, 0.1, -1.0),
                    spin=turned(5.0, -70.0, 20.0),
                ),
            ),
            planes=(Wall(name="w", axis="xyz"[(2 + shift) % 3], position=0.0, material=GLASS),),
        )
        run_ = integrate(model(scene, kind, t_end=5e-4, e_n=0.8, friction=0.3))
        return np.roll(np.concatenate([run_.x, run_.v, run_.spin], axis=1), -shift, axis=2)

    assert np.array_equal(states(0), states(1))
    assert np.array_equal(states(0), states(2))


@pytest.mark.parametrize("kind", KINDS)
def test_a_common_velocity_changes_nothing(kind: str) -> None:
    scene = oblique_pair()
    drift = np.array([0.4, -0.2, 0.3])
    moving = with_bodies(
        scene,
        spheres=tuple(
            dataclasses.replace(p, velocity=tuple((np.array(p.velocity) + drift).tolist())) for p in scene.spheres
        ),
    )
    a, b = (integrate(model(s, kind, t_end=5e-4, e_n=0.7, friction=0.4)) for s in (scene, moving))
    assert np.abs(b.v - drift - a.v).max() < 1e-10
    assert np.abs(b.spin - a.spin).max() < 1e-7
    assert np.abs(a.v[-1] - a.v[0]).max() > 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_strides_over_flights_change_nothing(kind: str) -> None:
    scene = on_wall(gap=5e-3, velocity=(0.1, 0.0, 0.0), gravity=9.81)
    leaping = model(scene, kind, t_end=0.11, e_n=0.8, flight_every=60)
    plain = integrate(dataclasses.replace(leaping, flight_every=1))
    strided = integrate(leaping)
    assert len(plain.t) == leaping.n_steps + 1
    assert len(strided.t) < 0.5 * len(plain.t)
    assert len(observe(leaping, strided).contacts) == 2
    same = plain.step.searchsorted(strided.step)
    assert np.abs(strided.x - plain.x[same]).max() < 1e-12 * 5e-3
    before = strided.t < observe(leaping, strided).contacts[0].t_start
    assert np.abs(strided.v - plain.v[same])[before].max() < 1e-12
    # a rounding of the position at the touch becomes omega = 1e4/s times as much of the velocity
    assert np.abs(strided.v - plain.v[same]).max() < 1e-10


def test_frames_are_dense_in_contact_and_never_jump_over_a_touch() -> None:
    given = model(on_wall(gap=1e-3), "linear", t_end=2.5e-3, flight_every=17, record_every=3)
    trajectory = integrate(given)
    gaps = trajectory.x[:, 0, 2] - R
    spacing = np.diff(trajectory.step)
    assert set(spacing[gaps[:-1] <= 0.0]) == {3}
    assert spacing.max() == 17
    # the frame before the touch is free, and no further from it than one dense spacing
    first = int(np.argmax(gaps <= 0.0))
    assert spacing[first - 1] <= 3
    assert trajectory.step[0] == 0
    assert trajectory.step[-1] == given.n_steps


def test_a_bead_knocked_on_by_a_heavy_ball_is_seen_at_the_wall() -> None:
    # Elastic: a heavy ball at v sends a light bead off at nearly 2 v, faster than anything at the start.
    heavy = Particle(name="heavy", material=GLASS, radius=2e-3, position=(-2.3e-3, 0.0, 0.0), velocity=(1.0, 0.0, 0.0))
    light = Particle(name="light", material=GLASS, radius=2e-4, position=(0.0, 0.0, 0.0))
    wall = Wall(name="wall", axis="x", position=1.2e-2, material=None)
    scene = Scene.of(name="knock", spheres=(heavy, light), planes=(wall,))
    given = model(scene, "linear", t_end=1e-2, flight_every=10_000)
    contacts = observe(given, integrate(given)).contacts
    assert [c.pair for c in contacts[:2]] == [("heavy", "light"), ("light", "wall")]
    assert contacts[1].v_in > 1.9
    assert contacts[1].delta_max == pytest.approx(
        contacts[1].v_in * math.sqrt(given.between("light", "wall").m_eff / given.between("light", "wall").k),
        rel=1e-2,
    )


def test_force_end_never_pulls_and_overlap_end_does() -> None:
    forces = {
        end: integrate(model(on_wall(), "linear", t_end=5e-4, e_n=0.4, end=end)).force[:, 0, 2]
        for end in ("overlap", "force")
    }
    assert forces["force"].min() == 0.0
    assert forces["overlap"].min() < -0.05 * forces["overlap"].max()


def test_friction_stays_within_the_coulomb_limit_and_reaches_it() -> None:
    trajectory = integrate(model(on_wall(velocity=(0.5, 0.2, -1.0)), "hertz", t_end=5e-4, friction=0.1))
    normal = trajectory.force[:, 0, 2]
    tangential = np.hypot(trajectory.force[:, 0, 0], trajectory.force[:, 0, 1])
    inside = normal > 0.0
    assert inside.sum() > 40
    assert np.all(tangential[inside] <= 0.1 * normal[inside] * (1.0 + 1e-12))
    assert np.isclose(tangential[inside], 0.1 * normal[inside]).sum() > 30
    assert np.all(tangential[~inside] == 0.0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_stuck_contact_swings_at_its_own_frequency(kind: str) -> None:
    # rolling is 7/2 times as light as sliding: omega_t² = (7/2) k_t/m for the velocity of the contact point
    m = mass(on_wall().spheres[0])
    contact = model(on_wall(), kind, t_end=1.0).between("bead", "floor")
    delta = (m * 9.81 / contact.k) ** (1.0 / contact.n)
    k_t = contact.k_t * (math.sqrt(delta) if kind == "hertz" else 1.0)
    omega = math.sqrt(3.5 * k_t / m)
    scene = on_wall(gap=-delta, velocity=(1e-4, 0.0, 0.0), gravity=9.81)
    given = model(scene, kind, t_end=10.0 / omega, steps_per_contact=200.0, friction=50.0)
    run_ = integrate(given)
    slip = run_.v[:, 0, 0] - R * run_.spin[:, 0, 1]
    assert slip / 1e-4 == pytest.approx(np.cos(omega * run_.t), abs=5e-3)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("damping_t", ["same", "half"])
def test_the_contact_point_leaves_a_sticking_impact_as_predicted(kind: str, damping_t: str) -> None:
    # the prediction is for overlaps small against the radius
    scene = on_wall(gap=1e-7, velocity=(0.01, 0.0, -0.01))
    given = model(scene, kind, t_end=2e-3, steps_per_contact=1000.0, e_n=0.7, friction=1e9, damping_t=damping_t)
    given = dataclasses.replace(
        given,
        contacts={
            pair: dataclasses.replace(c, v_0=0.01, t_c=c.t_c * 0.01**-0.2 if kind == "hertz" else c.t_c)
            for pair, c in given.contacts.items()
        },
    )
    run_ = integrate(given)
    after = run_.v[-1, 0, 0] - R * run_.spin[-1, 0, 1]
    predicted = given.between("bead", "floor").stick_restitution()
    assert predicted is not None
    assert -after / 0.01 == pytest.approx(predicted, abs=5e-3)


def test_what_it_cannot_do_is_refused() -> None:
    given = model(on_wall(), "linear", t_end=1e-4)
    contact = dataclasses.replace(given.between("bead", "floor"), rolling_friction=0.1)
    with pytest.raises(RenderError, match=r"bead, floor: rolling_friction = 0\.1.*liggghts"):
        integrate(dataclasses.replace(given, contacts={(0, 1): contact}))
    with pytest.raises(RenderError, match="dt = 0"):
        integrate(dataclasses.replace(given, dt=0.0))
    soft = dataclasses.replace(contact, rolling_friction=0.0, k=0.01)
    with pytest.raises(RunError, match=r"bead–floor: the overlap reached the radius"):
        integrate(dataclasses.replace(given, contacts={(0, 1): soft}, n_steps=10**6))


def test_frames_beyond_all_memory_end_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sphere that rests is in contact for ever: a frame for every step."""
    pressed = on_wall(gap=-1e-6, velocity=(0.0, 0.0, 0.0), gravity=9.81)
    resting = dataclasses.replace(model(pressed, "linear", t_end=1e-3, e_n=0.5), n_steps=5000)
    monkeypatch.setattr("kncal.engines.builtin.integrator.MOST_FRAMES", 100)
    result = Builtin().run(resting, tmp_path)
    assert (result.status, "record_every" in result.message) == ("failed", True)


def test_engine_runs_and_reads_back(tmp_path: Path) -> None:
    given, engine = model(on_wall(), "hertz", t_end=5e-4, e_n=0.9), Builtin()
    engine.render(given, tmp_path)
    assert "kncal run" in (tmp_path / "Allrun").read_text()
    steps: list[tuple[int, int]] = []
    result = engine.run(given, tmp_path, progress=lambda done, total: steps.append((done, total)))
    assert (result.status, result.message, result.steps) == ("completed", "", given.n_steps)
    assert steps[-1] == (given.n_steps, given.n_steps)
    back, direct = engine.read(given, tmp_path), integrate(given)
    for name in ("step", "t", "x", "v", "spin", "force", "radius"):
        assert np.array_equal(getattr(back, name), getattr(direct, name)), name


def test_engine_says_how_a_run_ended(tmp_path: Path) -> None:
    given, engine = model(on_wall(), "linear", t_end=5e-4), Builtin()
    slow = engine.run(dataclasses.replace(given, n_steps=10**9), tmp_path, timeout=0.05)
    assert slow.status == "timed_out"
    assert "0.05 s" in slow.message
    contact = dataclasses.replace(given.between("bead", "floor"), k=0.01)
    soft = dataclasses.replace(given, contacts={(0, 1): contact}, n_steps=10**6)
    failed = engine.run(soft, tmp_path)
    assert failed.status == "failed"
    assert "overlap reached the radius" in failed.message

    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    assert engine.run(given, tmp_path, progress=stop).status == "interrupted"
    assert not (tmp_path / "particles.dump").exists()


@pytest.mark.solver
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("scene", [on_wall(), head_on(), head_on(radius_2=3 * R)], ids=["wall", "pair", "unequal"])
@pytest.mark.parametrize(("e_n", "end"), [(0.9, "overlap"), (0.3, "force")])
def test_normal_impact_is_that_of_liggghts(kind: str, scene: Scene, e_n: float, end: str, tmp_path: Path) -> None:
    given = model(scene, kind, t_end=1.5e-3, e_n=e_n, end=end, flight_every=1)
    ours = integrate(given)
    steps, rows = run(given, tmp_path)
    assert np.array_equal(steps, ours.step)
    mine = rebound_and_overlap(given, ours.x, ours.v)
    theirs = rebound_and_overlap(given, rows[:, :, 0:3], rows[:, :, 3:6])
    assert 0.9 * e_n < theirs[0] < 1.5 * e_n
    assert mine == pytest.approx(theirs, rel=1e-12, abs=0.0)
    assert np.abs(ours.force - rows[:, :, 9:12]).max() < 1e-12 * np.abs(rows[:, :, 9:12]).max()


@pytest.mark.solver
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "scene",
    [
        on_wall(velocity=(0.5, 0.2, -1.0), spin=(3.0, 50.0, 100.0)),
        on_wall(gap=-1e-6, velocity=(0.1, 0.05, -0.05), gravity=9.81),
        oblique_pair(radius_2=3 * R),
    ],
    ids=["oblique", "sliding", "pair"],
)
def test_friction_is_that_of_liggghts(kind: str, scene: Scene, tmp_path: Path) -> None:
    given = model(scene, kind, t_end=1.5e-3, e_n=0.8, friction=0.3, flight_every=1)
    ours = integrate(given)
    _, rows = run(given, tmp_path)
    assert np.ptp(rows[:, :, 6:9], axis=0).max() > 1.0
    for k, name in enumerate(("x", "v", "spin", "force")):
        theirs = rows[:, :, 3 * k : 3 * k + 3]
        assert np.abs(getattr(ours, name) - theirs).max() < 1e-11 * np.abs(theirs).max(), name


@pytest.mark.solver
@pytest.mark.parametrize(("kind", "law"), [("linear", "tsuji"), ("hertz", "tsuji"), ("hertz", "kuwabara_kono")])
@pytest.mark.parametrize(
    ("friction", "spring"), [(0.3, True), (5.0, True), (0.3, False)], ids=["slips", "sticks", "no-spring"]
)
@pytest.mark.parametrize(
    "scene",
    [on_wall(velocity=(0.5, 0.2, -1.0), spin=(3.0, 50.0, 100.0)), oblique_pair(radius_2=3 * R)],
    ids=["wall", "pair"],
)
def test_tangential_damping_is_that_of_liggghts(
    kind: str, law: str, friction: float, spring: bool, scene: Scene, tmp_path: Path
) -> None:
    given = model(scene, kind, t_end=1.5e-3, e_n=0.8, friction=friction, flight_every=1, damping_t="same", law=law)
    contacts = {pair: dataclasses.replace(c, spring=spring) for pair, c in given.contacts.items()}
    given = dataclasses.replace(given, contacts=contacts)
    ours = integrate(given)
    _, rows = run(given, tmp_path)
    undamped = integrate(model(scene, kind, t_end=1.5e-3, e_n=0.8, friction=friction, flight_every=1, law=law))
    assert np.abs(undamped.spin[-1] - ours.spin[-1]).max() > (1.0 if friction > 1.0 else 1e-3)
    for k, name in enumerate(("x", "v", "spin", "force")):
        theirs = rows[:, :, 3 * k : 3 * k + 3]
        assert np.abs(getattr(ours, name) - theirs).max() < 1e-11 * np.abs(theirs).max(), name


@pytest.mark.solver
@pytest.mark.parametrize("kind", KINDS)
def test_bounces_after_long_flights_are_those_of_liggghts(kind: str, tmp_path: Path) -> None:
    given = model(on_wall(gap=5e-3, velocity=(0.0, 0.0, 0.0), gravity=9.81), kind, t_end=0.15, e_n=0.8)
    ours = integrate(given)
    steps, rows = run(given, tmp_path)
    same = steps.searchsorted(ours.step)
    assert len(observe(given, ours).contacts) >= 3
    # strides round less often than steps do
    assert np.abs(ours.v - rows[same, :, 3:6]).max() < 1e-9 * np.abs(rows[:, :, 3:6]).max()
    assert np.abs(ours.x - rows[same, :, 0:3]).max() < 1e-9 * 5e-3
