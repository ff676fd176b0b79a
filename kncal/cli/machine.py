"""What this machine has of what kncal needs: one finding per thing, with a hint how to mend it.

Nothing here prints, and nothing missing raises: a finding says so. Solvers and the graphics library are
asked in child processes with a time limit: they may hang, and VTK crashes a process that has no libEGL.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib import metadata
from pathlib import Path

from kncal.core.errors import KncalError
from kncal.core.installed import SOLVER_LIMIT, Finding, ask, ask_version, last_line
from kncal.core.mpi import MPIRUN, run_ranks
from kncal.core.scratch import scratch
from kncal.core.shipped import folder
from kncal.engines.registry import ENGINES

#: Seconds that rendering may take to draw one sphere.
RENDER_LIMIT = 8.0

#: Free space that a run with its recorded frames and report should have [bytes].
ROOM = 10**9

#: Draws one sphere off the screen and says what kind of window did it; VTK prints its own warnings around it.
RENDER_PROBE = """
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=(64, 64))
plotter.add_mesh(pyvista.Sphere())
if plotter.screenshot(return_img=True).std() == 0:
    raise SystemExit("the picture is empty")
print("drawn by", plotter.render_window.GetClassName())
"""


def examine() -> list[Finding]:
    """Look at this machine; takes less than 10 s.

    Returns
    -------
    list of Finding
        Python, packages, solvers, rendering, disk (of the working folder), shipped files, temporary folder.
    """
    solvers = dict.fromkeys(look for entry in ENGINES.values() for look in entry.programs)
    slow: list[Callable[[], Finding]] = [*solvers, _mpirun, _rendering, _slurm]
    with ThreadPoolExecutor(len(slow)) as pool:
        started = [pool.submit(look) for look in slow]
        quick = [_python(), *_packages(), _dask(), _adapter()]
        asked = [future.result() for future in started]
    return [
        *quick,
        *asked,
        _disk(Path.cwd(), ROOM),
        _shipped("cases", "case.toml", "cases by name, such as `kncal run falling_particle`"),
        _shipped("templates", "*.j2", "writing solver input and reports"),
        _temporary_folder(),
    ]


def _adapter() -> Finding:
    from kncal.engines.dpmfoam.adapter_build import AdapterError, find

    try:
        library, found = find(), "not built"
    except AdapterError as error:
        library, found = None, str(error)
    return Finding(
        name="adapter",
        found=str(library or found),
        needed_for="fast coupled beds: the gas solver is not started again for each coupling",
        hint="" if library else "optional; kncal adapter build (downloads 45 MB, needs a C++ compiler)",
    )


def _python() -> Finding:
    return Finding(
        name="Python",
        found=f"{platform.python_version()} ({sys.executable})",
        needed_for="everything",
        hint="" if sys.version_info >= (3, 11) else "install Python 3.11 or newer",
    )


def _packages() -> list[Finding]:
    """One finding for kncal itself and one for each package that its metadata requires outside extras."""
    from packaging.requirements import Requirement

    try:
        itself = metadata.distribution("kncal")
    except metadata.PackageNotFoundError:
        needed_for = "the command `kncal`, and knowing which packages it requires"
        hint = "python -m pip install . (in kncal's folder), or make demo"
        found = "imported from a folder, not installed"
        return [Finding(name="kncal", found=found, needed_for=needed_for, hint=hint)]
    required = [Requirement(text) for text in itself.requires or ()]
    return [
        Finding(name="kncal", found=itself.version, needed_for="everything"),
        *(
            _package(package.name, str(package.specifier))
            for package in required
            if package.marker is None or package.marker.evaluate({"extra": ""})
        ),
    ]


def _package(name: str, specifier: str) -> Finding:
    """Whether package ``name`` is installed in a version that ``specifier`` (``>=3,<4``, or empty) allows."""
    from packaging.specifiers import SpecifierSet

    version, wanted = _version(name), f"{name}{specifier}"
    ok = bool(version) and SpecifierSet(specifier).contains(version, prereleases=True)
    return Finding(
        name=f"package {name}",
        found=version if ok else f"{version or 'nothing'} where {wanted} is required",
        needed_for="everything",
        hint="" if ok else f"python -m pip install '{wanted}'",
    )


def _version(package: str) -> str:
    """Return the version of an installed package, "" if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""


def _dask() -> Finding:
    names = ("distributed", "dask-jobqueue", "cryptography")
    versions = {name: version for name in names if (version := _version(name))}
    found, ok = ", ".join(f"{name} {version}" for name, version in versions.items()), len(versions) == len(names)
    return Finding(
        name="Dask",
        found=found if ok else f"not installed{f' (only {found})' if found else ''}",
        needed_for="sweeps with --executor dask or slurm; one machine does not need it",
        hint="" if ok else "pip install 'kncal[dask]'",
    )


def _slurm() -> Finding:
    path, hint = shutil.which("sbatch"), ""
    if path is None:
        found, hint = "no sbatch on PATH", "only on a cluster with Slurm: work on a node where jobs are submitted"
    else:
        failure, text = ask(["sinfo", "--noheader", "--format=%R"], SOLVER_LIMIT, os.environ)
        if failure:
            found = f"{path}, but sinfo {failure}: {last_line(text)}"
            hint = "see that slurm.conf (SLURM_CONF) is the cluster's, and that its controller runs"
        else:
            _, version = ask([path, "--version"], SOLVER_LIMIT, os.environ)
            queues = ", ".join(sorted({line.strip() for line in text.splitlines() if line.strip()}))[:200]
            found = f"{last_line(version).removeprefix('slurm ')} ({path}), partitions: {queues or 'none'}"
    needed_for = "sweeps in Slurm jobs; where there is no Slurm nothing is missing"
    return Finding(name="Slurm", found=found, needed_for=needed_for, hint=hint)


def _mpirun() -> Finding:
    finding = ask_version(
        MPIRUN,
        ["--version"],
        r"mpirun \(Open MPI\) ([0-9][\w.]*)",
        wanted=None,
        title="Open MPI",
        needed_for="a run on several ranks (-n); runs on one do not need it",
        package="openmpi-bin",
    )
    if not finding.ok:
        return finding
    problem = _two_ranks()
    if not problem:
        return replace(finding, found=f"{finding.found}, starts two ranks")
    hint = "runs on one rank are not concerned; what it says is mostly about the machine's network or temporary folder"
    return replace(finding, found=f"{finding.found}, but two ranks do not start: {problem}", hint=hint)


def _two_ranks() -> str:
    """Start two ranks of LIGGGHTS (where there is none: of a program that does nothing); return what is wrong."""
    # With an empty deck it joins the other rank, prints its banner and ends.
    solver = shutil.which("liggghts")
    command = ("true",) if solver is None else (solver, "-log", "none")
    try:
        with scratch() as place:
            start = run_ranks(command, 2, oversubscribe=True, cwd=place, log=place / "log", timeout=SOLVER_LIMIT)
    except (KncalError, OSError) as error:
        return str(error)
    if start.status != "exited":
        return f"no answer within {SOLVER_LIMIT:g} s" if start.status == "timed_out" else start.status
    if start.returncode == 0:
        return ""
    how = f"signal {start.signal}" if start.returncode is None else f"code {start.returncode}"
    return f"ended with {how}: {last_line(chr(10).join(start.last_lines))}"


def _rendering() -> Finding:
    failure, text = ask([sys.executable, "-c", RENDER_PROBE], RENDER_LIMIT, os.environ)
    drawn = None if failure else re.search(r"drawn by (\w+)", text)
    mend = "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri"
    if failure.startswith("gave no answer"):
        mend = f"try again, the first start is the slowest; if that does not help: {mend}"
    return Finding(
        name="off-screen rendering",
        found=drawn.group(1) if drawn else f"the trial {failure or 'drew nothing'}: {last_line(text)}",
        needed_for="3-D pictures; diagrams do not need it",
        hint="" if drawn else mend,
    )


def _disk(where: Path, room: float) -> Finding:
    free = shutil.disk_usage(where).free
    ok = free >= room
    return Finding(
        name="free disk space",
        found=f"{free / 1e9:.1f} GB in {where}",
        needed_for="recorded frames and reports; a full disk ruins a run",
        hint="" if ok else f"make room: at least {room / 1e9:g} GB, or work in another folder",
    )


def _shipped(name: str, pattern: str, needed_for: str) -> Finding:
    try:
        place = folder(name)
    except FileNotFoundError as error:
        count, found = 0, str(error)
    else:
        count = sum(1 for _ in place.rglob(pattern))
        found = f"{count} in {place}"
    return Finding(
        name=name,
        found=found,
        needed_for=needed_for,
        hint="" if count else "the installation is incomplete: python -m pip install --force-reinstall kncal",
    )


def _temporary_folder() -> Finding:
    try:
        with scratch() as place:
            (place / "probe").write_text("probe", encoding="utf-8")
            found, ok = str(place.parent), True
    except OSError as error:
        found, ok = str(error), False
    return Finding(
        name="temporary folder",
        found=found,
        needed_for="several ranks of a solver, and Python itself",
        hint="" if ok else "set TMPDIR to a folder that you can write to and that has room",
    )
