"""Everything is killed at random moments of a sweep, again and again; what is left at the end is what it should be."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from kncal.study import read_sweep, sweep_status

pytestmark = pytest.mark.solver

#: Four runs of both models.
ARGUMENTS = ("--set", "contact.e_n=0.6,0.8", "--set", "run.steps_per_contact=20,30", "--workers", "2")
IDS = 4

#: Starts the command line in a fresh process for each line of input: forked, since importing all takes a second.
SERVER = """
import json, os, sys
import kncal.runs.workflow, kncal.cli, kncal.observe.compare, kncal.study, pandas, scipy.stats
from kncal.scene.case_file import load_case
from kncal.scene.plan import plan
plan(load_case("wall_impact"))  # fills the tables of impacts
print("ready", flush=True)
for line in sys.stdin:
    if (pid := os.fork()) == 0:
        os.setsid()
        os.dup2(2, 1)
        try:
            kncal.cli.main(json.loads(line))
        except SystemExit as stop:
            sys.stderr.flush()
            os._exit(stop.code)
        os._exit(99)
    print(pid, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
"""


class Server:
    """Runs of the command line that can be killed."""

    def __init__(self, stderr: int) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", SERVER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
        assert self._line() == "ready"

    def start(self, *arguments: object) -> int:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps([str(a) for a in arguments]) + "\n")
        self._process.stdin.flush()
        return int(self._line())

    def code(self) -> int:
        return int(self._line())

    def close(self) -> None:
        self._process.communicate(timeout=60)

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with (tmp_path_factory.mktemp("server") / "errors").open("w") as errors:
        found = Server(errors.fileno())
        yield found
        found.close()


@pytest.fixture
def undisturbed(server: Server, case: Path, tmp_path_factory) -> tuple[pd.DataFrame, float]:
    """The table of a sweep that nothing happens to, and how long it took [s]."""
    out = tmp_path_factory.mktemp("undisturbed") / "sweep"
    begin = time.monotonic()
    server.start("sweep", case, *ARGUMENTS, "--out", out)
    assert server.code() == 0
    return read_sweep(out), time.monotonic() - begin


@pytest.mark.parametrize("most", [12, pytest.param(500, marks=[pytest.mark.long, pytest.mark.timeout(0)])])
def test_power_cuts_lose_nothing_and_double_nothing(
    server: Server, case: Path, undisturbed, tmp_path: Path, most: int
) -> None:
    table, duration = undisturbed
    kills = rounds = 0
    rng = np.random.default_rng(20240607)
    while kills < most or rounds < 2:  # finished and begun anew between the kills: they come at every stage of a sweep
        rounds += 1
        out = tmp_path / f"sweep{rounds}"
        while True:
            pid = server.start("sweep", case, *ARGUMENTS, "--out", out)
            # once the test has its kills, the last sweep may come to its end
            ended = kills < most and _cut(pid, rng.uniform(0.0, 0.6) * duration, everything=bool(rng.integers(2)))
            code = server.code()
            _no_solver_is_left(out)
            if not ended:
                assert code in (0, -signal.SIGKILL)
                if code == 0:
                    break
            kills += ended
        _same(out, table)


def _cut(pid: int, after: float, *, everything: bool) -> bool:
    """Kill kncal, and all that it started at the same moment or not; False if it ended before."""
    deadline = time.monotonic() + after
    while time.monotonic() < deadline:
        if _gone(pid):
            return False
        time.sleep(0.005)
    try:
        os.kill(pid, signal.SIGSTOP)  # so that it sees nothing of what happens to its solvers
        for process in [*(_descendants(pid) if everything else []), pid]:
            os.kill(process, signal.SIGKILL)
    except ProcessLookupError:
        return not _gone(pid)
    return True


def _stat(pid: int | str) -> list[str]:
    return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()


def _gone(pid: int) -> bool:
    try:
        return _stat(pid)[0] == "Z"
    except OSError:
        return True


def _descendants(pid: int) -> list[int]:
    parents: dict[int, list[int]] = {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            parents.setdefault(int(_stat(path.name)[1]), []).append(int(path.name))
        except OSError:
            continue  # it has ended
    found, todo = [], [pid]
    while todo:
        children = parents.get(todo.pop(), [])
        found += children
        todo += children
    return found


def _no_solver_is_left(out: Path) -> None:
    deadline = time.monotonic() + 10.0
    while left := [link.parent.name for link in Path("/proc").glob("[0-9]*/cwd") if _works_in(link, out)]:
        assert time.monotonic() < deadline, left
        time.sleep(0.01)


def _works_in(link: Path, out: Path) -> bool:
    try:
        return link.readlink().is_relative_to(out)
    except OSError:
        return False  # it has ended, or is not ours


def _same(out: Path, expected: pd.DataFrame) -> None:
    """The same runs, one result each, and the same numbers to the last bit (one process, the same deck)."""
    table = read_sweep(out)
    costs = ["cpu_seconds", "wall_seconds"]
    pd.testing.assert_frame_equal(table.drop(columns=costs), expected.drop(columns=costs), check_like=True)
    assert set(table["status"]) == {"completed"}
    assert sorted(path.name for path in (out / "runs").iterdir()) == sorted(set(expected["id"]))
    assert len(list((out / "runs").glob("*/*/result.json"))) == 2 * IDS
    assert len(pd.read_csv(out / "sweep.csv", dtype={"id": str})) == 2 * IDS
    status = sweep_status(out)
    assert (dict(status.counts), status.running, status.owner) == ({"completed": IDS}, (), "")
