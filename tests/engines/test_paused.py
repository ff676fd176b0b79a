"""A pause of everything is no one's fault; a solver that is held or hangs while kncal runs is ended, and named."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from beds import model, scene, still
from gas_columns import setup

from kncal.core.errors import RunError
from kncal.core.process import run_process
from kncal.engines.dpmfoam.adapter_build import find
from kncal.engines.dpmfoam.live import LiveGas
from kncal.engines.dpmfoam.restart import RestartGas
from kncal.engines.liggghts import library as dem_module
from kncal.engines.liggghts.diagnose import diagnose_liggghts
from kncal.engines.liggghts.library import LiggghtsDem
from kncal.runs.states import ADVICE
from kncal.scene.placement import Start, lattice

pytestmark = pytest.mark.solver

LIMIT = 5.0  # s that a solver may be silent, here: one step of a busy machine takes less
BATCH = 2.0  # s that a run of a program may take
PAUSE = LIMIT + 1.0
NONE = (np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0))  # particles of a gas step

#: Everything that waits with a limit, all at once, until it is told to end; says what became of each.
PROGRAM = """
import json, sys, threading
from pathlib import Path
import kncal.engines.liggghts.library as dem_module
from beds import model, scene, still
from gas_columns import setup
from kncal.scene.placement import Start, lattice
from kncal.engines.dpmfoam.adapter_build import find
from kncal.engines.liggghts.library import LiggghtsDem
from kncal.engines.dpmfoam.live import LiveGas
from kncal.engines.dpmfoam.restart import RestartGas
from kncal.core.process import run_process
from test_paused import BATCH, LIMIT, NONE

dem_module._RUN_LIMIT, dem_module._STEP_LIMIT = LIMIT, 0.0
out, end, first, found = Path(sys.argv[1]), threading.Event(), {}, {}

def particles():
    bed = scene(50)
    with LiggghtsDem(model(bed), out / "particles", Start.at(lattice(bed))) as dem:
        yield from (dem.run(3000, still(bed)) for _ in iter(int, 1))

def live():
    gas = LiveGas(setup(), out / "live", find(), 0, time_limit=LIMIT)
    yield from (gas.step(*NONE) for _ in iter(int, 1))

def restart():
    gas = RestartGas(setup(), out / "restart", time_limit=LIMIT)
    yield from (gas.step(*NONE) for _ in iter(int, 1))

def batch():
    yield
    result = run_process(("sleep", "60"), cwd=out, log=out / "log", timeout=BATCH)
    found["batch_seconds"] = result.wall_seconds

def work(job):
    try:
        for _ in job():
            first[job.__name__].set()
            if job is not batch:
                if end.is_set():
                    break
            else:
                all(event.wait() for event in first.values())
        found[job.__name__] = "ok"
    except Exception as error:
        found[job.__name__] = str(error)
        first[job.__name__].set()

jobs = [particles, restart, batch] + ([live] if find() else [])
first |= {job.__name__: threading.Event() for job in jobs}
threads = [threading.Thread(target=work, args=(job,)) for job in jobs]
for thread in threads:
    thread.start()
all(event.wait() for event in first.values())
print("ready", flush=True)
sys.stdin.readline()
end.set()
for thread in threads:
    thread.join()
print(json.dumps(found), flush=True)
"""


def tree(pid: int) -> list[int]:
    """A process and all that it started, itself first."""
    found = [pid]
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        found += [one for child in path.read_text().split() for one in tree(int(child))]
    return found


def test_a_pause_of_everything_is_no_silence_and_no_time(tmp_path: Path) -> None:
    paths = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=paths,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "ready\n"
            time.sleep(0.2)
            os.kill(process.pid, signal.SIGSTOP)
            held = tree(process.pid)
            for number in (signal.SIGSTOP, signal.SIGCONT):
                for pid in held:
                    with suppress(ProcessLookupError):  # a gas step that has just ended
                        os.kill(pid, number)
                if number == signal.SIGSTOP:
                    time.sleep(PAUSE)
            answer, _ = process.communicate("end\n", timeout=60)
        finally:
            process.kill()  # its solvers die with it
    found = json.loads(answer)
    assert found.pop("batch_seconds") > PAUSE + 0.5 * BATCH  # its time was not over with the pause
    assert set(found.values()) == {"ok"}


def particles(folder: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[int, Callable[[], object], Callable[[], object]]:
    """The number of a LIGGGHTS, what asks it something, and what waits for it while it waits for kncal: a deadlock."""
    monkeypatch.setattr(dem_module, "_RUN_LIMIT", 0.6)
    bed = scene(20)
    dem = LiggghtsDem(model(bed), folder, Start.at(lattice(bed)))
    assert dem.pid is not None
    return dem.pid, lambda: dem.run(10, still(bed)), lambda: dem._receive(0.6)


def live(folder: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[int, Callable[[], object], Callable[[], object]]:
    library = find()
    if library is None:
        pytest.skip("the adapter is not built")
    gas = LiveGas(setup(), folder, library, 0)
    solver = gas._running()
    monkeypatch.setattr(gas, "_time_limit", 0.6)
    return solver.pid, lambda: gas.step(*NONE), lambda: gas._await(solver)


@pytest.mark.parametrize("side", [particles, live])
@pytest.mark.parametrize(("held", "failure"), [(True, "peer-stopped"), (False, "peer-died")])
def test_a_solver_that_is_held_or_deadlocked_is_ended_and_told_apart(
    side: Callable, held: bool, failure: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pid, ask, wait = side(tmp_path / "side", monkeypatch)
    if held:
        os.kill(pid, signal.SIGSTOP)
    begin = time.monotonic()
    with pytest.raises(RunError) as caught:
        (ask if held else wait)()
    assert 0.6 <= time.monotonic() - begin < 5.0
    assert caught.value.failure == failure
    assert ADVICE[failure]
    assert not Path(f"/proc/{pid}").exists()


@pytest.mark.parametrize(("held", "failure"), [(True, "peer-stopped"), (False, "peer-died")])
def test_a_gas_step_that_is_held_or_hangs_is_ended_and_told_apart(held: bool, failure: str, tmp_path: Path) -> None:
    gas = RestartGas(setup(), tmp_path / "gas", time_limit=1.0)
    end = tmp_path / "gas" / f"{gas.setup.step:.9g}"
    end.mkdir()
    os.mkfifo(end / "p")  # DPMFoam waits for someone who reads what it writes
    holder = HOLDER if held else "pass"
    with subprocess.Popen([sys.executable, "-c", holder, str(tmp_path / "gas")]):
        begin = time.monotonic()
        with pytest.raises(RunError) as caught:
            gas.step(*NONE)
        assert time.monotonic() - begin < 10.0
    assert caught.value.failure == failure


#: Stops the solver that works in a folder.
HOLDER = """
import os, signal, sys, time
from pathlib import Path
while True:
    for link in Path("/proc").glob("[0-9]*/cwd"):
        try:
            if link.readlink() == Path(sys.argv[1]) and (link.parent / "comm").read_text().startswith("DPMFoam"):
                sys.exit(os.kill(int(link.parent.name), signal.SIGSTOP))
        except OSError:
            continue
    time.sleep(0.02)
"""


@pytest.mark.parametrize("held", [True, False])
def test_a_batch_run_says_whether_its_solver_was_held_at_the_limit(held: bool, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "in.wait")  # LIGGGHTS waits for its deck
    script = 'kill -STOP $$; exec "$@"' if held else 'exec "$@"'
    command = ("sh", "-c", script, "sh", "liggghts", "-in", "in.wait", "-log", "none")
    result = run_process(command, cwd=tmp_path, log=tmp_path / "log", timeout=1.0, grace=0.5)
    assert (result.status, result.stopped) == ("timed_out", held)
    assert result.wall_seconds < 1.0 + 3.0
    found = diagnose_liggghts(result, tmp_path / "log", tmp_path / "dump", 1, 1)
    assert found is not None
    assert found.code == "timed-out"
    assert ("SIGSTOP" in found.message) == held
