"""Sweeps on Dask workers: a killed worker costs its own run another start and no run anything else; no orphans."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from bouncing import ENDLESS, LIMIT, SHORT, alive, attempts, bounce, designed, parent, solver_of, solvers, wait_until

from kncal import __version__
from kncal.core.errors import InputError, RunError
from kncal.core.lock import locked
from kncal.runs.folder import read_result
from kncal.study import Settings, combine, dask_executor, design, grid_axis, run_sweep, sweep_status
from kncal.study.dask_executor import perform

pytestmark = pytest.mark.skipif(  # not imported here, which takes a second
    importlib.util.find_spec("distributed") is None, reason="dask is not installed (kncal[dask])"
)


@pytest.fixture
def case(case: Path) -> Path:
    return bounce(case)


# --- killed workers ---------------------------------------------------------------------------------------------------


@pytest.mark.solver
def test_a_killed_worker_costs_only_its_own_run_another_start(case: Path, tmp_path: Path, monkeypatch) -> None:
    """One run loses its worker once, one each time that it is begun, and two others run beside them."""
    monkeypatch.setattr("kncal.study.dask_workers.RETRIES", 1)  # of three: each new worker takes seconds
    out = tmp_path / "sweep"
    made, text = designed(case, ENDLESS, SHORT, 1.0, 2.0)
    poison, once, *_ = made.runs
    kills = {poison: 99, once: 1}
    killed: list[int] = []

    def kill(_: object) -> None:
        for run, left in kills.items():
            solver = solver_of(out / "runs" / run) if left else None
            if solver is not None and solver not in killed:
                kills[run] = left - 1
                killed.append(solver)
                os.kill(parent(solver), signal.SIGKILL)  # the worker

    before = time.monotonic()
    result = run_sweep(made, text, out, dask_executor("dask", 2), kill)
    assert time.monotonic() - before < LIMIT
    assert (result.completed, dict(result.failures)) == (3, {"killed": (poison,)})
    assert "died 2 times" in result.messages[poison]
    # every start is one of an undisturbed run, or followed a kill: none is lost, none doubled
    assert attempts(out) == {ENDLESS: 2, SHORT: 2, 1.0: 1, 2.0: 1}
    assert len(killed) == 3
    wait_until(lambda: not any(alive(pid) for pid in killed))
    assert sorted(p.parent.parent.name for p in out.glob("runs/*/*/result.json")) == sorted(set(made.runs) - {poison})


# --- interrupted ------------------------------------------------------------------------------------------------------


@pytest.mark.solver
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_the_end_of_kncal_is_the_end_of_its_workers_and_solvers(case: Path, tmp_path: Path, number: int) -> None:
    out = tmp_path / "sweep"
    command = [sys.executable, "-m", "kncal", "sweep", str(case), "--model", "linear", "--executor", "dask"]
    command += ["--set", f"run.until_time=0.0004,{ENDLESS},{ENDLESS + 1}", "--set", "run.record_every=1000"]
    child = subprocess.Popen(
        ["env", "--default-signal=INT", *command, "--workers", "1", "--out", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        process_group=0,
    )
    try:
        wait_until(lambda: out.is_dir() and solvers(out) and completed(out))
        (solver,) = solvers(out)
        worker = parent(solver)
        os.killpg(child.pid, number)  # as a terminal does
        _, err = child.communicate(timeout=LIMIT)
    finally:
        if child.poll() is None:
            child.kill()
            child.wait()
    wait_until(lambda: not alive(solver) and not alive(worker))
    assert not solvers(out)
    counts = dict(sweep_status(out).counts)
    if number == signal.SIGINT:
        assert child.returncode == 130, err
        assert "1 of 3 runs are completed" in err
        assert "Traceback" not in err
        assert counts == {"completed": 1, "interrupted": 1, "waiting": 1}
        states = sorted(read_result(path.parent).status for path in out.glob("runs/*/*/result.json"))
        assert states == ["completed", "interrupted"]
    else:
        # the worker may have noticed in time to end its run in order
        assert counts.pop("completed") == 1
        assert counts.pop("waiting") == 1
        assert counts in ({"unfinished": 1}, {"interrupted": 1})


def completed(out: Path) -> bool:
    return bool(list(out.glob("states.jsonl"))) and bool(sweep_status(out).counts.get("completed"))


# --- somebody else's scheduler ----------------------------------------------------------------------------------------


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes], list[subprocess.Popen[bytes]]]]:
    """A scheduler and one worker with one thread, started as docs/how-to/run-on-a-cluster.md says, on loopback."""
    address = tmp_path / "scheduler.json"
    started: list[subprocess.Popen[bytes]] = []

    def start(name: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [
            sys.executable,
            "-m",
            f"distributed.cli.dask_{name}",
            "--scheduler-file",
            str(address),
            "--no-dashboard",
        ]
        with (tmp_path / f"{name}.log").open("wb") as log:
            child = subprocess.Popen([*command, *arguments], stdout=log, stderr=log, stdin=subprocess.DEVNULL)
        started.append(child)
        return child

    try:
        first = start("scheduler", "--host", "127.0.0.1", "--port", "0")
        wait_until(address.exists)
        start("worker", "--nthreads", "1", "--no-nanny", "--preload", "kncal.study.dask_executor")
        yield json.loads(address.read_text())["address"], first, started
    finally:
        for child in started:
            if child.poll() is None:
                child.kill()
            child.wait()


@pytest.mark.solver
def test_a_given_scheduler_and_its_loss_in_the_middle(case: Path, tmp_path: Path, scheduler, kncal) -> None:
    address, first, started = scheduler
    out = tmp_path / "sweep"
    flags = ("--executor", "dask", "--scheduler", address, "--model", "linear", "--out", out)
    code, said, err = kncal("sweep", case, "--set", "run.until_time=0.0004,0.0005", *flags)
    assert (code, err) == (0, "")
    assert "2 of 2 runs completed" in said
    assert started[1].poll() is None  # another's worker is not ended

    made, text = designed(case, ENDLESS, ENDLESS + 1)
    pids: list[int] = []

    def lose(_: object) -> None:
        if not pids and (found := solvers(out)):
            pids.extend(found)
            first.kill()

    before = time.monotonic()
    result = run_sweep(made, text, out, dask_executor("dask", scheduler=address), lose)
    assert time.monotonic() - before < LIMIT
    assert {name: sorted(ids) for name, ids in result.failures.items()} == {"peer-died": sorted(made.runs)}
    assert pids
    wait_until(lambda: not alive(pids[0]))


def test_no_scheduler_there_is_said_before_anything_runs(case: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("kncal.study.dask_workers.CONNECT", 0.5)
    made, text = designed(case, SHORT)
    with pytest.raises(RunError, match=r"127\.0\.0\.1:9: no Dask scheduler"):
        run_sweep(made, text, tmp_path / "sweep", dask_executor("dask", scheduler="tcp://127.0.0.1:9"))
    with locked(tmp_path / "sweep"):
        assert sweep_status(tmp_path / "sweep").counts == {"waiting": 1}


# --- refusals ---------------------------------------------------------------------------------------------------------


def test_a_worker_says_what_it_lacks(case: Path, tmp_path: Path) -> None:
    out = tmp_path / "not-shared"
    assert f"does not see {out}" in str(perform(str(out), "0" * 12, __version__, "a"))
    assert "has kncal" in str(perform(str(out), "0" * 12, "0.0.0", "a"))


def test_without_the_extra_the_command_names_it(case: Path, tmp_path: Path, kncal, monkeypatch) -> None:
    there = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "distributed" else there(name))
    code, _, err = kncal("sweep", case, "--executor", "dask", "--out", tmp_path / "sweep")
    assert code == 2
    assert "pip install 'kncal[dask]'" in err
    assert not (tmp_path / "sweep").exists()


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (("--scheduler", "tcp://127.0.0.1:8786"), "--scheduler"),
        (("--executor", "dask", "--scheduler", "inproc://x"), "tcp://HOST:PORT"),
        (("--executor", "dask", "--scheduler", "tcp://a b:1"), "tcp://HOST:PORT"),
        (("--executor", "dask", "--interface", "lo"), "--interface"),
        (("--executor", "dask", "--queue", "short"), "--queue"),
        (("--executor", "dask", "--workers", "0"), "workers = 0"),
    ],
)
def test_flags_that_cannot_be_meant_are_refused(case: Path, tmp_path: Path, kncal, flags, named) -> None:
    code, _, err = kncal("sweep", case, *flags, "--out", tmp_path / "sweep")
    assert code == 2
    assert named in err
    assert not (tmp_path / "sweep").exists()


def test_what_is_kept_needs_no_workers(case: Path, tmp_path: Path, monkeypatch) -> None:
    """A finished sweep is told to be finished without a cluster being started."""
    made, text = design(case, combine([grid_axis("run.until_time=0.0004")]), Settings(engine="builtin"))
    assert run_sweep(made, text, tmp_path / "sweep").completed == 1
    with pytest.raises(InputError, match="needs --workers"):
        dask_executor("slurm")
    executor = dask_executor("dask", 1)
    monkeypatch.setattr(executor, "submit", lambda *_: pytest.fail("was run again"))
    assert run_sweep(made, text, tmp_path / "sweep", executor).kept == 1
