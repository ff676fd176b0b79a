"""What all tests share."""

from __future__ import annotations

import shutil
import signal

import pytest
from hypothesis import settings

# A shared machine may stop for a moment in the middle of an example; that is no failure.
settings.register_profile("kncal", deadline=None)
settings.load_profile("kncal")

# A job started in the background ignores these and hands that on to every child; the tests of interruption need them
# as in a terminal.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what starts the real LIGGGHTS where it is not installed."""
    if shutil.which("liggghts") is None:
        skip = pytest.mark.skip(reason="LIGGGHTS is not installed (apt-get install liggghts)")
        for item in items:
            if item.get_closest_marker("solver"):
                item.add_marker(skip)
