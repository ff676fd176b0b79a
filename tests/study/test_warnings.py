"""A sweep tells each kind of warning about its runs once, for people and for machines."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kncal.cli import main


def sweep(tmp_path: Path, *more: str) -> int:
    arguments = ["sweep", "wall_impact", "--engine", "builtin", "--set", "run.steps_per_contact=5,10,100"]
    with pytest.raises(SystemExit) as stop:
        main([*arguments, "--out", str(tmp_path / "out"), *more])
    return int(stop.value.code or 0)


def test_coarse_steps_are_told_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert sweep(tmp_path) == 0
    err = capsys.readouterr().err
    assert err.count("dt-coarse") == 1
    assert "2 of 3 runs" in err
    assert sweep(tmp_path, "--json") == 0
    found = json.loads(capsys.readouterr().out)["warnings"]
    assert list(found) == ["dt-coarse"]
    assert len(found["dt-coarse"]) == 2
