"""Beds on the command line: what ``run``, ``compare`` and ``report`` do for them, and ``kncal adapter``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Parameter

from kncal.cli import show

if TYPE_CHECKING:
    from kncal.observe.bed_compare import BedComparison
    from kncal.record.outcome import RunResult
    from kncal.scene.bed_scene import BedScene

Transport = Annotated[
    Literal["auto", "live", "restart"],
    Parameter(help="beds: how gas and particles exchange; auto is live where the adapter is built"),
]

adapter = App(name="adapter", help="The adapter of the live transport: a small library for OpenFOAM, built here once.")


@adapter.command
def build() -> None:
    """Build the adapter against the headers of this machine's OpenFOAM (downloads its source package, 45 MB)."""
    from kncal.engines.dpmfoam.adapter_build import build as build_adapter

    show.say(f"adapter: {build_adapter(progress=show.say)}")


@adapter.command
def status() -> int:
    """Say whether the adapter is built; exit code 4 if not."""
    from kncal.engines.dpmfoam.adapter_build import find

    library = find()
    show.say(f"adapter: {library}" if library else "adapter: not built; build it: kncal adapter build")
    return 0 if library else 4


def render_bed(scene: BedScene, folder: Path, kinds: tuple[str, ...], ranks: int, *, oversubscribe: bool) -> None:
    """Write what both solvers of a bed read, and say what runs by hand."""
    from kncal.runs.bed_rendering import README
    from kncal.runs.bed_rendering import render_bed as render_models
    from kncal.runs.bed_workflow import PACKING, warnings_of

    with show.time_bars({}) as progress_for:
        models = render_models(
            scene,
            folder,
            kinds,
            ranks=ranks,
            oversubscribe=oversubscribe,
            tell=show.note,
            progress=progress_for(PACKING),
        )
    for kind, m in models.items():
        show.say(
            f"{folder / kind}: {m.couplings} couplings of {show.quantity(m.coupling, 's')}, "
            f"{m.steps_per_coupling} DEM steps of {show.quantity(m.dt, 's')} each"
        )
    for text in warnings_of(models.values()):
        show.say(f"  warning: {text}")
    show.say(f"Each side runs by hand (see {README}); the exchange between them needs kncal run.")


def export_beds(folder: Path, kinds: Iterable[str], *, paraview: bool) -> None:
    """Write the frames of the runs in ``folder`` for ParaView, if asked for."""
    if not paraview:
        return
    from kncal.record.paraview import write_paraview
    from kncal.runs.bed_workflow import load_bed_run

    for kind in kinds:
        write_paraview(load_bed_run(folder / kind).series, folder / kind / "paraview")


def run_bed(
    scene: BedScene,
    folder: Path,
    kinds: tuple[str, ...],
    transport: str,
    timeout: float | None,
    *,
    anew: bool,
    ranks: int,
    oversubscribe: bool,
) -> dict[str, RunResult]:
    """Run (or go on with) a bed and raise if a run did not complete."""
    from kncal.runs.bed_workflow import plan_checked, warnings_of
    from kncal.runs.bed_workflow import run_bed as run_models
    from kncal.runs.workflow import require_completed

    models = plan_checked(scene, kinds)
    for text in warnings_of(models.values()):
        show.note(f"warning: {text}")
    intervals = {kind: model.coupling for kind, model in models.items()}
    with show.time_bars(intervals) as progress_for:
        results = run_models(
            scene,
            folder,
            kinds,
            transport=transport,
            timeout=timeout,
            progress_for=progress_for,
            anew=anew,
            tell=show.note,
            ranks=ranks,
            oversubscribe=oversubscribe,
        )
    require_completed(results.values())
    return results


def print_bed_results(scene: BedScene, folder: Path, results: dict[str, RunResult], *, json: bool) -> None:
    """Print what the runs of a bed cost and where they are."""
    if json:
        show.as_json(
            {
                kind: {"folder": str(folder / kind), "cpu_seconds": r.cpu_seconds, "dt": r.dt, **r.extra}
                for kind, r in results.items()
            }
        )
        return
    from kncal.runs.bed_workflow import plan_checked, warnings_of

    rows = [
        [name, *(show.quantity(r.extra.get(key), "s", 3) for r in results.values())]
        for name, key in (("CPU particles", "cpu_dem"), ("CPU gas", "cpu_gas"), ("CPU exchange", "cpu_exchange"))
    ]
    rows.append(["transport", *(str(r.extra.get("transport")) for r in results.values())])
    rows.append(["dt", *(show.quantity(r.dt, "s") for r in results.values())])
    show.table(f"{scene.name} by coupled", ["", *results], rows)
    for text in warnings_of(plan_checked(scene, results).values()):
        show.say(f"  warning: {text}")
    show.say(f"run folder: {folder}")


def compare_bed(folder: Path, report: Path, *, json: bool) -> int:
    """Compare the two runs in ``folder``, write the report; exit code 0 within, 1 not."""
    from kncal.runs.bed_workflow import compare_bed as compare_runs

    comparison, page = compare_runs(folder, report)
    if json:
        show.as_json(comparison.to_dict() | {"report": str(page)})
    else:
        _print(comparison)
        show.say(f"report: {page}")
    return 0 if comparison.within else 1


def _print(comparison: BedComparison) -> None:
    for sentence in comparison.sentences:
        show.say(sentence)
