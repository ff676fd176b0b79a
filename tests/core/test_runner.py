"""The runner, on real processes: LIGGGHTS where its behaviour matters, small programs elsewhere."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from wall_deck import DENSITY, DT, GAMMA_N, K_N, RADIUS, wall_deck

import kncal.core.process
from kncal.core.awake import awake
from kncal.core.errors import InputError, RunError
from kncal.core.process import ProcessResult, run_process, solver_environment
from kncal.record.liggghts_dump import read_trajectory
from kncal.record.liggghts_log import read_log, step_of_line

LIGGGHTS = ("stdbuf", "-oL", "liggghts", "-in", "in.wall")


def python(code: str) -> tuple[str, ...]:
    return (sys.executable, "-c", code)


def is_running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def wait_until(condition: Callable[[], bool], limit: float = 10.0) -> None:
    deadline = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.fixture
def run(tmp_path: Path):
    def _run(command: tuple[str, ...], **options: object) -> ProcessResult:
        awake()  # its clock has a thread, from the first look on
        before = threading.active_count()
        result = run_process(command, cwd=tmp_path, log=tmp_path / "log", **options)  # type: ignore[arg-type]
        assert threading.active_count() == before
        return result

    return _run


@pytest.mark.solver
def test_liggghts_from_deck_to_rebound(run, tmp_path: Path) -> None:
    """The whole chain on a wall impact; the rebound speed is that of the damped linear spring.

    Closed form: x'' + 2 z w x' + w² x = 0 from x = 0 until x = 0 gives e = exp(-pi z/sqrt(1 - z²)). At 236 steps
    per contact LIGGGHTS' half-step damping changes e by well under 0.1 % (first order in dt).
    """
    (tmp_path / "in.wall").write_text(wall_deck(every="v_nxt", extra="variable nxt equal step+1+49*(z[1]>0.00102)"))
    lines: list[str] = []
    result = run(LIGGGHTS, on_line=lines.append)
    assert (result.status, result.returncode, result.signal) == ("exited", 0, None)
    assert 0 < result.cpu_seconds < 5
    assert result.cpu_seconds / 4 < result.wall_seconds < 30
    assert result.last_lines[-1] == "KNCAL_DONE"
    assert [s for s in map(step_of_line, lines) if s is not None] == [0, 200, 400, 600]
    assert "\n".join(lines).strip() == (tmp_path / "log").read_text().replace(" \n", "\n").strip()
    screen, file = read_log(tmp_path / "log"), read_log(tmp_path / "log.liggghts")
    for log in (screen, file):
        assert log.finished
        assert (log.last_step, log.atoms, log.errors) == (600, 1, ())

    motion = read_trajectory(tmp_path / "particles.dump", ("ball",), (RADIUS,), DT)
    gaps = np.diff(motion.step)
    assert set(gaps.tolist()) == {1, 50}  # close to the wall, and far from it
    mass = DENSITY * 4 / 3 * np.pi * RADIUS**3
    omega = np.sqrt(K_N / mass)
    zeta = GAMMA_N / (2 * omega)
    e_n = np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2))
    assert motion.v[-1, 0, 2] / 0.5 == pytest.approx(e_n, rel=1e-3)
    assert motion.x[:, 0, 2].min() < RADIUS
    assert not motion.x[:, 0, :2].any()
    assert not motion.spin.any()
    # force is zero where there is no contact, and force/mass is what changes the velocity
    apart = motion.x[:, 0, 2] > RADIUS
    assert not motion.force[apart].any()
    near = np.flatnonzero((gaps[1:] == 1) & (gaps[:-1] == 1))
    mean_force = (motion.force[near, 0, 2] + 2 * motion.force[near + 1, 0, 2] + motion.force[near + 2, 0, 2]) / 4
    change = (motion.v[near + 2, 0, 2] - motion.v[near, 0, 2]) / (2 * DT)
    np.testing.assert_allclose(change, mean_force / mass, atol=1e-9 * np.abs(change).max())


@pytest.mark.solver
def test_liggghts_is_the_only_process(run, tmp_path: Path) -> None:
    """Open MPI's daemon would outlive a kill: it is in a session of its own."""
    (tmp_path / "in.wall").write_text(wall_deck(steps=1_000_000, velocity=0.0, thermo=100_000, every="1000000"))
    here: list[str] = []

    def on_line(line: str) -> None:
        if step_of_line(line) is not None:
            for entry in Path("/proc").glob("[0-9]*"):
                try:
                    if (entry / "cwd").readlink() == tmp_path:
                        here.append((entry / "comm").read_text().strip())
                except OSError:
                    continue  # ended meanwhile, or another user's

    assert run(LIGGGHTS, on_line=on_line).returncode == 0
    assert set(here) == {"liggghts"}


@pytest.mark.solver
def test_each_run_has_its_own_mpi_session_folder(run, tmp_path: Path) -> None:
    """One-rank programs share the folder's name: one that ended would remove it under another that starts."""
    deck = tmp_path / "in.look"
    deck.write_text('shell env > seen\nprint "done"\n')  # a deck of the test's own: kncal's have no shell
    bases = []
    for _ in range(2):
        assert run(("liggghts", "-in", "in.look", "-log", "none")).returncode == 0
        seen = dict(line.split("=", 1) for line in (tmp_path / "seen").read_text().splitlines() if "=" in line)
        bases.append(seen["OMPI_MCA_orte_tmpdir_base"])
    assert len(set(bases)) == 2
    assert not any(Path(base).exists() for base in bases)


@pytest.mark.solver
def test_timeout_of_liggghts(run, tmp_path: Path) -> None:
    (tmp_path / "in.wall").write_text(wall_deck(steps=2_000_000_000, velocity=0.0, thermo=200_000))
    result = run(LIGGGHTS, timeout=1.5)
    assert result.status == "timed_out"
    assert 1.5 <= result.wall_seconds < 1.5 + 4
    assert result.returncode == 0  # LIGGGHTS stops in good order, which says nothing about the run
    log = read_log(tmp_path / "log")
    assert log.last_step is not None
    assert not log.finished


def test_output_is_merged_in_order_and_reported_live(run, tmp_path: Path) -> None:
    seen: list[tuple[float, str]] = []
    code = "import os, time\nfor k in range(3): os.write(1 + k % 2, b'line %d\\n' % k); time.sleep(0.3)"
    result = run(python(code), on_line=lambda line: seen.append((time.monotonic(), line)))
    assert [line for _, line in seen] == ["line 0", "line 1", "line 2"]
    assert seen[2][0] - seen[0][0] > 0.4  # not all at the end
    assert result.last_lines == ("line 0", "line 1", "line 2")
    assert (tmp_path / "log").read_text() == "line 0\nline 1\nline 2\n"


@pytest.mark.parametrize(
    ("written", "lines"),
    [
        ("b'no end'", ["no end"]),
        ("b'a\\r\\n\\nb\\n'", ["a", "", "b"]),
        ("b'\\xff\\xc3\\xa9\\n'", ["\ufffd\u00e9"]),
        ("b'\\x1b[2J\\n'", ["\ufffd[2J"]),
        ("b'x' * 3000000 + b'\\nnext\\n'", ["x" * 4096, "next"]),
        ("b'x' * 3000000", ["x" * 4096]),
        ("b''", []),
    ],
)
def test_odd_output(run, written: str, lines: list[str]) -> None:
    seen: list[str] = []
    run(python(f"import sys; sys.stdout.buffer.write({written})"), on_line=seen.append)
    assert seen == lines


def test_only_the_last_lines_are_kept(run) -> None:
    count = 0

    def on_line(_: str) -> None:
        nonlocal count
        count += 1

    result = run(python("for k in range(200000): print(k)"), on_line=on_line)
    assert count == 200_000
    assert result.last_lines == tuple(str(k) for k in range(199_980, 200_000))


def test_cpu_time_is_the_childs_own(run) -> None:
    burn = "import time\nwhile time.process_time() < 0.4: pass"
    result = run(python(burn))
    assert 0.4 <= result.cpu_seconds < 1.0
    assert run(("sleep", "0.2")).cpu_seconds < 0.1  # neither this process nor the child before


def test_exit_codes_and_signals(run) -> None:
    assert (run(("false",)).status, run(("false",)).returncode) == ("exited", 1)
    killed = run(python("import os; os.kill(os.getpid(), 9)"))
    assert (killed.status, killed.returncode, killed.signal) == ("exited", None, signal.SIGKILL)


def test_no_input_and_no_shell(run) -> None:
    assert run(("cat",), timeout=20).status == "exited"
    assert run(("echo", "$HOME; touch x", "`id`")).last_lines == ("$HOME; touch x `id`",)


@pytest.mark.parametrize("command", [("no-such-solver",), ("stdbuf", "-oL", "no-such-solver"), ("./none",)])
def test_missing_program(run, command: tuple[str, ...]) -> None:
    result = run(command)
    assert (result.status, result.command) == ("not_installed", command)
    assert result.cpu_seconds < 1


def test_program_is_searched_in_the_childs_path(run, tmp_path: Path) -> None:
    assert run(("liggghts",), env={"PATH": str(tmp_path)}).status == "not_installed"
    tool = tmp_path / "tool"
    tool.write_text("#!/bin/sh\necho here\n")
    tool.chmod(0o755)
    assert run(("tool",), env={"PATH": str(tmp_path)}).last_lines == ("here",)
    assert run(("./tool",)).last_lines == ("here",)  # relative to the run's folder, not to ours


#: Asked to end, it and its child only say so. A shell, which is ready at once also on a busy machine.
STUBBORN = """
trap 'echo no' TERM
while :; do sleep 0.1; done &
echo ready
while :; do sleep 0.1; done
"""


def test_timeout_ends_what_ignores_sigterm_and_its_children(run, tmp_path: Path) -> None:
    marker = f"kncal-{os.getpid()}-{time.monotonic_ns()}"
    result = run(("sh", "-c", STUBBORN, marker), timeout=0.5, grace=0.5)
    assert (result.status, result.signal) == ("timed_out", signal.SIGKILL)
    assert 1.5 <= result.wall_seconds < 8.0  # 0.5 s, then two graces
    assert (tmp_path / "log").read_text().count("no") >= 2  # both were asked, at least twice between them

    def relics() -> list[Path]:
        found = []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            try:
                if marker.encode() in path.read_bytes() and is_running(int(path.parent.name)):
                    found.append(path)
            except OSError:
                continue
        return found

    wait_until(lambda: not relics())


def interrupting(log: Path, *lines: str) -> threading.Thread:
    """Send Ctrl-C to this process as soon as the log holds a line, then the same for the next."""

    def act() -> None:
        for line in lines:
            wait_until(lambda line=line: log.exists() and line in log.read_text().split(), 60.0)
            signal.raise_signal(signal.SIGINT)

    thread = threading.Thread(target=act)
    thread.start()
    return thread


def test_ctrl_c_ends_the_child(tmp_path: Path) -> None:
    log = tmp_path / "log"
    thread = interrupting(log, "ready")
    result = run_process(("sh", "-c", "echo ready; sleep 60"), cwd=tmp_path, log=log, grace=30.0)
    thread.join()
    assert (result.status, result.signal) == ("interrupted", signal.SIGTERM)
    assert result.wall_seconds < 20.0


@pytest.mark.parametrize("timeout", [None, 0.5])
def test_second_ctrl_c_is_immediate(tmp_path: Path, timeout: float | None) -> None:
    """Also where the child was being ended for its time limit: the user's wish is what counts."""
    log = tmp_path / "log"
    thread = interrupting(log, "no") if timeout else interrupting(log, "ready", "no")
    result = run_process(("sh", "-c", STUBBORN), cwd=tmp_path, log=log, timeout=timeout, grace=30.0)
    thread.join()
    assert (result.status, result.signal) == ("interrupted", signal.SIGKILL)
    assert result.wall_seconds < 20.0


def test_an_exception_of_the_caller_ends_the_child(tmp_path: Path) -> None:
    pids: list[int] = []

    def on_line(line: str) -> None:
        pids.append(int(line))
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run_process(
            python("import os, time; print(os.getpid(), flush=True); time.sleep(60)"),
            cwd=tmp_path,
            log=tmp_path / "log",
            on_line=on_line,
        )
    assert not is_running(pids[0])


def test_the_child_dies_with_a_killed_parent(tmp_path: Path) -> None:
    code = (
        "import sys, pathlib\nfrom kncal.core.process import run_process\n"
        "folder = pathlib.Path(sys.argv[1])\n"
        "child = (sys.executable, '-c', 'import os, time; print(os.getpid(), flush=True); time.sleep(60)')\n"
        "run_process(child, cwd=folder, log=folder / 'log')\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)])
    log = tmp_path / "log"
    wait_until(lambda: log.exists() and log.read_text().endswith("\n"), 30.0)
    pid = int(log.read_text())
    assert is_running(pid)
    parent.kill()
    parent.wait()
    wait_until(lambda: not is_running(pid))


def test_log_is_replaced_but_never_written_through_a_link(run, tmp_path: Path) -> None:
    (tmp_path / "log").write_text("old text, longer than the new one")
    run(("echo", "new"))
    assert (tmp_path / "log").read_text() == "new\n"
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / "log").unlink()
    (tmp_path / "log").symlink_to(victim)
    with pytest.raises(RunError, match="symbolic link"):
        run(("echo", "new"))
    assert victim.read_text() == "precious"


def test_arguments_are_checked(run, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="command"):
        run(())
    with pytest.raises(InputError, match="timeout"):
        run(("true",), timeout=0.0)
    with pytest.raises(InputError, match="not a folder"):
        run_process(("true",), cwd=tmp_path / "none", log=tmp_path / "log")
    with pytest.raises(RunError, match="log"):
        run_process(("true",), cwd=tmp_path, log=tmp_path / "none" / "log")


def test_environment_is_short_and_ours(monkeypatch: pytest.MonkeyPatch, run) -> None:
    for name in ("SLURM_STEPID", "PMI_RANK", "PMIX_RANK", "LD_PRELOAD", "SECRET_TOKEN", "LANG", "FOAM_SIGFPE"):
        monkeypatch.setenv(name, "1")
    monkeypatch.setenv("LC_ALL", "de_DE.UTF-8")
    monkeypatch.setenv("OMP_NUM_THREADS", "64")
    monkeypatch.setenv("TMPDIR", "/no/such/folder")
    names = {line.partition("=")[0] for line in run(("env",)).last_lines}
    ours = solver_environment()
    assert names == {*ours, "OMPI_MCA_orte_tmpdir_base"}
    assert names <= {
        "OMPI_MCA_orte_tmpdir_base",
        "PATH", "HOME", "TMPDIR", "LC_ALL", "OMP_NUM_THREADS", "WM_PROJECT_DIR",
        "OMPI_MCA_ess_singleton_isolated", "OMPI_MCA_pml", "OMPI_MCA_btl",
        "OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM",
    }  # fmt: skip
    assert (ours["LC_ALL"], ours["OMP_NUM_THREADS"]) == ("C", "1")
    assert "TMPDIR" not in ours
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert not [name for name in solver_environment() if "ROOT" in name]


def test_works_without_setpriv(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    which = kncal.core.process.shutil.which
    monkeypatch.setattr(
        kncal.core.process.shutil, "which", lambda name, **k: None if name == "setpriv" else which(name, **k)
    )
    assert run_process(("echo", "x"), cwd=tmp_path, log=tmp_path / "log").last_lines == ("x",)


_UNDER_FIRE = """
import os, signal, sys, threading, time
from pathlib import Path
from kncal.core.process import run_process

os.setpgid(0, 0)
signal.signal(signal.SIGINT, lambda *_: None)
done = threading.Event()

def press():
    while not done.is_set():
        os.killpg(0, signal.SIGINT)
        time.sleep(0.0003)

pressing = threading.Thread(target=press)
pressing.start()
here = Path(sys.argv[1])
ends = [run_process(("true",), cwd=here, log=here / "log") for _ in range(100)]
done.set()
pressing.join()
print(sum(end.status != "exited" or end.returncode != 0 for end in ends))
"""


def test_ctrl_c_does_not_end_a_process_that_is_just_starting(tmp_path: Path) -> None:
    """It belongs to a group of its own, but not from its first moment; one in twenty died before it was shielded."""
    found = subprocess.run(
        [sys.executable, "-c", _UNDER_FIRE, str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert found.stdout.split() == ["0"]
