"""How much is fuzzed: a few hundred examples with the other tests, or KNCAL_FUZZ of them (``make test-long``)."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, settings

EXAMPLES = int(os.environ.get("KNCAL_FUZZ", "0"))
#: Seconds for one example, whatever else the machine does; bytes beyond what the process has taken.
MOST_SECONDS, MOST_MEMORY = 20, 2 << 30


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """With KNCAL_FUZZ the tests of this folder are long ones."""
    for item in items:
        if EXAMPLES and item.path.is_relative_to(Path(__file__).parent):
            item.add_marker(pytest.mark.long)


def fuzzed(share: float = 1.0, short: int = 100) -> settings:
    """Settings of a fuzz test: ``short`` examples, or its ``share`` of KNCAL_FUZZ."""
    return settings(
        max_examples=max(int(EXAMPLES * share), 1) if EXAMPLES else short,
        deadline=None,
        database=None,
        derandomize=not EXAMPLES,
        suppress_health_check=list(HealthCheck),
        phases=[Phase.explicit, Phase.generate, Phase.shrink],
    )


@contextmanager
def in_time() -> Iterator[None]:
    """Fail if the block takes longer than `MOST_SECONDS`."""

    def stop(*_: object) -> None:
        raise AssertionError(f"not done within {MOST_SECONDS} s")

    old = signal.signal(signal.SIGALRM, stop)
    left = signal.alarm(MOST_SECONDS)  # what pytest-timeout had set
    try:
        yield
    finally:
        signal.alarm(left)
        signal.signal(signal.SIGALRM, old)


@pytest.fixture(scope="module", autouse=True)
def little_memory() -> Iterator[None]:
    """A parser that asks for gigabytes gets a MemoryError, which is no KncalError: the test fails."""
    import pandas  # noqa: F401  takes its address space first

    used = int(Path("/proc/self/statm").read_text("ascii").split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_MEMORY, hard))
    yield
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
