"""What a kill leaves in temporary folders, reports and caches is removed by the next start, and nothing else is."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from kncal.core.files import replacing, sweep_parts, write_text
from kncal.core.scratch import drawn_aside, scratch

DIE = "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"
KILLED = {
    "folder": f"with scratch(here) as f:\n    (f / 'x').write_text('x')\n    {DIE}",
    "figures": f"with drawn_aside(here) as f:\n    (f / 'x.png').write_text('x')\n    {DIE}",
    "file": f"with replacing(here / 'a.json') as f:\n    f.write(b'x')\n    {DIE}",
}


def killed(here: Path, what: str) -> None:
    """Kill a process of its own in the middle of its work in ``here``."""
    code = "import sys; from pathlib import Path; here = Path(sys.argv[1])\n"
    code += (
        "from kncal.core.files import replacing\nfrom kncal.core.scratch import drawn_aside, scratch\n" + KILLED[what]
    )
    done = subprocess.run([sys.executable, "-c", code, str(here)], check=False)
    assert done.returncode == -signal.SIGKILL


def test_the_next_start_removes_what_nobody_holds(tmp_path: Path) -> None:
    own = [
        "kncal-thesis",
        "kncal-mine.scratch",
        ".figures-mine",
        ".a.json.part",
        ".b.json.abcdefgh.part",
        "a.json.part",
    ]
    for name in own:
        (tmp_path / name).mkdir()
    for what in KILLED:
        killed(tmp_path, what)
    assert len(list(tmp_path.iterdir())) == len(own) + 3
    with scratch(tmp_path) as mine, drawn_aside(tmp_path) as pictures, replacing(tmp_path / "a.json") as file:
        file.write(b"new")
        (pictures / "x.png").write_text("new")
        assert len(list(tmp_path.iterdir())) == len(own) + 3  # those of now
        with scratch(tmp_path), drawn_aside(tmp_path), replacing(tmp_path / "a.json"):
            assert mine.is_dir() and pictures.is_dir()  # held: not taken for leftovers
        sweep_parts(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {*own, "a.json", "x.png"}
    assert (tmp_path / "a.json").read_text() == "new"


def test_links_and_folders_named_like_leftovers_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "thesis.txt").write_text("x")
    (tmp_path / "kncal-abcdefgh.scratch").symlink_to("precious")
    (tmp_path / ".a.json.abcdefgh.part").symlink_to("precious/thesis.txt")
    (tmp_path / ".a.json.12345678.part").mkdir()
    with scratch(tmp_path):
        write_text(tmp_path / "a.json", "x")
    assert (tmp_path / "precious" / "thesis.txt").read_text() == "x"


def test_an_error_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("old")
    for _ in range(2):
        with pytest.raises(ZeroDivisionError), replacing(tmp_path / "a.json") as file:
            file.write(b"half")
            raise ZeroDivisionError
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a.json", "old")]


@pytest.mark.solver
def test_a_killed_run_leaves_no_temporary_folder_behind_the_next(tmp_path: Path) -> None:
    place, out = tmp_path / "tmp", tmp_path / "out"
    place.mkdir()
    text = (Path("cases") / "falling_particle" / "case.toml").read_text()
    (tmp_path / "case.toml").write_text(text.replace("until_bounces = 3", "until_time = 1000.0\nrecord_every = 1000"))
    start = [sys.executable, "-m", "kncal", "run"]
    environment = os.environ | {"TMPDIR": str(place)}
    run = subprocess.Popen([*start, tmp_path / "case.toml", "--out", out], env=environment, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while not (out / "linear" / "particles.dump").exists():
        assert run.poll() is None and time.monotonic() < deadline
        time.sleep(0.02)
    run.kill()
    run.wait()
    assert [path.name for path in place.iterdir() if path.name.startswith("kncal-")]
    shutil.copy(out / "case.toml", out / "linear" / ".result.json.abcdefgh.part")  # as if killed a moment later
    again = [*start, "wall_impact", "--engine", "builtin", "--out", out]
    done = subprocess.run(again, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert list(place.iterdir()) == []
    assert not list(out.rglob("*.part"))
