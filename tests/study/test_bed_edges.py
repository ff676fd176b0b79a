"""The scans of a bed on the real solvers: past the limits on purpose, kept when they have ended."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from kncal.scene.case_file import load_case
from kncal.study.stability import coupling_edges as edges

pytestmark = [
    pytest.mark.solver,
    pytest.mark.skipif(shutil.which("DPMFoam") is None, reason="OpenFOAM is not installed (apt-get install openfoam)"),
]


def test_a_coupling_of_a_relaxation_time_goes_wrong_and_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In four intervals of tau at 0.8 m/s of gas particles leave a bed of some mm: by tau g they gain 0.6 m/s each."""
    monkeypatch.setattr(edges, "COUNT", 200)
    monkeypatch.setattr(edges, "END_TIME", 0.005)
    monkeypatch.setattr(edges, "COURANT", (0.25,))
    monkeypatch.setattr(edges, "RELAXATION", (0.01, 1.0))
    monkeypatch.setattr(edges, "CELL", (2.5,))
    scene = load_case("bubbling_bed_mini")
    found = edges.bed_edges(scene, tmp_path)
    gas, coupling, cell = found
    assert [len(edge.runs) for edge in found] == [1, 2, 1]
    assert [edge.runs[0].level for edge in (coupling, cell)] == ["ok", "ok"]
    assert "courant" not in gas.runs[0].level
    fine, coarse = coupling.runs
    assert fine.outcome == "right"
    assert fine.numbers["solids_error"] < 1e-9
    assert coarse.outcome != "right"
    assert coarse.level.startswith("refuse")
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "runs").rglob("*")}
    assert edges.bed_edges(scene, tmp_path) == found
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "runs").rglob("*")} == before
