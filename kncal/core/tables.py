"""JSON and CSV files that are whole or not there, and exact in every digit."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from kncal.core.errors import InputError, ReadError
from kncal.core.files import read_limited
from kncal.core.scratch import replacing

if TYPE_CHECKING:
    import pandas as pd

#: A larger JSON file is refused: read, it takes about twenty times its size.
MAX_JSON_BYTES = 32 * 1024**2
#: What spreadsheets take for the beginning of a formula; the wide forms too.
_FORMULA = ("=", "+", "-", "@", "\uff1d", "\uff0b", "\uff0d", "\uff20")


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


def write_text(path: Path, text: str) -> None:
    """Write a temporary file beside ``path``, bring it to the disk, and put it in place in one move.

    A symbolic link at ``path`` is replaced, not followed.
    """
    with replacing(path) as file:
        file.write(text.encode("utf-8"))
