"""The run folder: what is in it, where it came from, and how it is taken up again.

OUT/case.toml  OUT/manifest.json         the scene as it was run, and its hash
OUT/linear/    OUT/hertz/                one folder a model: solver input, log, frames, manifest.json, result.json
OUT/report/                              index.html and its pictures
OUT/attempt-1/ ...                       what an earlier run left, moved aside
"""

from __future__ import annotations

import hashlib
import platform
import shutil
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from kncal import __version__
from kncal.case_file import dump_case, load_case
from kncal.engines.base import Profile, RunResult
from kncal.errors import ReadError, RenderError
from kncal.io.tables import read_json, write_json
from kncal.model import Model
from kncal.scene import Scene

MANIFEST, RESULT, CASE = "manifest.json", "result.json", "case.toml"


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file as hexadecimal text."""
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def open_case_folder(scene: Scene, out: Path) -> Path:
    """Make ``out`` ready for a run of ``scene``; what an earlier run left there is moved to ``attempt-N``.

    Raises
    ------
    RenderError
        If ``out`` is a file, or holds things that kncal did not put there.
    """
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise RenderError(f"{out}: expected a folder (or nothing yet), not a file or a link; choose another --out")
    if out.is_dir() and any(out.iterdir()):
        if not (out / MANIFEST).is_file():
            raise RenderError(
                f"{out}: the folder holds files and no kncal {MANIFEST}; choose an empty folder with --out, "
                "nothing was changed"
            )
        _move_aside(out)
    out.mkdir(parents=True, exist_ok=True)
    (out / CASE).write_text(dump_case(scene), encoding="utf-8")
    write_json(
        out / MANIFEST,
        {"kncal": __version__, "case": scene.name, "case_sha256": sha256(out / CASE), "created": _now()},
    )
    return out


def _move_aside(out: Path) -> None:
    number = 1
    while (attempt := out / f"attempt-{number}").exists():
        number += 1
    old = [path for path in out.iterdir() if not path.name.startswith("attempt-")]
    attempt.mkdir()
    for path in old:
        shutil.move(path, attempt / path.name)


def write_model_manifest(model: Model, folder: Path, profile: Profile, command: list[str]) -> None:
    """Write ``manifest.json`` of one model's folder: what was rendered, for which solver, by which kncal."""
    files = {p.name: sha256(p) for p in sorted(folder.iterdir()) if p.is_file() and p.name != MANIFEST}
    write_json(
        folder / MANIFEST,
        {
            "kncal": __version__,
            "case": model.scene.name,
            "case_sha256": hashlib.sha256(dump_case(model.scene).encode()).hexdigest(),
            "model": model.kind,
            "engine": profile.engine,
            "solver": {"program": str(profile.program or ""), "version": profile.version},
            "command": command,
            "python": platform.python_version(),
            "platform": platform.platform(),
            "dt": model.dt,
            "steps": model.n_steps,
            "t_end": model.t_end,
            "contacts": {
                f"{a}–{b}": {k: v for k, v in asdict(c).items() if v is not None}
                for (a, b), c in model.contacts.items()
            },
            "files_sha256": files,
            "rendered": _now(),
        },
    )


def write_result(result: RunResult) -> None:
    """Write ``result.json`` beside the run's output (temporary file, fsync, rename)."""
    data = {k: v for k, v in asdict(result).items() if v is not None}
    data |= {"folder": result.folder.name, "log": result.log.name if result.log else ""}
    write_json(result.folder / RESULT, data | {"ended": _now()})


def read_result(folder: Path) -> RunResult:
    """Read ``result.json`` of a model's folder.

    Raises
    ------
    ReadError
        If there is none (the run has not ended) or it is not one.
    """
    path = folder / RESULT
    if not path.is_file():
        raise ReadError(f"{path}: not there, so this run has not ended; run it with `kncal run`")
    data = read_json(path)
    data.pop("ended", None)
    log = data.pop("log", "")
    data["folder"] = folder
    try:
        return RunResult(**data, log=folder / log if log else None)
    except TypeError as error:
        raise ReadError(f"{path}: not a result of this version of kncal: {error}") from error


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read ``manifest.json`` of a model's folder.

    Raises
    ------
    ReadError
        If there is none.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise ReadError(f"{folder}: no {MANIFEST}; expected a model's run folder, e.g. runs/wall_impact/hertz")
    data: dict[str, Any] = read_json(path)
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
    if not case.is_file() or "model" not in data:
        raise ReadError(f"{folder}: expected a model's run folder with {CASE} in the folder above")
    if sha256(case) != data["case_sha256"]:
        raise ReadError(f"{case}: changed since {folder.name} was rendered; run the case again")
    scene = load_case(case, name=str(data["case"]))
    return scene, str(data["model"]), str(data["engine"])


def _now() -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%S%z")
