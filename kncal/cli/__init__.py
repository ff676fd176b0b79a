"""The command line: ``kncal COMMAND``.

Exit codes: 0 ok, 1 outside a tolerance (and for nothing else), 2 bad usage or input (also a run folder in use), 3 a run
failed (also disk full, or not writable), 4 solver missing, 130 interrupted (Ctrl-C, SIGTERM, SIGHUP).
"""

from __future__ import annotations

import contextlib
import contextvars
import errno
import sys

from cyclopts import App, CycloptsError

from kncal import __version__
from kncal.cli import beds, calibrate, cases, runs, show, stability, sweeps, trade, trim, upkeep
from kncal.errors import InterruptedRunError, KncalError, RunError, SolverMissingError

OK, OUTSIDE, USAGE, FAILED, MISSING, INTERRUPTED = 0, 1, 2, 3, 4, 130
#: Error -> exit code, the special before the general.
_CODES = {SolverMissingError: MISSING, InterruptedRunError: INTERRUPTED, RunError: FAILED, KncalError: USAGE}
#: Errors of the system that are no fault of the arguments.
_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO)

app = App(
    name="kncal",
    suppress_keyboard_interrupt=False,
    version=__version__,
    help_format="plaintext",  # Markdown would swallow <case>
    help="How stiff must my linear spring be, what does the softer spring buy, and what does it cost?\n\n"
    "Calibrate a linear spring–dashpot contact against a Hertz-type one, run both, compare. SI units throughout.",
)
app.command(calibrate.kn)
app.command(calibrate.collide)
app.command(calibrate.laws)
app.command(cases.cases)
app.command(cases.new)
app.command(cases.needs)
app.command(runs.render)
app.command(runs.run)
app.command(runs.compare)
app.command(runs.report)
app.command(upkeep.status)
app.command(upkeep.clean)
app.command(cases.doctor)
app.command(beds.adapter)
app.command(sweeps.sweep)
app.command(sweeps.sweep_run)
app.command(sweeps.sweep_table)
app.command(trade.trade)
app.command(stability.stability)
app.command(trim.trim)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave the process with its exit code."""
    with show.stop_signals(), show.steady_streams():
        code = _run(sys.argv[1:] if arguments is None else arguments)
    sys.exit(code)


def _run(arguments: list[str]) -> int:
    # Path("") would be the current folder
    if any(text == "" or (text.startswith("--") and text.endswith("=")) for text in arguments):
        return _complain("an argument is empty: expected a value", USAGE)
    try:
        # templates that these arguments trust are trusted no longer than they are worked on
        code = contextvars.copy_context().run(app, arguments, exit_on_error=False, print_error=True)
        if sys.stdout is not None:
            sys.stdout.flush()
    except CycloptsError:
        return USAGE
    except (KncalError, KeyboardInterrupt, MemoryError, OSError, UnicodeError) as error:
        return _complain(*_explain(error))
    return code if isinstance(code, int) else OK


def _explain(error: BaseException) -> tuple[str, int]:
    """Text and exit code of an error that may happen."""
    if isinstance(error, KncalError):
        return str(error), next(code for kind, code in _CODES.items() if isinstance(error, kind))
    if isinstance(error, OSError):
        text = f"{error.filename or 'output'}: {error.strerror or error}"
        return text, FAILED if error.errno in _DISK else USAGE
    if isinstance(error, UnicodeError):
        return f"a name or text that cannot be written: {error}", USAGE
    return ("out of memory", FAILED) if isinstance(error, MemoryError) else ("interrupted", INTERRUPTED)


def _complain(text: str, code: int) -> int:
    with contextlib.suppress(OSError):
        print(f"kncal: {show.printable(text)}", file=sys.stderr)
    return code
