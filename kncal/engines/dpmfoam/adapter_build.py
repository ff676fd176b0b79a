"""Builds the adapter: the function object library through which a live DPMFoam exchanges particles.

It is compiled on the user's machine against the headers of the OpenFOAM that is installed there, which Debian ships
in its source package only. Nothing is installed, and the machine's apt configuration is only read.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import tarfile
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from kncal.core.awake import run_within
from kncal.core.errors import KncalError
from kncal.core.lock import only_one
from kncal.core.process import ProcessResult, run_process, solver_environment
from kncal.core.shipped import cache_folder

#: File name of the library; a case names it in ``libs``.
LIBRARY = "libkncalExchange.so"
SOURCE = Path(__file__).resolve().parent / "adapter" / "kncalExchange.C"

#: What the build says while it goes on: one line per stage.
Progress = Callable[[str], None]

# Folders of OpenFOAM's src/ whose headers and templates the adapter needs
_LIBRARIES = (
    "OpenFOAM",
    "OSspecific/POSIX",
    "finiteVolume",
    "meshTools",
    "lagrangian/basic",
    "lagrangian/intermediate",
    "regionModels/regionModel",
    "regionModels/surfaceFilmModels",
)
# As OpenFOAM's own build system compiles with g++ on 64-bit Linux: double precision, 32-bit labels
_FLAGS = [
    *("-std=c++11", "-m64", "-pthread", "-ftemplate-depth-100", "-O2", "-fPIC", "-w", "-shared"),
    *("-DOPENFOAM=1912", "-DWM_DP", "-DWM_LABEL_SIZE=32", "-DNoRepository"),
]
_LINK = [
    *("-Wl,--no-as-needed", "-lOpenFOAM", "-lfiniteVolume", "-lmeshTools", "-llagrangian"),
    "-llagrangianIntermediate",
]
_WANTED = re.compile(r"OPENFOAM=1912|\(1912\)")
_PROXIES = ("http_proxy", "https_proxy", "ftp_proxy", "all_proxy", "no_proxy")
_SCRATCH = "building-"
_QUICK, _LONG = 60.0, 900.0  # s: asking for something; downloading, compiling, waiting for another builder


class AdapterError(KncalError, RuntimeError):
    """The adapter cannot be built or used on this machine; the text says why and what to do."""


def find(cache_dir: Path | None = None) -> Path | None:
    """Return the library that `build` made for the installed OpenFOAM and this version of the source, or None.

    Parameters
    ----------
    cache_dir : Path, optional
        Where built libraries are kept; None: ``$XDG_CACHE_HOME/kncal``, else ``~/.cache/kncal``.
    """
    if shutil.which("DPMFoam") is None:
        return None
    try:
        library = _place(cache_dir) / LIBRARY
    except AdapterError:
        return None  # no usable OpenFOAM: there is no adapter to it
    return library if library.is_file() else None


def build(cache_dir: Path | None = None, progress: Progress | None = None) -> Path:
    """Return the adapter for the installed OpenFOAM, building it if need be (about 30 s, 45 MB to download).

    Several may build at once: one does, the others wait for it.

    Parameters
    ----------
    cache_dir : Path, optional
        See `find`.
    progress : callable, optional
        Called with one line at the beginning of each stage.

    Raises
    ------
    AdapterError
        If OpenFOAM or the compiler is missing, its source cannot be had, or the compilation fails.
    """
    say = progress or (lambda _: None)
    place = _place(cache_dir)
    library = place / LIBRARY
    if library.is_file():
        return library
    missing = [tool for tool in ("g++", "apt-get", "dpkg-query") if shutil.which(tool) is None]
    if missing:
        raise AdapterError(
            f"the adapter to a live DPMFoam needs {' and '.join(missing)}, not on PATH: apt-get install g++ (on "
            "Debian), or use the restart transport, which needs no adapter"
        )
    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise AdapterError(f"{place}: cannot be made ({error.strerror}); set XDG_CACHE_HOME") from error
    try:
        with only_one(place / "lock", _LONG, lambda: say("waiting for another build of the adapter")):
            _build(library, say)
    except BlockingIOError as error:
        text = f"{place / 'lock'}: another build has held it for {_LONG:g} s; end that one"
        raise AdapterError(text) from error
    return library


def _build(library: Path, say: Progress) -> None:
    """Build the library, whose folder is held."""
    if library.is_file():
        return  # the builder that was waited for made it
    for left in library.parent.glob(f"{_SCRATCH}*"):
        shutil.rmtree(left)  # of a builder that was killed: none is alive, the lock is ours
    with tempfile.TemporaryDirectory(prefix=_SCRATCH, dir=library.parent) as name:
        scratch = Path(name)
        say("downloading OpenFOAM's source package (45 MB)")
        tarball = download_source(scratch)
        say("unpacking its headers")
        headers = scratch / "headers"
        unpack_headers(tarball, headers)
        say("compiling the adapter")
        made = scratch / LIBRARY
        compile_adapter(SOURCE, headers, made)
        made.replace(library)


def download_source(scratch: Path) -> Path:
    """Download the source of the installed libopenfoam into ``scratch``; apt checks it against the signed index.

    Returns
    -------
    Path
        The source archive.

    Raises
    ------
    AdapterError
        If the package is not installed, or its source cannot be reached, with the words of apt.
    """
    query = ["dpkg-query", "-W", "-f", "${source:Version}", "libopenfoam"]
    version = _ask(query, "the installed OpenFOAM is not Debian's package, its headers cannot be found").strip()
    targets = _ask(
        ["apt-get", "indextargets", "--format", "$(REPO_URI) $(RELEASE) $(COMPONENT)", "Created-By: Packages"],
        "apt does not say where packages come from",
    )
    sources = [f"deb-src {line}" for line in dict.fromkeys(targets.splitlines()) if len(line.split()) == 3]
    if not sources:
        raise AdapterError("apt knows no package source (its lists are empty): apt-get update, then try again")
    for folder in ("none", "lists/partial", "cache/archives/partial"):
        (scratch / folder).mkdir(parents=True)
    (scratch / "sources.list").write_text("\n".join(sources) + "\n")
    settings = {
        "Dir::Etc::sourcelist": scratch / "sources.list",
        "Dir::Etc::sourceparts": scratch / "none",
        "Dir::State::lists": scratch / "lists",
        "Dir::Cache": scratch / "cache",
        "Acquire::Languages": "none",
        # Root may write here, apt's own user may not.
        **({"APT::Sandbox::User": "root"} if os.geteuid() == 0 else {}),
    }
    apt = ["apt-get", "-q", *(f"-o{key}={value}" for key, value in settings.items())]
    # One of several sources may fail, as those without source packages do: what counts is whether ours is found.
    update = _run([*apt, "update"], scratch, "update")
    source = _run([*apt, "source", "--download-only", f"openfoam={version}"], scratch, "source")
    found = sorted(scratch.glob("openfoam_*.orig.tar.*"))
    if source.status != "exited" or source.returncode != 0 or not found:
        words = [line for line in (*update.last_lines, *source.last_lines) if line.startswith(("E:", "W:", "Err:"))]
        raise AdapterError(
            f"the source package openfoam={version} could not be downloaded, so the adapter to a live DPMFoam cannot "
            f"be built ({' / '.join(words) or source.status}); connect to a Debian mirror, or use the restart transport"
        )
    return found[0]


def unpack_headers(tarball: Path, target: Path) -> None:
    """Unpack headers and templates of the needed libraries of OpenFOAM, one flat folder per library.

    Raises
    ------
    AdapterError
        If the archive cannot be read or holds none.
    """
    try:
        with tarfile.open(tarball, "r|*") as archive:
            for member in archive:
                library = _library_of(member)
                content = archive.extractfile(member) if library else None
                if content is None:
                    continue
                file = target / library.replace("/", "_") / Path(member.name).name
                if not file.exists():
                    file.parent.mkdir(parents=True, exist_ok=True)
                    file.write_bytes(content.read())
    except (tarfile.TarError, OSError, EOFError) as error:
        raise AdapterError(f"{tarball}: cannot be unpacked ({error}); check the free space and try again") from error
    if not target.is_dir():
        raise AdapterError(f"{tarball}: holds no headers of OpenFOAM, expected src/OpenFOAM and others")


def compile_adapter(source: Path, headers: Path, library: Path) -> None:
    """Compile ``source`` against the flat folders in ``headers`` into ``library``.

    Raises
    ------
    AdapterError
        With the compiler's first errors.
    """
    includes = [f"-I{folder}" for folder in sorted(headers.iterdir())]
    folder = library.parent
    result = _run(["g++", *_FLAGS, *includes, str(source), "-o", str(library), *_LINK], folder, "compile")
    if result.status != "exited" or result.returncode != 0 or not library.is_file():
        log = (folder / "log.compile").read_text(errors="replace")
        words = [line for line in log.splitlines() if "error" in line][:3] or list(result.last_lines[-3:])
        raise AdapterError(
            f"g++ could not compile the adapter ({result.status}, exit code {result.returncode}): "
            f"{' / '.join(words) or 'no message'}; use the restart transport"
        )


def _library_of(member: tarfile.TarInfo) -> str:
    """Return the library folder that a file of the source archive belongs to, empty if it is not needed."""
    _, *parts = Path(member.name).parts
    if not member.isfile() or not parts or parts[0] != "src" or {"Make", "lnInclude"} & set(parts):
        return ""
    if Path(member.name).suffix not in (".H", ".C", ".h"):
        return ""
    inside = "/".join(parts[1:])
    return next((library for library in _LIBRARIES if inside.startswith(f"{library}/")), "")


def _place(cache_dir: Path | None) -> Path:
    """Return the folder of the library: its name stands for the OpenFOAM build, the source and the flags."""
    said = _ask(["DPMFoam", "-help"], "OpenFOAM is not installed, or does not start: apt-get install openfoam")
    banner = [line for line in said.splitlines() if line.startswith(("Using:", "Build:", "Arch:"))]
    if not _WANTED.search("\n".join(banner)):
        raise AdapterError(
            f"the adapter is for OpenFOAM v1912, found {' '.join(banner) or 'an unknown version'}: use Debian's "
            "package openfoam, or the restart transport"
        )
    text = "\n".join([*banner, *_FLAGS, *_LINK, SOURCE.read_text(encoding="utf-8")])
    return (cache_dir or _default_cache()) / hashlib.sha256(text.encode()).hexdigest()[:16]


def _default_cache() -> Path:
    try:
        return cache_folder()
    except FileNotFoundError as error:
        raise AdapterError(f"nowhere to keep the adapter: {error}") from error


def _environment() -> dict[str, str]:
    """Environment of apt and compiler: that of a solver, and how apt reaches the network."""
    known = {*_PROXIES, *(name.upper() for name in _PROXIES), "APT_CONFIG"}
    return solver_environment() | {name: value for name, value in os.environ.items() if name in known}


def _ask(command: Sequence[str], problem: str) -> str:
    """Return what a program that answers at once prints; ``problem`` says what it means if it does not."""
    try:
        done = run_within(_QUICK, command, env=_environment(), text=True, errors="replace")
    except (OSError, subprocess.TimeoutExpired) as error:
        raise AdapterError(f"{problem} ({command[0]}: {error})") from error
    if done.returncode != 0:
        words = " ".join(done.stderr.split()) or f"exit code {done.returncode}"
        raise AdapterError(f"{problem} ({command[0]}: {words})")
    return str(done.stdout)


def _run(command: Sequence[str], folder: Path, name: str) -> ProcessResult:
    return run_process(command, cwd=folder, log=folder / f"log.{name}", env=_environment(), timeout=_LONG)
