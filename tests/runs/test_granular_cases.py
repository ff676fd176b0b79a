"""The shipped cases of many particles without gas on the real LIGGGHTS, both models, against their expected.json."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import pytest
from shipped import GRANULAR

from kncal.core.shipped import folder
from kncal.engines.registry import engine_for
from kncal.observe.run_data import RunData
from kncal.runs.workflow import complete, load, require_completed, run_case
from kncal.scene.case_file import load_case

pytestmark = pytest.mark.solver

#: Smaller ones, of a few CPU seconds: case -> what is changed, and which expected values still hold.
SMALL: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "heap": (
        (
            "particles.beads.count=330",
            "particles.beads.region.high=[0.06, 0.025, 0.1]",
            "walls.floor.edge_1=[0.065, 0.0, 0.0]",
            "walls.lip.corner=[0.06, 0.0, 0.0]",
            "walls.gate.corner=[0.06, 0.0, 0.004]",
            "run.until_time=1.5",
        ),
        ("angle_of_repose", "support"),
    ),
    "silo": (
        ("particles.beads.count=600", "walls.floor.motion.0.stop=0.15", "run.until_time=0.4"),
        ("support", "janssen_k_mu"),
    ),
}


def runs_of(name: str, out: Path, *sets: str) -> dict[str, RunData]:
    scene = load_case(name, overrides=sets)
    require_completed(run_case(scene, engine_for(scene), out).values())
    return {kind: complete(load(out / kind)) for kind in ("linear", "hertz")}


def check_expected(name: str, runs: Mapping[str, RunData], only: tuple[str, ...] = ()) -> None:
    """Each expected value holds, but for what the run itself says that it is uncertain by."""
    expected = json.loads((folder("cases") / name / "expected.json").read_text(encoding="utf-8"))["metrics"]
    for kind, metrics in expected.items():
        for metric in only or metrics:
            found, item = runs[kind].estimate(metric), metrics[metric]
            assert found.value is not None, (kind, metric, found.why)
            allowed = item["rel_tol"] * item["value"] + (found.width or 0.0)
            assert found.value == pytest.approx(item["value"], abs=allowed), (kind, metric)


@pytest.mark.parametrize("name", SMALL)
def test_small(name: str, tmp_path: Path) -> None:
    sets, only = SMALL[name]
    check_expected(name, runs_of(name, tmp_path / "run", *sets), only)


@pytest.mark.long
@pytest.mark.parametrize("name", GRANULAR)
def test_as_shipped(name: str, tmp_path: Path) -> None:
    check_expected(name, runs_of(name, tmp_path / "run"))
