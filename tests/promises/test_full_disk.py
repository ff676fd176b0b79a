"""A run that a full disk ended says so, wherever it hits: in its result, in the run folder, in the table of a sweep."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from kncal.core.disk import ROOM, is_full
from kncal.core.errors import KncalError, RunError, failure_of
from kncal.core.process import ProcessResult
from kncal.engines.coupled import Coupled
from kncal.engines.dpmfoam.adapter_build import find
from kncal.engines.liggghts.diagnose import diagnose_liggghts
from kncal.runs.states import run_state
from kncal.runs.workflow import run_case
from kncal.scene.case_file import load_case
from kncal.scene.scene import Scene
from kncal.study.states import sweep_status

#: Frames of 300 kB and more.
CASE = ("falling_particle", "--model", "linear", "--set", "run.until_bounces=5")


class Disk:
    """A disk of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._ballast = folder, folder / "ballast"

    def leave(self, size: int) -> None:
        """Fill all but ``size`` bytes."""
        with self._ballast.open("wb", buffering=0) as file:
            try:
                while file.write(b"x" * 4096):
                    pass
            except OSError as error:
                assert error.errno == errno.ENOSPC
            os.ftruncate(file.fileno(), os.fstat(file.fileno()).st_size // 4096 * 4096 - size)

    def free(self) -> None:
        self._ballast.unlink()


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=16m", "tmpfs", str(folder)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"cannot mount a small disk: {mounted.stderr.decode(errors='replace').strip()}")
    yield Disk(folder)
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def test_a_disk_is_full_without_space_and_without_inodes(disk: Disk, tmp_path: Path) -> None:
    assert not is_full(disk.folder)
    disk.leave(ROOM // 2)
    assert is_full(disk.folder)
    disk.free()
    subprocess.run(["mount", "-o", "remount,nr_inodes=2", str(disk.folder)], check=True)
    (disk.folder / "last").touch()  # the other one is the folder itself
    assert is_full(disk.folder)
    assert not is_full(tmp_path)
    assert not is_full(tmp_path / "nowhere")
    assert [path.name for path in disk.folder.iterdir()] == ["last"]  # looking leaves nothing


@pytest.mark.parametrize("engine", ["builtin", pytest.param("liggghts", marks=pytest.mark.solver)])
def test_a_single_contact(here: Callable, disk: Disk, engine: str) -> None:
    disk.leave(120_000)
    out = disk.folder / "out"
    arguments = ("run", *CASE, "--engine", engine, "--out", out)
    code, _ = here(*arguments)
    assert code == 3
    disk.free()  # what the folder says does not depend on the disk as it is later
    state = run_state(out / "linear")
    assert (state.status, state.failure) == ("failed", "disk-full"), state
    assert here(*arguments)[0] == 0


@pytest.mark.solver
def test_a_killed_liggghts_on_a_full_disk(disk: Disk) -> None:
    disk.leave(0)
    process = ProcessResult(
        status="exited", returncode=None, signal=signal.SIGBUS, cpu_seconds=0.0, wall_seconds=0.0, last_lines=()
    )
    (disk.folder / "log").touch()
    found = diagnose_liggghts(process, disk.folder / "log", disk.folder / "dump", 1, 1)
    assert found is not None
    assert found.code == "disk-full"


def bed(*, gas: bool) -> Scene:
    scene = load_case("bubbling_bed_mini").with_group(count=300, place="lattice")
    run = replace(scene.run, until_time=0.005, frames_every=0.001)
    return replace(scene, run=run, gas=scene.gas if gas else None, tolerances={})


@pytest.mark.solver
@pytest.mark.parametrize(("transport", "room"), [("none", 60_000), ("live", 400_000), ("restart", 400_000)])
def test_a_bed(disk: Disk, transport: str, room: int) -> None:
    if transport == "live" and find() is None:
        pytest.skip("the adapter is not built")
    disk.leave(room)
    out = disk.folder / "out"
    engine = Coupled("restart" if transport == "none" else transport)
    scene = bed(gas=transport != "none")
    try:
        result = run_case(scene, engine, out, ("linear",))["linear"]
        failure = result.failure
    except (KncalError, OSError) as error:
        failure = failure_of(error)
    assert failure == "disk-full"
    disk.free()
    if (out / "linear" / "started.json").is_file():
        state = run_state(out / "linear")
        assert (state.status, state.failure) == ("failed", "disk-full"), state
    if transport == "none":  # the quickest
        assert run_case(scene, engine, out, ("linear",))["linear"].status == "completed"


def test_a_sweep(here: Callable, disk: Disk) -> None:
    disk.leave(120_000)
    out = disk.folder / "sweep"
    arguments = ("sweep", *CASE, "--engine", "builtin", "--workers", 1, "--set", "contact.e_n=0.9", "--out", out)
    assert here(*arguments)[0] == 3
    disk.free()
    assert sweep_status(out).failures == {"disk-full": 1}
    (out / "states.jsonl").unlink()  # which only saves looking at the run folders
    assert sweep_status(out).failures == {"disk-full": 1}
    assert here(*arguments)[0] == 0


def test_the_cause_of_an_error_in_words_is_kept() -> None:
    try:
        try:
            raise OSError(errno.EDQUOT, "Disk quota exceeded")
        except OSError as error:
            raise RunError("the log cannot be opened") from error
    except RunError as error:
        assert failure_of(error) == "disk-full"
