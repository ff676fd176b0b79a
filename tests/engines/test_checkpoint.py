"""Which folders are checkpoints that a run may go on from: whole ones, of this run, and no others."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

from kncal.engines.checkpoint import last_checkpoint, write_checkpoint


def saved(folder: Path, coupling: int = 3) -> Path:
    """A whole checkpoint."""

    def save(name: str):
        return lambda place: (place.mkdir(), (place / name).write_bytes(b"x"))

    write_checkpoint(folder, coupling, {"dem": 1.0}, save("p"), save("particles.restart"))
    return folder / f"checkpoint-{coupling}"


ZEROS = "0" * 64
DOCTORED = [
    *(("coupling", value) for value in (10**9, 10**400, True, False, "3", 3.0, 0, -1, 4, None)),
    *(("cost", value) for value in ({"dem": "1"}, {"dem": True}, {"dem": -1.0}, {"dem": None}, [], None)),
    *(("files_sha256", value) for value in ({"/etc/passwd": ZEROS}, {"../x": ZEROS}, {"p": 5}, {"pipe": ZEROS}, [])),
]


@pytest.mark.parametrize(("key", "value"), DOCTORED)
def test_a_doctored_checkpoint_is_none(tmp_path, key, value):
    """Wrong in kind or range, naming files elsewhere, or a pipe that would be waited for."""
    checkpoint = saved(tmp_path)
    assert last_checkpoint(tmp_path, 3).coupling == 3
    assert last_checkpoint(tmp_path, 2) is None  # of a longer run
    os.mkfifo(checkpoint / "pipe")
    record = json.loads((checkpoint / "checkpoint.json").read_text())
    (checkpoint / "checkpoint.json").write_text(json.dumps(record | {key: value}))
    assert last_checkpoint(tmp_path) is None


def test_a_checkpoint_counts_under_its_own_name_and_leaves_other_folders_alone(tmp_path):
    for name in ("checkpoint-mine", "checkpoint-03", "checkpoint-"):
        shutil.copytree(saved(tmp_path / "other"), tmp_path / "run" / name)
    saved(tmp_path / "run", 3).rename(tmp_path / "run" / "checkpoint-7")
    assert last_checkpoint(tmp_path / "run") is None
    saved(tmp_path / "run", 5)
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert names == {"checkpoint-mine", "checkpoint-03", "checkpoint-", "checkpoint-5"}
