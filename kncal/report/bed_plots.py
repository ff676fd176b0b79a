"""Pictures of bed runs: signals, mean voidage, overlaps, spectrum; runs of several models in one picture.

``runs`` is always a mapping from model ("linear", "hertz") to series and what was observed in it. Figures are saved
with `kncal.report.plots.save`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.core.checks import Array, one_of
from kncal.core.errors import InputError
from kncal.core.units import si_prefix
from kncal.observe.averages import BedObservations
from kncal.observe.fields import velocity_profile
from kncal.record.facts import BedFacts
from kncal.record.series import BedSeries
from kncal.report import plots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Runs = Mapping[str, tuple[BedSeries, BedObservations]]

#: Signals that `signal_time` draws: field of `BedSeries` -> (label, unit, name of its average).
SIGNALS: Mapping[str, tuple[str, str, str]] = {
    "p_in": ("pressure at the inlet", "Pa", "pressure_drop"),
    "z_mean": ("mean particle height", "m", "z_mean"),
    "z_95": ("height of 95 % of the particles", "m", "z_95"),
    "kinetic_energy": ("kinetic energy", "J", "kinetic_energy"),
    "overlap_mean": ("mean overlap", "m", "overlap_mean"),
}
#: More points than this on one line do not show.
_POINTS = 4000


def signal_time(runs: Runs, name: str, ax: Axes | None = None) -> Axes:
    """Draw one of `SIGNALS` against time: a thin line per model, and mean and 95 % interval where it was averaged."""
    field = one_of("name", name, SIGNALS)
    label, unit, averaged = SIGNALS[field]
    ax = plots.new_axes(7.4, 3.6) if ax is None else ax
    factor, shown_unit = si_prefix(
        np.concatenate([_finite(getattr(series, field)) for series, _ in runs.values()]), unit
    )
    for kind, (series, observed) in runs.items():
        colour = plots.STYLES[kind]["color"]
        every = max(1, len(series.t) // _POINTS)
        y = factor * getattr(series, field)
        ax.plot(series.t[::every], y[::every], color=colour, linewidth=0.7, alpha=0.75, zorder=2)
        if averaged not in observed.averages:
            continue
        found = observed.averages[averaged]
        mean, half = factor * found.mean, factor * found.uncertainty
        span = [observed.begin, series.t[-1]]
        text = f"{_title(kind)}: {mean:.4g} ± {half:.2g} {shown_unit}" + ("" if found.reliable else " (not reliable)")
        ax.plot(span, [mean, mean], color=colour, linestyle=plots.STYLES[kind]["linestyle"], linewidth=2.2, label=text)
        ax.fill_between(span, mean - half, mean + half, color=colour, alpha=0.2, linewidth=0.0, zorder=3)
    begins = [observed.begin for _, observed in runs.values() if observed.begin > 0.0]
    if begins:
        ax.axvspan(0.0, max(begins), color="0.93", linewidth=0.0, zorder=0)
        ax.annotate(
            "start-up, left out", (0.0, 0.02), xycoords=("data", "axes fraction"), fontsize=8, color="0.35", va="bottom"
        )
    ax.set_xlim(0.0, max(float(series.t[-1]) for series, _ in runs.values()))
    ax.set_xlabel("time [s]")
    ax.set_ylabel(f"{label} [{shown_unit}]")
    _dress(ax)
    return ax


def voidage_maps(runs: Runs) -> Figure:
    """Draw the time mean void fraction of each model, averaged over the depth; of two models also the difference."""
    from matplotlib.figure import Figure

    maps = {kind: (series.facts, _depth_mean(observed)) for kind, (series, observed) in runs.items()}
    facts = next(iter(maps.values()))[0]
    if any(other.cells != facts.cells or other.size != facts.size for other, _ in maps.values()):
        raise InputError("the runs have different gas grids: expected the same cells in the same box")
    panels = len(maps) + (len(maps) == 2)
    width, _, height = facts.size
    panel = float(np.clip(4.6 * width / height, 1.5, 4.0))
    figure = Figure(figsize=(1.0 + panels * (panel + 0.75), 5.4), layout="constrained")
    axes = figure.subplots(1, panels, sharey=True, squeeze=False)[0]
    image = None
    for ax, (kind, (_, eps_g)) in zip(axes, maps.items(), strict=False):
        image = _field(ax, facts, eps_g, cmap="cividis", vmin=0.35, vmax=1.0)
        ax.set_title(_title(kind), fontsize=10)
    if image is not None:
        _colour_bar(figure, image, list(axes[: len(maps)]), "eps_g [–]")
    if len(maps) == 2:
        (first, (_, a)), (second, (_, b)) = maps.items()
        largest = max(float(np.abs(a - b).max()), 1e-3)
        image = _field(axes[-1], facts, a - b, cmap="RdBu_r", vmin=-largest, vmax=largest)
        axes[-1].set_title(f"{_title(first)} – {_title(second)}", fontsize=10)
        _colour_bar(figure, image, [axes[-1]], "diff. [–]")
    axes[0].set_ylabel(f"z [{si_prefix(facts.size, 'm')[1]}]")
    return figure


def overlap_histogram(runs: Runs, ax: Axes | None = None) -> Axes:
    """Draw the share of contacts per decade of overlap, relative to the diameter; dotted: the mean, marks: the largest.

    A bin that begins at zero has no place on the logarithmic axis and is left out.
    """
    ax = plots.new_axes() if ax is None else ax
    right = 0.0
    for kind, (series, observed) in runs.items():
        overlaps = observed.overlaps
        if overlaps is None:
            continue
        colour = plots.STYLES[kind]["color"]
        edges = 100.0 * overlaps.edges / series.facts.diameter
        drawn = slice(int(edges[0] == 0.0), None)
        density = overlaps.histogram[drawn] / overlaps.counted / np.diff(np.log10(edges[drawn]))
        ax.stairs(density, edges[drawn], color=colour, linewidth=1.5, label=_title(kind), baseline=None)
        mean, largest = (100.0 * value / series.facts.diameter for value in (overlaps.mean, overlaps.max))
        ax.axvline(mean, color=colour, linestyle=":", linewidth=1.5, label=f"mean {mean:.3g} %")
        ax.plot([largest], [density[density > 0.0].min()], "v", color=colour, label=f"largest {largest:.3g} %")
        right = max(right, largest)
    ax.set_xscale("log")
    if right:
        ax.set_xlim(right=3.0 * right)  # the bins go on to 100 %
    ax.set_yscale("log")
    ax.set_xlabel("overlap δ / diameter [%]")
    ax.set_ylabel("share of contacts per decade [–]")
    _dress(ax)
    return ax


def pressure_spectra(runs: Runs, ax: Axes | None = None) -> Axes:
    """Draw the spectral density of the inlet pressure; the label names the dominant frequency."""
    ax = plots.new_axes() if ax is None else ax
    highest, lowest = 0.0, np.inf
    for kind, (_, observed) in runs.items():
        spectrum = observed.spectrum
        if spectrum is None:
            continue
        style = {key: value for key, value in plots.STYLES[kind].items() if key != "marker"}
        text = f"{_title(kind)}: {spectrum.dominant:.3g} ± {spectrum.resolution:.2g} Hz"
        ax.plot(spectrum.frequency[1:], spectrum.density[1:], linewidth=1.5, label=text, **style)
        ax.axvline(spectrum.dominant, color=style["color"], linewidth=0.8, linestyle=(0, (2, 2)), zorder=1)
        highest = max(highest, float(spectrum.density[1:].max()))
        lowest = min(lowest, float(spectrum.density[1:].min()))
    ax.set_xscale("log")
    ax.set_yscale("log")
    if highest:
        ax.set_ylim(max(1e-8 * highest, 0.5 * lowest), 3.0 * highest)
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel("pressure spectrum [Pa²/Hz]")
    _dress(ax)
    return ax


def velocity_profiles(runs: Runs, z: float, ax: Axes | None = None) -> Axes:
    """Draw the mean vertical velocity of the particles across the bed in the cell layer at height ``z`` [m]."""
    ax = plots.new_axes() if ax is None else ax
    for kind, (series, observed) in runs.items():
        if observed.solids is None:
            continue
        x, v_z = velocity_profile(observed.solids, series.facts, z)
        ax.plot(1e3 * x, v_z, linewidth=1.5, markersize=4, label=_title(kind), **plots.STYLES[kind])
    ax.axhline(0.0, color="0.35", linewidth=0.8, zorder=1)
    ax.set_xlabel("x [mm]")
    ax.set_ylabel(f"mean particle velocity at z = {1e3 * z:.3g} mm [m/s]")
    _dress(ax)
    return ax


def bubble_rise(runs: Runs, ax: Axes | None = None) -> Axes:
    """Draw the rise velocity of every followed bubble against its diameter, and that of a single bubble."""
    from kncal.observe.bubbles import RISE

    ax = plots.new_axes() if ax is None else ax
    largest, gravity = 0.0, 9.81
    for kind, (series, observed) in runs.items():
        if observed.tracks is None or not len(observed.tracks.diameter):
            continue
        style = plots.STYLES[kind]
        ax.plot(
            1e3 * observed.tracks.diameter,
            observed.tracks.velocity,
            style["marker"],
            color=style["color"],
            markerfacecolor="none",
            markersize=4.5,
            label=f"{_title(kind)}: {len(observed.tracks.diameter)} bubbles",
        )
        largest, gravity = max(largest, float(observed.tracks.diameter.max())), series.facts.gravity
    if largest > 0.0:
        diameter = np.linspace(0.0, 1.05 * largest, 100)
        ax.plot(1e3 * diameter, RISE * np.sqrt(gravity * diameter), color="0.35", label="single bubble")
    ax.set_xlabel("bubble diameter D [mm]")
    ax.set_ylabel("rise velocity [m/s]")
    _dress(ax)
    return ax


def fluidization_curves(runs: Runs, ax: Axes | None = None) -> Axes:
    """Draw pressure drop over weight against gas velocity on the way down, the packed bed's curve, and U_mf."""
    ax = plots.new_axes() if ax is None else ax
    for kind, (_, observed) in runs.items():
        if observed.curve is None:
            continue
        branch, style = observed.curve.falling, plots.STYLES[kind]
        ax.plot(branch.U_0, branch.drop, color=style["color"], linewidth=0.6, alpha=0.6, zorder=2)
        velocity = np.linspace(0.0, branch.U_mf, 100)
        label = f"{_title(kind)}: U_mf = {branch.U_mf:.3f} ± {branch.uncertainty:.2g} m/s"
        ax.plot(velocity, branch.packed_drop(velocity), color=style["color"], linestyle=style["linestyle"], label=label)
        ax.plot([branch.U_mf], [1.0], style["marker"], color=style["color"], markerfacecolor="none")
    ax.axhline(1.0, color="0.35", linewidth=0.8, zorder=1)
    ax.set_xlabel("superficial gas velocity [m/s]")
    ax.set_ylabel("pressure drop over weight per area [–]")
    _dress(ax)
    return ax


def _field(ax: Axes, facts: BedFacts, values: Array, **colours: Any) -> Any:
    factor, unit = si_prefix(facts.size, "m")
    extent = (0.0, factor * facts.size[0], 0.0, factor * facts.size[2])
    image = ax.imshow(values, origin="lower", extent=extent, interpolation="nearest", aspect="equal", **colours)
    ax.set_xlabel(f"x [{unit}]")
    return image


def _colour_bar(figure: Figure, image: Any, axes: list[Axes], name: str) -> None:
    """Add a colour bar with its name above it: beside it there is the next panel."""
    bar = figure.colorbar(image, ax=axes, shrink=0.75, pad=0.06, aspect=25)
    bar.ax.locator_params(axis="y", nbins=6)
    bar.ax.tick_params(labelsize=9)
    bar.ax.set_title(name, fontsize=9, pad=8, loc="left")


def _depth_mean(observed: BedObservations) -> Array:
    if observed.eps_g is None:
        raise InputError("no mean void fraction: expected a run with gas and recorded frames")
    mean: Array = observed.eps_g.mean(axis=1)
    return mean


def _finite(values: Array) -> Array:
    finite: Array = values[np.isfinite(values)]
    return finite


def _title(kind: str) -> str:
    return {"linear": "linear", "hertz": "Hertz"}.get(kind, kind)


def _dress(ax: Axes) -> None:
    """Light grid, no box, and the legend above the axes, where it hides nothing."""
    ax.grid(True, which="major", color="0.88", linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    if not ax.get_legend_handles_labels()[0]:
        return
    ax.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0, 1.0, 0.1),
        ncols=3,
        frameon=False,
        fontsize=8.5,
        borderaxespad=0.3,
        columnspacing=1.4,
        handlelength=2.4,
    )
