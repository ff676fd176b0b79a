"""What a machine, an impatient user or a meddler does to a run: refused or reported, never a traceback."""

from __future__ import annotations

import dataclasses
import errno
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from kncal.core.errors import InputError, RenderError, RunError, SolverMissingError, ValidityError
from kncal.core.lock import LOCK, locked, sign
from kncal.core.process import run_process
from kncal.engines.liggghts.batch import Liggghts
from kncal.engines.registry import get_engine
from kncal.runs.folder import write_result
from kncal.runs.workflow import load, render_case, run_case
from kncal.scene.case_file import load_case
from kncal.scene.exact import solve
from kncal.scene.plan import plan

pytestmark = pytest.mark.slow

KNCAL = (sys.executable, "-m", "kncal")


def kncal(*arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
    """The command line in a process of its own."""
    command = [*KNCAL, *(str(a) for a in arguments)]
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True} | options
    return subprocess.run(command, check=False, **options)  # type: ignore[call-overload,no-any-return]


@pytest.fixture(scope="module")
def long_case(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("long")
    text = (Path("cases") / "falling_particle" / "case.toml").read_text()
    (folder / "case.toml").write_text(text.replace("until_bounces = 3", "until_time = 1000.0\nrecord_every = 1000"))
    return folder / "case.toml"


def wait_until(condition, limit: float = 60.0) -> None:
    deadline = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


# --- one owner --------------------------------------------------------------------------------------------------------


def test_second_start_is_refused_and_touches_nothing(here, done: Path) -> None:
    before = sorted(path.relative_to(done) for path in done.rglob("*"))
    with locked(done) as lock:
        sign(lock)
        code, err = here("run", "wall_impact", "--engine", "builtin", "--out", done)
    assert code == 2
    assert f"in use by pid {os.getpid()} on {os.uname().nodename}, started 20" in err
    assert sorted(path.relative_to(done) for path in done.rglob("*")) == before


def test_a_solver_that_outlives_kncal_still_owns_its_folder(tmp_path: Path) -> None:
    with locked(tmp_path) as lock:
        child = subprocess.Popen(["sleep", "30"], pass_fds=[lock])
    try:
        with pytest.raises(RenderError, match="in use by"), locked(tmp_path):
            pass
    finally:
        child.kill()
        child.wait()
    with locked(tmp_path):
        pass


def test_the_runner_hands_descriptors_on(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with (tmp_path / "file").open() as file:
        number = file.fileno()
        seen = [
            run_process(
                (sys.executable, "-c", f"import os; os.fstat({number})"),
                cwd=tmp_path,
                log=tmp_path / "log",
                pass_fds=fds,
            ).returncode
            for fds in ((number,), ())
        ]
    assert seen == [0, 1]


# --- nothing is touched before a refusal ------------------------------------------------------------------------------


def test_old_results_stay_in_place_when_a_run_is_refused(scene, done: Path, tmp_path: Path, monkeypatch) -> None:
    before = sorted(done.rglob("*"))
    for options in ({"timeout": -1.0}, {"repeat": 0}, {"kinds": ("hooke",)}):
        with pytest.raises(InputError):
            run_case(scene, get_engine("builtin"), done, **options)

    class NoDeck(type(get_engine("builtin"))):  # type: ignore[misc]
        def render(self, model, folder, **_):
            raise RenderError("no")

    with pytest.raises(RenderError):
        render_case(scene, NoDeck(), done)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SolverMissingError, match="apt-get"):
        run_case(scene, get_engine("liggghts"), done)
    assert sorted(done.rglob("*")) == before


@pytest.mark.parametrize("arguments", [("--out", ""), ("--out=",)])
def test_an_empty_folder_name_is_refused(here, tmp_path: Path, monkeypatch, arguments) -> None:
    monkeypatch.chdir(tmp_path)
    code, err = here("render", "wall_impact", *arguments)
    assert code == 2
    assert "empty" in err
    assert not list(tmp_path.iterdir())


# --- interruption -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("engine", "number"),
    [
        ("builtin", signal.SIGINT),
        pytest.param("liggghts", signal.SIGINT, marks=pytest.mark.solver),
        pytest.param("liggghts", signal.SIGTERM, marks=pytest.mark.solver),
        ("builtin", signal.SIGHUP),
    ],
)
def test_interrupted_is_130_with_a_record_and_no_leftovers(
    engine: str, number: int, long_case: Path, tmp_path: Path
) -> None:
    (tmp_path / "tmp").mkdir()
    out = tmp_path / "out" / "linear"
    child = subprocess.Popen(
        # a SIGINT that is ignored (in a background job) would be inherited
        [
            "env",
            "--default-signal=INT",
            *KNCAL,
            "run",
            str(long_case),
            "--engine",
            engine,
            "--model",
            "linear",
            "--out",
            str(out.parent),
        ],
        env={**os.environ, "TMPDIR": str(tmp_path / "tmp")},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        process_group=0,
    )
    log = out / "log.liggghts"
    wait_until(lambda: log.is_file() and "Step" in log.read_text() if engine == "liggghts" else out.is_dir())
    time.sleep(0.3)
    os.killpg(child.pid, number)
    _, err = child.communicate(timeout=60)
    assert child.returncode == 130, err
    assert "interrupted" in err
    assert "Traceback" not in err
    assert json.loads((out / "result.json").read_text())["status"] == "interrupted"
    assert not list((tmp_path / "tmp").iterdir())


# --- the disk, the pipe, the terminal ---------------------------------------------------------------------------------


def test_a_full_disk_in_a_run_is_a_failed_run(here, scene, tmp_path: Path, monkeypatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "somewhere")

    monkeypatch.setattr("kncal.runs.folder.write_json", full)
    code, err = here("run", "wall_impact", "--engine", "builtin", "--out", tmp_path / "a")
    assert (code, err) == (3, "kncal: somewhere: No space left on device\n")
    with pytest.raises(RunError, match="cannot be written"):
        write_result(_some_result(scene, tmp_path))


def _some_result(scene, folder: Path):
    from kncal.engines.base import run_result

    return run_result("builtin", plan(scene)["linear"], folder, "failed", message="x")


@pytest.mark.parametrize("trouble", ["memory", "file", "long", "link"])
def test_no_traceback_and_never_exit_code_1(here, done: Path, tmp_path: Path, monkeypatch, trouble: str) -> None:
    report = tmp_path / "page"
    expected = 2
    if trouble == "memory":
        monkeypatch.setattr("kncal.report.comparison.draw_comparison", lambda *_: (_ for _ in ()).throw(MemoryError))
        expected = 3
    elif trouble == "file":
        report.write_text("precious")
    elif trouble == "link":
        report.symlink_to(tmp_path)
    else:
        report = tmp_path / ("x" * 300)
    code, err = here("report", done, "--out", report)
    assert code == expected
    assert err.startswith("kncal: ")
    assert err.count("\n") == 1


def test_output_to_a_full_device_or_a_deleted_folder(tmp_path: Path) -> None:
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = kncal("laws", stdout=full)
    assert (done.returncode, done.stderr) == (3, "kncal: output: No space left on device\n")
    (tmp_path / "gone").mkdir()
    script = 'cd gone && rmdir ../gone && exec "$@"'
    done = subprocess.run(
        ["sh", "-c", script, "sh", *KNCAL, "run", "wall_impact", "--engine", "builtin"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path.cwd())},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode in (2, 3)
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("tolerance", [0.0001, 10.0])
def test_a_closed_pipe_leaves_the_verdict_in_the_exit_code(scene, tmp_path: Path, tolerance: float) -> None:
    judged = dataclasses.replace(scene, tolerances={"delta_max": tolerance})
    run_case(judged, get_engine("builtin"), tmp_path / "out")
    read, write = os.pipe()
    os.close(read)
    done = kncal("compare", tmp_path / "out" / "linear", tmp_path / "out" / "hertz", stdout=write)
    os.close(write)
    assert (done.returncode, done.stderr) == (int(tolerance < 1.0), "")


def test_help_into_a_closed_pipe() -> None:
    read, write = os.pipe()
    os.close(read)
    done = kncal("--help", stdout=write)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_terminal_that_has_only_ascii() -> None:
    env = {**os.environ, "PYTHONIOENCODING": "ascii"}
    assert kncal("cases", env=env).returncode == 0
    done = kncal("cases", "--json", env=env)
    assert done.returncode == 0
    assert {case["name"] for case in json.loads(done.stdout)} >= {"wall_impact"}


def test_links_in_a_report_folder_are_replaced_not_followed(done: Path, tmp_path: Path, here) -> None:
    precious = tmp_path / "precious"
    precious.write_text("mine")
    page = tmp_path / "page"
    page.mkdir()
    for name in ("index.html", "motion.png", "comparison.json"):
        (page / name).symlink_to(precious)
    code, _ = here("report", done, "--out", page)
    assert code == 0
    assert precious.read_text() == "mine"
    assert not any(path.is_symlink() or path.is_dir() for path in page.iterdir())


# --- numbers without bounds -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [("\ne_n = ", "\ne_n = 1e-300 #", "contact.e_n"), ("diameter = ", "diameter = 1e-200 #", "1 mm is 1e-3")],
)
def test_hopeless_numbers_are_refused_in_a_case(here, tmp_path: Path, old: str, new: str, words: str) -> None:
    text = (Path("cases") / "wall_impact" / "case.toml").read_text()
    assert old in text
    (tmp_path / "case.toml").write_text(text.replace(old, new, 1))
    code, err = here("render", tmp_path, "--out", tmp_path / "out")
    assert code == 2
    assert words in err


def test_a_contact_that_hardly_ever_ends_is_given_up_in_bounded_time() -> None:
    scene = load_case("falling_particle")
    control = dataclasses.replace(scene.run, until_bounces=None, until_time=1.0)
    scene = dataclasses.replace(scene, run=control)
    model = plan(scene)["hertz"]
    stiff = {names: dataclasses.replace(c, c=1e12 * c.c) for names, c in model.contacts.items()}
    started = time.process_time()
    with pytest.raises(ValidityError, match="too strongly damped"):
        solve(dataclasses.replace(model, contacts=stiff), 1.0)
    assert time.process_time() - started < 20.0


# --- the solver -------------------------------------------------------------------------------------------------------


def fake_solver(folder: Path, monkeypatch, script: str) -> None:
    program = folder / "liggghts"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")


@pytest.mark.solver
def test_another_version_runs_with_a_warning_everywhere(tmp_path: Path, monkeypatch) -> None:
    script = '[ $# = 2 ] && { echo "LIGGGHTS (Version LIGGGHTS-PUBLIC 9.9.9, x)"; exit; }\nexec /usr/bin/liggghts "$@"'
    fake_solver(tmp_path, monkeypatch, script)
    run = kncal("run", "wall_impact", "--model", "linear", "--out", tmp_path / "out")
    assert run.returncode == 0
    assert run.stderr == f"kncal: {tmp_path}/liggghts is LIGGGHTS 9.9.9; kncal knows 3.8.0: look at the results twice\n"
    for name, find in (("result", lambda d: d["extra"]), ("manifest", lambda d: d["solver"])):
        assert "9.9.9" in find(json.loads((tmp_path / "out" / "linear" / f"{name}.json").read_text()))["warning"]
    manifest = json.loads((tmp_path / "out" / "linear" / "manifest.json").read_text())
    assert manifest["solver"]["sha256"] == hashlib.sha256((tmp_path / "liggghts").read_bytes()).hexdigest()
    assert manifest["environment"]["LC_ALL"] == "C"


@pytest.mark.parametrize(
    ("script", "words"), [("echo no room in /tmp", "its version: no room in /tmp"), ("exec sleep 60", "within 0.3 s")]
)
def test_a_program_that_names_no_version_is_quoted(tmp_path: Path, monkeypatch, script: str, words: str) -> None:
    monkeypatch.setattr("kncal.core.installed.SOLVER_LIMIT", 0.3)
    fake_solver(tmp_path, monkeypatch, script)
    profile = Liggghts().profile()
    assert profile.program is None
    assert words in profile.problem


def test_no_descriptor_leaks_where_there_is_no_room_for_temporary_files(tmp_path: Path, monkeypatch) -> None:
    def no_room(**_: object) -> None:
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found")

    monkeypatch.setattr("kncal.core.scratch.tempfile.mkdtemp", no_room)
    before = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(FileNotFoundError):
        run_process(("true",), cwd=tmp_path, log=tmp_path / "log")
    assert len(list(Path("/proc/self/fd").iterdir())) == before


@pytest.mark.solver
def test_liggghts_own_spring_is_told_apart_and_read_back(tmp_path: Path) -> None:
    scene = load_case("wall_impact")
    scene = dataclasses.replace(
        scene, contact=dataclasses.replace(scene.contact, method="strain_energy", options={}, k_n=None)
    )
    run_case(scene, get_engine("liggghts-hooke"), tmp_path / "out", ("linear",))
    folder = tmp_path / "out" / "linear"
    assert json.loads((folder / "manifest.json").read_text())["engine"] == "liggghts-hooke"
    assert load(folder).result.engine == "liggghts-hooke"
    assert (tmp_path / "out" / LOCK).is_file()
