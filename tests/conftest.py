"""What all tests share."""

from __future__ import annotations

import shutil

import pytest
from hypothesis import settings

# A shared machine may stop for a moment in the middle of an example; that is no failure.
settings.register_profile("kncal", deadline=None)
settings.load_profile("kncal")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what starts the real LIGGGHTS where it is not installed."""
    if shutil.which("liggghts") is None:
        skip = pytest.mark.skip(reason="LIGGGHTS is not installed (apt-get install liggghts)")
        for item in items:
            if item.get_closest_marker("solver"):
                item.add_marker(skip)
