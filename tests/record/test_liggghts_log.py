"""Logs: whole, cut off, or full of noise."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kncal.core.errors import ReadError
from kncal.record.liggghts_log import END_MARKER, read_log, step_of_line

# In the form that LIGGGHTS 3.8.0 prints: indented, right-aligned, a blank at the end.
LOG = """\
LIGGGHTS (Version LIGGGHTS-PUBLIC 3.8.0, compiled 2022-01-26-19:42:32 by buildd, git commit unknown)
Created 2 atoms
WARNING: Something is unusual (./src/some.cpp:12)
Setting up run at Sun Nov 22 09:48:23 2026

Memory usage per processor = 7.7 Mbytes
    Step    Atoms         KinEng \n\
       0        2  1.3089969e-06 \n\
     200        2           -nan \n\
WARNING: In the middle of the table
     250        2              3 \n\
Loop time of 0.5 on 1 procs for 250 steps with 2 atoms, finish time Sun Nov 22 09:48:23 2026

Pair  time (%) = 0.00014 (29.4)
Nlocal:    1 ave 1 max 1 min
Histogram: 1 0 0 0 0 0 0 0 0 0
run 50
    Step    Atoms c_dmax \n\
     250        2 -1e20 \n\
     300        1   4e-6 \n\
Loop time of 0.25 on 1 procs for 50 steps with 1 atoms, finish time Sun Nov 22 09:48:23 2026
print         "KNCAL_DONE"
KNCAL_DONE
"""


@pytest.fixture
def write(tmp_path: Path):
    def _write(text: str | bytes) -> Path:
        path = tmp_path / "log"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return _write


def test_whole_log(write) -> None:
    log = read_log(write(LOG))
    assert (log.last_step, log.atoms) == (300, 1)
    assert log.finished
    assert log.errors == ()


def test_every_cut_parses_and_none_is_finished(write) -> None:
    """Only the whole marker alone on a line counts, not the deck's own `print` line."""
    marker = LOG.rindex(END_MARKER) + len(END_MARKER)
    steps = []
    for cut in range(len(LOG)):
        log = read_log(write(LOG[:cut]))
        assert log.finished == (cut >= marker)
        steps.append(-1 if log.last_step is None else log.last_step)
    assert sorted(set(steps)) == [-1, 0, 200, 250, 300]
    assert steps == sorted(steps)


def test_nothing_at_all(write) -> None:
    log = read_log(write(""))
    assert (log.last_step, log.atoms, log.finished) == (None, None, False)


@pytest.mark.parametrize(
    "line", ["ERROR: Lost atoms: original 0 current 0 (./src/thermo.cpp:445)", "ERROR on proc 0: bad seed"]
)
def test_error_lines_and_what_follows_them(write, line: str) -> None:
    """LIGGGHTS may write random bytes after an error; no control character comes through."""
    log = read_log(write(LOG[:700].encode() + b"\n" + line.encode() + b"\n\xff\xfe\x1b[31m ERR\n"))
    assert log.errors == (line,)
    escape = read_log(write(b"ERROR: \x1b]0;title\x07 bad\n"))
    assert "\x1b" not in escape.errors[0]
    assert "\x07" not in escape.errors[0]


def test_an_echoed_line_is_no_error(write) -> None:
    log = read_log(write('print "ERROR: not one"\nprint "KNCAL_DONE"\n# KNCAL_DONE\n'))
    assert log.errors == ()
    assert not log.finished


@given(st.binary(max_size=400))
def test_any_bytes_parse(tmp_path_factory: pytest.TempPathFactory, noise: bytes) -> None:
    path = tmp_path_factory.mktemp("log") / "log"
    path.write_bytes(noise + b"\n" + LOG.encode())
    log = read_log(path)
    assert log.last_step == 300
    assert log.finished


def test_an_endless_line_is_bounded(write) -> None:
    log = read_log(write(b"ERROR " + b"x" * 3_000_000 + b"\n" + LOG.encode()))
    assert len(log.errors[0]) <= 4096
    assert log.finished


def test_many_errors_are_bounded(write) -> None:
    log = read_log(write("ERROR: again\n" * 100_000))
    assert len(log.errors) == 20


def test_missing_log(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="No such file"):
        read_log(tmp_path / "log")


@given(st.integers(0, 10**12), st.floats())
def test_step_of_a_thermo_line(step: int, value: float) -> None:
    assert step_of_line(f"{step:8d}        1 {value!r} ") == step


@pytest.mark.parametrize(
    "line",
    ["", "12", "    Step    Atoms         KinEng ", "Loop time of 0.5", "1 by 1 by 1 MPI processor grid",
     "  1 settings made for vz", "0.5 1 2", "-1 2 3", "\u0661 2 3", "Histogram: 1 0 0"],
)  # fmt: skip
def test_what_is_no_thermo_line(line: str) -> None:
    assert step_of_line(line) is None
