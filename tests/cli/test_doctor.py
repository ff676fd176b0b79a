"""`kncal.cli.machine`: it tells the truth about this machine, and about machines that lack something."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from kncal.cli import machine as doctor
from kncal.core import installed
from kncal.engines.dpmfoam import installed as openfoam
from kncal.engines.liggghts import installed as liggghts


def finding(findings: list[doctor.Finding], name: str) -> doctor.Finding:
    return next(f for f in findings if f.name == name)


def program(folder: Path, name: str, script: str) -> None:
    """Put an executable shell script called ``name`` in ``folder``."""
    path = folder / name
    path.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[doctor.Finding], list[Path]]:
    """This machine's findings, and what they left behind in the working folder."""
    folder = tmp_path_factory.mktemp("here")
    before = Path.cwd()
    os.chdir(folder)
    try:
        findings = doctor.examine()
        return findings, list(folder.iterdir())
    finally:
        os.chdir(before)


@pytest.mark.slow
def test_leaves_nothing_behind(here):
    assert here[1] == []


def test_each_finding_says_what_it_is_for_and_how_to_mend_it(here):
    findings = here[0]
    names = [f.name for f in findings]
    assert len(names) == len(set(names))
    for found in findings:
        assert found.found and found.needed_for
        assert bool(found.hint) is not found.ok


def test_packages_are_those_that_kncal_requires(here):
    packages = {f.name.removeprefix("package "): f for f in here[0] if f.name.startswith("package ")}
    assert {"numpy", "scipy", "pyvista", "matplotlib"} <= set(packages)
    assert not {"pytest", "ruff"} & set(packages), "the development extra is not needed to use kncal"
    assert packages["numpy"].found == np.__version__
    assert all(f.ok for f in packages.values())


def test_package_too_old_or_missing():
    numpy = doctor._package("numpy", f">{metadata.version('numpy')}")
    assert not numpy.ok
    assert metadata.version("numpy") in numpy.found
    assert "pip install" in numpy.hint
    absent = doctor._package("no-such-package-of-kncal", ">=1")
    assert not absent.ok
    assert "nothing" in absent.found


@pytest.mark.solver
def test_finds_the_installed_liggghts(here):
    found = finding(here[0], "LIGGGHTS")
    banner = subprocess.run(
        ["liggghts", "-log", "none"], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=True
    ).stdout
    version = found.found.split()[0]
    assert f"LIGGGHTS-PUBLIC {version}," in banner
    assert found.ok is (version == "3.8.0")


@pytest.mark.solver
@pytest.mark.skipif(not Path("/usr/bin/DPMFoam").exists(), reason="OpenFOAM is not installed")
@pytest.mark.parametrize("given", [None, "/usr/share/openfoam"])
def test_finds_openfoam_without_its_environment(monkeypatch, given):
    if given is None:
        monkeypatch.delenv("WM_PROJECT_DIR", raising=False)
    else:
        monkeypatch.setenv("WM_PROJECT_DIR", given)
    found = openfoam.look()
    assert found.ok
    assert found.found.startswith("1912 (patch=")


@pytest.mark.solver
@pytest.mark.skipif(not Path("/usr/bin/DPMFoam").exists(), reason="OpenFOAM is not installed")
def test_wrong_openfoam_folder_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("WM_PROJECT_DIR", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    found = openfoam.look()
    assert not found.ok
    assert str(tmp_path) in found.hint


def test_machine_without_solvers(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    for look, package in (
        (liggghts.look, "liggghts"),
        (openfoam.look, "openfoam"),
        (doctor._mpirun, "openmpi-bin"),
    ):
        found = look()
        assert not found.ok
        assert found.hint == f"apt-get install {package}"


@pytest.mark.parametrize(
    ("script", "told"),
    [
        ("/bin/sleep 60", "no answer within 0.5 s"),
        ("/bin/sleep 60 & wait", "no answer within 0.5 s"),
        ("exit 0", "does not say its version: it printed nothing"),
        ("echo cannot open libmpi.so >&2; exit 127", "ended with code 127: cannot open libmpi.so"),
        ("kill -SEGV $$", "was ended by signal 11"),
        (r"printf 'x \033]0;title\007\377\n'; exit 1", "ended with code 1"),
    ],
)
def test_broken_program_is_reported_in_time(monkeypatch, tmp_path, script, told):
    program(tmp_path, "liggghts", script)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(installed, "SOLVER_LIMIT", 0.5)
    start = time.perf_counter()
    found = liggghts.look()
    assert time.perf_counter() - start < 5.0
    assert not found.ok
    assert told in found.found
    assert found.found.isprintable()
    assert found.hint


def test_program_that_cannot_be_started(monkeypatch, tmp_path):
    program(tmp_path, "liggghts", "")
    (tmp_path / "liggghts").write_text("#!/no/such/interpreter\n", encoding="utf-8")
    monkeypatch.setenv("PATH", str(tmp_path))
    found = liggghts.look()
    assert not found.ok
    assert "cannot be started" in found.found


def test_crash_of_the_graphics_library_is_survived(monkeypatch):
    monkeypatch.setattr(doctor, "RENDER_PROBE", f"import os; os.kill(os.getpid(), {signal.SIGSEGV.value})")
    found = doctor._rendering()
    assert not found.ok
    assert "signal 11" in found.found
    assert "libegl1" in found.hint


def test_rendering_probe_names_its_window(here):
    found = finding(here[0], "off-screen rendering")
    if found.ok:
        assert found.found.startswith("vtk")
    else:
        assert "the trial" in found.found


def test_full_disk(tmp_path):
    found = doctor._disk(tmp_path, room=1e30)
    assert not found.ok
    assert str(tmp_path) in found.found
    assert doctor._disk(tmp_path, room=0.0).ok


def test_unusable_temporary_folder(monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    found = doctor._temporary_folder()
    assert not found.ok
    assert "TMPDIR" in found.hint


def test_shipped_files_are_counted(here):
    for name in ("cases", "templates"):
        found = finding(here[0], name)
        assert found.ok
        assert int(found.found.split()[0]) >= 1


def test_python_is_the_one_that_runs(here):
    assert sys.executable in finding(here[0], "Python").found


@pytest.mark.solver
def test_solvers_that_are_asked_side_by_side_all_answer():
    """Open MPI's folder of a start goes with it: shared, about one start in 25 died of another's end."""
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda _: liggghts.look(), range(60)))
    assert {(a.ok, a.found) for a in answers} == {(True, answers[0].found)}
