"""Pictures of contacts and of beds; `kncal.report.style` saves them.

Every function takes SI data, draws on a figure of its own (or on ``ax``) and returns the axes. ``runs`` of a bed is a
mapping from model ("linear", "hertz") to what was seen in its signals.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.core.checks import Array, one_of
from kncal.core.errors import InputError
from kncal.core.units import si_prefix
from kncal.observe.averages import BedObservations
from kncal.observe.bubbles import RISE
from kncal.observe.fields import velocity_profile
from kncal.record.facts import BedFacts
from kncal.record.series import BedSeries
from kncal.report.style import CYCLE, DASHES, STYLES, dress, line_style, log_axes, model_name, new_axes, plain_ticks

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: (abscissa, ordinate) of one line, each of shape (n,).
Line = tuple[Array, Array]
Runs = Mapping[str, BedObservations]

#: More markers than this on one line hide each other.
_MARKERS = 60
#: More points than this on one line do not show.
_POINTS = 4000
#: Shown lines of the error figure: error column -> (text, dashes).
_ERRORS = {"error_e_n": ("restitution e_n", "-"), "error_delta_max": ("maximum overlap", (0, (5, 2)))}
#: Signals that `signal_time` draws: field of `BedSeries` -> (label, unit, name of its average).
SIGNALS: Mapping[str, tuple[str, str, str]] = {
    "p_in": ("pressure at the inlet", "Pa", "pressure_drop"),
    "z_mean": ("mean particle height", "m", "z_mean"),
}


def overlap_time(runs: Mapping[str, Line], exact: Mapping[str, Line], ax: Axes | None = None) -> Axes:
    """Overlap [m] against time since first touch [s]: runs as markers, exact solutions as lines, by model."""
    ax = _markers_and_lines(runs, exact, ("time since first touch", "s"), ("overlap δ", "m"), ax)
    ax.set_xlim(0.0, 1.03 * _largest(ax, "x"))
    ax.set_ylim(0.0, 1.06 * _largest(ax, "y"))
    return ax


def force_loops(runs: Mapping[str, Line], exact: Mapping[str, Line], ax: Axes | None = None) -> Axes:
    """Normal force [N] (positive: repulsion) against overlap [m]: runs as markers, exact solutions as lines.

    The area of a loop is the energy lost. Where a damped contact pulls at its end, that part is shaded.
    """
    ax = _markers_and_lines(runs, exact, ("overlap δ", "m"), ("normal force", "N"), ax)
    largest, low = _largest(ax, "y"), float(min(_drawn(ax, "y").min(), 0.0))
    high = 1.06 * largest
    ax.set_xlim(0.0, 1.03 * _largest(ax, "x"))
    ax.set_ylim(low - 0.02 * high, high)
    ax.axhline(0.0, color="0.35", linewidth=0.8, zorder=1)
    # rounding makes -1e-17 N of the last frame of an undamped contact: not an attraction
    if low < -1e-6 * largest:
        low = min(1.1 * low, -0.2 * high)  # room for the text
        ax.axhspan(low, 0.0, color="#F0E442", alpha=0.25, linewidth=0.0, zorder=0)
        ax.set_ylim(low, high)
        text = "attraction: at the end of a damped contact\nthe dashpot pulls harder than the spring pushes"
        ax.text(0.98, 0.02, text, transform=ax.transAxes, ha="right", va="bottom", fontsize=9, color="0.25")
    return ax


def stiffness(x: Array, curves: Mapping[str, Array], against: str, chosen: float) -> Axes:
    """k_n [N/m] of several methods against impact speed (``against="v_0"``, m/s) or restitution ("e_n").

    ``x`` and every curve have shape (n,); NaN leaves a gap. ``chosen`` is the scene's own value, a line.
    """
    if against not in ("v_0", "e_n"):
        raise InputError(f"against = {against!r}: expected 'v_0' or 'e_n'")
    ax = new_axes()
    factor, unit = si_prefix(np.concatenate(list(curves.values())), "N/m")
    for index, (method, k_n) in enumerate(curves.items()):
        colour, dashes = CYCLE[index % len(CYCLE)], DASHES[index % len(DASHES)]
        ax.plot(x, factor * k_n, label=method, linewidth=1.8, color=colour, linestyle=dashes)
    mark = f"this case: {chosen:.3g}{' m/s' if against == 'v_0' else ''}"
    ax.axvline(chosen, color="0.45", linewidth=1.0, linestyle=(0, (2, 2)), label=mark, zorder=1)
    if against == "v_0":
        log_axes(ax)
    x_label = "impact speed v_0 [m/s]" if against == "v_0" else "normal restitution e_n [–]"
    return dress(ax, x_label, f"linear stiffness k_n [{unit}]", columns=3)


def motion(runs: Mapping[str, Line], label: str) -> Axes:
    """A coordinate [m] named ``label`` against time [s], one line per model."""
    ax = new_axes()
    t_factor, t_unit = si_prefix(_all(runs, 0), "s")
    y_factor, y_unit = si_prefix(_all(runs, 1), "m")
    for kind, (t, y) in runs.items():
        ax.plot(t_factor * t, y_factor * y, label=model_name(kind), linewidth=1.8, **line_style(kind))
    return dress(ax, f"time [{t_unit}]", f"{label} [{y_unit}]")


def errors(table: pd.DataFrame) -> Axes:
    """Predicted worst error [-] against steps per contact; the steps really run are marked.

    ``table`` has columns ``model``, ``steps_per_contact``, ``run`` (bool), ``error_e_n`` and
    ``error_delta_max``.
    """
    ax = new_axes()
    for kind, part in table.sort_values("steps_per_contact").groupby("model", sort=False):
        style = STYLES[str(kind)]
        for column, (text, dashes) in _ERRORS.items():
            n = part["steps_per_contact"].to_numpy(dtype=np.float64)
            error = np.abs(part[column].to_numpy(dtype=np.float64))
            shown = error > 0.0  # a logarithmic axis has no zero
            if not shown.any():
                continue
            label = f"{model_name(str(kind))}, {text}"
            ax.plot(n[shown], error[shown], linewidth=1.8, label=label, color=style["color"], linestyle=dashes)
            made = shown & part["run"].to_numpy(dtype=bool)
            ax.plot(n[made], error[made], style["marker"], color=style["color"], markersize=8)
    ax.plot([], [], "o", color="0.3", markersize=8, label="as run")
    ax.set_xscale("log")
    ax.set_yscale("log")
    plain_ticks(ax.xaxis)
    return dress(ax, "steps per contact N [–]", "predicted worst relative error [–]")


def _markers_and_lines(
    runs: Mapping[str, Line], exact: Mapping[str, Line], x: tuple[str, str], y: tuple[str, str], ax: Axes | None
) -> Axes:
    ax = new_axes() if ax is None else ax
    x_factor, x_unit = si_prefix(np.concatenate([_all(runs, 0), _all(exact, 0)]), x[1])
    y_factor, y_unit = si_prefix(np.concatenate([_all(runs, 1), _all(exact, 1)]), y[1])
    for kind, (a, b) in exact.items():
        ax.plot(x_factor * a, y_factor * b, linewidth=1.6, label=f"{model_name(kind)}, exact", **line_style(kind))
    for kind, (a, b) in runs.items():
        style = STYLES[kind] | {"linestyle": "none" if kind in exact else "-", "linewidth": 0.8}
        style |= {"markersize": 4.5, "markerfacecolor": "white", "markevery": max(1, len(a) // _MARKERS)}
        ax.plot(x_factor * a, y_factor * b, label=f"{model_name(kind)}, run", **style)
    return dress(ax, f"{x[0]} [{x_unit}]", f"{y[0]} [{y_unit}]", columns=4)


def _drawn(ax: Axes, which: str) -> Array:
    lines = [getattr(line, f"get_{which}data")() for line in ax.get_lines()]
    return np.concatenate([np.zeros(0), *(np.asarray(values, dtype=np.float64) for values in lines)])


def _largest(ax: Axes, which: str) -> float:
    """Largest drawn value, 1 where nothing is above zero: axes need an extent."""
    largest = float(_drawn(ax, which).max(initial=0.0))
    return largest if largest > 0.0 else 1.0


def _all(lines: Mapping[str, Line], which: int) -> Array:
    return np.concatenate([np.zeros(0), *(np.asarray(line[which], dtype=np.float64) for line in lines.values())])


def signal_time(runs: Runs, name: str) -> Axes:
    """Draw one of `SIGNALS` against time: a thin line per model, and mean and 95 % interval where it was averaged."""
    field = one_of("name", name, SIGNALS)
    label, unit, averaged = SIGNALS[field]
    ax = new_axes()
    factor, shown_unit = si_prefix(np.concatenate([getattr(seen.series, field) for seen in runs.values()]), unit)
    for kind, observed in runs.items():
        series = observed.series
        colour = STYLES[kind]["color"]
        every = max(1, len(series.t) // _POINTS)
        y = factor * getattr(series, field)
        ax.plot(series.t[::every], y[::every], color=colour, linewidth=0.7, alpha=0.75, zorder=2)
        found = observed.estimates.get(averaged)
        if found is None or found.value is None or found.width is None:
            continue
        mean, half = factor * found.value, factor * found.width
        span = [observed.begin, series.t[-1]]
        doubt = "" if found.reliable else " (not reliable)"
        text = f"{model_name(kind)}: {mean:.4g} ± {half:.2g} {shown_unit}{doubt}"
        ax.plot(span, [mean, mean], color=colour, linestyle=STYLES[kind]["linestyle"], linewidth=2.2, label=text)
        ax.fill_between(span, mean - half, mean + half, color=colour, alpha=0.2, linewidth=0.0, zorder=3)
    begins = [observed.begin for observed in runs.values() if observed.begin > 0.0]
    if begins:
        ax.axvspan(0.0, max(begins), color="0.93", linewidth=0.0, zorder=0)
        ax.text(0.01, 0.02, "start-up, left out", transform=ax.transAxes, fontsize=9, color="0.35", va="bottom")
    ax.set_xlim(0.0, max(float(seen.series.t[-1]) for seen in runs.values()))
    return dress(ax, "time [s]", f"{label} [{shown_unit}]", columns=1)


def voidage_maps(runs: Runs) -> Figure:
    """Draw the time mean void fraction of each model, averaged over the depth; of two models also the difference."""
    from matplotlib.figure import Figure

    maps = {kind: (seen.series.facts, _depth_mean(seen)) for kind, seen in runs.items()}
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
        ax.set_title(model_name(kind), fontsize=10)
    if image is not None:
        _colour_bar(figure, image, list(axes[: len(maps)]), "eps_g [–]")
    if len(maps) == 2:
        (first, (_, a)), (second, (_, b)) = maps.items()
        largest = max(float(np.abs(a - b).max()), 1e-3)
        image = _field(axes[-1], facts, a - b, cmap="RdBu_r", vmin=-largest, vmax=largest)
        axes[-1].set_title(f"{model_name(first)} – {model_name(second)}", fontsize=10)
        _colour_bar(figure, image, [axes[-1]], "diff. [–]")
    axes[0].set_ylabel(f"z [{si_prefix(facts.size, 'm')[1]}]")
    return figure


def overlap_histogram(runs: Runs) -> Axes:
    """Draw the share of contacts per decade of overlap, relative to the diameter; dotted: the mean, marks: the largest.

    A bin that begins at zero has no place on the logarithmic axis and is left out.
    """
    ax = new_axes()
    right = 0.0
    for kind, series, overlaps in _having(runs, "overlaps"):
        colour = STYLES[kind]["color"]
        edges = 100.0 * overlaps.edges / series.facts.diameter
        drawn = slice(int(edges[0] == 0.0), None)
        density = overlaps.histogram[drawn] / overlaps.counted / np.diff(np.log10(edges[drawn]))
        ax.stairs(density, edges[drawn], color=colour, linewidth=1.5, label=model_name(kind), baseline=None)
        mean, largest = (100.0 * value / series.facts.diameter for value in (overlaps.mean, overlaps.max))
        ax.axvline(mean, color=colour, linestyle=":", linewidth=1.5, label=f"mean {mean:.3g} %")
        ax.plot([largest], [density[density > 0.0].min()], "v", color=colour, label=f"largest {largest:.3g} %")
        right = max(right, largest)
    ax.set_xscale("log")
    if right:
        ax.set_xlim(right=3.0 * right)  # the bins go on to 100 %
    ax.set_yscale("log")
    return dress(ax, "overlap δ / diameter [%]", "share of contacts per decade [–]")


def pressure_spectra(runs: Runs) -> Axes:
    """Draw the spectral density of the inlet pressure; the label names the dominant frequency."""
    ax = new_axes()
    highest, lowest = 0.0, np.inf
    for kind, _, spectrum in _having(runs, "spectrum"):
        style = line_style(kind)
        text = f"{model_name(kind)}: {spectrum.dominant:.3g} ± {spectrum.resolution:.2g} Hz"
        ax.plot(spectrum.frequency[1:], spectrum.density[1:], linewidth=1.5, label=text, **style)
        ax.axvline(spectrum.dominant, color=style["color"], linewidth=0.8, linestyle=(0, (2, 2)), zorder=1)
        highest = max(highest, float(spectrum.density[1:].max()))
        lowest = min(lowest, float(spectrum.density[1:].min()))
    ax.set_xscale("log")
    ax.set_yscale("log")
    if highest:
        ax.set_ylim(max(1e-8 * highest, 0.5 * lowest), 3.0 * highest)
    return dress(ax, "frequency [Hz]", "pressure spectrum [Pa²/Hz]")


def velocity_profiles(runs: Runs, z: float) -> Axes:
    """Draw the mean vertical velocity of the particles across the bed in the cell layer at height ``z`` [m]."""
    ax = new_axes()
    for kind, series, solids in _having(runs, "solids"):
        x, v_z = velocity_profile(solids, series.facts, z)
        ax.plot(1e3 * x, v_z, linewidth=1.5, markersize=4, label=model_name(kind), **STYLES[kind])
    ax.axhline(0.0, color="0.35", linewidth=0.8, zorder=1)
    return dress(ax, "x [mm]", f"particle velocity at z = {1e3 * z:.3g} mm [m/s]")


def bubble_rise(runs: Runs) -> Axes:
    """Draw the rise velocity of every followed bubble against its diameter, and that of a single bubble."""
    ax = new_axes()
    largest, gravity = 0.0, 9.81
    for kind, series, tracks in _having(runs, "tracks"):
        if not len(tracks.diameter):
            continue
        style = STYLES[kind] | {"linestyle": "none", "markerfacecolor": "none", "markersize": 4.5}
        label = f"{model_name(kind)}: {len(tracks.diameter)} bubbles"
        ax.plot(1e3 * tracks.diameter, tracks.velocity, label=label, **style)
        largest, gravity = max(largest, float(tracks.diameter.max())), series.facts.gravity
    if largest > 0.0:
        diameter = np.linspace(0.0, 1.05 * largest, 100)
        ax.plot(1e3 * diameter, RISE * np.sqrt(gravity * diameter), color="0.35", label="single bubble")
    return dress(ax, "bubble diameter D [mm]", "rise velocity [m/s]")


def fluidization_curves(runs: Runs) -> Axes:
    """Draw pressure drop over weight against gas velocity on the way down, the packed bed's curve, and U_mf."""
    ax = new_axes()
    for kind, _, curve in _having(runs, "curve"):
        branch, style = curve.falling, STYLES[kind]
        ax.plot(branch.U_0, branch.drop, color=style["color"], linewidth=0.6, alpha=0.6, zorder=2)
        velocity = np.linspace(0.0, branch.U_mf, 100)
        label = f"{model_name(kind)}: U_mf = {branch.U_mf:.3f} ± {branch.uncertainty:.2g} m/s"
        ax.plot(velocity, branch.packed_drop(velocity), label=label, **line_style(kind))
        ax.plot([branch.U_mf], [1.0], style["marker"], color=style["color"], markerfacecolor="none")
    ax.axhline(1.0, color="0.35", linewidth=0.8, zorder=1)
    return dress(ax, "superficial gas velocity [m/s]", "pressure drop over weight per area [–]")


def _having(runs: Runs, part: str) -> Iterator[tuple[str, BedSeries, Any]]:
    """Yield model, series and one part of what was observed, of the runs that have it."""
    for kind, seen in runs.items():
        if (found := seen.get(part)) is not None:
            yield kind, seen.series, found


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
    if observed.get("eps_g") is None:
        raise InputError("no mean void fraction: expected a run with gas and recorded frames")
    mean: Array = observed.eps_g.mean(axis=1)
    return mean
