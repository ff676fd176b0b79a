"""What LIGGGHTS and DPMFoam need by themselves, and what the exchange adds: the parts behind bench_coupling.

*LIGGGHTS*: in one process and one bed, blocks of couplings in random order, each block once per round: as one single
``run`` under the held force; by `kncal.engines.liggghts.library_child` with all that it does per coupling; and the
same without its
looks at the overlaps. What is added to a coupling is the median over the rounds of the differences. The bed rests,
nine tenths of its weight taken off: it has its most contacts, and blocks differ in nothing else.

*DPMFoam*: the adapter tells the CPU time that it takes itself. `gas_pair` checks it from outside: a plain DPMFoam
beside a live one, with as many parcels for as many steps. Parcels cannot stand still in a plain DPMFoam unless they are
heavy, so in this pair both get parcels a million times too heavy for the gas to move; they push the gas back as ever.

Started with arguments it is the process that holds LIGGGHTS: python coupling_parts.py ROUNDS, in the deck's folder.
"""

from __future__ import annotations

import json
import mmap
import os
import random
import resource
import shutil
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kncal.core.checks import Array
from kncal.core.process import run_process, solver_environment
from kncal.engines.base import GasSetup
from kncal.engines.dpmfoam import adapter_build
from kncal.engines.dpmfoam.case import write_case
from kncal.engines.dpmfoam.forces import Exchange
from kncal.engines.dpmfoam.live import LiveGas
from kncal.engines.dpmfoam.programs import SOLVER, case_environment, make_mesh
from kncal.engines.liggghts import library_child as dem_child
from kncal.engines.liggghts.deck import DECK, bed_deck, write_deck
from kncal.engines.liggghts.impacts import Before
from kncal.engines.liggghts.library import middle, sides
from kncal.engines.settle import packing
from kncal.record.openfoam import write_parcel_constants, write_parcel_motion
from kncal.scene.case_file import load_case
from kncal.scene.model import Plan
from kncal.scene.placement import Start
from kncal.scene.plan import plan

#: Couplings in a block: short against the drift of a shared machine, long against the clock.
BLOCK = 5
#: Times the particles' density: their velocity changes by a millionth of what it would.
HEAVY = 1e6
_NEVER = 1_000_000_000


@dataclass(frozen=True)
class DemPair:
    """CPU seconds of LIGGGHTS' process: before its deck; per coupling by itself, added by looks, added by the rest."""

    start: float
    plain: float
    looks: float
    rest: float


def linear_model(case: str, seconds: float) -> Plan:
    """The linear model of a shipped bed, run for so long."""
    scene = load_case(case)
    return plan(replace(scene, run=replace(scene.run, until_time=seconds)), ("linear",))["linear"]


def shipped(case: str) -> Plan:
    """The linear model of a shipped bed as it is."""
    return plan(load_case(case), ("linear",))["linear"]


def settled(model: Plan) -> Array:
    """Start positions, kept between runs of the benchmark."""
    return packing(model, Path(tempfile.gettempdir()) / "kncal-bench-packings")


def library() -> Path:
    """The adapter; the benchmark ends here if it is not built."""
    found = adapter_build.find()
    if found is None:
        raise SystemExit("the adapter is not built: kncal adapter build")
    return found


def children_cpu() -> float:
    """CPU seconds of all child processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def own_cpu() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def dem_pair(model: Plan, x: Array, rounds: int) -> DemPair:
    """Compare the three modes in a bed that starts at ``x``."""
    with tempfile.TemporaryDirectory() as scratch:
        folder, scene = Path(scratch), model.scene
        write_deck(bed_deck(model, Start.at(x)), folder)
        layer, periodic = scene.front_back == "layer", scene.front_back == "periodic"
        given = {
            "deck": DECK,
            "saved": "",
            "diameter": scene.diameter,
            "dt": model.dt,
            "gravity": scene.g,
            "plane": middle(scene) if layer else None,
            "period": scene.box.depth if periodic else None,
            "sides": sides(scene),
            "count": scene.number,
            "steps": model.steps_per_coupling,
        }
        (folder / "given.json").write_text(json.dumps(given))
        environment = solver_environment() | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
        command = [sys.executable, "-P", str(Path(__file__).resolve()), str(rounds)]
        result = run_process(command, cwd=folder, log=folder / "log", env=environment, timeout=600.0)
        if result.returncode != 0:
            raise SystemExit(f"LIGGGHTS alone: {result.last_lines}")
        told = json.loads((folder / "told.json").read_text())
    plain, bare, full = (np.array([one[mode] for one in told["rounds"]]) for mode in ("plain", "bare", "full"))
    medians = (float(np.median(values)) for values in (plain, full - bare, bare - plain))
    return DemPair(told["start"], *medians)


def hold(rounds: int) -> None:
    """In the child: run the deck of this folder, then blocks of couplings, and tell the CPU seconds of a coupling."""
    given = json.loads(Path("given.json").read_text())
    count, steps = given["count"], given["steps"]
    shared = dem_child.Shared.over(mmap.mmap(-1, dem_child.Shared.size(count)), count)
    lib, often = Sighted(), dem_child.LOOK_EVERY
    start = own_cpu()
    child = Looking(lib, shared, given)
    shared.force[:, 2] = 0.9 * lib.masses.mean() * given["gravity"]
    child.run(steps)

    def block(mode: str) -> float:
        lib.looks, dem_child.LOOK_EVERY = mode == "full", often if mode == "full" else 1 << 30
        begin = time.thread_time()
        if mode == "plain":
            lib.command(f"run {BLOCK * steps} pre no post no")
        for _ in range(0 if mode == "plain" else BLOCK):
            json.dumps(child.run(steps) | child.publish())
        return (time.thread_time() - begin) / BLOCK

    told = [{mode: block(mode) for mode in random.sample(["plain", "bare", "full"], 3)} for _ in range(rounds)]
    Path("told.json").write_text(json.dumps({"start": start, "rounds": told}))
    lib.close()


class Sighted(dem_child.Library):
    """LIGGGHTS whose contacts can be left alone."""

    looks = True

    def contacts(self) -> Array:
        return super().contacts() if self.looks else np.empty((0, 4))


class Looking(dem_child.Child):
    """A child that can be kept from looking for new contacts."""

    def _before(self) -> Before | None:
        return super()._before() if self.lib.looks else None


def gas_pair(setup: GasSetup, x: Array, diameter: float, density: float, steps: int) -> tuple[float, float, float]:
    """CPU seconds per step of a live DPMFoam, of its adapter as told by itself, and of a plain DPMFoam beside it."""
    v, d, rho = np.zeros_like(x), np.full(len(x), diameter), np.full(len(x), HEAVY * density)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "plain"
        write_case(setup, folder, end_time=steps * setup.step, write_interval=_NEVER)
        make_mesh(folder)
        parcels = Exchange(setup).parcels(x, v, d, rho)
        write_parcel_constants(folder / "0", parcels.diameter, parcels.density, parcels.weight)
        write_parcel_motion(folder / "0", parcels.x, parcels.cell, parcels.v)
        with closing(LiveGas(setup, Path(scratch) / "live", library(), len(x))) as gas, ThreadPoolExecutor() as pool:
            mesh, log = gas.cpu_seconds, folder / "log"
            plain = pool.submit(run_process, [SOLVER], cwd=folder, log=log, env=case_environment(folder), timeout=600.0)
            for _ in range(steps):
                gas.step(x, v, d, rho)
            result = plain.result()
        done = log.read_text(encoding="utf-8", errors="replace").count("\nTime = ")
        if result.returncode != 0 or done != steps:
            raise SystemExit(f"plain DPMFoam: {done} of {steps} steps: {result.last_lines}")
    return (gas.cpu_seconds - mesh) / steps, gas.exchange_seconds / steps, result.cpu_seconds / steps


def restarts_alone(folder: Path, step: float, count: int) -> float:
    """CPU seconds per start of DPMFoam in the case ``folder`` as a run of `RestartGas` left it."""
    before = children_cpu()
    for _ in range(count):
        with (folder / "log.alone").open("wb") as log:
            pid = os.posix_spawn(
                str(shutil.which(SOLVER)),
                [SOLVER, "-noFunctionObjects", "-case", str(folder)],
                case_environment(folder),
                file_actions=[(os.POSIX_SPAWN_DUP2, log.fileno(), 1), (os.POSIX_SPAWN_DUP2, log.fileno(), 2)],
            )
        if os.waitpid(pid, 0)[1] != 0:
            raise SystemExit(f"{SOLVER} alone failed: see {folder / 'log.alone'}")
        shutil.rmtree(folder / f"{step:.9g}")
    return (children_cpu() - before) / count


class Watch:
    """CPU time and memory of this process and of its living children, by name, whenever it is looked at."""

    def __init__(self) -> None:
        self.cpu: dict[int, dict[str, float]] = {}
        self.peak: dict[str, float] = {}

    def __call__(self, number: int, _: int) -> None:
        ticks = os.sysconf("SC_CLK_TCK")
        cpu = {"exchange": time.process_time()}
        self.peak["exchange"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        children = Path("/proc/self/task").glob("*/children")
        for pid in (number for path in children for number in path.read_text().split()):
            name = "DPMFoam" if Path(f"/proc/{pid}/comm").read_text().strip() == SOLVER else "LIGGGHTS"
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            cpu[name] = (int(fields[11]) + int(fields[12])) / ticks
            status = Path(f"/proc/{pid}/status").read_text().split("VmHWM:")[1]
            self.peak[name] = int(status.split()[0]) / 1024.0
        self.cpu[number] = cpu


if __name__ == "__main__":
    hold(int(sys.argv[1]))
