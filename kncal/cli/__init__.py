"""The command line: ``kncal COMMAND``.

Exit codes: 0 ok, 1 outside a tolerance, 2 bad usage or input, 3 solver failed, 4 solver missing, 130 interrupted.
"""

from __future__ import annotations

import sys

from cyclopts import App, CycloptsError

from kncal import __version__
from kncal.cli import calibrate, cases, runs
from kncal.errors import KncalError, RunError, SolverMissingError

OK, OUTSIDE, USAGE, FAILED, MISSING, INTERRUPTED = 0, 1, 2, 3, 4, 130
#: Error -> exit code, the special before the general.
_CODES = {SolverMissingError: MISSING, RunError: FAILED, KncalError: USAGE}

app = App(
    name="kncal",
    version=__version__,
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
app.command(cases.doctor)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave the process with its exit code."""
    sys.exit(_run(arguments))


def _run(arguments: list[str] | None) -> int:
    try:
        code = app(arguments, exit_on_error=False, print_error=True)
    except CycloptsError:
        return USAGE
    except KncalError as error:
        from kncal.cli.show import printable

        print(f"kncal: {printable(str(error))}", file=sys.stderr)
        return next(code for kind, code in _CODES.items() if isinstance(error, kind))
    except KeyboardInterrupt:
        print("kncal: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return OK
    return code if isinstance(code, int) else OK
