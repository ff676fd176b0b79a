"""A coupled run that is killed goes on where it was: nothing left running, nothing lost, nothing doubled."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from granular import HEAD, RAIN

from kncal.engines.checkpoint import last_checkpoint
from kncal.engines.coupled import Coupled
from kncal.engines.dpmfoam.adapter_build import find
from kncal.engines.registry import engine_for
from kncal.record.series import read_series
from kncal.runs.states import run_state
from kncal.runs.workflow import run_case
from kncal.scene.case_file import dump_case, load_case
from kncal.scene.scene import Scene

pytestmark = pytest.mark.solver

#: Makes a checkpoint every tenth of a second and runs the case; to be killed.
PROGRAM = """
import sys
from pathlib import Path
import kncal.engines.drive
from kncal.engines.coupled import Coupled
from kncal.runs.workflow import run_case
from kncal.scene.case_file import load_case

kncal.engines.drive.CHECKPOINT_SECONDS = 0.1
run_case(load_case(sys.argv[1]), Coupled(sys.argv[3]), Path(sys.argv[2]), ("linear",))
"""
NUMBERS = ("t", "p_in", "drag_z", "floor", "z_mean", "kinetic_energy", "overlap_max", "momentum_z")


def bed() -> Scene:
    scene = load_case("bubbling_bed_mini").with_group(count=400, place="lattice")
    return replace(scene, run=replace(scene.run, until_time=0.04), tolerances={})


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The series of a run that nothing happens to."""
    out = tmp_path_factory.mktemp("undisturbed") / "run"
    assert run_case(bed(), Coupled(), out, ("linear",))["linear"].status == "completed"
    return read_series(out / "linear" / "series")


@pytest.mark.parametrize("seed", [1, 2])
def test_a_run_killed_at_a_random_coupling_resumes(undisturbed, tmp_path: Path, seed: int) -> None:
    transport = "live" if find() is not None else "restart"
    case, out = tmp_path / "case.toml", tmp_path / "run"
    case.write_text(dump_case(bed()), encoding="utf-8")
    stop_at = int(np.random.default_rng(seed).integers(5, len(undisturbed.t) - 5))
    process = subprocess.Popen([sys.executable, "-c", PROGRAM, str(case), str(out), transport], start_new_session=True)
    deadline = time.monotonic() + 120.0
    while _saved(out / "linear") < stop_at:
        assert process.poll() is None, "the run ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)  # kncal itself, not its solvers: they must end by themselves
    process.wait()
    while (left := _using(out)) or run_state(out / "linear").status == "running":  # the lock ends just after its holder
        assert time.monotonic() < deadline, left
        time.sleep(0.05)
    state = run_state(out / "linear")
    assert (state.status, state.failure) == ("failed", "killed")

    scene = replace(bed(), name=load_case(str(case)).name)
    said: list[str] = []
    results = run_case(scene, Coupled(transport), out, ("linear",), tell=said.append)
    assert results["linear"].status == "completed"
    assert "resumes: it has no end" in said[0]
    series = read_series(out / "linear" / "series")
    np.testing.assert_array_equal(series.coupling, undisturbed.coupling)
    for name in NUMBERS:
        one, two = getattr(series, name), getattr(undisturbed, name)
        # Saving brings LIGGGHTS' sums into another order: 1e-16 per step, which contacts amplify.
        np.testing.assert_allclose(one, two, rtol=1e-6, atol=1e-7 * np.abs(two).max(), err_msg=name)


def test_a_stream_killed_between_walls_that_move_resumes(tmp_path: Path) -> None:
    """Of particles that come and go none is lost or doubled, and each goes on where it was."""
    case = tmp_path / "case.toml"
    case.write_text(HEAD + RAIN, encoding="utf-8")
    scene = load_case(str(case))
    first, out = tmp_path / "first", tmp_path / "run"
    assert run_case(scene, engine_for(scene), first, ("linear",))["linear"].status == "completed"
    process = subprocess.Popen([sys.executable, "-c", PROGRAM, str(case), str(out), "auto"], start_new_session=True)
    deadline = time.monotonic() + 120.0
    while _saved(out / "linear") < 25:
        assert process.poll() is None, "the run ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    while _using(out) or run_state(out / "linear").status == "running":
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert run_case(scene, engine_for(scene), out, ("linear",))["linear"].status == "completed"
    one, two = (read_series(folder / "linear" / "series") for folder in (first, out))
    np.testing.assert_array_equal(one.coupling, two.coupling)
    for series in (one, two):
        mass = np.array(series.facts.masses)[0]
        come = np.minimum(120, np.round(0.04 * series.t / mass))
        assert series.number + series.out_number[:, 1] == pytest.approx(3 + come, abs=1)
        assert (np.diff(series.out_number, axis=0) >= 0).all()
    early = one.t_frame < 0.1  # before contacts have made rounding visible
    assert early.sum() > 3
    for frame in np.flatnonzero(early):
        np.testing.assert_allclose(two.x[frame], one.x[frame], rtol=0.0, atol=1e-6)
        np.testing.assert_array_equal(two.kind[frame], one.kind[frame])


def test_ctrl_c_loses_no_coupling(undisturbed, tmp_path: Path) -> None:
    """Without any checkpoint in time, the run stops after a whole coupling, saves it, and goes on from there."""
    case, out = tmp_path / "case.toml", tmp_path / "run"
    case.write_text(dump_case(bed()), encoding="utf-8")
    transport = "live" if find() is not None else "restart"
    arguments = ["run", str(case), "--model", "linear", "--out", str(out), "--transport", transport]
    command = ["env", "--default-signal=INT", sys.executable, "-m", "kncal", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, process_group=0)
    try:
        deadline = time.monotonic() + 120.0
        while not (out / "linear" / "series" / "facts.json").exists():
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=60)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    assert process.returncode == 130, err
    state = run_state(out / "linear")
    assert state.status == "interrupted"
    stopped = _saved(out / "linear")
    assert 1 <= stopped < len(undisturbed.t)
    assert len(read_series(out / "linear" / "series").t) == stopped
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert f"resumes: it ended as interrupted; from coupling {stopped} of" in done.stderr
    series = read_series(out / "linear" / "series")
    np.testing.assert_array_equal(series.coupling, undisturbed.coupling)
    np.testing.assert_allclose(series.z_mean, undisturbed.z_mean, rtol=1e-6)


def _saved(folder: Path) -> int:
    """Couplings in the last checkpoint of a run that goes on."""
    found = last_checkpoint(folder)
    return 0 if found is None else found.coupling


def _using(folder: Path) -> list[str]:
    """Processes that work in ``folder``."""
    found = []
    for link in Path("/proc").glob("[0-9]*/cwd"):
        try:
            if link.readlink().is_relative_to(folder):
                found.append((link.parent / "comm").read_text().strip())
        except OSError:
            continue  # it has ended, or is not ours
    return found
