"""The design of a sweep: which runs there are, what each is called, and what all of them share.

OUT/case.toml        the case before any value was replaced
OUT/sweep.json       the design: settings, and the values of every run
OUT/runs/<id>/       one ordinary run folder per run; the id is a hash of what the run depends on
OUT/states.jsonl     how the runs ended, as a cache; the truth is their result.json
OUT/sweep.csv        one row per run and model
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from kncal import __version__
from kncal.core.checks import one_of, positive
from kncal.core.errors import CaseFileError, InputError, KncalError, ReadError
from kncal.core.files import read_json, write_json, write_text
from kncal.core.mpi import check_ranks
from kncal.core.scratch import scratch
from kncal.engines.base import Engine
from kncal.engines.registry import ENGINES, engine_for
from kncal.runs.solving import plan_checked
from kncal.scene.case_file import CASE, copy_files, identity_text, load_case
from kncal.scene.case_text import CaseText, read_case
from kncal.scene.finding import Finding
from kncal.scene.limits import check
from kncal.scene.model import KINDS, Plan
from kncal.scene.overrides import parse_override
from kncal.scene.scene import Scene
from kncal.study.points import Point

DESIGN, RUNS = "sweep.json", "runs"
#: So many bad points are named in one refusal.
_NAMED = 10

Id = Annotated[str, Field(pattern="^[0-9a-f]{12}$")]


#: Called with (id of a run, a warning about it).
OnWarnings = Callable[[str, tuple[Finding, ...]], None]


class Refused(BaseModel):
    """A point that is no possible run, and why."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    values: list[str]
    message: str


class Sweep(BaseModel):
    """What ``sweep.json`` says.

    Attributes
    ----------
    kncal : version that made the design
    name : of the case, and of every run's scene
    engine, models, transport : of every run; ``transport`` is "" where nothing is coupled
    timeout : wall-clock limit of each model's run [s], or None
    ranks, oversubscribe : of every run, see `kncal.core.mpi.check_ranks`
    beyond : whether limits (`kncal.scene.limits`) are not asked, since what happens beyond them is looked for
    runs : id -> the values that the run has in place of the case's, as ``KEY = VALUE``
    refused : points that were left out because they cannot run
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)

    kncal: str
    name: str
    case_sha256: str
    engine: str
    models: list[Literal["linear", "hertz"]]
    transport: str
    timeout: Annotated[float, Field(gt=0.0)] | None
    ranks: Annotated[int, Field(ge=1)] = 1
    oversubscribe: bool = False
    beyond: bool = False
    created: str
    runs: dict[Id, list[str]]
    refused: list[Refused]

    def values(self, run: str) -> dict[str, Any]:
        """Return key -> value of one run."""
        return {override.key: override.value for override in map(parse_override, self.runs[run])}


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What all runs of a sweep share beside the case.

    Attributes
    ----------
    engine : of single contacts
    models : "linear", "hertz" or both
    transport : of beds
    timeout : wall-clock limit of each model's run [s], or None; not part of a run's identity
    ranks : processes that share one run; oversubscribe : allow more of them than cores (not part of the identity)
    beyond : do not ask the limits of the scene
    """

    engine: str = "liggghts"
    models: tuple[str, ...] = KINDS
    transport: str = "auto"
    timeout: float | None = None
    ranks: int = 1
    oversubscribe: bool = False
    beyond: bool = False

    def __post_init__(self) -> None:
        if not self.models or len(set(self.models)) != len(self.models):
            raise InputError(f"models = {self.models}: expected one or both of {', '.join(KINDS)}")
        for kind in self.models:
            one_of("model", kind, KINDS)
        if self.timeout is not None:
            positive("timeout", self.timeout, unit="s")
        check_ranks(self.ranks, oversubscribe=self.oversubscribe)


def physics_text(case_text: str) -> str:
    """Return a text as of `identity_text` without title and source, on which no run depends."""
    lines = case_text.split("\n")
    return "\n".join(line for i, line in enumerate(lines) if i > 1 or not line.startswith(("title = ", "source = ")))


def run_id(case_text: str, *, engine: str, models: Iterable[str], transport: str, ranks: int = 1) -> str:
    """Return the id of a run: twelve hexadecimal digits of a hash of all that its results depend on."""
    parts = [physics_text(case_text), engine, sorted(models), transport, *([ranks] if ranks > 1 else [])]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:12]


def design(
    case: str | Path,
    points: Sequence[Point],
    settings: Settings,
    *,
    skip_bad: bool = False,
    progress: Callable[[int, int], None] | None = None,
    warn: OnWarnings | None = None,
) -> tuple[Sweep, CaseText]:
    """Check every point as far as that is possible without a run; return the design, and the case file.

    Points that are the same run become one. Nothing is written.

    Parameters
    ----------
    case : str or Path
        A case.toml, a folder holding one, or the name of a shipped case.
    points : sequence of Point
    settings : Settings
    skip_bad : bool
        Leave points out that cannot run (they are in ``Sweep.refused``) instead of refusing the sweep.
    progress : callable, optional
        Called with (points checked, points in all).
    warn : callable, optional
        Called with (id, warning), once for each run that has one.

    Raises
    ------
    CaseFileError
        If the case is not valid, or points are not (each is named with its values and the reason).
    """
    sweep, text, _ = design_points(case, points, settings, skip_bad=skip_bad, progress=progress, warn=warn)
    if not sweep.runs:
        raise _refusal(sweep.refused)
    return sweep, text


def design_points(
    case: str | Path,
    points: Sequence[Point],
    settings: Settings,
    *,
    skip_bad: bool = False,
    progress: Callable[[int, int], None] | None = None,
    warn: OnWarnings | None = None,
) -> tuple[Sweep, CaseText, list[str | None]]:
    """Do as `design` does; return also the id of each point's run, None for a refused one. There may be no run at all.

    Raises
    ------
    CaseFileError
        As `design`, but not where ``skip_bad`` leaves nothing.
    """
    text, name, _ = read = read_case(case)
    base = load_case(case)
    shared: dict[str, Any] = {"ranks": settings.ranks, "oversubscribe": settings.oversubscribe}
    engine = engine_for(base, settings.engine, settings.transport, **shared)
    transport = settings.transport if ENGINES[engine.name].coupled else ""
    runs: dict[str, list[str]] = {}
    refused: list[Refused] = []
    ids: list[str | None] = []
    id_of = partial(run_id, engine=engine.name, models=settings.models, transport=transport, ranks=settings.ranks)
    with scratch() as draft:
        for done, point in enumerate(points, start=1):
            values = [str(override) for override in point]
            try:
                scene = load_case(case, overrides=values) if values else base
                models = _checked(scene, settings, engine, draft)
                written = identity_text(scene)
            except KncalError as error:
                # the values stand beside the message anyway
                refused.append(Refused(values=values, message=str(error).partition("\n(with ")[0]))
                ids.append(None)
                if len(refused) > _NAMED and not skip_bad:
                    break
            else:
                ids.append(id_of(written))
                if warn is not None and ids[-1] not in runs and (found := _warnings(models)):
                    warn(str(ids[-1]), found)
                runs.setdefault(str(ids[-1]), values)
            if progress is not None:
                progress(done, len(points))
    if refused and not skip_bad:
        raise _refusal(refused)
    sweep = Sweep.model_validate(
        {
            "kncal": __version__,
            "name": name,
            "case_sha256": hashlib.sha256(text.encode()).hexdigest(),
            "engine": engine.name,
            "models": list(settings.models),
            "transport": transport,
            "timeout": settings.timeout,
            **shared,
            "beyond": settings.beyond,
            "created": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "runs": runs,
            "refused": refused,
        }
    )
    return sweep, read, ids


def _refusal(refused: Sequence[Refused]) -> CaseFileError:
    named = "\n".join(f"  {', '.join(r.values)}: {r.message}" for r in refused[:_NAMED])
    more = "\n  and more" if len(refused) > _NAMED else ""
    return CaseFileError(f"points of the sweep that cannot run; nothing was started:\n{named}{more}")


def _checked(scene: Scene, settings: Settings, engine: Engine, draft: Path) -> list[Plan]:
    """Return the models of a scene that can run; refused by planning, limits, or what the engine cannot do."""
    engine.check(scene)
    models = list(plan_checked(scene, settings.models, beyond=settings.beyond).values())
    for model in models:
        if not model.couplings:  # what starts from a packing is rendered when it runs
            engine.render(model, draft)
    return models


def _warnings(models: Sequence[Plan]) -> tuple[Finding, ...]:
    """Return the limits that these models of one run come near to, each kind once."""
    found: dict[str, Finding] = {}
    for model in models:
        for finding in check(model):
            if finding.level == "warn":
                found.setdefault(finding.code, finding)
    return tuple(found.values())


def write_design(folder: Path, sweep: Sweep, case: CaseText) -> None:
    """Write the case and the design into a sweep's folder."""
    write_text(folder / CASE, case.text)
    copy_files(load_case(case.where), folder)
    write_json(folder / DESIGN, sweep.model_dump())


def is_design(path: Path) -> bool:
    """Return whether a file is the design of a sweep, of this or another version of kncal."""
    try:
        data = read_json(path)
    except ReadError:
        return False
    return isinstance(data, dict) and {"kncal", "case_sha256", "runs"} <= data.keys()


def read_design(folder: Path) -> Sweep:
    """Read the design of a sweep.

    Raises
    ------
    ReadError
        If the folder is not that of a sweep, or ``sweep.json`` is not one.
    """
    path = folder / DESIGN
    try:
        status = path.stat()
    except OSError:
        raise ReadError(f"{folder}: no {DESIGN}; expected the folder of a sweep (see `kncal sweep`)") from None
    return _read(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=4)  # a worker asks once per run
def _read(path: Path, _time: int, _size: int) -> Sweep:
    try:
        return Sweep.model_validate(read_json(path))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "the whole file"
        raise ReadError(f"{path}: {key}: {first['msg']}; expected what kncal {__version__} writes") from error


def run_folder(folder: Path, run: str) -> Path:
    """Return the run folder of one run."""
    return folder / RUNS / run


def scene_of(folder: Path, sweep: Sweep, run: str) -> Scene:
    """Return the scene of one run, from the case in the sweep's folder.

    Raises
    ------
    ReadError
        If the sweep has no such run, or the case does not give this run (it was changed).
    """
    if run not in sweep.runs:
        raise ReadError(f"{folder / DESIGN}: no run {run!r}")
    scene = load_case(folder / CASE, name=sweep.name, overrides=sweep.runs[run])
    if identity(sweep, identity_text(scene)) != run:
        raise ReadError(
            f"{folder / CASE}: changed since the sweep was made: it does not give run {run}; choose another --out"
        )
    return scene


def identity(sweep: Sweep, case_text: str) -> str:
    """Return the id that a case file (its `identity_text`) has in a sweep."""
    return run_id(case_text, engine=sweep.engine, models=sweep.models, transport=sweep.transport, ranks=sweep.ranks)


def keys_of(sweep: Sweep) -> list[str]:
    """Return the keys that the runs of a sweep set, in the order of the first run that has them."""
    keys: dict[str, None] = {}
    for run in sweep.runs:
        keys |= dict.fromkeys(sweep.values(run))
    return list(keys)
