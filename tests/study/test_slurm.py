"""Sweeps under Slurm: the exported script, and workers in jobs. A Slurm of their own is started here, on loopback."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from bouncing import ENDLESS, LIMIT, SHORT, alive, attempts, bounce, designed, parent, solver_of, solvers, wait_until

from kncal.core.errors import InputError, InterruptedRunError
from kncal.study import (
    SlurmOptions,
    SweepProgress,
    array_script,
    dask_executor,
    read_design,
    run_sweep,
    sweep_status,
)

pytestmark = pytest.mark.slow

PROGRAMS = ("slurmctld", "slurmd", "sbatch", "munged", "munge")
CONF = """
ClusterName=kncal
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={place}/munge
StateSaveLocation={place}/state
SlurmdSpoolDir={place}/spool
SlurmctldPidFile={place}/slurmctld.pid
SlurmdPidFile={place}/slurmd.pid
SlurmctldLogFile={place}/slurmctld.log
SlurmdLogFile={place}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
JobCompType=jobcomp/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerType=sched/backfill
SchedulerParameters=bf_interval=1,sched_interval=1,batch_sched_delay=0
ReturnToService=2
MpiDefault=none
SwitchType=switch/none
CommunicationParameters=NoInAddrAny,NoCtldInAddrAny
NodeName=localhost NodeHostname={host} NodeAddr=127.0.0.1 CPUs={cores} RealMemory=1000 State=UNKNOWN
PartitionName=debug Nodes=localhost Default=YES MaxTime=60:00 State=UP OverSubscribe=NO
"""


def missing() -> str:
    if os.geteuid() != 0:
        return "only root can start a Slurm of its own"
    lacking = [name for name in PROGRAMS if shutil.which(name, path=f"{os.environ['PATH']}:/usr/sbin") is None]
    text = "Slurm is not installed ({}: apt-get install slurmctld slurmd slurm-client munge)"
    return text.format(f"no {', '.join(lacking)}") if lacking else ""


def ask(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, timeout=20, check=False).stdout.strip()


@pytest.fixture(scope="module")
def slurm() -> Iterator[None]:
    """A Slurm of one node, with ports, key and folders of its own; ended with all its jobs."""
    if why := missing():
        pytest.skip(why)
    place = Path(tempfile.mkdtemp(prefix="kncal-slurm-"))  # short: a socket's path has at most 107 characters
    daemons: list[subprocess.Popen[bytes]] = []
    patch = pytest.MonkeyPatch()

    def start(*command: str) -> None:
        with (place / f"{command[0]}.out").open("wb") as log:
            daemons.append(subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log))

    def ready(*command: str, wanted: str) -> None:
        deadline = time.monotonic() + LIMIT
        while wanted not in ask(*command):
            assert time.monotonic() < deadline, "\n".join(
                p.read_text() for p in (*place.glob("*.out"), *place.glob("*.log"))
            )
            time.sleep(0.2)

    try:
        patch.setenv("PATH", f"{os.environ['PATH']}:/usr/sbin")
        patch.setenv("SLURM_CONF", str(place / "slurm.conf"))
        for name in ("state", "spool"):
            (place / name).mkdir()
        (place / "key").write_bytes(os.urandom(64))
        (place / "key").chmod(0o400)
        ports = []
        with socket.socket() as one, socket.socket() as two:
            for s in (one, two):
                s.bind(("127.0.0.1", 0))
                ports.append(s.getsockname()[1])
        host = ask("hostname", "-s")
        (place / "slurm.conf").write_text(CONF.format(place=place, host=host, ports=ports, cores=os.cpu_count()))
        files = {
            "socket": "munge",
            "key-file": "key",
            "pid-file": "munge.pid",
            "seed-file": "seed",
            "log-file": "munge.log",
        }
        start("munged", "--foreground", "--force", *(f"--{key}={place / name}" for key, name in files.items()))
        wait_until((place / "munge").exists)
        start("slurmctld", "-D", "-i")
        start("slurmd", "-D", "-N", "localhost")
        ready("sinfo", "-h", "-o", "%T", wanted="idle")
        yield
    finally:
        if len(daemons) == 3:
            ask("scancel", "--full", "-u", "root")
            deadline = time.monotonic() + 20.0
            while ask("squeue", "-h") and time.monotonic() < deadline:
                time.sleep(0.2)
        for daemon in reversed(daemons):
            daemon.terminate()
            try:
                daemon.wait(10)
            except subprocess.TimeoutExpired:
                daemon.kill()
                daemon.wait()
        patch.undo()
        shutil.rmtree(place, ignore_errors=True)


def submit(script: Path) -> None:
    """Submit a script and wait for its jobs."""
    done = subprocess.run(["sbatch", script], capture_output=True, text=True, timeout=20, check=False)
    assert done.returncode == 0, done.stderr
    wait_until(lambda: not ask("squeue", "-h"))


# --- the exported script ----------------------------------------------------------------------------------------------

NASTY = [
    "sweep",
    "a b",
    "it's",
    'say "x"',
    "$(touch hit)",
    "`touch hit`",
    "a;touch hit",
    "-n",
    "ü",
    "%j",
    "a\\b",
    "#SBATCH -N9",
]


@pytest.mark.parametrize("name", NASTY)
def test_every_name_of_a_folder_reaches_the_run_as_it_is(tmp_path: Path, monkeypatch, name: str) -> None:
    """The script runs in a shell; in place of Python a program that writes down its arguments."""
    python = tmp_path / f"{name} python"
    python.write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    python.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(python))
    folder = tmp_path / name
    folder.mkdir()
    script = tmp_path / "jobs.sh"
    script.write_text(array_script(folder, name, ["0" * 12, "a" * 12], SlurmOptions(queue="short", memory="2GB")))
    directives = [line for line in script.read_text().splitlines() if line.startswith("#SBATCH")]
    assert all(re.fullmatch(r"#SBATCH --[a-z-]+=[\w.:@%/-]+", line, re.ASCII) for line in directives)
    assert {"#SBATCH --partition=short", "#SBATCH --mem=2G", "#SBATCH --array=0-1"} <= set(directives)
    for index in ("1", "2"):  # the second is beyond the list
        subprocess.run(["bash", script], cwd=tmp_path, env={"SLURM_ARRAY_TASK_ID": index}, timeout=20, check=True)
    assert [path.name for path in (folder / "slurm").iterdir()] == [f"{'a' * 12}.log"]
    said = (folder / "slurm" / f"{'a' * 12}.log").read_text().splitlines()
    assert said == ["-P", "-m", "kncal", "sweep-run", str(folder), "a" * 12]
    assert not list(tmp_path.rglob("hit"))


def test_more_runs_than_an_array_has_are_submitted_in_parts(tmp_path: Path, monkeypatch) -> None:
    python = tmp_path / "python"
    python.write_text('#!/bin/sh\necho "$6"\n')
    python.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(python))
    runs = [f"{i:012x}" for i in range(1500)]
    script = tmp_path / "jobs.sh"
    script.write_text(array_script(tmp_path, "case", runs, SlurmOptions(), at_once=20))
    assert "#SBATCH --array=0-999%20\n" in script.read_text()
    for offset, index in ((0, 999), (1000, 0), (1000, 499), (1000, 500)):
        settings = {"SLURM_ARRAY_TASK_ID": str(index), "OFFSET": str(offset)}
        subprocess.run(["bash", script], env=settings, timeout=20, check=True)
    assert {path.stem for path in (tmp_path / "slurm").iterdir()} == {runs[999], runs[1000], runs[1499]}


@pytest.mark.parametrize(
    "options",
    [
        {"queue": "a b"},
        {"queue": "short\n#SBATCH --uid=0"},
        {"queue": "-x"},
        {"walltime": "10; rm"},
        {"walltime": "soon"},
        {"memory": "2 GB"},
        {"memory": "lots"},
        {"interface": "lo --preload x"},
    ],
)
def test_what_is_no_word_of_slurm_does_not_get_into_a_script(options: dict[str, str]) -> None:
    with pytest.raises(InputError, match=next(iter(options))):
        SlurmOptions(**options)


def test_a_folder_with_a_line_break_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="control characters"):
        array_script(tmp_path / "a\n#SBATCH --uid=0", "case", ["0" * 12], SlurmOptions())


def test_only_an_earlier_script_is_replaced(case: Path, tmp_path: Path, kncal) -> None:
    before = case.read_text()
    command = ("sweep", case, "--engine", "builtin", "--set", "contact.e_n=0.7,0.8", "--out", tmp_path / "sweep")
    code, _, err = kncal(*command, "--export-slurm", case)
    assert (code, case.read_text()) == (2, before)
    assert "no script of an earlier" in err
    for _ in range(2):
        code, out, _ = kncal(*command, "--export-slurm", tmp_path / "jobs.sh")
        assert code == 0
        assert "2 of 2 runs are left; submit them: sbatch" in out
    assert kncal(*command, "--export-slurm", tmp_path / "x", "--executor", "dask")[0] == 2
    assert kncal(*command, "--queue", "short")[0] == 2


def test_one_run_by_its_id(case: Path, tmp_path: Path, kncal) -> None:
    """The exit code says what became of it; the table follows, with nothing run."""
    out = tmp_path / "sweep"
    axes = ("--set", "contact.e_n=0.7,0.8", "--engine", "builtin", "--model", "linear", "--out", out)
    assert kncal("sweep", case, *axes, "--export-slurm", tmp_path / "jobs.sh")[0] == 0
    first, second = read_design(out).runs
    assert kncal("sweep-run", out, "0" * 12)[0] == 2
    assert kncal("sweep-run", tmp_path, first)[0] == 2
    assert kncal("sweep-run", out, first)[:2] == (0, f"{first}: completed\n")
    code, said, _ = kncal("sweep-table", out)
    assert code == 3
    assert "1 of 2 runs completed" in said
    assert kncal("sweep-run", out, second)[0] == 0
    assert kncal("sweep-table", out)[0] == 0
    result = (out / "runs" / first / "linear" / "result.json").read_bytes()
    assert kncal("sweep-run", out, first)[0] == 0  # completed: not run again
    assert (out / "runs" / first / "linear" / "result.json").read_bytes() == result
    code, said, _ = kncal("sweep", case, *axes, "--export-slurm", tmp_path / "jobs.sh")
    assert "all 2 runs are completed" in said


# --- a real Slurm -----------------------------------------------------------------------------------------------------


@pytest.mark.solver
def test_the_script_does_all_runs_and_again_only_what_is_missing(slurm, case: Path, tmp_path: Path, kncal) -> None:
    out, script = tmp_path / "it's $(touch hit)", tmp_path / "jobs.sh"
    command = ("sweep", case, "--set", "contact.e_n=0.7,0.8", "--model", "linear", "--out", out, "--queue", "debug")
    command = (*command, "--walltime", "5", "--memory", "300M", "--export-slurm", script)
    assert kncal(*command)[0] == 0
    submit(script)
    assert kncal("sweep-table", out)[0] == 0, [p.read_text() for p in (out / "slurm").iterdir()]
    lost, kept = sorted(path.parent for path in out.glob("runs/*/*/result.json"))
    result = (kept / "result.json").read_bytes()
    (lost / "result.json").unlink()
    code, said, _ = kncal(*command)
    assert code == 0
    assert "1 of 2 runs are left" in said
    assert kept.parent.name not in script.read_text()
    submit(script)
    assert kncal("sweep-table", out)[0] == 0
    assert (kept / "result.json").read_bytes() == result
    assert not list(tmp_path.rglob("hit"))


jobqueue = pytest.mark.skipif(  # not imported here: that would change what Ctrl-C does to the tests
    importlib.util.find_spec("dask_jobqueue") is None, reason="dask-jobqueue is not installed (kncal[dask])"
)


@jobqueue
@pytest.mark.solver
def test_a_worker_killed_in_its_job_and_then_ctrl_c(slurm, case: Path, tmp_path: Path) -> None:
    """The killed one costs its run another start; Ctrl-C, once two runs are done, ends the third one and all jobs."""
    out = tmp_path / "sweep"
    made, text = designed(bounce(case), SHORT, 1.0, ENDLESS)
    once, _, endless = made.runs
    killed: list[int] = []

    def disturb(progress: SweepProgress) -> None:
        if not killed and (solver := solver_of(out / "runs" / once)) is not None:
            killed.append(solver)
            os.kill(parent(solver), signal.SIGKILL)
        if progress.completed == 2 and solver_of(out / "runs" / endless) is not None:
            os.kill(os.getpid(), signal.SIGINT)

    options = SlurmOptions(queue="debug", walltime="5", memory="300M", interface="lo")
    before = time.monotonic()
    with pytest.raises(InterruptedRunError, match="2 of 3 runs are completed"):
        run_sweep(made, text, out, dask_executor("slurm", 2, options=options), disturb)
    assert time.monotonic() - before < LIMIT
    assert attempts(out) == {SHORT: 2, 1.0: 1, ENDLESS: 1}
    assert dict(sweep_status(out).counts) == {"completed": 2, "interrupted": 1}
    assert len(list(out.glob("runs/*/*/result.json"))) == 3
    assert len(killed) == 1
    assert not alive(killed[0])
    assert not solvers(out)
    wait_until(lambda: not ask("squeue", "-h"))
    assert not list(out.glob(".dask-*"))  # the key


@jobqueue
def test_a_job_that_slurm_would_not_take_is_refused_at_once(slurm, case: Path, tmp_path: Path) -> None:
    made, text = designed(bounce(case), SHORT)
    executor = dask_executor("slurm", 1, options=SlurmOptions(queue="nowhere", interface="lo"))
    with pytest.raises(InputError, match="Slurm would not take"):
        run_sweep(made, text, tmp_path / "sweep", executor)
    assert not ask("squeue", "-h")
    with pytest.raises(InputError, match="plain --out"):
        run_sweep(made, text, tmp_path / "a b", dask_executor("slurm", 1, options=SlurmOptions(interface="lo")))
