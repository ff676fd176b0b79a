"""What an earlier start left of a run: is it kept, resumed, or run again, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from kncal.core.errors import ReadError
from kncal.engines.base import Tell
from kncal.record.outcome import RunResult
from kncal.runs.folder import read_manifest, read_result, set_aside
from kncal.runs.records import RESULT, STARTED

#: What must be the same for a result to be that of this run: manifest key -> what a user calls it.
_IDENTITY: Mapping[str, str] = {
    "kncal": "version of kncal",
    "case_sha256": "case",
    "engine": "engine",
    "solver": "solver",
    "dt": "time step",
    "steps": "number of steps",
    "ranks": "number of ranks",
    "files_sha256": "solver input",
    "foreign_templates": "set of templates",
}
#: Of the solver: where it is installed does not matter.
_SOLVER = ("version", "sha256")


@dataclass(frozen=True, kw_only=True)
class Earlier:
    """What to do about one model's folder.

    Attributes
    ----------
    action : "keep" (it is done), "resume" (from its last checkpoint) or "run"
    why : for a person; empty where there was nothing
    result : of the finished run, with "keep"
    """

    action: Literal["keep", "resume", "run"]
    why: str = ""
    result: RunResult | None = None


def take_up(
    out: Path,
    manifests: Mapping[str, Mapping[str, Any]],
    *,
    repeat: int = 1,
    checkpoints: Mapping[str, str] | None = None,
    tell: Tell | None = None,
) -> dict[str, Earlier]:
    """Decide about each model in the run folder ``out`` (`look_back`), and move what runs again to ``attempt-N``.

    ``manifests`` and ``checkpoints`` by model; ``tell`` is called with a sentence about each model that was there.
    """
    given = checkpoints or {}
    found = {
        kind: look_back(out / kind, manifest, repeat=repeat, checkpoint=given.get(kind, ""))
        for kind, manifest in manifests.items()
    }
    old = [kind for kind, earlier in found.items() if earlier.action == "run" and (out / kind).exists()]
    attempt = set_aside(out, old) if old else None
    for kind, earlier in found.items():
        if tell and earlier.why:
            done = {"keep": "not run again", "resume": "resumes", "run": f"runs again (the old run is in {attempt})"}
            tell(f"{kind} {done[earlier.action]}: {earlier.why}")
    return found


def look_back(folder: Path, manifest: Mapping[str, Any], *, repeat: int = 1, checkpoint: str = "") -> Earlier:
    """Decide about ``folder``, one model's, for the run that ``manifest`` describes.

    Parameters
    ----------
    folder : Path
        May not exist.
    manifest : mapping
        Of the run that is wanted, from `kncal.runs.folder.model_manifest`.
    repeat : int
        How many CPU times are wanted.
    checkpoint : str
        Where an unfinished run could resume ("coupling 500 of 2012"); empty: nowhere.
    """
    if not folder.exists():
        return Earlier(action="run")
    try:
        changed = _changed(read_manifest(folder), manifest)
        result = read_result(folder) if (folder / RESULT).is_file() else None
    except ReadError as error:
        return Earlier(action="run", why=str(error))
    if changed:
        return Earlier(action="run", why=f"not the same {', '.join(changed)}")
    if result is not None and result.status == "completed":
        return _completed(result, repeat)
    if result is not None:
        why = f"it ended as {result.status.replace('_', ' ')}"
    elif (folder / STARTED).is_file():
        why = "it has no end (kncal or the machine was stopped)"
    else:  # only rendered
        why = ""
    if checkpoint:
        return Earlier(action="resume", why=f"{why}; from {checkpoint}")
    return Earlier(action="run", why=why)


def _completed(result: RunResult, repeat: int) -> Earlier:
    samples = len(result.extra.get("cpu_samples") or [result.cpu_seconds])
    if samples >= repeat:
        return Earlier(action="keep", why="it is complete, with the same input", result=result)
    return Earlier(action="run", why=f"it has {samples} CPU time(s), {repeat} are asked for")


def _changed(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    def identity(manifest: Mapping[str, Any], key: str) -> Any:
        value = manifest.get(key, {})
        return tuple(value[name] for name in _SOLVER) if key == "solver" else value

    return [name for key, name in _IDENTITY.items() if identity(before, key) != identity(now, key)]
