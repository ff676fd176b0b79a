"""Every way in which LIGGGHTS fails while looking well, made to happen for real."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from wall_deck import wall_deck

from kncal.core.process import ProcessResult, run_process
from kncal.engines.liggghts.diagnose import CODES, Diagnosis, diagnose_liggghts

SOLVER = ("stdbuf", "-oL", "liggghts", "-in", "in.wall")
ENDLESS = {"steps": 2_000_000_000, "velocity": 0.0, "thermo": 100_000, "every": "1000000000"}


class Run:
    """One run in a folder of its own, and its diagnosis."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.log = folder / "log"
        self.dump = folder / "particles.dump"
        self.process: ProcessResult | None = None

    def start(self, deck: str, command: tuple[str, ...] = SOLVER, **options: object) -> Run:
        (self.folder / "in.wall").write_text(deck)
        self.process = run_process(command, cwd=self.folder, log=self.log, **options)  # type: ignore[arg-type]
        return self

    def diagnose(self, steps: int = 600, atoms: int = 1) -> Diagnosis | None:
        assert self.process is not None
        return diagnose_liggghts(self.process, self.log, self.dump, steps, atoms)

    def problem(self, steps: int = 600, atoms: int = 1) -> Diagnosis:
        diagnosis = self.diagnose(steps, atoms)
        assert diagnosis is not None
        assert diagnosis.code in CODES
        return diagnosis


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run(tmp_path)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run that is all right; tests that damage its files do so on a copy of them."""
    return Run(tmp_path_factory.mktemp("good")).start(wall_deck())


def damaged(good: Run, folder: Path, *, log: str | None = None, dump: str | None = None) -> Run:
    copy = Run(folder)
    copy.process = good.process
    copy.log.write_text(good.log.read_text() if log is None else log)
    copy.dump.write_text(good.dump.read_text() if dump is None else dump)
    return copy


def strike(number: int, folder: Path) -> threading.Thread:
    """Send a signal, as someone else would, to the LIGGGHTS that runs in ``folder`` once it counts steps."""

    def act() -> None:
        deadline = time.monotonic() + 20
        while time.monotonic() < deadline:
            time.sleep(0.02)
            if "\n  100000 " not in ((folder / "log").read_text() if (folder / "log").exists() else ""):
                continue
            for entry in Path("/proc").glob("[0-9]*"):
                try:
                    if (entry / "cwd").readlink() == folder:
                        os.kill(int(entry.name), number)
                        return
                except OSError:
                    continue

    thread = threading.Thread(target=act)
    thread.start()
    return thread


@pytest.mark.solver
def test_a_good_run_has_no_diagnosis(good: Run) -> None:
    assert good.diagnose() is None
    assert good.process is not None
    assert good.process.returncode == 0


@pytest.mark.solver
def test_error_line_and_log_reach_the_user(run: Run) -> None:
    found = run.start(wall_deck(extra="pair_coef * *")).problem()
    assert found.code == "solver-error"
    assert "ERROR: Unknown command: pair_coef" in found.message
    assert str(run.log) in found.message


@pytest.mark.solver
def test_sigterm_from_elsewhere_is_no_success(run: Run) -> None:
    """LIGGGHTS then exits with 0, and its log speaks of all steps."""
    thread = strike(signal.SIGTERM, run.folder)
    run.start(wall_deck(**ENDLESS))
    thread.join()
    assert run.process is not None
    assert (run.process.status, run.process.returncode) == ("exited", 0)
    found = run.problem(steps=ENDLESS["steps"])
    assert found.code == "no-end-marker"
    assert "of 2000000000" in found.message


@pytest.mark.solver
def test_kill_from_elsewhere(run: Run) -> None:
    thread = strike(signal.SIGKILL, run.folder)
    found = run.start(wall_deck(**ENDLESS)).problem(steps=ENDLESS["steps"])
    thread.join()
    assert found.code == "killed"
    assert "signal 9 (SIGKILL" in found.message


@pytest.mark.solver
def test_interruption(run: Run) -> None:
    thread = strike(signal.SIGCONT, run.folder)  # harmless: it only says when the run is under way
    stop = threading.Thread(target=lambda: (thread.join(), signal.raise_signal(signal.SIGINT)))
    stop.start()
    found = run.start(wall_deck(**ENDLESS)).problem(steps=ENDLESS["steps"])
    stop.join()
    assert run.process is not None
    assert run.process.returncode == 0  # LIGGGHTS sees no failure
    assert found.code == "interrupted"


@pytest.mark.solver
def test_timeout(run: Run) -> None:
    found = run.start(wall_deck(**ENDLESS), timeout=1.5).problem(steps=ENDLESS["steps"])
    assert found.code == "timed-out"
    assert "after 1." in found.message
    assert "at step" in found.message


@pytest.mark.solver
def test_empty_deck(run: Run) -> None:
    found = run.start("").problem()
    assert run.process is not None
    assert run.process.returncode == 0
    assert found.code == "no-end-marker"
    assert "is the deck empty" in found.message


@pytest.mark.solver
def test_error_of_one_rank(run: Run) -> None:
    """The reason comes through where the output is buffered by lines; without that it is lost in MPI_Abort."""
    found = run.start("", (*SOLVER[:-1], "in.none")).problem()
    assert found.code == "solver-error"
    assert "ERROR on proc 0: Cannot open input script in.none" in found.message
    lost = run.start("", ("liggghts", "-in", "in.none")).problem()
    assert lost.code == "solver-error"
    assert "exit code 1" in lost.message


@pytest.mark.solver
def test_lost_particle_at_a_thermo_line(run: Run) -> None:
    found = run.start(wall_deck(velocity=50.0)).problem()
    assert found.code == "lost-particles"
    assert "ERROR: Lost atoms" in found.message


@pytest.mark.solver
def test_lost_particle_that_liggghts_lets_pass(run: Run) -> None:
    """Without ``lost error`` it is gone, the end marker stands, and the exit code is 0."""
    deck = wall_deck(velocity=50.0).replace("thermo_modify norm no lost error", "thermo_modify norm no lost ignore")
    found = run.start(deck).problem()
    assert run.process is not None
    assert run.process.returncode == 0
    assert found.code == "lost-particles"
    assert "0 particles in the last thermo line, expected 1" in found.message


@pytest.mark.solver
def test_not_a_number(run: Run) -> None:
    """Two particles at one point: NaN for ever, with exit code 0."""
    found = run.start(wall_deck(spheres=2)).problem(atoms=2)
    assert run.process is not None
    assert run.process.returncode == 0
    assert found.code == "not-finite"
    assert "of particle 1 at step" in found.message


@pytest.mark.solver
def test_deck_that_ends_too_soon(run: Run) -> None:
    assert run.start(wall_deck(steps=500)).problem().code == "wrong-last-step"
    assert "at step 500 of 600" in run.problem().message


@pytest.mark.solver
def test_deck_without_marker(run: Run) -> None:
    assert run.start(wall_deck(marker=False)).problem().code == "no-end-marker"


@pytest.mark.solver
def test_deck_without_dump(run: Run) -> None:
    deck = "\n".join(line for line in wall_deck().splitlines() if not line.startswith("dump"))
    found = run.start(deck).problem()
    assert found.code == "empty-output"
    assert "particles.dump" in found.message


@pytest.mark.solver
def test_missing_program(run: Run) -> None:
    for command in (("no-such-liggghts",), ("stdbuf", "-oL", "no-such-liggghts")):
        found = run.start(wall_deck(), command).problem()
        assert found.code == "not-installed"
        assert "no-such-liggghts" in found.message


@pytest.fixture
def tiny_disk(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"cannot mount a small disk: {mounted.stderr.decode(errors='replace').strip()}")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.mark.solver
@pytest.mark.parametrize("fill", [True, False], ids=["before", "during"])
def test_full_disk(tiny_disk: Path, fill: bool) -> None:
    """LIGGGHTS notices nothing and exits with 0."""
    run = Run(tiny_disk)
    (tiny_disk / "in.wall").write_text(wall_deck(every="1"))
    if fill:
        with (tiny_disk / "ballast").open("wb", buffering=0) as file:
            try:
                while file.write(b"x" * 1024):
                    pass
            except OSError as error:
                assert error.errno == 28
    run.process = run_process(SOLVER, cwd=tiny_disk, log=run.log)
    assert run.process.returncode == 0
    found = run.problem()
    assert found.code == "disk-full"
    assert "disk" in found.message
    assert "full" in found.message


@pytest.mark.solver
def test_damaged_dumps_of_a_good_run(good: Run, tmp_path: Path) -> None:
    text = good.dump.read_text()
    last = text.rindex("ITEM: TIMESTEP")
    cases = {
        "": "empty-output",
        text[:-30]: "truncated-output",
        text[: last + 40]: "truncated-output",
        text.replace("0.00101 ", "nan ", 1): "not-finite",
        text.replace("0.00101 ", "inf ", 1): "not-finite",
        text.replace("0.00101 ", "0.001o1 ", 1): "truncated-output",
        text[:last] + text[last:].replace("ATOMS\n1\n", "ATOMS\n2\n") + "2 1" + " 0" * 12 + " \n": "lost-particles",
    }
    assert {name: damaged(good, tmp_path, dump=name).problem().code for name in cases} == cases
    run = damaged(good, tmp_path)
    assert run.diagnose() is None
    run.dump.unlink()
    assert run.problem().code == "empty-output"


@pytest.mark.solver
def test_a_frame_without_its_particle(good: Run, tmp_path: Path) -> None:
    """Frames of no rows leave no trace in the table, so a vanished particle must be seen in the log."""
    text = good.dump.read_text()
    last = text.rindex("ITEM: TIMESTEP")
    gone = text[: text.rindex("\n1 1 ") + 1].replace("ATOMS\n1\n", "ATOMS\n0\n")
    assert gone[last:] != text[last:]
    log = good.log.read_text().replace("     600        1 ", "     600        0 ")
    assert damaged(good, tmp_path, log=log).problem().code == "lost-particles"


@pytest.mark.solver
def test_damaged_logs_of_a_good_run(good: Run, tmp_path: Path) -> None:
    text = good.log.read_text()
    assert damaged(good, tmp_path, log="").problem().code == "no-end-marker"
    assert damaged(good, tmp_path, log=text.replace("KNCAL_DONE", "")).problem().code == "no-end-marker"
    assert damaged(good, tmp_path, log=text + "ERROR: late\n").problem().code == "solver-error"
    run = damaged(good, tmp_path)
    run.log.unlink()
    assert run.problem().code == "empty-output"
