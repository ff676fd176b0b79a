"""``kncal render``, ``kncal run``, ``kncal compare``, ``kncal report``: everything that makes or reads a run folder."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

from cyclopts import Parameter

from kncal.cli import show
from kncal.cli.beds import Transport, compare_bed, export_beds, print_bed_results, render_bed, run_bed
from kncal.core.errors import InputError

if TYPE_CHECKING:
    from kncal.engines.base import Engine
    from kncal.observe.compare import Comparison, RunData
    from kncal.scene.bed_scene import BedScene
    from kncal.scene.model import Model
    from kncal.scene.scene import Scene

_S = TypeVar("_S", bound="Scene | BedScene")

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
Set = Annotated[
    list[str] | None,
    Parameter(
        name="--set",
        negative="",
        help="KEY=VALUE in place of what the case file says, e.g. run.end_time=0.2 (may be repeated)",
    ),
]
Trust = Annotated[
    Path | None,
    Parameter(
        name="--trust-templates",
        help="folder of templates in the place of kncal's of the same name; the solvers obey what is in them",
    ),
]
Anew = Annotated[
    bool, Parameter(name="--anew", negative="", help="run again what is complete, or could be gone on with")
]
Timeout = Annotated[float | None, Parameter(name="--timeout", help="wall-clock limit of each run [s]")]
Ranks = Annotated[int, Parameter(name=("--ranks", "-n"), help="processes that share one run (MPI); beds: the gas only")]
Oversubscribe = Annotated[
    bool, Parameter(name="--oversubscribe", negative="", help="allow more ranks than there are cores")
]


def render(
    case: str,
    *,
    engine: EngineName = "liggghts",
    model: ModelChoice = "both",
    out: Out = None,
    overrides: Set = None,
    ranks: Ranks = 1,
    oversubscribe: Oversubscribe = False,
    trust_templates: Trust = None,
) -> None:
    """Write the solver input of CASE: a folder per model that runs by hand with ./Allrun.

    Of a bed, the particles' deck and the gas case each run by hand; the exchange between them needs kncal.

    Parameters
    ----------
    case
        A shipped case's name, a case folder or a case.toml.
    """
    from kncal.runs.workflow import get_engine, render_case
    from kncal.scene.bed_scene import BedScene

    scene, folder = _load(case, out, overrides, trust_templates)
    if isinstance(scene, BedScene):
        _refuse_ignored(scene, engine=engine != "liggghts")
        scene = measured(scene, folder)
        render_bed(scene, folder, _kinds(model), ranks, oversubscribe=oversubscribe)
        return
    solver = get_engine(engine, ranks=ranks, oversubscribe=oversubscribe)
    scene = measured(scene, folder, engine=engine)
    models = render_case(scene, solver, folder, _kinds(model), tell=show.note)
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
    anew: Anew = False,
    overrides: Set = None,
    ranks: Ranks = 1,
    oversubscribe: Oversubscribe = False,
    trust_templates: Trust = None,
    json: Json = False,
) -> None:
    """Render and run CASE, and print what was observed.

    Parameters
    ----------
    case
        A shipped case's name, a case folder or a case.toml.
    """
    from kncal.runs.workflow import get_engine, load_run
    from kncal.scene.bed_scene import BedScene
    from kncal.scene.limits import no_contact
    from kncal.scene.metrics import metric_unit

    scene, folder = _load(case, out, overrides, trust_templates)
    kinds = _kinds(model)
    _refuse_ignored(scene, engine=engine != "liggghts", transport=transport != "auto")
    scene = measured(scene, folder, engine=engine, transport=transport, timeout=timeout)
    if isinstance(scene, BedScene):
        results = run_bed(scene, folder, kinds, transport, timeout, anew=anew, ranks=ranks, oversubscribe=oversubscribe)
        export_beds(folder, results, paraview=paraview)
        print_bed_results(scene, folder, results, json=json)
        return
    _run(scene, get_engine(engine, ranks=ranks, oversubscribe=oversubscribe), folder, kinds, timeout, anew=anew)
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
    for kind, data in runs.items():
        if not data.observations.contacts:
            show.say(f"  {kind}: {no_contact(data.model)}")
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
    anew: Anew = False,
    overrides: Set = None,
    ranks: Ranks = 1,
    oversubscribe: Oversubscribe = False,
    trust_templates: Trust = None,
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
    from kncal.observe.compare import compare as compare_runs
    from kncal.runs.workflow import complete, get_engine, load_both, load_pair
    from kncal.scene.bed_scene import BedScene

    if second is not None:
        if overrides:
            raise InputError("--set has no meaning for two runs that exist already: leave it out")
        if trust_templates:
            raise InputError("--trust-templates has no meaning for two runs that exist already: leave it out")
        if ranks != 1:
            raise InputError("--ranks has no meaning for two runs that exist already: leave it out")
        linear, hertz = load_pair(Path(first), second)
        comparison = compare_runs(complete(linear), complete(hertz))
        where = None
    else:
        if repeat < 1:
            raise InputError(f"--repeat = {repeat}: expected at least 1")
        scene, folder = _load(first, out, overrides, trust_templates)
        _refuse_ignored(
            scene,
            engine=engine != "liggghts",
            repeat=repeat > 1,
            transport=transport != "auto",
        )
        scene = measured(scene, folder, engine=engine, transport=transport, timeout=timeout)
        if isinstance(scene, BedScene):
            results = run_bed(
                scene,
                folder,
                ("linear", "hertz"),
                transport,
                timeout,
                anew=anew,
                ranks=ranks,
                oversubscribe=oversubscribe,
            )
            export_beds(folder, results, paraview=paraview)
            return compare_bed(folder, folder / "report", json=json)
        solver = get_engine(engine, ranks=ranks, oversubscribe=oversubscribe)
        _run(scene, solver, folder, ("linear", "hertz"), timeout, repeat, anew=anew)
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
    from kncal.observe.compare import compare as compare_runs
    from kncal.runs.states import command_of
    from kncal.runs.workflow import complete, load_both

    if command := command_of(folder):
        raise InputError(
            f"{folder}: that of {command}, not the run folder of one case; the same {command} again writes what it "
            "reports there anew, and runs nothing that is done"
        )
    if _is_bed(folder):
        compare_bed(folder, out or folder / "report", json=False)
        return 0
    linear, hertz = load_both(folder)
    comparison = compare_runs(complete(linear), complete(hertz))
    show.say(f"report: {_report(comparison, out or folder / 'report')}")
    return 0


def _load(
    case: str, out: Path | None, overrides: list[str] | None, templates: Path | None
) -> tuple[Scene | BedScene, Path]:
    """Return what ``case`` describes, with the values of --set, and its run folder; trust ``templates`` from now on."""
    from kncal.core.templating import trust_from_now
    from kncal.scene.case_file import load_case

    for name, digest in trust_from_now(templates).items():
        print(show.printable(f"not kncal's template: {name}, sha256 {digest}"), file=sys.stderr)
    scene = load_case(case, overrides=overrides or ())
    return scene, out if out is not None else Path("runs") / scene.name


def measured(
    scene: _S,
    folder: Path,
    *,
    engine: str = "liggghts",
    transport: str = "auto",
    timeout: float | None = None,
) -> _S:
    """Return the scene with the impact speed that it asks to be measured, which may take some runs in ``folder``."""
    if scene.contact.measured is None:
        return scene
    from kncal.runs.measure_speed import resolve_measured

    with show.working("measuring"):
        return resolve_measured(scene, folder, engine=engine, transport=transport, timeout=timeout, tell=show.note)


def _refuse_ignored(scene: Scene | BedScene, **given: bool) -> None:
    """Refuse a flag that the kind of case at hand would pass over in silence."""
    from kncal.scene.bed_scene import BedScene

    is_bed = isinstance(scene, BedScene)
    for name in ("engine", "repeat") if is_bed else ("transport",):
        if given.get(name):
            kind = "a bed" if is_bed else "a case of single contacts"
            raise InputError(f"--{name} has no meaning for {kind}: leave it out")


def _is_bed(folder: Path) -> bool:
    from kncal.runs.folder import read_model_folder
    from kncal.scene.bed_scene import BedScene

    model = folder / "linear"
    return (model / "manifest.json").is_file() and isinstance(read_model_folder(model)[0], BedScene)


def _kinds(model: str) -> tuple[str, ...]:
    return ("linear", "hertz") if model == "both" else (model,)


def _run(
    scene: Scene,
    engine: Engine,
    folder: Path,
    kinds: tuple[str, ...],
    timeout: float | None,
    repeat: int = 1,
    *,
    anew: bool,
) -> None:
    from kncal.runs.workflow import require_completed, run_case
    from kncal.scene.limits import warnings_of
    from kncal.scene.plan import plan

    for text in warnings_of(plan(scene, kinds), usual=False):
        show.note(f"warning: {text}")
    with show.progress_bars() as progress_for:
        results = run_case(
            scene,
            engine,
            folder,
            kinds,
            timeout=timeout,
            progress_for=progress_for,
            repeat=repeat,
            anew=anew,
            tell=show.note,
        )
    require_completed(results.values())


def _export(runs: Iterable[RunData], paraview: bool) -> None:
    from kncal.report.tables import export_paraview, export_tables

    for data in runs:
        export_tables(data)
        if paraview:
            export_paraview(data)


def _report(comparison: Comparison, folder: Path) -> Path:
    from kncal.runs.workflow import report_on

    return report_on(comparison, folder)


def _print_warnings(models: Mapping[str, Model]) -> None:
    from kncal.scene.limits import warnings_of

    for text in warnings_of(models):
        show.say(f"  warning: {text}")


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
