"""Maps of outcomes: what becomes of impacts over the time step and e_n, size ratio, contacts at once, k_n and v_0."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kncal.core.errors import KncalError
from kncal.study.stability.accuracy import impacts
from kncal.study.stability.edges import Runner, run_builtin
from kncal.study.stability.limits import impact_limit
from kncal.study.stability.outcome import Outcome, outcome_of_error
from kncal.study.stability.probes import (
    DIRECTIONS,
    Ingredients,
    Probe,
    impact_of_cluster,
    impact_of_pair,
    impact_on_wall,
)

#: Time steps of the maps over the limit of one contact [-].
STEPS = tuple(float(x) for x in np.round(np.geomspace(0.02, 20.0, 16), 4))
STEPS_QUICK = STEPS[1::3]
RESTITUTIONS = (1.0, 0.9, 0.7, 0.5, 0.3, 0.1)
RATIOS = (1.0, 3.0, 10.0, 30.0, 100.0)
#: Factors on k_n and on v_0 of the case.
SOFTER = (1.0, 1e-2, 1e-4, 1e-6, 1e-8)
FASTER = (1e-3, 1e-2, 0.1, 1.0, 10.0)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One run of a map.

    Attributes
    ----------
    map : "e_n", "contacts", "size_ratio" or "k_n"
    kind, engine : of the run
    x : dt over the limit of one contact (`kncal.study.stability.limits.impact_limit`); of the map "k_n": v_0 [m/s]
    y : e_n, contacts at once, size ratio; of the map "k_n": k_n [N/m]
    dt : [s], None for a model that was refused before it had one
    outcome : Outcome
    """

    map: str
    kind: str
    engine: str
    x: float
    y: float
    dt: float | None
    outcome: Outcome


def outcome_maps(
    given: Ingredients,
    kinds: Sequence[str],
    liggghts: Runner | None = None,
    *,
    quick: bool = False,
    restitutions: Sequence[float] = RESTITUTIONS,
) -> list[Cell]:
    """Return the maps: all by the builtin engine, and one row of each map (in dt) by LIGGGHTS if there is it."""
    case_e = given.contact.e_n
    rows: dict[str, tuple[Callable[[str, float], Probe], Sequence[float], float]] = {
        "e_n": (lambda kind, e_n: impact_on_wall(given, kind, e_n), _with(restitutions, case_e), case_e),
        "size_ratio": (lambda kind, ratio: impact_of_pair(given, kind, case_e, ratio), RATIOS, 10.0),
        "contacts": (lambda kind, z: impact_of_cluster(given, kind, case_e, int(z)), sorted(DIRECTIONS), 12),
    }
    cells = []
    for name, (build, values, asked) in rows.items():
        for kind in kinds:
            for y in values:
                cells += _row(name, build, kind, float(y), liggghts if y == asked else None, quick=quick)
    if "linear" in kinds and given.contact.k_n is None:
        cells += _soft_and_fast(given, quick=quick)
    return cells


def _with(values: Sequence[float], more: float) -> list[float]:
    return sorted({*values, more}, reverse=True)


def _row(
    name: str,
    build: Callable[[str, float], Probe],
    kind: str,
    y: float,
    liggghts: Runner | None,
    *,
    quick: bool,
) -> list[Cell]:
    probe = build(kind, y)
    limit = impact_limit(probe.model)
    # the last two jump over the radius, or right through, in one step
    through = probe.scene.spheres[0].radius / (_speed(probe) * limit)
    shares = [*(STEPS_QUICK if quick else STEPS), *(x for x in (through, 3.0 * through) if x > STEPS[-1])]
    cells = []
    for engine, run in (("builtin", run_builtin), ("liggghts", liggghts)):
        if run is None:
            continue
        for x, outcome in zip(shares, impacts(run, probe, [x * limit for x in shares]), strict=True):
            cells.append(Cell(map=name, kind=kind, engine=engine, x=x, y=y, dt=x * limit, outcome=outcome))
    return cells


def _speed(probe: Probe) -> float:
    """Return the largest speed at the start of a probe [m/s]."""
    return max(float(np.linalg.norm(p.velocity)) for p in probe.scene.spheres)


def _soft_and_fast(given: Ingredients, *, quick: bool) -> list[Cell]:
    """The linear contact at the case's steps per contact, over stiffness and speed."""
    first = impact_on_wall(given, "linear", given.contact.e_n).model.between("s0", "floor")
    cells = []
    for soft in SOFTER[::2] if quick else SOFTER:
        for fast in FASTER[1::2] if quick else FASTER:
            k_n, v_0 = first.k * soft, given.v_0 * fast
            contact = replace(given.contact, k_n=k_n, v_0=v_0, method="mean_overlap", options={}, pairs=())
            dt = None
            try:
                probe = impact_on_wall(replace(given, contact=contact), "linear", contact.e_n)
                dt = probe.model.between("s0", "floor").t_c / given.steps_per_contact
                (outcome,) = impacts(run_builtin, probe, [dt])
            except KncalError as error:
                outcome = outcome_of_error(error)
            cells.append(Cell(map="k_n", kind="linear", engine="builtin", x=v_0, y=k_n, dt=dt, outcome=outcome))
    return cells
