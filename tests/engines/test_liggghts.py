"""The real LIGGGHTS on rendered decks, against velocity Verlet written out here, and against mechanics."""

from __future__ import annotations

import dataclasses
import math
import subprocess
from pathlib import Path

import numpy as np
import pytest

from kncal.engines.liggghts.batch import Liggghts
from kncal.physics.material import Material, sphere_mass
from kncal.record.frames import Trajectory
from kncal.record.liggghts_dump import read_dump
from kncal.scene.bodies import Particle, Wall
from kncal.scene.contact import ContactChoice, PairChoice
from kncal.scene.model import KINDS, PairContact, Plan
from kncal.scene.plan import plan
from kncal.scene.run_control import RunControl
from kncal.scene.scene import Scene

pytestmark = pytest.mark.solver

GLASS = Material(young=7e10, poisson=0.22, density=2500.0, name="glass")
STEEL = Material(young=2e11, poisson=0.3, density=7800.0, name="steel")
RUBBER = Material(young=1e6, poisson=0.45, density=1100.0, name="rubber")
R = 1e-3


def simulate(model: Plan, folder: Path, style: str = "hooke/stiffness") -> Trajectory:
    engine = Liggghts(style)
    engine.render(model, folder)
    result = engine.run(model, folder, timeout=60.0)
    assert result.status == "completed", result.message
    return engine.read(model, folder)


# --- the oracle: two bodies on a line ---------------------------------------------------------------------------------


def verlet(
    contact: PairContact, mass: list[float], reach: float, x: list[float], v: list[float], model: Plan
) -> tuple[list[float], float]:
    """Velocities at the end and largest overlap of two bodies, x[0] < x[1]; a wall is a body of infinite mass.

    Velocity Verlet with the force at the new positions and the velocities of the half step.
    """

    def force(x: list[float], v: list[float]) -> float:
        delta = reach - (x[1] - x[0])
        if delta <= 0.0:
            return 0.0
        F = contact.k * delta**contact.n + contact.c * delta**contact.p * (v[0] - v[1])
        return max(F, 0.0) if contact.end == "force" else F

    half, largest = 0.5 * model.dt, 0.0
    F = force(x, v)
    for _ in range(model.n_steps):
        v = [v[0] - half * F / mass[0], v[1] + half * F / mass[1]]
        x = [x[0] + model.dt * v[0], x[1] + model.dt * v[1]]
        largest = max(largest, reach - (x[1] - x[0]))
        F = force(x, v)
        v = [v[0] - half * F / mass[0], v[1] + half * F / mass[1]]
    return v, largest


def four_impacts(end: str) -> Scene:
    """Unlike beads meet on x, three more hit walls: an elastic floor, a rigid lid, a rigid wall in the negative."""
    beads = (
        Particle(name="a", material=GLASS, radius=R, position=(0.0, 0.0, 0.1), velocity=(0.7, 0.0, 0.0)),
        Particle(name="b", material=STEEL, radius=3 * R, position=(4.021e-3, 0, 0.1), velocity=(-0.3, 0.0, 0.0)),
        Particle(name="c", material=GLASS, radius=R, position=(0.1, 0.0, 1.013e-3), velocity=(0, 0, -1.0)),
        Particle(name="d", material=GLASS, radius=R, position=(0.2, 0.0, 0.19891), velocity=(0, 0, 0.8)),
        Particle(name="e", material=STEEL, radius=2 * R, position=(0.3, -0.01797, 0.1), velocity=(0, -1.2, 0.0)),
    )
    walls = (
        Wall(name="floor", axis="z", position=0.0, material=STEEL),
        Wall(name="lid", axis="z", position=0.2),
        Wall(name="side", axis="y", position=-0.02),
    )
    exceptions = (PairChoice(between=("c", "floor"), e_n=0.6), PairChoice(between=("d", "lid"), e_n=0.75))
    return Scene.of(
        name="four_impacts",
        spheres=beads,
        planes=walls,
        contact=ContactChoice(e_n=0.9, end=end, v_0=1.0, pairs=exceptions),
        run=RunControl(until_time=1.2e-4, steps_per_contact=100.0),
    )


@pytest.mark.parametrize("end", ["overlap", "force"])
@pytest.mark.parametrize("kind", KINDS)
def test_pair_and_wall_impacts_are_the_models(tmp_path: Path, kind: str, end: str) -> None:
    scene = four_impacts(end)
    model = plan(scene, [kind])[kind]
    frames = simulate(model, tmp_path)
    beads = {p.name: p for p in scene.spheres}
    index = {p.name: i for i, p in enumerate(scene.spheres)}

    def check(names: tuple[str, str], axis: int, wall: float | None) -> float:
        a, b = beads[names[0]], beads.get(names[1])
        side = 1.0 if wall is None or wall > a.position[axis] else -1.0
        contact = model.between(*names)
        masses = [float(sphere_mass(a.material, a.radius)), math.inf]
        x, v, reach = [side * a.position[axis]], [side * a.velocity[axis]], a.radius
        recorded = frames.x[:, index[a.name], axis] * side
        if b is None:
            assert wall is not None
            x, v, other = [*x, side * wall], [*v, 0.0], np.full(len(frames.t), side * wall)
        else:
            masses[1], reach = float(sphere_mass(b.material, b.radius)), a.radius + b.radius
            x, v, other = [*x, b.position[axis]], [*v, b.velocity[axis]], frames.x[:, index[b.name], axis]
        expected, largest = verlet(contact, masses, reach, x, v, model)
        assert side * frames.v[-1, index[a.name], axis] == pytest.approx(expected[0], rel=1e-9)
        if b is not None:
            assert frames.v[-1, index[b.name], axis] == pytest.approx(expected[1], rel=1e-9)
        assert largest > 0.0
        assert np.max(reach - (other - recorded)) == pytest.approx(largest, rel=1e-9)
        return (expected[1] - expected[0]) / (v[0] - v[1])

    rebounds = {
        0.9: [check(("a", "b"), 0, None), check(("e", "side"), 1, -0.02)],
        0.6: [check(("c", "floor"), 2, 0.0)],
        0.75: [check(("d", "lid"), 2, 0.2)],
    }
    for e_n, measured in rebounds.items():
        # First order in dt: the step as a fraction of the contact, times the loss. One gamman for pairs and walls
        # would give 0.86 instead of 0.9 at a wall.
        assert measured == pytest.approx([e_n] * len(measured), abs=0.02)


@pytest.mark.parametrize("size", [1e-6, 1.0])
def test_scale_does_not_matter(tmp_path: Path, size: float) -> None:
    """A bead of radius 1e-6 m or 1 m rebounds alike: the dimensionless iteration is the same."""
    rebound = []
    for radius in (R, size):
        bead = Particle(name="a", material=GLASS, radius=radius, position=(0, 0, 1.01 * radius), velocity=(0, 0, -1.0))
        scene = Scene.of(
            name="sized",
            spheres=(bead,),
            planes=(Wall(name="floor", axis="z", position=0.0, material=GLASS),),
            contact=ContactChoice(e_n=0.8, v_0=1.0),
            run=RunControl(until_time=0.06 * radius, steps_per_contact=50.0),
        )
        folder = tmp_path / f"{radius:g}"
        folder.mkdir()
        rebound.append(simulate(plan(scene, ["hertz"])["hertz"], folder).v[-1, 0, 2])
    assert rebound[0] > 0.7
    assert rebound[1] == pytest.approx(rebound[0], rel=1e-6)


def test_hooke_flavour_is_the_same_spring(tmp_path: Path) -> None:
    scene = dataclasses.replace(
        four_impacts("overlap"), contact=ContactChoice(e_n=0.8, v_0=1.0, method="strain_energy")
    )
    model = plan(scene, ["linear"])["linear"]
    ends = []
    for style in ("hooke/stiffness", "hooke"):
        folder = tmp_path / style.replace("/", "_")
        folder.mkdir()
        ends.append(simulate(model, folder, style).v[-1])
    assert np.linalg.norm(ends[0] - ends[1]) < 1e-9 * np.linalg.norm(ends[0])
    assert ends[0][2, 2] > 0.0


# --- mechanics --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_gross_sliding_takes_mu_times_the_normal_impulse(tmp_path: Path, kind: str) -> None:
    mu, v_t, v_n = 0.1, 4.0, 1.0
    bead = Particle(name="a", material=GLASS, radius=R, position=(0, 0, 1.007 * R), velocity=(v_t, 0.0, -v_n))
    scene = Scene.of(
        name="sliding",
        spheres=(bead,),
        planes=(Wall(name="floor", axis="z", position=0.0, material=GLASS),),
        contact=ContactChoice(e_n=0.9, v_0=v_n, friction=mu, end="force"),
        run=RunControl(until_time=5e-5, steps_per_contact=100.0),
    )
    frames = simulate(plan(scene, [kind])[kind], tmp_path)
    v_x, _, v_z = frames.v[-1, 0]
    # Coulomb: the tangential impulse is mu times the normal one, here in every single step.
    assert v_t - v_x == pytest.approx(mu * (v_z + v_n), rel=1e-9)
    assert v_z == pytest.approx(0.9, abs=0.02)
    # Sphere: the same impulse at the lever R, shortened by the overlap at most.
    spin = 2.5 * mu * (v_z + v_n) / R
    assert frames.spin[-1, 0, 1] == pytest.approx(spin, rel=2.0 * np.max(R - frames.x[:, 0, 2]) / R)


@pytest.mark.parametrize("kind", KINDS)
def test_oblique_collision_conserves_momentum_and_its_solver_sees_the_recorded_overlap(
    tmp_path: Path, kind: str
) -> None:
    a = Particle(name="a", material=GLASS, radius=R, position=(0, 0, 0), velocity=(1.0, 0.2, 0.0))
    b = Particle(
        name="b",
        material=STEEL,
        radius=2 * R,
        position=(2.8e-3, 1.1e-3, 0.1e-3),
        velocity=(-1.0, 0.0, 0.1),
        spin=(0.0, 50.0, 20.0),
    )
    scene = Scene.of(
        name="oblique",
        spheres=(a, b),
        contact=ContactChoice(e_n=0.8, friction=0.3, v_0=1.5),
        run=RunControl(until_time=4e-5),
    )
    model = plan(scene, [kind])[kind]
    engine = Liggghts()
    engine.render(model, tmp_path)
    deck = tmp_path / "in.liggghts"
    own = (
        "compute overlaps all pair/gran/local id delta\n"
        "dump overlaps all local 1 overlaps.dump c_overlaps[1] c_overlaps[2] c_overlaps[3] c_overlaps[4]\n"
        'dump_modify overlaps format "%.0f %.0f %.0f %.17g"\n'
    )
    deck.write_text(deck.read_text().replace("thermo_style", own + "thermo_style", 1))
    assert engine.run(model, tmp_path).status == "completed"
    frames = engine.read(model, tmp_path)
    masses = np.array([sphere_mass(p.material, p.radius) for p in (a, b)])
    momentum = np.einsum("p,fpi->fi", masses, frames.v)
    assert np.ptp(momentum, axis=0) == pytest.approx(0.0, abs=1e-13 * np.max(masses))
    assert abs(frames.v[-1, 0, 0] - 1.0) > 0.1  # they did collide

    delta = 3 * R - np.linalg.norm(frames.x[:, 1] - frames.x[:, 0], axis=1)
    solver = read_dump(tmp_path / "overlaps.dump", kind="local").set_index("step")["c_overlaps[4]"]
    touching = delta > 0.0
    # every step of the contact is a frame, and the overlap there is the solver's own
    assert list(frames.step[touching]) == list(solver.index)
    assert solver.to_numpy() == pytest.approx(delta[touching], abs=1e-12 * R)


def test_nobody_is_lost_however_far_they_fly(tmp_path: Path) -> None:
    """Free flight is exact in velocity Verlet; the box has to follow over 5000 diameters in all directions."""
    particles = tuple(
        Particle(
            name=f"p{i}",
            material=RUBBER,
            radius=R,
            position=(0.01 * i, 0, 0),
            velocity=(10.0 * i - 5.0, 100.0 * (-1) ** i, 30.0),
        )
        for i in range(2)
    )
    scene = Scene.of(
        name="far_apart",
        spheres=particles,
        planes=(Wall(name="floor", axis="z", position=-1.0),),
        contact=ContactChoice(v_0=1.0),
        run=RunControl(until_time=0.1, dt=1e-5),
    )
    model = plan(scene, ["linear"])["linear"]
    frames = simulate(model, tmp_path)
    assert frames.step[-1] == model.n_steps
    expected = np.array([np.add(p.position, np.multiply(p.velocity, frames.t[-1])) for p in particles])
    assert frames.x[-1] == pytest.approx(expected, rel=1e-11)


# --- recording --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("record_every", [1, 3])
def test_frames_are_dense_in_contact_sparse_in_flight_and_reach_the_last_step(
    tmp_path: Path, record_every: int
) -> None:
    bead = Particle(name="a", material=RUBBER, radius=R, position=(0, 0, 2.1 * R))
    scene = Scene.of(
        name="drop",
        spheres=(bead,),
        planes=(Wall(name="floor", axis="z", position=0.0),),
        gravity=(0.0, 0.0, -9.81),
        contact=ContactChoice(e_n=0.9),
        run=RunControl(until_time=0.045, steps_per_contact=60.0, record_every=record_every),
    )
    model = plan(scene, ["linear"])["linear"]
    seen: list[tuple[int, int]] = []
    engine = Liggghts()
    engine.render(model, tmp_path)
    result = engine.run(model, tmp_path, progress=lambda done, of: seen.append((done, of)))
    frames = engine.read(model, tmp_path)
    spacing, gap = np.diff(frames.step), frames.x[:, 0, 2] - R
    assert (frames.step[0], frames.step[-1]) == (0, model.n_steps)
    in_contact = gap[:-1] <= 0.0
    assert np.all(spacing[:-1][in_contact[:-1]] == record_every)
    assert spacing.max() > 10 * record_every
    assert len(frames.step) < 0.5 * model.n_steps / record_every
    # no touch is jumped over: a frame before a contact is not further from it than one dense step
    first = np.flatnonzero(in_contact[1:] & ~in_contact[:-1])
    assert len(first) >= 2
    assert np.all(spacing[first] == record_every)

    assert result.steps == model.n_steps
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    assert seen[-1] == (model.n_steps, model.n_steps)
    assert len(seen) >= 100


@pytest.mark.parametrize("kind", KINDS)
def test_no_contact_is_missed_when_a_collision_makes_a_bead_faster_than_all_were(tmp_path: Path, kind: str) -> None:
    """A heavy ball makes a light bead leave with nearly twice its speed; the bead then hits a far wall."""
    ball = Particle(name="ball", material=STEEL, radius=3 * R, position=(0, 0, 0), velocity=(1.0, 0, 0))
    bead = Particle(name="bead", material=GLASS, radius=R, position=(4.1e-3, 0, 0))
    scene = Scene.of(
        name="knock_on",
        spheres=(ball, bead),
        planes=(Wall(name="end", axis="x", position=0.015),),
        contact=ContactChoice(v_0=1.0),
        run=RunControl(until_time=5.5e-3, steps_per_contact=40.0),
    )
    frames = simulate(plan(scene, [kind])[kind], tmp_path)
    gap = 0.015 - R - frames.x[:, 1, 0]
    assert frames.v[:, 1, 0].max() > 1.9
    assert frames.v[-1, 1, 0] < 0.0  # it did come back
    (before,) = np.flatnonzero((gap[:-1] >= 0.0) & (gap[1:] < 0.0))
    assert frames.step[before + 1] - frames.step[before] == 1
    assert np.sum(gap < 0.0) >= 30  # a contact of about 40 steps, stiffer against the rigid wall
    assert len(frames.step) < 1000


def test_short_runs_also_have_a_first_and_a_last_frame(tmp_path: Path) -> None:
    model = dataclasses.replace(plan(four_impacts("overlap"), ["linear"])["linear"], n_steps=7)
    frames = simulate(model, tmp_path)
    assert frames.step[0] == 0
    assert frames.step[-1] == 7


# --- by hand, and failures --------------------------------------------------------------------------------------------


def test_allrun_by_hand_in_a_folder_with_a_space(tmp_path: Path) -> None:
    folder = tmp_path / "by hand $HOME #1"
    folder.mkdir()
    model = plan(four_impacts("overlap"), ["linear"])["linear"]
    Liggghts().render(model, folder)
    done = subprocess.run(
        [str(folder / "Allrun")], cwd="/", env={"PATH": "/usr/bin:/bin"}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    by_hand = Liggghts().read(model, folder)
    again = tmp_path / "again"
    again.mkdir()
    assert np.array_equal(simulate(model, again).v, by_hand.v)


def test_a_broken_deck_is_a_failed_run_with_the_solvers_words(tmp_path: Path) -> None:
    model = plan(four_impacts("overlap"), ["linear"])["linear"]
    engine = Liggghts()
    engine.render(model, tmp_path)
    deck = tmp_path / "in.liggghts"
    deck.write_text(deck.read_text().replace("fix           motion all nve/sphere", "fix motion all nve/cube"))
    result = engine.run(model, tmp_path)
    assert result.status == "failed"
    assert "nve/cube" in result.message or "fix style" in result.message.lower()
    assert result.log == tmp_path / "log.liggghts"


def test_profile_names_program_and_version_and_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    profile = Liggghts().profile()
    assert profile.program is not None
    assert profile.program.name == "liggghts"
    assert profile.version.startswith("3.")
    assert not profile.problem
    assert not list(tmp_path.iterdir())


def test_without_the_program_nothing_is_started_and_the_hint_says_how(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = plan(four_impacts("overlap"), ["linear"])["linear"]
    Liggghts().render(model, tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert Liggghts().profile().program is None
    result = Liggghts().run(model, tmp_path)
    assert result.status == "not_installed"
    assert "apt-get install liggghts" in result.message
    assert not (tmp_path / "log.liggghts").exists()
