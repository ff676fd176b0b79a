"""Registries: kncal's own entries, and those of packages, which are imported only when they are asked for."""

from __future__ import annotations

import sys
from dataclasses import dataclass

import pytest

from kncal.core.errors import InputError
from kncal.core.registry import Registry

CODE = "from test_registry import Colour\nBLUE = Colour('blue', 3)\nGREY = 1\nWHITE = Colour('pale', 4)\n"


@dataclass(frozen=True)
class Colour:
    name: str
    value: int


RED = Colour("red", 1)


@pytest.fixture
def colours(tmp_path, monkeypatch):
    """A registry, and an installed package that adds good and bad entries to it."""
    for name, own in (("paint-1.5", "blue grey white red"), ("lost-2", "green")):
        info = tmp_path / f"{name}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Name: {name.split('-')[0]}\nVersion: {name.split('-')[1]}\n", encoding="utf-8")
        points = [f"{key} = {name.split('-')[0]}:{key.upper()}\n" for key in own.split()]
        (info / "entry_points.txt").write_text("[test.colours]\n" + "".join(points), encoding="utf-8")
    (tmp_path / "paint.py").write_text(CODE, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    yield Registry("colour", Colour, RED, group="test.colours")
    sys.modules.pop("paint", None)


def test_own_entries_come_first_and_need_no_package(colours):
    assert colours["red"] is colours.find("red") is colours.find(RED) is RED
    assert "paint" not in sys.modules
    assert list(colours) == ["red", "blue", "grey", "white", "green"]
    assert len(colours) == 5
    assert "paint" not in sys.modules
    assert colours.source("red") == ""


def test_package_adds_an_entry(colours):
    assert colours.find("blue").value == 3
    assert colours["blue"] is colours["blue"]
    assert colours.source("blue") == "paint 1.5"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("blu", "expected one of .*; did you mean 'blue'"),
        (["red"], "expected one of"),
        ("grey", "'grey' of the package paint 1.5 .*expected a Colour of this name, not int"),
        ("white", "expected a Colour of this name"),
        ("green", "'green' of the package lost 2 .*ModuleNotFoundError.*uninstall"),
    ],
)
def test_what_is_not_there_or_broken_is_said(colours, name, message):
    with pytest.raises(InputError, match=f"colour.*{message}"):
        colours.find(name)


def test_unknown_key_is_a_key_error_as_in_every_mapping(colours):
    assert colours.get("pink") is None
    with pytest.raises(KeyError):
        colours["pink"]
