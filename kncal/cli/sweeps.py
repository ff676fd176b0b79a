"""``kncal sweep``, ``sweep-run``, ``sweep-table``: many runs of one case, here or on a cluster, and their table."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from kncal.cli import show
from kncal.cli.flags import Flags, Json, ModelChoice, RanksFlags, Timeout, Workers, kinds, several
from kncal.core.errors import InputError

if TYPE_CHECKING:
    from kncal.scene.case_text import CaseText
    from kncal.scene.finding import Finding
    from kncal.study import Executor, Sweep, SweepProgress, SweepResult
    from kncal.study.points import Point
    from kncal.study.slurm_script import SlurmOptions

#: Failed runs that are named per class, and characters of their messages.
_SHOWN, _LONGEST = 3, 400

Parquet = Annotated[bool, Parameter(help="also write sweep.parquet (needs kncal[parquet])")]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class PointFlags(Flags):
    """Which values the runs of a sweep have; several of these are combined."""

    overrides: Annotated[
        list[str] | None, several("--set", "KEY=VALUE,VALUE,...: a grid of these values; commas in [] do not count")
    ] = None
    points: Annotated[Path | None, Parameter(help="CSV file: a header of dotted keys, one run per row")] = None
    sample: Annotated[int | None, Parameter(help="number of points of a Latin hypercube over --range")] = None
    ranges: Annotated[list[str] | None, several("--range", "KEY=LOW:HIGH for --sample, e.g. contact.v_0=0.1:1.0")] = (
        None
    )
    log: Annotated[list[str] | None, several("--log", "KEY of a --range that is sampled by its logarithm")] = None
    seed: Annotated[int | None, Parameter(help="for --sample; the same seed gives the same points; default 0")] = None

    def groups(self) -> list[list[Point]]:
        """Return the groups of points to combine."""
        from kncal.scene.overrides import parse_override
        from kncal.study import grid_axis, parse_range, read_points
        from kncal.study import sample as hypercube

        groups = [grid_axis(text) for text in self.overrides or ()]
        if self.points is not None:
            groups.append(read_points(self.points))
        if self.sample is None:
            alone = (("--range", self.ranges), ("--log", self.log), ("--seed", self.seed))
            for name in (name for name, value in alone if value):
                raise InputError(f"{name} has no meaning without --sample N")
            return groups
        found = [parse_range(text, self.log or ()) for text in self.ranges or ()]
        unknown = {parse_override(f"{key}=0").path for key in self.log or ()} - {r.path for r in found}
        if unknown:
            raise InputError(f"--log {'.'.join(unknown.pop())}: no --range of that key")
        if len({r.path for r in found}) < len(found):
            raise InputError("--range: a key is given twice; expected each key once")
        return [*groups, hypercube(found, self.sample, self.seed or 0)]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ClusterFlags(Flags):
    """Where the runs of a sweep are done."""

    workers: Workers = None
    executor: Annotated[
        Literal["local", "dask", "slurm"],
        Parameter(help="dask: Dask workers here, or of --scheduler; slurm: in Slurm jobs (both need kncal[dask])"),
    ] = "local"
    scheduler: Annotated[str | None, Parameter(help="for --executor dask: tcp://HOST:PORT or tls://HOST:PORT")] = None
    queue: Annotated[str | None, Parameter(help="Slurm's partition")] = None
    walltime: Annotated[str | None, Parameter(help="time limit of a Slurm job, e.g. 02:00:00")] = None
    memory: Annotated[str | None, Parameter(help="memory of one run in a Slurm job, e.g. 2G")] = None
    interface: Annotated[
        str | None, Parameter(help="network interface for --executor slurm, e.g. ib0; default: all")
    ] = None
    export_slurm: Annotated[
        Path | None, Parameter(help="run nothing: write a script to FILE, a Slurm job array of the runs that are left")
    ] = None

    def check(self, *, parquet: bool) -> None:
        """Refuse a flag that would be ignored."""
        if self.scheduler is not None and self.executor != "dask":
            raise InputError("--scheduler has no meaning without --executor dask")
        if self.executor != "slurm":
            if self.interface is not None:
                raise InputError("--interface has no meaning without --executor slurm")
            for name in ("queue", "walltime", "memory") if self.export_slurm is None else ():
                if getattr(self, name) is not None:
                    raise InputError(f"--{name} has no meaning without --executor slurm or --export-slurm")
        if self.export_slurm is not None:
            if self.executor != "local":
                raise InputError(f"--export-slurm runs nothing: leave --executor {self.executor} out")
            if parquet:
                raise InputError("--export-slurm runs nothing, so there is no table: see `kncal sweep-table`")

    def options(self) -> SlurmOptions:
        """Return what Slurm is told."""
        from kncal.study.slurm_script import SlurmOptions

        given = {name: getattr(self, name) or "" for name in ("queue", "walltime", "memory", "interface")}
        return SlurmOptions(**given)

    def at_once(self, ranks: RanksFlags) -> int | None:
        """Return how many runs go on at the same time; None: as many as there are workers."""
        from kncal.core.mpi import check_fit

        if ranks.ranks == 1:
            return self.workers
        if self.executor == "slurm" or self.scheduler or self.export_slurm:
            raise InputError(
                "--ranks: a run on another machine or in a Slurm job has one core; expected --executor local"
            )
        return check_fit(self.workers, ranks.ranks, oversubscribe=ranks.oversubscribe)

    def runner(self, workers: int | None) -> Executor:
        """Return what does the runs."""
        if self.executor == "local":
            from kncal.study import ThreadExecutor

            return ThreadExecutor(workers)
        from kncal.study.dask_executor import dask_executor

        return dask_executor(self.executor, workers, scheduler=self.scheduler, options=self.options())


def sweep(
    case: str,
    *,
    over: PointFlags = PointFlags(),
    model: ModelChoice = "both",
    by: RanksFlags = RanksFlags(),
    timeout: Timeout = None,
    on: ClusterFlags = ClusterFlags(),
    out: Annotated[Path | None, Parameter(help="folder of the sweep; default runs/<case>_sweep here")] = None,
    skip_bad: Annotated[bool, Parameter(help="skip points that cannot run, instead of refusing all")] = (False),
    parquet: Parquet = False,
    json: Json = False,
) -> int:
    """Run CASE with every combination of the given values; one run folder each, one table of all.

    The same command again runs only what has no valid result yet. Exit code 0: all completed, 3: some failed.

    Parameters
    ----------
    case
        A shipped case's name, a case folder or a case.toml.
    """
    from kncal.scene.case_file import load_case
    from kncal.study import Settings, combine, design, read_sweep, run_sweep
    from kncal.study.table import check_parquet, write_parquet

    if parquet:
        check_parquet()
    groups, scene = over.groups(), load_case(case)
    by.check(scene)
    settings = Settings(
        engine=by.engine,
        models=kinds(model),
        transport=by.transport,
        timeout=timeout,
        ranks=by.ranks,
        oversubscribe=by.oversubscribe and by.ranks > 1,
    )
    workers = on.at_once(by)
    on.check(parquet=parquet)
    runner = on.runner(workers)
    folder = out or Path("runs") / f"{scene.name}_sweep"
    combined = combine(groups)
    warnings: dict[str, dict[str, str]] = {}

    def warn(run: str, found: tuple[Finding, ...]) -> None:
        for finding in found:
            warnings.setdefault(finding.code, {})[run] = finding.message

    with _bar() as told:
        made, text = design(case, combined, settings, skip_bad=skip_bad, progress=told.checking, warn=warn)
        if on.export_slurm is None:
            result = run_sweep(made, text, folder, runner, told.running)
    if on.export_slurm is not None:
        _tell_warnings(warnings, made)
        return _export(made, text, folder, on.export_slurm, on.options(), workers, json)
    if parquet:
        write_parquet(folder, read_sweep(folder))
    if json:
        summary = _summary(result, len(combined), [r.model_dump() for r in made.refused])
        show.as_json(summary | {"warnings": warnings})
    else:
        _print(result, len(combined), [", ".join(r.values) + ": " + r.message for r in made.refused])
        _tell_warnings(warnings, made)
    return 0 if result.completed == result.total and not made.refused else 3


def _tell_warnings(warnings: Mapping[str, Mapping[str, str]], made: Sweep) -> None:
    """Print each kind of warning once: of how many runs, and its text for the first."""
    for code, runs in warnings.items():
        run, message = next(iter(runs.items()))
        values = ", ".join(made.runs[run]) or "the case"
        show.note(f"warning ({code}), {len(runs)} of {len(made.runs)} runs, e.g. {values}: {message}")


def sweep_run(folder: Path, run: str, *, json: Json = False) -> int:
    """Do one RUN of the sweep in FOLDER, unless it is completed. The jobs of --export-slurm call this.

    Exit code 0: completed, 3: failed, 4: the solver is missing, 130: interrupted.

    Parameters
    ----------
    folder
        Of the sweep.
    run
        Id of the run, as in sweep.csv.
    """
    from kncal.study import execute_run, read_design

    if run not in read_design(folder).runs:
        raise InputError(f"{folder}: no run {run[:100]!r}; the ids are in sweep.json and sweep.csv")
    record = execute_run(folder, run)
    if json:
        show.as_json({key: record[key] for key in ("id", "status", "class", "message")})
    else:
        show.say(f"{run}: {record['status'].replace('_', ' ')}" + (f": {record['message']}" * bool(record["class"])))
    return {"completed": 0, "not_installed": 4, "interrupted": 130}.get(record["status"], 3)


def sweep_table(folder: Path, *, parquet: Parquet = False, json: Json = False) -> int:
    """Write the table of the sweep in FOLDER again from its run folders, and count the runs; runs nothing.

    Exit code 0: all runs are completed, 3: some are not.

    Parameters
    ----------
    folder
        Of the sweep.
    """
    from kncal.study import read_sweep
    from kncal.study.table import check_parquet, write_parquet, write_table

    if parquet:
        check_parquet()
    table = read_sweep(folder)
    path = write_table(folder, table)
    if parquet:
        write_parquet(folder, table)
    completed = table.assign(yes=table["status"] == "completed").groupby("id")["yes"].all()
    counts = {str(name): int(number) for name, number in table["status"].value_counts().items()}
    if json:
        show.as_json(
            {"folder": str(folder), "table": str(path), "runs": len(completed), "completed": int(completed.sum())}
            | {"models": counts}
        )
    else:
        show.say(f"{completed.sum()} of {len(completed)} runs completed")
        show.say("models: " + ", ".join(f"{number} {name.replace('_', ' ')}" for name, number in counts.items()))
        show.say(f"table: {path}")
    return 0 if completed.all() else 3


def _export(
    made: Sweep, text: CaseText, folder: Path, file: Path, options: SlurmOptions, workers: int | None, json: bool
) -> int:
    """Write the job-array script of the runs that are left."""
    from kncal.study.slurm_script import array_script, write_script
    from kncal.study.sweep import prepare_sweep

    left = prepare_sweep(made, text, folder)
    if left:
        write_script(file, array_script(folder, made.name, left, options, at_once=workers))
    if json:
        script = str(file) if left else None
        show.as_json({"folder": str(folder), "script": script, "runs": len(made.runs), "left": len(left)})
    elif left:
        show.say(f"{len(left)} of {len(made.runs)} runs are left; submit them: sbatch {shlex.quote(str(file))}")
        show.say(f"afterwards: kncal sweep-table {shlex.quote(str(folder))}")
    else:
        show.say(f"all {len(made.runs)} runs are completed: no script was written")
    return 0 if not made.refused else 3


class _Told:
    """Shows the progress of a sweep."""

    def __init__(self, update: Callable[[str, int, int, str], None]) -> None:
        self._update = update

    def checking(self, done: int, total: int) -> None:
        self._update("checking", done, total, f"{done} of {total} points")

    def running(self, p: SweepProgress) -> None:
        left = "" if p.left is None else f", {_time(p.left)} left"
        kept = f" ({p.kept} earlier)" if p.kept else ""
        text = f"{p.done} of {p.total}: {p.completed} completed{kept}, {p.failed} failed, {p.running} running{left}"
        self._update("sweep", p.done, p.total, text)


def _time(seconds: float) -> str:
    minutes, s = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{s:02d}"


@contextmanager
def _bar() -> Iterator[_Told]:
    from rich.progress import BarColumn, TextColumn

    with show.bars(TextColumn("{task.description:>8}"), BarColumn(), TextColumn("{task.fields[text]}")) as bars:
        task = bars.add_task("checking", total=None, text="")

        def update(what: str, done: int, total: int, text: str) -> None:
            bars.update(task, description=what, completed=done, total=total, text=text)

        yield _Told(update)


def _summary(result: SweepResult, points: int, refused: list[dict[str, object]]) -> dict[str, object]:
    return {
        "folder": str(result.folder),
        "table": str(result.table),
        "points": points,
        "runs": result.total,
        "completed": result.completed,
        "kept": result.kept,
        "failed": sum(map(len, result.failures.values())),
        "failures": {name: list(ids) for name, ids in result.failures.items()},
        "messages": dict(result.messages),
        "refused": refused,
    }


def _print(result: SweepResult, points: int, refused: list[str]) -> None:
    kept = f", {result.kept} of them earlier" if result.kept else ""
    show.say(f"{result.completed} of {result.total} runs completed{kept}")
    if points > result.total + len(refused):
        show.say(f"  ({points} points; some of them give the same run)")
    for name, ids in result.failures.items():
        show.say(f"{len(ids)} failed: {name}")
        for run in ids[:_SHOWN]:
            message = " ".join(result.messages[run].split())
            show.say(f"  {run}: {message[:_LONGEST]}{' ...' if len(message) > _LONGEST else ''}")
        if len(ids) > _SHOWN:
            show.say(f"  and {len(ids) - _SHOWN} more")
    for text in refused:
        show.say(f"skipped: {text}")
    show.say(f"table: {result.table}")
