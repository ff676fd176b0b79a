"""A run folder that a start left half-made when it was killed: it is kncal's, and the next start takes it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import kncal.runs.folder
from kncal.core.errors import RenderError
from kncal.core.files import sha256
from kncal.engines.registry import get_engine
from kncal.runs.folder import case_folder
from kncal.runs.workflow import load_both, run_case
from kncal.scene.case_file import load_case


class Killed(BaseException):
    """Stands for a SIGKILL: nothing catches it."""


@pytest.fixture(scope="module")
def scene():
    return load_case("wall_impact")


@pytest.mark.parametrize("moved", range(5))
def test_killed_while_old_results_are_moved_aside(scene, tmp_path: Path, monkeypatch, moved: int) -> None:
    """The folder holds .lock, case.toml, manifest.json, linear and hertz; killed after so many of these moves."""
    out = tmp_path / "out"
    run_case(scene, get_engine("builtin"), out)
    old = {path.read_bytes() for path in out.glob("*/result.json")}
    assert len(old) == 2
    true_move, count = kncal.runs.folder.shutil.move, 0

    def move(*arguments):
        nonlocal count
        if count == moved:
            raise Killed
        count += 1
        return true_move(*arguments)

    monkeypatch.setattr(kncal.runs.folder.shutil, "move", move)
    if moved < 4:
        with pytest.raises(Killed), case_folder(scene, out):
            pass
    monkeypatch.undo()
    run_case(scene, get_engine("builtin"), out)
    load_both(out)
    assert old <= {path.read_bytes() for path in out.glob("**/result.json")}  # kept in place, or in an attempt


@pytest.mark.parametrize("place", ["write_json", "write_bytes"])
def test_killed_while_the_new_records_are_written(scene, tmp_path: Path, monkeypatch, place: str) -> None:
    out = tmp_path / "out"

    def die(*_):
        (out / ".manifest.json.k3x2.part").write_text("{")
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(*((kncal.runs.folder, "write_json") if place == "write_json" else (Path, "write_bytes")), die)
        with pytest.raises(Killed), case_folder(scene, out):
            pass
    run_case(scene, get_engine("builtin"), out)
    load_both(out)
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["case_sha256"] == sha256(out / "case.toml")


def test_a_stranger_s_folder_is_still_refused(scene, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(RenderError, match="holds files"), case_folder(scene, tmp_path):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
