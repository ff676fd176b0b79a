"""``kncal new`` copies all that a shipped case needs."""

from pathlib import Path

import pytest

from kncal.cli.cases import new
from kncal.scene.case_file import load_case, shipped_cases


@pytest.mark.parametrize("name", [name for name in shipped_cases() if load_case(name).files])
def test_a_copy_has_the_files_that_its_case_names(name: str, tmp_path: Path) -> None:
    new(name, tmp_path / "mine")
    made, shipped = load_case(tmp_path / "mine"), load_case(name)
    assert made.walls == shipped.walls
    for file in shipped.files:
        assert made.path_of(file).read_bytes() == shipped.path_of(file).read_bytes()
