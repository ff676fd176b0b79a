"""The page of a stability study, its pictures and tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kncal.core.files import write_csv, write_json, write_text
from kncal.core.scratch import drawn_aside
from kncal.core.units import percent, quantity
from kncal.report import plots
from kncal.report.figures import Figure
from kncal.report.page import Table, page_template
from kncal.study.stability.edges import RESOLUTION
from kncal.study.stability.maps import Cell
from kncal.study.stability.outcome import OUTCOMES
from kncal.study.stability.results import CELL_UNITS, EDGE_UNITS, Stability

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Outcome -> colour (Okabe and Ito) and sign, so that no one has to tell colours apart.
MARKS = dict(
    zip(
        OUTCOMES,
        (
            ("#009E73", "o"),
            ("#E69F00", "^"),
            ("#D55E00", "s"),
            ("#CC79A7", "D"),
            ("#CC79A7", "v"),
            ("#000000", "X"),
            ("#56B4E9", "P"),
            ("#000000", "x"),
        ),
        strict=True,
    )
)
#: Whether LIGGGHTS came to the same outcome, as a legend says it.
_SAME, _OTHER = "LIGGGHTS: the same", "LIGGGHTS: another"
#: Map -> (ordinate, whether it is logarithmic, what is shown).
_MAPS = {
    "e_n": ("normal restitution e_n [–]", False, "Spheres hit a wall at v_0."),
    "contacts": ("contacts at once [–]", False, "Spheres hit one at rest from all sides, all at once and at v_0."),
    "size_ratio": ("size ratio [–]", True, "A sphere meets a larger one, head on at v_0."),
    "k_n": ("stiffness k_n [N/m]", True, "Spheres hit a wall, at the case's steps per contact."),
}


def write_stability(found: Stability, folder: Path) -> Path:
    """Write stability.json, stability.csv, map.csv and report/index.html into ``folder``; returns the page's path."""
    folder.mkdir(parents=True, exist_ok=True)
    # first, since it says whose folder this is
    write_json(folder / "stability.json", found.to_dict())
    write_csv(folder / "stability.csv", found.edge_frame(), EDGE_UNITS)
    write_csv(folder / "map.csv", found.cell_frame(), CELL_UNITS)
    report = folder / "report"
    report.mkdir(exist_ok=True)
    # drawn aside and moved, so that each is whole
    with drawn_aside(report) as drawn:
        figures = _figures(found, drawn)
    page = report / "index.html"
    write_text(
        page,
        page_template("stability.html.j2").render(
            case=found.given.name,
            v_0=quantity(found.given.v_0, "m/s"),
            engines=" and ".join(found.engines),
            safe="UNSAFE" not in found.sentences()[0],
            sentences=found.sentences(),
            notes=found.given.notes,
            edges=edge_table(found),
            accuracy=accuracy_table(found),
            bed=bed_table(found),
            figures=figures,
        ),
    )
    return page


def edge_table(found: Stability) -> Table:
    """Return the edges as text, one row per probe: the edge that counts, of the case's own contacts, beside theory."""
    rows = []
    for e in found.edges:
        p, engine = e.probe, found.engine_of(e)
        b = e.measured[engine]
        half = 50.0 * (b.high / b.low - 1.0)
        other = [percent(x.middle / b.middle - 1.0) for name, x in e.measured.items() if name != engine]
        rows.append(
            (
                p.name.removesuffix(f"-{p.kind}"),
                p.kind,
                f"{p.e_n:g}",
                str(p.contacts),
                f"{quantity(e.at_v_0(engine), 's', 4)} ±{half:.2g} %",
                engine,
                other[0] if other else "–",
                quantity(e.advised, "s", 4),
                safety(e.safe_by(engine)),
                percent(e.off_by(engine)),
                b.beyond,
            )
        )
    headings = (
        "probe", "model", "e_n", "contacts", "edge at v_0", "by", "other engine", "advised limit", "advice is",
        "off eigenvalues", "beyond",
    )  # fmt: skip
    return Table(headings, tuple(rows))


def safety(share: float) -> str:
    """Say by how much an advised limit lies on the right side of the edge."""
    if abs(share) <= RESOLUTION:
        return "exact"
    return f"{'safe' if share > 0.0 else 'UNSAFE'} by {100.0 * abs(share):.3g} %"


def accuracy_table(found: Stability) -> Table:
    """Return the accuracy edges as text."""
    rows = tuple(
        (
            a.kind,
            f"{a.e_n:g}",
            f"{100.0 * a.error:g} %",
            "–" if a.measured is None else f"{a.measured:g}",
            "–" if a.predicted is None else f"{a.predicted:g}",
            quantity(a.dt, "s", 4),
            {True: "yes", False: "NO", None: "–"}[a.confirmed],
        )
        for a in found.accuracy
    )
    return Table(("model", "e_n", "error of e_n", "N needed", "N predicted", "dt", "LIGGGHTS agrees"), rows)


def bed_table(found: Stability) -> Table:
    """Return the edges of the coupled algorithm as text."""
    rows = tuple(
        (r.edge, f"{r.value:.3g}", quantity(r.setting, r.unit, 3), r.level, r.outcome, r.evidence)
        for edge in found.bed
        for r in edge.runs
    )
    return Table(("parameter", "value", "setting", "kncal says", "what happened", "numbers"), rows)


def _figures(found: Stability, folder: Path) -> list[Figure]:
    figures = []
    if found.edges:
        png, svg = plots.save(_edge_picture(found), folder, "edges")
        figures.append(
            Figure(
                name="edges",
                png=png.name,
                svg=svg.name,
                caption="Measured edge over the advised limit: above 1 the advice is safe. Against the number of "
                "contacts at once; linear and Hertz probes lie beside each other.",
                alt="Measured stability edge over advised limit against number of contacts.",
            )
        )
    for name, (_, _, text) in _MAPS.items():
        cells = [c for c in found.cells if c.map == name]
        if not cells:
            continue
        stem = f"map-{name}"
        png, svg = plots.save(map_picture(cells), folder, stem)
        figures.append(
            Figure(
                name=stem,
                png=png.name,
                svg=svg.name,
                caption=f"{text} Rings: LIGGGHTS came to the same; red crosses: it did not.",
                alt=f"Outcome of runs over dt and {name}, linear and Hertz.",
            )
        )
    return figures


def _edge_picture(found: Stability) -> Axes:
    ax = plots.new_axes()
    for kind, shift in (("linear", 0.96), ("hertz", 1.04)):
        ours = [e for e in found.edges if e.probe.kind == kind]
        style = plots.STYLES[kind]
        x = [e.probe.contacts * shift for e in ours]
        y = [e.safe_by(found.engine_of(e)) + 1.0 for e in ours]
        ax.plot(x, y, style["marker"], color=style["color"], label=kind, markersize=6)
    ax.axhline(1.0, color="0.45", linewidth=1.0, linestyle=(0, (2, 2)))
    ax.set_xscale("log")
    ax.set_xticks([1, 2, 4, 6, 8, 12], labels=["1", "2", "4", "6", "8", "12"])
    ax.minorticks_off()
    ax.set_ylim(0.0, None)
    ax.set_xlabel("contacts at once z [–]")
    ax.set_ylabel("measured edge / advised limit [–]")
    ax.grid(True, color="0.88", linewidth=0.7)
    ax.legend(loc="upper left", frameon=False, fontsize=8.5)
    return ax


def map_picture(cells: Sequence[Cell]) -> Axes:
    """Draw one map, a panel per model: a mark per run of the builtin engine, a ring where LIGGGHTS came to the same."""
    from matplotlib.figure import Figure as Drawing

    kinds = [kind for kind in ("linear", "hertz") if any(c.kind == kind for c in cells)]
    drawing = Drawing(figsize=(7.4, 0.4 + 2.7 * len(kinds)), layout="constrained")
    panels = drawing.subplots(len(kinds), 1, sharex=True, squeeze=False)[:, 0]
    shown: dict[str, Any] = {}
    for kind, ax in zip(kinds, panels, strict=True):
        shown |= _panel(ax, [c for c in cells if c.kind == kind])
        ax.set_title(kind, loc="left", fontsize=9.5)
    panels[-1].set_xlabel("impact speed v_0 [m/s]" if cells[0].map == "k_n" else "dt over the limit of one contact [–]")
    order = [name for name in (*MARKS, _SAME, _OTHER) if name in shown]
    drawing.legend([shown[name] for name in order], order, loc="outside right center", frameon=False, fontsize=8.5)
    first: Axes = panels[0]
    return first


def _panel(ax: Axes, cells: Sequence[Cell]) -> dict[str, Any]:
    """Draw the runs of one model; returns what stands for each outcome."""
    from matplotlib.ticker import NullLocator

    name, drawn = cells[0].map, {}
    y_label, y_log, _ = _MAPS[name]
    own = {(c.x, c.y): c for c in cells if c.engine == "builtin"}
    for code, (colour, marker) in MARKS.items():
        at = [key for key, c in own.items() if c.outcome.code == code]
        if at:
            (drawn[code],) = ax.plot(*zip(*at, strict=True), linestyle="", color=colour, marker=marker, markersize=6)
    others = [c for c in cells if c.engine == "liggghts" and (c.x, c.y) in own]
    for label, marker, colour in ((_SAME, "o", "0.35"), (_OTHER, "x", "red")):
        alike = label == _SAME
        at = [(c.x, c.y) for c in others if (c.outcome.code == own[c.x, c.y].outcome.code) == alike]
        if at:
            (drawn[label],) = ax.plot(
                *zip(*at, strict=True), linestyle="", marker=marker, color=colour, markerfacecolor="none", markersize=11
            )
    ax.set_xscale("log")
    ax.xaxis.set_minor_locator(NullLocator())
    if name != "k_n":
        ax.axvline(1.0, color="0.45", linewidth=1.0, linestyle=(0, (2, 2)))
    if y_log:
        ax.set_yscale("log")
        ax.yaxis.set_minor_locator(NullLocator())
    ax.set_ylabel(y_label)
    ax.grid(True, color="0.9", linewidth=0.6)
    ax.set_axisbelow(True)
    return drawn
