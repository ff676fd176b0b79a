"""`kncal status` of a sweep: one screen, true to the results."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kncal.cli import main
from kncal.study import read_design


def test_status_of_a_sweep(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def kncal(*arguments: object) -> str:
        with pytest.raises(SystemExit) as stop:
            main([str(a) for a in arguments])
        printed = capsys.readouterr()
        assert stop.value.code == 0, printed.err
        return printed.out

    swept = tmp_path / "sweep"
    kncal("sweep", "wall_impact", "--set", "contact.e_n=0.5,0.6,0.7", "--engine", "builtin", "--out", swept)
    assert "3 runs: 3 completed" in kncal("status", swept)
    run = next(iter(read_design(swept).runs))
    result = swept / "runs" / run / "linear" / "result.json"
    data = json.loads(result.read_text()) | {"status": "failed", "failure": "not-finite", "message": "it blew up"}
    result.write_text(json.dumps(data))
    text = kncal("status", swept)
    assert "2 completed" in text
    assert "1 failed" in text
    assert "not-finite" in text
    assert "a smaller time step" in text
    assert "it blew up" in text
    # from above: the completed runs of a sweep are counted, the others listed
    text = kncal("status", tmp_path)
    assert "5 completed" in text  # of the folders in the order of their names, which are hashes
    assert "1 failed" in text
    assert run in text
    assert not any(other in text for other in read_design(swept).runs if other != run)
    found = json.loads(kncal("status", swept, "--json"))
    assert found["counts"] == {"completed": 2, "failed": 1}
    assert found["newest"][0]["id"] == run
