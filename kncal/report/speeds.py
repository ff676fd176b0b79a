"""Impact speeds: their picture, and what a report says of them beside the speed that the contacts are calibrated at."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kncal.core.errors import InputError
from kncal.core.units import quantity
from kncal.observe.impact_speeds import STATISTICS, ImpactSpeeds, bed_impact_speeds, kinds_of_impacts
from kncal.observe.run_data import RunData
from kncal.report.page import Section, Table
from kncal.report.style import Album, dress, model_name, new_axes, save_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Kind of impacts -> who meets.
WHO = {"particles": "two particles", "walls": "a particle and a wall", "all": "all contacts"}
#: Most kinds of impacts that a picture shows: the most frequent ones.
_SHOWN = 2
_REMARK = (
    "Speeds of new contacts, after the start-up, with 95 % intervals. Energy-weighted: Σv³/Σv², the speed at which the"
    " impacts carry their energy. 99 %: the percentile; the largest overlaps come from these impacts. v_0: the speed"
    " that the contact is calibrated at, and where it lies relative to the energy-weighted interval."
)


def speeds_section(runs: tuple[RunData, ...], album: Album) -> Section:
    """Return the section on the impact speeds of ``runs``, its pictures in ``album``; empty where nothing can meet."""
    sentences: list[str] = []
    rows: list[tuple[str, ...]] = []
    notes: dict[str, None] = {}
    first = len(album.figures)
    for data in runs:
        name = model_name(data.model.kind)
        if data.signals is None or not data.signals.facts.impact_edges:  # nothing can meet
            continue
        kinds = kinds_of_impacts(data.model.species)
        speeds = bed_impact_speeds(data.series, data.seen.begin, data.seen.window.doubt, kinds)
        for kind, pair in kinds.items():
            if kind not in speeds:
                continue
            v_0 = data.model.contacts[pair].v_0
            rows.append(_row(name, speeds[kind], v_0))
            notes |= dict.fromkeys(_doubts(name, speeds[kind]))
        if any(found.count for found in speeds.values()):
            album.add(
                f"impact_speeds_{data.model.kind}",
                impact_speeds(speeds, f"{name} run"),
                f"{name}: share of impacts per decade of speed, with the three speeds of each pair.",
                f"Distribution of impact speeds, {name} run.",
            )
    if any(row[-1] in ("below", "above") for row in rows):
        sentences.append(
            "v_0 is not within the energy-weighted interval everywhere (last column): kncal kn --from-run gives the k_n"
            " that belongs to the measured speed."
        )
    figures = tuple(album.figures[first:])
    del album.figures[first:]
    headings = ("run", "contact of", "impacts", "mean", "energy-weighted", "99 %", "v_0", "v_0 is")
    return Section(
        title="Impact speeds",
        text=tuple(sentences),
        table=Table(headings, tuple(rows), text=(0, 1, 7)),
        remark=_REMARK,
        notes=tuple(notes),
        figures=figures,
    )


def _row(name: str, speeds: ImpactSpeeds, v_0: float | None) -> tuple[str, ...]:
    values = [speeds.speeds[each].shown("m/s", 3) if each in speeds.speeds else "–" for each in STATISTICS]
    given = "–" if v_0 is None else quantity(v_0, "m/s", 3)
    return (name, WHO.get(speeds.kind, speeds.kind), f"{speeds.count:,}", *values, given, _place(speeds, v_0))


def _place(speeds: ImpactSpeeds, v_0: float | None) -> str:
    """Where v_0 is to the interval of the energy-weighted mean."""
    found = speeds.speeds.get("energy_weighted")
    if found is None or v_0 is None:
        return ""
    return "below" if v_0 < found.low else "above" if v_0 > found.high else "within"


def _doubts(name: str, speeds: ImpactSpeeds) -> Iterator[str]:
    for statistic, found in speeds.speeds.items():
        if found.why:
            yield f"{name}, {WHO.get(speeds.kind, speeds.kind)}, {STATISTICS[statistic]}: {found.why}"


def impact_speeds(speeds: Mapping[str, ImpactSpeeds], title: str = "") -> Axes:
    """Draw the shares of impacts per decade of speed, with the three speeds, of the most frequent kinds.

    A bin that begins at zero has no place on the logarithmic axis and is left out.

    Raises
    ------
    InputError
        If there was no impact.
    """
    most = sorted(speeds.values(), key=lambda found: -found.count)[:_SHOWN]
    shown = [found for found in speeds.values() if found.count and any(found is one for one in most)]
    if not shown:
        raise InputError("impact speeds: there was no impact to draw")
    ax = new_axes(5.6, 4.8)
    dashes = dict(zip(STATISTICS, (":", "-", "--"), strict=True))
    for found, colour in zip(shown, ("#0072B2", "#D55E00", "#009E73"), strict=False):
        edges, counts = found.edges[1:], found.counts[1:]
        used = np.flatnonzero(counts)
        part = slice(max(int(used[0]) - 1, 0), int(used[-1]) + 2) if len(used) else slice(0, 1)
        density = counts[part] / found.count / np.diff(np.log10(edges))[part]
        label = f"{WHO.get(found.kind, found.kind)}, {found.count} impacts"
        ax.stairs(density, edges[part.start : part.start + len(density) + 1], color=colour, label=label, fill=False)
        for name, estimate in found.speeds.items():
            told = f"{STATISTICS[name]} {estimate.value:.3g} m/s"
            ax.axvline(estimate.value, color=colour, linestyle=dashes[name], linewidth=1.2, label=told)
    ax.set_xscale("log")
    ax.set_ylim(bottom=0.0)
    dress(ax, "impact speed v_0 [m/s]", "share of impacts per decade [–]", columns=len(shown))
    ax.set_title(title, fontsize=10, pad=6.0 + 14.0 * len(ax.get_legend_handles_labels()[0]) / len(shown))
    return ax


def plot_impact_speeds(speeds: Mapping[str, ImpactSpeeds], path: Path, title: str = "") -> None:
    """Write `impact_speeds` as a picture (.png or .svg).

    Raises
    ------
    InputError
        If there was no impact, or the file is not of a kind that is drawn.
    """
    save_picture(impact_speeds(speeds, title).get_figure(root=True), path)
