"""The two figures of a trim: what each part costs, and how much of its limit its largest effect uses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from kncal.report.page import Figure
from kncal.report.style import Album, new_axes
from kncal.study.trim.trim import EITHER, KEEP, LEAVE_OUT, MATTERS, NOT_NEEDED, UNDECIDED, PartResult, Trim, share

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FREE, _KEPT, _OPEN = "#009E73", "#D55E00", "#E69F00"
_COLOURS = {LEAVE_OUT: _FREE, NOT_NEEDED: _FREE, EITHER: _FREE, KEEP: _KEPT, MATTERS: _KEPT, UNDECIDED: _OPEN}
_MEANING = "Green: the scene can do without; red: it matters; yellow: undecided."
#: Smaller shares of a limit than this are drawn at it.
_SMALLEST = 1e-4


def draw_figures(found: Trim, folder: Path) -> tuple[Figure, ...]:
    """Write the figures that the results allow into ``folder``, as PNG and SVG."""
    album = Album(folder)
    run = [r for r in found.results if r.cost is not None]
    if run:
        measured = any(r.cost is not None and r.cost.cpu is not None for r in run)
        spread = any(r.cost is not None and r.cost.cpu_low is not None for r in run)
        rounds = "; lines: smallest and largest of the rounds" if spread else ""
        album.add(
            "cost",
            _cost(run),
            f"What each part costs in {'CPU time' if measured else 'steps'}{rounds}. {_MEANING}",
            "Bars of the cost of each part.",
        )
    if with_share := [r for r in run if r.effects]:
        album.add(
            "effect",
            _effect(with_share, judged=bool(found.tolerances)),
            "The effect of each part that uses most of its limit; lines: its uncertainty. Surely left of the limit:"
            f" without effect. {_MEANING}",
            "Bars of the largest effect of each part over its limit.",
        )
    return tuple(album.figures)


def _axes(results: Sequence[PartResult]) -> Axes:
    ax = new_axes(5.6, 1.3 + 0.36 * len(results))
    ax.set_yticks(range(len(results)), [r.part.name for r in results])
    ax.set_ylim(len(results) - 0.4, -0.6)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    ax.grid(axis="x", color="#d5d9de", linewidth=0.6)
    ax.set_axisbelow(True)
    return ax


def _cost(results: Sequence[PartResult]) -> Axes:
    ax = _axes(results)
    measured = any(r.cost is not None and r.cost.cpu is not None for r in results)
    for row, result in enumerate(results):
        cost = result.cost
        if cost is None:
            continue
        value = cost.cpu if measured else cost.steps
        if value is None:
            continue
        ax.barh(row, 100.0 * value, height=0.6, color=_COLOURS[result.verdict])
        if measured and cost.cpu_low is not None and cost.cpu_high is not None:
            ax.plot([100.0 * cost.cpu_low, 100.0 * cost.cpu_high], [row, row], color="black", linewidth=1.4)
    ax.axvline(0.0, color="black", linewidth=0.8)
    ax.set_xlabel(f"cost of having it, % {'CPU time' if measured else 'steps'}")
    return ax


def _effect(results: Sequence[PartResult], *, judged: bool) -> Axes:
    ax = _axes(results)
    ax.set_xscale("log")
    largest = 1.0
    for row, result in enumerate(results):
        worst = result.worst
        used = None if worst is None else share(worst)
        if worst is None or used is None or worst.difference.value == 0.0:
            gone = any(row.verdict == "outside" for row in result.effects)
            equal = all(not row.difference.value for row in result.effects if row.seen)
            text = "a metric is gone" if gone else "no change at all" if equal else "not known"
            ax.text(1.15 * _SMALLEST, row, text, va="center", fontsize=9, color="#5a6470")
            continue
        size, width = max(used[0], _SMALLEST), used[1]
        ax.barh(row, size - _SMALLEST, left=_SMALLEST, height=0.6, color=_COLOURS[result.verdict])
        if width > 0.0:
            ends = [max(used[0] - width, _SMALLEST), max(used[0] + width, _SMALLEST)]
            ax.plot(ends, [row, row], color="black", linewidth=1.4)
        ax.annotate(
            worst.metric,
            (max(size, used[0] + width), row),
            (4, 0),
            textcoords="offset points",
            va="center",
            fontsize=9,
        )
        largest = max(largest, used[0] + width)
    ax.set_xlim(_SMALLEST, 30.0 * largest)
    ax.axvline(1.0, color="black", linewidth=1.0, linestyle=(0, (5, 2)))
    ax.set_xlabel("largest effect over its " + ("tolerance" if judged else "uncertainty"))
    return ax
