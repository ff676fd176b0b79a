"""Code run in a child process that may take little time and memory."""

from __future__ import annotations

import contextlib
import multiprocessing
import resource
import textwrap
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

from kncal.core.errors import KncalError

#: Beyond what the imports of kncal take [bytes], and processor time [s].
MEMORY, SECONDS = 1 << 30, 20

#: What the code may use; children are forked from a process that has imported it, which takes a second.
_MODULES = (
    "numpy",
    "pandas",
    "scipy.spatial",
    "kncal.core.arrays",
    "kncal.record.liggghts_dump",
    "kncal.record.liggghts_log",
    "kncal.record.openfoam",
    "kncal.record.series",
    "kncal.runs.folder",
    "kncal.scene.case_file",
    "kncal.scene.meshes",
    "kncal.scene.plan",
)
_NAMES = "import tomllib, kncal\nfrom kncal.scene.plan import plan\nfrom kncal.scene.case_file import parse_case\n"
_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(list(_MODULES))


def bounded(code: str) -> list[str]:
    """Run ``code`` with `attempt` at hand in a child; return what became of each; fail if it needs more than it may."""
    mine, its = _CONTEXT.Pipe(duplex=False)
    child = _CONTEXT.Process(target=_run, args=(textwrap.dedent(code), its))
    child.start()
    its.close()
    lines: list[str] = []
    with mine, contextlib.suppress(EOFError):
        while mine.poll(280.0):
            lines.append(mine.recv())
    child.join(10.0)
    child.kill()  # if it hangs
    child.join()
    assert child.exitcode == 0, f"code {child.exitcode} after {lines}"
    return lines


def _run(code: str, out: Connection) -> None:
    names = {"Path": Path}
    exec("".join(f"import {module}\n" for module in _MODULES) + _NAMES, names)  # noqa: S102

    def attempt(what: Callable[[], object]) -> None:
        try:
            what()
        except KncalError as error:
            out.send(f"{type(error).__name__} {error}".replace("\n", " ")[:300])
        else:
            out.send("accepted")

    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    time = int(resource.getrusage(resource.RUSAGE_SELF).ru_utime)
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY,) * 2)
    resource.setrlimit(resource.RLIMIT_CPU, (time + SECONDS,) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    exec(code, names | {"attempt": attempt})  # noqa: S102
