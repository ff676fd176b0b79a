"""Why a run is not to be trusted: small named checks that report and never correct.

LIGGGHTS' exit code is no proof: it is 0 after SIGTERM, on a full disk, with an empty deck, with lost particles and
with NaN. A run counts if it exited with 0, printed the end marker, reached its last step, kept its particles, and
left a whole dump of finite numbers.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kncal.core.disk import blame
from kncal.core.errors import ReadError
from kncal.core.process import ProcessResult, signal_name
from kncal.record.liggghts_dump import read_dump
from kncal.record.liggghts_log import END_MARKER, LiggghtsLog, read_log

if TYPE_CHECKING:
    import pandas as pd

#: Every code that a `Diagnosis` may have.
CODES = (
    "not-installed",
    "timed-out",
    "interrupted",
    "lost-particles",
    "solver-error",
    "killed",
    "no-end-marker",
    "wrong-last-step",
    "empty-output",
    "truncated-output",
    "not-finite",
    "disk-full",
)


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """What is wrong with a run: ``code`` is one of `CODES`, ``message`` is for the user."""

    code: str
    message: str


@dataclass(frozen=True)
class _Evidence:
    process: ProcessResult
    log_path: Path
    dump_path: Path
    expected_steps: int
    expected_atoms: int

    @cached_property
    def log(self) -> LiggghtsLog:
        return read_log(self.log_path)

    @cached_property
    def dump(self) -> pd.DataFrame:
        return read_dump(self.dump_path)

    def reached(self) -> str:
        """How far the run came, for a message."""
        try:
            last = self.log.last_step
        except ReadError:
            return f"(of {self.expected_steps} steps; the log cannot be read)"
        if last is None:
            return f"before its first step (of {self.expected_steps})"
        return f"at step {last} of {self.expected_steps}"


_Check = Callable[[_Evidence], Diagnosis | None]


def diagnose_liggghts(
    process: ProcessResult, log_path: Path, dump_path: Path, expected_steps: int, expected_atoms: int
) -> Diagnosis | None:
    """Say why a LIGGGHTS run is not to be trusted; None if every check passes.

    Parameters
    ----------
    process : ProcessResult
        From `kncal.core.process.run_process`.
    log_path : Path
        The log (screen output or log.liggghts) with the thermo lines, which include "Step" and "Atoms".
    dump_path : Path
        The ``dump custom`` of the run, all frames in one file.
    expected_steps : int
        The last step of the run, which is also its last thermo line.
    expected_atoms : int
        Number of particles in every frame.
    """
    evidence = _Evidence(process, log_path, dump_path, expected_steps, expected_atoms)
    try:
        found = next((diagnosis for check in _CHECKS if (diagnosis := check(evidence)) is not None), None)
    except ReadError as error:  # of the log: the checks of the dump handle their own
        found = Diagnosis(code="empty-output", message=f"LIGGGHTS left no readable log: {error}")
    if found is None:
        return None
    code, message = blame(found.code, found.message, dump_path.parent)
    return Diagnosis(code=code, message=message)


def _not_installed(run: _Evidence) -> Diagnosis | None:
    if run.process.status != "not_installed":
        return None
    command = " ".join(run.process.command) or "liggghts"
    return Diagnosis(
        code="not-installed",
        message=f"the solver could not be started: no such program in `{command}`; "
        "on Debian: apt-get install liggghts (or use the builtin engine)",
    )


def _timed_out(run: _Evidence) -> Diagnosis | None:
    if run.process.status != "timed_out":
        return None
    remedy = "give it more time or a shorter run"
    if run.process.stopped:
        remedy = "it did nothing at the end, since a signal from outside had stopped it (SIGSTOP, or a debugger)"
    return Diagnosis(
        code="timed-out",
        message=f"LIGGGHTS was ended by the time limit after {run.process.wall_seconds:.3g} s, {run.reached()}; "
        f"{remedy}; log: {run.log_path}",
    )


def _interrupted(run: _Evidence) -> Diagnosis | None:
    if run.process.status != "interrupted":
        return None
    how = "killed at once" if run.process.signal == signal.SIGKILL else "interrupted"
    return Diagnosis(code="interrupted", message=f"LIGGGHTS was {how} {run.reached()}; log: {run.log_path}")


def _solver_error(run: _Evidence) -> Diagnosis | None:
    if run.log.errors:
        line = run.log.errors[0]
        if "lost atoms" in line.lower():
            return Diagnosis(
                code="lost-particles",
                message=f"particles left the domain, seen after step {run.log.last_step}; check walls, start overlaps "
                f"and the time step. LIGGGHTS says (its counts mean nothing): {line}; log: {run.log_path}",
            )
        return Diagnosis(code="solver-error", message=f"LIGGGHTS stopped, {run.reached()}: {line}; log: {run.log_path}")
    if run.process.returncode:
        return Diagnosis(
            code="solver-error",
            message=f"LIGGGHTS ended with exit code {run.process.returncode} {run.reached()}, without an ERROR "
            f"line; its last lines: {_tail(run)}; log: {run.log_path}",
        )
    return None


def _killed(run: _Evidence) -> Diagnosis | None:
    number = run.process.signal
    if number is None:
        return None
    why: dict[int, str] = {
        signal.SIGKILL: "by hand, by the batch system, or for want of memory",
        signal.SIGSEGV: "it crashed",
    }
    name = ", ".join(filter(None, (signal_name(number), why.get(number))))
    return Diagnosis(
        code="killed",
        message=f"LIGGGHTS was ended by signal {number} ({name}) {run.reached()}; log: {run.log_path}",
    )


def _no_end_marker(run: _Evidence) -> Diagnosis | None:
    if run.log.finished:
        return None
    if run.log.last_step is None:
        why = "is the deck empty, or does it not end with that print?"
    else:
        why = "was it ended by a signal from elsewhere (scancel, kill)? LIGGGHTS then exits with 0"
    return Diagnosis(
        code="no-end-marker",
        message=f"LIGGGHTS stopped early, {run.reached()}: its log has no line {END_MARKER!r}; {why}; "
        f"last lines: {_tail(run)}; log: {run.log_path}",
    )


def _wrong_last_step(run: _Evidence) -> Diagnosis | None:
    if run.log.last_step == run.expected_steps:
        return None
    return Diagnosis(
        code="wrong-last-step",
        message=f"the last thermo line of the log is {run.reached()}, though LIGGGHTS came to the end of its "
        f"deck; does its `run` line ask for {run.expected_steps} steps? log: {run.log_path}",
    )


def _lost_particles(run: _Evidence) -> Diagnosis | None:
    if run.log.atoms == run.expected_atoms:
        return None
    return Diagnosis(
        code="lost-particles",
        message=f"{run.log.atoms} particles in the last thermo line, expected {run.expected_atoms}; did some "
        f"leave the domain, or were fewer inserted? log: {run.log_path}",
    )


def _dump(run: _Evidence) -> Diagnosis | None:
    try:
        table = run.dump
    except ReadError as error:
        empty = not run.dump_path.is_file() or run.dump_path.stat().st_size == 0
        return Diagnosis(code="empty-output" if empty else "truncated-output", message=str(error))
    if table.empty:
        return Diagnosis(code="empty-output", message=f"{run.dump_path}: no frame holds a particle")
    steps, counts = np.unique(table["step"].to_numpy(), return_counts=True)
    wrong = np.flatnonzero(counts != run.expected_atoms)
    if wrong.size:
        k = int(wrong[0])
        return Diagnosis(
            code="lost-particles",
            message=f"{run.dump_path}: {counts[k]} particles at step {steps[k]}, expected {run.expected_atoms}",
        )
    if (steps[0], steps[-1]) != (0, run.expected_steps):
        return Diagnosis(
            code="truncated-output",
            message=f"{run.dump_path}: frames of step {steps[0]} to {steps[-1]}, expected 0 to {run.expected_steps}; "
            "were the first or the last not written?",
        )
    return _not_finite(run.dump_path, table)


def _not_finite(path: Path, table: pd.DataFrame) -> Diagnosis | None:
    bad = ~np.isfinite(table.to_numpy(dtype=np.float64))
    if not bad.any():
        return None
    row, column = (int(i) for i in np.argwhere(bad)[0])
    first = table.iloc[row]
    which = f" of particle {int(first['id'])}" if "id" in table.columns else ""
    return Diagnosis(
        code="not-finite",
        message=f"{path}: {table.columns[column]} = {first.iloc[column]}{which} at step {int(first['step'])}; do two "
        "particles start at the same point, or is the time step too large?",
    )


_CHECKS: tuple[_Check, ...] = (
    _not_installed,
    _timed_out,
    _interrupted,
    _solver_error,
    _killed,
    _no_end_marker,
    _wrong_last_step,
    _lost_particles,
    _dump,
)


def _tail(run: _Evidence) -> str:
    lines = [line for line in run.process.last_lines if line.strip()][-3:]
    return " | ".join(lines) if lines else "(no output)"
