"""``kncal render``, ``kncal run``, ``kncal compare``, ``kncal report``: everything that makes or reads a run folder."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from kncal.cli import show
from kncal.cli.flags import Case, CaseFlags, Flags, Json, ModelChoice, RanksFlags, Timeout, kinds, refuse_ignored
from kncal.core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from kncal.observe.compare import Comparison
    from kncal.observe.estimate import Estimate
    from kncal.observe.run_data import RunData
    from kncal.record.outcome import RunResult

Trust = Annotated[
    Path | None,
    Parameter(
        name="--trust-templates",
        help="folder of your own templates, in place of kncal's of the same name; solvers execute what they say",
    ),
]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RunFlags(Flags):
    """How models are run, and what is written of them."""

    timeout: Timeout = None
    repeat: Annotated[int, Parameter(help="number of runs of each model, for the spread of its CPU time")] = 1
    rerun: Annotated[
        bool,
        Parameter(help="run all from the start, also what is complete or could be resumed"),
    ] = False
    paraview: Annotated[bool, Parameter(help="also write frames for ParaView")] = False
    trust_templates: Trust = None


def render(
    case: Case,
    *,
    model: ModelChoice = "both",
    at: CaseFlags = CaseFlags(),
    by: RanksFlags = RanksFlags(),
    trust_templates: Trust = None,
) -> None:
    """Write the solver input of CASE: one folder per model, which runs by hand with ./Allrun.

    With gas, the deck of the particles and the case of the gas each run by hand, alone. Both together need `kncal run`.
    """
    from kncal.engines.coupled import README
    from kncal.runs.workflow import render_case
    from kncal.scene.limits import warnings_of

    _trust(trust_templates)
    scene, folder = at.load(case)
    solver = by.solver(scene)
    scene = by.measured(scene, folder)
    with show.run_bars({}) as progress_for:
        models = render_case(scene, solver, folder, kinds(model), progress_for=progress_for, tell=show.note)
    for kind, m in models.items():
        what = "gas and particles exchange data" if m.scene.gas is not None else "a look"
        every = f", {what} every {show.quantity(m.coupling, 's')}" if m.couplings else ""
        show.say(
            f"{folder / kind}: {m.n_steps} steps of {show.quantity(m.dt, 's')} to t = "
            f"{show.quantity(m.t_end, 's')}{every}"
        )
    for text in warnings_of(models):
        show.say(f"  warning: {text}")
    if scene.gas is not None and (folder / next(iter(models)) / README).is_file():
        show.say(f"Gas and particles each run by hand, alone (see {README}). Both together need kncal run.")


def run(
    case: Case,
    *,
    model: ModelChoice = "both",
    at: CaseFlags = CaseFlags(),
    by: RanksFlags = RanksFlags(),
    how: RunFlags = RunFlags(),
    json: Json = False,
) -> None:
    """Write the solver input of CASE, run it, and print what the runs show."""
    from kncal.runs.workflow import load, remarks
    from kncal.scene.limits import warnings_of

    folder, results = _run(case, kinds(model), at, by, how)
    runs = {kind: load(folder / kind) for kind in results}
    metrics = {kind: _seen(data) for kind, data in runs.items()}
    if json:
        show.as_json(
            {
                kind: {"folder": folder / kind, "metrics": {name: e.value for name, e in metrics[kind].items()}}
                | {"steps": result.steps, "dt": result.dt, "cpu_seconds": result.cpu_seconds, **result.extra}
                for kind, result in results.items()
            }
        )
        return
    _print_results(runs, metrics)
    for data in runs.values():
        for text in remarks(data):
            show.say(f"  {text}")
    for text in warnings_of({kind: data.model for kind, data in runs.items()}):
        show.say(f"  warning: {text}")
    show.say(f"run folder: {folder}")


def compare(
    first: Annotated[
        str, Parameter(help="a case (name of a shipped one, folder, case.toml); with SECOND: folder of the linear run")
    ],
    second: Annotated[Path | None, Parameter(help="folder of the Hertz run: compare two runs that are there")] = None,
    *,
    at: CaseFlags = CaseFlags(),
    by: RanksFlags = RanksFlags(),
    how: RunFlags = RunFlags(),
    json: Json = False,
) -> int:
    """Run a case with the linear and with the Hertz contact, and compare. Or compare two runs.

    Exit code 0: within the tolerances; 1: outside, or undecided.
    """
    from kncal.runs.workflow import compare_case, compare_runs, load_pair

    page = None
    if second is not None:
        refuse_ignored("two runs that exist already", [*at.given(), *by.given(), *how.given()])
        comparison = compare_runs(*load_pair(Path(first), second))
    else:
        folder, _ = _run(first, ("linear", "hertz"), at, by, how)
        comparison, page = compare_case(folder)
    if json:
        show.as_json(comparison.to_dict() | {"report": None if page is None else str(page)})
    else:
        _print_comparison(comparison)
        if page is not None:
            show.say(f"report: {page}")
    return 0 if comparison.within else 1


def report(
    folder: Annotated[Path, Parameter(help="run folder of a case: it holds linear/ and hertz/")],
    *,
    out: Annotated[Path | None, Parameter(help="folder of the report; default: FOLDER/report")] = None,
) -> None:
    """Write the report of a run folder that holds both models."""
    from kncal.runs.states import command_of
    from kncal.runs.workflow import compare_case

    if command := command_of(folder):
        raise InputError(
            f"{folder}: made by {command}, so it is not the run folder of one case: run the same {command} again: it "
            "writes its report and keeps the runs that are complete"
        )
    comparison, page = compare_case(folder, out)
    _say_verdict(comparison)
    show.say(f"report: {page}")


def _trust(templates: Path | None) -> None:
    """Use the templates in this folder from now on, and name each on stderr."""
    from kncal.core.templating import trust_from_now

    for name, digest in trust_from_now(templates).items():
        print(show.printable(f"not kncal's template: {name}, sha256 {digest}"), file=sys.stderr)


def _run(
    case: str, models: tuple[str, ...], at: CaseFlags, by: RanksFlags, how: RunFlags
) -> tuple[Path, dict[str, RunResult]]:
    """Run the models of a case, write their tables; returns the run folder and the results, all completed."""
    from kncal.runs.solving import check_options, plan_checked
    from kncal.runs.workflow import export, load, require_completed, run_case
    from kncal.scene.limits import warnings_of

    _trust(how.trust_templates)
    scene, folder = at.load(case)
    if how.repeat < 1:
        raise InputError(f"--repeat = {how.repeat}: expected at least 1")
    check_options(scene, repeat=how.repeat)
    solver = by.solver(scene)
    scene = by.measured(scene, folder, how.timeout)
    planned = plan_checked(scene, models)
    for text in warnings_of(planned):
        show.note(f"warning: {text}")
    with show.run_bars({kind: m.coupling or None for kind, m in planned.items()}) as progress_for:
        results = run_case(
            scene,
            solver,
            folder,
            models,
            timeout=how.timeout,
            progress_for=progress_for,
            repeat=how.repeat,
            rerun=how.rerun,
            tell=show.note,
        )
    require_completed(results.values())
    for kind in results:
        export(load(folder / kind), paraview=how.paraview)
    return folder, results


def _seen(run: RunData) -> dict[str, Estimate]:
    """Return the metrics that a run has; none of a run too short for any average."""
    try:
        return {name: found for name, found in run.estimates.items() if found.value is not None}
    except InputError as error:
        show.note(str(error))
        return {}


def _print_results(runs: Mapping[str, RunData], metrics: Mapping[str, Mapping[str, Estimate]]) -> None:
    """Print a table of what the runs say and cost."""
    from kncal.observe.estimate import missing
    from kncal.scene.metrics import metric_order, metric_unit

    rows = []
    for name in sorted({name for seen in metrics.values() for name in seen}, key=metric_order):
        found, unit = [seen.get(name) or missing("") for seen in metrics.values()], metric_unit(name)
        rows.append([name, *(show.quantity(each.value, unit, 6, width=each.width) for each in found)])
    costs = [run.cost for run in runs.values()]
    rows.append(["steps", *(f"{cost.steps:,}" for cost in costs)])
    rows.append(["dt", *(show.quantity(cost.dt, "s") for cost in costs)])
    rows.append(["CPU", *(show.quantity(cost.total, "s", 3) for cost in costs)])
    if any(cost.transport for cost in costs):
        rows.append(["CPU particles", *(show.quantity(cost.cpu_seconds, "s", 3) for cost in costs)])
        with_gas = any(cost.has_gas for cost in costs)
        what = "CPU exchange" if with_gas else "CPU recording"
        rows += [["CPU gas", *(show.quantity(cost.gas, "s", 3) for cost in costs)]] if with_gas else []
        rows.append([what, *(show.quantity(cost.exchange, "s", 3) for cost in costs)])
        rows += [["transport", *(cost.transport for cost in costs)]] if with_gas else []
    first = next(iter(runs.values()))
    solver = first.result.version if first.model.scene.coupled else first.result.engine
    show.table(f"{first.model.scene.name} by {solver}", ["", *runs], rows)


def _print_comparison(comparison: Comparison) -> None:
    """Print the tables of the report, and the verdict."""
    from kncal.report.comparison import cost_table
    from kncal.report.page import unmarked
    from kncal.report.rows import table_of

    rows = table_of(comparison.rows)
    title = f"{comparison.reference.model.scene.name}: linear against Hertz"
    for heading, table in ((title, rows.table), ("Cost", cost_table(comparison))):
        show.table(heading, table.headings, [[unmarked(row[0]), *row[1:]] for row in table.rows], text=table.text)
    for text in rows.unseen:
        show.say(f"not shown: {text}")
    _say_verdict(comparison)


def _say_verdict(comparison: Comparison) -> None:
    verdict = comparison.verdict
    show.say(verdict.sentence)
    for text in verdict.points:
        show.say(f"- {text}")
    for text in verdict.details:
        show.say(f"  {text}")
