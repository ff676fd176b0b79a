"""``kncal trim``: which parts of the physics a scene does not need."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from kncal.cli import show
from kncal.cli.flags import CaseFlags, EngineFlags, Json, Timeout, Workers, several

if TYPE_CHECKING:
    from kncal.study.runs import OnStudyProgress
    from kncal.study.trim.trim import Trim


def trim(
    case: str,
    *,
    model: Annotated[Literal["linear", "hertz"], Parameter(help="contact model of the full scene")] = "linear",
    parts: Annotated[
        str | None, Parameter(help="only these, e.g. tangential,rolling; the report lists the names of all")
    ] = None,
    tolerance: Annotated[
        list[str] | None,
        several("--tolerance", "METRIC=SHARE that may change, e.g. restitution=1%; default: those of the case"),
    ] = None,
    rounds: Annotated[
        int | None, Parameter(help="how often everything is run, for the spread of CPU times; default 3, with gas 1")
    ] = None,
    workers: Workers = None,
    timeout: Timeout = None,
    at: CaseFlags = CaseFlags(),
    by: EngineFlags = EngineFlags(),
    json: Json = False,
) -> None:
    """Run CASE with and without each optional part of its physics; show cost and effect, and write the trimmed case.

    Parts without an effect, within the tolerances and the uncertainty of the runs, are left out. Then the trimmed scene
    is compared with the full one. Writes trim.json, trim.csv, report/ and case.toml. The same
    command again runs only what is missing.

    Parameters
    ----------
    case
        A shipped case's name, a case folder or a case.toml.
    """
    from kncal.observe.tolerances import parse_tolerances
    from kncal.scene.records import records_of
    from kncal.study.trim.report import write_trim
    from kncal.study.trim.run import TrimOptions
    from kncal.study.trim.run import trim as run_trim

    scene, folder = at.load(case, "trim")
    by.check(scene)
    options = TrimOptions(
        model=model,
        overrides=tuple(at.overrides or ()),
        tolerances=parse_tolerances(tolerance or (), records_of(scene)),
        parts=None if parts is None else tuple(name.strip() for name in parts.split(",")),
        rounds=rounds,
        engine=by.engine,
        transport=by.transport,
        workers=workers,
        timeout=timeout,
    )
    with _told() as progress:
        found = run_trim(case, folder, options, on_progress=progress, tell=show.note)
    page = write_trim(found, folder)
    if json:
        show.as_json(found.to_dict() | {"report": str(page), "trimmed": str(folder / "case.toml")})
        return
    _print(found)
    there, run = (shlex.quote(str(folder / name)) for name in ("case.toml", "trimmed"))
    show.say(f"trimmed case: {there} (kncal run {there} --model {found.trimmed_model} --out {run})")
    show.say(f"report: {page}")


@contextmanager
def _told() -> Iterator[OnStudyProgress]:
    """Show on stderr how far the runs are."""
    from rich.progress import BarColumn, TextColumn

    from kncal.study import SweepProgress

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:.0f}/{task.total:.0f} runs"))
    with show.bars(*columns) as bars:
        task = bars.add_task("checking", total=1, unit="runs")

        def told(number: int, rounds: int, model: str, progress: SweepProgress) -> None:
            text = f"round {number} of {rounds}, {model}"
            bars.update(task, description=text, completed=progress.done, total=progress.total)

        yield told


def _print(found: Trim) -> None:
    from kncal.study.trim.report import part_table
    from kncal.study.trim.trim import DOES_NOT_APPLY

    parts = part_table(found)
    title = f"{found.case}, {found.model}: parts of the physics"
    show.table(title, parts.headings, parts.rows, text=parts.text)
    show.say(found.verdict.sentence)
    for point in found.verdict.points:
        show.say(f"- {point}")
    for result in found.results:
        if result.verdict != DOES_NOT_APPLY:
            show.say(f"  {result.sentence}")
    for text in found.verdict.details:
        show.say(text)
