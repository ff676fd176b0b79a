"""The impact speeds of two bed runs as their report shows them, beside those that the contacts are calibrated at."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from kncal.core.units import quantity
from kncal.observe.averages import window_start
from kncal.observe.compare import Comparison
from kncal.observe.impact_speeds import (
    KINDS_OF_IMPACTS,
    STATISTICS,
    ImpactSpeeds,
    bed_impact_speeds,
)
from kncal.observe.run_data import BedRunData
from kncal.physics.statistics import Interval
from kncal.report.figures import Figure
from kncal.report.page import Table
from kncal.report.plots import plot_impact_speeds
from kncal.scene.bed_scene import PARTICLES
from kncal.scene.model import BedModel

_PAIRS = {"particles": "two particles", "walls": "particle and wall"}
_RUNS = {"linear": "linear", "hertz": "Hertz"}


@dataclass(frozen=True, kw_only=True)
class SpeedsSection:
    """What the page says of impact speeds.

    Attributes
    ----------
    sentences : that nothing was recorded, or where v_0 is not the speed at which energy arrives
    table : one row per run and pair
    notes : why an interval is not to be relied upon
    figures : a distribution per run
    """

    sentences: tuple[str, ...]
    table: Table
    notes: tuple[str, ...] = ()
    figures: tuple[Figure, ...] = ()


def speeds_section(comparison: Comparison[BedRunData], folder: Path) -> SpeedsSection | None:
    """Return the section, and draw its pictures into ``folder``; None where no particles can meet."""
    sentences: list[str] = []
    rows: list[tuple[str, ...]] = []
    notes: dict[str, None] = {}
    figures: list[Figure] = []
    headings = ("run", "contact of", "impacts", "mean", "energy-weighted", "99 %", "v_0", "")
    for data in (comparison.run, comparison.reference):
        model, kind = data.model, data.model.kind
        if not model.contacts:
            continue
        if not data.series.facts.impact_edges:
            sentences.append(
                f"{_RUNS[kind]}: impact speeds are not recorded in this run, which an earlier kncal made; "
                "the same command with --rerun records them."
            )
            continue
        begin, _, doubt = window_start(data.series, model.scene.run.discard)
        speeds = bed_impact_speeds(data.series, begin, doubt)
        for name in KINDS_OF_IMPACTS:
            rows.append(_row(kind, speeds[name], _v_0(model, name)))
            sentences += _beside(kind, speeds[name], _v_0(model, name))
            notes |= dict.fromkeys(_doubts(kind, speeds[name]))
        if any(found.count for found in speeds.values()):
            figures.append(_figure(kind, speeds, folder))
    if not rows and not sentences:
        return None
    return SpeedsSection(
        sentences=tuple(sentences), table=Table(headings, tuple(rows)), notes=tuple(notes), figures=tuple(figures)
    )


def _v_0(model: BedModel, name: str) -> float | None:
    """Return the speed that the contact of two particles, or of one and a wall, is calibrated at [m/s]."""
    return model.between(PARTICLES, name).v_0


def _row(kind: str, speeds: ImpactSpeeds, v_0: float | None) -> tuple[str, ...]:
    values = [_shown(speeds.speeds.get(name)) for name in STATISTICS]
    given = "–" if v_0 is None else quantity(v_0, "m/s", 3)
    return (_RUNS[kind], _PAIRS[speeds.kind], f"{speeds.count:,}", *values, given, _place(speeds, v_0))


def _place(speeds: ImpactSpeeds, v_0: float | None) -> str:
    """Where v_0 is to the interval of the energy-weighted mean."""
    found = speeds.speeds.get("energy_weighted")
    if found is None or v_0 is None:
        return ""
    return "below" if v_0 < found.low else "above" if v_0 > found.high else "within"


def _beside(kind: str, speeds: ImpactSpeeds, v_0: float | None) -> Iterator[str]:
    place, found = _place(speeds, v_0), speeds.speeds.get("energy_weighted")
    if place in ("below", "above") and found is not None:
        yield (
            f"{_RUNS[kind]}, {_PAIRS[speeds.kind]}: v_0 = {quantity(v_0, 'm/s', 3)} is {place} the energy-weighted"
            f" mean, {_shown(found)}{', not to be relied upon' if found.why else ''}; kncal kn --from-run"
            " says which k_n belongs to it."
        )


def _doubts(kind: str, speeds: ImpactSpeeds) -> Iterator[str]:
    for name, found in speeds.speeds.items():
        if found.why:
            yield f"{_RUNS[kind]}, {_PAIRS[speeds.kind]}, {STATISTICS[name]}: {found.why}"


def _shown(found: Interval | None) -> str:
    if found is None:
        return "–"
    return f"{found.value:.3g} ({found.low:.3g} to {found.high:.3g}) m/s"


def _figure(kind: str, speeds: Mapping[str, ImpactSpeeds], folder: Path) -> Figure:
    name = f"impact_speeds_{kind}"
    for suffix in (".png", ".svg"):
        plot_impact_speeds(speeds, folder / f"{name}{suffix}", title=f"{_RUNS[kind]} run")
    return Figure(
        name=name,
        png=f"{name}.png",
        svg=f"{name}.svg",
        caption=f"{_RUNS[kind]}: share of impacts per decade of speed, with the three speeds of each pair.",
        alt=f"Distribution of impact speeds, {_RUNS[kind]} run.",
    )
