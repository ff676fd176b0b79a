"""How a command ends that could not do or say what it should: its exit code, its JSON, and no traceback."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from kncal import cli
from kncal.cli import main
from kncal.study.design import DESIGN

pytestmark = pytest.mark.slow

EXIT_FAILED, EXIT_UNEXPECTED = 3, 5


def ended(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return int(stop.value.code)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "wall_impact", "--engine", "builtin", "--json"),
        ("run", "wall_impact", "--engine", "builtin"),
        ("render", "wall_impact"),
        ("cases",),
        ("cases", "--json"),
        ("laws", "--json"),
        ("kn", "wall_impact", "--json"),
        ("needs", "wall_impact", "--json"),
        ("collide", "--young", 7e10, "--density", 2500, "--radius", 1e-3, "--v0", 1, "--en", 0.9, "--json"),
        ("doctor", "--json"),
        ("new", "wall_impact", "mine"),
        ("status", "done"),
        ("status", "done", "--json"),
        ("report", "done"),
        ("clean", "done", "--yes"),
        ("sweep-table", "swept"),
        ("--version",),
    ],
    ids=lambda arguments: " ".join(str(a) for a in arguments[:2]),
)
def test_a_result_that_could_not_be_printed_is_no_success(
    arguments: tuple[object, ...], done: Path, swept: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    done.rename("done")
    (tmp_path / "swept").symlink_to(swept)
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert ended(*arguments) == EXIT_FAILED
    assert "No space left on device" in capsys.readouterr().err


@pytest.fixture(scope="module")
def swept(tmp_path_factory) -> Path:
    """A sweep of one finished run."""
    out = tmp_path_factory.mktemp("swept") / "out"
    grid = ("--set", "contact.e_n=0.8,0.9", "--model", "linear", "--engine", "builtin", "--out", out)
    assert ended("sweep", "wall_impact", *grid) == 0
    assert (out / DESIGN).is_file()
    return out


def test_a_process_without_standard_output_says_so(tmp_path: Path) -> None:
    command = f"exec {sys.executable} -m kncal cases --json >&-"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False)
    assert done.returncode == EXIT_FAILED
    assert "standard output" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "kind", "code"),
    [
        (("kn", "no_such_case"), "bad-input", 2),
        (("frobnicate",), "bad-input", 2),
        (("compare", "wall_impact", "--engine", ""), "bad-input", 2),
        (("run", "wall_impact", "--ranks", "2", "--engine", "builtin"), "bad-input", 2),
        (("status", "nowhere"), "bad-input", 2),
        (("sweep-table", "nowhere"), "truncated-output", 2),
        (("run", "wall_impact", "--out", "out"), "not-installed", 4),
    ],
)
def test_json_of_a_command_that_failed(arguments, kind: str, code: int, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    if code == cli.failures.MISSING:
        monkeypatch.setenv("PATH", str(tmp_path))
    assert ended(*arguments, "--json") == code
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert found["kind"] == kind
    assert found["exit_code"] == code
    assert found["error"]
    if "frobnicate" not in arguments:  # which is told in a frame
        assert found["error"].split("\n")[0] in said.err
    # without --json standard output is left alone
    assert ended(*arguments) == code
    assert capsys.readouterr().out == ""


def test_a_fault_of_kncal_itself_has_a_code_of_its_own_and_its_traceback_in_a_file(
    tmp_path: Path, monkeypatch, capsys
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("by\nnobody")

    monkeypatch.setattr("kncal.scene.case_file.load_case", broken)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert ended("needs", "wall_impact", "--json") == EXIT_UNEXPECTED
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert (found["kind"], found["exit_code"]) == ("unexpected", EXIT_UNEXPECTED)
    assert said.err.startswith("kncal: ")
    assert said.err.count("\n") == 1
    (file,) = tmp_path.iterdir()
    assert re.search(re.escape(str(file)), said.err)
    text = file.read_text()
    assert "Traceback (most recent call last)" in text
    assert "ZeroDivisionError" in text
    assert "ZeroDivisionError" in found["error"]


def test_a_fault_where_no_file_can_be_written_shows_its_traceback(monkeypatch, capsys, tmp_path: Path) -> None:
    monkeypatch.setattr("kncal.core.shipped.folder", lambda *_: 1 / 0)
    monkeypatch.setattr("kncal.scene.case_text.folder", lambda *_: 1 / 0)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "gone"))
    assert ended("cases") == EXIT_UNEXPECTED
    assert "ZeroDivisionError" in capsys.readouterr().err
