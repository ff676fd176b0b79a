"""The live transport: the same numbers as the restart transport, and an end in every case."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from gas_columns import RHO, VOLUME, G, alike, needs_openfoam, packing, setup

from kncal.core import solver_process
from kncal.core.errors import InputError, RunError
from kncal.engines.base import GasSetup, GasSolver
from kncal.engines.dpmfoam import adapter_build, memory
from kncal.engines.dpmfoam.live import LiveGas
from kncal.engines.dpmfoam.restart import RestartGas
from kncal.record.steps import GasStep
from kncal.scene.gas import Jet

pytestmark = needs_openfoam

SOON = 5.0  # s in which the death of the other side must be noticed


@pytest.fixture(scope="session")
def adapter() -> Path:
    """The adapter of this machine, built once and then taken from the user's cache."""
    try:
        return adapter_build.build()
    except adapter_build.AdapterError as error:
        pytest.skip(f"no adapter: {error}")


class Toy:
    """Particles that fall and fly in the gas, and pass through each other; the walls hold them. Explicit Euler."""

    def __init__(self, column: GasSetup, seed: int = 0) -> None:
        self.column = column
        width, depth, height = column.size
        flat = column.front_back == "layer"
        self.x = packing((width, depth, 0.5 * height), seed)
        if flat:
            self.x[:, 1] = 0.5 * depth
        self.v = np.zeros_like(self.x)
        self.steps: list[GasStep] = []

    def advance(self, gas: GasSolver, couplings: int) -> None:
        dt = self.column.step
        for _ in range(couplings):
            step = gas.step(self.x, self.v, *alike(self.x))
            self.steps.append(step)
            self.v = self.v + dt * (step.force / (RHO * VOLUME) - np.array([0.0, 0.0, G]))
            self.x = np.clip(self.x + dt * self.v, 1e-4, np.array(self.column.size) - 1e-4)

    def remove(self, count: int) -> None:
        self.x, self.v = self.x[:-count].copy(), self.v[:-count].copy()

    def add(self, seed: int) -> None:
        more = Toy(self.column, seed)
        self.x, self.v = np.vstack([self.x, more.x]), np.vstack([self.v, more.v])


def same(a: list[GasStep], b: list[GasStep]) -> bool:
    """Whether two runs agree to the last bit, in everything that a step returns."""
    pairs = zip((astuple(step) for step in a), (astuple(step) for step in b), strict=True)
    return all(np.array_equal(one, other) for left, right in pairs for one, other in zip(left, right, strict=True))


def both(column: GasSetup, tmp_path: Path, adapter: Path, story: Callable[[GasSolver, Toy], None]) -> list[Toy]:
    """Play one story on each transport."""
    toys = []
    for gas in (LiveGas(column, tmp_path / "live", adapter, 2000), RestartGas(column, tmp_path / "restart")):
        toy = Toy(column)
        with closing(gas):
            story(gas, toy)
        toys.append(toy)
    return toys


def test_the_transports_agree_to_the_last_bit_over_22_couplings(tmp_path: Path, adapter: Path) -> None:
    fields = []

    def story(gas: GasSolver, toy: Toy) -> None:
        gas.set_inlet(0.31)
        toy.advance(gas, 10)
        gas.set_inlet(0.7123456789012345)
        toy.advance(gas, 6)
        toy.remove(100)
        toy.advance(gas, 3)
        toy.add(seed=5)
        toy.advance(gas, 3)
        fields.append(gas.fields())

    live, restart = both(setup(), tmp_path, adapter, story)
    assert len(live.steps) == 22
    numbers = [len(step.force) for step in live.steps]
    assert numbers[15] - 100 == numbers[18] < numbers[19] == 2 * numbers[15] - 100
    assert same(live.steps, restart.steps)
    assert all(np.array_equal(a, b) for a, b in zip(astuple(fields[0]), astuple(fields[1]), strict=True))
    assert np.array_equal(live.x, restart.x)
    # Not because nothing happens: particles were carried along, and the gas reacted to the inlet.
    assert np.abs(live.v).max() > 1e-2
    assert live.steps[11].p_in > 1.2 * live.steps[9].p_in


VARIANTS = {
    "layer with a jet": {
        "cells": (6, 1, 10),
        "front_back": "layer",
        "walls": "noSlip",
        "inlet": 0.0,
        "jet": Jet(x_low=0.006, x_high=0.012, velocity=5.0),
        "step": 1e-4,
    },
    "periodic, 8 parcels": {"front_back": "periodic", "parcels_per_particle": 8},
    "27 parcels, the other drag law": {"parcels_per_particle": 27, "drag": "PlessisMasliyah", "cells": (3, 2, 6)},
}


@pytest.mark.parametrize("name", VARIANTS)
def test_the_transports_agree_in_every_kind_of_column(name: str, tmp_path: Path, adapter: Path) -> None:
    def story(gas: GasSolver, toy: Toy) -> None:
        toy.advance(gas, 3)
        gas.set_inlet(1.9 * (0.3 if gas.setup.jet is None else 5.0))
        toy.advance(gas, 3)

    live, restart = both(setup(**VARIANTS[name]), tmp_path, adapter, story)
    assert same(live.steps, restart.steps)
    assert live.steps[-1].p_in != live.steps[2].p_in


def test_either_transport_goes_on_from_what_the_other_saved(tmp_path: Path, adapter: Path) -> None:
    column = setup()
    whole = Toy(column)
    with closing(LiveGas(column, tmp_path / "whole", adapter, 1000)) as gas:
        whole.advance(gas, 4)
        gas.save(tmp_path / "by_live")
        x, v = whole.x, whole.v
        whole.advance(gas, 4)
    with closing(RestartGas(column, tmp_path / "first")) as gas:
        Toy(column).advance(gas, 4)
        gas.save(tmp_path / "by_restart")
    for number, (saved, live) in enumerate((a, b) for a in ("by_live", "by_restart") for b in (True, False)):
        folder = tmp_path / f"second_{number}"
        second = LiveGas(column, folder, adapter, 1000) if live else RestartGas(column, folder)
        toy = Toy(column)
        toy.x, toy.v = x, v
        with closing(second):
            second.load(tmp_path / saved)
            toy.advance(second, 4)
        assert same(toy.steps, whole.steps[4:]), f"saved {saved}, continued by {type(second).__name__}"


def test_state_can_be_taken_up_and_given_only_when_there_is_one(tmp_path: Path, adapter: Path) -> None:
    column = setup()
    with closing(LiveGas(column, tmp_path / "case", adapter, 1000)) as gas:
        for ask in (lambda: gas.save(tmp_path / "state"), gas.fields):
            with pytest.raises(RunError, match="before the first"):
                ask()
        Toy(column).advance(gas, 1)
        gas.save(tmp_path / "state")
        with pytest.raises(RunError, match="only be loaded before the first"):
            gas.load(tmp_path / "state")


def test_a_column_without_particles(tmp_path: Path, adapter: Path) -> None:
    column, none = setup(), np.zeros((0, 3))
    with closing(LiveGas(column, tmp_path / "case", adapter, 0)) as gas:
        steps = [gas.step(none, none, *alike(none)) for _ in range(3)]
        U = gas.fields().U
    assert steps[-1].force.shape == (0, 3)
    assert steps[-1].eps_g_min == 1.0
    # Uniform flow between slip walls stays as it is, and only the weight of the gas hangs on the inlet.
    np.testing.assert_allclose(U[..., 2], column.inlet, rtol=1e-4)  # the solver's tolerance for p is 1e-6
    half_a_cell = 0.5 / column.cells[2]
    weight = column.density * column.gravity * column.size[2]
    assert steps[-1].p_in == pytest.approx(weight, rel=1.1 * half_a_cell)


def test_two_at_once_do_not_disturb_each_other(tmp_path: Path, adapter: Path) -> None:
    column = setup()
    alone, *pair = Toy(column), Toy(column), Toy(column, seed=3)
    with closing(LiveGas(column, tmp_path / "alone", adapter, 1000)) as gas:
        alone.advance(gas, 4)
    with (
        closing(LiveGas(column, tmp_path / "a", adapter, 1000)) as a,
        closing(LiveGas(column, tmp_path / "b", adapter, 1000)) as b,
    ):
        for _ in range(4):
            pair[0].advance(a, 1)
            pair[1].advance(b, 1)
    assert same(pair[0].steps, alone.steps)
    assert not same(pair[1].steps, alone.steps)


def test_what_was_used_is_given_back(tmp_path: Path, adapter: Path) -> None:
    before = _open_files()
    gas = LiveGas(setup(), tmp_path / "case", adapter, 1000)
    toy = Toy(gas.setup)
    costs = [gas.cpu_seconds]
    for _ in range(3):
        toy.advance(gas, 5)
        costs.append(gas.cpu_seconds)
    pid = _pid(gas)
    # The memory between the two has no name that could stay behind.
    assert all(_shared_memory(process) == {"/memfd:kncal-exchange"} for process in (pid, os.getpid()))
    gas.close()
    gas.close()
    costs.append(gas.cpu_seconds)
    assert costs == sorted(costs)
    assert costs[-1] > costs[0] > 0.0
    assert _open_files() == before
    assert not _shared_memory(os.getpid())
    assert not _alive(pid)
    with pytest.raises(RunError, match="closed"):
        toy.advance(gas, 1)
    assert "End" in (tmp_path / "case" / "log.DPMFoam").read_text().splitlines()


def test_the_log_stays_short(tmp_path: Path, adapter: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limit, slack = 20_000, 10_000  # one step writes about 3 kB
    monkeypatch.setattr(solver_process, "_LOG_LIMIT", limit)
    with closing(LiveGas(setup(), tmp_path / "case", adapter, 1000)) as gas:
        toy = Toy(gas.setup)
        sizes = []
        for _ in range(20):
            toy.advance(gas, 1)
            sizes.append((tmp_path / "case" / "log.DPMFoam").stat().st_size)
    assert sum(np.diff(sizes) < 0) >= 1
    assert max(sizes) < limit + slack
    assert (tmp_path / "case" / "log.DPMFoam.before").stat().st_size < limit + slack


# What can go wrong


def test_too_many_particles_are_refused_and_the_run_goes_on(tmp_path: Path, adapter: Path) -> None:
    column = setup(parcels_per_particle=8)
    toy = Toy(column)
    with closing(LiveGas(column, tmp_path / "case", adapter, len(toy.x))) as gas:
        toy.advance(gas, 1)
        crowd = np.vstack([toy.x, toy.x[:1]])
        with pytest.raises(InputError, match=f"n_max = {len(toy.x)}"):
            gas.step(crowd, np.zeros_like(crowd), *alike(crowd))
        toy.advance(gas, 1)


def test_a_missing_library_is_named(tmp_path: Path) -> None:
    with pytest.raises(adapter_build.AdapterError, match="kncal adapter build"):
        LiveGas(setup(), tmp_path / "case", tmp_path / adapter_build.LIBRARY, 10)
    assert not (tmp_path / "case").exists()


def test_a_library_that_cannot_be_loaded_is_named(tmp_path: Path) -> None:
    library = tmp_path / adapter_build.LIBRARY
    library.write_bytes(b"this is no library")
    with (
        closing(LiveGas(setup(), tmp_path / "case", library, 1000)) as gas,
        _within(SOON),
        pytest.raises(adapter_build.AdapterError, match="without the adapter"),
    ):
        Toy(gas.setup).advance(gas, 1)


def test_an_adapter_of_another_version_is_refused_with_its_own_words(
    tmp_path: Path, adapter: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "VERSION", memory.VERSION + 1)
    with (
        closing(LiveGas(setup(), tmp_path / "case", adapter, 1000)) as gas,
        pytest.raises(RunError, match="the two sides disagree"),
    ):
        Toy(gas.setup).advance(gas, 1)


def test_a_floating_point_exception_is_told_in_the_solvers_own_words(tmp_path: Path, adapter: Path) -> None:
    with closing(LiveGas(setup(), tmp_path / "case", adapter, 1000)) as gas:
        toy = Toy(gas.setup)
        toy.advance(gas, 1)
        toy.v[:, 2] = 1e200  # its square is beyond all numbers
        with _within(SOON), pytest.raises(RunError, match=r"floating-point exception.*sigFpe"):
            toy.advance(gas, 1)


def test_a_killed_solver_is_noticed(tmp_path: Path, adapter: Path) -> None:
    before = _open_files()
    gas = LiveGas(setup(), tmp_path / "case", adapter, 1000)
    toy = Toy(gas.setup)
    toy.advance(gas, 2)
    os.kill(_pid(gas), signal.SIGKILL)
    with _within(SOON), pytest.raises(RunError, match=r"DPMFoam failed, signal 9: .*log\.DPMFoam"):
        toy.advance(gas, 1)
    with pytest.raises(RunError, match="closed"):
        toy.advance(gas, 1)
    assert gas.cpu_seconds > 0.0
    gas.close()
    assert _open_files() == before


def test_a_solver_that_died_before_the_end_is_told_at_the_end(tmp_path: Path, adapter: Path) -> None:
    gas = LiveGas(setup(), tmp_path / "case", adapter, 1000)
    Toy(gas.setup).advance(gas, 1)
    os.kill(_pid(gas), signal.SIGKILL)
    with _within(SOON), pytest.raises(RunError, match="signal 9"):
        gas.close()
    gas.close()


def test_a_solver_that_hangs_is_given_up_after_the_limit(
    tmp_path: Path, adapter: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gas = LiveGas(setup(), tmp_path / "case", adapter, 1000)
    toy = Toy(gas.setup)
    toy.advance(gas, 1)  # a start may take longer on a busy machine
    monkeypatch.setattr(gas, "_time_limit", 1.0)
    pid = _pid(gas)
    os.kill(pid, signal.SIGSTOP)
    with _within(SOON), pytest.raises(RunError, match="within 1 s"):
        toy.advance(gas, 1)
    assert not _alive(pid)


def test_ctrl_c_while_waiting_ends_the_solver(tmp_path: Path, adapter: Path) -> None:
    gas = LiveGas(setup(), tmp_path / "case", adapter, 1000)
    toy = Toy(gas.setup)
    toy.advance(gas, 1)
    pid = _pid(gas)
    os.kill(pid, signal.SIGSTOP)
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    signal.setitimer(signal.ITIMER_REAL, 0.2)
    try:
        with _within(SOON), pytest.raises(KeyboardInterrupt):
            toy.advance(gas, 1)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert not _alive(pid)
    gas.close()


ORPHAN = """
import os, signal, sys, time
from pathlib import Path
from gas_columns import setup
from test_live import Toy, _pid
from kncal.engines.dpmfoam.live import LiveGas
gas = LiveGas(setup(), Path(sys.argv[1]), Path(sys.argv[2]), 1000)
if sys.argv[3] == "before the first step":
    gas._running()
else:
    Toy(gas.setup).advance(gas, 2)
helper = os.fork() if sys.argv[3] == "with an heir" else None
if helper == 0:
    os.closerange(0, 3)
    time.sleep(60)  # inherits the socket, so it does not close with the parent
    os._exit(0)
print(_pid(gas), helper or 0, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("how", ["guarded", "unguarded", "before the first step", "with an heir"])
def test_the_solver_ends_with_kncal(how: str, tmp_path: Path, adapter: Path) -> None:
    """With setpriv the kernel ends it; without, it sees the socket close, or that it has another parent."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    if how != "guarded":
        programs = tmp_path / "programs"
        programs.mkdir()
        for name in ("DPMFoam", "blockMesh"):
            (programs / name).symlink_to(f"/usr/bin/{name}")
        environment["PATH"] = str(programs)
    command = [sys.executable, "-c", ORPHAN, str(tmp_path / "case"), str(adapter), how]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr
    solver, helper = map(int, done.stdout.split())
    try:
        deadline = time.monotonic() + SOON
        while _alive(solver) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not _alive(solver)
        if how != "guarded":
            assert "the particle side has gone" in (tmp_path / "case" / "log.DPMFoam").read_text()
    finally:
        if helper:
            os.kill(helper, signal.SIGKILL)


def _pid(gas: LiveGas) -> int:
    assert gas._solver is not None
    return gas._solver.pid


def _alive(pid: int) -> bool:
    """Whether a process is there and no zombie (whose parent has not collected it)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def _open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def _shared_memory(pid: int) -> set[str]:
    """Files in memory that a process has mapped."""
    lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    return {line.split()[5] for line in lines if "/memfd:" in line or "/dev/shm/" in line}  # noqa: S108


@contextmanager
def _within(seconds: float) -> Iterator[None]:
    begin = time.monotonic()
    yield
    assert time.monotonic() - begin < seconds
