"""Programs with a limit of time: what they print is whole, one that does not end is killed."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest

from kncal.core.awake import LOOK, run_within


def test_input_and_output_are_whole_over_many_looks() -> None:
    """A megabyte each way, through a program that takes longer than a look at the clock."""
    code = f"import sys, time; data = sys.stdin.buffer.read(); time.sleep({3 * LOOK}); sys.stdout.buffer.write(data)"
    given = bytes(range(256)) * 4096
    done = run_within(30.0, (sys.executable, "-c", code), input=given)
    assert (done.returncode, done.stdout, done.stderr) == (0, given, b"")


def test_input_waits_for_a_program_that_begins_to_read_late() -> None:
    code = f"import sys, time; time.sleep({3 * LOOK}); print(len(sys.stdin.buffer.read()))"
    assert run_within(30.0, (sys.executable, "-c", code), input=bytes(1 << 20)).stdout == b"1048576\n"


def test_a_program_that_does_not_end_is_killed() -> None:
    begin = time.monotonic()
    with pytest.raises(subprocess.TimeoutExpired) as caught:
        run_within(0.5, ("sleep", "30"))
    assert caught.value.timeout == 0.5
    assert 0.5 <= time.monotonic() - begin < 5.0
