"""A small case and the command line."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from sweeps import swept

from kncal.cli import main

CASE = """
title = "A bead on a floor"

[materials.glass]
young = 1e7
poisson = 0.25
density = 2500.0

[particles.bead]
material = "glass"
diameter = 0.002
position = [0.0, 0.0, 0.001001]
velocity = [0.0, 0.0, -1.0]

[walls.floor]
axis = "z"
position = 0.0
material = "rigid"

[contact]
e_n = 0.9
v_0 = 1.0

[run]
steps_per_contact = 20
until_time = 0.0004
"""


@pytest.fixture
def case(tmp_path: Path) -> Path:
    """A case of some forty steps."""
    path = tmp_path / "bead" / "case.toml"
    path.parent.mkdir()
    path.write_text(CASE)
    return path


@pytest.fixture
def kncal(capsys):
    """The command line in this process: exit code, standard output and error."""

    def run(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as stop:
            main([str(a) for a in arguments])
        printed = capsys.readouterr()
        return stop.value.code, printed.out, printed.err

    return run


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep of four runs of `CASE`; to be copied."""
    home = tmp_path_factory.mktemp("finished") / "bead"
    home.mkdir()
    (home / "case.toml").write_text(CASE)
    swept(home / "case.toml", home / "sweep")
    return home / "sweep"


@pytest.fixture
def folder(finished: Path, tmp_path: Path) -> Path:
    """A finished sweep of four runs of `case`."""
    return shutil.copytree(finished, tmp_path / "sweep")
