"""How a command ends that did not do its work: an exit code, a sentence, JSON where it was asked for, no traceback."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import sys
import tempfile
import traceback

from cyclopts import CycloptsError

from kncal import __version__
from kncal.cli import show
from kncal.core.disk import FULL
from kncal.core.errors import InterruptedRunError, KncalError, RunError, SolverMissingError, failure_of

OK, OUTSIDE, USAGE, FAILED, MISSING, UNEXPECTED, INTERRUPTED = 0, 1, 2, 3, 4, 5, 130
#: Error -> exit code, the special before the general.
_CODES = {SolverMissingError: MISSING, InterruptedRunError: INTERRUPTED, RunError: FAILED, KncalError: USAGE}
#: Errors of the system that are no fault of the arguments.
_DISK = (*FULL, errno.EROFS, errno.EIO, errno.EBADF)


def end(error: BaseException, *, json: bool) -> int:
    """Tell of ``error`` on standard error, and as a JSON object on standard output if ``json``; return the exit code.

    The object has ``error`` (the text), ``kind`` (of `kncal.record.outcome.FAILURES`, or "interrupted",
    "not-installed", "not-writable", "out-of-memory", "unexpected") and ``exit_code``. It is left out where a result was
    printed before.
    """
    text, kind, code = explain(error)
    if not isinstance(error, CycloptsError):  # which prints its own text
        with contextlib.suppress(OSError):
            print(f"kncal: {show.printable(text)}", file=sys.stderr)
    if json and not show.json_was_printed():
        with contextlib.suppress(OSError):  # of which the exit code tells
            show.as_json({"error": text, "kind": kind, "exit_code": code})
            sys.stdout.flush()
    return code


def explain(error: BaseException) -> tuple[str, str, int]:
    """Text, kind and exit code of any error."""
    match error:
        case CycloptsError():
            found = str(error), "bad-input", USAGE
        case KncalError():
            code = next(code for kind, code in _CODES.items() if isinstance(error, kind))
            kind = {MISSING: "not-installed", INTERRUPTED: "interrupted"}.get(code) or failure_of(error)
            found = str(error), kind, code
        case OSError():
            kind = "disk-full" if error.errno in FULL else "not-writable"
            fault = (kind, FAILED) if error.errno in _DISK else ("bad-input", USAGE)
            found = f"{error.filename or 'output'}: {error.strerror or error}", *fault
        case UnicodeError():
            found = f"a name or text that cannot be written: {error}", "bad-input", USAGE
        case MemoryError():
            found = "out of memory", "out-of-memory", FAILED
        case KeyboardInterrupt():
            found = "interrupted", "interrupted", INTERRUPTED
        case _:
            found = _unexpected(error), "unexpected", UNEXPECTED
    return found


def _unexpected(error: BaseException) -> str:
    """The sentence about an error that kncal did not foresee; its traceback goes into a new file."""
    lines = [f"kncal {__version__}, Python {sys.version}, {sys.platform}\n", f"arguments: {json.dumps(sys.argv[1:])}\n"]
    lines += traceback.format_exception(error)
    try:
        handle, path = tempfile.mkstemp(prefix="kncal-error-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.writelines(lines)
        where = f"the traceback is in {path}"
    except OSError as problem:
        print(show.printable("".join(lines)), file=sys.stderr)
        where = f"the traceback is above (no file for it: {problem.strerror})"
    what = " ".join(f"{type(error).__name__}: {error}".split())[:200]
    return f"an error in kncal itself, not in your input ({what}); please report it: {where}"
