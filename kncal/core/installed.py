"""Whether a program is installed and which version it is, asked in a child process with a time limit: it may hang."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from kncal.core.awake import run_within
from kncal.core.process import solver_environment
from kncal.core.scratch import scratch

#: Seconds that a solver may take to say its version; it takes about one.
SOLVER_LIMIT = 8.0


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing looked for on this machine.

    Attributes
    ----------
    name : what was looked for
    found : version and place, or what is wrong
    needed_for : what does not work without it
    hint : how to mend it, empty if it is there and fit for use
    program, version : of a program that says which one it is, fit or not
    """

    name: str
    found: str
    needed_for: str
    hint: str = ""
    program: Path | None = None
    version: str = ""

    @property
    def ok(self) -> bool:
        """Whether it is there and fit for use."""
        return not self.hint


def ask_version(
    program: str,
    arguments: list[str],
    pattern: str,
    *,
    wanted: str | None,
    title: str,
    needed_for: str,
    package: str,
) -> Finding:
    """Start ``program`` and find its version by ``pattern`` (group 1; group 2, if any, is the build)."""
    path = shutil.which(program)
    about = Finding(name=title, found="", needed_for=needed_for)
    if path is None:
        return replace(about, found=f"no {program} on PATH", hint=f"apt-get install {package}")
    failure, text = ask([path, *arguments], SOLVER_LIMIT, solver_environment())
    match = re.search(pattern, text)
    if match is None or failure:
        found = f"{path} {failure or 'does not say its version'}: {last_line(text)}"
        hint = f"start {path} by hand; if it is broken: apt-get install {package} --reinstall"
        return replace(about, found=found, hint=hint)
    version, *build = (group for group in match.groups() if group)
    wrong = wanted is not None and version != wanted
    hint = f"kncal is written for version {wanted}, that of Debian 12: apt-get install {package}" if wrong else ""
    found = f"{' '.join([version, *build])} ({path})"
    return replace(about, found=found, hint=hint, program=Path(path), version=version)


#: What has been found: (what looks, program, its settings) -> what there is.
_FOUND: dict[tuple[Callable[[], Finding], str | None, str | None], Finding] = {}


def found_once(look: Callable[[], Finding], program: str) -> Finding:
    """Return what ``look`` finds of a program; where that says its version, it is asked once as long as kncal runs."""
    key = (look, shutil.which(program), os.environ.get("WM_PROJECT_DIR"))
    if (known := _FOUND.get(key)) is None:
        known = look()
        if known.version:
            _FOUND[key] = known
    return known


def ask(command: list[str], limit: float, environment: Mapping[str, str]) -> tuple[str, str]:
    """Run ``command`` with nothing to read; return how it failed (empty if it did not) and all it printed."""
    try:
        # Solvers that start side by side must not share Open MPI's folder: the first to end removes it.
        with scratch() as session:
            own = {**environment, "OMPI_MCA_orte_tmpdir_base": str(session)}
            done = run_within(limit, command, env=own, stderr=subprocess.STDOUT)
    except OSError as error:
        return "cannot be started", str(error)
    except subprocess.TimeoutExpired as late:
        return f"gave no answer within {limit:g} s", (late.output or b"").decode(errors="replace")
    text, code = done.stdout.decode(errors="replace"), done.returncode
    if code < 0:
        return f"was ended by signal {-code} ({signal.strsignal(-code)})", text
    return (f"ended with code {code}" if code else ""), text


def last_line(text: str) -> str:
    """Return the last line of a program's output that holds anything, without control characters."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return "".join(c for c in lines[-1] if c.isprintable()) if lines else "it printed nothing"
