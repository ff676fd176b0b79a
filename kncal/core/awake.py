"""The clock of every limit of time: it stands still while this process itself does.

A batch system's suspend, ``docker pause`` or SIGSTOP holds kncal and its solvers together. When they go on, no solver
has been silent, and no run has used up its time: the pause is no one's.
"""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from tempfile import TemporaryFile
from typing import IO, Any

from kncal.core.stopping import start_deaf

#: The clock is looked at so often [s]; no wait that is to be told from a pause may be longer.
LOOK = 0.25
#: A look that comes so late [s] is a pause. A busy machine holds a process back for less.
LAPSE = 1.5


class _Clock:
    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._seen = time.monotonic()
        self._lost = 0.0
        self._watch: threading.Thread | None = None

    def seconds(self) -> float:
        with self._lock:
            now = time.monotonic()
            if self._watch is None:
                self._seen = now
                self._watch = threading.Thread(target=self._look, name="kncal-awake", daemon=True)
                start_deaf(self._watch)
            gap = now - self._seen
            if gap > LAPSE:
                self._lost += gap - LOOK
            self._seen = now
            return now - self._lost

    def _look(self) -> None:
        """Look at the clock from the first look on, whatever the others do."""
        while True:
            time.sleep(LOOK)
            self.seconds()


_CLOCK = _Clock()


def awake() -> float:
    """Return a time [s] for differences only, as `time.monotonic`, without what this process was stopped for."""
    return _CLOCK.seconds()


def run_within(limit: float, command: Sequence[str], **options: Any) -> subprocess.CompletedProcess[Any]:
    """Run a program to its end and return what it printed, as `subprocess.run` with a timeout of `awake`.

    Raises
    ------
    subprocess.TimeoutExpired
        If it has not ended within ``limit`` [s], with what it had printed; it and what it started are killed then.
    """
    given = options.pop("input", None)
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "process_group": 0} | options
    deadline = awake() + limit
    # Input from a file: by a pipe, Python sends none of what is left when `communicate` is called again.
    with TemporaryFile() as source:
        return _within(deadline, limit, command, options | {"stdin": _ready(source, given)})


def _within(
    deadline: float, limit: float, command: Sequence[str], options: dict[str, Any]
) -> subprocess.CompletedProcess[Any]:
    with subprocess.Popen(command, **options) as process:  # noqa: S603 - a list of arguments, no shell
        try:
            while True:
                try:
                    out, err = process.communicate(timeout=LOOK)
                    return subprocess.CompletedProcess(command, process.returncode, out, err)
                except subprocess.TimeoutExpired as late:
                    if awake() >= deadline:
                        raise subprocess.TimeoutExpired(command, limit, late.output, late.stderr) from late
        except BaseException:
            # The whole group: a grandchild that holds a pipe open would keep us waiting.
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            raise


def _ready(source: IO[bytes], given: bytes | str | None) -> IO[bytes] | int:
    """Return the standard input of a program that is given this; nothing if None."""
    if given is None:
        return subprocess.DEVNULL
    source.write(given.encode("utf-8") if isinstance(given, str) else given)
    source.seek(0)
    return source
