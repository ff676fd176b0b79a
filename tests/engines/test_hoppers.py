"""The shipped hoppers, smaller, on the real solver: against published numbers, and what must hold exactly.

Sources and tolerances: `expected.json` and `README.md` of each case.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kncal.core.shipped import folder
from kncal.engines.registry import engine_for
from kncal.observe.compare import compare
from kncal.observe.run_data import RunData
from kncal.runs.workflow import complete, load, require_completed, run_case
from kncal.scene.case_file import load_case
from kncal.scene.model import KINDS

pytestmark = pytest.mark.solver


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory):
    """case, overrides -> {kind: RunData}, each run once."""
    root = tmp_path_factory.mktemp("runs")

    @cache
    def run(case: str, *overrides: str) -> dict[str, RunData]:
        scene = load_case(case, overrides=overrides)
        out: Path = root / f"{case}-{len(overrides)}-{abs(hash(overrides))}"
        require_completed(run_case(scene, engine_for(scene), out).values())
        return {kind: complete(load(out / kind)) for kind in KINDS}

    return run


SMALL = ("particles.beads.count=1500", "run.until_time=0.25")


@pytest.mark.parametrize("case", [pytest.param("hopper", marks=pytest.mark.long), "hopper_flat"])
def test_hoppers_flow_as_published_and_lose_nothing(case: str, runs) -> None:
    """Beverloo's law within the range of its constants; what is inside and what passed is what was there, always."""
    expected = json.loads((folder("cases") / case / "expected.json").read_text("utf-8"))["metrics"]
    both = runs(case, *SMALL)
    for kind, data in both.items():
        series = data.series
        assert np.array_equal(series.number + series.out_number.sum(axis=1), np.full(len(series.t), 1500.0))
        assert series.mass + series.out_mass.sum(axis=1) == pytest.approx(series.mass[0], rel=1e-9)
        flow, entry = data.estimate("mass_flow"), expected[kind]["mass_flow"]
        assert abs(flow.value - entry["value"]) < entry["rel_tol"] * entry["value"] + flow.width
    row = next(row for row in compare(both["linear"], both["hertz"]).rows if row.metric == "mass_flow")
    assert row.verdict != "outside", row
