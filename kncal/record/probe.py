"""Native readers (VTK) tried out in a child process first: on a damaged file they may crash, hang or take all memory.

``python -m kncal.record.probe KIND PATH ...`` reads it as the parent will, and says what was wrong with it.
"""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

from kncal.core.awake import run_within
from kncal.core.errors import ReadError
from kncal.core.files import decode_line

#: What a reader may take: address space beyond what Python and VTK have taken already [bytes], time [s].
MEMORY, SECONDS = 4 * 1024**3, 60
_READ, _REFUSED = 0, 9


def probe(kind: str, path: Path, *arguments: str) -> None:
    """Let a child process read ``path`` as ``kind`` ("mesh", "case"), and return if it could.

    Raises
    ------
    ReadError
        If it could not, or crashed, hung, or asked for too much memory.
    """
    command = [sys.executable, "-P", "-m", "kncal.record.probe", kind, str(path.absolute()), *arguments]
    # not the working folder: it may be a stranger's, and hold modules of its own
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
    try:
        done = run_within(2 * SECONDS, command, env=environment)
    except subprocess.TimeoutExpired as error:
        raise ReadError(f"{path}: cannot be read (the reader did not end within {2 * SECONDS} s)") from error
    if done.returncode == _READ:
        return
    lines = [text for line in done.stderr[-8192:].splitlines() if (text := decode_line(line).strip())]
    if done.returncode == _REFUSED:
        why = lines[-1][:300] if lines else "no reason given"
    elif done.returncode < 0:
        why = f"the reader crashed with {_signal_name(-done.returncode)}; the file is damaged, or too large"
    else:
        why = f"the reader ended with code {done.returncode}: {lines[-1][:200] if lines else 'no message'}"
    raise ReadError(f"{path}: cannot be read ({why})")


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def limit_resources() -> None:
    """Bound what this process may still take: memory, time; no core file."""
    used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    for what, most in (
        (resource.RLIMIT_AS, used + MEMORY),
        (resource.RLIMIT_CPU, SECONDS + int(sum(os.times()[:2]))),
        (resource.RLIMIT_CORE, 0),
    ):
        _, hard = resource.getrlimit(what)
        resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def read(kind: str, path: Path, *arguments: str) -> None:
    """Read ``path`` and forget it; whatever goes wrong is an exception."""
    if kind == "mesh":
        from kncal.record.vtk import read_native

        read_native(path)
    else:
        from kncal.record.openfoam import read_native_case

        read_native_case(path, float(arguments[0]) if arguments else None)


def main(arguments: list[str]) -> int:
    """Read what the arguments name; exit code 0, or 9 with the reason as the last line of standard error."""
    import pyvista  # noqa: F401  before the limits: it takes much address space and is no part of the file

    limit_resources()
    kind, path, *rest = arguments
    try:
        read(kind, Path(path), *rest)
    # Foreign readers raise anything, and end the program (meshio): here that is the answer, not a fault.
    except (Exception, SystemExit) as error:
        lines = str(error).strip().splitlines()
        print(f"\n{lines[0][:300] if lines and lines[0] else type(error).__name__}", file=sys.stderr)
        return _REFUSED
    return _READ


if __name__ == "__main__":
    code = main(sys.argv[1:])
    sys.stderr.flush()
    os._exit(code)  # not through the destructors of a library that has just read nonsense
