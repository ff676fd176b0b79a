"""What all tests share: see README.md beside this file for what runs when."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings

# A shared machine may stop for a moment in the middle of an example; that is no failure.
settings.register_profile("kncal", deadline=None)
settings.load_profile("kncal")

# A job started in the background ignores these and hands that on to every child; the tests of interruption need them
# as in a terminal.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

#: What a test without the marker `solver` may not start; `make check` runs without them.
SOLVERS = ("liggghts", "DPMFoam", "blockMesh", "decomposePar", "mpirun", "sbatch")


def pytest_configure(config: pytest.Config) -> None:
    """Put programs that fail in the place of the solvers where tests with them are left out."""
    if "not solver" in config.option.markexpr:
        folder = Path(tempfile.mkdtemp(prefix="kncal-no-solver-"))
        for name in SOLVERS:
            program = folder / name
            program.write_text(f"#!/bin/sh\necho '{name}: started by a test without the marker solver' >&2\nexit 97\n")
            program.chmod(0o755)
        os.environ["PATH"] = f"{folder}{os.pathsep}{os.environ['PATH']}"
        config.add_cleanup(lambda: shutil.rmtree(folder))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what starts the real LIGGGHTS where it is not installed.

    Dear modules come first, so that all workers end at about the same time.
    """
    if shutil.which("liggghts") is None:
        skip = pytest.mark.skip(reason="LIGGGHTS is not installed (apt-get install liggghts)")
        for item in items:
            if item.get_closest_marker("solver"):
                item.add_marker(skip)
    dear = {item.path for item in items if any(item.get_closest_marker(name) for name in ("solver", "slow"))}
    items.sort(key=lambda item: item.path not in dear)
