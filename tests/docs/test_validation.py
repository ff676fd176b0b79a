"""The page of validation is what is stored, what is stored is what is compared, and each comparison has a reference."""

from __future__ import annotations

import importlib
import json
import shlex
import sys
from pathlib import Path
from typing import Any

import pytest

from kncal import cli
from kncal.core.shipped import folder
from kncal.scene.case_file import load_case
from kncal.scene.metrics import METRICS, split_metric

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def made() -> Any:
    sys.path.insert(0, str(DOCS))
    try:
        return importlib.import_module("make_validation")
    finally:
        sys.path.remove(str(DOCS))


@pytest.fixture(scope="module")
def stored(made: Any) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(made.STORE.read_text("utf-8"))
    return found


def test_the_page_is_what_is_stored(made: Any, stored: dict[str, Any]) -> None:
    """Else run python docs/make_validation.py."""
    assert made.page(stored) in made.PAGE.read_text("utf-8")


def test_every_quick_comparison_was_made_and_none_is_outside(made: Any, stored: dict[str, Any]) -> None:
    assert len({entry.name for entry in made.ENTRIES}) == len(made.ENTRIES)
    for entry in made.ENTRIES:
        assert entry.long or entry.name in stored, f"python docs/make_validation.py {entry.case}"
    assert {item["verdict"] for item in stored.values()} <= {"ok", "undecided", "-"}


def test_every_comparison_has_a_case_and_a_reference(made: Any) -> None:
    for entry in made.ENTRIES:
        load_case(entry.case)
        assert entry.source, entry.name
        assert entry.value is not None or split_metric(entry.metric)[0] in METRICS, entry.name
        if entry.reference is None:
            expected = json.loads((folder("cases") / entry.case / "expected.json").read_text("utf-8"))
            for model in entry.models:
                assert entry.metric in expected["metrics"][model], entry.name


def test_the_commands_parse(made: Any) -> None:
    for command in {made.command(entry) for entry in made.ENTRIES}:
        cli.app.parse_args(shlex.split(command)[1:], exit_on_error=False, print_error=False)


@pytest.mark.long
@pytest.mark.timeout(0)
@pytest.mark.solver
@pytest.mark.parametrize("case", ["chute", "vibrated_bed"])
def test_flowing_beads_are_as_published(case: str, made: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for entry in made.ENTRIES:
        if entry.case == case:
            assert made.result(entry)["verdict"] in ("ok", "undecided"), entry.name
