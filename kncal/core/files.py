"""Files: others' read with care (regular files only, no more bytes than a limit), our own whole or not there.

Text of solvers is made safe to keep and to show; JSON and CSV are exact in every digit.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import math
import os
import re
import stat
import tempfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NoReturn

import numpy as np

from kncal.core.errors import InputError, ReadError
from kncal.core.scratch import RANDOM, hold, named

if TYPE_CHECKING:
    import pandas as pd

#: Of a larger file no digest is compared: that would take minutes [bytes].
MOST_HASHED = 16 * 1024**3
#: A larger JSON file is refused: read, it takes about twenty times its size.
MAX_JSON_BYTES = 32 * 1024**2
#: What spreadsheets take for the beginning of a formula; the wide forms too.
_FORMULA = ("=", "+", "-", "@", "\uff1d", "\uff0b", "\uff0d", "\uff20")
#: Longer lines are cut [bytes]; solvers write shorter ones, but a damaged file may be one endless line.
MAX_LINE = 4096
_PART = ".part"


def open_limited(path: Path, most: int, expected: str, advice: str = "") -> BufferedReader:
    """Open a regular file of at most ``most`` bytes for reading.

    A device or a pipe has no size and may give bytes for ever, or none: it is refused without waiting for it.

    Raises
    ------
    ReadError
        If the file is missing, no regular file or too large; the text names it, ``expected`` and the ``advice``.
    """
    try:
        # O_NONBLOCK: opening a pipe that nobody writes to would wait
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ReadError(f"{path}: cannot be read ({reason}); expected {expected}") from error
    try:
        about = os.fstat(descriptor)
        if not stat.S_ISREG(about.st_mode):
            raise ReadError(f"{path}: not a regular file; expected {expected}")
        if about.st_size > most:
            hint = f"; {advice}" if advice else ""
            raise ReadError(f"{path}: {about.st_size} bytes, expected at most {most}{hint}")
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def sha256(path: Path, most: int = MOST_HASHED) -> str:
    """Return the SHA-256 of a regular file of at most ``most`` bytes as hexadecimal text; errors as `open_limited`."""
    with open_limited(path, most, "a file to compare with its record") as file:
        try:
            return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise ReadError(f"{path}: cannot be read ({error.strerror})") from error


def read_limited(path: Path, most: int, expected: str, advice: str = "") -> bytes:
    """Return the bytes of a regular file of at most ``most`` bytes; see `open_limited` for the errors."""
    with open_limited(path, most, expected, advice) as file:
        try:
            # not more than it was when it was opened: something may still be writing
            return file.read(os.fstat(file.fileno()).st_size)
        except OSError as error:
            raise ReadError(f"{path}: cannot be read ({error.strerror}); expected {expected}") from error


@contextmanager
def replacing(path: Path, *, durable: bool = True) -> Iterator[BinaryIO]:
    """Give a temporary file beside ``path``, put in its place in one move at the end; after an error it is removed.

    With ``durable`` it is on the disk before. A symbolic link at ``path`` is replaced, not followed.
    """
    name = path.name[:100]
    sweep_parts(path.parent, [name])
    while True:
        descriptor, made = tempfile.mkstemp(dir=path.parent, prefix=f".{name}.", suffix=_PART)
        with suppress(OSError):  # where no file can be locked
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        if os.fstat(descriptor).st_nlink:
            break
        os.close(descriptor)  # another start took it for a leftover before it was held
    part = Path(made)
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file
            file.flush()
            os.fchmod(file.fileno(), 0o644)  # mkstemp makes it private; results are for everyone to read
            if durable:
                os.fsync(file.fileno())
            part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    if durable:
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)  # without it the move itself may be lost
        finally:
            os.close(folder)


def sweep_parts(folder: Path, names: Collection[str] | None = None) -> None:
    """Remove what killed starts left of `replacing` in ``folder``, of files with these names; None: of all."""
    of = ".+" if names is None else "|".join(map(re.escape, names))
    for part in named(folder, rf"\.(?:{of})\.{RANDOM}{re.escape(_PART)}"):
        if (descriptor := hold(part, stat.S_IFREG)) is not None:
            with suppress(OSError):
                part.unlink()
            os.close(descriptor)


def write_text(path: Path, text: str) -> None:
    """Write a temporary file beside ``path``, bring it to the disk, and put it in place in one move.

    A symbolic link at ``path`` is replaced, not followed.
    """
    with replacing(path) as file:
        file.write(text.encode("utf-8"))


def decode_line(line: bytes) -> str:
    """Decode one line of a log: at most `MAX_LINE` bytes, without blanks at the end.

    LIGGGHTS may write random bytes after an error; those, and control characters that a terminal would obey,
    become U+FFFD.
    """
    text = line[:MAX_LINE].decode("utf-8", errors="replace").rstrip()
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\t" else "\ufffd" for c in text)


def write_json(path: Path, data: object) -> None:
    """Write ``data`` as JSON; a reader finds the old file or the whole new one, also after a power cut.

    Dictionaries (with text keys), sequences, text, numbers, booleans, None, paths, numpy numbers and arrays.

    Raises
    ------
    InputError
        If a value is NaN or infinite, or of a kind that JSON has no form for; the text names the key.
    """
    text = json.dumps(_plain(data, ""), indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def read_json(path: Path) -> Any:
    """Read a JSON file of at most `MAX_JSON_BYTES`.

    Raises
    ------
    ReadError
        If the file is missing, too large, not UTF-8, or not JSON (NaN and Infinity are not); with file and line.
    """

    def refuse(constant: str) -> NoReturn:
        raise ReadError(f"{path}: holds {constant[:40]}, expected finite numbers")

    def finite(digits: str) -> float:
        value = float(digits)
        return value if math.isfinite(value) else refuse(digits)

    data = read_limited(path, MAX_JSON_BYTES, "a JSON file")
    try:
        return json.loads(data.decode("utf-8"), parse_constant=refuse, parse_float=finite)
    except UnicodeDecodeError as error:
        raise ReadError(f"{path}: byte {error.start} is not UTF-8; expected a JSON file") from error
    except json.JSONDecodeError as error:
        place = f"line {error.lineno}, column {error.colno}"
        raise ReadError(f"{path}, {place}: {error.msg}; expected JSON (is the file cut off?)") from error
    except RecursionError as error:
        raise ReadError(f"{path}: nested too deeply; expected a JSON file written by kncal") from error
    except ValueError as error:  # a whole number of thousands of digits
        raise ReadError(f"{path}: {error}; expected a JSON file written by kncal") from error


def write_csv(path: Path, frame: pd.DataFrame, units: Mapping[str, str]) -> None:
    """Write a table; the first line is a comment with the unit of each column, then the names, then the rows.

    Floats get the shortest text that reads back exactly. `pandas.read_csv(path, comment="#")` reads the file.

    Parameters
    ----------
    path : Path
        Replaced as a whole, as by `write_json`.
    frame : pandas.DataFrame
    units : mapping
        Column name -> unit ("-" for a number without one), for every column.

    Raises
    ------
    InputError
        If a column has no unit.
    """
    missing = [str(name) for name in frame.columns if name not in units]
    if missing:
        raise InputError(f"units: nothing for {', '.join(missing)}; expected a unit for each column ('-' for none)")
    comment = "# units: " + ", ".join(f"{name} [{units[name]}]" for name in frame.columns)
    write_text(path, f"{' '.join(comment.split())}\n{csv_text(frame)}")


def csv_text(frame: pd.DataFrame) -> str:
    """Return a table as CSV that no spreadsheet takes for a formula or a terminal for a command.

    In text, control characters become spaces, and what a spreadsheet would compute (``=``, ``+``, ``-``, ``@`` first)
    gets an apostrophe before it: text may come from a stranger's run folder. Numbers are left as they are.
    """
    harmless = frame.rename(columns=_harmless)
    for i, kind in enumerate(frame.dtypes):
        if getattr(kind, "kind", "O") not in "biufc":  # not a number
            harmless.isetitem(i, [_harmless(value) for value in frame.iloc[:, i]])
    text: str = harmless.to_csv(index=False, lineterminator="\n")
    return text


def _harmless(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    text = "".join(c if c.isprintable() else " " for c in value)
    if len(text) > 1 and text.lstrip().startswith(_FORMULA) and not _is_number(text):
        return f"'{text}"
    return text


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _plain(value: Any, where: str) -> Any:
    """Turn numpy values and paths into what `json` knows; ``where`` is the key, for the message."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        if not np.isfinite(value):
            raise InputError(f"{where or 'value'} = {value}: expected a finite number; leave the key out, or use None")
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise InputError(f"{where or 'value'}: key {key!r}, expected text")
        return {str(key): _plain(item, f"{where}.{key}" if where else key) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, f"{where}[{i}]") for i, item in enumerate(value)]
    raise InputError(f"{where or 'value'}: {type(value).__name__} has no form in JSON; expected plain data")
