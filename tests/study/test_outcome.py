"""Runs that are broken on purpose come out as what they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kncal.core.errors import CaseFileError, RunError
from kncal.engines.builtin.integrator import integrate
from kncal.engines.tunnelling import passages
from kncal.record.frames import Trajectory
from kncal.record.outcome import FAILURES
from kncal.scene.case_file import load_case
from kncal.scene.model import Plan
from kncal.study.stability import outcome as outcomes
from kncal.study.stability.accuracy import impacts
from kncal.study.stability.edges import run_builtin
from kncal.study.stability.limits import impact_limit
from kncal.study.stability.outcome import judge, outcome_of_error, outcome_of_failure
from kncal.study.stability.probes import at_step, impact_of_pair, impact_on_wall, ingredients

SPHERE = ingredients(load_case("wall_impact"))


def impact(e_n: float, share: float, kind: str = "linear") -> outcomes.Outcome:
    """An impact at a share of the stability limit."""
    probe = impact_on_wall(SPHERE, kind, e_n)
    (found,) = impacts(run_builtin, probe, [share * impact_limit(probe.model)])
    return found


@pytest.mark.parametrize("kind", ["linear", "hertz"])
def test_what_becomes_of_impacts(kind: str) -> None:
    good = impact(0.9, 0.02, kind)
    assert good.stable
    assert abs(good.numbers["e_n_error"]) <= 1.25 * good.numbers["e_n_predicted"]
    assert good.numbers["energy_change"] == pytest.approx(0.81 - 1.0, abs=0.01)
    assert impact(0.1, 0.8, kind).code == outcomes.RESTITUTION
    gain = impact(0.9, 2.0, kind)
    assert gain.code == outcomes.GAIN
    assert gain.numbers["energy_change"] > 0.0


def test_a_particle_that_jumps_through_the_wall() -> None:
    probe = impact_on_wall(SPHERE, "linear", 0.9)
    (found,) = impacts(run_builtin, probe, [3.0 * SPHERE.radius / SPHERE.v_0])
    assert found.code == outcomes.TUNNELLING


def frames(model: Plan, x: np.ndarray) -> Trajectory:
    """Frames with these positions (frames, particles, 3)."""
    names = tuple(p.name for p in model.scene.spheres)
    steps = np.arange(len(x))
    radius = np.array([p.radius for p in model.scene.spheres])
    zero = np.zeros_like(x)
    return Trajectory(names, steps, steps * model.dt, x, zero, zero, zero, radius)


def test_centres_that_pass_between_two_frames_are_seen() -> None:
    """No frame shows an overlap: one sphere is on the left, then on the right of the other."""
    probe = impact_of_pair(SPHERE, "linear", 0.9)
    model = at_step(probe.model, 1e-3, 2)
    R = SPHERE.radius
    left, right, aside = (-4.0 * R, 0.0, 0.0), (6.0 * R, 0.0, 0.0), (6.0 * R, 4.0 * R, 0.0)
    other = (R, 0.0, 0.0)
    through = frames(model, np.array([[left, other], [right, other]]))
    assert len(passages(model, through)) == 1
    assert judge(model, through).code == outcomes.TUNNELLING
    assert passages(model, frames(model, np.array([[left, other], [aside, other]]))) == ()
    assert passages(model, frames(model, np.array([[left, other], [left, other]]))) == ()


def test_a_number_that_is_none() -> None:
    probe = impact_on_wall(SPHERE, "linear", 0.9)
    model = at_step(probe.model, 1e-8, 3)
    run = integrate(model)
    x = run.x.copy()
    x[-1, 0, 0] = np.nan
    assert judge(model, replace(run, x=x)).code == outcomes.NOT_FINITE


@pytest.mark.parametrize("failure", FAILURES)
def test_every_failure_of_a_run_is_an_outcome(failure: str) -> None:
    found = outcome_of_failure(failure, "text")
    assert found.code in outcomes.OUTCOMES
    assert not found.stable
    if failure in ("lost-particles", "not-finite"):
        assert found.code == failure


def test_errors_are_outcomes() -> None:
    assert outcome_of_error(CaseFileError("no")).code == outcomes.REFUSED
    assert outcome_of_error(RunError("through", "passed-through")).code == outcomes.TUNNELLING
