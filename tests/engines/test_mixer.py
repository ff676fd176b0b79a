"""The shipped mixer, shorter, on the real solver: a blade mixes until all is as chance would have it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from kncal.core.shipped import folder
from kncal.engines.registry import engine_for
from kncal.observe.run_data import RunData
from kncal.runs.workflow import complete, load, require_completed, run_case
from kncal.scene.case_file import load_case
from kncal.scene.model import KINDS

pytestmark = [pytest.mark.solver, pytest.mark.long]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, RunData]:
    scene = load_case("mixer", overrides=("run.until_time=1.6", "run.frames_every=0.04"))
    out: Path = tmp_path_factory.mktemp("runs") / "mixer"
    require_completed(run_case(scene, engine_for(scene), out).values())
    return {kind: complete(load(out / kind)) for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
def test_a_blade_mixes_two_groups_until_they_are_as_chance_has_it(kind: str, runs) -> None:
    entry = json.loads((folder("cases") / "mixer" / "expected.json").read_text("utf-8"))["metrics"][kind][
        "mixing_index"
    ]
    seen = runs[kind].grains
    assert seen is not None
    curve = seen.mixing
    before = curve.lacey[curve.t < 0.1]
    assert np.ptp(before) < 0.05, "nothing moves before the blade"
    assert before.mean() < 0.3
    assert curve.lacey[-8:].mean() == pytest.approx(entry["value"], abs=entry["rel_tol"])
    assert seen.series.number == pytest.approx(600)


def test_the_walls_carry_what_is_stirred(runs) -> None:
    for data in runs.values():
        found = data.estimates["support"]
        assert abs(found.value - 1.0) < 2.0 * found.width
