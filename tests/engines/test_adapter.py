"""Building the adapter: what is taken, what is cached, and what is said where it cannot be built."""

from __future__ import annotations

import fcntl
import io
import shutil
import socket
import tarfile
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from gas_columns import needs_openfoam

from kncal.engines.dpmfoam import adapter_build
from kncal.engines.dpmfoam.adapter_build import (
    LIBRARY,
    SOURCE,
    AdapterError,
    build,
    compile_adapter,
    find,
    unpack_headers,
)

pytestmark = pytest.mark.solver

openfoam = needs_openfoam[1]
apt = pytest.mark.skipif(shutil.which("apt-get") is None, reason="apt-get is not there")
compiler = pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A PATH with nothing on it but what a test puts there."""
    folder = tmp_path / "programs"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    return folder


@pytest.fixture
def apt_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Give the real apt further settings."""

    def give(text: str) -> None:
        (tmp_path / "apt.conf").write_text(text)
        monkeypatch.setenv("APT_CONFIG", str(tmp_path / "apt.conf"))

    return give


@pytest.fixture
def offline(apt_settings: Callable[[str], None]) -> None:
    """No mirror can be reached: the way there ends at a port of this machine where no one listens."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        closed = f"http://127.0.0.1:{free.getsockname()[1]}"
    apt_settings(f'Acquire::http::Proxy "{closed}";\nAcquire::https::Proxy "{closed}";\nAcquire::Retries "0";\n')


def _archive(path: Path, files: dict[str, str], mode: str = "w:bz2") -> Path:
    with tarfile.open(path, mode) as archive:  # type: ignore[call-overload]
        for name, text in files.items():
            entry = tarfile.TarInfo(f"openfoam-1912/{name}")
            entry.size = len(text)
            archive.addfile(entry, io.BytesIO(text.encode()))
    return path


def test_headers_come_out_as_one_flat_folder_per_library(tmp_path: Path) -> None:
    wanted = {
        "src/OpenFOAM/db/Time/Time.H": "time",
        "src/OpenFOAM/db/error/error.C": "error",
        "src/OSspecific/POSIX/sigFpe.h": "signal",
        "src/lagrangian/basic/Cloud/Cloud.H": "cloud",
        "src/lagrangian/intermediate/parcels/Parcel.H": "parcel",
    }
    unwanted = {
        "applications/solvers/DPMFoam/DPMFoam.C": "solver",
        "src/OpenFOAM/lnInclude/Link.H": "link",
        "src/OpenFOAM/Make/files.C": "make",
        "src/OpenFOAM/notes.txt": "notes",
        "src/lagrangian/basicother/Other.H": "another library",
        "modules/src/OpenFOAM/Module.H": "elsewhere",
    }
    unpack_headers(_archive(tmp_path / "source.tar.bz2", wanted | unwanted), tmp_path / "headers")
    found = {str(path.relative_to(tmp_path / "headers")): path.read_text() for path in tmp_path.glob("headers/*/*")}
    assert found == {
        "OpenFOAM/Time.H": "time",
        "OpenFOAM/error.C": "error",
        "OSspecific_POSIX/sigFpe.h": "signal",
        "lagrangian_basic/Cloud.H": "cloud",
        "lagrangian_intermediate/Parcel.H": "parcel",
    }


@pytest.mark.parametrize("kept", [0, 100])
def test_a_source_archive_that_is_cut_off_is_refused(kept: int, tmp_path: Path) -> None:
    path = _archive(tmp_path / "source.tar.bz2", {f"src/OpenFOAM/{i}.H": f"{i * 7919}" * 50 for i in range(50)})
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(AdapterError, match="cannot be unpacked"):
        unpack_headers(path, tmp_path / "headers")


def test_an_archive_without_headers_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AdapterError, match="holds no headers"):
        unpack_headers(_archive(tmp_path / "source.tar", {"README": "hello"}, "w"), tmp_path / "headers")


@compiler
def test_a_failing_compilation_is_told_in_the_compilers_words(tmp_path: Path) -> None:
    (tmp_path / "headers" / "OpenFOAM").mkdir(parents=True)
    with pytest.raises(AdapterError, match=r"functionObject\.H: No such file"):
        compile_adapter(SOURCE, tmp_path / "headers", tmp_path / LIBRARY)
    assert not (tmp_path / LIBRARY).exists()


def test_without_openfoam_there_is_no_adapter_and_building_says_so(programs: Path, tmp_path: Path) -> None:
    assert find(tmp_path / "cache") is None
    with pytest.raises(AdapterError, match="apt-get install openfoam"):
        build(tmp_path / "cache")
    assert not (tmp_path / "cache").exists()


@openfoam
def test_without_a_compiler_building_says_what_to_install(programs: Path, tmp_path: Path) -> None:
    (programs / "DPMFoam").symlink_to("/usr/bin/DPMFoam")
    with pytest.raises(AdapterError, match=r"g\+\+.*apt-get install g\+\+"):
        build(tmp_path / "cache")


def test_another_openfoam_is_refused(programs: Path, tmp_path: Path) -> None:
    other = programs / "DPMFoam"
    other.write_text("#!/bin/sh\necho 'Using: OpenFOAM-v2212 (2212) - visit www.openfoam.com'\necho 'Build: 1a2b'\n")
    other.chmod(0o755)
    with pytest.raises(AdapterError, match=r"for OpenFOAM v1912, found .*2212"):
        build(tmp_path / "cache")


@openfoam
@apt
@compiler
def test_an_unreachable_source_is_told_in_the_words_of_apt(offline: None, tmp_path: Path) -> None:
    stages: list[str] = []
    with pytest.raises(AdapterError, match=r"openfoam=1912\S* could not be downloaded.*(E|W): .*restart transport"):
        build(tmp_path / "cache", stages.append)
    assert len(stages) == 1
    # Neither half a library nor scratch files remain.
    assert {path.name for path in tmp_path.glob("cache/*/*")} == {"lock"}


@openfoam
@apt
@compiler
def test_a_machine_that_never_asked_for_package_lists_is_told_to(
    apt_settings: Callable[[str], None], tmp_path: Path
) -> None:
    (tmp_path / "lists" / "partial").mkdir(parents=True)
    apt_settings(f'Dir::State::lists "{tmp_path}/lists";\n')
    with pytest.raises(AdapterError, match=r"lists are empty.*apt-get update"):
        build(tmp_path / "cache")


@openfoam
@apt
@compiler
def test_what_a_killed_builder_left_is_cleared_away(offline: None, tmp_path: Path) -> None:
    place = adapter_build._place(tmp_path / "cache")
    (place / "building-x" / "headers").mkdir(parents=True)
    with pytest.raises(AdapterError):
        build(tmp_path / "cache")
    assert {path.name for path in place.iterdir()} == {"lock"}


@openfoam
def test_the_cache_knows_source_and_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    place = adapter_build._place(None)
    assert place.parent == tmp_path / "kncal"
    assert find() is None
    place.mkdir(parents=True)
    (place / LIBRARY).write_bytes(b"made before")
    assert find() == build() == place / LIBRARY
    # Another source is another library: the old one is not taken for it.
    changed = tmp_path / "changed.C"
    changed.write_text(SOURCE.read_text() + "\n// changed\n")
    monkeypatch.setattr(adapter_build, "SOURCE", changed)
    assert find() is None
    # A relative path is no place, says the XDG standard.
    monkeypatch.setenv("XDG_CACHE_HOME", "cache")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert adapter_build._place(None).parent == tmp_path / "home" / ".cache" / "kncal"


@openfoam
@apt
@compiler
def test_of_two_builders_one_waits_for_the_other(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    place = adapter_build._place(cache)
    place.mkdir(parents=True)
    stages: list[str] = []
    waiting, made = threading.Event(), []

    def say(stage: str) -> None:
        stages.append(stage)
        waiting.set()

    with (place / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        second = threading.Thread(target=lambda: made.append(build(cache, say)))
        second.start()
        assert waiting.wait(10.0)
        assert second.is_alive()
        (place / LIBRARY).write_bytes(b"made by the first")
    second.join(10.0)
    assert made == [place / LIBRARY]
    assert stages == ["waiting for another build of the adapter"]
    assert made[0].read_bytes() == b"made by the first"


def test_the_source_is_free_software_as_openfoam_is() -> None:
    head = SOURCE.read_text(encoding="utf-8")[:2000]
    assert "GPL-3.0-or-later" in head
