"""The command line: ``kncal COMMAND``.

Exit codes: 0 ok, 1 outside a tolerance (and for nothing else), 2 bad usage or input (also a run folder in use), 3 a run
failed (also disk full, or not writable), 4 solver missing, 5 an error in kncal itself (its traceback is in a file), 130
interrupted (Ctrl-C, SIGTERM, SIGHUP). A command with --json that fails prints an object with ``error``, ``kind`` and
``exit_code``.
"""

from __future__ import annotations

import contextvars
import sys

from cyclopts import App, Parameter

from kncal import __version__
from kncal.cli import adapter, calibrate, cases, failures, runs, show, stability, sweeps, trade, trim, upkeep
from kncal.core.errors import InputError

app = App(
    name="kncal",
    suppress_keyboard_interrupt=False,
    version=__version__,
    default_parameter=Parameter(negative=""),  # no --no-json, no --empty-set
    help_format="plaintext",  # Markdown would swallow <case>
    help="How stiff must my linear spring be, what does the softer spring buy, and what does it cost?\n\n"
    "Calibrate a linear spring–dashpot contact against a Hertz-type one, run both, compare. SI units throughout.",
)
app.command(calibrate.kn)
app.command(calibrate.collide)
app.command(cases.laws)
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
app.command(adapter.adapter)
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
    context = contextvars.copy_context()
    try:
        # Path("") would be the current folder
        if any(text == "" or (text.startswith("--") and text.endswith("=")) for text in arguments):
            raise InputError("an argument is empty: expected a value")
        # templates that these arguments trust are trusted no longer than they are worked on
        code = context.run(app, arguments, exit_on_error=False, print_error=True, result_action="return_value")
        sys.stdout.flush()
    except (Exception, KeyboardInterrupt) as error:  # no exception of Python may reach a user as a traceback
        return context.run(failures.end, error, json="--json" in arguments)
    return code if isinstance(code, int) else failures.OK
