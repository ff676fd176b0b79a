"""A plain Slurm job-array script for a sweep: one array index per run, for sites that allow nothing else.

The script is text for a person to read and to change. Of what a user names only checked words and shell-quoted
paths get into it.
"""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kncal import __version__
from kncal.core.errors import InputError, ReadError
from kncal.core.files import open_limited, write_text

#: Folder of a sweep that holds what Slurm's jobs print.
LOGS = "slurm"
#: First lines of every script; only a file that begins like this is replaced.
_MARK = "#!/bin/bash\n# Runs of a kncal sweep"
_MOST_BYTES = 64 * 1024**2
#: Slurm's own default of MaxArraySize, less one: larger arrays are refused by most sites.
ARRAY = 1000
#: A run gets SIGTERM so long before its time is over [s], to end its solver in order and leave its state.
_NOTICE = 60

_WORD = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.,+-]{0,99}")
_WALLTIME = re.compile(r"\d{1,4}|\d{1,6}:\d\d(:\d\d)?|\d{1,4}-\d{1,2}(:\d\d){0,2}")
_MEMORY = re.compile(r"(\d{1,6})([KMGT])B?")


@dataclass(frozen=True, kw_only=True)
class SlurmOptions:
    """What a job asks of Slurm; "" leaves it to the site's defaults.

    Attributes
    ----------
    queue : partition, or several ("short,long")
    walltime : as sbatch writes it: minutes, hours:minutes:seconds, days-hours ...
    memory : of one run, a whole number and K, M, G or T (of 1024)
    interface : network interface that Dask's scheduler and workers talk through, e.g. "ib0"; not for job arrays
    """

    queue: str = ""
    walltime: str = ""
    memory: str = ""
    interface: str = ""

    def __post_init__(self) -> None:
        for name, pattern, example in (
            ("queue", _WORD, "the name of a partition, such as short"),
            ("walltime", _WALLTIME, "minutes, or [days-]hours:minutes:seconds such as 02:00:00"),
            ("memory", _MEMORY, "a whole number with K, M, G or T, such as 2G"),
            ("interface", _WORD, "the name of a network interface, such as ib0"),
        ):
            value = getattr(self, name)
            if value and not pattern.fullmatch(value):
                raise InputError(f"{name} = {value[:100]!r}: expected {example}")


def array_script(
    folder: Path, name: str, runs: Sequence[str], options: SlurmOptions, *, at_once: int | None = None
) -> str:
    """Return the text of an sbatch script that does ``runs`` of the sweep in ``folder``.

    Parameters
    ----------
    folder : Path
        Of the sweep; compute nodes must see it under the same (absolute) name.
    name : str
        Of the case: part of the name of the jobs.
    runs : sequence of str
        Ids, at least one.
    options : SlurmOptions
    at_once : int, optional
        Largest number of runs at a time.

    Raises
    ------
    InputError
        If there are no runs, or the folder's path has control characters, which no script should hold.
    """
    place = str(folder.absolute())
    if not runs or any(not re.fullmatch("[0-9a-f]{12}", run) for run in runs):
        raise InputError("runs: expected at least one id, twelve hexadecimal digits each")
    for path in (place, sys.executable):
        if not path.isprintable():
            raise InputError(f"{path!r}: the path has control characters; choose another folder for the sweep")
    first = min(len(runs), ARRAY) - 1
    asked = "".join(
        f"#SBATCH --{key}={value}\n"
        for key, value in (("partition", options.queue), ("time", options.walltime), ("mem", _memory(options)))
        if value
    )
    lines = "\n".join(" ".join(runs[i : i + 8]) for i in range(0, len(runs), 8))
    more = "" if len(runs) <= ARRAY else _MORE.format(count=len(runs), array=ARRAY, last=ARRAY - 1)
    return _SCRIPT.format(
        mark=_MARK,
        version=__version__,
        job="kncal-" + (re.sub(r"[^A-Za-z0-9_.-]", "_", name)[:40] or "sweep"),
        limit=f"0-{first}" + (f"%{at_once}" if at_once else ""),
        asked=asked,
        notice=_NOTICE,
        more=more,
        folder=shlex.quote(place),
        python=shlex.quote(sys.executable),
        logs=LOGS,
        runs=lines,
        table=_comment(f"{shlex.quote(sys.executable)} -P -m kncal sweep-table {shlex.quote(place)}"),
    )


def write_script(path: Path, text: str) -> None:
    """Write the script (whole or not at all).

    Raises
    ------
    InputError
        If ``path`` is another file than an earlier script, or its folder does not exist.
    """
    if path.is_symlink() or path.exists():
        try:
            with open_limited(path, _MOST_BYTES, "a script") as file:
                ours = not path.is_symlink() and file.read(len(_MARK.encode())) == _MARK.encode()
        except (OSError, ReadError):
            ours = False
        if not ours:
            raise InputError(f"{path}: exists and is no script of an earlier --export-slurm; choose another name")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}")
    write_text(path, text)


def _memory(options: SlurmOptions) -> str:
    return options.memory.removesuffix("B")


def _comment(text: str) -> str:
    """Return text that stays one line of a comment (paths are printable, see `array_script`)."""
    return "#   " + text


_MORE = """\
#
# There are {count} runs, and Slurm takes arrays of {array} by default (scontrol show config: MaxArraySize).
# Submit parts:
#   OFFSET=0 sbatch --array=0-{last} THIS_FILE; OFFSET={array} sbatch --array=0-{last} THIS_FILE; and so on
"""

_SCRIPT = """\
{mark} (kncal {version}): one array index per run, each on one core.
#
#   sbatch THIS_FILE
#
# may be submitted again and again: a run that is completed is not run again. The state of a job says little; what
# counts is the result in the run's folder. Afterwards, for the table:
{table}
{more}#SBATCH --job-name={job}
#SBATCH --array={limit}
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=1
{asked}# A minute before its time is over a run is told to end its solver in order:
#SBATCH --signal=B:TERM@{notice}
# What a run prints goes to {logs}/ID.log in the sweep's folder (below).
#SBATCH --output=/dev/null

folder={folder}
python={python}
runs=(
{runs}
)

run=${{runs[SLURM_ARRAY_TASK_ID + ${{OFFSET:-0}}]}}
if [ -z "$run" ]; then exit 0; fi  # the array is longer than the list

mkdir -p -- "$folder/{logs}" || exit 3
exec >>"$folder/{logs}/$run.log" 2>&1
# exec: Slurm's signals reach kncal itself
exec "$python" -P -m kncal sweep-run "$folder" "$run"
"""
