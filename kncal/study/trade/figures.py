"""The figures of a trade: the Pareto front, where the error comes from, the law of cost."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.report.page import Figure
from kncal.report.style import (
    STYLES,
    Album,
    bare,
    dress,
    line_style,
    log_axes,
    model_name,
    new_axes,
    panels,
    shared_legend,
)
from kncal.study.trade.cost_law import LAW, Law
from kncal.study.trade.front import Conclusion, cost, worst_ratio
from kncal.study.trade.trade import ErrorSplit, Trade, TradePoint

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Part of an error -> (colour, dashes, text).
_PARTS: Mapping[str, tuple[str, Any, str]] = {
    "softness": ("#0072B2", "-", "softness (k_n or modulus)"),
    "model": ("#D55E00", (0, (5, 2)), "model (linear against Hertz)"),
}
#: Markers of the discretisation at each N.
_MARKS = ("o", "s", "^", "D", "v", "P")
#: Panels of the figure of the split.
_MOST_METRICS = 3
#: A zero on a logarithmic axis is drawn here: below it nothing matters.
_FLOOR = 1e-6


def draw_trade_figures(trade: Trade, conclusion: Conclusion, laws: Sequence[Law], folder: Path) -> tuple[Figure, ...]:
    """Write every figure that the data allow into ``folder``, as PNG and SVG."""
    album = Album(folder)
    album.add(
        "front",
        front(trade, conclusion),
        "Each point is one contact at one number of steps per contact. Its height is the worst error over its "
        "tolerance, uncertainty included; the thin bar goes down to the error as measured. Below the line at 1 "
        "a point is surely within. No point is both cheaper and more accurate than those on the grey line.",
        "Largest error over tolerance against cost, with the Pareto front.",
    )
    album.add(
        "split",
        split(trade),
        "Where the error comes from: the softness (against the factor of k_n or of the modulus), the model (linear "
        "against Hertz), and the discretisation (a line for each number of steps per contact). The dashed grey line is "
        "the tolerance.",
        "Parts of the error against the factor of the stiffness.",
    )
    album.add(
        "law",
        law(laws),
        "Cost against stiffness at one number of steps per contact. The steps follow k_n^(1/2) (grey). The CPU time "
        f"does so where the steps cost more than {trade.fixed}. Bars: smallest and largest time.",
        "Steps and CPU time against stiffness.",
    )
    return tuple(album.figures)


def front(trade: Trade, conclusion: Conclusion) -> Axes | None:
    """Worst error/tolerance against cost, with the front; None without a point."""
    ax = new_axes(5.6, 4.4)
    names = {p.candidate.name: p for p in trade.points if p.completed}
    drawn = False
    for model in ("linear", "hertz"):
        ours = [p for p in names.values() if p.candidate.model == model and cost(trade, p) is not None]
        ours = [p for p in ours if worst_ratio(p) < math.inf]
        if not ours:
            continue
        drawn = True
        x = [cost(trade, p) or 0.0 for p in ours]
        y = [max(worst_ratio(p), _FLOOR) for p in ours]
        down = [ratio - max(min(_seen(p), ratio), _FLOOR) for p, ratio in zip(ours, y, strict=True)]
        bars = np.array([down, np.zeros(len(y))])
        ax.errorbar(x, y, bars, label=model_name(model), markersize=4.5, elinewidth=0.7, alpha=0.85, **_points(model))
    if not drawn:
        return None
    on = [names[name] for name in conclusion.front]
    x, y = [cost(trade, p) or 0.0 for p in on], [max(worst_ratio(p), _FLOOR) for p in on]
    ax.plot(x, y, color="0.6", linewidth=1.2, drawstyle="steps-post", zorder=0, label="front")
    if conclusion.chosen is not None:
        x_0, y_0 = cost(trade, conclusion.chosen) or 0.0, worst_ratio(conclusion.chosen)
        ax.plot([x_0], [max(y_0, _FLOOR)], "o", markersize=13, markerfacecolor="none", color="k", label="chosen")
    ax.axhline(1.0, color="0.3", linewidth=1.0, linestyle=(0, (2, 2)), label="tolerance")
    log_axes(ax)
    x_label = {"cpu_seconds": "CPU time [s]", "steps": "steps [–]"}[trade.cost]
    return dress(ax, x_label, "(|error| + uncertainty) / tolerance [–]", columns=3)


def _points(kind: str) -> dict[str, Any]:
    return {"fmt": STYLES[kind]["marker"], "color": STYLES[kind]["color"]}


def _seen(point: TradePoint) -> float:
    """Largest abs(error)/tolerance as measured, without the uncertainty."""
    return max(abs(row.difference.value or 0.0) / (row.tolerance or math.inf) for row in point.judged.values())


def split(trade: Trade) -> Axes | None:
    """Parts of the error against the factor of the stiffness: a panel per model and judged metric."""
    # those with a panel: the metrics that a tolerance judges and a split is known of, the tightest first
    known = {s.metric for splits in trade.splits.values() for s in splits}
    metrics = sorted((m for m in trade.tolerances if m in known), key=lambda m: trade.tolerances[m])[:_MOST_METRICS]
    models = [m for m in ("linear", "hertz") if any(p.candidate.model == m for p in trade.points)]
    if not metrics or not models:
        return None
    size = 4.4 * len(models), 2.9 * len(metrics) + 0.6
    axes = panels(len(metrics), len(models), *size, sharex=True)
    for ax, (metric, model) in zip(axes, product(metrics, models), strict=True):
        _split_panel(ax, trade, model, metric)
        ax.set_title(f"{metric}, {model_name(model)}", fontsize=10, loc="left")
        if metric == metrics[-1]:
            ax.set_xlabel("factor of k_n or of the modulus [–]")
        if model == models[0]:
            ax.set_ylabel("|part of the error| [–]")
    shared_legend(axes, columns=2 * len(models))
    return axes[0]


def _split_panel(ax: Axes, trade: Trade, model: str, metric: str) -> None:
    by_factor = ("softened", "reduced_modulus")
    ours = [
        (p.candidate.factor, p.candidate.steps_per_contact, s)
        for p in trade.points
        if p.candidate.model == model and p.candidate.factor is not None
        if p.candidate.how in by_factor or p.candidate.factor == 1.0
        for s in trade.splits.get(p.candidate.name, ())
        if s.metric == metric
    ]

    def draw(name: str, n: float | None, **style: Any) -> None:
        values = {f: _size(s, name) for f, steps, s in ours if (n is None or steps == n)}
        # a part that is zero (the unsoftened contact is not softer) has no place on a logarithmic axis
        x = sorted(f for f, value in values.items() if value is not None and value > _FLOOR)
        if x:
            ax.plot(x, [values[f] or 0.0 for f in x], linewidth=1.5, markersize=4, **style)

    for name, (colour, dashes, text) in _PARTS.items():
        draw(name, None, color=colour, linestyle=dashes, marker="o", label=text)
    for k, n in enumerate(sorted({n for _, n, _ in ours})):
        mark, dashes = _MARKS[k % len(_MARKS)], (0, (1, 1.5))
        text = f"discretisation, N = {n:g}"
        draw("discretisation", n, color="#009E73", linestyle=dashes, marker=mark, label=text, markerfacecolor="white")
    ax.axhline(trade.tolerances[metric], color="0.4", linewidth=1.0, linestyle=(0, (2, 2)), label="tolerance")
    log_axes(ax)
    ax.margins(x=0.14)
    bare(ax)


def _size(found: ErrorSplit, part: str) -> float | None:
    known = found.parts[part]
    return None if known is None or known.value is None else abs(known.value)


def law(laws: Sequence[Law]) -> Axes | None:
    """Steps and CPU time against stiffness, with the law; None without a family."""
    if not laws:
        return None
    left, right = panels(1, 2, 9.0, 3.9)
    for found in laws:
        style = STYLES[found.family]
        text = f"{model_name(found.family)}, N = {found.steps_per_contact:g}"
        k = np.asarray(found.k_n)
        left.plot(k, found.steps, style["marker"], color=style["color"], markersize=5, label=text)
        cpu = np.asarray(found.cpu_seconds)
        timed = np.isfinite(cpu)
        if timed.any():
            spread = np.abs(np.asarray(found.cpu_range)[timed].T - cpu[timed])
            right.errorbar(
                k[timed], cpu[timed], spread, label=text, markersize=5, elinewidth=0.8, **_points(found.family)
            )
        if found.fit is not None:
            order = np.argsort(k)
            steps = np.asarray(found.steps, dtype=np.float64)
            start, per_step = found.fit.start.value or 0.0, found.fit.per_step.value or 0.0
            fitted = (start + per_step * steps)[order]
            label = f"{text}: fitted"
            right.plot(k[order], fitted, linewidth=1.0, label=label, **line_style(found.family))
    k = np.asarray(laws[0].k_n)
    middle = len(k) // 2
    left.plot(
        k, laws[0].steps[middle] * (k / k[middle]) ** LAW, color="0.6", linewidth=1.0, zorder=0, label="k_n^(1/2)"
    )
    for ax, label in ((left, "steps [–]"), (right, "CPU time [s]")):
        log_axes(ax)
        ax.set_xlabel("stiffness k_n, of Hertz the secant [N/m]")
        ax.set_ylabel(label)
        bare(ax)
    shared_legend((left, right), columns=3)
    return left
