"""``kncal render``, ``kncal run``, ``kncal compare``, ``kncal report``: everything that makes or reads a run folder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from kncal.cli import show
from kncal.cli.beds import Resume, Transport, compare_bed, print_bed_results, run_bed
from kncal.errors import InputError

if TYPE_CHECKING:
    from kncal.bed.scene import BedScene
    from kncal.compare import Comparison, RunData
    from kncal.model import Model
    from kncal.scene import Scene

Json = Annotated[bool, Parameter(name="--json", negative="", help="print data for machines")]
EngineName = Annotated[
    Literal["liggghts", "builtin", "liggghts-hooke"],
    Parameter(
        name="--engine",
        help="liggghts; builtin: only Python, few bodies; liggghts-hooke: LIGGGHTS' own strain-energy spring",
    ),
]
Out = Annotated[Path | None, Parameter(name="--out", help="run folder; default runs/<case> here")]
ModelChoice = Annotated[
    Literal["both", "linear", "hertz"], Parameter(name="--model", help="which contact model to use")
]
ParaView = Annotated[bool, Parameter(name="--paraview", negative="", help="also write frames that ParaView opens")]
Timeout = Annotated[float | None, Parameter(name="--timeout", help="wall-clock limit of each run [s]")]


def render(case: str, *, engine: EngineName = "liggghts", model: ModelChoice = "both", out: Out = None) -> None:
    """Write the solver input of CASE: a folder per model that runs by hand with ./Allrun.

    Parameters
    ----------
    case
        A shipped case's name, a case folder or a case.toml.
    """
    from kncal.workflow import get_engine, render_case

    scene, folder = _scene(case, out)
    models = render_case(scene, get_engine(engine), folder, _kinds(model))
    for kind, m in models.items():
        show.say(
            f"{folder / kind}: {m.n_steps} steps of {show.quantity(m.dt, 's')} to t = {show.quantity(m.t_end, 's')}"
        )
    _print_warnings(models)


def run(
    case: str,
    *,
    engine: EngineName = "liggghts",
    model: ModelChoice = "both",
    out: Out = None,
    timeout: Timeout = None,
    paraview: ParaView = False,
    transport: Transport = "auto",
    resume: Resume = False,
    json: Json = False,
) -> None:
    """Render and run CASE, and print what was observed.

    Parameters
    ----------
    case
        A shipped case's name, a case folder or a case.toml.
    """
    from kncal.metrics import metric_unit
    from kncal.workflow import load_run

    bed, folder = _bed(case, out)
    kinds = _kinds(model)
    _refuse_ignored(bed, engine=engine != "liggghts", paraview=paraview, transport=transport != "auto", resume=resume)
    if bed is not None:
        results = run_bed(bed, folder, kinds, transport, timeout, resume=resume)
        print_bed_results(bed, folder, results, json=json)
        return
    scene, folder = _scene(case, out)
    _run(scene, engine, folder, kinds, timeout)
    runs = {kind: load_run(folder / kind) for kind in kinds}
    _export(runs.values(), paraview)
    if json:
        show.as_json(
            {
                kind: {
                    "folder": str(folder / kind),
                    "steps": data.result.steps,
                    "dt": data.result.dt,
                    "cpu_seconds": data.result.cpu_seconds,
                    "metrics": data.observations.metrics,
                }
                for kind, data in runs.items()
            }
        )
        return
    names = list(dict.fromkeys(name for data in runs.values() for name in data.observations.metrics))
    rows = []
    for name in names:
        unit = metric_unit(name)
        values = [data.observations.metrics.get(name) for data in runs.values()]
        rows.append([name, *(show.quantity(value, unit, 6) for value in values)])
    rows.append(["steps", *(str(data.result.steps) for data in runs.values())])
    rows.append(["dt", *(show.quantity(data.result.dt, "s") for data in runs.values())])
    rows.append(["CPU", *(show.quantity(data.result.cpu_seconds, "s", 3) for data in runs.values())])
    show.table(f"{scene.name} by {engine}", ["", *kinds], rows)
    _print_warnings({kind: data.model for kind, data in runs.items()})
    show.say(f"run folder: {folder}")


def compare(
    first: str,
    second: Path | None = None,
    *,
    engine: EngineName = "liggghts",
    out: Out = None,
    timeout: Timeout = None,
    repeat: Annotated[int, Parameter(help="how often each model is run, for the spread of the CPU time")] = 1,
    paraview: ParaView = False,
    transport: Transport = "auto",
    resume: Resume = False,
    json: Json = False,
) -> int:
    """Run CASE with the linear and the Hertz contact and compare; exit code 0 within the tolerances, 1 outside.

    Parameters
    ----------
    first
        A case (shipped name, folder, case.toml); with SECOND, the folder of the linear run.
    second
        The folder of the Hertz run, to compare two runs that exist already.
    """
    from kncal.compare import compare as compare_runs
    from kncal.workflow import complete, load_both, load_pair

    if second is not None:
        linear, hertz = load_pair(Path(first), second)
        comparison = compare_runs(complete(linear), complete(hertz))
        where = None
    else:
        if repeat < 1:
            raise InputError(f"--repeat = {repeat}: expected at least 1")
        bed, folder = _bed(first, out)
        _refuse_ignored(
            bed,
            engine=engine != "liggghts",
            paraview=paraview,
            repeat=repeat > 1,
            transport=transport != "auto",
            resume=resume,
        )
        if bed is not None:
            run_bed(bed, folder, ("linear", "hertz"), transport, timeout, resume=resume)
            return compare_bed(folder, folder / "report", json=json)
        scene, folder = _scene(first, out)
        _run(scene, engine, folder, ("linear", "hertz"), timeout, repeat)
        linear, hertz = load_both(folder)
        _export((linear, hertz), paraview)
        comparison = compare_runs(complete(linear), complete(hertz))
        where = _report(comparison, folder / "report")
    if json:
        show.as_json(comparison.to_dict() | {"report": None if where is None else str(where)})
    else:
        _print_comparison(comparison)
        if where is not None:
            show.say(f"report: {where}")
    return 0 if comparison.within else 1


def report(folder: Path, *, out: Annotated[Path | None, Parameter(name="--out")] = None) -> int:
    """Write the report of a run folder that holds both models.

    Parameters
    ----------
    folder
        The run folder of a case (holds linear/ and hertz/).
    out
        Folder of the report; default FOLDER/report.
    """
    from kncal.compare import compare as compare_runs
    from kncal.workflow import complete, load_both

    if _is_bed(folder):
        compare_bed(folder, out or folder / "report", json=False)
        return 0
    linear, hertz = load_both(folder)
    comparison = compare_runs(complete(linear), complete(hertz))
    show.say(f"report: {_report(comparison, out or folder / 'report')}")
    return 0


def _bed(case: str, out: Path | None) -> tuple[BedScene | None, Path]:
    """Return the bed that ``case`` is (None for a case of single contacts) and its run folder."""
    from kncal.bed.scene import BedScene
    from kncal.case_file import load_case

    scene = load_case(case)
    return scene if isinstance(scene, BedScene) else None, out if out is not None else Path("runs") / scene.name


def _refuse_ignored(bed: BedScene | None, **given: bool) -> None:
    """Refuse a flag that the kind of case at hand would pass over in silence."""
    others = ("transport", "resume") if bed is None else ("engine", "paraview", "repeat")
    for name in others:
        if given.get(name):
            kind = "a case of single contacts" if bed is None else "a bed"
            raise InputError(f"--{name} has no meaning for {kind}: leave it out")


def _is_bed(folder: Path) -> bool:
    from kncal.bed.scene import BedScene
    from kncal.folder import read_model_folder

    model = folder / "linear"
    return (model / "manifest.json").is_file() and isinstance(read_model_folder(model)[0], BedScene)


def _scene(case: str, out: Path | None) -> tuple[Scene, Path]:
    from kncal.case_file import load_scene

    scene = load_scene(case)
    return scene, out if out is not None else Path("runs") / scene.name


def _kinds(model: str) -> tuple[str, ...]:
    return ("linear", "hertz") if model == "both" else (model,)


def _run(
    scene: Scene,
    engine: str,
    folder: Path,
    kinds: tuple[str, ...],
    timeout: float | None,
    repeat: int = 1,
) -> None:
    from kncal.workflow import get_engine, require_completed, run_case

    with show.progress_bars() as progress_for:
        results = run_case(
            scene,
            get_engine(engine),
            folder,
            kinds,
            timeout=timeout,
            progress_for=progress_for,
            repeat=repeat,
        )
    require_completed(results.values())


def _export(runs: Iterable[RunData], paraview: bool) -> None:
    from kncal.export import export_paraview, export_tables

    for data in runs:
        export_tables(data)
        if paraview:
            export_paraview(data)


def _report(comparison: Comparison, folder: Path) -> Path:
    from kncal.workflow import report_on

    return report_on(comparison, folder)


def _print_warnings(models: Mapping[str, Model]) -> None:
    pairs: dict[str, list[str]] = {}
    for model in models.values():
        for pair, contact in model.contacts.items():
            for text in contact.warnings.values():
                pairs.setdefault(text, []).append("–".join(pair))
    for text, names in pairs.items():
        show.say(f"  warning ({', '.join(dict.fromkeys(names))}): {text}")


def _print_comparison(comparison: Comparison) -> None:
    rows = []
    for row in comparison.rows:
        unit = row.unit
        tolerance = "" if row.tolerance is None else f"{100.0 * row.tolerance:g} %"
        values = [show.quantity(value, unit, 5) for value in (row.linear, row.hertz)]
        rows.append([row.metric, *values, show.percent(row.difference), tolerance, row.verdict])
    for name, unit in (("steps", ""), ("dt", "s"), ("cpu_seconds", "s")):
        rows.append([name, *(show.quantity(getattr(c, name), unit) for c in comparison.costs), "", "", ""])
    scene = comparison.hertz.model.scene
    show.table(
        f"{scene.name}: linear against Hertz",
        ["metric", "linear", "hertz", "difference", "tolerance", ""],
        rows,
    )
    for sentence in comparison.sentences:
        show.say(sentence)
