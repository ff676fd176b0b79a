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
import stat
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from kncal import __version__
from kncal.core.errors import ReadError, RenderError, RunError, failure_of
from kncal.core.files import MOST_HASHED, sha256, sweep_parts, write_json
from kncal.core.lock import LOCK, locked, sign
from kncal.core.records import is_record, read_record
from kncal.core.templating import foreign_hashes
from kncal.engines.base import FRAMES, Profile
from kncal.record.outcome import RunResult
from kncal.record.series import PIECES, SERIES
from kncal.runs.records import ATTEMPT, MANIFEST, RESULT, STARTED, CaseManifest, ModelManifest, Result, Started
from kncal.scene.case_file import FILES, copy_files, dump_case, identity_text, kept_identity, load_case
from kncal.scene.model import KINDS, Plan
from kncal.scene.scene import Scene

CASE, REPORT = "case.toml", "report"
#: Rows of a run in the table of its sweep (see `kncal.study.table`).
ROW = "row.json"
#: Folder in a run folder with the rounds that measured its impact speed (see `kncal.runs.measure_speed`).
MEASURING = "measuring"
#: All that kncal puts into a run folder and moves to an attempt; what else is there is somebody's own.
OURS = (*KINDS, CASE, FILES, MANIFEST, REPORT, ROW)


@contextmanager
def case_folder(
    scene: Scene, out: Path, *, keep: bool = False, tell: Callable[[str], None] | None = None
) -> Iterator[int]:
    """Make ``out`` ready for ``scene`` and hold it (see `kncal.core.lock`): gives the lock's descriptor for the solver.

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
        for folder in (out, *(out / kind for kind in KINDS), out / REPORT):
            sweep_parts(folder, (*OURS, STARTED, RESULT))
        if (out / MANIFEST).is_file():
            same = _same_case(scene, out)
            if keep and same:
                refuse_links(out)
                yield descriptor
                return
            attempt = set_aside(out)
            if tell:
                tell(f"{out}: what an earlier run{'' if same else ' with other values'} left was moved to {attempt}")
        text = dump_case(scene).encode()
        digest = hashlib.sha256(text).hexdigest()
        # The manifest first: it says whose folder this is, should kncal be killed before the next line.
        write_json(out / MANIFEST, {"kncal": __version__, "case": scene.name, "case_sha256": digest, "created": _now()})
        (out / CASE).write_bytes(text)
        copy_files(scene, out)
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
    if not out.is_dir():
        return
    if (out / MANIFEST).exists():
        try:
            read_record(CaseManifest, out / MANIFEST)
        except ReadError as error:
            raise RenderError(
                f"{out}: not a run folder: its {MANIFEST} is not from kncal ({error}); choose an empty folder with "
                "--out, nothing was changed"
            ) from error
    elif not all(map(_left_behind, out.iterdir())):
        raise RenderError(
            f"{out}: the folder holds files and no kncal {MANIFEST}; choose an empty folder with --out, "
            "nothing was changed"
        )


def _left_behind(path: Path) -> bool:
    """Return whether this may be there without a manifest: what a start leaves that is killed just then."""
    half_written = path.name.startswith(f".{MANIFEST}.") and path.name.endswith(".part")
    kept = (ATTEMPT.fullmatch(path.name) or path.name == MEASURING) and path.is_dir()
    return path.name == LOCK or half_written or bool(kept)


def _same_case(scene: Scene, out: Path) -> bool:
    try:
        return kept_identity(out) == identity_text(scene)
    except ReadError:
        return False


def set_aside(out: Path, kinds: Iterable[str] | None = None) -> Path:
    """Move what earlier runs left in ``out`` to a new ``attempt-N``, and return that.

    With ``kinds`` only the folders of these models and the report on them; the case is copied, so that the attempt can
    still be read. What kncal did not put there stays.
    """
    number = 1
    while os.path.lexists(attempt := out / f"attempt-{number}"):
        number += 1
    names = OURS if kinds is None else (*kinds, REPORT)
    attempt.mkdir()
    if (out / MANIFEST).exists():
        shutil.copyfile(out / MANIFEST, attempt / MANIFEST)  # first: it says whose the attempt is (see `is_attempt`)
    if kinds is not None and (out / CASE).is_file():
        shutil.copyfile(out / CASE, attempt / CASE)
        if (out / FILES).is_dir():
            shutil.copytree(out / FILES, attempt / FILES)
    for name in sorted(names, key=lambda name: name == MANIFEST):  # the manifest last, see `_check_ours`
        if os.path.lexists(out / name):
            shutil.move(out / name, attempt / name)
    return attempt


def is_run_folder(out: Path) -> bool:
    """Return whether ``out`` is a run folder of kncal, also one whose start was killed before its manifest."""
    if os.path.lexists(out / MANIFEST):
        return is_record(CaseManifest, out / MANIFEST)
    return (out / LOCK).is_file() and all(map(_left_behind, out.iterdir()))


def is_attempt(folder: Path) -> bool:
    """Return whether this is what `set_aside` made: by its name, and a record of kncal in it."""
    if not ATTEMPT.fullmatch(folder.name) or folder.is_symlink() or not folder.is_dir():
        return False
    models = (folder / kind for kind in KINDS)
    return is_record(CaseManifest, folder / MANIFEST) or any(
        is_record(ModelManifest, model / MANIFEST) or is_record(Started, model / STARTED) for model in models
    )


def refuse_links(out: Path) -> None:
    """Refuse a run folder that holds symbolic links, pipes or devices, before anything is written into it again.

    kncal makes none; in a folder from elsewhere they could lead a run to write, or to delete, outside of it, or to
    wait for ever.

    Raises
    ------
    RenderError
        Naming the first one.
    """
    for place, folders, files in os.walk(out, followlinks=False):
        for name in (*folders, *files):
            mode = os.lstat(path := Path(place, name)).st_mode
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                what = "a symbolic link" if stat.S_ISLNK(mode) else "a pipe or a device"
                raise RenderError(f"{path}: {what}, kncal makes none: remove it, or choose another --out")


def model_manifest(
    model: Plan, folder: Path, profile: Profile, command: Sequence[str], ranks: int = 1
) -> dict[str, Any]:
    """Return what ``manifest.json`` of one model's folder holds: what was rendered, for which solver, by whom."""
    found = (p for p in sorted(folder.rglob("*")) if p.is_file() and p.name != MANIFEST)
    files = {p.relative_to(folder).as_posix(): sha256(p) for p in found}
    return {
        "kncal": __version__,
        "case": model.scene.name,
        "case_sha256": hashlib.sha256(dump_case(model.scene).encode()).hexdigest(),
        "case_files": {name: sha256(model.scene.path_of(name)) for name in model.scene.files},
        "model": model.kind,
        "engine": profile.engine,
        "solver": {
            "program": str(profile.program or ""),
            "version": profile.version,
            "sha256": sha256(profile.program) if profile.program else "",
            "warning": profile.warning,
        },
        "command": list(command),
        "ranks": ranks,
        "environment": dict(profile.environment),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "dt": model.dt,
        "steps": model.n_steps,
        "t_end": model.t_end,
        "contacts": {
            "–".join(model.species.names(pair)): {k: v for k, v in asdict(c).items() if v is not None}
            | {"pairs_of_bodies": model.species.meetings(pair)}
            for pair, c in model.contacts.items()
        },
        "files_sha256": files,
        "rendered": _now(),
        **({"foreign_templates": dict(hashes)} if (hashes := foreign_hashes()) else {}),
    }


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
        files = {path.relative_to(result.folder).as_posix(): sha256(path, sys.maxsize) for path in output}
        write_json(result.folder / RESULT, data | {"files_sha256": files, "ended": _now()})
    except OSError as error:
        text = f"{result.folder / RESULT}: cannot be written ({error.strerror or error})"
        raise RunError(text + (f"; the run had failed: {result.message}" if result.failure else "")) from error
    except ReadError as error:
        raise RunError(str(error), failure_of(error)) from error


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
    record = read_record(Result, path)
    size = 0
    for name, digest in record.files_sha256.items():
        if not (folder / name).is_file():
            raise ReadError(f"{folder / name}: not there, though the run wrote it; run the case again")
        if (size := size + (folder / name).stat().st_size) > 4 * MOST_HASHED:
            raise ReadError(f"{folder / name}: {size} bytes with those before it, expected at most {4 * MOST_HASHED}")
        if sha256(folder / name) != digest:
            raise ReadError(f"{folder / name}: changed since the run ended; run the case again")
    if record.status == "completed" and not {FRAMES, SERIES} & record.files_sha256.keys():
        raise ReadError(f"{path}: files_sha256 names no {FRAMES} or {SERIES}, expected one of a completed run")
    data = record.model_dump(exclude={"ended", "files_sha256", "folder", "log"}, exclude_unset=True)
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
    data = read_record(ModelManifest, path).model_dump()
    if not data["foreign_templates"]:
        del data["foreign_templates"]
    return data


def read_model_folder(folder: Path) -> tuple[Scene, str, str]:
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
    for name, digest in data["case_files"].items():
        path = folder.parent / FILES / name
        if not path.is_file() or sha256(path) != digest:
            raise ReadError(f"{path}: changed or missing since {folder.name} was rendered; run the case again")
    if data["model"] != folder.resolve().name:
        raise ReadError(f"{folder / MANIFEST}: model = {data['model']!r}, expected that of the folder's name")
    return load_case(case, name=data["case"]), data["model"], data["engine"]


def _now() -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%S%z")
