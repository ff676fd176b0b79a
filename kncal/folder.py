"""The run folder: what is in it, where it came from, and how it is taken up again.

OUT/case.toml  OUT/manifest.json         the scene as it was run, and its hash
OUT/linear/    OUT/hertz/                one folder a model: solver input, log, frames, and three records:
    manifest.json                        what was rendered; started.json: who started it; result.json: how it ended
OUT/.lock                                held by the run that owns the folder
OUT/report/                              index.html and its pictures
OUT/attempt-1/ ...                       what an earlier run left, moved aside
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import socket
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from kncal import __version__
from kncal.bed.model import BedModel
from kncal.bed.scene import BedScene
from kncal.case_file import dump_case, load_case
from kncal.engines.base import FRAMES, Profile, RunResult
from kncal.errors import ReadError, RenderError, RunError
from kncal.foreign_templates import foreign_hashes
from kncal.io.tables import read_json, write_json
from kncal.lock import LOCK, locked, sign
from kncal.model import Model
from kncal.scene import Scene

MANIFEST, STARTED, RESULT, CASE, REPORT = "manifest.json", "started.json", "result.json", "case.toml", "report"
#: What a bed run leaves for its numbers, as ``particles.dump`` of a single contact.
SERIES = "series.csv"
PIECES = "series"
#: Folder in a run folder with the rounds that measured its impact speed (see `kncal.measured`).
MEASURING = "measuring"


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file as hexadecimal text."""
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


@contextmanager
def case_folder(
    scene: Scene | BedScene, out: Path, *, keep: bool = False, tell: Callable[[str], None] | None = None
) -> Iterator[int]:
    """Make ``out`` ready for ``scene`` and hold it (see `kncal.lock`): gives the lock's descriptor for the solver.

    What an earlier run left there is moved to ``attempt-N``; with ``keep`` only if it was another case. ``tell`` is
    called with a sentence if so.

    Raises
    ------
    RenderError
        If ``out`` is a file or a link, holds things that kncal did not put there, or is in use by another run.
    """
    refuse_foreign(out)
    out.mkdir(parents=True, exist_ok=True)
    with locked(out) as descriptor:
        _check_ours(out)
        sign(descriptor)
        if (out / MANIFEST).is_file():
            same = _same_case(scene, out)
            if keep and same:
                refuse_links(out)
                yield descriptor
                return
            attempt = set_aside(out)
            if tell:
                tell(f"what {out} held{'' if same else ', of another case,'} is now in {attempt}")
        text = dump_case(scene).encode()
        digest = hashlib.sha256(text).hexdigest()
        # The manifest first: it says whose folder this is, should kncal be killed before the next line.
        write_json(out / MANIFEST, {"kncal": __version__, "case": scene.name, "case_sha256": digest, "created": _now()})
        (out / CASE).write_bytes(text)
        yield descriptor


def refuse_foreign(out: Path) -> None:
    """Refuse ``out`` as a run folder if it is a file or a link, or holds things that kncal did not put there.

    Raises
    ------
    RenderError
        Saying which.
    """
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise RenderError(f"{out}: expected a folder (or nothing yet), not a file or a link; choose another --out")
    if not (out / LOCK).exists():
        _check_ours(out)


def _check_ours(out: Path) -> None:
    if out.is_dir() and not (out / MANIFEST).is_file() and not all(map(_left_behind, out.iterdir())):
        raise RenderError(
            f"{out}: the folder holds files and no kncal {MANIFEST}; choose an empty folder with --out, "
            "nothing was changed"
        )


def _left_behind(path: Path) -> bool:
    """Return whether this may be there without a manifest: what a start leaves that is killed just then."""
    half_written = path.name.startswith(f".{MANIFEST}.") and path.name.endswith(".part")
    kept = (path.name.startswith("attempt-") or path.name == MEASURING) and path.is_dir()
    return path.name == LOCK or half_written or kept


def _same_case(scene: Scene | BedScene, out: Path) -> bool:
    text = dump_case(scene).encode()
    return (out / CASE).is_file() and (out / CASE).read_bytes() == text


def set_aside(out: Path, kinds: Iterable[str] | None = None) -> Path:
    """Move what earlier runs left in ``out`` to a new ``attempt-N``, and return that.

    With ``kinds`` only the folders of these models and the report on them; the case is copied, so that the attempt can
    still be read.
    """
    number = 1
    while (attempt := out / f"attempt-{number}").exists():
        number += 1
    names = None if kinds is None else {*kinds, REPORT}
    stays = (LOCK, MEASURING)
    old = [path for path in out.iterdir() if path.name not in stays and not path.name.startswith("attempt-")]
    attempt.mkdir()
    for path in sorted(old, key=lambda path: path.name == MANIFEST):  # the manifest last, see `_check_ours`
        if names is None or path.name in names:
            shutil.move(path, attempt / path.name)
        elif path.name in (CASE, MANIFEST):
            shutil.copyfile(path, attempt / path.name)
    return attempt


def refuse_links(out: Path) -> None:
    """Refuse a run folder that holds symbolic links, before anything is written into it again.

    kncal makes none; in a folder from elsewhere they could lead a run to write, or to delete, outside of it.

    Raises
    ------
    RenderError
        Naming the first link.
    """
    for place, folders, files in os.walk(out, followlinks=False):
        for name in (*folders, *files):
            if (path := Path(place, name)).is_symlink():
                raise RenderError(f"{path}: a symbolic link, which kncal does not make: remove it to go on in {out}")


def model_manifest(
    model: Model | BedModel,
    folder: Path,
    profile: Profile,
    command: list[str],
    *,
    steps: int,
    t_end: float,
    ranks: int = 1,
) -> dict[str, Any]:
    """Return what ``manifest.json`` of one model's folder holds: what was rendered, for which solver, by whom."""
    found = (p for p in sorted(folder.rglob("*")) if p.is_file() and p.name != MANIFEST)
    files = {p.relative_to(folder).as_posix(): sha256(p) for p in found}
    return {
        "kncal": __version__,
        "case": model.scene.name,
        "case_sha256": hashlib.sha256(dump_case(model.scene).encode()).hexdigest(),
        "model": model.kind,
        "engine": profile.engine,
        "solver": {
            "program": str(profile.program or ""),
            "version": profile.version,
            "sha256": sha256(profile.program) if profile.program else "",
            "warning": profile.warning,
        },
        "command": command,
        "ranks": ranks,
        "environment": dict(profile.environment),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "dt": model.dt,
        "steps": steps,
        "t_end": t_end,
        "contacts": {
            f"{a}–{b}": {k: v for k, v in asdict(c).items() if v is not None} for (a, b), c in model.contacts.items()
        },
        "files_sha256": files,
        "rendered": _now(),
        **({"foreign_templates": dict(hashes)} if (hashes := foreign_hashes()) else {}),
    }


def write_model_manifest(
    model: Model | BedModel,
    folder: Path,
    profile: Profile,
    command: list[str],
    *,
    steps: int,
    t_end: float,
    ranks: int = 1,
) -> None:
    """Write ``manifest.json`` of one model's folder; see `model_manifest`."""
    data = model_manifest(model, folder, profile, command, steps=steps, t_end=t_end, ranks=ranks)
    write_json(folder / MANIFEST, data)


def write_started(folder: Path) -> None:
    """Write ``started.json`` of one model's folder: a run began; what is no longer true goes."""
    (folder / RESULT).unlink(missing_ok=True)
    write_json(folder / STARTED, {"pid": os.getpid(), "host": socket.gethostname(), "started": _now()})


def write_result(result: RunResult) -> None:
    """Write ``result.json`` beside the run's output (temporary file, fsync, rename), with what ties the output to it.

    Raises
    ------
    RunError
        If it cannot be written.
    """
    data = {k: v for k, v in asdict(result).items() if v is not None}
    log = result.log.name if result.log else ""
    data |= {"folder": result.folder.name, "log": log}
    try:
        output = [path for name in (FRAMES, SERIES, log) if name and (path := result.folder / name).is_file()]
        output += sorted((result.folder / PIECES).glob("*"))
        files = {path.relative_to(result.folder).as_posix(): sha256(path) for path in output}
        write_json(result.folder / RESULT, data | {"files_sha256": files, "ended": _now()})
    except OSError as error:
        raise RunError(f"{result.folder / RESULT}: cannot be written ({error.strerror or error})") from error


def read_result(folder: Path) -> RunResult:
    """Read ``result.json`` of a model's folder, and check that the frames and the log are still those of the run.

    Raises
    ------
    ReadError
        If there is none (the run has not ended), it is not one, or a file was changed after the run.
    """
    path = folder / RESULT
    if not path.is_file():
        raise ReadError(f"{path}: not there, so this run has not ended; run it with `kncal run`")
    record = _parse(_Result, path)
    for name, digest in record.files_sha256.items():
        if not (folder / name).is_file():
            raise ReadError(f"{folder / name}: not there, though the run wrote it; run the case again")
        if sha256(folder / name) != digest:
            raise ReadError(f"{folder / name}: changed since the run ended; run the case again")
    needed = SERIES if record.engine == "coupled" else FRAMES
    if record.status == "completed" and needed not in record.files_sha256:
        raise ReadError(f"{path}: files_sha256 names no {needed}, expected it of a completed run")
    data = record.model_dump(exclude={"ended", "files_sha256", "folder", "log"})
    return RunResult(**data, folder=folder, log=folder / record.log if record.log else None)


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read ``manifest.json`` of a model's folder.

    Raises
    ------
    ReadError
        If there is none, or it is not one.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise ReadError(f"{folder}: no {MANIFEST}; expected a model's run folder, e.g. runs/wall_impact/hertz")
    data = _parse(_Manifest, path).model_dump()
    if not data["foreign_templates"]:
        del data["foreign_templates"]
    return data


def read_model_folder(folder: Path) -> tuple[Scene | BedScene, str, str]:
    """Return (scene, kind, engine name) of one model's folder, e.g. ``runs/wall_impact/hertz``.

    Raises
    ------
    ReadError
        If it is not such a folder, or the case beside it was changed after the run.
    """
    data = read_manifest(folder)
    case = folder.parent / CASE
    if not case.is_file():
        raise ReadError(f"{folder}: expected a model's run folder with {CASE} in the folder above")
    if sha256(case) != data["case_sha256"]:
        raise ReadError(f"{case}: changed since {folder.name} was rendered; run the case again")
    if data["model"] != folder.resolve().name:
        raise ReadError(f"{folder / MANIFEST}: model = {data['model']!r}, expected that of the folder's name")
    return load_case(case, name=data["case"]), data["model"], data["engine"]


def _file_name(text: str) -> str:
    if text != Path(text).name and text:
        raise ValueError("expected the name of a file in the run's folder")
    return text


def _inside(text: str) -> str:
    path = PurePosixPath(text)
    if not text or path.is_absolute() or ".." in path.parts or text != path.as_posix():
        raise ValueError("expected the path and name of a file inside the run's folder")
    return text


_Kind = Literal["linear", "hertz"]
_Count = Annotated[int, Field(ge=0)]
_Positive = Annotated[float, Field(gt=0.0)]
_Seconds = Annotated[float, Field(ge=0.0)]
_FileName = Annotated[str, AfterValidator(_file_name)]
_Digests = dict[Annotated[str, AfterValidator(_inside)], Annotated[str, Field(pattern="^[0-9a-f]{64}$")]]


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class _Extra(_Record):
    model_config = ConfigDict(extra="allow")

    cpu_samples: list[_Seconds] = []


class _Result(_Record):
    """``result.json``: a `RunResult` as `write_result` writes it."""

    status: Literal["completed", "failed", "timed_out", "interrupted", "not_installed"]
    engine: str
    model: _Kind
    folder: str
    steps: _Count
    dt: _Positive
    cpu_seconds: _Seconds
    wall_seconds: _Seconds
    version: str
    returncode: int | None = None
    message: str
    failure: str = ""
    log: _FileName
    extra: _Extra
    files_sha256: _Digests
    ended: str


class _Solver(_Record):
    program: str
    version: str
    sha256: str
    warning: str


class _Manifest(_Record):
    """``manifest.json`` of a model's folder, as `write_model_manifest` writes it."""

    kncal: str
    case: str
    case_sha256: str
    model: _Kind
    engine: str
    solver: _Solver
    command: list[str]
    ranks: Annotated[int, Field(ge=1)] = 1
    environment: dict[str, str]
    python: str
    platform: str
    dt: _Positive
    steps: _Count
    t_end: _Seconds
    contacts: dict[str, dict[str, Any]]
    files_sha256: _Digests
    rendered: str
    foreign_templates: dict[str, Annotated[str, Field(pattern="^[0-9a-f]{64}$")]] = {}


_R = TypeVar("_R", bound=_Record)


def _parse(kind: type[_R], path: Path) -> _R:
    try:
        return kind.model_validate(read_json(path))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "the whole file"
        raise ReadError(f"{path}: {key}: {first['msg']}; expected what kncal {__version__} writes") from error


def _now() -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%S%z")
