"""The shipped cases: promises of form. Whether their numbers come out is tested where they are run."""

from __future__ import annotations

import json
import math
import re
import tomllib
import warnings
from pathlib import Path
from typing import Any

import pytest
from shipped import SINGLE

from kncal.core.checks import as_floats
from kncal.core.shipped import folder
from kncal.scene.case_file import dump_case, load_case, parse_case, shipped_cases
from kncal.scene.metrics import METRICS, split_metric
from kncal.scene.needs import decide

CASES = folder("cases")
PROMISED = {
    "head_on_collision": {"pair_contacts"},
    "unequal_collision": {"pair_contacts", "damping"},
    "wall_impact": {"walls", "damping"},
    "falling_particle": {"walls", "damping", "gravity"},
    "stacked_particles": {"pair_contacts", "walls", "damping", "gravity"},
    "sliding_particle": {"walls", "gravity", "tangential", "history", "rotation"},
    "oblique_impact": {"walls", "tangential", "history", "rotation"},
}
every_case = pytest.mark.parametrize("name", SINGLE)


def expected(name: str) -> dict[str, Any]:
    data: dict[str, Any] = json.loads((CASES / name / "expected.json").read_text(encoding="utf-8"))
    return data


def test_shipped_cases_are_those_promised() -> None:
    assert set(shipped_cases()) >= set(PROMISED)
    assert {path.name for path in CASES.iterdir()} == set(shipped_cases())


def test_missing_folder_says_so() -> None:
    with pytest.raises(FileNotFoundError, match="'no_such_thing' is missing"):
        folder("no_such_thing")


@every_case
def test_case_loads_and_says_what_it_is(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = load_case(name)
    assert scene.name == name
    assert scene.title
    assert scene.source
    assert scene.tolerances, "a comparison needs tolerances for a verdict"
    assert parse_case(dump_case(scene), name=name) == scene


@pytest.mark.parametrize("name", sorted(PROMISED))
def test_case_needs_what_its_physics_says(name: str) -> None:
    needs = decide(load_case(name))
    assert {item.name for item in needs.items if item.used} == PROMISED[name]
    assert needs.dimensions == (2 if "tangential" in PROMISED[name] else 1)


@every_case
def test_case_file_is_short_and_commented(name: str) -> None:
    lines = (CASES / name / "case.toml").read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# ")
    assert lines[0].endswith("SI units.")
    assert len(lines) <= 70
    assert sum("#" in line for line in lines) >= 5
    for key in ("young", "density", "diameter", "position", "velocity", "until_time"):
        first = next((line for line in lines if re.match(rf"{key} =", line)), None)
        assert first is None or "#" in first, f"the first {key} of a file says its unit or what it is"


@every_case
def test_readme_is_short_and_says_source_focus_and_command(name: str) -> None:
    text = (CASES / name / "README.md").read_text(encoding="utf-8")
    assert text.startswith(f"# {load_case(name).title}")
    assert f"    kncal compare {name}\n" in text
    assert re.search(r"Look at: ", text)
    assert re.search(r"Parameters: |own parameters are not public", text)
    assert len(text.splitlines()) <= 25
    assert max(map(len, text.splitlines())) <= 120


@every_case
def test_expected_values_have_tolerance_and_source(name: str) -> None:
    data = expected(name)
    assert set(data) <= {"note", "metrics", "positions"}
    assert set(data["metrics"]) == {"linear", "hertz"}
    entries = [item for model in data["metrics"].values() for item in model.items()]
    assert entries
    for metric, entry in entries:
        assert split_metric(metric)[0] in METRICS
        assert set(entry) == {"value", "rel_tol", "source"}
        assert as_floats(metric, entry["value"]) > 0.0
        assert 0.0 < entry["rel_tol"] <= 0.05
        assert entry["source"]


@every_case
def test_tolerances_admit_the_expected_values(name: str) -> None:
    """The verdict of the theory itself is "within": tolerances judge the run, not the choice of the case."""
    metrics = expected(name)["metrics"]
    for metric, tolerance in load_case(name).tolerances.items():
        if metric in metrics["hertz"]:
            hertz, linear = metrics["hertz"][metric]["value"], metrics["linear"][metric]["value"]
            assert abs(linear - hertz) <= tolerance * hertz, metric


@every_case
def test_particles_start_close_to_contact(name: str) -> None:
    """Runs stay short: the first touch is at most 1 % of a radius away, except where falling is the point."""
    scene = load_case(name)
    if name == "falling_particle":
        return
    gaps = [
        math.dist(a.position, b.position) - a.radius - b.radius
        if not hasattr(b, "axis")
        else abs(a.position["xyz".index(b.axis)] - b.position) - a.radius
        for a, b in scene.body_pairs()
    ]
    assert min(gaps) <= 0.01 * min(p.radius for p in scene.spheres)


# --- the numbers of the case files, against the closed forms they are said to come from ----------------------------


def first(case: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = next(iter(case["particles"].values()))
    return found


def raw(name: str) -> dict[str, Any]:
    return tomllib.loads(Path(CASES / name / "case.toml").read_text(encoding="utf-8"))


def test_oblique_impact_slides_to_its_end() -> None:
    case = raw("oblique_impact")
    v_t, _, v_n = (abs(v) for v in first(case)["velocity"])
    assert math.hypot(v_t, v_n) == pytest.approx(3.9, rel=1e-12)
    mu, e_n = case["contact"]["friction"], case["contact"]["e_n"]
    assert v_t / v_n > 3.5 * mu * (1.0 + e_n)
    values = {k: v["value"] for k, v in expected("oblique_impact")["metrics"]["linear"].items()}
    assert values["tangential_restitution"] == pytest.approx(1.0 - mu * (1.0 + e_n) * v_n / v_t, rel=1e-9)
    # angular momentum about the contact point is conserved: (2/5) R omega = v_t - v_t'
    R = first(case)["diameter"] / 2.0
    lost = v_t * (1.0 - values["tangential_restitution"])
    assert values["spin_out"] == pytest.approx(2.5 * lost / R, rel=1e-9)


def test_sliding_ball_starts_on_its_spring_and_ends_rolling() -> None:
    case = raw("sliding_particle")
    ball, g = first(case), -case["gravity"][2]
    R, material = ball["diameter"] / 2.0, case["materials"]["ball"]
    weight = material["density"] * 4.0 / 3.0 * math.pi * R**3 * g
    assert R - ball["position"][2] == pytest.approx(weight / case["contact"]["k_n"], rel=1e-5)
    k_h = 4.0 / 3.0 * material["young"] / (1.0 - material["poisson"] ** 2) * math.sqrt(R)
    assert k_h ** (2.0 / 3.0) * weight ** (1.0 / 3.0) == pytest.approx(case["contact"]["k_n"], rel=1e-3)
    values = {k: v["value"] for k, v in expected("sliding_particle")["metrics"]["hertz"].items()}
    u_0, mu = ball["velocity"][0], case["contact"]["friction"]
    t, u = values["slip_end_time"], values["slip_end_speed"]
    assert u == pytest.approx(u_0 - mu * g * t, rel=1e-9)
    assert u == pytest.approx(2.5 * mu * g * t, rel=1e-9)  # speed of the surface, omega R
    assert t < case["run"]["until_time"]


def test_stacked_particles_are_matched_at_their_first_overlaps() -> None:
    case = raw("stacked_particles")
    heavy, light = case["materials"]["heavy"], case["materials"]["light"]
    assert (heavy["young"], heavy["poisson"]) == (light["young"], light["poisson"])
    E_eff = heavy["young"] / (2.0 * (1.0 - heavy["poisson"] ** 2))
    for R_eff, force in ((0.25e-3, 0.1), (0.5e-3, 0.05)):
        secant = (4.0 / 3.0 * E_eff * math.sqrt(R_eff)) ** (2.0 / 3.0) * force ** (1.0 / 3.0)
        assert secant == pytest.approx(case["contact"]["k_n"], rel=1e-5)


def test_falling_particle_is_near_the_hard_sphere_and_below_it() -> None:
    case = raw("falling_particle")
    fall = first(case)["position"][2] - first(case)["diameter"] / 2.0
    e_n = case["contact"]["e_n"]
    for model in expected("falling_particle")["metrics"].values():
        for bounce, suffix in enumerate(("", "_2", "_3"), start=1):
            hard = fall * e_n ** (2 * bounce)
            # the weight during a contact of finite duration costs a little speed
            assert 0.99 * hard < model[f"rebound_height{suffix}"]["value"] < hard


@pytest.mark.parametrize("name", ["head_on_collision", "oblique_impact"])
def test_elastic_impacts_conserve_energy(name: str) -> None:
    """All kinetic energy is in the spring at the maximum overlap: (2/5) k_h x^2.5 and (1/2) k_n x^2 are equal."""
    case, metrics = raw(name), expected(name)["metrics"]
    if name == "head_on_collision":
        R = first(case)["diameter"] / 2.0
        glass = case["materials"]["glass"]
        m_eff, R_eff, speed = glass["density"] * 2.0 / 3.0 * math.pi * R**3, R / 2.0, 20.0
        E_eff = glass["young"] / (2.0 * (1.0 - glass["poisson"] ** 2))
    else:
        R = R_eff = first(case)["diameter"] / 2.0
        oxide, alloy = case["materials"]["aluminium_oxide"], case["materials"]["aluminium_alloy"]
        m_eff, speed = oxide["density"] * 4.0 / 3.0 * math.pi * R**3, -first(case)["velocity"][2]
        E_eff = 1.0 / sum((1.0 - m["poisson"] ** 2) / m["young"] for m in (oxide, alloy))
    energy = 0.5 * m_eff * speed**2
    x = metrics["hertz"]["delta_max"]["value"]
    assert 0.4 * 4.0 / 3.0 * E_eff * math.sqrt(R_eff) * x**2.5 == pytest.approx(energy, rel=1e-8)
    x, t_c = metrics["linear"]["delta_max"]["value"], metrics["linear"]["t_c"]["value"]
    assert 0.5 * m_eff * (math.pi / t_c) ** 2 * x**2 == pytest.approx(energy, rel=1e-8)
