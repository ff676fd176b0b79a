"""Edges of the coupled algorithm, by short runs of a reduced bed: gas step, coupling interval, size of the gas cells.

The runs go past the limits of `kncal.scene.limits` on purpose: they say what happens there, and how far the limits
are from it. Each scan changes one thing; its first run, the finest, is what the others are compared with.
"""

from __future__ import annotations

import hashlib
import math
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import ReadError
from kncal.core.files import write_json
from kncal.core.records import Record, is_record, read_record
from kncal.engines.coupled import Coupled
from kncal.engines.settle import start_positions
from kncal.physics.fluidization import relaxation_time
from kncal.record.series import BedSeries, read_series
from kncal.runs.workflow import require_completed
from kncal.scene.limits import check
from kncal.scene.load import EPS_SETTLED, largest_superficial, settled_height
from kncal.scene.plan import plan
from kncal.scene.scene import Scene

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
    small = scene.with_group(
        count=min(COUNT, scene.group.number), place="settled", position=None, positions=()
    ).with_box(size=(across * edges[0], deep * edges[1], scene.box.height))
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
    if scene.gas is None or scene.group.frozen or scene.group.number < 2 or scene.g == 0.0:
        return []
    small = reduced(scene)
    positions = start_positions(small, tell=tell)
    edges = []
    for name, unit, points, codes in _scans(small, quick=quick):
        runs: list[BedPoint] = []
        finest: dict[str, float] = {}
        for value, setting, changed in points:
            if tell:
                tell(f"{name}: {value:g}")
            there = folder / f"{name.replace(' ', '-')}-{value:g}"
            found = _run(changed, positions, there, transport)
            level = _level(changed, codes)
            point = _point(name, value, setting, unit, level, found, finest)
            finest = finest or dict(point.numbers)
            runs.append(point)
        edges.append(BedEdge(name=name, runs=tuple(runs)))
    return edges


def _scans(scene: Scene, *, quick: bool) -> list[tuple[str, str, list[tuple[float, float, Scene]], tuple[str, ...]]]:
    gas, box, d = scene.gas, scene.box, scene.group.diameter
    assert gas is not None  # noqa: S101  # `bed_edges` sees to it
    speed = largest_superficial(scene) / EPS_SETTLED
    h = box.height / gas.cells[2]
    tau = float(relaxation_time(scene.density, d, gas.density, gas.viscosity, slip=speed, eps_g=EPS_SETTLED))
    step = 0.25 * h / speed
    courant = COURANT[::2] if quick else COURANT
    relaxation = RELAXATION[:-2:2] if quick else RELAXATION
    cells = CELL[::2] if quick else CELL
    longest = courant[-1] * h / speed

    def with_run(coupling: float, gas_step: float) -> Scene:
        # at least four intervals, however long
        end = max(END_TIME, 4.0 * coupling)
        return replace(scene, run=replace(scene.run, coupling=coupling, gas_step=gas_step, until_time=end))

    def with_cells(ratio: float) -> Scene:
        nx, ny, nz = (max(round(size / (ratio * d)), 1) for size in box.size)
        cells = (nx, 1 if scene.layer else ny, nz)
        fine = min(step, 0.25 * ratio * d / speed)
        return replace(with_run(fine, fine), gas=replace(gas, cells=cells))

    return [
        ("gas step", "s", [(c, c * h / speed, with_run(longest, c * h / speed)) for c in courant], ("courant",)),
        (
            "coupling interval",
            "s",
            [(b, b * tau, with_run(b * tau, min(step, b * tau))) for b in relaxation],
            ("relaxation", "particle-way"),
        ),
        ("cell size", "m", [(r, r * d, with_cells(r)) for r in cells], ("cell-size",)),
    ]


def _level(scene: Scene, codes: Sequence[str]) -> str:
    findings = [f for f in check(plan(scene, ("linear",))["linear"]) if f.code in codes]
    if not findings:
        return "ok"
    return f"{findings[0].level}: {', '.join(f.code for f in findings if f.level == findings[0].level)}"


class _Ended(Record):
    """How a run ended: its failure, or its status."""

    status: str
    message: str


def _run(scene: Scene, positions: Array, folder: Path, transport: str) -> tuple[str, str, BedSeries | None]:
    """Status or failure, message, and what is there of the series. Limits are not asked: the run goes past them.

    A run that ended, of the same input, is not run again: its folder's name is a hash of it.
    """
    model = plan(scene, ("linear",))["linear"]
    digest = hashlib.sha256(repr(model).encode() + positions.tobytes()).hexdigest()
    there = folder.with_name(f"{folder.name}-{digest[:12]}")
    record = there / "ended.json"
    if not is_record(_Ended, record):
        if there.exists():  # stopped on its way; this study's own folder
            shutil.rmtree(there)
        there.mkdir(parents=True)
        result = Coupled(transport).run(model, there, start=positions, timeout=_TIMEOUT)
        if result.status in ("interrupted", "not_installed"):
            require_completed([result])
        write_json(record, {"status": result.failure or result.status, "message": result.message})
    ended = read_record(_Ended, record)
    try:
        series: BedSeries | None = read_series(there / "series")
    except ReadError:
        series = None  # it failed before its first coupling was written
    return ended.status, ended.message, series


def _point(
    name: str,
    value: float,
    setting: float,
    unit: str,
    level: str,
    found: tuple[str, str, BedSeries | None],
    finest: Mapping[str, float],
) -> BedPoint:
    status, message, series = found
    numbers: dict[str, float] = {}
    if series is not None and len(series.t):
        late = slice(len(series.t) // 2, None)
        numbers = {
            "pressure": float(np.mean(series.p_in[late])),
            "drag": float(np.mean(series.drag_z[late])),
            "kinetic": float(np.max(series.kinetic_energy)),
            "solids_error": float(np.max(series.solids_error)),
            "courant": float(np.max(series.courant_max)),
        }
        numbers = {k: v for k, v in numbers.items() if math.isfinite(v)}
    outcome, evidence = status, message[:160]
    if status == "completed":
        outcome, evidence = "right", "the finest run"
        if finest:
            ratios = {
                k: numbers[k] / finest[k] for k in ("pressure", "drag", "kinetic") if k in numbers and finest.get(k)
            }
            off = max((abs(ratios[k] - 1.0) for k in ("pressure", "drag") if k in ratios), default=math.inf)
            solids = numbers.get("solids_error", math.inf)
            evidence = (
                f"pressure drop {ratios.get('pressure', math.nan):.3g}, drag {ratios.get('drag', math.nan):.3g}, "
                f"kinetic energy {ratios.get('kinetic', math.nan):.3g} of the finest run; solids error {solids:.2g}"
            )
            if ratios.get("kinetic", math.inf) > BLOWN:
                outcome = "energy-gain"
            elif off > OFF or solids > 1e-6:
                outcome = "off"
    return BedPoint(
        edge=name,
        value=value,
        setting=setting,
        unit=unit,
        level=level,
        outcome=outcome,
        evidence=evidence,
        numbers=numbers,
    )
