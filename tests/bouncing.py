"""Sweeps of a bead that bounces on and on, so that runs last as long as wanted; and a look at their processes."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from kncal.study import Settings, Sweep, combine, design, grid_axis, read_sweep

#: Seconds that anything is waited for.
LIMIT = 90.0
#: LIGGGHTS takes about a second for SHORT and minutes for ENDLESS.
SHORT, ENDLESS = 20.0, 4000.0

_LID = '\n[walls.lid]\naxis = "z"\nposition = 0.0021\nmaterial = "rigid"\n'


def bounce(case: Path) -> Path:
    """Put a lid over the bead of the case and take no energy from it."""
    case.write_text(case.read_text().replace("e_n = 0.9", "e_n = 1.0") + _LID)
    return case


def designed(case: Path, *times: float) -> tuple[Sweep, str]:
    axes = [f"run.until_time={','.join(map(str, times))}", "run.record_every=1000"]
    return design(case, combine([grid_axis(axis) for axis in axes]), Settings(engine="liggghts", models=("linear",)))


def attempts(out: Path) -> dict[float, int]:
    """End time of a run -> how often it was begun."""
    table = read_sweep(out).set_index("id")
    return {
        float(table.loc[run.name, "run.until_time"]): 1 + len(list(run.glob("attempt-*")))
        for run in (out / "runs").iterdir()
    }


def alive(pid: int) -> bool:
    """Whether a process is there and no zombie."""
    try:
        return _stat(pid)[0] != "Z"
    except OSError:
        return False


def parent(pid: int) -> int:
    return int(_stat(pid)[1])


def solver_of(run: Path) -> int | None:
    """The process that works in a run's folder, once it is LIGGGHTS itself."""
    for link in Path("/proc").glob("[0-9]*/cwd"):
        pid = int(link.parent.name)
        try:
            if link.readlink().is_relative_to(run) and "liggghts" in (link.parent / "exe").readlink().name:
                return pid if alive(pid) else None
        except OSError:
            continue  # it has ended, or is not ours
    return None


def solvers(out: Path) -> list[int]:
    """The processes that work in any run of a sweep."""
    return [pid for run in out.glob("runs/*") if (pid := solver_of(run)) is not None]


def wait_until(what: Callable[[], object], limit: float = LIMIT) -> None:
    deadline = time.monotonic() + limit
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def _stat(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
