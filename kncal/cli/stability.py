"""``kncal stability``: where a case stops to be simulated right."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from kncal.cli import show
from kncal.cli.beds import Transport
from kncal.cli.runs import Json, Set, measured


def stability(
    case: str,
    *,
    engine: Annotated[
        Literal["liggghts", "builtin"],
        Parameter(help="liggghts: confirms what the builtin engine finds; builtin: that one alone"),
    ] = "liggghts",
    quick: Annotated[bool, Parameter(name="--quick", negative="", help="fewer probes, coarser maps")] = False,
    transport: Transport = "auto",
    workers: Annotated[int | None, Parameter(help="LIGGGHTS runs at a time; default: one per core")] = None,
    out: Annotated[Path | None, Parameter(name="--out", help="folder; default runs/<case>_stability here")] = None,
    overrides: Set = None,
    json: Json = False,
) -> None:
    """Find the edge of stability of CASE: by bisection in the time step, compared with theory, and maps of outcomes.

    Probes made from the case's materials and contact: one sphere on a wall to twelve around one, linear and Hertz. Of a
    bed also the edges in gas step, coupling interval and cell size, by short runs of a reduced bed. Writes
    stability.json, stability.csv, map.csv and report/. The same command again runs only what is missing.

    Parameters
    ----------
    case
        A shipped case's name, a case folder or a case.toml.
    """
    from kncal.scene.case_file import load_case
    from kncal.study.folders import refuse_other
    from kncal.study.stability.report import accuracy_table, bed_table, edge_table, write_stability
    from kncal.study.stability.workflow import RECORD, SPEED, STARTED, study_stability

    scene = load_case(case, overrides=overrides or ())
    folder = out if out is not None else Path("runs") / f"{scene.name}_stability"
    refuse_other(folder, RECORD, STARTED, case)
    scene = measured(scene, folder / SPEED, engine=engine, transport=transport)
    with show.working("probes") as now:
        found = study_stability(
            scene, folder, engine=engine, quick=quick, transport=transport, workers=workers, tell=now
        )
        page = write_stability(found, folder)
    if json:
        show.as_json(found.to_dict() | {"report": str(page)})
        return
    for title, table, text in (
        ("Edges of stability", edge_table(found), (0, 1, 5, 8, 10)),
        ("Steps that a right restitution needs", accuracy_table(found), (0, 6)),
        ("Edges of the coupled algorithm", bed_table(found), (0, 3, 4, 5)),
    ):
        if table.rows:
            show.table(title, table.headings, table.rows, text=text)
    for sentence in (*found.sentences(), *(f"Note: {note}" for note in found.given.notes)):
        show.say(sentence)
    show.say(f"report: {page}")
