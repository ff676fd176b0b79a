"""``kncal stability``: from which time step on a case is simulated wrong."""

from __future__ import annotations

from typing import Annotated, Literal

from cyclopts import Parameter

from kncal.cli import show
from kncal.cli.flags import CaseFlags, EngineFlags, Json, Transport, Workers


def stability(
    case: str,
    *,
    engine: Annotated[
        Literal["liggghts", "builtin"],
        Parameter(help="liggghts: confirms what the builtin engine finds; builtin: only that engine"),
    ] = "liggghts",
    transport: Transport = "auto",
    quick: Annotated[bool, Parameter(name="--quick", help="fewer probes, coarser maps")] = False,
    workers: Workers = None,
    at: CaseFlags = CaseFlags(),
    json: Json = False,
) -> None:
    """Find the largest stable time step of CASE by bisection, compare it with theory, and map the outcomes.

    Small test scenes have the case's materials and contact, linear and Hertz: from one sphere on a wall to twelve
    spheres around one. With gas also the limits of gas step, coupling interval and cell size, by short runs of a
    smaller bed. Writes stability.json, stability.csv, map.csv and report/. The same command again runs only what is
    missing.

    Parameters
    ----------
    case
        A shipped case's name, a case folder or a case.toml.
    """
    from kncal.study.folders import refuse_other
    from kncal.study.stability.report import accuracy_table, coupling_table, edge_table, write_stability
    from kncal.study.stability.workflow import RECORD, SPEED, STARTED, study_stability

    scene, folder = at.load(case, "stability")
    refuse_other(folder, RECORD, STARTED, case)
    scene = EngineFlags(engine=engine, transport=transport).measured(scene, folder / SPEED)
    with show.working("probes") as now:
        found = study_stability(
            scene, folder, engine=engine, quick=quick, transport=transport, workers=workers, tell=now
        )
        page = write_stability(found, folder)
    if json:
        show.as_json(found.to_dict() | {"report": str(page)})
        return
    for title, table, fold in (
        ("Edges of stability", edge_table(found), False),
        ("Steps for a correct restitution", accuracy_table(found), False),
        ("Edges of the coupled algorithm", coupling_table(found), True),  # its last column is a sentence
    ):
        if table.rows:
            show.table(title, table.headings, table.rows, text=table.text, fold=fold)
    for sentence in (*found.sentences(), *(f"Note: {note}" for note in found.given.notes)):
        show.say(sentence)
    show.say(f"report: {page}")
