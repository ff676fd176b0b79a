"""Records that are read back from JSON: what each must hold, in kind and in range.

A file may come from elsewhere, so nothing in it is trusted: a record that kncal would not write is an error.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Annotated, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from kncal import __version__
from kncal.core.errors import ReadError
from kncal.core.files import read_json


def _file_name(text: str) -> str:
    if text != Path(text).name and text:
        raise ValueError("expected the name of a file in the run's folder")
    return text


def _inside(text: str) -> str:
    path = PurePosixPath(text)
    if not text or "\0" in text or path.is_absolute() or ".." in path.parts or text != path.as_posix():
        raise ValueError("expected the path and name of a file inside the run's folder")
    return text


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
