"""The records of a run folder as they are read back: what each must hold, in kind and in range.

A folder may come from elsewhere, so nothing in it is trusted: a record that kncal would not write is an error.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from kncal.core.records import Count, Digests, FileName, Positive, Record, Seconds, Sha256

MANIFEST, STARTED, RESULT = "manifest.json", "started.json", "result.json"
#: What an earlier run left is moved to folders of this name.
ATTEMPT = re.compile(r"attempt-[1-9]\d{0,8}")


Kind = Literal["linear", "hertz"]


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
    """``result.json``: a `kncal.record.outcome.RunResult` as `kncal.runs.folder.write_result` writes it."""

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
    """``manifest.json`` of a model's folder, as `kncal.runs.folder.model_manifest` makes it."""

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
    case_files: dict[str, Sha256] = Field(default_factory=dict)
    rendered: str
    foreign_templates: dict[str, Sha256] = Field(default_factory=dict)
