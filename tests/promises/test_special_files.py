"""Pipes, devices and huge files in a run folder from elsewhere: nothing waits for them or reads them whole."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from kncal.cli import main
from kncal.core.errors import ReadError, RenderError, RunError
from kncal.engines.registry import get_engine
from kncal.runs.cleaning import plan_cleaning
from kncal.runs.states import case_states
from kncal.runs.workflow import load_both, run_case
from kncal.scene.case_file import load_case
from kncal.study import (
    Settings,
    ThreadExecutor,
    combine,
    design,
    grid_axis,
    read_design,
    read_sweep,
    run_sweep,
    sweep_status,
)
from kncal.study.execute import finished as finished_run
from kncal.study.execute import present

#: No command takes longer on a good folder than a second or two [s].
LIMIT = 30
FILES = ["manifest.json", "linear/manifest.json", "linear/result.json", "linear/started.json", "case.toml", ".lock"]
FILES += ["linear/particles.dump", "linear/builtin.log"]


@pytest.fixture(autouse=True)
def ended_if_it_hangs() -> Iterator[None]:
    def late(*_: object) -> None:
        raise AssertionError(f"no end after {LIMIT} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(LIMIT)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture
def here(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str]]:
    def run(*arguments: object) -> tuple[int, str]:
        with pytest.raises(SystemExit) as stop:
            main([str(a) for a in arguments])
        captured = capsys.readouterr()
        return stop.value.code, captured.out + captured.err

    return run


def special(path: Path, kind: str) -> None:
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        with path.open("wb") as file:
            file.truncate(1 << 43)  # sparse: no disk, weeks to read


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("finished") / "run"
    run_case(load_case("wall_impact"), get_engine("builtin"), out)
    return out


MANY = [(name, "pipe") for name in FILES]
MANY += [(name, kind) for name in (FILES[2], FILES[4], FILES[6]) for kind in ("device", "huge")]


@pytest.mark.parametrize(("name", "kind"), MANY)
def test_nothing_waits_for_a_file_of_a_run_folder(finished: Path, tmp_path: Path, name: str, kind: str) -> None:
    out = shutil.copytree(finished, tmp_path / "run")
    special(out / name, kind)
    case_states(out)
    plan_cleaning(tmp_path)
    if name in ("linear/started.json", ".lock", "manifest.json", "linear/builtin.log"):
        load_both(out)
    else:
        with pytest.raises(ReadError, match=Path(name).name):
            load_both(out)
    with suppress(RenderError, RunError):  # done anew, or refused
        run_case(load_case("wall_impact"), get_engine("builtin"), out)


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("swept") / "sweep"
    made, text = design("wall_impact", combine([grid_axis("contact.e_n=0.5,0.6")]), Settings(engine="builtin"))
    run_sweep(made, text, folder, ThreadExecutor(1))
    return folder


SWEPT = ["sweep.json", "case.toml", "states.jsonl", "{run}/row.json", "{run}/linear/result.json", "{run}/case.toml"]


@pytest.mark.parametrize(("name", "kind"), [*((name, "pipe") for name in SWEPT), ("states.jsonl", "device")])
def test_nothing_waits_for_a_file_of_a_sweep(swept: Path, tmp_path: Path, name: str, kind: str) -> None:
    folder = shutil.copytree(swept, tmp_path / "sweep")
    run = sorted((folder / "runs").iterdir())[0]
    path = folder / name.format(run=run.relative_to(folder))
    special(path, kind)
    if name == "sweep.json":
        for look in (sweep_status, read_sweep):
            with pytest.raises(ReadError, match=r"sweep\.json"):
                look(folder)
        return
    lost = path.name == "result.json"
    assert sweep_status(folder).counts == ({"completed": 1, "failed": 1} if lost else {"completed": 2})
    assert set(read_sweep(folder)["status"]) == ({"completed", "failed"} if lost else {"completed"})
    made = read_design(folder)
    for one in made.runs:
        damaged = one == run.name and name in ("{run}/linear/result.json", "{run}/case.toml")
        assert finished_run(made, folder, one, present(made, None)) is not damaged


def test_points_from_a_pipe_are_refused(here, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "points.csv")
    code, text = here("sweep", "wall_impact", "--engine", "builtin", "--points", tmp_path / "points.csv")
    assert code == 2
    assert "points.csv" in text


def test_a_lock_with_control_characters_is_shown_without(here, finished: Path, tmp_path: Path) -> None:
    from kncal.core.lock import locked
    from kncal.runs.states import holder

    out = shutil.copytree(finished, tmp_path / "run")
    with locked(out) as descriptor:
        os.pwrite(descriptor, b"pid 1 \x1b]0;x\x07 on h, started now\n", 0)
        assert holder(out).isprintable()
