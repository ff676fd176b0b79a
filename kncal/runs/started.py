"""The record that a run began, ``started.json``; of one that could leave no result, it also says what it died of."""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from kncal.core.disk import blame
from kncal.core.errors import KncalError, ReadError, failure_of
from kncal.core.files import write_text
from kncal.core.records import read_record
from kncal.record.outcome import FAILURES
from kncal.runs.records import RESULT, STARTED, Started

_SIZE = 4096  # bytes of the record, mostly blanks
_NOTED = 500  # characters of a message in it, of at most six bytes


@contextmanager
def started(folder: Path) -> Iterator[None]:
    """Say that a run began in one model's folder; what is no longer true goes.

    An error that leaves the block without a ``result.json``, as on a full disk, is noted in the record.
    """
    (folder / RESULT).unlink(missing_ok=True)
    record = Started(pid=os.getpid(), host=socket.gethostname(), started=time.strftime("%Y-%m-%dT%H:%M:%S%z"))
    # With blanks behind it: what is noted later needs no room of its own.
    write_text(folder / STARTED, record.model_dump_json(exclude_defaults=True).ljust(_SIZE - 1) + "\n")
    try:
        yield
    except (KncalError, OSError) as error:
        with suppress(OSError):
            _note(folder / STARTED, record.model_copy(update={"failure": failure_of(error), "message": str(error)}))
        raise


def _note(path: Path, record: Started) -> None:
    text = json.dumps(record.model_dump() | {"message": record.message[:_NOTED]})
    with path.open("r+b") as file:
        file.write(text.ljust(_SIZE - 1).encode("ascii") + b"\n")
        file.flush()
        os.fsync(file.fileno())


def end_without_result(folder: Path) -> tuple[str, str]:
    """Return failure and message of a run that began and left no ``result.json``: as noted, or as far as one can see.

    "killed" means that nothing was noted: kncal, or the machine, was stopped.
    """
    who = "an unknown process"
    with suppress(ReadError):
        record = read_record(Started, folder / STARTED)
        if record.failure in FAILURES:
            return record.failure, record.message
        who = f"process {record.pid} on {record.host[:80]}, started {record.started[:40]}"
    return blame("killed", f"{who}, was stopped before it could write a result", folder)
