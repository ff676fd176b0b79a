"""LIGGGHTS as the particle side of a coupled bed: how it ends, what it tells, and what it refuses."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from beds import model, scene, still

from kncal.core.errors import InputError, RunError
from kncal.engines.liggghts import library as dem_module
from kncal.engines.liggghts.library import LOG, LiggghtsDem
from kncal.scene.groups import AT_REST
from kncal.scene.placement import Start, lattice

solver = pytest.mark.solver


def gone(pid: int) -> bool:
    """Whether no such process runs (one that nobody collected yet does not)."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return True
    return state == "Z"


@pytest.fixture
def nothing_left() -> object:
    """Neither descriptors nor shared memory of this process remain."""

    def seen() -> tuple[int, int]:
        return len(os.listdir("/proc/self/fd")), len([p for p in os.listdir("/dev/shm") if "vader" in p])  # noqa: PTH208, S108

    before = seen()
    yield
    assert seen() == before


@solver
def test_kill_is_noticed_at_once(tmp_path: Path, nothing_left: object) -> None:
    bed = scene(400)
    dem = LiggghtsDem(model(bed), tmp_path, Start.at(lattice(bed)))
    pid = dem.pid
    assert pid is not None
    threading.Timer(0.5, os.kill, (pid, signal.SIGKILL)).start()
    begin = time.monotonic()
    with pytest.raises(RunError, match=rf"SIGKILL.*{LOG}"):
        dem.run(500_000, still(bed))
    assert time.monotonic() - begin < 5.0
    assert gone(pid)
    with pytest.raises(RunError, match="has ended"):
        dem.run(1, still(bed))
    assert dem.cpu_seconds > 0.1
    dem.close()
    dem.close()


@solver
def test_a_hanging_child_is_ended(tmp_path: Path, nothing_left: object, monkeypatch: pytest.MonkeyPatch) -> None:
    bed = scene(50)
    dem = LiggghtsDem(model(bed), tmp_path, Start.at(lattice(bed)))
    pid = dem.pid
    assert pid is not None
    monkeypatch.setattr(dem_module, "_RUN_LIMIT", 1.0)
    os.kill(pid, signal.SIGSTOP)
    with pytest.raises(RunError, match=r"within 1(\.03)? s"):
        dem.run(10, still(bed))
    assert gone(pid)


@solver
def test_a_run_that_a_signal_cut_short_does_not_count(tmp_path: Path, nothing_left: object) -> None:
    """LIGGGHTS answers SIGTERM by an early end of the run, as if nothing had happened; the next run ends it."""
    bed = scene(400)
    dem = LiggghtsDem(model(bed), tmp_path, Start.at(lattice(bed)))
    pid = dem.pid
    assert pid is not None
    threading.Timer(0.5, os.kill, (pid, signal.SIGTERM)).start()
    with pytest.raises(RunError, match=r"stopped at step|SIGTERM"):
        dem.run(20_000, still(bed))
    assert gone(pid)


@solver
def test_lost_particles_are_an_error(tmp_path: Path, nothing_left: object) -> None:
    bed = scene(50)
    dem = LiggghtsDem(model(bed), tmp_path, Start.at(lattice(bed)))
    push = still(bed)
    push[7, 0] = 1.0  # a million times its weight: through the wall
    with pytest.raises(RunError, match="left the domain"):
        dem.run(2000, push)


@solver
def test_the_error_of_liggghts_reaches_the_user(tmp_path: Path, nothing_left: object) -> None:
    bed = scene(50)
    given = model(bed)
    with LiggghtsDem(given, tmp_path / "a", Start.at(lattice(bed))) as dem:
        dem.run(10, still(bed))
        dem.save(tmp_path / "state")
    file = tmp_path / "state" / "particles.restart"
    file.write_bytes(b"not a restart file" * 100)
    with pytest.raises(RunError, match=rf"ended .*(ERROR|MPI_ABORT).*{LOG}"):
        LiggghtsDem(given, tmp_path / "b", None, restart=tmp_path / "state")
    file.unlink()
    with pytest.raises(InputError, match=r"particles\.restart"):
        LiggghtsDem(given, tmp_path / "b", None, restart=tmp_path / "state")


@solver
def test_two_particles_in_one_place(tmp_path: Path, nothing_left: object) -> None:
    """LIGGGHTS computes NaN from there to the end, with exit code 0."""
    bed = scene(2, gravity=AT_REST)
    x = np.full((2, 3), 3e-3)
    with pytest.raises(RunError, match="not finite"), LiggghtsDem(model(bed), tmp_path, Start.at(x)) as dem:
        dem.run(10, still(bed))


@solver
def test_the_child_dies_with_its_parent(tmp_path: Path) -> None:
    """Also in the middle of a run, when it does not listen."""
    program = (
        "import sys; from pathlib import Path; from beds import *; from kncal.scene.placement import Start, lattice\n"
        "from kncal.engines.liggghts.library import LiggghtsDem\n"
        "bed = scene(400); dem = LiggghtsDem(model(bed), Path(sys.argv[1]), Start.at(lattice(bed)))\n"
        "print(dem.pid, flush=True); dem.run(10_000_000, still(bed))\n"
    )
    paths = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    parent = subprocess.Popen([sys.executable, "-c", program, str(tmp_path)], stdout=subprocess.PIPE, env=paths)
    try:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        time.sleep(0.3)
        assert not gone(child)
    finally:
        parent.kill()
        parent.communicate()
    deadline = time.monotonic() + 5.0
    while not gone(child) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert gone(child)


@solver
def test_bad_forces_are_refused(tmp_path: Path) -> None:
    bed = scene(5)
    with LiggghtsDem(model(bed), tmp_path, Start.at(lattice(bed))) as dem:
        with pytest.raises(InputError, match="force"):
            dem.run(1, np.full((5, 3), np.nan))
        with pytest.raises(InputError, match="force"):
            dem.run(1, np.zeros((4, 3)))
        with pytest.raises(InputError, match="steps"):
            dem.run(0, still(bed))
        dem.run(1, still(bed))
