"""The page of a stability study, its pictures and tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kncal.core.files import write_csv, write_json
from kncal.core.units import percent, quantity
from kncal.observe.verdict import Verdict
from kncal.report.page import Figure, Page, Section, Table, report_folder, write_page
from kncal.report.style import STYLES, Album, bare, dress, model_name, new_axes, panels, plain_ticks, shared_legend
from kncal.study.stability.accuracy import AccuracyEdge
from kncal.study.stability.coupling_edges import BedPoint
from kncal.study.stability.edges import RESOLUTION, Edge
from kncal.study.stability.maps import Cell
from kncal.study.stability.outcome import OUTCOMES
from kncal.study.stability.results import CELL_UNITS, EDGE_COLUMNS, Stability, probe_name

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
    write_csv(folder / "stability.csv", found.edge_frame(), {name: unit for name, (unit, _) in EDGE_COLUMNS.items()})
    write_csv(folder / "map.csv", found.cell_frame(), CELL_UNITS)
    with report_folder(folder / "report") as drawn:
        figures = _figures(found, drawn)
    given, sentences = found.given, found.sentences()
    page = Page(
        case=given.name,
        title=f"{given.name}: the edge of stability",
        subject="where it stops to be stable",
        about=f"Probes made from the case's materials and contact, at v_0 = {quantity(given.v_0, 'm/s')};"
        f" run by {' and '.join(found.engines)}.",
        verdict=Verdict.of("outside" if "UNSAFE" in sentences[0] else "within", sentences),
        sections=(
            Section(title="Edges in the time step", table=edge_table(found), remark=_EDGES),
            Section(title="Steps for a correct restitution", table=accuracy_table(found), remark=_ACCURACY),
            Section(title="Edges of the coupled algorithm", table=coupling_table(found), remark=_COUPLED),
            Section(title="Maps", figures=figures),
            Section(title="Left out", points=tuple(given.notes), folded=True),
        ),
        files=("../stability.json", "../stability.csv", "../map.csv"),
    )
    return write_page(page, folder / "report")


_EDGES = (
    "Probes at rest under load, nudged: above the edge the nudge grows. Advised: the limit that kncal gives,"
    " ω dt = 2 (√(1 + ζ²) − ζ) with ω and ζ times √z for z contacts at once. Off eigenvalues: edge against the largest"
    " stable step of this arrangement, from the eigenvalues of one step. Other engine: its edge against this one."
    " Exact: within half a per cent, where bisection ends. The number in the name of a pair is its size ratio."
)
_ACCURACY = (
    "Impacts on a wall, first touch at several moments within a step. N needed: the steps per contact from which on e_n"
    " is never further off. N predicted: by the iteration itself, over many such moments."
)
_COUPLED = (
    "Short runs of a reduced bed (fewer particles in a smaller column, the same cells and steps), beyond the limits on"
    " purpose."
)


def edge_table(found: Stability) -> Table:
    """Return the edges as text, one row per probe: the edge that counts, of the case's own contacts, beside theory."""

    def at_v_0(e: Edge) -> str:
        b = e.measured[found.engine_of(e)]
        return f"{quantity(e.at_v_0(found.engine_of(e)), 's', 4)} ±{50.0 * (b.high / b.low - 1.0):.2g} %"

    def other(e: Edge) -> str:
        own = found.engine_of(e)
        middle = e.measured[own].middle
        return next((percent(x.middle / middle - 1.0) for name, x in e.measured.items() if name != own), "–")

    columns: dict[str, Callable[[Edge], str]] = {
        "probe": probe_name,
        "model": lambda e: e.probe.kind,
        "e_n": lambda e: f"{e.probe.e_n:g}",
        "contacts": lambda e: str(e.probe.contacts),
        "edge at v_0": at_v_0,
        "by": found.engine_of,
        "other engine": other,
        "advised": lambda e: quantity(e.advised, "s", 4),
        "advice is": lambda e: safety(e.safe_by(found.engine_of(e))),
        "off eigenvalues": lambda e: percent(e.off_by(found.engine_of(e))),
        "beyond": lambda e: e.measured[found.engine_of(e)].beyond,
    }
    return Table.of(found.edges, columns, ("probe", "model", "by", "advice is", "beyond"))


def safety(share: float) -> str:
    """Say by how much an advised limit lies on the right side of the edge."""
    if abs(share) <= RESOLUTION:
        return "exact"
    return f"{'safe' if share > 0.0 else 'UNSAFE'} by {100.0 * abs(share):.3g} %"


_ACCURACY_COLUMNS: Mapping[str, Callable[[AccuracyEdge], str]] = {
    "model": lambda a: a.kind,
    "e_n": lambda a: f"{a.e_n:g}",
    "error of e_n": lambda a: f"{100.0 * a.error:g} %",
    "N needed": lambda a: quantity(a.measured, ""),
    "N predicted": lambda a: quantity(a.predicted, ""),
    "dt": lambda a: quantity(a.dt, "s", 4),
    "LIGGGHTS agrees": lambda a: {True: "yes", False: "NO", None: "–"}[a.confirmed],
}
_COUPLING_COLUMNS: Mapping[str, Callable[[BedPoint], str]] = {
    "parameter": lambda r: r.edge,
    "value": lambda r: f"{r.value:.3g}",
    "setting": lambda r: quantity(r.setting, r.unit, 3),
    "kncal says": lambda r: r.level,
    "what happened": lambda r: r.outcome,
    "numbers": lambda r: r.evidence,
}


def accuracy_table(found: Stability) -> Table:
    """Return the accuracy edges as text."""
    return Table.of(found.accuracy, _ACCURACY_COLUMNS, ("model", "LIGGGHTS agrees"))


def coupling_table(found: Stability) -> Table:
    """Return the edges of the coupled algorithm as text."""
    runs = [run for edge in found.coupling for run in edge.runs]
    return Table.of(runs, _COUPLING_COLUMNS, ("parameter", "kncal says", "what happened", "numbers"))


def _figures(found: Stability, folder: Path) -> tuple[Figure, ...]:
    album = Album(folder)
    if found.edges:
        album.add(
            "edges",
            _edge_picture(found),
            "Measured edge over the advised limit, against the number of contacts at once: above 1 the advice is safe."
            " Linear and Hertz probes lie beside each other.",
            "Measured stability edge over advised limit against number of contacts.",
        )
    compared = " Rings: LIGGGHTS came to the same; red crosses: it did not." if "liggghts" in found.engines else ""
    for name, (_, _, text) in _MAPS.items():
        if cells := [c for c in found.cells if c.map == name]:
            album.add(
                f"map-{name}",
                map_picture(cells),
                f"{text}{compared}",
                f"Outcome of runs over dt and {name}, linear and Hertz.",
            )
    return tuple(album.figures)


def _edge_picture(found: Stability) -> Axes:
    ax = new_axes()
    for kind, shift in (("linear", 0.96), ("hertz", 1.04)):
        ours = [e for e in found.edges if e.probe.kind == kind]
        style = STYLES[kind]
        x = [e.probe.contacts * shift for e in ours]
        y = [e.safe_by(found.engine_of(e)) + 1.0 for e in ours]
        ax.plot(x, y, style["marker"], color=style["color"], label=model_name(kind), markersize=6)
    ax.axhline(1.0, color="0.45", linewidth=1.0, linestyle=(0, (2, 2)))
    ax.set_xscale("log")
    ax.set_xticks([1, 2, 4, 6, 8, 12], labels=["1", "2", "4", "6", "8", "12"])
    ax.minorticks_off()
    ax.set_ylim(0.0, None)
    return dress(ax, "contacts at once z [–]", "measured edge / advised limit [–]")


def map_picture(cells: Sequence[Cell]) -> Axes:
    """Draw one map, a panel per model: a mark per run of the builtin engine, a ring where LIGGGHTS came to the same."""
    kinds = [kind for kind in ("linear", "hertz") if any(c.kind == kind for c in cells)]
    axes = panels(len(kinds), 1, 5.6, 0.8 + 2.5 * len(kinds))
    for kind, ax in zip(kinds, axes, strict=True):
        _panel(ax, [c for c in cells if c.kind == kind])
        ax.set_title(model_name(kind), loc="left", fontsize=9.5)
    axes[-1].set_xlabel("impact speed v_0 [m/s]" if cells[0].map == "k_n" else "dt over the limit of one contact [–]")
    shared_legend(axes, columns=3)
    return axes[0]


def _panel(ax: Axes, cells: Sequence[Cell]) -> None:
    """Draw the runs of one model."""
    name = cells[0].map
    y_label, y_log, _ = _MAPS[name]
    own = {(c.x, c.y): c.outcome.code for c in cells if c.engine == "builtin"}
    same = {(c.x, c.y): c.outcome.code == own[c.x, c.y] for c in cells if c.engine == "liggghts" and (c.x, c.y) in own}

    def draw(label: str, at: list[tuple[float, float]], marker: str, colour: str, size: float, **style: Any) -> None:
        if at:
            look: dict[str, Any] = {
                "marker": marker,
                "color": colour,
                "markersize": size,
                "linestyle": "",
                "label": label,
            }
            ax.plot(*zip(*at, strict=True), **look, **style)

    for code, (colour, marker) in MARKS.items():
        draw(code, [key for key, found in own.items() if found == code], marker, colour, 6)
    draw(_SAME, [key for key, alike in same.items() if alike], "o", "0.35", 11, markerfacecolor="none")
    draw(_OTHER, [key for key, alike in same.items() if not alike], "x", "red", 11)
    ax.set_xscale("log")
    plain_ticks(ax.xaxis)
    if name != "k_n":
        ax.axvline(1.0, color="0.45", linewidth=1.0, linestyle=(0, (2, 2)))
    if y_log:
        ax.set_yscale("log")
        plain_ticks(ax.yaxis)
    ax.set_ylabel(y_label)
    bare(ax)
