"""Pictures of contacts and runs.

Every function takes SI data, draws on ``ax`` (on a figure of its own if None) and returns the axes.
The colours are those of Okabe and Ito, which people with any colour vision tell apart; dashes differ too.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.core.units import si_prefix
from kncal.observe.impact_speeds import STATISTICS, ImpactSpeeds

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

#: (abscissa, ordinate) of one line, each of shape (n,).
Line = tuple[Array, Array]

#: Colour, dashes and marker of each model.
STYLES: Mapping[str, dict[str, Any]] = {
    "linear": {"color": "#0072B2", "linestyle": "-", "marker": "o"},
    "hertz": {"color": "#D55E00", "linestyle": (0, (5, 2)), "marker": "s"},
}
_CYCLE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#000000")
_DASHES = ("-", (0, (5, 2)), (0, (5, 1.5, 1, 1.5)), (0, (1, 1.5)), (0, (8, 2)), (0, (3, 1, 1, 1, 1, 1)), "-")

#: More markers than this on one line hide each other.
_MARKERS = 60

#: Shown lines of the error figure: error column -> (text, dashes).
_ERRORS = {"error_e_n": ("restitution e_n", "-"), "error_delta_max": ("maximum overlap", (0, (5, 2)))}


def new_axes(width: float = 6.6, height: float = 4.2) -> Axes:
    """Return axes on a figure of their own (inches) that needs no display."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained").add_subplot()


def save(ax: Axes, folder: Path, name: str) -> tuple[Path, Path]:
    """Write the figure of ``ax`` as ``name.png`` (130 dots per inch) and ``name.svg``; returns both paths.

    The same data give the same bytes: no date, no random identifiers.
    """
    from matplotlib import rc_context

    figure = ax.get_figure(root=True)
    if figure is None:
        raise InputError(f"picture {name}: the axes have been removed from their figure")
    png, svg = folder / f"{name}.png", folder / f"{name}.svg"
    with rc_context({"svg.hashsalt": name}):
        figure.savefig(png, dpi=130, metadata={"Software": None})
        figure.savefig(svg, metadata={"Date": None, "Creator": None})
    return png, svg


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
        ax.annotate(
            "attraction: at the end of a damped contact\nthe dashpot pulls harder than the spring pushes",
            xy=(0.98, 0.02),
            xycoords="axes fraction",
            ha="right",
            va="bottom",
            fontsize=8,
            color="0.25",
        )
    return ax


def stiffness(x: Array, curves: Mapping[str, Array], against: str, chosen: float, ax: Axes | None = None) -> Axes:
    """k_n [N/m] of several methods against impact speed (``against="v_0"``, m/s) or restitution ("e_n").

    ``x`` and every curve have shape (n,); NaN leaves a gap. ``chosen`` is the scene's own value, a line.
    """
    if against not in ("v_0", "e_n"):
        raise InputError(f"against = {against!r}: expected 'v_0' or 'e_n'")
    ax = new_axes() if ax is None else ax
    factor, unit = si_prefix(np.concatenate(list(curves.values())), "N/m")
    for index, (method, k_n) in enumerate(curves.items()):
        colour, dashes = _CYCLE[index % len(_CYCLE)], _DASHES[index % len(_DASHES)]
        ax.plot(x, factor * k_n, label=method, linewidth=1.8, color=colour, linestyle=dashes)
    if against == "v_0":
        ax.set_xscale("log")
        ax.set_yscale("log")
        _plain_ticks(ax.xaxis)
        _plain_ticks(ax.yaxis)
        mark = f"this case: {chosen:.3g} m/s"
    else:
        mark = f"this case: {chosen:.3g}"
    ax.axvline(chosen, color="0.45", linewidth=1.0, linestyle=(0, (2, 2)), label=mark, zorder=1)
    ax.set_xlabel("impact speed v_0 [m/s]" if against == "v_0" else "normal restitution e_n [–]")
    ax.set_ylabel(f"linear stiffness k_n [{unit}]")
    _dress(ax, columns=3)
    return ax


def motion(runs: Mapping[str, Line], label: str, ax: Axes | None = None) -> Axes:
    """A coordinate [m] named ``label`` against time [s], one line per model."""
    ax = new_axes() if ax is None else ax
    t_factor, t_unit = si_prefix(_all(runs, 0), "s")
    y_factor, y_unit = si_prefix(_all(runs, 1), "m")
    for kind, (t, y) in runs.items():
        style = {k: v for k, v in STYLES[kind].items() if k != "marker"}
        ax.plot(t_factor * t, y_factor * y, label=_name(kind), linewidth=1.8, **style)
    ax.set_xlabel(f"time [{t_unit}]")
    # a name from a case is text, also if it holds a $
    ax.set_ylabel(f"{label} [{y_unit}]", parse_math=False)
    _dress(ax, columns=2)
    return ax


def errors(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Predicted worst error [-] against steps per contact; the steps really run are marked.

    ``table`` has columns ``model``, ``steps_per_contact``, ``run`` (bool), ``error_e_n`` and
    ``error_delta_max``.
    """
    ax = new_axes() if ax is None else ax
    for kind, part in table.sort_values("steps_per_contact").groupby("model", sort=False):
        style = STYLES[str(kind)]
        for column, (text, dashes) in _ERRORS.items():
            n = part["steps_per_contact"].to_numpy(dtype=np.float64)
            error = np.abs(part[column].to_numpy(dtype=np.float64))
            shown = error > 0.0  # a logarithmic axis has no zero
            if not shown.any():
                continue
            ax.plot(
                n[shown],
                error[shown],
                color=style["color"],
                linestyle=dashes,
                linewidth=1.8,
                label=f"{_name(str(kind))}, {text}",
            )
            made = shown & part["run"].to_numpy(dtype=bool)
            ax.plot(n[made], error[made], style["marker"], color=style["color"], markersize=8)
    ax.plot([], [], "o", color="0.3", markersize=8, label="as run")
    ax.set_xscale("log")
    ax.set_yscale("log")
    _plain_ticks(ax.xaxis)
    ax.set_xlabel("steps per contact N [–]")
    ax.set_ylabel("predicted worst relative error [–]")
    _dress(ax, columns=2)
    return ax


def _markers_and_lines(
    runs: Mapping[str, Line],
    exact: Mapping[str, Line],
    x_label: tuple[str, str],
    y_label: tuple[str, str],
    ax: Axes | None,
) -> Axes:
    ax = new_axes() if ax is None else ax
    x_factor, x_unit = si_prefix(np.concatenate([_all(runs, 0), _all(exact, 0)]), x_label[1])
    y_factor, y_unit = si_prefix(np.concatenate([_all(runs, 1), _all(exact, 1)]), y_label[1])
    for kind, (x, y) in exact.items():
        style = STYLES[kind]
        ax.plot(
            x_factor * x,
            y_factor * y,
            color=style["color"],
            linestyle=style["linestyle"],
            linewidth=1.6,
            label=f"{_name(kind)}, exact",
        )
    for kind, (x, y) in runs.items():
        style = STYLES[kind]
        ax.plot(
            x_factor * x,
            y_factor * y,
            linestyle="none" if kind in exact else "-",
            linewidth=0.8,
            color=style["color"],
            marker=style["marker"],
            markersize=4.5,
            markerfacecolor="white",
            markeredgecolor=style["color"],
            markevery=max(1, len(x) // _MARKERS),
            label=f"{_name(kind)}, run",
        )
    ax.set_xlabel(f"{x_label[0]} [{x_unit}]")
    ax.set_ylabel(f"{y_label[0]} [{y_unit}]")
    _dress(ax, columns=4)
    return ax


def _drawn(ax: Axes, which: str) -> Array:
    lines = [getattr(line, f"get_{which}data")() for line in ax.get_lines()]
    return np.concatenate([np.zeros(0), *(np.asarray(values, dtype=np.float64) for values in lines)])


def _largest(ax: Axes, which: str) -> float:
    """Largest drawn value, 1 where nothing is above zero: axes need an extent."""
    largest = float(_drawn(ax, which).max(initial=0.0))
    return largest if largest > 0.0 else 1.0


def _all(lines: Mapping[str, Line], which: int) -> Array:
    return np.concatenate([np.zeros(0), *(np.asarray(line[which], dtype=np.float64) for line in lines.values())])


def _name(kind: str) -> str:
    return {"linear": "linear", "hertz": "Hertz"}.get(kind, kind)


def _dress(ax: Axes, columns: int) -> None:
    """Light grid, no box, and the legend above the axes, where it hides nothing."""
    ax.grid(True, which="major", color="0.88", linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    if not ax.get_lines():
        return
    ax.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0, 1.0, 0.1),
        ncols=columns,
        frameon=False,
        fontsize=8.5,
        borderaxespad=0.3,
        columnspacing=1.4,
        handlelength=2.6,
    )


def _plain_ticks(axis: Any) -> None:
    """On a logarithmic axis write 1, 2, 5, 10 as numbers, not as powers, and no minor labels that collide."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(base=10, subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


#: Kind of impacts -> what meets; and the colours of a picture with two kinds.
WHO_MEETS = {"particles": "two particles", "walls": "particle and wall", "all": "all contacts"}
_IMPACT_COLOURS = ("#0072B2", "#D55E00")


def plot_impact_speeds(speeds: Mapping[str, ImpactSpeeds], path: Path, title: str = "") -> None:
    """Draw the shares of impacts per decade of speed, with the three speeds, into a picture (.png or .svg).

    A bin that begins at zero has no place on the logarithmic axis and is left out.

    Raises
    ------
    InputError
        If there was no impact, or the file is not of a kind that is drawn.
    """
    shown = [found for found in speeds.values() if found.count]
    if not shown:
        raise InputError("impact speeds: there was no impact to draw")
    if path.suffix not in (".png", ".svg"):
        raise InputError(f"{path}: expected a picture name that ends in .png or .svg")
    ax = new_axes(6.6, 5.0)
    dashes = dict(zip(STATISTICS, (":", "-", "--"), strict=True))
    for found, colour in zip(shown, _IMPACT_COLOURS, strict=False):
        edges, counts = found.edges[1:], found.counts[1:]
        used = np.flatnonzero(counts)
        part = slice(max(int(used[0]) - 1, 0), int(used[-1]) + 2) if len(used) else slice(0, 1)
        density = counts[part] / found.count / np.diff(np.log10(edges))[part]
        label = f"{WHO_MEETS[found.kind]}, {found.count} impacts"
        ax.stairs(density, edges[part.start : part.start + len(density) + 1], color=colour, label=label, fill=False)
        for name, estimate in found.speeds.items():
            told = f"{STATISTICS[name]} {estimate.value:.3g} m/s"
            ax.axvline(estimate.value, color=colour, linestyle=dashes[name], linewidth=1.2, label=told)
    ax.set_xscale("log")
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("impact speed v_0 [m/s]")
    ax.set_ylabel("share of impacts per decade [–]")
    ax.set_title(title, fontsize=10)
    figure = ax.get_figure(root=True)
    if figure is not None:
        figure.legend(fontsize=8, loc="outside lower center", ncols=len(shown))
        figure.savefig(path, dpi=130, metadata={"Software": None} if path.suffix == ".png" else {"Date": None})
