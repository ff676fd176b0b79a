"""A stranger's case folder shows nothing of the user's files: no link is followed out of it, errors quote little."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from kncal.cli import main
from kncal.core.errors import CaseFileError
from kncal.scene.case_file import load_case
from kncal.scene.case_text import find_case

LINE = "AWS_KEY=hunter2"


@pytest.fixture
def here(capsys: pytest.CaptureFixture[str]):
    def run(*arguments: object) -> tuple[int, str]:
        with pytest.raises(SystemExit) as stop:
            main([str(a) for a in arguments])
        captured = capsys.readouterr()
        return stop.value.code, captured.out + captured.err

    return run


@pytest.mark.parametrize("target", ["/proc/self/environ", "../secret.env", "{secret}"])
@pytest.mark.parametrize("named", ["folder", "file"])
def test_a_case_that_is_a_link_out_of_its_folder_is_not_read(here, tmp_path: Path, target: str, named: str) -> None:
    secret = tmp_path / "secret.env"
    secret.write_text(f"{LINE}\n")
    (tmp_path / "ev").mkdir()
    (tmp_path / "ev" / "case.toml").symlink_to(target.format(secret=secret))
    case = tmp_path / "ev" / ("case.toml" if named == "file" else "")
    for command in (["needs", case], ["run", case, "--engine", "builtin"], ["sweep", case, "--set", "contact.e_n=0.5"]):
        code, text = here(*command)
        assert code == 2
        assert "case.toml" in text
        assert "hunter2" not in text
        assert not any(f"{key}={value}"[:20] in text for key, value in os.environ.items())


def test_links_within_the_folder_and_folders_that_are_links_are_read(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "mine.toml").write_text(find_case("wall_impact").read_text())
    (tmp_path / "real" / "case.toml").symlink_to("mine.toml")
    (tmp_path / "other").symlink_to("real")
    assert load_case(tmp_path / "other").particles == load_case("wall_impact").particles


@pytest.mark.parametrize("name", ["wall_impact", "bubbling_bed_mini"])
def test_errors_quote_at_most_80_characters_of_a_case(tmp_path: Path, name: str) -> None:
    """A long text in place of each value, of each key, and as a line that is no TOML."""
    long = "A" * 3000
    text = find_case(name).read_text()
    lines = text.splitlines()
    keys = [i for i, line in enumerate(lines) if re.match(r"[A-Za-z_]+ *=", line)]
    refused = 0
    for i in keys:
        key = lines[i].partition("=")[0]
        for changed in (f'{key}= "{long}"', f"{key}= {long}", f"{long} = 1\n{lines[i]}", f'{key}= ["{long}"]', long):
            (tmp_path / "case.toml").write_text("\n".join([*lines[:i], changed, *lines[i + 1 :]]))
            try:
                load_case(tmp_path, name="x")
            except CaseFileError as error:
                refused += 1
                assert "A" * 81 not in str(error), changed[:80]
    assert refused > 4 * len(keys)


@pytest.mark.parametrize(
    "junk", [b"PATH=/bin\0HOME=/root\0", b"\x1b[31mred\n", b"a = 1\nb\x07ell\n", "x\u202ey\n".encode()]
)
def test_a_line_that_is_not_text_is_not_quoted(tmp_path: Path, junk: bytes) -> None:
    (tmp_path / "case.toml").write_bytes(junk)
    with pytest.raises(CaseFileError) as error:
        load_case(tmp_path)
    assert "line" in str(error.value)
    assert str(error.value).isprintable()
    assert not any(word in str(error.value) for word in ("HOME", "31m", "ell\\", "\\u202e"))


def test_what_is_no_regular_file_is_no_case(here, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "case.toml")
    for case in (tmp_path, tmp_path / "case.toml", "/dev/zero"):
        assert here("needs", case)[0] == 2
