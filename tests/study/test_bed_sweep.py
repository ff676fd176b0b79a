"""Beds in a sweep: both limits and table are those of beds; a sweep that was stopped goes on inside its runs."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from kncal.core.errors import CaseFileError
from kncal.runs.workflow import load
from kncal.scene.case_file import dump_case, load_case
from kncal.study import Settings, ThreadExecutor, combine, design, grid_axis, read_sweep, run_sweep, sweep_status


@pytest.fixture
def bed(tmp_path: Path) -> Path:
    """A shallow bed on a lattice, for a hundredth of a second."""
    scene = load_case("bubbling_bed_mini")
    run = replace(scene.run, until_time=0.01, discard=0.0)
    small = scene.with_group(count=300, place="lattice")
    (tmp_path / "bed").mkdir()
    path = tmp_path / "bed" / "case.toml"
    path.write_text(dump_case(replace(small, run=run, tolerances={})), encoding="utf-8")
    return path


def designed(bed: Path, *axes: str):
    return design(bed, combine([grid_axis(text) for text in axes]), Settings())


def test_limits_of_beds_refuse_a_point(bed: Path) -> None:
    """A coupling interval beyond a fifth of the relaxation time is refused by the limits, not by the schema."""
    with pytest.raises(CaseFileError, match=r"run\.coupling = 0\.05") as error:
        designed(bed, "run.coupling=5e-4,0.05")
    assert "0.0005:" not in str(error.value)


@pytest.mark.solver
def test_a_stopped_sweep_of_beds_goes_on(bed: Path, tmp_path: Path) -> None:
    out = tmp_path / "sweep"
    made, text = designed(bed, "gas.U_0=0.6,0.8")
    executor = ThreadExecutor(2)

    def stop_soon() -> None:
        deadline = time.monotonic() + 120.0
        while time.monotonic() < deadline and len(list(out.glob("runs/*/linear/series/*"))) == 0:
            time.sleep(0.02)
        time.sleep(0.2)
        executor.stop()

    stopper = threading.Thread(target=stop_soon)
    stopper.start()
    first = run_sweep(made, text, out, executor)
    stopper.join()
    assert first.completed < 2
    assert set(first.failures) == {"interrupted"}
    begun = {path.parent.parent.name for path in out.glob("runs/*/linear/positions.npy")}

    second = run_sweep(made, text, out, ThreadExecutor(2))
    assert second.completed == 2
    assert dict(sweep_status(out).counts) == {"completed": 2}
    for run in made.runs:
        for kind in ("linear", "hertz"):
            data = load(out / "runs" / run / kind)
            assert len(data.series.t) == data.model.couplings  # each coupling once, before and after the stop
    assert begun
    # gone on with, not begun anew; a model that was stopped before its first coupling had nothing to go on from
    assert not list(out.glob("runs/*/attempt-*/*/series/*"))
    table = read_sweep(out)
    assert sorted(table["gas.U_0"]) == [0.6, 0.6, 0.8, 0.8]
    assert (table["pressure_drop"] > 0.0).all()
    assert (table["uncertainty.pressure_drop"] > 0.0).all()
    linear = table[table["model"] == "linear"]
    assert linear["difference.z_mean"].notna().all()
