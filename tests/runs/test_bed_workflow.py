"""A bed from its case to the report, on the real solvers: both transports, stop and resume, the command line."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kncal.core.errors import CaseFileError
from kncal.engines.checkpoint import last_checkpoint
from kncal.engines.coupled import Coupled
from kncal.engines.dpmfoam.adapter_build import find
from kncal.record.series import BedSeries, read_series
from kncal.runs.solving import plan_checked
from kncal.runs.workflow import load, run_case
from kncal.scene.case_file import dump_case, load_case
from kncal.scene.plan import plan
from kncal.scene.scene import Scene

pytestmark = pytest.mark.solver

#: Eleven couplings.
END = 0.005
NUMBERS = ("p_in", "drag_z", "floor", "z_mean", "kinetic_energy", "overlap_max", "momentum_z")  # of every coupling


def mini(end_time: float = END, count: int = 400) -> Scene:
    """The shipped mini bed with fewer particles and less time; a loose lattice needs no settling."""
    scene = load_case("bubbling_bed_mini")
    scene = scene.with_group(count=count, place="lattice")
    return replace(scene, run=replace(scene.run, until_time=end_time), tolerances={})


def numbers(series: BedSeries) -> np.ndarray:
    impacts = [array.reshape(len(series.t), -1).T for array in (series.impacts, series.impact_sums)]
    return np.vstack([*(getattr(series, name) for name in NUMBERS), series.watched, *impacts])


def ctrl_c_at(coupling: int) -> Callable[[int, int], None]:
    def progress(done: int, _: int) -> None:
        if done == coupling:
            raise KeyboardInterrupt

    return progress


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Both models of a short bed, by the live transport where it is built."""
    out = tmp_path_factory.mktemp("bed") / "run"
    results = run_case(mini(), Coupled(), out)
    assert [r.status for r in results.values()] == ["completed", "completed"], results
    return out


def test_run_keeps_its_invariants(whole):
    for kind in ("linear", "hertz"):
        data = load(whole / kind)
        series = data.series
        assert len(series.t) == data.model.couplings
        assert series.reaction_error.max() <= 1e-10
        assert series.not_passed.max() <= 1e-3
        assert np.abs(series.solids_error).max() < 1e-12
        assert data.result.extra["transport"] == ("restart" if find() is None else "live")


def test_both_models_start_from_the_same_packing(whole):
    one, two = (np.load(whole / kind / "positions.npy", allow_pickle=False) for kind in ("linear", "hertz"))
    assert np.array_equal(one, two)


def test_transports_give_the_same_numbers(whole, tmp_path):
    if find() is None:
        pytest.skip("the adapter of the live transport is not built: kncal adapter build")
    run_case(mini(), Coupled("restart"), tmp_path / "restart", ("linear",))
    live, restart = (read_series(folder / "linear" / "series") for folder in (whole, tmp_path / "restart"))
    assert np.array_equal(numbers(live), numbers(restart))


def test_a_run_that_was_stopped_goes_on_as_if_it_had_not_been(whole, tmp_path, monkeypatch):
    # A checkpoint after every coupling, then a stop: what comes after must be what an undisturbed run gives.
    monkeypatch.setattr("kncal.engines.drive.CHECKPOINT_SECONDS", 0.0)
    scene, out = mini(), tmp_path / "stopped"
    results = run_case(scene, Coupled("restart"), out, ("linear",), progress_for=lambda _: ctrl_c_at(4))
    assert results["linear"].status == "interrupted"
    stopped = len(read_series(out / "linear" / "series").t)
    assert 4 <= stopped < plan(scene)["linear"].couplings
    monkeypatch.setattr("kncal.engines.drive.CHECKPOINT_SECONDS", 1e9)
    said: list[str] = []
    results = run_case(scene, Coupled("restart"), out, ("linear",), tell=said.append)
    assert results["linear"].status == "completed"
    # Ctrl-C came before the checkpoint of the last coupling in the series
    assert f"resumes: it ended as interrupted; from coupling {stopped - 1} of" in said[0]
    assert results["linear"].extra["couplings"] == plan(scene)["linear"].couplings  # of both parts, as the cost is
    one, two = (numbers(read_series(folder / "linear" / "series")) for folder in (out, whole))
    # Saving sums forces in another order, a relative 1e-16 per step, which contacts amplify.
    scale = np.abs(two).max(axis=1, keepdims=True)
    assert np.abs(one - two).max() <= 1e-7 * scale.max()
    assert np.allclose(one, two, rtol=1e-6, atol=1e-9 * scale)


def test_a_completed_bed_is_not_run_again_and_another_case_is_not_mixed_with_it(whole, tmp_path):
    out = tmp_path / "copy"
    shutil.copytree(whole, out)
    said: list[str] = []
    first = run_case(mini(), Coupled(), out, tell=said.append)
    assert [text.split(":")[0] for text in said] == ["linear not run again", "hertz not run again"]
    assert [r.status for r in first.values()] == ["completed", "completed"]
    assert not (out / "attempt-1").exists()
    run_case(mini(0.0015), Coupled(), out, ("linear",))
    assert len(read_series(out / "attempt-1" / "linear" / "series").t) > len(read_series(out / "linear" / "series").t)
    assert not (out / "hertz").exists()


def test_a_completed_bed_whose_series_was_damaged_runs_anew(whole, tmp_path):
    out = tmp_path / "copy"
    shutil.copytree(whole, out)
    piece = next((out / "linear" / "series").glob("piece-*.npz"))
    piece.write_bytes(piece.read_bytes()[:-10])
    said: list[str] = []
    run_case(mini(), Coupled(), out, ("linear",), tell=said.append)
    assert said[0].startswith("linear runs again")
    assert "changed since the run ended" in said[0]
    assert np.array_equal(
        numbers(read_series(out / "linear" / "series")), numbers(read_series(whole / "linear" / "series"))
    )


@pytest.mark.parametrize("damage", ["gas/p", "particles/particles.restart", "checkpoint.json"])
def test_a_checkpoint_that_a_power_cut_left_in_pieces_is_not_gone_on_with(tmp_path, damage):
    scene, out = mini(), tmp_path / "run"
    assert run_case(scene, Coupled("restart"), out, ("linear",), timeout=0.5)["linear"].status == "timed_out"
    checkpoint = last_checkpoint(out / "linear")
    assert checkpoint is not None
    assert checkpoint.cost["couplings"] == checkpoint.coupling
    (checkpoint.path / damage).write_bytes(b"")
    assert last_checkpoint(out / "linear") is None
    said: list[str] = []
    result = run_case(scene, Coupled(), out, ("linear",), tell=said.append)["linear"]
    assert result.status == "completed"
    assert said[0].startswith("linear runs again")


def test_a_checkpoint_of_a_coupling_that_was_not_computed_is_not_gone_on_with(tmp_path):
    """Its name and its record agree, its files are whole, but the series ends before it."""
    scene, out = mini(), tmp_path / "run"
    assert run_case(scene, Coupled("restart"), out, ("linear",), timeout=0.5)["linear"].status == "timed_out"
    checkpoint = last_checkpoint(out / "linear")
    end = plan(scene, ("linear",))["linear"].couplings
    assert checkpoint is not None and checkpoint.coupling < end
    record = json.loads((checkpoint.path / "checkpoint.json").read_text())
    (checkpoint.path / "checkpoint.json").write_text(json.dumps(record | {"coupling": end}))
    checkpoint.path.rename(out / "linear" / f"checkpoint-{end}")
    said: list[str] = []
    result = run_case(scene, Coupled(), out, ("linear",), tell=said.append)["linear"]
    assert said[0].startswith("linear runs again")
    assert result.status == "completed"
    assert len(read_series(out / "linear" / "series").t) == end


@pytest.mark.parametrize("transport", ["live", "restart"])
def test_the_solvers_of_a_bed_own_its_folder(tmp_path, transport):
    """They inherit the lock: an orphan would still keep others out."""
    if transport == "live" and find() is None:
        pytest.skip("the adapter of the live transport is not built: kncal adapter build")
    out, holders = tmp_path / "run", set()

    def look(done: int, _: int) -> None:
        for link in Path("/proc").glob("[0-9]*/fd/*"):
            try:
                if link.readlink() == out / ".lock" and int(link.parts[2]) != os.getpid():
                    holders.add((link.parents[1] / "comm").read_text().strip())
            except OSError:
                continue  # it has ended, or is not ours

    run_case(mini(0.002), Coupled(transport), out, ("linear",), progress_for=lambda _: look)
    assert any(name.startswith("python") for name in holders)  # LIGGGHTS' library lives in one
    assert transport == "restart" or "DPMFoam" in holders  # a restarted one has ended when we look


def test_impossible_beds_are_refused_before_anything_is_written(tmp_path):
    scene = mini()
    small = replace(scene, gas=replace(scene.gas, cells=(40, 8, 120)))
    with pytest.raises(CaseFileError, match="cell"):
        plan_checked(small, ("linear",))
    with pytest.raises(CaseFileError):
        run_case(small, Coupled("restart"), tmp_path / "no")
    assert not (tmp_path / "no").exists()


def test_a_killed_gas_solver_is_a_failed_run_and_leaves_nothing(tmp_path):
    if find() is None:
        pytest.skip("the adapter of the live transport is not built: kncal adapter build")
    scene = mini(1.0)
    folder = tmp_path / "linear"
    folder.mkdir()
    killed: list[int] = []

    def kill(done: int, _: int) -> None:
        if done == 3:
            for pid in _children("DPMFoam"):
                os.kill(pid, signal.SIGKILL)
                killed.append(pid)

    from kncal.scene.placement import Start, lattice

    before = _children("python")
    started = time.monotonic()
    result = Coupled("live").run(plan(scene)["linear"], folder, start=Start.at(lattice(scene)), progress=kill)
    assert killed
    assert result.status == "failed"
    assert "DPMFoam" in result.message
    assert time.monotonic() - started < 60.0
    assert _children("DPMFoam") == []
    assert _children("python") == before


def test_what_closing_says_does_not_hide_why_a_run_ended(tmp_path):
    """DPMFoam is killed and Ctrl-C comes: closing a dead solver is an error of its own, but the run was interrupted."""
    if find() is None:
        pytest.skip("the adapter of the live transport is not built: kncal adapter build")
    from kncal.scene.placement import Start, lattice

    scene, folder = mini(1.0), tmp_path / "linear"
    folder.mkdir()
    before = _children("python")

    def kill_and_interrupt(done: int, _: int) -> None:
        for pid in _children("DPMFoam"):
            os.kill(pid, signal.SIGKILL)
        raise KeyboardInterrupt

    result = Coupled("live").run(
        plan(scene)["linear"], folder, start=Start.at(lattice(scene)), progress=kill_and_interrupt
    )
    assert (result.status, result.failure) == ("interrupted", "")
    assert _children("DPMFoam") == []
    assert _children("python") == before


def test_the_command_line_compares_a_bed(tmp_path):
    case = tmp_path / "case.toml"
    case.write_text(dump_case(mini()))
    command = [sys.executable, "-m", "kncal", "compare", str(case), "--out", str(tmp_path / "out"), "--json"]
    transport = "restart" if find() is None else "live"
    command += ["--transport", transport, "--set", "run.discard=0.0"]  # ten couplings are the least
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1), done.stderr
    data = json.loads(done.stdout)
    assert Path(data["report"]).is_file()
    assert (tmp_path / "out" / "linear" / "series.csv").is_file()


def _children(name: str) -> list[int]:
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            before, after = path.read_text().rsplit(")", 1)
        except OSError:
            continue
        state, parent = after.split()[:2]
        if int(parent) == os.getpid() and name in before and state != "Z":
            found.append(int(path.parent.name))
    return found


def test_gas_alone_flows_as_a_plug_and_weighs_nothing(tmp_path):
    import pyvista

    from kncal.record.paraview import write_paraview

    scene = mini(0.004, count=0)
    scene = replace(scene, run=replace(scene.run, frames_every=0.002))
    results = run_case(scene, Coupled(), tmp_path / "run", ("linear",))
    assert results["linear"].status == "completed"
    series = load(tmp_path / "run" / "linear").series
    assert len(series.t_frame) == 2
    assert np.all(series.eps_g == 1.0)
    np.testing.assert_allclose(series.U[-1][..., 2], scene.gas.U_0, rtol=1e-5)  # solver tolerance
    assert not series.weight.any()
    assert not series.drag_z.any()
    assert np.isnan(series.z_mean).all()
    frames = pyvista.get_reader(write_paraview(series, tmp_path / "paraview"))
    frames.set_active_time_point(1)
    particles, gas = frames.read()
    assert particles.n_points == 0
    assert gas.n_cells == np.prod(scene.gas.cells)
