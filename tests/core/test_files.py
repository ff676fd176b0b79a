"""JSON and CSV: exact, whole, and refused where they would lie."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kncal.core.errors import InputError, ReadError
from kncal.core.files import read_json, write_csv, write_json

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@settings(max_examples=50)  # each waits for the disk
@given(JSON)
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, data: object) -> None:
    path = tmp_path_factory.mktemp("json") / "a.json"
    try:
        write_json(path, data)
    except UnicodeEncodeError:  # lone surrogates are no text
        return
    assert read_json(path) == data


def test_numpy_and_paths(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_json(
        path,
        {
            "scalar": np.float64(0.1),
            "whole": np.int32(3),
            "flag": np.bool_(True),
            "array": np.arange(4.0).reshape(2, 2),
            "path": Path("a/b"),
            "tuple": (1, "µ"),
        },
    )
    assert read_json(path) == {
        "scalar": 0.1, "whole": 3, "flag": True, "array": [[0.0, 1.0], [2.0, 3.0]], "path": "a/b", "tuple": [1, "µ"]
    }  # fmt: skip


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, np.float32("nan"), np.array([1.0, np.nan])])
def test_not_finite_is_refused_by_name_and_nothing_is_written(tmp_path: Path, bad: object) -> None:
    path = tmp_path / "a.json"
    write_json(path, {"old": 1})
    with pytest.raises(InputError, match=r"runs\[1\]\.e_n"):
        write_json(path, {"runs": [{}, {"e_n": bad}]})
    assert read_json(path) == {"old": 1}
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("bad", [{1: 2}, {"a": {1, 2}}, {"a": 1j}, object()])
def test_what_json_has_no_form_for(tmp_path: Path, bad: object) -> None:
    with pytest.raises(InputError):
        write_json(tmp_path / "a.json", bad)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "part"),
    [
        (b"", "line 1, column 1"),
        (b'{"a": 1,\n "b": ', "line 2"),
        (b'{"a": NaN}', "NaN"),
        (b'{"a": -Infinity}', "-Infinity"),
        (b'{"a": "\xff"}', "byte 7 is not UTF-8"),
        (b"[" * 200_000, "nested too deeply"),
    ],
)
def test_reading_what_is_no_json(tmp_path: Path, text: bytes, part: str) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(text)
    with pytest.raises(ReadError, match=part) as caught:
        read_json(path)
    assert str(path) in str(caught.value)


def test_missing(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="No such file"):
        read_json(tmp_path / "none.json")


def test_a_kill_leaves_the_old_or_the_new_file(tmp_path: Path) -> None:
    """A process that rewrites a file without end is killed; what is there is whole, at every attempt."""
    path = tmp_path / "a.json"
    code = (
        "import sys, pathlib\n"
        "from kncal.core.files import write_json\n"
        "k = 0\n"
        "while True:\n"
        "    k += 1\n"
        "    write_json(pathlib.Path(sys.argv[1]), {'k': k, 'values': [k] * 20000})\n"
    )
    for _ in range(3):
        path.unlink(missing_ok=True)
        child = subprocess.Popen([sys.executable, "-c", code, str(path)])
        while not path.exists():
            assert child.poll() is None
            time.sleep(0.01)
        time.sleep(0.05)
        os.kill(child.pid, signal.SIGKILL)
        child.wait()
        data = json.loads(path.read_text())
        assert data["values"] == [data["k"]] * 20000


def test_results_are_readable_for_others(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {})
    assert (tmp_path / "a.json").stat().st_mode & 0o777 == 0o644


@given(st.lists(st.floats(allow_infinity=False, allow_nan=False), min_size=1, max_size=5))
def test_csv_is_exact_and_says_its_units(tmp_path_factory: pytest.TempPathFactory, values: list[float]) -> None:
    path = tmp_path_factory.mktemp("csv") / "a.csv"
    frame = pd.DataFrame({"step": range(len(values)), "delta": values})
    write_csv(path, frame, {"step": "-", "delta": "m"})
    assert path.read_text().splitlines()[0] == "# units: step [-], delta [m]"
    back = pd.read_csv(path, comment="#")
    assert back["delta"].astype(float).tolist() == values
    assert back["step"].tolist() == list(range(len(values)))


@pytest.mark.parametrize(
    "text", ["=HYPERLINK(1)", "+1+cmd|' /C calc'!A0", "-2+3", "@SUM(1)", " =1+1", "\t=1", "\uff1d1"]
)
def test_a_cell_of_text_is_no_formula(tmp_path: Path, text: str) -> None:
    write_csv(tmp_path / "a.csv", pd.DataFrame({"x": [-1.5, 2.0], "why": [text, "fine"]}), {"x": "m", "why": "-"})
    (first, second) = pd.read_csv(tmp_path / "a.csv", comment="#").to_dict(orient="records")
    assert first["why"].lstrip().startswith("'")
    assert first["why"].lstrip(" '").rstrip() == text.strip()
    assert (first["x"], second["x"], second["why"]) == (-1.5, 2.0, "fine")


def test_a_cell_of_text_holds_no_control_characters_and_numbers_in_text_stay(tmp_path: Path) -> None:
    texts = ["a\x1b[31mb\x00\x07\x9b\u202ec", "-3.5e-3", "-", "[-1.0, 2]"]
    write_csv(tmp_path / "a.csv", pd.DataFrame({"why": texts}), {"why": "-"})
    found = (tmp_path / "a.csv").read_text().splitlines()[2:]
    assert all(line.isprintable() for line in found)
    assert found[1:] == ["-3.5e-3", "-", '"[-1.0, 2]"']


def test_csv_needs_every_unit(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="delta"):
        write_csv(tmp_path / "a.csv", pd.DataFrame({"t": [0.0], "delta": [0.0]}), {"t": "s"})
