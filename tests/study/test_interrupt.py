"""Ctrl-C and SIGTERM in the middle of a sweep: solvers ended in order, states kept, the table readable; then go on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

from kncal.runs.folder import read_result
from kncal.study import read_sweep, sweep_status

LID = """
[walls.lid]
axis = "z"
position = 0.0021
material = "rigid"
"""


def start(case: Path, out: Path, engine: str) -> subprocess.Popen[str]:
    """A sweep whose first runs are short and whose others would take hours, two at a time."""
    return subprocess.Popen(
        # a SIGINT that is ignored (in a background job) would be inherited
        [
            *("env", "--default-signal=INT", sys.executable, "-m", "kncal", "sweep", str(case), "--engine", engine),
            *("--set", "run.until_time=0.0004,4000.0,4001.0,4002.0", "--set", "run.record_every=1000"),
            *("--model", "linear", "--workers", "2", "--out", str(out)),
        ],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        process_group=0,
    )


@pytest.mark.parametrize(
    ("engine", "number"),
    [
        pytest.param("builtin", signal.SIGINT, marks=pytest.mark.slow),
        pytest.param("liggghts", signal.SIGINT, marks=pytest.mark.solver),
        pytest.param("liggghts", signal.SIGTERM, marks=pytest.mark.solver),
    ],
)
def test_interrupted_in_order(case: Path, tmp_path: Path, engine: str, number: int) -> None:
    # a lid and no loss, so that contact follows contact: the builtin engine jumps over flights
    case.write_text(case.read_text().replace("e_n = 0.9", "e_n = 1.0") + LID)
    out = tmp_path / "sweep"
    child = start(case, out, engine)
    deadline = time.monotonic() + 120.0

    def running() -> int:
        try:
            status = sweep_status(out)
        except ValueError:
            return 0  # the design is not written yet
        return len(status.running) if status.counts.get("completed") else 0

    try:
        while running() < 2:
            assert child.poll() is None, child.communicate()[1]
            assert time.monotonic() < deadline
            time.sleep(0.05)
        time.sleep(0.3)
        os.killpg(child.pid, number)
        _, err = child.communicate(timeout=60)
    finally:
        if child.poll() is None:
            os.killpg(child.pid, signal.SIGKILL)  # its solvers go with it
            child.wait()
    assert child.returncode == 130, err
    assert "1 of 4 runs are completed" in err
    assert "Traceback" not in err
    status = sweep_status(out)
    assert dict(status.counts) == {"completed": 1, "interrupted": 2, "waiting": 1}
    assert not status.running
    states = {path.parent.parent.name: read_result(path.parent).status for path in out.glob("runs/*/*/result.json")}
    assert sorted(states.values()) == ["completed", "interrupted", "interrupted"]
    written = pd.read_csv(out / "sweep.csv", dtype={"id": str})
    assert sorted(written["status"]) == ["completed", "interrupted", "interrupted", "waiting"]
    assert sorted(read_sweep(out)["status"]) == sorted(written["status"])
    # no solver is left
    for link in Path("/proc").glob("[0-9]*/cwd"):
        try:
            assert not link.readlink().is_relative_to(out)
        except OSError:
            continue  # it has ended, or is not ours
