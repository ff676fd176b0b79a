"""Several ranks of the real LIGGGHTS: the same motion as on one, and every rank gone whatever ends the run."""

from __future__ import annotations

import json
import math
import os
import shutil
import signal
import stat
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from models import GLASS, R, head_on, model

from kncal.cli import machine as doctor
from kncal.cli import main
from kncal.core import mpi
from kncal.core.errors import InputError
from kncal.core.mpi import check_fit, check_ranks, cores
from kncal.core.scratch import hold
from kncal.engines.coupled import Coupled, check_bed_ranks
from kncal.engines.liggghts.batch import Liggghts
from kncal.engines.liggghts.deck import parts_of
from kncal.engines.registry import get_engine
from kncal.record.frames import Trajectory
from kncal.runs.folder import read_manifest
from kncal.runs.workflow import run_case
from kncal.scene.bodies import Particle, Wall
from kncal.scene.case_file import load_case
from kncal.scene.model import Plan
from kncal.scene.scene import Scene
from kncal.study import Settings, ThreadExecutor, design, run_sweep
from kncal.study.design import run_folder


def needs_mpi(test):
    """Mark a test that starts several ranks of the real LIGGGHTS."""
    missing = shutil.which("mpirun") is None
    reason = "Open MPI is not installed (apt-get install openmpi-bin)"
    return pytest.mark.solver(pytest.mark.skipif(missing, reason=reason)(test))


def solve(given: Plan, folder: Path, ranks: int) -> Trajectory:
    engine = Liggghts(ranks=ranks, oversubscribe=True)
    folder.mkdir()
    engine.render(given, folder)
    result = engine.run(given, folder, timeout=60.0)
    assert result.status == "completed", result.message
    assert f"{ranks} MPI processor" in product(folder) or ranks == 1
    return engine.read(given, folder)


def product(folder: Path) -> str:
    """The log's line on the grid of ranks, with their number in place of the three factors."""
    line = next(line for line in (folder / "log.liggghts").read_text().splitlines() if "MPI processor grid" in line)
    return f"{math.prod(int(word) for word in line.split()[:5:2])} MPI processor grid"


def bead(name: str, x: tuple[float, float, float], v: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Particle:
    return Particle(name=name, material=GLASS, radius=R, position=x, velocity=v)


def skidding() -> Scene:
    """A bead that slides into the floor and on, across the middle of the box that it widens: from rank to rank."""
    return Scene.of(
        name="skidding",
        spheres=(bead("a", (-2 * R, 0.0, 1.001 * R), (3.0, 0.0, -0.5)), bead("b", (2.5 * R, 0.0, 5 * R))),
        planes=(Wall(name="floor", axis="z", position=0.0),),
    )


def pile() -> Scene:
    """A bead falls into the hollow of three others on a floor: it touches three at once."""
    a = 2.02 * R / math.sqrt(3.0)
    angles = [math.radians(angle) for angle in (10.0, 130.0, 250.0)]
    base = [bead(name, (a * math.cos(t), a * math.sin(t), R)) for name, t in zip("abc", angles, strict=True)]
    height = R + math.sqrt((2 * R) ** 2 - a**2) + 1e-6
    return Scene.of(
        name="pile",
        spheres=(*base, bead("top", (0.0, 0.0, height), (0.0, 0.0, -0.5))),
        planes=(Wall(name="floor", axis="z", position=0.0),),
        gravity=(0.0, 0.0, -9.81),
    )


# --- the same motion --------------------------------------------------------------------------------------------------


@needs_mpi
@pytest.mark.parametrize(
    ("scene", "kind", "friction", "t_end", "bound"),
    [
        # Two beads, one on each rank. A force that is a sum of two contacts at most has no order of summation that
        # could matter (a + b = b + a to the last bit), so nothing may differ.
        (head_on(), "linear", 0.0, 1.5e-4, 0.0),
        # One of two ranks is empty some of the time, and the tangential spring goes with the bead.
        (skidding(), "hertz", 0.3, 2e-3, 0.0),
        # Sums of three contacts may differ by 2^-52 of the forces, here some 100 steps long; one collision does not
        # blow that up more than a hundredfold: 100 * 2.2e-16 * 100 = 2e-12.
        (pile(), "hertz", 0.3, 4e-4, 2e-12),
    ],
    ids=["head-on", "skidding", "pile"],
)
def test_frames_are_those_of_one_rank(scene, kind, friction, t_end, bound, tmp_path: Path) -> None:
    given = model(scene, kind, t_end=t_end, friction=friction, e_n=0.9)
    one = solve(given, tmp_path / "1", 1)
    assert np.ptp(np.linalg.norm(one.v, axis=2), axis=0).max() > 0.01  # something happens
    for ranks in (2, 3):
        several = solve(given, tmp_path / str(ranks), ranks)
        assert np.array_equal(one.step, several.step)
        assert np.abs(one.x - several.x).max() <= bound * np.ptp(one.x, axis=0).max()
        assert np.abs(one.v - several.v).max() <= bound * np.abs(one.v).max()


@needs_mpi
def test_allrun_by_hand_runs_on_as_many_ranks(tmp_path: Path) -> None:
    given = model(head_on(), "linear", t_end=1.5e-4)
    folder = tmp_path / "by hand $HOME #1"
    folder.mkdir()
    engine = Liggghts(ranks=2, oversubscribe=True)
    engine.render(given, folder)
    done = subprocess.run(
        [str(folder / "Allrun")], cwd="/", env={"PATH": "/usr/bin:/bin"}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert product(folder) == "2 MPI processor grid"
    assert np.array_equal(engine.read(given, folder).x, solve(given, tmp_path / "1", 1).x)


@needs_mpi
def test_another_number_of_ranks_is_another_run(tmp_path: Path) -> None:
    scene, said = load_case("head_on_collision"), []
    several = get_engine("liggghts", ranks=2, oversubscribe=True)
    for engine in (get_engine("liggghts"), several, several):
        results = run_case(scene, engine, tmp_path / "out", ("linear",), tell=said.append)
        assert results["linear"].status == "completed"
    assert ["number of ranks" in text for text in said] == [True, False]
    assert said[1].startswith("linear not run again")
    manifest = read_manifest(tmp_path / "out" / "linear")
    assert manifest["ranks"] == 2
    assert manifest["command"][0] == "mpirun"
    assert manifest["command"][-1] == "none"
    # with these every rank would compute the whole, all into one dump, or could not reach the others
    assert not {"OMPI_MCA_ess_singleton_isolated", "OMPI_MCA_pml", "OMPI_MCA_btl"} & set(manifest["environment"])


# --- refusals ---------------------------------------------------------------------------------------------------------


def test_no_more_ranks_than_cores_unless_told() -> None:
    assert check_ranks(cores()) == cores()
    with pytest.raises(InputError, match=rf"expected at most {cores()}, or --oversubscribe"):
        check_ranks(cores() + 1)
    assert check_ranks(cores() + 1, oversubscribe=True) == cores() + 1
    for bad in (0, -1, 2.0, True, "2", mpi.MOST_RANKS + 1):
        with pytest.raises(InputError):
            check_ranks(bad, oversubscribe=True)


def test_runs_at_a_time_times_ranks_stay_within_the_cores(monkeypatch) -> None:
    monkeypatch.setattr(mpi, "cores", lambda: 8)
    for ranks in range(1, 9):
        workers = check_fit(None, ranks)
        assert workers * ranks <= 8 < (workers + 1) * ranks
        assert check_fit(workers, ranks) == workers
        if ranks > 1:
            with pytest.raises(InputError, match="expected at most"):
                check_fit(workers + 1, ranks)
        assert check_fit(workers + 1, ranks, oversubscribe=True) == workers + 1
    assert check_fit(None, 9, oversubscribe=True) == 1
    assert check_fit(20, 1) == 20  # of one rank each: as ever, the user's choice


@pytest.mark.parametrize(
    ("size", "up", "ranks", "parts"),
    [
        ((1.0, 0.2, 5.0), (0.0, 0.0, 1.0), 2, (2, 1, 1)),  # not across the height, though it is the longest side
        ((0.2, 1.0, 0.1), (0.0, 0.0, 1.0), 3, (1, 3, 1)),
        ((1.0, 1.0, 1.0), (0.0, 0.0, 1.0), 4, (2, 2, 1)),
        ((3.0, 0.1, 1.0), (0.4, 0.0, 0.9), 2, (2, 1, 1)),
        ((1.0, 1.0, 0.5), (0.0, -1.0, 0.0), 1, (1, 1, 1)),
    ],
)
def test_particles_are_shared_among_ranks_by_upright_cuts(size, up, ranks, parts) -> None:
    assert parts_of(np.array(size), np.array(up), ranks) == parts


def test_what_cannot_run_on_several_ranks_says_why() -> None:
    with pytest.raises(InputError, match="builtin computes in kncal's own process"):
        get_engine("builtin", ranks=2)
    moving, frozen, without = (load_case(name) for name in ("bubbling_bed_mini", "packed_bed", "bubbling_bed_mini"))
    with pytest.raises(InputError, match="move, and such a bed runs on one rank"):
        check_bed_ranks(moving, 2)
    check_bed_ranks(moving, 1)
    check_bed_ranks(frozen, 2)
    check_bed_ranks(replace(without, gas=None), 2)  # they share the particles
    with pytest.raises(InputError, match="nothing moves"):
        check_bed_ranks(replace(frozen, gas=None), 2)
    with pytest.raises(InputError, match="10 x 30 cells in x and z; expected at most 30"):
        check_bed_ranks(frozen, 31)
    with pytest.raises(InputError, match="live has one gas solver"):
        Coupled("live", ranks=2, oversubscribe=True)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("run", "wall_impact", "-n", str(cores() + 1)), "--oversubscribe"),
        (("run", "wall_impact", "--ranks", "2", "--oversubscribe", "--engine", "builtin"), "builtin"),
        (("run", "bubbling_bed_mini", "-n", "2", "--oversubscribe"), "runs on one rank"),
        (("compare", "a", "b", "-n", "2"), "two runs that exist already"),
        (("sweep", "wall_impact", "-n", "2", "--oversubscribe", "--export-slurm", "x"), "one core"),
        (("sweep", "bubbling_bed_mini", "--set", "gas.U_0=0.6", "-n2", "--oversubscribe"), "runs on one rank"),
    ],
)
def test_refused_on_the_command_line_before_anything_is_written(
    arguments, told, tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        main(list(arguments))
    assert stop.value.code == 2
    assert told in " ".join(capsys.readouterr().err.split())
    assert not list(tmp_path.iterdir())


@needs_mpi
def test_without_mpirun_nothing_is_started_and_the_hint_says_how(tmp_path: Path, monkeypatch) -> None:
    for program in ("liggghts", "stdbuf", "DPMFoam"):
        (tmp_path / program).symlink_to(shutil.which(program) or "/nowhere")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert Liggghts().profile().program is not None
    profile = Liggghts(ranks=2, oversubscribe=True).profile()
    assert profile.program is None
    assert "apt-get install openmpi-bin" in profile.problem


# --- ends -------------------------------------------------------------------------------------------------------------


def processes(folder: Path) -> dict[int, str]:
    """Number -> name of the live processes that work in ``folder``."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            alive = (entry / "stat").read_text().rpartition(")")[2][1] != "Z"
            if alive and (entry / "cwd").readlink() == folder:
                found[int(entry.name)] = (entry / "comm").read_text().strip()
        except OSError:
            continue  # it has just ended
    return found


def wait_until(condition, limit: float = 30.0) -> None:
    deadline = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def shared_memory(folder: Path) -> Path:
    """Where the ranks that work in ``folder`` keep the memory they share."""
    (start,) = (pid for pid, name in processes(folder).items() if name == "mpirun")
    links = [entry.readlink() for entry in Path(f"/proc/{start}/fd").iterdir()]
    (place,) = (link for link in links if link.name.startswith("kncal-mpi-"))
    wait_until(lambda: any(place.iterdir()))
    return place


def is_free(place: Path) -> bool:
    """Whether no process holds the folder any more."""
    descriptor = hold(place, stat.S_IFDIR)
    if descriptor is not None:
        os.close(descriptor)
    return descriptor is not None


def long_run() -> Plan:
    """Some million steps."""
    return model(head_on(speed=1e-3), "linear", t_end=20.0, record_every=10_000, flight_every=10_000)


def ranks_at_work(folder: Path) -> list[int]:
    return [pid for pid, name in processes(folder).items() if name == "liggghts"]


@needs_mpi
def test_a_killed_rank_ends_the_others_and_is_named(tmp_path: Path) -> None:
    engine, given = Liggghts(ranks=2, oversubscribe=True), long_run()
    engine.render(given, tmp_path)

    def kill() -> None:
        wait_until(lambda: "Step" in (log.read_text() if (log := tmp_path / "log.liggghts").exists() else ""))
        places.append(shared_memory(tmp_path))
        os.kill(ranks_at_work(tmp_path)[-1], signal.SIGKILL)

    places: list[Path] = []
    killer = threading.Thread(target=kill)
    killer.start()
    result = engine.run(given, tmp_path, timeout=60.0)
    killer.join()
    assert (result.status, result.failure, result.returncode) == ("failed", "killed", None)
    assert "signal 9 (SIGKILL" in result.message
    assert not processes(tmp_path)
    assert not places[0].exists()


@needs_mpi
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_no_rank_outlives_kncal(number: int, tmp_path: Path) -> None:
    case = tmp_path / "case.toml"
    text = (Path("cases") / "falling_particle" / "case.toml").read_text()
    case.write_text(text.replace("until_bounces = 3", "until_time = 1000.0\nrecord_every = 1000"))
    folder = tmp_path / "out" / "linear"
    command = (sys.executable, "-m", "kncal", "run", case, "-n", "2", "--oversubscribe", "--out", tmp_path / "out")
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        wait_until(lambda: len(ranks_at_work(folder)) == 2)
        place = shared_memory(folder)
        process.send_signal(number)
        _, err = process.communicate(timeout=30)
    finally:
        process.kill()
    if number == signal.SIGKILL:
        wait_until(lambda: not processes(folder), limit=5.0)
        # what it left in the machine's memory goes with the next run
        assert place.exists()
        wait_until(lambda: is_free(place), limit=5.0)
        solve(model(head_on(), "linear", t_end=1.5e-4), tmp_path / "next", 2)
    else:
        assert process.returncode == 130, err
        assert not processes(folder)
        assert json.loads((folder / "result.json").read_text())["status"] == "interrupted"
    assert not place.exists()


@needs_mpi
def test_lost_particles_are_seen_on_several_ranks(tmp_path: Path) -> None:
    engine, given = Liggghts(ranks=2, oversubscribe=True), model(head_on(), "linear", t_end=5e-3)
    engine.render(given, tmp_path)
    deck = tmp_path / "in.liggghts"
    deck.write_text(deck.read_text().replace("boundary      m m m", "boundary      f f f"))
    result = engine.run(given, tmp_path, timeout=60.0)
    assert (result.status, result.failure) == ("failed", "lost-particles")
    assert not processes(tmp_path)


# --- many -------------------------------------------------------------------------------------------------------------


@needs_mpi
def test_a_sweep_never_has_more_ranks_than_cores(tmp_path: Path) -> None:
    ranks = min(2, cores())
    from kncal.study import combine, grid_axis

    points = combine([grid_axis("run.steps_per_contact=20,30,40")])
    sweep, text = design("wall_impact", points, Settings(models=("linear",), ranks=ranks))
    alone, _ = design("wall_impact", points, Settings(models=("linear",)))
    assert bool(set(sweep.runs) & set(alone.runs)) is (ranks == 1)
    most = 0
    done = threading.Event()

    def count() -> None:
        nonlocal most
        while not done.is_set():
            folders = [run_folder(tmp_path / "sweep", run) / "linear" for run in sweep.runs]
            most = max(most, sum(len(ranks_at_work(folder)) for folder in folders))
            time.sleep(0.02)

    counter = threading.Thread(target=count)
    counter.start()
    try:
        result = run_sweep(sweep, text, tmp_path / "sweep", ThreadExecutor(ranks=ranks))
    finally:
        done.set()
        counter.join()
    assert result.completed == 3
    assert ranks <= most <= cores()


@needs_mpi
def test_doctor_starts_two_ranks(monkeypatch, tmp_path: Path) -> None:
    found = doctor._mpirun()
    assert found.ok
    assert "starts two ranks" in found.found
    # one that knows its version and cannot start anything
    (tmp_path / "mpirun").write_text('#!/bin/sh\n[ "$1" = --version ] && echo "mpirun (Open MPI) 4.1.4" || exit 213\n')
    (tmp_path / "mpirun").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    found = doctor._mpirun()
    assert not found.ok
    assert "two ranks do not start: ended with" in found.found
