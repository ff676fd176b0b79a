"""`kncal status` of a sweep: one screen, true to the results."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from kncal.study import read_design


def kncal(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "kncal", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)


@pytest.fixture
def swept(tmp_path: Path) -> Path:
    out = tmp_path / "sweep"
    done = kncal("sweep", "wall_impact", "--set", "contact.e_n=0.5,0.6,0.7", "--engine", "builtin", "--out", out)
    assert done.returncode == 0, done.stderr
    return out


def test_status_of_a_sweep(swept: Path) -> None:
    assert "3 runs: 3 completed" in kncal("status", swept).stdout
    run = next(iter(read_design(swept).runs))
    result = swept / "runs" / run / "linear" / "result.json"
    data = json.loads(result.read_text()) | {"status": "failed", "failure": "not-finite", "message": "it blew up"}
    result.write_text(json.dumps(data))
    text = kncal("status", swept).stdout
    assert "2 completed" in text
    assert "1 failed" in text
    assert "not-finite" in text
    assert "a smaller time step" in text
    assert "it blew up" in text
    found = json.loads(kncal("status", swept, "--json").stdout)
    assert found["counts"] == {"completed": 2, "failed": 1}
    assert found["newest"][0]["id"] == run
