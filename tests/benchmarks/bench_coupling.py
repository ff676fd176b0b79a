"""What the exchange between gas and particles costs: CPU time of all processes, ratios of paired runs.

Run: python tests/benchmarks/bench_coupling.py [mini|restart|jet|overlaps|growth]      (without a word: all of them)

mini      bubbling_bed_mini, live, 0.12 s: the exchange is all that is neither DPMFoam's own solve nor LIGGGHTS' own
          stepping. Target: at most 10 % of the run; the start of the processes is scaled to the shipped length.
restart   the same bed with DPMFoam started anew for each coupling, against as many starts of it alone in the same
          folder. Target: at most 20 % more, without the start of the Python processes.
jet       bubbling_bed, live, 37 DEM steps per coupling, 0.3 s. Targets: at most 1.10 times what the two solvers need by
          themselves, and 60 CPU s per simulated second where LIGGGHTS needs 0.16 µs per particle and step.
overlaps  the share of the looks at overlaps and new contacts in the DEM time. Target: at most 10 %.
growth    3000 to 100 000 particles on a lattice in wider and wider columns: slope of the cost, memory. Target: linear.

What the exchange adds inside LIGGGHTS' process and inside DPMFoam is measured as coupling_parts.py says, close together
and as medians, since the speed of a shared machine drifts. The solvers' own cost is that of the run minus that.
"""

from __future__ import annotations

import json
import math
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from coupling_parts import (
    Watch,
    children_cpu,
    dem_pair,
    gas_pair,
    linear_model,
    restarts_alone,
    settled,
    shipped,
)

from kncal.engines.base import GasSolver, Progress, gas_setup
from kncal.engines.coupled import GAS, Coupled
from kncal.engines.dpmfoam.live import LiveGas
from kncal.scene.model import Plan
from kncal.scene.placement import Start, lattice
from kncal.scene.plan import plan

ROUNDS = 3


def split(case: str, seconds: float) -> dict[str, float]:
    """CPU seconds of live runs of ``case``, by part; and what they did."""
    model = linear_model(case, seconds / ROUNDS)
    x, setup, group = settled(model), gas_setup(model), model.scene.group
    assert setup is not None
    dems, runs = [], []
    for _ in range(ROUNDS):
        dems.append(dem_pair(model, x, 12))
        runs.append(one_run("live", model, x))
    looks, rest, start = (statistics.median(getattr(dem, name) for dem in dems) for name in ("looks", "rest", "start"))
    total = {name: sum(run[name] for run in runs) for name in runs[0]}
    n, whole_run = total["couplings"], shipped(case).couplings
    added = {  # CPU seconds per coupling
        "looks at overlaps": looks,
        "rest of LIGGGHTS' process": rest,
        "adapter in DPMFoam": total["adapter"] / n,
        "Python loop": total["loop"] / n,
    }
    once = start + (total["exchange"] - total["loop"]) / ROUNDS
    own = {
        "LIGGGHTS": (total["dem"] - ROUNDS * start) / n - looks - rest,
        "DPMFoam": (total["gas"] - total["adapter"]) / n,
    }
    exchange, alone = sum(added.values()), sum(own.values())
    print(
        f"{case}, live: {n:.0f} couplings of {model.coupling:.4g} s = {model.steps_per_coupling} DEM steps, "
        f"{group.number} particles, {math.prod(setup.cells)} cells; CPU ms per coupling"
    )
    for name, value in own.items():
        print(f"  {name + ', by itself':30s} {1e3 * value:8.3f}  {value / (alone + exchange):6.1%}")
    for name, value in added.items():
        print(f"  + {name:28s} {1e3 * value:8.3f}  {value / (alone + exchange):6.1%}")
    print(f"  {'exchange':30s} {1e3 * exchange:8.3f}  {exchange / (alone + exchange):6.1%}")
    print(f"  all over the two solvers by themselves: {1.0 + exchange / alone:.3f}")
    share = (once + whole_run * exchange) / (once + whole_run * (exchange + alone))
    print(
        f"  {once:.2f} s once for the start of both Python processes; share of the exchange in the shipped run of "
        f"{whole_run} couplings, start included: {share:.1%}"
    )
    per_step = own["LIGGGHTS"] / (model.steps_per_coupling * group.number)
    print(f"  LIGGGHTS by itself: {1e6 * per_step:.3f} µs per particle and step")
    seconds = n * model.coupling
    return {name: total[name] / seconds for name in ("dem", "gas", "exchange")} | {"per_step": per_step}


def one_run(
    transport: str, model: Plan, x: np.ndarray, keep: Path | None = None, progress: Progress | None = None
) -> dict[str, float]:
    """CPU seconds of the particles' process, of OpenFOAM's, and of this one, for one run of ``model``."""
    engine = Watched(transport)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) if keep is None else keep
        before, children = time.process_time(), children_cpu()
        result = engine.run(model, folder / "run", start=x, progress=progress)
        mine, theirs = time.process_time() - before, children_cpu() - children
    if result.status != "completed":
        raise SystemExit(f"{model.scene.name}: {result.message}")
    gas = engine.gas
    assert gas is not None
    adapter = gas.exchange_seconds if isinstance(gas, LiveGas) else 0.0
    return {
        "dem": theirs - gas.cpu_seconds,
        "gas": gas.cpu_seconds,
        "adapter": adapter,
        "exchange": mine,
        "loop": float(result.extra["cpu_exchange"]),
        "couplings": float(model.couplings),
    }


class Watched(Coupled):
    """The engine, which lets its gas side be asked afterwards."""

    gas: GasSolver | None = None

    def _gas(self, plan: Plan, folder: Path, pass_fds: Sequence[int]) -> GasSolver | None:
        self.gas = super()._gas(plan, folder, pass_fds)
        return self.gas


def mini() -> None:
    split("bubbling_bed_mini", 0.12)
    told_by_the_adapter("bubbling_bed_mini")


def told_by_the_adapter(case: str) -> None:
    """Check the adapter's own account by a plain DPMFoam that runs beside."""
    model = linear_model(case, 0.1)
    setup, scene = gas_setup(model), model.scene
    assert setup is not None
    x = settled(model)
    pairs = [gas_pair(setup, x, scene.diameter, scene.density, 100) for _ in range(2 * ROUNDS)]
    live, adapter, difference = (
        1e3 * statistics.median(values) for values in zip(*((a, b, a - c) for a, b, c in pairs), strict=True)
    )
    print(
        f"  check, particles at rest: live DPMFoam {live:.2f} ms per step, {difference:.2f} ms more than a plain one "
        f"beside it; the adapter tells {adapter:.2f} ms"
    )


def jet() -> None:
    run = split("bubbling_bed", 0.3)
    told_by_the_adapter("bubbling_bed")
    per_second = run["dem"] + run["gas"] + run["exchange"]
    print(
        f"  {per_second:.1f} CPU s per simulated second: LIGGGHTS {run['dem']:.1f}, DPMFoam {run['gas']:.1f}, Python "
        f"{run['exchange']:.1f}; target {60.0 * run['per_step'] / 0.16e-6:.0f} (60 at 0.16 µs)"
    )


def restart() -> None:
    model = linear_model("bubbling_bed_mini", 0.04)
    x = settled(model)
    pair = dem_pair(model, x, 20)
    with tempfile.TemporaryDirectory() as scratch:
        case, alone, aside = Path(scratch) / "run" / GAS, [], []

        def start_alone(*_: int) -> None:
            """After each coupling: the same start once more, by itself, in the same folder."""
            begin = time.process_time()
            alone.append(restarts_alone(case, model.coupling, 1))
            aside.append(time.process_time() - begin)

        run = one_run("restart", model, x, Path(scratch), start_alone)
    n, added = run["couplings"], pair.looks + pair.rest
    gas, loop, start = run["gas"] / n, (run["loop"] - sum(aside)) / n, sum(alone) / n
    print(
        f"bubbling_bed_mini, restart, {n:.0f} couplings: DPMFoam {gas * 1e3:.1f} ms, Python {loop * 1e3:.1f} ms, in "
        f"LIGGGHTS' process {added * 1e3:.1f} ms per coupling; a start alone {start * 1e3:.1f} ms\n"
        f"  ratio {(gas + loop + added) / start:.3f}, target 1.20"
    )


def overlaps() -> None:
    for case in random.sample(["bubbling_bed_mini", "bubbling_bed"], 2):
        model = linear_model(case, 0.1)
        pair = dem_pair(model, settled(model), 50)
        print(
            f"{case}: {1e3 * pair.plain:.2f} ms per coupling; looks at overlaps + {pair.looks / pair.plain:.1%} "
            f"(target 10 %), all else that its process does + {pair.rest / pair.plain:.1%}"
        )


def growth() -> None:
    """Each number of particles in a process of its own, so that peaks of memory are its own."""
    rows = []
    for layout in ((10, 2), (11, 6), (20, 10), (37, 18)):
        command = [sys.executable, __file__, "grown", *map(str, layout)]
        rows.append(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout))
        row = rows[-1]
        parts = ", ".join(f"{name} {1e3 * value:.1f}" for name, value in row["cpu"].items())
        peaks = ", ".join(f"{name} {value:.0f}" for name, value in row["peak"].items())
        print(f"{row['count']:7d} particles, {row['cells']:6d} cells: CPU ms per coupling: {parts}; peak MB: {peaks}")
    n = np.array([row["count"] for row in rows])
    names = sorted(rows[0]["cpu"])
    for title, key in (("cost", "cpu"), ("memory", "peak")):
        values = {name: np.array([row[key][name] for row in rows]) for name in names}
        values["all processes"] = np.sum(list(values.values()), axis=0)
        for name, value in values.items():
            if key == "cpu":
                told = f"slope of log cost over log n {np.polyfit(np.log(n), np.log(value), 1)[0]:.2f}"
            else:
                told = f"{1e3 * np.polyfit(n, value, 1)[0]:.2f} MB per 1000 particles"
            print(f"  {title:6s} {name:14s} {told}")


def grown(nx: int, ny: int) -> None:
    """One size: cells and column grow together, so do the particles; some couplings from the lattice."""
    small = linear_model("bubbling_bed_mini", 0.01).scene
    box, gas = small.box, small.gas
    assert gas is not None
    a, b = nx / gas.cells[0], ny / gas.cells[1]
    cells = (nx, ny, gas.cells[2])
    scene = replace(small, gas=replace(gas, cells=cells)).with_box(size=(a * box.width, b * box.depth, box.height))
    scene = scene.with_group(count=round(a * b * small.number), place="lattice")
    model = replace(plan(scene, ("linear",))["linear"], couplings=12)
    watch = Watch()
    with tempfile.TemporaryDirectory() as scratch:
        result = Coupled("live").run(model, Path(scratch) / "run", start=Start.at(lattice(scene)), progress=watch)
    if result.status != "completed":
        raise SystemExit(result.message)
    first, last = 2, model.couplings  # the first couplings start the gas
    cpu = {name: (watch.cpu[last][name] - watch.cpu[first][name]) / (last - first) for name in watch.cpu[last]}
    told = {"count": scene.number, "cells": math.prod(cells), "cpu": cpu, "peak": watch.peak}
    print(json.dumps(told))


if __name__ == "__main__":
    parts = {"mini": mini, "restart": restart, "jet": jet, "overlaps": overlaps, "growth": growth}
    if sys.argv[1:2] == ["grown"]:
        grown(*map(int, sys.argv[2:4]))
    else:
        for word in sys.argv[1:] or parts:
            if word not in parts:
                raise SystemExit(f"{word}: expected some of {', '.join(parts)}")
            parts[word]()
