"""Where Dask runs a sweep: workers on this machine, in Slurm jobs, or those of a scheduler that is there already.

Whoever can reach a Dask port can run code as its owner, for what goes over it are pickles. So what is started here
talks by TLS with a certificate made for this one sweep, has no dashboard, and on one machine listens on loopback only.
"""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kncal.core.awake import run_within
from kncal.core.errors import InputError, RunError
from kncal.study.slurm_script import LOGS, SlurmOptions

if TYPE_CHECKING:
    from distributed import Client

#: A run whose worker died is sent to another one so many times.
RETRIES = 3
#: Seconds to wait for a scheduler's answer, and between two looks whether Slurm's jobs are still as many as wanted.
CONNECT, MEND = 10.0, 30.0
_SBATCH = 60.0

#: Settings of what is started here.
_CONFIG: dict[str, Any] = {
    # Dask would send a dead worker's run at once to one that is busy, which then has two to lose; see `DaskExecutor`
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.daemon": False,
}
#: Module that workers load at their start, and what tells them that they are children of the sweep's own process.
TASKS, DETACHED = "kncal.study.dask_executor", "KNCAL_DETACHED"
_ADDRESS = re.compile(r"(tcp|tls)://(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+):\d{1,5}")
#: Paths that dask-jobqueue can write into its job scripts, where it quotes nothing.
_PLAIN = re.compile(r"[A-Za-z0-9_./+=@:,-]+")


class Workers:
    """Workers that runs are sent to: a connection to a scheduler, and what was started for it.

    Attributes
    ----------
    limit : largest number of runs at a time, or None: what the workers take
    retries : times to send a run again whose worker died, beyond what the scheduler does by itself
    here : whether all are on this machine
    """

    here = False
    needs: tuple[str, ...] = ("distributed", "cryptography")

    def __init__(self, limit: int | None) -> None:
        missing = [name for name in self.needs if importlib.util.find_spec(name) is None]
        if missing:
            raise InputError(f"Dask is not installed (no {', '.join(missing)}): pip install 'kncal[dask]'")
        self.limit, self.retries = limit, RETRIES
        self._open = contextlib.ExitStack()

    def start(self, folder: Path) -> Client:
        """Start what is needed for the sweep in ``folder``; return a client of its scheduler."""
        raise NotImplementedError

    def mend(self) -> None:
        """Replace workers that are lost for good, where nobody else does; called about every second."""

    def close(self) -> None:
        """End what `start` started, and nothing else."""
        self._open.close()


class LocalWorkers(Workers):
    """Workers on this machine, one process each: what happens to one is no other's business."""

    here = True

    def start(self, folder: Path) -> Client:
        """See `Workers.start`; Dask's nannies replace lost workers by themselves."""
        import dask
        from distributed import Client, LocalCluster
        from distributed.security import Security

        self._open.enter_context(dask.config.set(_CONFIG))
        cluster = LocalCluster(
            n_workers=self.limit,
            threads_per_worker=1,
            host="127.0.0.1",
            protocol="tls://",
            security=Security.temporary(),
            dashboard_address="127.0.0.1:0",  # Dask has a web server in any case: loopback, and no pages
            scheduler_kwargs={"dashboard": False},
            memory_limit=0,
            silence_logs=logging.CRITICAL,
            preload=[TASKS],
            env={DETACHED: "1"},
        )
        return self._open.enter_context(Client(self._open.enter_context(cluster), set_as_default=False))


class GivenScheduler(Workers):
    """The workers of a scheduler that somebody else started: they are neither replaced nor ended."""

    needs = ("distributed",)

    def __init__(self, address: str, limit: int | None) -> None:
        super().__init__(limit)
        if not _ADDRESS.fullmatch(address):
            raise InputError(f"scheduler = {address[:100]!r}: expected tcp://HOST:PORT or tls://HOST:PORT")
        self.retries = 0  # as its owner has set it
        self._address = address

    def start(self, folder: Path) -> Client:
        """See `Workers.start`; raises `RunError` if no scheduler answers there."""
        from distributed import Client

        try:
            return self._open.enter_context(Client(self._address, timeout=CONNECT, set_as_default=False))
        except (OSError, ValueError, RuntimeError) as error:
            raise RunError(
                f"{self._address}: no Dask scheduler to be had there ({_first_line(error)}); "
                "is `dask scheduler` running, and are the versions of Dask the same?",
                "peer-died",
            ) from error


class SlurmWorkers(Workers):
    """Workers in Slurm jobs, one job each, by dask-jobqueue; needs only sbatch and scancel."""

    needs = ("distributed", "dask_jobqueue", "cryptography")

    def __init__(self, limit: int, options: SlurmOptions) -> None:
        super().__init__(limit)
        if shutil.which("sbatch") is None:
            raise InputError("--executor slurm: no sbatch on PATH; run the sweep where Slurm jobs can be submitted")
        self._options = options
        self._cluster: Any = None
        self._looked = 0.0

    def start(self, folder: Path) -> Client:
        """See `Workers.start`; raises `InputError` if the folder cannot stand in a job, or Slurm refuses such a job."""
        import dask
        from distributed import Client

        with _own_signals():
            from dask_jobqueue import SLURMCluster

        options, place = self._options, str(folder)
        if not _PLAIN.fullmatch(place):
            raise InputError(f"{place!r}: dask-jobqueue cannot write such a path into a job; choose a plain --out")
        self._open.enter_context(dask.config.set(_CONFIG))
        for left in folder.glob(".dask-*"):  # by a start that was killed; the folder is locked, so nobody uses it
            shutil.rmtree(left, ignore_errors=True)
        # the key, for this user's eyes only (mode 700), on the file system that the workers share
        keys = self._open.enter_context(tempfile.TemporaryDirectory(prefix=".dask-", dir=folder))
        (folder / LOGS).mkdir(exist_ok=True)
        cluster = SLURMCluster(
            cores=1,
            processes=1,
            memory=options.memory.removesuffix("B") + "iB" if options.memory else "1GiB",
            job_directives_skip=[] if options.memory else ["--mem"],
            walltime=options.walltime or None,
            queue=options.queue or None,
            interface=options.interface or None,
            protocol="tls://",
            security=_security_in(Path(keys)),
            python=f"{shlex.quote(sys.executable)} -P",
            job_name="kncal",
            log_directory=str(folder / LOGS),
            job_script_prologue=[
                "export DASK_DISTRIBUTED__WORKER__DAEMON=False",
                "export DASK_DISTRIBUTED__WORKER__HTTP__ROUTES='[]'",
            ],
            worker_extra_args=["--no-dashboard", "--preload", TASKS],
            scheduler_options={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
            silence_logs=logging.CRITICAL,
        )
        self._cluster = self._open.enter_context(cluster)
        _check_job(cluster.job_script(), folder)
        self.mend()
        return self._open.enter_context(Client(cluster, set_as_default=False))

    def mend(self) -> None:
        """Submit a job for each worker that is missing."""
        now = time.monotonic()
        if self._cluster is not None and now - self._looked > MEND:
            self._looked = now
            self._cluster.scale(self.limit)

    def close(self) -> None:
        """See `Workers.close`."""
        self._cluster = None
        super().close()


@contextlib.contextmanager
def _own_signals() -> Iterator[None]:
    """Keep what Ctrl-C does: dask-jobqueue's import makes it end the program at once, with exit code 0."""
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGINT) is not before:
            signal.signal(signal.SIGINT, before)


def _security_in(folder: Path) -> Any:
    """Return a key and a certificate that only what is started here has, in files."""
    from distributed.security import Security

    made = Security.temporary()
    certificate, key = folder / "certificate.pem", folder / "key.pem"
    certificate.write_text(made.tls_ca_file, encoding="ascii")
    key.write_text(made.tls_worker_key, encoding="ascii")
    roles = ("client", "scheduler", "worker")
    files = {f"tls_{role}_cert": str(certificate) for role in roles} | {f"tls_{role}_key": str(key) for role in roles}
    return Security(require_encryption=True, tls_ca_file=str(certificate), **files)


def _check_job(script: str, folder: Path) -> None:
    """Have Slurm look at the job before any is submitted: a refusal later on would be a sweep that waits for ever."""
    try:
        command = ("sbatch", "--test-only")  # the user's own Slurm
        done = run_within(_SBATCH, command, input=script, cwd=folder, text=True, errors="replace")
    except (OSError, subprocess.TimeoutExpired) as error:
        raise RunError(f"sbatch --test-only gives no answer ({error}): is Slurm in order?", "peer-died") from error
    if done.returncode != 0:
        raise InputError(f"Slurm would not take such a job: {_first_line(done.stderr)}")


def _first_line(error: object) -> str:
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
