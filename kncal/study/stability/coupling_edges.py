"""Edges of the coupled algorithm, by short runs of a reduced bed: gas step, coupling interval, size of the gas cells.

The runs go past the limits of `kncal.scene.limits` on purpose: they say what happens there, and how far the limits
are from it. Each scan changes one thing; its first run, the finest, is what the others are compared with.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from kncal.core.errors import ReadError
from kncal.engines.settle import start_positions
from kncal.physics.fluidization import relaxation_time
from kncal.record.series import PIECES, read_series
from kncal.scene.case_file import CASE, load_case, write_case
from kncal.scene.limits import check
from kncal.scene.load import EPS_SETTLED, largest_superficial, settled_height
from kncal.scene.plan import plan
from kncal.scene.scene import Scene
from kncal.study.runs import REFUSED, VariantRun, run_variants
from kncal.study.states import WAITING
from kncal.study.sweep import SweepProgress
from kncal.study.variants import Changes, Variant

#: Particles of a reduced bed, its gas cells in x and y, and its simulated time [s].
COUNT, CELLS, END_TIME = 600, (3, 2), 0.05
#: Values of each scan, the finest first: Courant number, coupling interval over relaxation time, cell over diameter.
COURANT = (0.25, 1.0, 2.0, 4.0, 8.0)
RELAXATION = (0.01, 0.05, 0.2, 0.5, 1.0, 2.0)
CELL = (2.5, 1.5, 1.0, 0.75, 0.5)
#: A run is off if its pressure drop or drag differs by more than this from the finest run's ...
OFF = 0.1
#: ... and blows up if it moves with this many times the kinetic energy.
BLOWN = 10.0
#: Wall-clock limit of each run [s].
_TIMEOUT = 300.0


@dataclass(frozen=True, kw_only=True)
class BedPoint:
    """One run of a scan.

    Attributes
    ----------
    edge : name of the scan
    value : Courant number, coupling over relaxation time, or cell edge over diameter [-]
    setting, unit : what was set
    level : what `kncal.scene.limits` says of it: "ok", "warn: codes", "refuse: codes"
    outcome : "right", "off", "energy-gain", or the failure of the run
    evidence : the numbers in words; numbers: means of p_in [Pa] and drag_z [N] in the later half,
        largest kinetic_energy [J], solids_error and courant_max (see `kncal.record.series`)
    """

    edge: str
    value: float
    setting: float
    unit: str
    level: str
    outcome: str
    evidence: str
    numbers: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class BedEdge:
    """A scan: its runs, finest first, and what they say about kncal's limit."""

    name: str
    runs: tuple[BedPoint, ...]

    @property
    def sentence(self) -> str:
        """Say how kncal's limit lies to what happened."""
        wrong = [r for r in self.runs[1:] if r.outcome != "right"]
        refused = [r for r in self.runs if r.level.startswith("refuse")]
        last = "none" if not refused else f"{refused[0].value:g}"
        if not wrong:
            return f"{self.name}: no run went wrong up to {self.runs[-1].value:g}; kncal refuses from {last} on."
        first = wrong[0]
        silent = [r for r in wrong if r.level == "ok"]
        verdict = (
            f"UNSAFE: {silent[0].value:g} passes without a word and is wrong ({silent[0].outcome})"
            if silent
            else "every wrong run is warned of or refused"
        )
        return (
            f"{self.name}: the first wrong run is at {first.value:g} ({first.outcome}: {first.evidence}); kncal "
            f"refuses from {last} on; {verdict}."
        )

    def to_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        return {"name": self.name, "sentence": self.sentence, "runs": [asdict(r) for r in self.runs]}


def reduced(scene: Scene) -> Scene:
    """Return the bed with fewer particles in a smaller column: same particles, gas velocity, cell size and steps."""
    gas = scene.gas
    assert gas is not None  # noqa: S101  # `bed_edges` sees to it
    edges = [size / n for size, n in zip(scene.box.size, gas.cells, strict=True)]
    across = min(CELLS[0], gas.cells[0])
    deep = gas.cells[1] if scene.layer else min(CELLS[1], gas.cells[1])
    small = scene.with_group(count=min(COUNT, scene.number), place="settled", position=None, positions=()).with_box(
        size=(across * edges[0], deep * edges[1], scene.box.height)
    )
    layers = max(math.ceil(2.5 * settled_height(small) / edges[2]), 6)
    return replace(
        small.with_box(size=(*small.box.size[:2], layers * edges[2])),
        name=f"{scene.name[:50]}-reduced",
        gas=replace(gas, U_0=largest_superficial(scene), jet=None, ramp=(), cells=(across, deep, layers)),
        run=replace(scene.run, until_time=END_TIME, discard=None),
    )


def bed_edges(
    scene: Scene,
    folder: Path,
    *,
    transport: str = "auto",
    quick: bool = False,
    tell: Callable[[str], None] | None = None,
) -> list[BedEdge]:
    """Run the scans of a bed with gas and moving particles; none for one that is frozen, or a single particle.

    Raises
    ------
    RunError
        If the packing of the reduced bed fails; `SolverMissingError`, `InterruptedRunError` if a run could not start or
        was stopped. Other failures are what is looked for.
    """
    if scene.gas is None or scene.frozen or scene.number < 2 or scene.g == 0.0:
        return []
    small = reduced(scene)
    # all runs start from one packing, whatever changes
    positions = tuple(tuple(map(float, centre)) for centre in start_positions(small, tell=tell).x)
    small = small.with_group(place="given", count=None, settle_k_n=None, positions=positions)
    case = folder / small.name / CASE
    case.parent.mkdir(parents=True, exist_ok=True)
    write_case(small, case)
    scans = _scans(small, quick=quick)
    ended = _run(case, [step.variant for scan in scans for step in scan.steps], folder / "runs", transport, tell)
    return [_edge(case, scan, ended) for scan in scans]


@dataclass(frozen=True, kw_only=True)
class _Step:
    """One value of a scan [-], what is set by it in the scan's unit, and the variant that is run."""

    value: float
    setting: float
    variant: Variant


@dataclass(frozen=True, kw_only=True)
class _Scan:
    """What changes one thing: ``codes`` are the limits of kncal that speak of it."""

    name: str
    unit: str
    codes: tuple[str, ...]
    steps: list[_Step]


#: From what is set to the changes that set it.
_By = Callable[[float], Changes]


def _scans(scene: Scene, *, quick: bool) -> list[_Scan]:
    gas, box, d = scene.gas, scene.box, scene.diameter
    assert gas is not None  # noqa: S101  # `bed_edges` sees to it
    speed = largest_superficial(scene) / EPS_SETTLED
    h = box.height / gas.cells[2]
    tau = float(relaxation_time(scene.density, d, gas.density, gas.viscosity, slip=speed, eps_g=EPS_SETTLED))
    step = 0.25 * h / speed
    courant = COURANT[::2] if quick else COURANT
    longest = courant[-1] * h / speed

    def scan(name: str, unit: str, codes: tuple[str, ...], values: Sequence[float], size: float, by: _By) -> _Scan:
        called = name.replace(" ", "-")
        variants = [Variant(name=f"{called}-{v:g}", model="linear", changes=by(v * size)) for v in values]
        steps = [_Step(value=v, setting=v * size, variant=made) for v, made in zip(values, variants, strict=True)]
        return _Scan(name=name, unit=unit, codes=codes, steps=steps)

    def run(coupling: float, gas_step: float) -> Changes:
        # at least four intervals, however long
        end = max(END_TIME, 4.0 * coupling)
        return {"run.coupling": coupling, "run.gas_step": gas_step, "run.until_time": end}

    def cells(edge: float) -> Changes:
        nx, ny, nz = (max(round(size / edge), 1) for size in box.size)
        fine = min(step, 0.25 * edge / speed)
        return {**run(fine, fine), "gas.cells": [nx, 1 if scene.layer else ny, nz]}

    relaxation, edges = (RELAXATION[:-2:2], CELL[::2]) if quick else (RELAXATION, CELL)
    of_coupling = ("relaxation", "particle-way")
    return [
        scan("gas step", "s", ("courant",), courant, h / speed, lambda dt: run(longest, dt)),
        scan("coupling interval", "s", of_coupling, relaxation, tau, lambda dt: run(dt, min(step, dt))),
        scan("cell size", "m", ("cell-size",), edges, d, cells),
    ]


def _run(
    case: Path, variants: Sequence[Variant], folder: Path, transport: str, tell: Callable[[str], None] | None
) -> Mapping[str, VariantRun]:
    """Run what has not ended yet, past the limits; how a run failed is a result too, so that none is run twice."""

    def told(_round: int, _rounds: int, _model: str, progress: SweepProgress) -> None:
        if tell:
            tell(f"runs with gas: {progress.done} of {progress.total}")

    run = partial(run_variants, case, folder=folder, transport=transport, timeout=_TIMEOUT, beyond=True)
    there = run(variants, look=True)
    left = [v for v in variants if there[v.name].status in (WAITING, "interrupted", "not_installed")]
    return {**there, **run(left, on_progress=told)}


def _edge(case: Path, scan: _Scan, ended: Mapping[str, VariantRun]) -> BedEdge:
    runs: list[BedPoint] = []
    finest: Mapping[str, float] = {}
    for step in scan.steps:
        run = ended[step.variant.name]
        refused = run.status == REFUSED
        level = "refuse: no case" if refused else _level(load_case(case, overrides=step.variant.overrides), scan.codes)
        found = _point(scan, step, level, run, finest)
        finest = finest or found.numbers
        runs.append(found)
    return BedEdge(name=scan.name, runs=tuple(runs))


def _level(scene: Scene, codes: Sequence[str]) -> str:
    findings = [f for f in check(plan(scene, ("linear",))["linear"]) if f.code in codes]
    if not findings:
        return "ok"
    return f"{findings[0].level}: {', '.join(f.code for f in findings if f.level == findings[0].level)}"


def _numbers(folder: Path | None) -> dict[str, float]:
    """Means and largest values of a run as far as it came; empty if it failed before its first coupling."""
    try:
        series = read_series(folder / PIECES) if folder is not None else None
    except ReadError:
        series = None
    if series is None or not len(series.t):
        return {}
    late = slice(len(series.t) // 2, None)
    numbers = {
        "pressure": float(np.mean(series.p_in[late])),
        "drag": float(np.mean(series.drag_z[late])),
        "kinetic": float(np.max(series.kinetic_energy)),
        "solids_error": float(np.max(series.solids_error)),
        "courant": float(np.max(series.courant_max)),
    }
    return {k: v for k, v in numbers.items() if math.isfinite(v)}


def _point(scan: _Scan, step: _Step, level: str, ended: VariantRun, finest: Mapping[str, float]) -> BedPoint:
    numbers = _numbers(ended.folder)
    if not ended.completed:
        outcome, evidence = ended.failure or ended.status, ended.message[:160]
    elif not finest:
        outcome, evidence = "right", "the finest run"
    else:
        outcome, evidence = _against(finest, numbers)
    return BedPoint(
        edge=scan.name,
        value=step.value,
        setting=step.setting,
        unit=scan.unit,
        level=level,
        outcome=outcome,
        evidence=evidence,
        numbers=numbers,
    )


def _against(finest: Mapping[str, float], numbers: Mapping[str, float]) -> tuple[str, str]:
    """Return the outcome of a completed run against the finest one, and the numbers in words."""
    ratios = {k: numbers.get(k, math.nan) / (finest.get(k) or math.nan) for k in ("pressure", "drag", "kinetic")}
    known = [abs(ratios[k] - 1.0) for k in ("pressure", "drag") if math.isfinite(ratios[k])]
    solids = numbers.get("solids_error", math.inf)
    evidence = (
        f"pressure drop {ratios['pressure']:.3g}, drag {ratios['drag']:.3g}, kinetic energy {ratios['kinetic']:.3g} of"
        f" the finest run; solids error {solids:.2g}"
    )
    if not ratios["kinetic"] <= BLOWN:
        return "energy-gain", evidence
    return ("off" if max(known, default=math.inf) > OFF or solids > 1e-6 else "right"), evidence
