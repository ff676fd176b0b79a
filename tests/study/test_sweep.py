"""A sweep keeps what is valid, runs the rest, hurts no run by another."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from sweeps import GRID, designed, results, swept

import kncal.study.execute
import kncal.study.table
from kncal.core.errors import InputError, RunError
from kncal.core.lock import locked, sign
from kncal.runs.workflow import load
from kncal.study import (
    Settings,
    read_design,
    read_sweep,
    sweep_status,
)
from kncal.study.design import physics_text

pytestmark = pytest.mark.slow

# --- identity ---------------------------------------------------------------------------------------------------------


def test_the_same_inputs_have_the_same_id_and_others_another(case: Path) -> None:
    ids = list(designed(case)[0].runs)
    assert len(set(ids)) == 4
    assert set(designed(case, *reversed(GRID))[0].runs) == set(ids)
    assert not set(designed(case, settings=Settings(engine="liggghts"))[0].runs) & set(ids)
    assert not set(designed(case, settings=Settings(engine="builtin", models=("linear",)))[0].runs) & set(ids)
    # neither a limit of time nor a title changes what comes out
    assert list(designed(case, settings=Settings(engine="builtin", timeout=60.0))[0].runs) == ids
    case.write_text(case.read_text().replace("A bead on a floor", "Another title"))
    assert list(designed(case)[0].runs) == ids
    case.write_text(case.read_text().replace("poisson = 0.25", "poisson = 0.26"))
    assert not set(designed(case)[0].runs) & set(ids)


def test_a_value_that_the_case_has_already_is_the_same_run_and_equal_points_are_one(case: Path) -> None:
    made, _ = designed(case, "run.steps_per_contact=20,20.0")
    assert len(made.runs) == 1
    assert list(made.runs) == list(designed(case, "contact.v_0=1.0")[0].runs)


def test_only_title_and_source_are_left_out_of_the_identity() -> None:
    text = 'title = "a"\nsource = "b"\ngravity = [0, 0, 0]\n\n[x]\ntitle = "c"\n'
    assert physics_text(text) == 'gravity = [0, 0, 0]\n\n[x]\ntitle = "c"\n'


# --- what is run ------------------------------------------------------------------------------------------------------


def test_each_run_is_an_ordinary_run_folder(folder: Path) -> None:
    for run in read_design(folder).runs:
        out = folder / "runs" / run
        assert load(out / "linear").model.scene.name == "bead"
        assert load(out / "hertz").result.status == "completed"


def test_the_same_sweep_again_runs_nothing(case: Path, folder: Path, monkeypatch) -> None:
    before = results(folder)
    monkeypatch.setattr(kncal.study.execute, "_run_case", lambda *_: pytest.fail("was run again"))
    again = swept(case, folder)
    assert (again.completed, again.kept) == (4, 4)
    assert results(folder) == before


def test_a_wider_sweep_runs_only_what_is_new(case: Path, folder: Path) -> None:
    before = results(folder)
    wider = swept(case, folder, "contact.v_0=0.5,1.0,2.0", "run.steps_per_contact=20,30")
    assert (wider.completed, wider.kept, wider.total) == (6, 4, 6)
    assert results(folder).items() > before.items()
    narrower = swept(case, folder, "contact.v_0=2.0", "run.steps_per_contact=20,30")
    assert (narrower.kept, narrower.total) == (2, 2)
    assert set(read_sweep(folder)["contact.v_0"]) == {2.0}


@pytest.mark.parametrize("damage", ["result", "frames", "record", "status", "case", "manifest", "folder"])
def test_a_damaged_run_is_run_again_and_no_other(case: Path, folder: Path, damage: str) -> None:
    before = results(folder)
    run = next(iter(read_design(folder).runs))
    out = folder / "runs" / run
    hertz = out / "hertz"
    if damage == "result":
        (hertz / "result.json").unlink()
    elif damage == "frames":
        (hertz / "particles.dump").write_text("")
    elif damage == "record":
        (hertz / "result.json").write_text('{"status": "completed"')
    elif damage == "status":
        text = (hertz / "result.json").read_text()
        (hertz / "result.json").write_text(text.replace('"completed"', '"interrupted"'))
    elif damage == "manifest":
        (hertz / "manifest.json").write_text("[5]")
    elif damage == "case":
        (out / "case.toml").write_text((out / "case.toml").read_text().replace("e_n = 0.9", "e_n = 0.8"))
    else:
        shutil.rmtree(out)
    again = swept(case, folder)
    assert (again.completed, again.kept) == (4, 3)
    after = results(folder)
    assert {name: data for name, data in after.items() if run not in name} == {
        name: data for name, data in before.items() if run not in name
    }
    assert after.keys() == before.keys()
    load(hertz)
    assert (out / "attempt-1").is_dir() is (damage != "folder")


@pytest.mark.parametrize("part", ["kncal", "engine", "ranks", "version", "sha256"])
def test_results_of_another_kncal_solver_or_number_of_ranks_are_made_anew(case: Path, folder: Path, part: str) -> None:
    """What `kncal run` would not take for this run's result, a sweep does not keep either."""
    before = results(folder)
    run = next(iter(read_design(folder).runs))
    manifest = folder / "runs" / run / "hertz" / "manifest.json"
    data = json.loads(manifest.read_text())
    was = json.loads(manifest.read_text())
    if part in data["solver"]:
        data["solver"][part] = "0" * 64
    else:
        data[part] = 2 if part == "ranks" else "liggghts" if part == "engine" else "0.0.1"
    manifest.write_text(json.dumps(data))
    again = swept(case, folder)
    assert (again.completed, again.kept) == (4, 3)
    assert {name for name, text in results(folder).items() if before[name] != text} == {
        f"runs/{run}/hertz/result.json"  # the linear one is still good
    }
    mended = json.loads(manifest.read_text())
    assert {key: mended[key] for key in ("kncal", "engine", "solver", "ranks")} == {
        key: was[key] for key in ("kncal", "engine", "solver", "ranks")
    }


def test_the_solver_is_asked_once_for_all_runs_that_are_kept(case: Path, folder: Path, monkeypatch) -> None:
    from kncal.engines.builtin import Builtin

    asked = []
    true_profile = Builtin.profile
    monkeypatch.setattr(Builtin, "profile", lambda self: asked.append(1) or true_profile(self))
    assert swept(case, folder).kept == 4
    assert len(asked) == 1


@pytest.mark.parametrize(
    ("error", "failure"),
    [
        (RuntimeError("boom"), "internal-error"),
        (OSError(28, "No space left on device"), "disk-full"),
        (MemoryError(), "out-of-memory"),
        (RecursionError("deep"), "internal-error"),
        (RunError("two left the box", "lost-particles"), "lost-particles"),
    ],
)
def test_an_error_in_one_run_is_the_failure_of_that_run(
    case: Path, tmp_path: Path, monkeypatch, error: Exception, failure: str
) -> None:
    folder = tmp_path / "sweep"
    victim = list(designed(case)[0].runs)[1]
    true_run = kncal.study.execute._run_case

    def run(sweep, scene, out):
        if out.name == victim:
            raise error
        true_run(sweep, scene, out)

    with monkeypatch.context() as patch:
        patch.setattr(kncal.study.execute, "_run_case", run)
        result = swept(case, folder)
    assert (result.completed, dict(result.failures)) == (3, {failure: (victim,)})
    table = read_sweep(folder).set_index("id")
    assert list(table.loc[victim, "class"]) == [failure, failure]
    assert set(table.drop(victim)["status"]) == {"completed"}
    status = sweep_status(folder)
    assert (dict(status.counts), dict(status.failures)) == ({"completed": 3, "failed": 1}, {failure: 1})
    assert status.newest[0].id == victim
    mended = swept(case, folder)
    assert (mended.completed, mended.kept) == (4, 3)


def test_a_run_that_times_out_is_told_and_tried_again(case: Path, tmp_path: Path) -> None:
    folder = tmp_path / "sweep"
    result = swept(case, folder, "contact.v_0=1.0", settings=Settings(engine="builtin", timeout=1e-9))
    assert result.completed == 0
    assert list(result.failures) == ["timed-out"]
    table = read_sweep(folder)
    assert list(table["status"]) == ["timed_out", "not_run"]
    assert swept(case, folder, "contact.v_0=1.0").completed == 1


def test_a_run_folder_that_is_taken_is_waited_for(case: Path, tmp_path: Path, monkeypatch) -> None:
    """As by a solver that a killed kncal left, which is just ending; one that stays is the failure of this run."""
    folder = tmp_path / "sweep"
    victim = next(iter(designed(case)[0].runs))
    out = folder / "runs" / victim
    out.mkdir(parents=True)
    (folder / ".lock").touch()
    monkeypatch.setattr(kncal.study.execute, "PATIENCE", 0.3)
    with locked(out):
        result = swept(case, folder)
    assert dict(result.failures) == {"in-use": (victim,)}
    assert result.completed == 3
    monkeypatch.setattr(kncal.study.execute, "PATIENCE", 60.0)
    with locked(out) as lock:
        holder = subprocess.Popen(["sleep", "1"], pass_fds=[lock])
    assert swept(case, folder).completed == 4
    assert holder.wait() == 0


# --- bad points -------------------------------------------------------------------------------------------------------


def test_a_bad_point_is_named_and_nothing_starts(case: Path, tmp_path: Path, kncal) -> None:
    out = tmp_path / "sweep"
    command = ("sweep", case, "--engine", "builtin", "--out", out, "--set", "contact.e_n=0.9,1.5,0.5")
    code, _, err = kncal(*command)
    assert code == 2
    assert "contact.e_n = 1.5" in err
    assert "contact.e_n = 0.5" not in err
    assert not out.exists()
    code, told, _ = kncal(*command, "--skip-bad")
    assert code == 3
    assert "skipped: contact.e_n = 1.5" in told
    assert set(read_sweep(out)["contact.e_n"]) == {0.9, 0.5}


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (("--set", "contact.kn=5"), "did you mean 'k_n'"),
        (("--set", "run.until_time=1e9"), "at most"),  # refused by the planning
        ((), "nothing to vary"),
        (("--sample", 3), "--range"),
        (("--range", "contact.v_0=1:2"), "--sample"),
        (("--sample", 3, "--range", "contact.v_0=1:2", "--log", "contact.e_n"), "no --range of that key"),
        (("--set", "contact.v_0=1", "--workers", 0), "workers"),
        (("--set", "contact.v_0=1", "--timeout", -1), "timeout"),
        (("--set", "contact.v_0=1", "--transport", "live"), "--transport"),
        (("--points", "/nowhere.csv"), "cannot be read"),
    ],
)
def test_bad_usage_is_2_and_leaves_nothing(case: Path, tmp_path: Path, kncal, flags, said: str) -> None:
    code, _, err = kncal("sweep", case, "--engine", "builtin", "--out", tmp_path / "sweep", *flags)
    assert code == 2
    assert said in err
    assert not (tmp_path / "sweep").exists()


@pytest.mark.parametrize("name", ["thesis.tex", "case.toml"])
def test_a_folder_that_is_not_a_sweep_s_is_left_alone(case: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / "mine" / "runs").mkdir(parents=True)
    (tmp_path / "mine" / name).write_text("x")
    with pytest.raises(InputError, match="holds files"):
        swept(case, tmp_path / "mine")
    assert {path.name for path in (tmp_path / "mine").iterdir()} == {name, "runs"}
    assert (tmp_path / "mine" / name).read_text() == "x"


@pytest.mark.parametrize("text", ["", "{}", '{"program": "train.py", "method": "grid"}'])
def test_a_stranger_s_design_is_not_written_over(case: Path, tmp_path: Path, text: str) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "sweep.json").write_text(text)
    (mine / "case.toml").write_text("x")
    with pytest.raises(InputError, match=r"sweep\.json"):
        swept(case, mine)
    assert {path.name: path.read_text() for path in mine.iterdir()} == {"sweep.json": text, "case.toml": "x"}


def test_a_start_that_was_killed_before_the_design_was_whole(case: Path, tmp_path: Path) -> None:
    folder = tmp_path / "sweep"
    (folder / "runs").mkdir(parents=True)
    for name in (".lock", "case.toml", ".sweep.json.x1.part"):
        (folder / name).write_text("")
    assert swept(case, folder).completed == 4


def test_two_sweeps_in_one_folder(case: Path, folder: Path, kncal) -> None:
    with locked(folder) as lock:
        sign(lock)
        code, _, err = kncal("sweep", case, "--engine", "builtin", "--out", folder, "--set", "contact.v_0=1")
        assert sweep_status(folder).owner.startswith(f"pid {os.getpid()} on ")
    assert code == 2
    assert f"in use by pid {os.getpid()}" in err
