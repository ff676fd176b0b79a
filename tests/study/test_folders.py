"""A command of many runs writes into its own folder only, and finds it again."""

from __future__ import annotations

from pathlib import Path

import pytest

from kncal.cli import main
from kncal.core.errors import InputError
from kncal.study.folders import refuse_other
from kncal.study.trim.run import TrimOptions, trim

CASE = Path(__file__).parents[2] / "cases" / "falling_particle" / "case.toml"
QUICK = TrimOptions(engine="builtin", rounds=1, parts=("damping",))


@pytest.mark.parametrize("name", ["case.toml", "manifest.json", "sweep.json", "report"])
def test_a_folder_of_other_things_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("mine")
    with pytest.raises(InputError, match="nothing was changed"):
        refuse_other(tmp_path, "trim.json", ("runs",), "wall_impact")
    assert (tmp_path / name).read_text() == "mine"


@pytest.mark.parametrize("text", ["", "{}", '{"case": 5}', '{"price": 7.5}'])
def test_a_stranger_s_record_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "trade.json").write_text(text)
    with pytest.raises(InputError, match="nothing was changed"):
        refuse_other(tmp_path, "trade.json", ("runs",), "wall_impact")


def test_what_a_killed_start_left_is_taken_up(tmp_path: Path) -> None:
    refuse_other(tmp_path / "new", "trim.json", (), "wall_impact")
    for name in ("runs", ".lock", ".trim.json.x.part"):
        (tmp_path / name).mkdir()
    refuse_other(tmp_path, "trim.json", ("runs",), "wall_impact")


@pytest.mark.parametrize("command", [["trim", "wall_impact"], ["stability", "wall_impact", "--quick"]])
def test_commands_leave_a_case_folder_alone(tmp_path: Path, command: list[str]) -> None:
    (tmp_path / "case.toml").write_text("mine")
    with pytest.raises(SystemExit) as stop:
        main([*command, "--engine", "builtin", "--out", str(tmp_path)])
    assert stop.value.code == 2
    assert [path.name for path in tmp_path.iterdir()] == ["case.toml"]
    assert (tmp_path / "case.toml").read_text() == "mine"


@pytest.mark.slow
def test_a_measured_speed_is_found_again(tmp_path: Path) -> None:
    case = tmp_path / "fall.toml"
    case.write_text(CASE.read_text())
    options = TrimOptions(engine="builtin", rounds=1, parts=("damping",), overrides=('contact.v_0="measured"',))
    out = tmp_path / "out"
    told: list[str] = []
    first = trim(case, out, options, tell=told.append)
    second = trim(case, out, options)
    assert any("measuring v_0" in text for text in told)
    assert first.trimmed == second.trimmed


def test_the_case_is_not_written_over(tmp_path: Path) -> None:
    case = tmp_path / "fall.toml"
    case.write_text(CASE.read_text())
    before = case.read_bytes()
    with pytest.raises(InputError, match="holds the case itself"):
        trim(case, tmp_path, QUICK)
    assert case.read_bytes() == before
