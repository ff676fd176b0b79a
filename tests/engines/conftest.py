"""Gas solvers for tests of physics."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from kncal.engines.base import GasSetup, GasSolver
from kncal.engines.dpmfoam.adapter_build import find
from kncal.engines.dpmfoam.live import LiveGas
from kncal.engines.dpmfoam.restart import RestartGas


@pytest.fixture
def quick(tmp_path: Path) -> Iterator[Callable[[GasSetup], GasSolver]]:
    """What makes a gas solver for many steps: by the live transport where it is built, which gives the same bits."""
    made: list[GasSolver] = []
    with ExitStack() as stack:

        def make(setup: GasSetup) -> GasSolver:
            library, folder = find(), tmp_path / f"gas{len(made)}"
            made.append(RestartGas(setup, folder) if library is None else LiveGas(setup, folder, library, 2000))
            return stack.enter_context(closing(made[-1]))

        yield make
