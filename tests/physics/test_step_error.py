"""What the time step does to e_n: the advised N against impacts written out again, LIGGGHTS, and what is said."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kncal import InputError, Material, advise_time_step, advised_steps, calibrate, pair, smallest_restitution
from kncal.cli import main
from kncal.core.errors import CaseFileError
from kncal.engines.registry import get_engine
from kncal.observe.contacts import observe
from kncal.physics.timestep import instead_of_zero, predict_error, restitution_error
from kncal.scene.case_file import load_case
from kncal.scene.limits import check
from kncal.scene.plan import plan
from kncal.study.stability.accuracy import steps_of_impact
from kncal.study.stability.probes import at_step, impact_on_wall, ingredients

PAIR = pair(Material(young=70e9, poisson=0.22, density=2500.0), 1e-3)


def worst_of_impacts(e_n: float, n: float, samples: int = 4000) -> float:
    """Largest error of e_n of linear contacts by velocity Verlet with half-step velocities, N within half a step."""
    zeta = -math.log(e_n) / math.hypot(math.pi, math.log(e_n))
    rng = np.random.default_rng(1)
    dt = math.pi / math.sqrt(1.0 - zeta**2) / (n + rng.uniform(-0.5, 0.5, samples))
    x, v, a = -rng.uniform(0.0, 1.0, samples) * dt, np.ones(samples), np.zeros(samples)
    for _ in range(int(1.5 * n) + 10):
        half = v + 0.5 * dt * a
        x = x + dt * half
        a = np.where(x > 0.0, -x - 2.0 * zeta * half, 0.0)
        v = half + 0.5 * dt * a
    return float(np.abs(-v / e_n - 1.0).max())


@pytest.mark.parametrize("e_n", [0.9, 0.6, 0.3])
def test_the_advised_number_of_steps_is_enough_and_hardly_more(e_n: float) -> None:
    n = advised_steps("linear", e_n)
    assert n is not None
    assert worst_of_impacts(e_n, n) <= 0.0107  # a predicted worst is up to 7 % below the worst of many
    assert worst_of_impacts(e_n, 0.85 * n) > 0.01


def test_the_advice_follows_the_worst_phase_and_not_the_mean() -> None:
    """In the mean over the phases e_n is right long before: by a factor of 2 at e_n = 0.3, of 60 at 0.9."""
    for e_n, factor in ((0.3, 2.0), (0.9, 30.0)):
        n = advised_steps("linear", e_n)
        assert n is not None
        found = predict_error("linear", e_n, n)
        assert abs(found.mean["e_n"]) * factor < found.worst["e_n"] <= 0.01


def test_an_advice_asks_for_more_than_usual_only_where_e_n_needs_it() -> None:
    usual, damped = (advise_time_step(calibrate(PAIR, v_0=0.5, e_n=e)) for e in (0.9, [0.9, 0.3]))
    assert usual.steps_per_contact == 50.0
    assert damped.steps_per_contact == advised_steps("linear", 0.3) == pytest.approx(320.0, rel=0.1)
    # smaller errors, and the reference alone
    assert advised_steps("linear", 0.9, error=0.001) > 8.0 * (advised_steps("linear", 0.9) or 0.0)
    assert (advised_steps("tsuji", 0.3) or 0.0) < damped.steps_per_contact
    assert advised_steps("walton_braun", 0.5) is None
    with pytest.raises(InputError, match="error"):
        advised_steps("linear", 0.5, error=0.0)


def test_beyond_a_thousand_steps_an_error_falls_as_one_over_n() -> None:
    """Against impacts written out again, at N = 1500."""
    seen = worst_of_impacts(0.1, 1500.0, samples=600)
    assert restitution_error("linear", 0.1, 1500.0) == pytest.approx(seen, rel=0.1)
    assert restitution_error("linear", 0.1, 2.0) == math.inf


@pytest.mark.solver
@pytest.mark.parametrize(("e_n", "off"), [(0.3, 0.042), (0.1, 0.13)])
def test_liggghts_at_fifty_steps(e_n: float, off: float, tmp_path: Path) -> None:
    """Spheres side by side, at eight sub-step phases: e_n is 4.2 and 13 % off at the worst of a few phases."""
    engine = get_engine("liggghts")
    probe = impact_on_wall(ingredients(load_case("wall_impact")), "linear", e_n)
    t_c = probe.model.between("s0", "floor").t_c
    model = at_step(probe.model, t_c / 50.0, steps_of_impact(probe, t_c / 50.0))
    engine.render(model, tmp_path)
    assert engine.run(model, tmp_path, timeout=60.0).status == "completed"
    events = observe(model, engine.read(model, tmp_path)).contacts
    worst = max(abs(event.e_n / e_n - 1.0) for event in events if event.e_n is not None)
    assert 0.9 * off < worst < 1.1 * off
    predicted = restitution_error("linear", e_n, 50.0)
    assert predicted is not None
    assert worst < predicted


def said(case: str, *changes: str, code: str, kind: str = "linear") -> list[str]:
    """Messages of ``code`` about a case, of single contacts or a bed."""
    scene = load_case(case, overrides=changes)
    findings = check(plan(scene, (kind,))[kind])
    return [finding.message for finding in findings if finding.code == code and finding.level == "warn"]


@pytest.mark.parametrize(
    ("case", "code", "steps"), [("wall_impact", "dt-coarse", 50), ("bubbling_bed_mini", "dem-step", 22)]
)
def test_a_step_that_makes_e_n_wrong_is_said_with_the_step_that_does_not(case: str, code: str, steps: int) -> None:
    changes = ("contact.e_n=0.3", "contact.pairs=[]")
    text = said(case, *changes, f"run.steps_per_contact={steps}", code=code)[0]
    assert float(text.split("up to ")[1].split(" %")[0]) == pytest.approx(100.0 * worst_of_impacts(0.3, steps), rel=0.1)
    advised = float(text.split("run.steps_per_contact = ")[1].split()[0])
    # a bed's contacts with walls last longer: what its shortest contact needs is enough for all
    assert advised == pytest.approx(320.0, rel=0.1)
    assert not said(case, *changes, f"run.steps_per_contact={advised!r}", code=code)


def test_usual_cases_are_not_nagged() -> None:
    """At 50 steps from e_n = 0.65 on; the step of the linear contact is the coarser one."""
    for e_n in (1.0, 0.9, 0.65):
        changes = (f"contact.e_n={e_n}", "run.steps_per_contact=50")
        assert not said("wall_impact", *changes, code="dt-coarse")
        assert not said("bubbling_bed_mini", *changes, code="dem-step")


def test_a_pair_that_lasts_longer_is_judged_by_its_own_steps() -> None:
    """A wall whose contact lasts 1.6 times as long as that of two particles has as many more steps."""
    bed = load_case("bubbling_bed_mini")
    bed = replace(bed, contact=replace(bed.contact, e_n=0.3), run=replace(bed.run, steps_per_contact=22.0))
    model = plan(bed, ("linear",))["linear"]
    wall, both = (model.between("beads", name) for name in ("column", "beads"))
    texts = {m.message.split(":")[0]: m.message for m in check(model) if m.code == "dem-step"}
    wanted = {who: float(text.split("run.steps_per_contact = ")[1].split()[0]) for who, text in texts.items()}
    ratio = wanted["beads–beads"] / wanted["beads–column"]
    assert ratio == pytest.approx(wall.t_c / both.t_c, rel=0.01)


@pytest.mark.parametrize("n", [20.0, 50.0, 100.0])
def test_the_way_out_of_no_rebound_is_resolved_by_the_step(n: float) -> None:
    least = smallest_restitution(n)
    assert worst_of_impacts(least, n) <= 0.107
    assert worst_of_impacts(0.95 * least, n) > 0.1


@pytest.mark.parametrize("case", ["wall_impact", "bubbling_bed_mini"])
def test_no_rebound_in_a_case_is_refused_with_a_way_out(case: str) -> None:
    with pytest.raises(CaseFileError) as refused:
        load_case(case, overrides=("contact.e_n=0", "run.steps_per_contact=80"))
    text = str(refused.value)
    assert instead_of_zero(80.0, ("linear", "tsuji")) in text
    assert f"e_n = {smallest_restitution(80.0):g}" in text
    load_case(case, overrides=(f"contact.e_n={smallest_restitution(80.0)!r}", "run.steps_per_contact=80"))


def test_no_rebound_by_flags_and_the_step_in_json(capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["kn", "--young", "70e9", "--density", "2500", "--radius", "1e-3", "--v0", "0.5"]
    with pytest.raises(SystemExit) as stop:
        main([*flags, "--en", "0"])
    assert stop.value.code == 2
    assert f"e_n = {smallest_restitution():g}" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([*flags, "--en", "0.3", "--steps-per-contact", "50", "--json"])
    found = json.loads(capsys.readouterr().out)["step_error"]
    assert found["linear"]["e_n"] == pytest.approx(worst_of_impacts(0.3, 50.0), rel=0.07)
    assert found["linear"]["advised_steps_per_contact"] == advised_steps("linear", 0.3)
    assert found["tsuji"]["advised_steps_per_contact"] == advised_steps("tsuji", 0.3)
