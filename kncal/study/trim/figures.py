"""The two figures of a trim: what each part costs, and how much of its limit its largest effect uses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from kncal.report.page import Figure
from kncal.report.style import Album, bare, new_axes
from kncal.study.trim.trim import (
    EITHER,
    KEEP,
    LEAVE_OUT,
    MATTERS,
    NOT_NEEDED,
    UNDECIDED,
    CostChange,
    PartResult,
    Trim,
    share,
)

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
    costs = [(r, r.cost) for r in found.results if r.cost is not None]
    if costs:
        measured = any(cost.cpu is not None for _, cost in costs)
        spread = any(cost.cpu_low is not None for _, cost in costs)
        rounds = "; lines: smallest and largest of the rounds" if spread else ""
        album.add(
            "cost",
            _cost(costs, measured=measured),
            f"What each part costs in {'CPU time' if measured else 'steps'}{rounds}. {_MEANING}",
            "Bars of the cost of each part.",
        )
    if seen := [r for r, _ in costs if r.effects]:
        album.add(
            "effect",
            _effect(seen, judged=bool(found.tolerances)),
            "The effect of each part that uses most of its limit; lines: its uncertainty. Surely left of the limit:"
            f" without effect. {_MEANING}",
            "Bars of the largest effect of each part over its limit.",
        )
    return tuple(album.figures)


def _axes(results: Sequence[PartResult]) -> Axes:
    ax = new_axes(5.6, 1.3 + 0.36 * len(results))
    ax.set_yticks(range(len(results)), [r.part.name for r in results])
    ax.set_ylim(len(results) - 0.4, -0.6)
    bare(ax)
    return ax


def _bar(ax: Axes, row: int, result: PartResult, value: float, ends: tuple[float, float] | None, left: float) -> None:
    ax.barh(row, value - left, left=left, height=0.6, color=_COLOURS[result.verdict])
    if ends is not None:
        ax.plot(ends, [row, row], color="black", linewidth=1.4)


def _cost(costs: Sequence[tuple[PartResult, CostChange]], *, measured: bool) -> Axes:
    ax = _axes([r for r, _ in costs])
    for row, (result, cost) in enumerate(costs):
        value, low, high = (cost.cpu, cost.cpu_low, cost.cpu_high) if measured else (cost.steps, None, None)
        if value is not None:
            ends = None if low is None or high is None else (100.0 * low, 100.0 * high)
            _bar(ax, row, result, 100.0 * value, ends, 0.0)
    ax.axvline(0.0, color="black", linewidth=0.8)
    ax.set_xlabel(f"cost of having it, % {'CPU time' if measured else 'steps'}")
    return ax


def _effect(results: Sequence[PartResult], *, judged: bool) -> Axes:
    ax = _axes(results)
    ax.set_xscale("log")
    largest = 1.0
    for row, result in enumerate(results):
        used = None if result.worst is None else share(result.worst)
        if result.worst is None or used is None or result.worst.difference.value == 0.0:
            gone = any(effect.verdict == "outside" for effect in result.effects)
            equal = not any(effect.difference.value for effect in result.effects)
            text = "a metric is gone" if gone else "no change at all" if equal else "not known"
            ax.text(1.15 * _SMALLEST, row, text, va="center", fontsize=9, color="#5a6470")
            continue
        low, value, high = (max(used[0] + sign * used[1], _SMALLEST) for sign in (-1.0, 0.0, 1.0))
        _bar(ax, row, result, value, (low, high), _SMALLEST)
        ax.annotate(result.worst.metric, (high, row), (4, 0), textcoords="offset points", va="center", fontsize=9)
        largest = max(largest, high)
    ax.set_xlim(_SMALLEST, 30.0 * largest)
    ax.axvline(1.0, color="black", linewidth=1.0, linestyle=(0, (5, 2)))
    ax.set_xlabel("largest effect over its " + ("tolerance" if judged else "uncertainty"))
    return ax
