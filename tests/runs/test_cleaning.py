"""`kncal clean` frees what nobody needs, and nothing else; `kncal status` says what is true."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from kncal.core.errors import ReadError, RenderError
from kncal.core.lock import locked, sign
from kncal.engines.builtin import Builtin
from kncal.record.outcome import FAILURES
from kncal.runs.cleaning import clean, plan_cleaning
from kncal.runs.records import RESULT
from kncal.runs.states import ADVICE, STATES, case_states, run_state
from kncal.runs.workflow import run_case
from kncal.scene.case_file import load_case

pytestmark = pytest.mark.slow

SCENE = load_case("wall_impact")


@pytest.fixture
def twice(tmp_path: Path) -> Path:
    out = tmp_path / "runs" / "impact"
    for _ in range(2):
        run_case(SCENE, Builtin(), out, rerun=True)
    return out


def kncal(*arguments: object, **options) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "kncal", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL, **options)


def test_attempts_go_and_results_stay(twice: Path) -> None:
    removals, left = plan_cleaning(twice.parent)
    assert [r.path for r in removals] == [twice / "attempt-1"]
    assert left == ()
    size = sum(p.lstat().st_size for p in (twice / "attempt-1").rglob("*") if p.name != ".lock")
    assert clean(removals) == (size, ())
    assert not (twice / "attempt-1").exists()
    assert [s.status for s in case_states(twice)] == ["completed", "completed"]
    assert plan_cleaning(twice.parent) == ((), ())


def test_a_folder_in_use_is_left_alone(twice: Path) -> None:
    removals, _ = plan_cleaning(twice)
    with locked(twice) as descriptor:
        sign(descriptor)
        planned, left = plan_cleaning(twice)
        assert planned == ()
        assert f"in use by pid {os.getpid()}" in left[0]
        freed, held = clean(removals)  # planned before the run began
        assert freed == 0
        assert len(held) == 1
    assert (twice / "attempt-1").is_dir()


def test_links_are_not_followed(twice: Path, tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "thesis.txt").write_text("x")
    (twice / "attempt-2").symlink_to(precious)
    (twice / "attempt-1" / "more").symlink_to(precious)
    clean(plan_cleaning(twice)[0])
    assert (precious / "thesis.txt").read_text() == "x"


@pytest.fixture
def worked(twice: Path) -> Path:
    """A run folder whose model has, as a bed's has, a series and the folders in which solvers worked."""
    for name in ("series", "gas", "particles"):
        (twice / "linear" / name).mkdir()
        (twice / "linear" / name / "log.solver").write_text("x")
    return twice


def test_working_folders_of_a_completed_run_go(worked: Path) -> None:
    assert {r.path.name for r in plan_cleaning(worked)[0]} == {"attempt-1", "gas", "particles"}
    assert clean(plan_cleaning(worked)[0])[1] == ()
    assert not (worked / "linear" / "gas").exists()
    assert (worked / "linear" / "series" / "log.solver").is_file()


@pytest.mark.parametrize("link", ["model", "run"])
def test_a_link_to_a_run_elsewhere_is_left_alone(worked: Path, tmp_path: Path, link: str) -> None:
    elsewhere = tmp_path / "elsewhere"
    if link == "model":
        shutil.move(worked / "linear", elsewhere)
        (worked / "linear").symlink_to(elsewhere)
        gas = elsewhere / "gas"
    else:
        shutil.move(worked, elsewhere)
        worked.symlink_to(elsewhere)
        gas = elsewhere / "linear" / "gas"
    for root in (worked.parent, worked):
        removals, _ = plan_cleaning(root)
        assert not [r for r in removals if r.path.name == "gas"]
        clean(removals)
    assert (gas / "log.solver").is_file()


def test_a_model_that_became_a_link_since_is_left_alone(worked: Path, tmp_path: Path) -> None:
    removals, _ = plan_cleaning(worked)
    shutil.move(worked / "linear", tmp_path / "elsewhere")
    (worked / "linear").symlink_to(tmp_path / "elsewhere")
    clean(removals)
    assert (tmp_path / "elsewhere" / "gas").is_dir()


@pytest.mark.parametrize("gone", ["attempt-1", "linear/gas", "linear", "."])
def test_what_has_gone_since_is_no_error(worked: Path, gone: str) -> None:
    removals, _ = plan_cleaning(worked)
    sizes = {r.path: r.size for r in removals}
    shutil.rmtree(worked / gone)
    there = [path for path in sizes if path.exists()]
    freed, left = clean(removals)
    assert freed == sum(sizes[path] for path in there)
    assert left == ()
    assert not [path for path in sizes if path.exists()]


@pytest.mark.parametrize("since", ["started", "interrupted"])
def test_a_run_that_began_and_stopped_since_keeps_what_it_goes_on_from(worked: Path, since: str) -> None:
    removals, _ = plan_cleaning(worked)
    record = worked / "linear" / RESULT
    if since == "started":  # and killed before its end
        record.unlink()
    else:
        record.write_text(json.dumps(json.loads(record.read_text()) | {"status": "interrupted"}))
    _, left = clean(removals)
    assert (worked / "linear" / "gas").is_dir()
    assert (worked / "linear" / "particles").is_dir()
    assert not (worked / "attempt-1").exists()
    assert len(left) == 1
    assert str(worked / "linear") in left[0]


def test_folders_that_are_not_kncals_are_not_touched(tmp_path: Path) -> None:
    (tmp_path / "attempt-1").mkdir()
    (tmp_path / "x" / "checkpoint-3").mkdir(parents=True)
    assert plan_cleaning(tmp_path) == ((), ())
    with pytest.raises(ReadError, match="not a folder"):
        plan_cleaning(tmp_path / "no")


def snapshot(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("*")}


@pytest.mark.parametrize(
    "manifest",
    ["{}", '{"name": "app", "icons": []}', "x", None, '{"kncal": 1, "case": "x", "case_sha256": "", "a": 1}'],
)
def test_a_strangers_manifest_makes_no_run_folder(tmp_path: Path, manifest: str | None) -> None:
    """A web page has a manifest.json too; neither is it cleaned, nor moved aside by a run."""
    web = tmp_path / "web"
    for name in ("linear", "attempt-at-novel", "attempt-1"):
        (web / name).mkdir(parents=True)
        (web / name / "ch1.txt").write_text("x")
    if manifest is not None:
        (web / "manifest.json").write_text(manifest)
    before = snapshot(tmp_path)
    assert plan_cleaning(tmp_path) == ((), ())
    with pytest.raises(RenderError, match="--out"):
        run_case(SCENE, Builtin(), web)
    assert snapshot(tmp_path) == before


OWN = ["attempt-mine", "attempt-01", "attempt-2", "linear/gas-photos", "linear/particles-thesis", "linear/gas-7"]


def test_what_a_user_put_into_a_run_folder_stays(worked: Path) -> None:
    """Folders like kncal's by their name, and a note in an attempt; also when the run is done anew."""
    (worked / "linear" / "checkpoint-3").mkdir()
    (worked / "linear" / "checkpoint-3" / "checkpoint.json").write_text("{}")
    own = [*OWN, "linear/checkpoint-mine"]
    for name in own:
        (worked / name).mkdir()
        (worked / name / "mine.txt").write_text("x")
    removals, left = plan_cleaning(worked)
    assert {r.path.name for r in removals} == {"attempt-1", "gas", "particles", "checkpoint-3"}
    assert left == ()
    clean(removals)
    assert all((worked / name / "mine.txt").is_file() for name in own)
    (worked / "thesis.txt").write_text("x")
    run_case(SCENE, Builtin(), worked, rerun=True)
    assert (worked / "thesis.txt").is_file()
    assert (worked / "attempt-mine" / "mine.txt").is_file()
    (worked / "attempt-1" / "notes.txt").write_text("x")
    removals, left = plan_cleaning(worked)
    assert removals == ()
    assert len(left) == 1 and "notes.txt" in left[0]


def test_what_killed_starts_left_can_be_removed(twice: Path) -> None:
    """Killed while the earlier run was moved aside: attempts, the lock, and not yet a model."""
    for kind in ("linear", "hertz"):
        shutil.rmtree(twice / kind)
    whole = shutil.copytree(twice / "attempt-1", twice / "attempt-2")
    (whole / "manifest.json").unlink()
    shutil.rmtree(whole / "hertz")
    (whole / "linear" / RESULT).unlink()
    removals, _ = plan_cleaning(twice.parent)
    assert {r.path.name for r in removals} == {"attempt-1", "attempt-2"}
    (twice / "manifest.json").unlink()
    (twice / "case.toml").unlink()
    removals, _ = plan_cleaning(twice.parent)
    assert {r.path.name for r in removals} == {"attempt-1", "attempt-2"}
    clean(removals)
    assert not list(twice.glob("attempt-*"))


def test_the_command_asks(twice: Path) -> None:
    asked = kncal("clean", twice)
    assert asked.returncode == 2
    assert "--yes" in asked.stderr
    assert (twice / "attempt-1").is_dir()
    done = kncal("clean", twice, "--yes")
    assert done.returncode == 0, done.stderr
    assert not (twice / "attempt-1").exists()


def test_status_names_the_failure_and_the_remedy(twice: Path) -> None:
    data = json.loads((twice / "hertz" / RESULT).read_text())
    data |= {"status": "failed", "failure": "lost-particles", "message": "particles left the domain"}
    (twice / "hertz" / RESULT).write_text(json.dumps(data))
    text = kncal("status", twice.parent).stdout
    assert "1 completed, 1 failed" in text
    assert "failed (lost-particles)" in text
    assert "particles left the domain" in text
    assert ADVICE["lost-particles"] in text
    states = json.loads(kncal("status", twice.parent, "--json").stdout)
    assert [(s["model"], s["status"]) for s in states] == [("linear", "completed"), ("hertz", "failed")]


def test_status_has_advice_for_a_failure_that_this_kncal_does_not_know(twice: Path) -> None:
    """As from a later kncal, or by hand; and a failure without a name."""
    for kind, failure in (("linear", "melted"), ("hertz", "")):
        data = json.loads((twice / kind / RESULT).read_text())
        data |= {"status": "failed", "failure": failure, "message": "it is gone"}
        (twice / kind / RESULT).write_text(json.dumps(data))
    done = kncal("status", twice.parent)
    assert done.returncode == 0, done.stderr
    assert "failed (melted)" in done.stdout
    assert done.stdout.count("what to do: ") == 2


def test_a_running_run_is_seen_with_its_owner(twice: Path) -> None:
    (twice / "hertz" / RESULT).unlink()
    with locked(twice) as descriptor:
        sign(descriptor)
        state = run_state(twice / "hertz")
    assert state.status == "running"
    assert f"pid {os.getpid()}" in state.owner


def test_there_is_advice_for_every_end_that_is_no_success() -> None:
    bad = {*FAILURES, *STATES} - {"rendered", "running", "completed", "failed"}
    assert set(ADVICE) == bad


@pytest.mark.parametrize("command", ["trade", "trim", "stability"])
def test_the_folder_of_many_runs_is_told_from_that_of_a_case(twice: Path, tmp_path: Path, command: str) -> None:
    """Its runs are found inside; a report of two models is not what it holds."""
    out = tmp_path / "many"
    (out / "runs").mkdir(parents=True)
    twice.rename(out / "runs" / "round-1")
    (out / f"{command}.json").write_text("{}")
    seen = kncal("status", out)
    assert f"made by kncal {command}" in seen.stdout and "2 completed" in seen.stdout
    refused = kncal("report", out)
    assert refused.returncode == 2 and f"made by kncal {command}" in refused.stderr
