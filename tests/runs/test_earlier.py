"""What is done about what an earlier start left: nothing is run twice, nothing is mixed, nothing is lost."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from kncal.engines.builtin import Builtin
from kncal.runs.folder import read_result
from kncal.runs.records import RESULT, STARTED
from kncal.runs.states import case_states, find_run_folders, run_state
from kncal.runs.workflow import render_case, run_case
from kncal.scene.case_file import load_case
from kncal.scene.model import KINDS

SCENE = load_case("wall_impact")


@pytest.fixture
def done(tmp_path: Path) -> Path:
    run_case(SCENE, Builtin(), tmp_path / "run")
    return tmp_path / "run"


def again(out: Path, scene=SCENE, **options) -> list[str]:
    said: list[str] = []
    results = run_case(scene, Builtin(), out, tell=said.append, **options)
    assert list(results) == list(KINDS)
    assert {r.status for r in results.values()} == {"completed"}
    assert [s.status for s in case_states(out)] == ["completed", "completed"]
    return said


def ended(out: Path) -> list[str]:
    return [json.loads((out / kind / RESULT).read_text())["ended"] + str((out / kind).stat().st_ino) for kind in KINDS]


def attempts(out: Path) -> list[str]:
    return sorted(path.name for path in out.glob("attempt-*"))


def test_the_same_input_is_not_run_again(done: Path) -> None:
    before = ended(done)
    said = again(done)
    assert ended(done) == before
    assert len(said) == 2
    assert all("not run again: it is complete, with the same input" in text for text in said)
    assert attempts(done) == []


def test_anew_runs_again_and_keeps_the_old(done: Path) -> None:
    before = ended(done)
    again(done, rerun=True)
    assert set(ended(done)).isdisjoint(before)
    assert attempts(done) == ["attempt-1"]
    assert [s.status for s in case_states(done / "attempt-1")] == ["completed", "completed"]


def test_changed_input_never_reuses_a_result(done: Path) -> None:
    before = ended(done)
    changed = replace(SCENE, contact=replace(SCENE.contact, e_n=0.5))
    again(done, changed)
    assert set(ended(done)).isdisjoint(before)
    assert attempts(done) == ["attempt-1"]
    again(done, SCENE)  # and back: what is there now is of the other input
    assert attempts(done) == ["attempt-1", "attempt-2"]


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda folder: (folder / RESULT).unlink(), "it has no end"),
        (lambda folder: (folder / "particles.dump").write_text("x"), "changed since the run ended"),
        (lambda folder: (folder / "particles.dump").unlink(), "not there, though the run wrote it"),
        (lambda folder: (folder / "manifest.json").write_text("{}"), "manifest.json"),
        (lambda folder: (folder / "manifest.json").unlink(), "no manifest.json"),
        (lambda folder: (folder / RESULT).write_text('{"status"'), "result.json"),
        (lambda folder: _edit(folder / RESULT, status="failed"), "it ended as failed"),
        (lambda folder: _edit(folder / RESULT, status="timed_out"), "it ended as timed out"),
        (lambda folder: _edit(folder / "manifest.json", kncal="0.0.1"), "not the same version of kncal"),
        (lambda folder: _edit(folder / "manifest.json", dt=1.0), "not the same time step"),
        (lambda folder: _edit(folder / "manifest.json", engine="liggghts"), "not the same engine"),
    ],
)
def test_one_model_that_is_not_to_be_trusted_runs_anew_alone(done: Path, damage, words: str) -> None:
    linear, hertz = ended(done)
    damage(done / "hertz")
    said = again(done)
    assert ended(done)[0] == linear
    assert ended(done)[1] != hertz
    assert any("linear not run again" in text for text in said)
    assert any(text.startswith("hertz runs again") and words in text and "attempt-1" in text for text in said), said
    assert (done / "attempt-1" / "hertz").is_dir()
    assert not (done / "attempt-1" / "linear").exists()
    assert (done / "attempt-1" / "case.toml").is_file()


def test_more_repeats_than_on_record_are_run(done: Path) -> None:
    said = again(done, repeat=2)
    assert all("it has 1 CPU time(s), 2 are asked for" in text for text in said)
    assert len(read_result(done / "linear").extra["cpu_samples"]) == 2
    assert all("not run again" in text for text in again(done))


def test_states_of_a_folder_nobody_works_in(done: Path, tmp_path: Path) -> None:
    rendered = tmp_path / "more" / "rendered"
    render_case(SCENE, Builtin(), rendered)
    assert [s.status for s in case_states(rendered)] == ["rendered", "rendered"]
    (done / "hertz" / RESULT).unlink()
    state = run_state(done / "hertz")
    assert (state.status, state.failure) == ("failed", "killed")
    assert "was stopped before it could write a result" in state.message
    assert (done / "hertz" / STARTED).is_file()
    again(done)
    assert list(find_run_folders(tmp_path)) == [rendered, done]  # without attempt-1


def _edit(path: Path, **changes) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
