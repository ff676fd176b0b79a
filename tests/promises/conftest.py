"""Run folders to damage."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from kncal.cli import main
from kncal.engines.registry import get_engine
from kncal.runs.workflow import run_case
from kncal.scene.case_file import load_case


@pytest.fixture
def here(capsys):
    """The command line in this process: exit code and standard error."""

    def run(*arguments: object) -> tuple[int, str]:
        with pytest.raises(SystemExit) as stop:
            main([str(a) for a in arguments])
        return stop.value.code, capsys.readouterr().err

    return run


@pytest.fixture(scope="module")
def scene():
    return load_case("wall_impact")


@pytest.fixture(scope="module")
def finished(scene, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("finished") / "out"
    run_case(scene, get_engine("builtin"), out)
    return out


@pytest.fixture
def done(finished: Path, tmp_path: Path) -> Path:
    """A finished run folder of both models, to damage."""
    return shutil.copytree(finished, tmp_path / "out")
