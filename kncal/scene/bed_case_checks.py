"""What the values of a bed's case file must satisfy together; checks yield (path of the key, what is wrong).

Only contradictions are refused here. What is possible but unwise for the solvers is found by `kncal.scene.limits`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from kncal.core.checks import Array
from kncal.physics.drag import DRAGS
from kncal.physics.statistics import MIN_SAMPLES
from kncal.scene.bed_schema import MOST_CELLS, BedTable
from kncal.scene.case_checks import (
    RIGID,
    Path,
    Problem,
    contact_problems,
    known_name,
    material_problems,
    needs_problems,
    tolerance_problems,
)
from kncal.scene.metrics import COUPLED

#: The names of the two kinds of bodies in the exceptions of a bed.
PARTICLES, WALLS = "particles", "walls"
#: Solids fraction beyond which no random packing of equal spheres goes; lattices are looser.
DENSEST = 0.64


def problems(case: BedTable) -> list[Problem]:
    """Return everything that is wrong with a bed's case file whose single values are of the right form."""
    return [problem for check in _CHECKS for problem in check(case)]


def _materials(case: BedTable) -> Iterator[Problem]:
    yield from material_problems(case.materials)
    for name in (PARTICLES, WALLS):
        if name in case.materials:
            yield ("materials", name), f"{name!r} stands for the bodies of a bed: expected another name"
    yield from known_name(("particles", "material"), case.particles.material, tuple(case.materials))
    yield from known_name(
        ("column", "wall_material"), case.column.wall_material, (*case.materials, RIGID), "wall_material"
    )


def _contact(case: BedTable) -> Iterator[Problem]:
    contact = case.contact
    yield from contact_problems(contact)
    kinds = {PARTICLES: {PARTICLES, case.particles.material}, WALLS: {WALLS, case.column.wall_material}}
    known = sorted(kinds[PARTICLES] | kinds[WALLS])
    for i, choice in enumerate(contact.pairs):
        path: Path = ("contact", "pairs", i)
        for name in choice.between:
            yield from known_name((*path, "between"), name, known)
        if choice.e_n is choice.friction is choice.v_0 is choice.k_n is None:
            yield path, "changes nothing: expected at least one of e_n, friction, v_0, k_n"
        one, two = choice.between
        if {one, two} <= kinds[WALLS] - kinds[PARTICLES]:
            yield (
                (*path, "between"),
                f"between = {choice.between!r}: walls do not touch each other: expected {PARTICLES!r} twice, or "
                f"{PARTICLES!r} and {WALLS!r}",
            )
    if contact.to_be_measured:
        for key, what in (("start", "a first guess of v_0 [m/s]"), ("run_time", "the time to measure over [s]")):
            if contact.measured is None or getattr(contact.measured, key) is None:
                yield ("contact", "measured", key), f"missing: expected {what}: a bed has no first impact"
        time = None if contact.measured is None else contact.measured.run_time
        if time is not None and time < (least := 2 * MIN_SAMPLES * case.run.coupling):
            # at most half of a run is start-up
            yield (
                ("contact", "measured", "run_time"),
                f"run_time = {time:g}: expected at least {2 * MIN_SAMPLES} coupling intervals, {least:g} s",
            )
    particles = case.particles
    needed = particles.count > 0 and (not particles.frozen or particles.packing == "settled")
    if needed and contact.v_0 is None and contact.k_n is None:
        yield (
            ("contact", "v_0"),
            "missing: expected the impact speed to calibrate at [m/s], typical of this bed (0.1 to 1 is usual), or a "
            "prescribed contact.k_n [N/m]: a bed has no first impact to take it from",
        )


def _column(case: BedTable) -> Iterator[Problem]:
    column, particles = case.column, case.particles
    d = particles.diameter
    if (cells := math.prod(column.cells)) > MOST_CELLS:
        yield ("column", "cells"), f"cells = {column.cells}: {cells} in all: expected at most {MOST_CELLS}"
    if column.front_back == "layer" and column.cells[1] != 1:
        yield (
            ("column", "cells"),
            f'cells = {column.cells}: expected one cell in y with front_back = "layer", which has no gas motion in y',
        )
    for key in ("width", "depth", "height"):
        if (size := getattr(column, key)) < d * (1.0 - 1e-9) and particles.count:
            yield ("column", key), f"{key} = {size:g}: expected at least a particle's diameter, {d:g} m"
    volume = particles.count * np.pi / 6.0 * d**3
    box = column.width * column.depth * column.height
    if particles.packing != "given" and volume > DENSEST * box:
        share = volume / box if box > 0.0 else np.inf  # the product of small sides may be 0
        yield (
            ("particles", "count"),
            f"count = {particles.count}: fills {share:.3g} of the column: expected at most {DENSEST:g}",
        )


def _positions(case: BedTable) -> Iterator[Problem]:
    particles, column = case.particles, case.column
    path = ("particles", "positions")
    if particles.settle_k_n is not None and particles.packing != "settled":
        yield ("particles", "settle_k_n"), f'given together with packing = "{particles.packing}": expected "settled"'
    given = len(particles.positions)
    if particles.packing != "given":
        if given:
            yield path, f'given together with packing = "{particles.packing}": expected packing = "given"'
        return
    if given != particles.count:
        yield path, f"{given} of them: expected as many as count, {particles.count}"
        return
    if not given:
        return
    x = np.array(particles.positions, dtype=np.float64)
    outside = ((x <= 0.0) | (x >= (column.width, column.depth, column.height))).any(axis=1)
    for k in np.flatnonzero(outside)[:3]:
        yield (*path, int(k)), f"positions[{k}] = {x[k].tolist()}: expected a centre inside the column"
    off = np.flatnonzero(np.abs(x[:, 1] - 0.5 * column.depth) > 1e-9 * column.depth)
    if column.front_back == "layer" and off.size:
        k = int(off[0])
        yield (*path, k), f"y = {x[k, 1]:g}: expected {0.5 * column.depth:g}, the middle plane of the layer"
    for i, k in _too_close(x, 0.5 * particles.diameter * (1.0 - 1e-12)):
        yield (
            (*path, k),
            f"positions[{k}] = {x[k].tolist()}: overlaps positions[{i}] by more than a radius: expected less",
        )


def _too_close(x: Array, limit: float) -> list[tuple[int, int]]:
    """Return up to three pairs of rows of ``x`` (n, 3) that are closer than ``limit``.

    n particles in one place are n²/2 pairs. So first it is looked for two in one box whose diagonal is the limit; where
    each box holds one at most, few can be close to any.
    """
    boxes = np.floor(x * (math.sqrt(3.0) / limit))
    _, first, places = np.unique(boxes, axis=0, return_index=True, return_inverse=True)
    earlier = first[places.reshape(-1)]
    if len(shared := np.flatnonzero(earlier != np.arange(len(x)))):
        return [(int(earlier[k]), int(k)) for k in shared[:3]]
    from scipy.spatial import cKDTree

    return sorted(cKDTree(x).query_pairs(limit))[:3]


def _gas(case: BedTable) -> Iterator[Problem]:
    gas, particles = case.gas, case.particles
    if gas is None:
        if not particles.count:
            yield ("particles", "count"), "count = 0: neither particles nor gas: expected one of them"
        return
    yield from known_name(("gas", "drag"), gas.drag, DRAGS)
    material = case.materials.get(particles.material)
    if material is not None and material.density <= gas.density:
        yield ("gas", "density"), f"density = {gas.density:g}: expected less than the particles' {material.density:g}"
    ways = {"U_0": gas.U_0 > 0.0, "ramp": bool(gas.ramp), "jet": gas.jet is not None}
    if sum(ways.values()) > 1:
        both = [name for name, used in ways.items() if used]
        yield ("gas", both[-1]), f"given together with {both[0]}: expected one of U_0, ramp and jet"
    times = np.array([point[0] for point in gas.ramp])
    if np.any(np.diff(times) <= 0.0):
        yield ("gas", "ramp"), f"ramp: times {times.tolist()}: expected them to increase"
    if any(velocity > 1e3 for _, velocity in gas.ramp):
        yield ("gas", "ramp"), "ramp: expected [time [s], velocity [m/s]] with velocities up to 1000"
    if (jet := gas.jet) is not None and not jet.x_low < jet.x_high <= case.column.width * (1.0 + 1e-12):
        yield (
            ("gas", "jet", "x_high"),
            f"x_high = {jet.x_high:g}: expected above x_low = {jet.x_low:g} and at most the width, "
            f"{case.column.width:g} m",
        )


def _run(case: BedTable) -> Iterator[Problem]:
    run = case.run
    if run.coupling > run.end_time:
        yield ("run", "coupling"), f"coupling = {run.coupling:g}: expected at most end_time, {run.end_time:g} s"
    if run.gas_step is not None and run.gas_step > run.coupling * (1.0 + 1e-9):
        yield (
            ("run", "gas_step"),
            f"gas_step = {run.gas_step:g}: expected at most the coupling interval, {run.coupling:g} s",
        )
    if run.discard is not None and run.discard >= run.end_time:
        yield ("run", "discard"), f"discard = {run.discard:g}: expected less than end_time, {run.end_time:g} s"
    if case.gravity == 0.0 and case.particles.packing == "settled" and case.particles.count:
        yield ("gravity",), 'gravity = 0: nothing settles: expected packing = "lattice" or "given"'


def _names(case: BedTable) -> Iterator[Problem]:
    yield from tolerance_problems(case.tolerances, COUPLED)
    yield from needs_problems(case.needs)


_CHECKS: tuple[Callable[[BedTable], Iterator[Problem]], ...] = (
    _materials, _contact, _column, _positions, _gas, _run, _names,
)  # fmt: skip
