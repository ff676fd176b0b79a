"""Records and frames that are not those of the run are refused; the text names the file and the key."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from kncal.core.errors import ReadError
from kncal.engines.registry import get_engine
from kncal.runs.workflow import load, load_both, run_case


def test_changed_frames_are_noticed(done: Path) -> None:
    load_both(done)
    frames = done / "linear" / "particles.dump"
    frames.write_bytes((done / "hertz" / "particles.dump").read_bytes())
    with pytest.raises(ReadError, match=r"particles\.dump: changed since the run ended"):
        load(done / "linear")
    frames.unlink()
    with pytest.raises(ReadError, match=r"particles\.dump: not there"):
        load(done / "linear")


@pytest.mark.parametrize("cut", ["first", "last"])
def test_frames_must_span_the_run_even_where_the_hash_is_right(done: Path, cut: str) -> None:
    folder = done / "hertz"
    frames = folder / "particles.dump"
    item = "ITEM: TIMESTEP\n"
    parts = frames.read_text().split(item)[1:]
    frames.write_text("".join(item + part for part in (parts[1:] if cut == "first" else parts[:-1])))
    edit(folder / "result.json", "files_sha256", {"particles.dump": hashlib.sha256(frames.read_bytes()).hexdigest()})
    with pytest.raises(ReadError, match="frames of step"):
        load(folder)


def edit(path: Path, key: str, value: object) -> None:
    data = json.loads(path.read_text())
    data[key] = value
    path.write_text(json.dumps(data))


@pytest.mark.parametrize(
    ("file", "key", "value"),
    [
        ("result.json", "log", "../../etc/passwd"),
        ("result.json", "model", "hooke"),
        ("result.json", "model", "hertz"),
        ("result.json", "engine", "liggghts"),
        ("result.json", "steps", 7),
        ("result.json", "dt", 1.0),
        ("result.json", "status", "fine"),
        ("result.json", "cpu_seconds", "1"),
        ("result.json", "extra", {"cpu_samples": [None]}),
        ("result.json", "files_sha256", {}),
        ("result.json", "files_sha256", {"../x": "0" * 64}),
        ("result.json", "surprise", 1),
        ("manifest.json", "model", "hertz"),
        ("manifest.json", "engine", 5),
        ("manifest.json", "case", None),
        ("manifest.json", "solver", []),
    ],
)
def test_a_record_of_the_wrong_shape_names_file_and_key(done: Path, file: str, key: str, value: object) -> None:
    edit(done / "linear" / file, key, value)
    with pytest.raises(ReadError) as error:
        load(done / "linear")
    assert file in str(error.value)
    assert key in str(error.value)


@pytest.mark.parametrize("text", ["null", "[]", "5", "{}"])
@pytest.mark.parametrize("file", ["result.json", "manifest.json"])
def test_json_that_is_no_record(here, done: Path, file: str, text: str) -> None:
    (done / "linear" / file).write_text(text)
    code, err = here("report", done)
    assert code == 2
    assert file in err


def test_a_marker_of_the_repeat_before_does_not_stand_while_the_next_runs(scene, tmp_path: Path, monkeypatch) -> None:
    engine = get_engine("builtin")
    true_run, stood = engine.run, []

    def run(model, folder, **options):
        stood.append((folder / "result.json").exists())
        return true_run(model, folder, **options)

    monkeypatch.setattr(engine, "run", run)
    run_case(scene, engine, tmp_path / "out", repeat=2)
    assert stood == [False] * 4
