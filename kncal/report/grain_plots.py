"""Pictures of many particles without gas: surfaces, profiles, discharge, mixing, what walls carry.

Every function takes what was observed of each model, and draws on a figure of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.core.units import si_prefix
from kncal.observe.grain_metrics import grain_estimate
from kncal.observe.granular import GrainObservations
from kncal.observe.surface import SurfaceFit, seen_along
from kncal.report.style import STYLES, bare, dress, line_style, model_name, new_axes, panels, shared_legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GrainRuns = Mapping[str, GrainObservations]


def surfaces(runs: GrainRuns) -> Axes:
    """Draw the particles of the last frame measured, seen as for the angle, with surface, flank and line over them."""
    fits = {kind: (seen, seen.fits[-1], next(seen.frames(seen.looked[-1:]))) for kind, seen in runs.items()}
    places = {kind: seen_along(fit, last, seen.space, seen.centre) for kind, (seen, fit, last) in fits.items()}
    wide = max(float(np.ptp(s)) / max(float(np.ptp(h)), 1e-12) for s, h, _ in places.values())
    height = float(np.clip(8.4 / len(runs) / wide + 1.5, 2.3, 5.4))
    axes = panels(1, len(runs), 4.6 * len(runs) + 0.4, height, sharey=True)
    factor, unit = si_prefix(np.concatenate([np.concatenate(place[:2]) for place in places.values()]), "m")
    for ax, (kind, (seen, fit, _)) in zip(axes, fits.items(), strict=True):
        _particles(ax, *(factor * part for part in places[kind]))
        _surface(ax, fit, factor)
        name = "angle_of_repose" if seen.resting else "dynamic_angle"
        found = grain_estimate(seen, name)
        width = "" if found.width is None else f" ± {found.width:.2g}"
        ax.set_title(f"{model_name(kind)}: {found.value:.3g}{width}°", fontsize=10)
        ax.set_aspect("equal")
        bare(ax)
        ax.set_xlabel(f"across [{unit}]")
    axes[0].set_ylabel(f"height [{unit}]")
    shared_legend(axes, 3)
    return axes[0]


def _particles(ax: Axes, s: Array, h: Array, radius: Array) -> None:
    from matplotlib.collections import EllipseCollection

    drawn = EllipseCollection(
        2.0 * radius, 2.0 * radius, 0.0, units="xy", offsets=np.column_stack([s, h]), offset_transform=ax.transData,
        facecolors="0.85", edgecolors="0.6", linewidths=0.3, rasterized=True,
    )  # fmt: skip
    ax.add_collection(drawn)
    most = 2.0 * float(radius.max())
    ax.set_xlim(s.min() - most, s.max() + most)
    ax.set_ylim(h.min() - most, h.max() + most)


def _surface(ax: Axes, fit: SurfaceFit, factor: float) -> None:
    ax.plot(factor * fit.s, factor * fit.h, ".", color="0.35", markersize=4, label="surface: half the bulk's density")
    s, h = fit.s[fit.fitted], fit.h[fit.fitted]
    ax.plot(factor * s, factor * h, ".", color="#0072B2", markersize=5, label="fitted")
    ends = np.array([s.min(), s.max()])
    ends += np.array([-0.15, 0.15]) * np.ptp(ends)
    ax.plot(factor * ends, factor * (fit.offset + fit.slope * ends), "-", color="#D55E00", linewidth=2.0, label="line")


def profiles(runs: GrainRuns) -> Axes:
    """Draw solids fraction, velocity, shear rate and granular temperature along the axis of the case."""
    found = {kind: seen.profile for kind, seen in runs.items()}
    first = next(iter(found.values()))
    moving = any(not seen.resting for seen in runs.values())
    flow = first.flow
    columns: list[tuple[str, Any]] = [("solids fraction [–]", lambda p: p.fraction)]
    if moving:
        columns += [
            (f"v_{'xyz'[flow]} [m/s]", lambda p: p.velocity[:, flow]),
            ("shear rate [1/s]", lambda p: p.shear_rate[:, flow]),
            ("temperature [m²/s²]", lambda p: p.temperature),
        ]
    axes = panels(1, len(columns), 1.2 + 2.1 * len(columns), 3.6, sharey=True)
    factor, unit = si_prefix(first.at, "m")
    for ax, (label, values) in zip(axes, columns, strict=True):
        for kind, one in found.items():
            there = label.startswith("solids") | (one.fraction > 0.05 * one.fraction.max())  # few show chance only
            x = np.where(there, values(one), np.nan)
            ax.plot(x, factor * one.at, label=model_name(kind), linewidth=1.6, **line_style(kind))
            if label.startswith("v_"):
                half = one.spread[:, flow]
                ax.fill_betweenx(
                    factor * one.at, x - half, x + half, color=STYLES[kind]["color"], alpha=0.2, linewidth=0
                )
        bare(ax)
        ax.set_xlabel(label)
    axes[0].set_ylabel(f"{'xyz'[first.axis]} [{unit}]")
    filled = np.concatenate([one.at[one.fraction > 1e-3 * one.fraction.max()] for one in found.values()])
    axes[0].set_ylim(factor * filled.min(), factor * filled.max())
    shared_legend(axes, 2)
    return axes[0]


def discharge_curves(runs: GrainRuns) -> Axes:
    """Draw what passed the outlets against time; thick: the steady part, whose slope is the mass flow rate."""
    ax = new_axes()
    factor, unit = si_prefix(np.concatenate([seen.flow.out for seen in runs.values()]) * 1e3, "g")
    for kind, seen in runs.items():
        flow, style = seen.flow, line_style(kind)
        rate, half = flow.rate.mean, flow.rate.uncertainty
        ax.plot(flow.t, 1e3 * factor * flow.out, linewidth=1.0, **style)
        inside = (flow.t >= flow.begin) & (flow.t <= flow.end)
        label = f"{model_name(kind)}: {1e3 * rate:.4g} ± {1e3 * half:.2g} g/s"
        ax.plot(flow.t[inside], 1e3 * factor * flow.out[inside], linewidth=3.0, label=label, **style)
    return dress(ax, "time [s]", f"mass that passed [{unit}]", columns=1)


def mixing_curves(runs: GrainRuns) -> Axes:
    """Draw Lacey's index against time, one standard deviation of a frame, and the mixing time."""
    ax = new_axes()
    for kind, seen in runs.items():
        curve, style = seen.mixing, line_style(kind)
        ax.plot(curve.t, curve.lacey, linewidth=1.6, label=model_name(kind), **style)
        ax.fill_between(
            curve.t, curve.lacey - curve.error, curve.lacey + curve.error, color=style["color"], alpha=0.2, linewidth=0
        )
        time = grain_estimate(seen, "mixing_time")
        if time.value is not None:
            ax.axvline(
                time.value,
                color=style["color"],
                linewidth=1.0,
                linestyle=(0, (2, 2)),
                label=f"90 %: {time.value:.3g} s",
            )
    ax.axhline(1.0, color="0.35", linewidth=0.8, zorder=1)
    ax.set_ylim(min(0.0, ax.get_ylim()[0]), max(1.05, ax.get_ylim()[1]))
    return dress(ax, "time [s]", "Lacey's mixing index [–]")


def wall_loads(runs: GrainRuns) -> Axes:
    """Draw the force through each cross-section against height, Janssen's law as fitted, and the weight above it."""
    if not all(seen.resting for seen in runs.values()):
        raise InputError("particles move: expected a filling at rest")
    axes = panels(1, 2, 7.6, 3.8, sharey=True)
    every = list(runs.values())
    factor, unit = si_prefix(np.concatenate([seen.silo.edges for seen in every]), "m")
    force, newton = si_prefix(np.concatenate([np.abs(seen.silo.through) for seen in every]), "N")
    for kind, seen in runs.items():
        found, style = seen.silo, line_style(kind)
        below = found.edges <= found.top
        depth = found.top - found.edges[below]
        ends = factor * found.edges
        axes[0].plot(
            force * found.through,
            ends,
            STYLES[kind]["marker"],
            markersize=4,
            color=style["color"],
            label=model_name(kind),
        )
        if np.isfinite(found.length):
            law = force * found.limit * (1.0 - np.exp(-depth / found.length))
            axes[0].plot(law, ends[below], linewidth=1.4, label=f"Janssen, λ = {1e3 * found.length:.3g} mm", **style)
        axes[0].plot(
            force * found.limit / found.length * depth, ends[below], linewidth=0.9, color="0.5", linestyle=(0, (2, 2))
        )
        middle = 0.5 * (ends[1:] + ends[:-1])
        axes[1].plot(found.carried / np.diff(found.edges), middle, linewidth=1.4, **style)
    for ax, label in zip(
        axes, (f"force through the cross-section [{newton}]", "on the walls, per height [N/m]"), strict=True
    ):
        bare(ax)
        ax.set_xlabel(label)
    axes[0].set_ylabel(f"height [{unit}]")
    axes[0].set_ylim(top=factor * 1.1 * max(seen.silo.top for seen in every))
    shared_legend(axes, 4)
    return axes[0]
