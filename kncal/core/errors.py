"""Every error kncal raises on purpose. Each is a `KncalError`; most are also the fitting built-in."""

from __future__ import annotations

from kncal.core.disk import FULL


class KncalError(Exception):
    """Base of every error that kncal raises on purpose; its text is meant for the user."""


class InputError(KncalError, ValueError):
    """A value given by the caller is out of range, not finite, or of the wrong kind."""


class ValidityError(KncalError, ValueError):
    """The inputs are possible, but the contact theory has no meaning for them (overlap beyond the radius ...)."""


class CaseFileError(KncalError, ValueError):
    """A case file is not readable or not valid; the text names the file, the key and the line."""


class RenderError(KncalError, ValueError):
    """A scene cannot be written as input of the chosen solver."""


class ReadError(KncalError, ValueError):
    """A file written by a solver is truncated, empty or malformed; the text names the file and the line."""


class RunError(KncalError, RuntimeError):
    """A solver run did not end as it should; ``failure`` says of what kind (`kncal.record.outcome.FAILURES`)."""

    def __init__(self, text: str, failure: str = "solver-error") -> None:
        super().__init__(text)
        self.failure = failure


class InterruptedRunError(RunError):
    """A run was stopped from outside: Ctrl-C, SIGTERM or SIGHUP."""


class SolverMissingError(RunError):
    """The solver's program is not installed or cannot be started."""


def failure_of(error: BaseException) -> str:
    """Return what kind of failure an error is, one of `kncal.record.outcome.FAILURES`."""
    cause: BaseException | None = error
    while cause is not None:  # an error that was put into words keeps the one that it is about
        if isinstance(cause, OSError) and cause.errno in FULL:
            return "disk-full"
        cause = cause.__cause__
    if isinstance(error, RunError):
        return error.failure
    if isinstance(error, OSError):
        return "solver-error"
    if isinstance(error, ReadError):
        return "truncated-output"
    return "bad-input" if isinstance(error, KncalError) else "solver-error"
