"""Work that may crash, hang or take all memory, done by a child process: ``python -m MODULE`` of kncal, with limits.

Nothing else in Python bounds a native reader on a damaged file, an endless loop, or one expression.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from kncal.core.awake import run_within
from kncal.core.files import decode_line
from kncal.core.process import signal_name

_DONE, _REFUSED = 0, 9


class ChildError(Exception):
    """The child could not do it; the text says why."""


def ask(module: str, *arguments: str, given: bytes = b"", seconds: float) -> bytes:
    """Return what a module's `answer` gives; ``seconds`` is a limit of time beside the child's own [s].

    Raises
    ------
    ChildError
        If it could not, or crashed, hung, or asked for too much.
    """
    # not the working folder (-P): it may be a stranger's, and hold modules of its own
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
    try:
        done = run_within(seconds, (sys.executable, "-P", "-m", module, *arguments), input=given, env=environment)
    except subprocess.TimeoutExpired as error:
        raise ChildError(f"stopped: it did not end within {seconds:g} s") from error
    if done.returncode == _DONE:
        return bytes(done.stdout)
    lines = [text for line in done.stderr[-8192:].splitlines() if (text := decode_line(line).strip())]
    if done.returncode == _REFUSED:
        raise ChildError(lines[-1][:500] if lines else "no reason given")
    ended = f"exit code {done.returncode}"
    if done.returncode < 0:
        ended = signal_name(-done.returncode)
    raise ChildError(f"stopped or crashed with {ended}, beyond its limits of time and memory, or by damaged input")


def answer(work: Callable[[], bytes], memory: int, seconds: int) -> NoReturn:
    """In the child: do the work within so much more memory [bytes] and processor time [s], and end the process."""
    used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    for what, most in (
        (resource.RLIMIT_AS, used + memory),
        (resource.RLIMIT_CPU, seconds + int(sum(os.times()[:2]))),
        (resource.RLIMIT_CORE, 0),
    ):
        _, hard = resource.getrlimit(what)
        resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
    code = _DONE
    try:
        sys.stdout.buffer.write(work())
        sys.stdout.flush()
    # What is done here may raise anything, or end the program (meshio): that is the answer, not a fault.
    except (Exception, SystemExit) as error:
        text = " ".join(str(error).split())[:400]
        print(f"\n{type(error).__name__}: {text}" if text else f"\n{type(error).__name__}", file=sys.stderr)
        code = _REFUSED
    sys.stderr.flush()
    os._exit(code)  # not through the destructors of a library that has just read nonsense
