"""What a sweep costs beyond its runs, and how long a look at a large one takes.

Run: python tests/benchmarks/bench_sweep.py [runs] [looked-at runs]

Overhead: the same trivial runs (builtin engine, both models, some twenty steps) as a sweep and as a bare loop of what
`kncal compare` does, each half the runs and in turns, since the speed of a shared machine drifts; printed are wall and
CPU time per run. Target: at most 20 ms more in the sweep. One worker, so that the wall times compare.
Status: `sweep_status` of a made-up sweep, with its notes and without. Target: at most 1 s.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from kncal.engines.base import run_result
from kncal.engines.registry import get_engine
from kncal.observe.compare import compare
from kncal.runs.folder import write_result
from kncal.runs.workflow import load_both, run_case
from kncal.scene.case_file import load_case
from kncal.scene.plan import plan
from kncal.study import Settings, ThreadExecutor, combine, design, grid_axis, run_sweep, sweep_status
from kncal.study.design import run_folder, write_design
from kncal.study.states import STATES, StatesFile, read_state, stamps_of

CASE = """
[materials.glass]
young = 1e7
poisson = 0.25
density = 2500.0

[particles.bead]
material = "glass"
diameter = 0.002
position = [0.0, 0.0, 0.001001]
velocity = [0.0, 0.0, -1.0]

[walls.floor]
axis = "z"
position = 0.0
material = "rigid"

[contact]
e_n = 0.9
v_0 = 1.0

[run]
steps_per_contact = 20
until_time = 0.0002
"""
_BATCHES = 10


def speeds(number: int, offset: int = 0) -> str:
    """``number`` values of contact.v_0, none of them in another batch."""
    return "contact.v_0=" + ",".join(repr(1.0 + 1e-6 * (offset + i)) for i in range(number))


def as_sweep(case: Path, number: int, offset: int, folder: Path) -> None:
    """One sweep from its arguments to its table."""
    points = combine([grid_axis(speeds(number, offset))])
    made, text = design(case, points, Settings(engine="builtin"))
    result = run_sweep(made, text, folder, ThreadExecutor(1))
    if result.completed != number:
        raise SystemExit(f"{result.failures}")


def bare(case: Path, number: int, offset: int, folder: Path) -> None:
    """The same runs one after the other."""
    for i in range(number):
        scene = load_case(case, overrides=[f"contact.v_0={1.0 + 1e-6 * (offset + i)!r}"])
        run_case(scene, get_engine("builtin"), folder / str(i))
        compare(*load_both(folder / str(i)))


def timed(action: Callable[..., None], *arguments: object) -> tuple[float, float]:
    """Wall and CPU seconds."""
    wall, cpu = time.perf_counter(), time.process_time()
    action(*arguments)
    return time.perf_counter() - wall, time.process_time() - cpu


def overhead(case: Path, runs: int, scratch: Path) -> None:
    """Print what a run costs in a sweep and by itself [ms]; the medians over the batches, and those of the pairs."""
    size = max(runs // _BATCHES, 1)
    pairs = []
    for batch in range(_BATCHES):
        both = {
            action: timed(action, case, size, batch * size, scratch / f"{action.__name__}{batch}")
            for action in ((as_sweep, bare) if batch % 2 else (bare, as_sweep))
        }
        pairs.append([1e3 / size * value for action in (as_sweep, bare) for value in both[action]])
    columns = list(zip(*pairs, strict=True))
    for name, swept, alone in (("wall", columns[0], columns[2]), ("CPU", columns[1], columns[3])):
        more = [s - b for s, b in zip(swept, alone, strict=True)]
        print(
            f"{name:5s} sweep {statistics.median(swept):7.2f}  bare {statistics.median(alone):7.2f}  "
            f"more {statistics.median(more):6.2f} ms per run  ({runs} runs, batches of {size})"
        )
    wall, cpu = timed(as_sweep, case, runs, _BATCHES * size, scratch / "whole")
    print(f"one sweep of {runs}: wall {1e3 * wall / runs:.2f}, CPU {1e3 * cpu / runs:.2f} ms per run")


def status(case: Path, runs: int, scratch: Path) -> None:
    """Print how long the status of a sweep of ``runs`` takes [s]: nine tenths completed, the rest failed."""
    models = plan(load_case(case))
    made, text = design(case, combine([grid_axis(speeds(20))]), Settings(engine="builtin"))
    ids = [f"{i:012x}" for i in range(runs)]
    made = made.model_copy(update={"runs": {run: next(iter(made.runs.values())) for run in ids}})
    folder = scratch / "status"
    folder.mkdir()
    write_design(folder, made, text)
    notes = []
    first = run_folder(folder, ids[0])
    for kind, model in models.items():
        (first / kind).mkdir(parents=True)
        write_result(run_result("builtin", model, first / kind, "completed"))
    for i, run in enumerate(ids):
        out = run_folder(folder, run)
        for kind in models:
            (out / kind).mkdir(parents=True, exist_ok=True)
            record = (first / kind / "result.json").read_text()
            if i % 10 == 9:
                record = record.replace('"completed"', '"failed"')
            (out / kind / "result.json").write_text(record)
        notes.append({"id": run, **read_state(made, out, stamps_of(made, out))})
    StatesFile(folder, notes).close()
    for what in ("with its notes", "without"):
        seen = [timed(lambda: print(end="") if sweep_status(folder).counts else None) for _ in range(5)]
        wall, cpu = (statistics.median(values) for values in zip(*seen, strict=True))
        print(f"status of {runs} runs {what}: wall {wall:.2f}, CPU {cpu:.2f} s  {dict(sweep_status(folder).counts)}")
        (folder / STATES).unlink(missing_ok=True)


def main() -> None:
    """Print both."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    looked_at = int(sys.argv[2]) if len(sys.argv) > 2 else 10_000
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        case = scratch / "tiny" / "case.toml"
        case.parent.mkdir()
        case.write_text(CASE)
        bare(case, 5, 10**6, scratch / "warm")
        as_sweep(case, 5, 10**6, scratch / "warm-sweep")
        overhead(case, runs, scratch)
        status(case, looked_at, scratch)


if __name__ == "__main__":
    main()
