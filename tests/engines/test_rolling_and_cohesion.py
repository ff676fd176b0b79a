"""Rolling friction, cohesion, and the laws that LIGGGHTS has and has not, in the real one, against mechanics."""

from __future__ import annotations

import dataclasses
import math
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kncal.core.errors import RenderError
from kncal.engines.liggghts.batch import Liggghts
from kncal.physics.material import Material, sphere_mass, wall_pair
from kncal.physics.timestep import predict_error
from kncal.record.frames import Trajectory
from kncal.scene.bodies import Particle, Wall
from kncal.scene.contact import ContactChoice, PairChoice
from kncal.scene.model import KINDS, PairContact, Plan
from kncal.scene.plan import plan
from kncal.scene.scene import RunControl, Scene

pytestmark = pytest.mark.solver

GLASS = Material(young=5e6, poisson=0.25, density=2500.0, name="glass")
R, G = 1e-3, 9.81
WEIGHT = float(sphere_mass(GLASS, R)) * G


def planned(
    kind: str, spheres: tuple[Particle, ...], t_end: float, gravity: tuple[float, float, float], **contact: Any
) -> Plan:
    scene = Scene.of(
        name="contacts",
        spheres=spheres,
        planes=(Wall(name="floor", axis="z", position=0.0, material=GLASS),),
        gravity=gravity,
        contact=ContactChoice(**{"e_n": 0.5, "v_0": 0.1} | contact),
        run=RunControl(until_time=t_end, steps_per_contact=40.0, record_every=50),
    )
    return plan(scene, [kind])[kind]


def simulate(model: Plan, folder: Path, style: str = "hooke/stiffness") -> Trajectory:
    folder.mkdir(exist_ok=True)
    engine = Liggghts(style)
    engine.render(model, folder)
    result = engine.run(model, folder, timeout=60.0)
    assert result.status == "completed", result.message
    return engine.read(model, folder)


def resting(kind: str, name: str, x: float, weight: float = WEIGHT, **how: Any) -> Particle:
    """A sphere on the floor that its weight presses in as far as the spring carries it."""
    probe = Particle(name="probe", material=GLASS, radius=R, position=(0.0, 0.0, 2.0 * R))
    contact = planned(kind, (probe,), 1e-3, (0.0, 0.0, -G)).between("probe", "floor")
    return Particle(name=name, material=GLASS, radius=R, position=(x, 0.0, R - contact.overlap_under(weight)), **how)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("rolling_model", ["cdt", "epsd2"])
def test_rolling_friction_of_each_pair_slows_a_rolling_sphere(kind: str, rolling_model: str, tmp_path: Path) -> None:
    # I w' = F R - M, m v' = -F, v = w R, M = mu_r R m g: v' = -(5/7) mu_r g
    rates = {"one": 0.02, "two": 0.06}
    v_0, time = 0.05, 0.05
    spheres = tuple(
        resting(kind, name, 8.0 * R * k, velocity=(0.0, v_0, 0.0), spin=(-v_0 / R, 0.0, 0.0))
        for k, name in enumerate(rates)
    )
    pairs = tuple(PairChoice(between=(name, "floor"), rolling_friction=mu) for name, mu in rates.items())
    choice: dict[str, Any] = {"friction": 0.5, "rolling_model": rolling_model, "pairs": pairs}
    model = planned(kind, spheres, time, (0.0, 0.0, -G), rolling_friction=0.3, **choice)
    assert model.needs.uses("rolling")
    frames = simulate(model, tmp_path)
    for k, mu in enumerate(rates.values()):
        lost = 5.0 / 7.0 * mu * G * frames.t[-1]
        # the spring of epsd2 is stretched first, and a sphere rolls on R - delta
        assert v_0 - frames.v[-1, k, 1] == pytest.approx(lost, rel=0.02), mu


@pytest.mark.parametrize("rolling_model", ["epsd", "epsd2"])
def test_a_rolling_spring_holds_a_sphere_on_a_slope_up_to_its_friction(rolling_model: str, tmp_path: Path) -> None:
    mu_r, time = 0.2, 0.05
    moved = {}
    for steep in (0.5, 2.0):
        angle = math.atan(steep * mu_r)
        sphere = resting("linear", "ball", 0.0, WEIGHT * math.cos(angle))
        model = planned(
            "linear",
            (sphere,),
            time,
            (G * math.sin(angle), 0.0, -G * math.cos(angle)),
            friction=0.9,
            rolling_friction=mu_r,
            rolling_model=rolling_model,
            rolling_damping=0.3 if rolling_model == "epsd" else 0.0,
        )
        moved[steep] = simulate(model, tmp_path / f"{steep}").x[-1, 0, 0]
        rolls = 0.5 * 5.0 / 7.0 * G * (math.sin(angle) - mu_r * math.cos(angle)) * time**2
        if steep > 1.0:
            assert moved[steep] == pytest.approx(rolls, rel=0.05)
    assert abs(moved[0.5]) < 0.02 * moved[2.0]


# --- cohesion ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_cohesion_pulls_by_the_area_in_which_the_outlines_cut(kind: str, tmp_path: Path) -> None:
    density = {"floor": 2e4, "two": 5e4}
    delta = {"floor": 2e-5, "two": 3e-5}
    one = Particle(name="one", material=GLASS, radius=R, position=(0.0, 0.0, R - delta["floor"]))
    two = Particle(
        name="two", material=GLASS, radius=2.0 * R, position=(0.0, 0.0, 4.0 * R - delta["floor"] - delta["two"])
    )
    pairs = tuple(PairChoice(between=("one", name), cohesion_energy_density=kappa) for name, kappa in density.items())
    model = planned(kind, (one, two), 1e-4, (0.0, 0.0, 0.0), pairs=pairs)
    frames = simulate(model, tmp_path)

    def force(name: str, area: float) -> float:
        contact = model.between("one", name)
        return contact.k * delta[name] ** contact.n - density[name] * area

    # circle about the line of centres: a² = R² - h², h from the centre to the plane of the circle
    d, r_1, r_2 = 3.0 * R - delta["two"], R, 2.0 * R
    h = (d * d + r_1 * r_1 - r_2 * r_2) / (2.0 * d)
    on_two = force("two", math.pi * (r_1**2 - h**2))
    on_floor = force("floor", math.pi * (R**2 - (R - delta["floor"]) ** 2))
    assert frames.force[0, 1, 2] == pytest.approx(on_two, rel=1e-9)
    assert frames.force[0, 0, 2] == pytest.approx(on_floor - on_two, rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_cohesion_alone_costs_no_energy(kind: str, tmp_path: Path) -> None:
    ball = Particle(name="ball", material=GLASS, radius=R, position=(0.0, 0.0, 1.01 * R), velocity=(0.0, 0.0, -0.1))
    law = {"law": "tsuji", "e_n": 1.0}
    model = planned(kind, (ball,), 5e-3, (0.0, 0.0, 0.0), cohesion_energy_density=3e4, **law)
    assert model.needs.uses("cohesion")
    frames = simulate(model, tmp_path)
    assert frames.v[-1, 0, 2] == pytest.approx(0.1, rel=5e-3)


def hanging(kind: str, density: float, delta: float) -> Plan:
    """A sphere above a wall, that its weight pulls off."""
    ball = Particle(name="ball", material=GLASS, radius=R, position=(0.0, 0.0, R - delta))
    return planned(kind, (ball,), 0.02, (0.0, 0.0, G), cohesion_energy_density=density, e_n=0.3)


@pytest.mark.parametrize("bond", [0.9, 1.1])
def test_a_hertz_sphere_hangs_if_its_bond_number_is_above_one(bond: float, tmp_path: Path) -> None:
    k_h = float(wall_pair(GLASS, R, GLASS).k_h)
    slope = (27.0 / 4.0 * bond * WEIGHT * k_h**2) ** (1.0 / 3.0)
    density, root = slope / (2.0 * math.pi * R), slope / k_h
    # k_h x³ - slope x² = -m g with x = sqrt(delta): the larger root is stable; without one start at the strongest pull
    roots = np.roots([k_h, -slope, 0.0, WEIGHT])
    stable = max((r.real for r in roots if abs(r.imag) < 1e-9), default=0.0)
    model = hanging("hertz", density, max(stable, 2.0 / 3.0 * root) ** 2)
    assert model.between("ball", "floor").pull_off() / WEIGHT == pytest.approx(bond, rel=1e-9)
    away = simulate(model, tmp_path).x[-1, 0, 2] - R
    assert away < 0.0 if bond > 1.0 else away > 1e-4


def test_a_linear_sphere_does_not_hang_on_cohesion(tmp_path: Path) -> None:
    k_n = hanging("linear", 1.0, 1e-6).between("ball", "floor").k
    model = hanging("linear", 0.95 * k_n / (2.0 * math.pi * R), 1e-6)
    (contact,) = model.contacts.values()
    assert contact.pull_off() == 0.0
    assert "cohesion-linear" in contact.warnings
    assert simulate(model, tmp_path).x[-1, 0, 2] > 1.1 * R


def test_the_density_that_keeps_the_force_does_so() -> None:
    asked: dict[str, Any] = {"k_n": 20.0, "v_0": 0.1, "cohesion_energy_density": 1e3, "e_n": 0.9}
    ball = Particle(name="ball", material=GLASS, radius=R, position=(0.0, 0.0, 1.01 * R))
    own, same, hertz = (
        planned(kind, (ball,), 1e-3, (0.0, 0.0, 0.0), cohesion_keeps=keeps, **asked).between("ball", "floor")
        for kind, keeps in (("linear", "density"), ("linear", "force"), ("hertz", "force"))
    )

    def pull(contact: PairContact) -> float:
        assert contact.delta_max is not None
        return contact.cohesion * contact.delta_max

    assert (own.cohesion, hertz.cohesion) == (1e3, 1e3)
    assert pull(same) == pytest.approx(pull(hertz), rel=1e-9)
    assert pull(own) > 1.1 * pull(hertz)
    assert f"{same.cohesion:.4g}" in own.warnings["cohesion-area"]
    assert "cohesion-area" not in same.warnings


# --- laws -------------------------------------------------------------------------------------------------------------


def test_kuwabara_kono_of_a_case_rebounds_as_asked(tmp_path: Path) -> None:
    ball = Particle(name="ball", material=GLASS, radius=R, position=(0.0, 0.0, 1.001 * R), velocity=(0.2, 0.0, -0.5))
    model = planned("hertz", (ball,), 2e-3, (0.0, 0.0, 0.0), law="kuwabara_kono", v_0=0.5, e_n=0.8, friction=0.3)
    model = dataclasses.replace(model, dt=model.dt / 5.0, n_steps=5 * model.n_steps)
    frames = simulate(model, tmp_path)
    assert "hertz/stiffness" in (tmp_path / "in.liggghts").read_text()
    steps = model.shortest / model.dt
    assert frames.v[-1, 0, 2] / 0.5 == pytest.approx(
        0.8, rel=1.05 * predict_error("kuwabara_kono", 0.8, steps).worst["e_n"]
    )


def test_both_linear_models_of_liggghts_damp_a_sticking_contact_alike(tmp_path: Path) -> None:
    ball = Particle(name="ball", material=GLASS, radius=R, position=(0.0, 0.0, 1.01 * R), velocity=(0.1, 0.0, -0.5))
    choice: dict[str, Any] = {
        "friction": 0.9, "method": "strain_energy", "v_0": 0.5, "tangential_damping": "liggghts"
    }  # fmt: skip
    model = planned("linear", (ball,), 2e-3, (0.0, 0.0, 0.0), k_t_ratio=1.0, **choice)
    ends = [simulate(model, tmp_path / style.replace("/", "-"), style) for style in ("hooke/stiffness", "hooke")]
    for name in ("x", "v", "spin"):
        one, other = (getattr(end, name)[-1] for end in ends)
        assert np.abs(one - other).max() < 1e-9 * np.abs(one).max()
    undamped = simulate(
        planned("linear", (ball,), 2e-3, (0.0, 0.0, 0.0), k_t_ratio=1.0, **choice | {"tangential_damping": "none"}),
        tmp_path / "undamped",
    )
    assert abs(undamped.spin[-1, 0, 1] - ends[0].spin[-1, 0, 1]) > 1.0
    # with 2/7 of the spring LIGGGHTS' hooke still has the whole of the normal damping
    other = planned("linear", (ball,), 2e-3, (0.0, 0.0, 0.0), k_t_ratio=2.0 / 7.0, **choice)
    with pytest.raises(RenderError, match="c_t"):
        Liggghts("hooke").render(other, tmp_path)


def test_half_of_the_normal_damping_is_for_linear_contacts(tmp_path: Path) -> None:
    ball = Particle(name="ball", material=GLASS, radius=R, position=(0.0, 0.0, 1.01 * R), velocity=(0.2, 0.0, -0.5))
    choice: dict[str, Any] = {"friction": 0.3, "tangential_damping": "half_normal"}
    Liggghts().render(planned("linear", (ball,), 1e-3, (0.0, 0.0, 0.0), **choice), tmp_path)
    with pytest.raises(RenderError, match="c_t"):
        Liggghts().render(planned("hertz", (ball,), 1e-3, (0.0, 0.0, 0.0), **choice), tmp_path)


def test_the_hysteresis_of_liggghts_is_not_walton_braun(tmp_path: Path) -> None:
    """Its unloading stiffness grows with the largest overlap, so its e_n falls with the speed; Walton–Braun's is one
    number.
    """
    ratio, depth, V = 4.0, 0.2, 1.0
    both = wall_pair(GLASS, R, GLASS)
    m, stiff = float(both.m_eff), math.sqrt(R) * float(both.E_eff)
    k_1 = 16.0 / 15.0 * stiff * (15.0 * m * V**2 / (16.0 * stiff)) ** 0.2
    limit = ratio / (ratio - 1.0) * depth * 2.0 * R
    speeds, t_c = (0.05, 0.5, 2.0), math.pi * math.sqrt(m / k_1)
    dt = t_c / 500.0
    model = "model hooke/hysteresis tangential off"
    properties = {
        "coefficientRestitution": 1.0,
        "coefficientMaxElasticStiffness": ratio,
        "coefficientAdhesionStiffness": 0.0,
        "coefficientPlasticityDepth": depth,
    }
    deck = ["units si", "atom_style granular", "boundary f f f", "newton off", "communicate single vel yes"]
    deck += ["region box block -0.1 0.1 -0.1 0.1 -0.1 0.1 units box", "create_box 1 box", "neighbor 1e-3 nsq"]
    deck += [f"fix {k} all property/global {k} peratomtypepair 1 {v!r}" for k, v in properties.items()]
    deck += ["fix y all property/global youngsModulus peratomtype 5e6"]
    deck += ["fix n all property/global poissonsRatio peratomtype 0.25"]
    deck += [f"fix c all property/global characteristicVelocity scalar {V!r}", f"pair_style gran {model}"]
    deck += ["pair_coeff * *", f"timestep {dt!r}", f"fix w all wall/gran {model} primitive type 1 zplane 0.0"]
    deck += [f"create_atoms 1 single {0.01 * k} 0 {R + 1e-7!r} units box" for k in range(len(speeds))]
    deck += [f"set atom {k} diameter {2 * R!r} density 2500.0 vz {-v!r}" for k, v in enumerate(speeds, 1)]
    deck += ["fix move all nve/sphere", f"run {int(1.2 * t_c / dt) + 500}"]
    deck += ["write_dump all custom last.dump id vz modify sort id format '%d %.17g'", 'print "HYSTERESIS_DONE"']
    (tmp_path / "in.own").write_text("\n".join(deck) + "\n")
    done = subprocess.run(
        ["liggghts", "-in", "in.own"], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    assert "HYSTERESIS_DONE" in done.stdout, done.stdout[-1500:]
    rows = (tmp_path / "last.dump").read_text().splitlines()[-len(speeds) :]
    found = [float(row.split()[1]) / v for row, v in zip(rows, speeds, strict=True)]
    deepest = [v * math.sqrt(m / k_1) / limit for v in speeds]
    assert found == pytest.approx([1.0 / math.sqrt(1.0 + (ratio - 1.0) * min(d, 1.0)) for d in deepest], rel=0.01)
    assert found[0] > found[1] > found[2]
