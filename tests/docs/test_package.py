"""The package as others get it: the wheel, its installation, the set-up by make, the repository's files."""

from __future__ import annotations

import ast
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

from kncal.cli import main

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
HEAVY = ("scipy", "pandas", "pyvista", "vtk", "vtkmodules", "matplotlib", "meshio")


def run(command: list[str | Path], cwd: Path, **settings: str) -> subprocess.CompletedProcess[str]:
    """Run ``command`` in ``cwd`` with nothing to read and with no trace of this test run's own Python."""
    hidden = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "MAKEFLAGS", "MAKELEVEL", "MFLAGS")
    environment = {key: value for key, value in os.environ.items() if key not in hidden}
    return subprocess.run(
        command,
        cwd=cwd,
        env={**environment, **settings},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def succeed(command: list[str | Path], cwd: Path, **settings: str) -> str:
    """Run ``command`` as `run` does; fail with all it printed unless it succeeds, else return that."""
    done = run(command, cwd, **settings)
    assert done.returncode == 0, f"{command} ended with {done.returncode}:\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def repository() -> list[Path]:
    """Every file that is in git or would be with the next `git add`, relative to the root."""
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    listed = succeed(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], ROOT)
    return [Path(name) for name in listed.split("\0") if name and (ROOT / name).is_file()]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    # No isolation: the back end is part of the development extra, so that no network is needed.
    succeed([sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, ROOT], folder)
    (built,) = folder.glob("kncal-*.whl")
    return built


def borrowing_environment(folder: Path) -> Path:
    """Make an environment without kncal that borrows the other packages from this one; return its Python.

    Installing them anew (VTK alone has hundreds of megabytes) would take a minute. The folder named in a .pth
    file only provides packages; its own .pth files, so the link to this checkout, are not followed.
    """
    succeed([sys.executable, "-m", "venv", "--without-pip", folder], folder.parent)
    python = folder / "bin" / "python"
    ours = succeed([python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], folder).strip()
    theirs = sysconfig.get_path("purelib")
    Path(ours, "borrowed.pth").write_text(f"{theirs}\n", encoding="utf-8")
    missing = run([python, "-c", "import numpy, kncal.core.errors"], folder)
    assert "No module named 'kncal" in missing.stderr, "the environment to install into is not empty"
    return python


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The `bin` folder of an environment that has kncal from the wheel, and from nowhere else."""
    python = borrowing_environment(tmp_path_factory.mktemp("wheel") / "environment")
    succeed([python, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", wheel], python.parent)
    return python.parent


# --- the wheel ----------------------------------------


def test_wheel_holds_code_cases_templates_and_licence(wheel, repository):
    held = set(zipfile.ZipFile(wheel).namelist())
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in held)
    for path in repository:
        if path.parts[0] in ("cases", "templates"):
            assert f"kncal/_data/{path.as_posix()}" in held
        if path.parts[0] == "kncal":
            assert path.as_posix() in held
    assert any(name.startswith("kncal/_data/cases/") and name.endswith("case.toml") for name in held)
    assert any(name.startswith("kncal/_data/templates/liggghts/") for name in held)


def test_wheel_holds_nothing_else(wheel, repository):
    known = {path.as_posix() for path in repository}
    for name in zipfile.ZipFile(wheel).namelist():
        if ".dist-info/" not in name:
            assert name.removeprefix("kncal/_data/") in known


def test_wheel_says_its_licence_and_its_python(installed):
    text = succeed(
        [installed / "python", "-c", "import importlib.metadata as m; print(m.metadata('kncal'))"], installed
    )
    assert "License-Expression: GPL-3.0-or-later" in text
    assert "Requires-Python: >=3.11" in text


def test_installed_package_is_not_the_checkout(installed, tmp_path):
    found = succeed([installed / "python", "-c", "import kncal; print(kncal.__file__)"], tmp_path).strip()
    assert Path(found).is_relative_to(installed.parent)


def test_installed_command_runs_a_case(installed, tmp_path):
    out = tmp_path / "wall"
    succeed([installed / "kncal", "run", "wall_impact", "--engine", "builtin", "--out", out], tmp_path)
    results = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(out.rglob("result.json"))]
    assert results, f"no result.json in {out}"
    assert {result["status"] for result in results} == {"completed"}


def test_every_import_is_declared():
    """What kncal imports is what it requires: others' dependencies may go away."""
    halves = {"pydantic_core": "pydantic"}  # released together, each requires the other's exact version
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    required, of_dask = (
        {re.match(r"[\w.-]+", text).group().lower() for text in texts}
        for texts in (project["dependencies"], project["optional-dependencies"]["dask"])
    )
    provided_by = metadata.packages_distributions()
    for path in sorted((ROOT / "kncal").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names.append(node.module)
            for top in {name.split(".")[0] for name in names} - {"kncal"} - set(sys.stdlib_module_names):
                owners = {halves.get(owner, owner).lower().replace("_", "-") for owner in provided_by.get(top, [])}
                declared = required | (of_dask if path.name.startswith("dask_") else set())  # these check for the extra
                assert owners & declared, f"{path.name} imports {top}, which pyproject.toml does not require"


def test_imports_of_kncal_and_of_its_command_are_light(tmp_path):
    code = f"import sys, kncal, kncal.cli; print([name for name in {HEAVY!r} if name in sys.modules])"
    assert succeed([sys.executable, "-c", code], tmp_path).strip() == "[]"


# --- the set-up ----------------------------------------


def shipped_to(folder: Path) -> Path:
    """Copy what `make setup` needs into ``folder``."""
    folder.mkdir()
    for name in (".ci", "kncal", "cases", "templates"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("Makefile", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder)
    return folder


@pytest.fixture(scope="module")
def set_up(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """A checkout in a folder with an awkward name, set up by make; and the settings to call make with."""
    folder = tmp_path_factory.mktemp("set_up")
    checkout = shipped_to(folder / "my check out, $HOME's")
    borrowing_environment(checkout / ".venv")
    # A test installs nothing on the machine it runs on: whatever is missing stays missing.
    (folder / "bin").mkdir()
    for name in ("apt-get", "sudo"):
        program = folder / "bin" / name
        program.write_text("#!/bin/sh\necho no network >&2\nexit 1\n", encoding="utf-8")
        program.chmod(0o755)
    settings = {
        "PATH": f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "PIP_NO_BUILD_ISOLATION": "0",  # pip's way to say "no isolation": no network is needed
        "CDPATH": str(folder),
    }
    assert "installing kncal" in succeed(["make", "setup-dev"], checkout, **settings)
    return checkout, settings


@pytest.mark.solver
def test_set_up_links_to_its_own_checkout(set_up, tmp_path):
    checkout, _ = set_up
    shown = succeed([checkout / ".venv/bin/python", "-c", "import kncal; print(kncal.__file__)"], tmp_path)
    assert Path(shown.strip()).is_relative_to(checkout)


@pytest.mark.solver
def test_second_set_up_does_nothing_and_is_quick(set_up):
    checkout, settings = set_up
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert "installing" not in succeed(["make", "setup", "setup-dev"], checkout, **settings)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    # CPU time: other tests run at the same time.
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 3.0


@pytest.mark.solver
def test_changed_requirements_are_installed(set_up):
    checkout, settings = set_up
    with (checkout / "pyproject.toml").open("a", encoding="utf-8") as file:
        file.write("\n# changed\n")
    assert "installing kncal" in succeed(["make", "setup"], checkout, **settings)


@pytest.mark.solver
@pytest.mark.parametrize("has_apt", [False, True])
def test_set_up_without_solver_says_what_to_install(set_up, tmp_path, has_apt):
    checkout, settings = set_up
    fakes, *real = settings["PATH"].split(os.pathsep)
    hidden = {"liggghts", "DPMFoam", "sudo", "apt-get"}
    for folder in [fakes] * has_apt + real:
        for program in Path(folder).iterdir() if Path(folder).is_dir() else ():
            link = tmp_path / program.name
            if (folder == fakes or program.name not in hidden) and not link.is_symlink():
                link.symlink_to(program)
    done = run(["make", "setup"], checkout, **settings | {"PATH": str(tmp_path)})
    assert done.returncode != 0
    assert ("apt-get install failed: liggghts" if has_apt else "no apt-get on this machine") in done.stderr
    assert "apt-get install liggghts" in done.stderr
    assert "--engine builtin" in done.stderr


def test_set_up_refuses_an_unknown_level(tmp_path):
    done = run(["bash", ROOT / ".ci/setup.sh", "everything"], tmp_path)
    assert done.returncode == 1
    assert "'everything'" in done.stderr


def test_make_alone_explains_itself():
    shown = succeed(["make", "--no-print-directory"], ROOT)
    for target in ("demo", "test", "lint", "clean"):
        assert f"make {target}" in shown


def code_of_readme() -> str:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return "\n".join(re.findall(r"```.*?```|`[^`\n]+`", text, flags=re.DOTALL))


def test_make_commands_of_the_readme_exist():
    targets = set(re.findall(r"\bmake ([a-z][a-z-]*)", code_of_readme()))
    assert {"demo", "test"} <= targets
    for target in sorted(targets):
        succeed(["make", "--dry-run", target], ROOT)


def test_kncal_commands_of_the_readme_exist(capsys):
    commands = set(re.findall(r"(?:^|`)(?:\.venv/bin/)?kncal ([a-z]+)", code_of_readme(), flags=re.MULTILINE))
    assert commands
    for command in sorted(commands):
        with pytest.raises(SystemExit) as stop:
            main([command, "--help"])
        assert not stop.value.code, (command, capsys.readouterr().err)


def test_continuous_integration_ends_with_the_tests():
    lines = (ROOT / ".ci/run").read_text(encoding="utf-8").split("\n")
    called = [line for line in lines if line.startswith("make ")]
    assert [line.split()[-1] for line in called] == ["lint", "test"]
    assert "set -eu" in lines


# --- the repository ----------------------------------------


def test_no_file_names_a_machine_or_a_registry(repository):
    """Paths of somebody's machine, and hosts of package registries: neither is the same elsewhere."""
    forbidden = re.compile(
        r"(?<![\w.])/(?:home|root|work|Users|mnt)/\w"
        r"|\bpypi\.org|\bpythonhosted\.org|\b(?:deb|security|ftp)\.debian\.org|\bregistry\.npmjs"
    )
    for path in repository:
        try:
            text = (ROOT / path).read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue  # a picture
        named = forbidden.search(text)
        assert named is None, f"{path} names {named.group()!r}"
        assert str(ROOT) not in text, f"{path} names the folder of this checkout"


# --- a package that adds to kncal ----------------------------------------

PLUGIN = """
from dataclasses import replace
from kncal.physics.drag import DRAGS, Drag
from kncal.physics.laws import LAWS
from kncal.physics.methods import METHODS

LAW = replace(LAWS["tsuji"], name="my_law", title="Mine", liggghts="")
METHOD = replace(METHODS["max_overlap"], name="my_method", kappa=lambda q: 2.0)
DRAG = Drag(name="MyDrag", title="Stokes", source="Stokes (1851)", openfoam="SphereDrag",
            per_slip=lambda eps, slip, d, rho, mu: 18.0 * mu / d**2)
"""
USE = """
import kncal
from kncal.physics.drag import DRAGS
glass = kncal.Material(young=70e9, poisson=0.22, density=2500)
beads = kncal.pair(glass, 1e-3)
mine = kncal.calibrate(beads, v_0=0.5, e_n=0.9, law="my_law")
assert mine.k_n == kncal.calibrate(beads, v_0=0.5, e_n=0.9, law="tsuji").k_n and mine.law == "my_law"
assert kncal.calibrate(beads, v_0=0.5, e_n=0.9, method="my_method").kappa == 2.0
assert DRAGS["MyDrag"].per_slip(1.0, 0.0, 1e-3, 1.2, 1.8e-5) == 18.0 * 1.8e-5 / 1e-3**2
try:
    kncal.calibrate(beads, v_0=0.5, e_n=0.9, law="mylaw")
except kncal.InputError as error:
    print(error)
"""


def test_an_installed_package_adds_a_law_a_method_and_a_drag_law(installed, tmp_path):
    project = tmp_path / "plug"
    project.mkdir()
    (project / "plug.py").write_text(PLUGIN, encoding="utf-8")
    points = {"laws": "my_law = 'plug:LAW'", "methods": "my_method = 'plug:METHOD'", "drags": "MyDrag = 'plug:DRAG'"}
    text = "[build-system]\nrequires = ['hatchling']\nbuild-backend = 'hatchling.build'\n"
    text += "[project]\nname = 'plug'\nversion = '1.5'\n[tool.hatch.build]\ninclude = ['plug.py']\n"
    text += "".join(f"[project.entry-points.'kncal.{group}']\n{line}\n" for group, line in points.items())
    (project / "pyproject.toml").write_text(text, encoding="utf-8")
    flags = ["--quiet", "--no-deps", "--no-index", "--no-build-isolation"]
    succeed([installed / "python", "-m", "pip", "install", *flags, project], tmp_path)
    try:
        assert "did you mean 'my_law'" in succeed([installed / "python", "-c", USE], tmp_path)
        found = json.loads(succeed([installed / "kncal", "laws", "--json"], tmp_path))
        added = {kind: [(e["name"], e["package"]) for e in entries if e["package"]] for kind, entries in found.items()}
        assert added == {
            "laws": [("my_law", "plug 1.5")],
            "methods": [("my_method", "plug 1.5")],
            "drags": [("MyDrag", "plug 1.5")],
        }
        flags = ["--young", "70e9", "--density", "2500", "--radius", "1e-3", "--v0", "0.5", "--en", "0.9"]
        assert "my_law" in succeed([installed / "kncal", "kn", *flags, "--law", "my_law"], tmp_path)
    finally:
        succeed([installed / "python", "-m", "pip", "uninstall", "--quiet", "--yes", "plug"], tmp_path)
