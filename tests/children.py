"""Code run in a child process that may take little time and memory."""

from __future__ import annotations

import resource
import subprocess
import sys
import textwrap
from collections.abc import Callable

#: Beyond what the imports of kncal take [bytes], and processor time [s].
MEMORY, SECONDS = 1 << 30, 20

_START = """
import resource
import numpy, pandas, scipy.spatial, pydantic
from pathlib import Path
import kncal.scene.case_file, kncal.scene.plan, kncal.record.series, kncal.runs.folder
from kncal.scene.plan import plan
from kncal.scene.bed_case_file import parse_bed
import kncal.record.liggghts_dump, kncal.record.liggghts_log, kncal.record.openfoam
import kncal.scene.meshes, kncal.core.arrays
from kncal.core.errors import KncalError
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + {memory},) * 2)
resource.setrlimit(resource.RLIMIT_CPU, (int(resource.getrusage(resource.RUSAGE_SELF).ru_utime) + {seconds},) * 2)
def attempt(what):
    try:
        what()
    except KncalError as error:
        print(type(error).__name__, str(error).replace("\\n", " ")[:300])
    else:
        print("accepted")
"""


def bounded(code: str) -> list[str]:
    """Run ``code`` with `attempt` at hand in a child; return its lines; fail if it needs more than it may."""
    text = _START.format(memory=MEMORY, seconds=SECONDS) + textwrap.dedent(code)
    done = subprocess.run(
        [sys.executable, "-c", text],
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
        preexec_fn=_no_core,
    )
    assert done.returncode == 0, f"code {done.returncode}: {done.stderr[-2000:]}"
    return done.stdout.splitlines()


def _no_core() -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


Attempt = Callable[[], object]
