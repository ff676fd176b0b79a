"""Extremes on the real solver: each gives a right result, a warning before the run, or a refusal before the run.

What LIGGGHTS accepts in silence (k_n <= 0, infinite numbers, centres in one place, bodies that go through each other, a
step beyond stability) is caught before the run or after it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from models import with_bodies

from kncal.core.errors import CaseFileError, RenderError, ValidityError
from kncal.engines.liggghts.batch import Liggghts
from kncal.engines.registry import get_engine
from kncal.physics.material import Material
from kncal.physics.timestep import predict_error, verlet_limit
from kncal.record.frames import Trajectory
from kncal.runs.solving import plan_checked
from kncal.runs.workflow import load, run_case
from kncal.scene.bodies import Particle, Wall
from kncal.scene.case_file import load_case, parse_case
from kncal.scene.contact import ContactChoice
from kncal.scene.contact_limits import overlap_at
from kncal.scene.finding import Finding
from kncal.scene.limits import check, warnings_of
from kncal.scene.model import Plan
from kncal.scene.plan import plan
from kncal.scene.run_control import RunControl
from kncal.scene.scene import Scene
from kncal.study.stability.outcome import Outcome, judge
from kncal.study.stability.probes import at_step, impact_of_cluster, ingredients, pressed

GLASS = Material(young=7e10, poisson=0.22, density=2500.0, name="glass")
SOFT = Material(young=1e6, poisson=0.3, density=1000.0, name="soft")


def on_wall(
    radius: float = 1e-3, v: float = 0.5, material: Material = GLASS, steps: float = 50.0, **contact: float | str
) -> Scene:
    """A sphere that hits a rigid wall at ``v``, from a third of a step of the usual number away."""
    given = ContactChoice(**({"e_n": 0.9} | contact))  # type: ignore[arg-type]
    start = replace(_bare(radius, v, material, given, 1e-6 * radius), run=RunControl(until_time=1.0, dt=1.0))
    t_c = min(m.between("ball", "floor").t_c for m in plan(start).values())
    scene = _bare(radius, v, material, given, 0.37 * v * t_c / 50.0)
    return replace(scene, run=RunControl(until_bounces=1, steps_per_contact=steps))


def _bare(radius: float, v: float, material: Material, contact: ContactChoice, gap: float) -> Scene:
    ball = Particle(
        name="ball", material=material, radius=radius, position=(0.0, 0.0, radius + gap), velocity=(0.0, 0.0, -v)
    )
    floor = Wall(name="floor", axis="z", position=0.0)
    return Scene.of(name="extreme", spheres=(ball,), planes=(floor,), contact=contact, run=RunControl(until_bounces=1))


def pair(ratio: float, v: float = 0.5) -> Scene:
    """A sphere of 1 mm meets one that is ``ratio`` times larger."""
    r, big = 1e-3, ratio * 1e-3
    small = Particle(name="small", material=GLASS, radius=r, position=(-r - 1e-9, 0.0, 0.0), velocity=(v, 0.0, 0.0))
    large = Particle(name="large", material=GLASS, radius=big, position=(big, 0.0, 0.0))
    return Scene.of(
        name="pair", spheres=(small, large), contact=ContactChoice(e_n=0.7), run=RunControl(until_bounces=1)
    )


def simulate(scene: Scene, folder: Path, kinds: tuple[str, ...] = ("linear", "hertz")) -> dict[str, Outcome]:
    run_case(scene, get_engine("liggghts"), folder, kinds, timeout=60.0)
    runs = {kind: load(folder / kind) for kind in kinds}
    return {kind: judge(data.model, data.trajectory) for kind, data in runs.items()}


def codes(scene: Scene) -> set[str]:
    """Codes of everything that is said about a scene before it runs."""
    found: set[str] = set()
    for model in plan(scene).values():
        found |= {finding.code for finding in check(model)}
        found |= {code for contact in model.contacts.values() for code in contact.warnings}
    assert warnings_of(plan(scene)) or not found - {"attraction"}  # that is left to the tables
    return found


# --- right results ----------------------------------------------------------------------------------------------------

BOTH, LINEAR = ("linear", "hertz"), ("linear",)
RIGHT = {
    "e_n 1": (on_wall(e_n=1.0), BOTH),
    "e_n 0.06": (on_wall(e_n=0.06, steps=200.0), BOTH),
    "e_n 0.05, linear": (on_wall(e_n=0.05, steps=200.0), LINEAR),
    "k_n 1": (on_wall(v=1e-3, k_n=1.0), LINEAR),
    "k_n 1e9": (on_wall(k_n=1e9), LINEAR),
    "radius 1 um": (on_wall(radius=1e-6), BOTH),
    "radius 1 m": (on_wall(radius=1.0), BOTH),
    "v_0 1e-4": (on_wall(v=1e-4), BOTH),
    "v_0 100": (on_wall(v=100.0), BOTH),
    "size ratio 100": (pair(100.0), BOTH),
}


@pytest.mark.solver
@pytest.mark.parametrize("name", RIGHT)
def test_right_within_the_predicted_error(name: str, tmp_path: Path) -> None:
    """`judge` calls an impact stable only if e_n is right to within the error predicted for its step."""
    scene, kinds = RIGHT[name]
    for kind, outcome in simulate(scene, tmp_path / "run", kinds).items():
        assert outcome.stable, (kind, outcome)
        assert abs(outcome.numbers["e_n_error"]) <= 1.25 * outcome.numbers["e_n_predicted"] + 1e-9, kind


@pytest.mark.solver
@pytest.mark.parametrize("share", [0.5, 0.9])
def test_overlap_close_to_the_radius(share: float, tmp_path: Path) -> None:
    """Said before the run; what comes out is still the linear law's: v sqrt(m/k) without damping."""
    v, r = 1.0, 1e-3
    m = 2500.0 * 4.0 / 3.0 * math.pi * r**3
    scene = on_wall(v=v, e_n=1.0, k_n=m * (v / (share * r)) ** 2)
    assert "overlap-large" in codes(scene)
    (outcome,) = simulate(scene, tmp_path / "run", LINEAR).values()
    assert outcome.stable
    data = load(tmp_path / "run" / "linear")
    allowed = 1.25 * predict_error("linear", 1.0, 50.0).worst["delta_max"]  # a sample of phases: a few per cent low
    assert data.observations.metrics["delta_max"] == pytest.approx(share * r, rel=allowed)


@pytest.mark.solver
@pytest.mark.parametrize("kind", BOTH)
def test_twelve_neighbours_at_once(kind: str, tmp_path: Path) -> None:
    """No momentum and no gain of energy at the usual step (beyond the edge: `tests/stability`)."""
    given = ingredients(load_case("bubbling_bed_mini"))
    probe = impact_of_cluster(given, kind, 0.9, 12)
    t_c = min(c.t_c for c in probe.model.contacts.values())
    outcome = judge(*liggghts(at_step(probe.model, t_c / 50.0, 180), tmp_path / "impact"))
    assert outcome.stable, outcome
    assert outcome.numbers["momentum"] < 1e-13
    assert outcome.numbers["energy_change"] < 0.0


def liggghts(model: Plan, folder: Path) -> tuple[Plan, Trajectory]:
    """Run a model as it is, whatever is said about it."""
    folder.mkdir()
    engine = Liggghts()
    engine.render(model, folder)
    result = engine.run(model, folder, timeout=60.0)
    assert result.status == "completed", result.message
    return model, engine.read(model, folder)


# --- said before the run ----------------------------------------------------------------------------------------------


@pytest.mark.solver
def test_a_step_beyond_stability_is_said_and_creates_energy(tmp_path: Path) -> None:
    scene = on_wall()
    contact = plan(scene)["linear"].between("ball", "floor")
    limit = float(verlet_limit(contact.k, contact.m_eff, contact.c))
    fast, slow = (replace(scene, run=replace(scene.run, dt=share * limit)) for share in (1.5, 0.05))
    assert "dt-unstable" in codes(fast)
    assert not {"dt-unstable", "dt-coarse"} & codes(slow)
    assert simulate(fast, tmp_path / "run", LINEAR)["linear"].code == "energy-gain"


def test_several_contacts_at_once_have_a_smaller_limit() -> None:
    probe = pressed(ingredients(load_case("wall_impact")), "linear", 0.6, 12)
    many = min(float(verlet_limit(c.k, c.m_eff, c.c, 12.0)) for c in probe.model.contacts.values())
    said = {f.code for f in check(at_step(probe.model, 1.01 * many, 10))}
    assert "dt-unstable" in said
    assert "dt-unstable" not in {f.code for f in check(at_step(probe.model, 0.9 * many, 10))}


def test_few_steps_with_strong_damping_are_said() -> None:
    """At e_n = 0.3 ten steps per contact make it up to a quarter wrong; at e_n = 1 less than a per cent."""
    assert "dt-coarse" in codes(on_wall(e_n=0.3, steps=10.0))
    assert "dt-coarse" not in codes(on_wall(e_n=1.0, steps=10.0))


def test_a_start_inside_another_body_is_said() -> None:
    scene = on_wall()
    (ball,) = scene.spheres
    inside = with_bodies(scene, spheres=(replace(ball, position=(0.0, 0.0, 0.6e-3)),))
    inside = replace(inside, contact=replace(scene.contact, v_0=0.5), run=RunControl(until_time=1e-5))
    assert "start-overlap" in codes(inside)


@pytest.mark.parametrize(("radii", "level"), [(0.05, None), (0.5, "warn"), (1.5, "refuse")])
def test_a_spring_under_its_spheres_weight(radii: float, level: str | None) -> None:
    """m g/k of so many radii: right, said, or refused since it sinks through."""
    scene = on_wall(v=1e-6)
    m = 2500.0 * 4.0 / 3.0 * math.pi * 1e-9
    contact = replace(scene.contact, k_n=m * 9.81 / (radii * 1e-3))
    heavy = replace(scene, gravity=(0.0, 0.0, -9.81), contact=contact, run=RunControl(until_time=1e-3))
    if level == "refuse":
        with pytest.raises(CaseFileError, match="can't carry"):
            plan(heavy)
    else:
        assert ("static-overlap" in {f.code for f in check(plan(heavy)["linear"])}) == (level == "warn")


# --- refused before the run -------------------------------------------------------------------------------------------


def test_an_overlap_of_a_radius_is_refused() -> None:
    with pytest.raises(ValidityError, match="reaches the radius"):
        plan(on_wall(v=1.0, material=SOFT, k_n=1e-3))


@pytest.mark.parametrize("kind", BOTH)
def test_a_scene_faster_than_its_v_0_is_refused_if_it_goes_through(kind: str) -> None:
    """The contact of 1 mm/s, met at 100 m/s: the overlap as v, or v^(4/5), reaches the radius."""
    slow = on_wall(v=0.001, material=SOFT, v_0=0.001)
    (ball,) = slow.spheres
    contact = plan(slow)[kind].between("ball", "floor")
    assert (overlap_at(contact, 100.0) or 0.0) > 1e-3
    fast = with_bodies(slow, spheres=(replace(ball, velocity=(0.0, 0.0, -100.0)),))
    with pytest.raises(CaseFileError, match="goes through"):
        plan(fast, (kind,))
    # ten times faster than said is no reason to refuse: the overlap is still small
    plan(with_bodies(slow, spheres=(replace(ball, velocity=(0.0, 0.0, -0.01)),)), (kind,))


CASE = """
[materials.glass]
young = 7e10
poisson = 0.22
density = 2500.0
[particles.a]
material = "glass"
diameter = 0.002
position = [0.0, 0.0, 0.0]
velocity = [1.0, 0.0, 0.0]
[particles.b]
material = "glass"
diameter = 0.002
position = [{x}, 0.0, 0.0]
[contact]
e_n = {e_n}
k_n = {k_n}
[run]
until_bounces = 1
"""


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ({"k_n": "0.0"}, "k_n"),
        ({"k_n": "-1.0"}, "k_n"),
        ({"k_n": "inf"}, "k_n"),
        ({"k_n": "nan"}, "k_n"),
        ({"e_n": "0.0"}, "e_n"),
        ({"e_n": "1.01"}, "e_n"),
        ({"x": "0.0"}, "position"),
        ({"x": "0.0009"}, "position"),
    ],
)
def test_what_liggghts_takes_in_silence_is_no_case(value: dict[str, str], said: str) -> None:
    with pytest.raises(CaseFileError, match=said):
        parse_case(CASE.format(**({"x": "0.003", "e_n": "0.9", "k_n": "1e5"} | value)), name="extreme")
    parse_case(CASE.format(x="0.003", e_n="0.9", k_n="1e5"), name="extreme")


@pytest.mark.parametrize("k", [0.0, -1.0, math.inf, math.nan])
def test_no_deck_with_a_stiffness_that_is_none(k: float, tmp_path: Path) -> None:
    model = plan(on_wall())["linear"]
    contact = model.between("ball", "floor")
    with pytest.raises(RenderError, match="k ="):
        Liggghts().render(replace(model, contacts={(0, 1): replace(contact, k=k)}), tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("dt", [0.0, -1e-7, math.inf, math.nan])
def test_no_deck_with_a_step_that_is_none(dt: float, tmp_path: Path) -> None:
    with pytest.raises(RenderError, match="dt ="):
        Liggghts().render(replace(plan(on_wall())["linear"], dt=dt), tmp_path)


def test_hertz_with_more_damping_than_liggghts_has(tmp_path: Path) -> None:
    with pytest.raises(RenderError, match="e_n"):
        Liggghts().render(plan(on_wall(e_n=0.05))["hertz"], tmp_path)


# --- a bed under its own weight ---------------------------------------------------------------------------------------


def bed(share: float) -> tuple[Finding, ...]:
    """What is said about a bed whose lowest particles overlap by this share of d, by weight over stiffness."""
    scene = load_case("bubbling_bed_mini")
    d, box = scene.diameter, scene.box
    layers = scene.number * d**2 / (box.width * box.depth)
    weight = 1000.0 * math.pi / 6.0 * d**3 * scene.g
    contact = replace(scene.contact, k_n=layers * weight / (share * d), v_0=1e-3)
    scene = replace(scene, contact=contact, run=replace(scene.run, steps_per_contact=50.0))
    if share >= 0.5:
        with pytest.raises(CaseFileError, match="cannot carry"):
            plan_checked(scene, LINEAR)
    return check(plan(scene, LINEAR)["linear"])


@pytest.mark.parametrize(("share", "level"), [(0.01, None), (0.1, "warn"), (0.6, "refuse")])
def test_a_bed_that_its_springs_do_not_carry(share: float, level: str | None) -> None:
    levels = {finding.level for finding in bed(share) if finding.code == "static-overlap"}
    assert levels == ({level} if level else set())


# --- caught after the run ---------------------------------------------------------------------------------------------


@pytest.mark.solver
@pytest.mark.parametrize("how", ["too soft", "too long a step"])
def test_a_sphere_that_goes_through_the_wall_fails(how: str, tmp_path: Path) -> None:
    """LIGGGHTS ends with code 0 and all its particles; planning is passed by."""
    model = plan(on_wall(v=1.0))["linear"]
    contact = model.between("ball", "floor")
    if how == "too soft":
        weak = replace(contact, k=1e-3, c=0.0)
        model = at_step(replace(model, contacts={(0, 1): weak}), 1e-5, 400)
    else:
        model = at_step(model, 3e-3, 5)
    folder = tmp_path / "run"
    folder.mkdir()
    engine = Liggghts()
    engine.render(model, folder)
    result = engine.run(model, folder, timeout=60.0)
    assert (result.status, result.failure) == ("failed", "passed-through")
    assert "ball–floor" in result.message
    assert np.isfinite(engine.read(model, folder).x).all()


@pytest.mark.solver
def test_spheres_that_go_through_each_other_fail(tmp_path: Path) -> None:
    model = plan(pair(3.0, v=1.0))["linear"]
    weak = replace(model.between("small", "large"), k=1e-3, c=0.0)
    model = at_step(replace(model, contacts={(0, 1): weak}), 2e-5, 800)
    engine = Liggghts()
    engine.render(model, tmp_path)
    result = engine.run(model, tmp_path, timeout=60.0)
    assert (result.status, result.failure) == ("failed", "passed-through")
