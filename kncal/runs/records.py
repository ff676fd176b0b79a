"""The records of a run folder as they are read back: what each must hold, in kind and in range.

A folder may come from elsewhere, so nothing in it is trusted: a record that kncal would not write is an error.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from kncal import __version__
from kncal.core.errors import ReadError
from kncal.core.tables import read_json

MANIFEST, STARTED, RESULT = "manifest.json", "started.json", "result.json"
#: What an earlier run left is moved to folders of this name.
ATTEMPT = re.compile(r"attempt-[1-9]\d{0,8}")


def _file_name(text: str) -> str:
    if text != Path(text).name and text:
        raise ValueError("expected the name of a file in the run's folder")
    return text


def _inside(text: str) -> str:
    path = PurePosixPath(text)
    if not text or "\0" in text or path.is_absolute() or ".." in path.parts or text != path.as_posix():
        raise ValueError("expected the path and name of a file inside the run's folder")
    return text


Kind = Literal["linear", "hertz"]
#: More steps than this take longer than anybody waits; a float holds them exactly.
Count = Annotated[int, Field(ge=0, le=2**53)]
Positive = Annotated[float, Field(gt=0.0)]
Seconds = Annotated[float, Field(ge=0.0)]
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
FileName = Annotated[str, AfterValidator(_file_name)]
Inside = Annotated[str, AfterValidator(_inside)]
Digests = dict[Inside, Sha256]


class Record(BaseModel):
    """What all records share: exactly these keys, no value of another kind, finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class CaseManifest(Record):
    """``manifest.json`` of a run folder: whose folder it is."""

    kncal: str
    case: str
    case_sha256: Sha256
    created: str


class Started(Record):
    """``started.json`` of a model's folder: who began the run, and what it died of if that found no better place."""

    pid: Annotated[int, Field(ge=1, le=2**31)]
    host: str
    started: str
    failure: str = ""
    message: str = ""


class Extra(Record):
    """What an engine adds to a result; other keys are free."""

    model_config = ConfigDict(extra="allow")

    cpu_samples: list[Seconds] | None = None
    couplings: Count | None = None
    cpu_dem: Seconds | None = None
    cpu_gas: Seconds | None = None
    cpu_exchange: Seconds | None = None
    transport: str | None = None
    warning: str | None = None


class Result(Record):
    """``result.json``: a `kncal.engines.base.RunResult` as `kncal.runs.folder.write_result` writes it."""

    status: Literal["completed", "failed", "timed_out", "interrupted", "not_installed"]
    engine: str
    model: Kind
    folder: str
    steps: Count
    dt: Positive
    cpu_seconds: Seconds
    wall_seconds: Seconds
    version: str
    returncode: Annotated[int, Field(ge=-(2**31), le=2**32)] | None = None
    message: str
    failure: str = ""
    log: FileName
    extra: Extra
    files_sha256: Digests
    ended: str


class Solver(Record):
    """The solver in a model's manifest."""

    program: str
    version: str
    sha256: str
    warning: str


class ModelManifest(Record):
    """``manifest.json`` of a model's folder, as `kncal.runs.folder.write_model_manifest` writes it."""

    kncal: str
    case: str
    case_sha256: str
    model: Kind
    engine: str
    solver: Solver
    command: list[str]
    ranks: Annotated[int, Field(ge=1, le=2**31)] = 1
    environment: dict[str, str]
    python: str
    platform: str
    dt: Positive
    steps: Count
    t_end: Seconds
    contacts: dict[str, dict[str, Any]]
    files_sha256: Digests
    rendered: str
    foreign_templates: dict[str, Sha256] = {}


R = TypeVar("R", bound=Record)


def read_record(kind: type[R], path: Path) -> R:
    """Read a record.

    Raises
    ------
    ReadError
        If it is none: with the file, the key, and what is wrong.
    """
    return as_record(kind, read_json(path), path)


def as_record(kind: type[R], data: object, path: Path) -> R:
    """Return what was read from ``path`` as a record; see `read_record`."""
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])[:80] or "the whole file"
        raise ReadError(f"{path}: {key}: {first['msg'][:200]}; expected what kncal {__version__} writes") from error


def is_record(kind: type[Record], path: Path) -> bool:
    """Return whether the file is such a record."""
    try:
        read_record(kind, path)
    except ReadError:
        return False
    return True
