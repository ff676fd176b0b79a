"""Every shipped case, by both engines, against the exact solution, its expected.json and each other."""

import json
from functools import cache

import numpy as np
import pytest
from shipped import SINGLE

from kncal.core.shipped import folder as resource
from kncal.engines.registry import get_engine
from kncal.observe.compare import compare as compare_runs
from kncal.observe.run_data import RunData
from kncal.runs.workflow import complete, load, require_completed, run_case
from kncal.scene.case_file import load_case
from kncal.scene.model import KINDS

ENGINES = ["builtin", pytest.param("liggghts", marks=pytest.mark.solver)]
# Contacts of one sphere and one wall or of two spheres, without friction: the same iteration, digit for digit.
NORMAL_IMPACTS = ("head_on_collision", "unequal_collision", "wall_impact", "falling_particle")


@pytest.fixture(scope="session")
def runs(tmp_path_factory):
    """case, engine -> {kind: RunData}, each run once per session."""
    root = tmp_path_factory.mktemp("runs")

    @cache
    def run(case, engine_name):
        out = root / f"{case}-{engine_name}"
        results = run_case(load_case(case), get_engine(engine_name), out)
        require_completed(results.values())
        return {kind: complete(load(out / kind)) for kind in KINDS}

    return run


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("case", SINGLE)
def test_agrees_with_the_exact_solution_within_the_predicted_error(case, engine, runs):
    checked = 0
    for data in runs(case, engine).values():
        assert data.exact, "every shipped case has exact values"
        for name, exact in data.exact.items():
            if data.predicted is None or name not in data.predicted or name not in data.observations.metrics:
                continue
            # 1e-9: what the frames' 17 digits and the exact solution's 1e-12 leave on an elastic contact
            limit = 1.05 * data.predicted[name] + 1e-9
            assert data.observations.metrics[name] == pytest.approx(exact, rel=limit), (data.model.kind, name)
            checked += 1
    assert checked >= 2


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("case", SINGLE)
def test_agrees_with_expected_json(case, engine, runs):
    expected = json.loads((resource("cases") / case / "expected.json").read_text())["metrics"]
    assert expected
    for kind, metrics in expected.items():
        observed = runs(case, engine)[kind].observations.metrics
        for name, entry in metrics.items():
            assert observed[name] == pytest.approx(entry["value"], rel=entry["rel_tol"]), (kind, name)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("case", SINGLE)
def test_linear_is_within_the_tolerances_of_the_case(case, engine, runs):
    both = runs(case, engine)
    comparison = compare_runs(both["linear"], both["hertz"])
    assert comparison.judged
    assert comparison.within, [f"{r.metric} {r.difference} {r.reason}" for r in comparison.failures]


@pytest.mark.solver
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("case", NORMAL_IMPACTS)
def test_liggghts_and_builtin_are_the_same_iteration(case, kind, runs):
    one, two = (runs(case, engine)[kind] for engine in ("builtin", "liggghts"))
    for a, b in zip(one.observations.contacts, two.observations.contacts, strict=True):
        assert a.pair == b.pair
        assert a.v_out == pytest.approx(b.v_out, rel=1e-9)
        assert a.delta_max == pytest.approx(b.delta_max, rel=1e-9)
    assert one.observations.metrics.keys() == two.observations.metrics.keys()


@pytest.mark.solver
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("case", ["stacked_particles", "sliding_particle", "oblique_impact"])
def test_liggghts_and_builtin_agree_with_friction_and_resting_contacts(case, kind, runs):
    one, two = (runs(case, engine)[kind] for engine in ("builtin", "liggghts"))
    assert one.observations.metrics.keys() == two.observations.metrics.keys()
    for name, value in one.observations.metrics.items():
        # A resting overlap is a small difference of positions: 1e-16 m of 5 nm leaves seven digits.
        assert two.observations.metrics[name] == pytest.approx(value, rel=1e-6), name


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("case", ["head_on_collision", "unequal_collision"])
def test_momentum_is_conserved(case, engine, runs):
    for data in runs(case, engine).values():
        masses = np.array([p.material.density * p.radius**3 for p in data.model.scene.spheres])
        momentum = np.einsum("p,fpi->fi", masses, data.trajectory.v)
        scale = np.abs(masses[:, None] * data.trajectory.v[0]).max()
        assert np.abs(momentum - momentum[0]).max() <= 1e-12 * scale


def test_a_comparison_of_engines_needs_completed_runs(runs):
    data: RunData = runs("wall_impact", "builtin")["linear"]
    assert data.result.status == "completed"
    assert data.result.cpu_seconds > 0.0
