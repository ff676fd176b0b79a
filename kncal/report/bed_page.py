"""The report on two beds: a page that opens from disk, with its figures and its numbers as files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kncal.core.errors import RenderError
from kncal.core.files import write_csv, write_json, write_text
from kncal.core.units import percent, quantity
from kncal.observe.compare import Comparison
from kncal.observe.cost import Cost
from kncal.observe.run_data import BedRunData
from kncal.record.series import write_series_csv
from kncal.report.bed_figures import draw_bed_figures
from kncal.report.page import CONTACT_ENDS, Table, page_template
from kncal.report.rows import lines_of, names_of, with_uncertainty
from kncal.report.speeds import speeds_section
from kncal.scene.model import BedModel

__all__ = ["with_uncertainty", "write_bed_report"]

_DRAGS = {
    "ErgunWenYu": "Ergun below a void fraction of 0.8, Wen and Yu above (Gidaspow's combination)",
    "PlessisMasliyah": "Du Plessis and Masliyah",
}
_DEPTHS = {
    "walls": "walls in front and at the back",
    "periodic": "periodic in depth",
    "layer": "one layer of particles held in its plane, no walls in front and at the back",
}
_MODEL_B = (
    "Gas and particles: DPMFoam gives the whole pressure gradient to the gas (Gidaspow's model B), and its drag law is"
    " scaled by the void fraction to hold the pressure-gradient force, which is therefore not added again. The equation"
    " of the gas carries its full weight, so the buoyancy V ρ_g g is given to each particle besides the drag. The force"
    " on a particle is held during a coupling interval, in which the gas makes one step or several."
)


def write_bed_report(
    comparison: Comparison[BedRunData],
    folder: Path,
    *,
    warnings: Sequence[str] = (),
    provenance: Mapping[str, Any],
) -> Path:
    """Write the report into ``folder`` (made if missing, files of an earlier report replaced).

    The page needs no network and runs no script: a Content-Security-Policy forbids both, and every text in
    it is escaped.

    Parameters
    ----------
    comparison : Comparison[BedRunData]
    warnings : what the limits of the solvers say about the case, one sentence each; those of the contacts are added
    provenance : section -> entries (nested mappings, lists, text, numbers), shown as they are

    Returns
    -------
    Path
        Of ``index.html``; beside it ``comparison.json``, ``metrics.csv``, the numbers per coupling of each run
        (``linear.csv``, ``hertz.csv``), the figures as PNG and SVG, and ``animation.gif``.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise RenderError(f"{folder}: expected a folder for the report (or nothing yet), not a file or a link")
    folder.mkdir(parents=True, exist_ok=True)
    figures = draw_bed_figures(comparison, folder)
    speeds = speeds_section(comparison, folder)
    texts = list(dict.fromkeys((*warnings, *_contact_warnings(comparison))))
    write_json(
        folder / "comparison.json",
        {**comparison.to_dict(), "warnings": texts, "provenance": dict(provenance)},
    )
    frame = comparison.to_frame()
    units = dict.fromkeys((str(name) for name in frame.columns), "-") | {"needed_end": "s"}
    for name in ("run", "run_width", "reference", "reference_width"):
        units[name] = "see unit"
    write_csv(folder / "metrics.csv", frame, units)
    for data in (comparison.run, comparison.reference):
        write_series_csv(folder / f"{data.model.kind}.csv", data.series)
    scene = comparison.reference.model.scene
    lines = lines_of(comparison.rows)
    page = folder / "index.html"
    write_text(
        page,
        page_template("bed.html.j2").render(
            case=scene.name,
            title=scene.title,
            source=scene.source,
            state=comparison.state,
            sentences=comparison.verdict.all,
            lines=lines,
            windows=_windows(comparison),
            costs=_cost_table(comparison),
            invariants=_invariant_table(comparison),
            warnings=texts,
            figures=figures,
            speeds=speeds,
            settings=_settings(comparison),
            conventions=_conventions(comparison.run.model, comparison.reference.model, names_of(lines.rows)),
            provenance=provenance,
            files=("comparison.json", "metrics.csv", "linear.csv", "hertz.csv"),
        ),
    )
    return page


def _windows(comparison: Comparison[BedRunData]) -> str:
    data = (comparison.run, comparison.reference)
    texts = [
        f"{d.model.kind}: {seen.begin:.3g} to {float(d.series.t[-1]):.3g} s"
        + ("" if seen.begin_by == "given" else f", start-up found in {seen.begin_by}")
        for d, seen in ((d, d.seen) for d in data)
    ]
    return "; ".join(texts)


def _cost_table(comparison: Comparison[BedRunData]) -> Table:
    costs = comparison.costs
    linear, hertz = costs

    def line(name: str, of: Any) -> tuple[str, str, str]:
        return (name, *(of(c) for c in costs))

    def share(part: float, cost: Cost) -> str:
        return f"{quantity(part, 's', 3)} ({part / cost.total:.0%})" if cost.total > 0.0 else quantity(part, "s", 3)

    rows = [
        line("DEM steps", lambda c: quantity(c.steps, "")),
        line("DEM step dt", lambda c: quantity(c.dt, "s")),
        line("steps per (shortest) contact", lambda c: quantity(c.steps_per_contact, "–", 4)),
        line("couplings", lambda c: quantity(c.couplings, "")),
        line("CPU time, particles (DEM)", lambda c: share(c.cpu_seconds, c)),
        line("CPU time, gas", lambda c: share(c.gas, c)),
        line("CPU time, exchange", lambda c: share(c.exchange, c)),
        line("CPU time, total", lambda c: quantity(c.total, "s", 3)),
        line("CPU time per simulated second", lambda c: quantity(c.total / c.simulated, "s", 3)),
        line("wall time", lambda c: quantity(c.wall_seconds, "s", 3)),
    ]
    speed, total = comparison.speed, comparison.speed.total
    ratios = (
        quantity(speed.steps, "–", 3),
        _ratio(hertz.steps_per_contact, linear.steps_per_contact),
        _ratio(hertz.couplings, linear.couplings),
        "–" if speed.cpu is None else f"{speed.cpu:.3g}",
        "–" if speed.cpu is None else _ratio(hertz.gas, linear.gas),
        "–" if speed.cpu is None else _ratio(hertz.exchange, linear.exchange),
        "–" if total is None else f"{total:.3g}",
        "–" if total is None else _ratio(hertz.total / hertz.simulated, linear.total / linear.simulated),
        _ratio(hertz.wall_seconds, linear.wall_seconds),
    )
    with_ratios = zip(rows, (ratios[0], _ratio(hertz.dt, linear.dt), *ratios[1:]), strict=True)
    moving = any(c.cpu_seconds > 0.0 for c in costs)
    kept = tuple((*row, ratio) for row, ratio in with_ratios if moving or not _of_particles(row[0]))
    return Table(("", "linear", "Hertz", "Hertz / linear"), kept)


def _of_particles(cost: str) -> bool:
    """Return whether a line of the cost table is about LIGGGHTS alone."""
    return "DEM" in cost or "contact" in cost


def _ratio(hertz: float | None, linear: float | None) -> str:
    return "–" if hertz is None or not linear else f"{hertz / linear:.3g}"


def _invariant_table(comparison: Comparison[BedRunData]) -> Table:
    rows = tuple(
        (
            i.name,
            i.text,
            "–" if i.run is None else f"{i.run:.3g}",
            "–" if i.reference is None else f"{i.reference:.3g}",
            f"{'more than' if i.at_least else 'at most'} {i.limit:g}",
            "ok" if i.holds else "outside",
        )
        for i in comparison.invariants
        if not (i.holds and i.run is i.reference is None)
    )
    return Table(("", "", "linear", "Hertz", "limit", ""), rows)


def _contact_warnings(comparison: Comparison[BedRunData]) -> list[str]:
    """What the calibration says about the pairs, each text once."""
    return [
        f"{'–'.join(pair)}: {warning}"
        for data in (comparison.run, comparison.reference)
        for pair, contact in data.model.named.items()
        for warning in contact.warnings.values()
    ]


def _settings(comparison: Comparison[BedRunData]) -> Table:
    models = (comparison.run.model, comparison.reference.model)
    scene = models[1].scene
    column, particles, gas = scene.column, scene.particles, scene.gas
    size = " × ".join(quantity(s, "m") for s in (column.width, column.depth, column.height))
    cells = " × ".join(str(n) for n in column.cells)
    edges = zip((column.width, column.depth, column.height), column.cells, strict=True)
    smallest = min(s / n for axis, (s, n) in enumerate(edges) if not (axis == 1 and column.front_back == "layer"))
    rows = [
        ("transport between the solvers", *(c.transport for c in comparison.costs)),
        ("coupling interval", *(quantity(m.coupling, "s") for m in models)),
        ("gas step", *(quantity(m.gas_step, "s") if gas is not None else "–" for m in models)),
        ("box (x, y, z)", size, size),
        ("front and back", *(2 * (_DEPTHS.get(column.front_back, column.front_back),))),
        ("gas cells (x, y, z)", *(2 * (f"{cells}; smallest edge {smallest / particles.diameter:.3g} diameters",))),
        (
            "particles",
            *(2 * (f"{particles.count:,} of {quantity(particles.diameter, 'm')}, start: {particles.packing}",)),
        ),
    ]
    if particles.count and not particles.frozen:
        rows.insert(3, ("DEM steps per coupling", *(str(m.steps_per_coupling) for m in models)))
    if gas is not None:
        inlet = f"{quantity(gas.U_0, 'm/s')} over the floor"
        if gas.jet is not None:
            inlet = f"jet of {quantity(gas.jet.velocity, 'm/s')}, {quantity(gas.jet.x_high - gas.jet.x_low, 'm')} wide"
        elif gas.ramp:
            inlet = f"ramp over {len(gas.ramp)} points"
        rows += [
            ("drag law", *(2 * (f"{gas.drag}: {_DRAGS.get(gas.drag, '')}".rstrip(": "),))),
            ("gas enters", inlet, inlet),
            ("parcels per particle", *(2 * (str(gas.parcels_per_particle),))),
        ]
    for pair in models[1].named:
        name = "–".join(pair)
        rows.append((f"contact {name}", *(_contact(m, pair) for m in models)))
    return Table(("", "linear", "Hertz"), tuple((a, b, c) for a, b, c in rows))


def _contact(model: BedModel, pair: tuple[str, str]) -> str:
    c = model.named.get(pair)
    if c is None:
        return "–"
    stiffness = f"k_n = {quantity(c.k, 'N/m', 4)}" if c.n == 1.0 else f"k_h = {c.k:.4g} N/m^1.5"
    return f"{c.law}: {stiffness}, e_n = {c.e_n:g}, friction {c.friction:g}, t_c = {quantity(c.t_c, 's', 3)}"


def _conventions(linear: BedModel, hertz: BedModel, shown: set[str]) -> list[str]:
    """Return what the numbers mean; of the quantities only those in the table, ``shown``."""
    scene = hertz.scene
    texts = [_MODEL_B] if scene.gas is not None else []
    if hertz.contacts:
        ratios = {pair: c.k_t / c.k for pair, c in linear.named.items() if c.friction > 0.0}
        listed = ", ".join(f"{ratio:.3g} ({'–'.join(pair)})" for pair, ratio in ratios.items())
        how = "Mindlin's 4 G_eff/E_eff" if scene.contact.k_t_ratio is None else "as the case gives it"
        tangential = "no friction, so no tangential force in either run."
        if ratios:
            tangential = (
                f"linear k_t/k_n = {listed}, {how}; Hertz: Mindlin's 8 G_eff sqrt(R_eff δ). Friction with a tangential"
                " spring and no tangential damping in both; the two decks differ in nothing but the normal law, its"
                " tangential stiffness and the time step."
            )
        texts += [f"Tangential stiffness: {tangential}", CONTACT_ENDS[scene.contact.end]]
    if any(name.startswith("bubble_") for name in shown):
        texts.append("Bubbles are connected cells with a void fraction above 0.7 that do not reach the freeboard.")
    if "bed_height" in shown:
        texts.append("The bed height is where the laterally averaged void fraction crosses 0.8.")
    if "overlap_share" in shown:
        texts.append(f"overlap_share counts contacts above {percent(0.01).lstrip('+')} of the diameter.")
    return texts
