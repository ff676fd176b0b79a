"""What must hold in every bed run whatever its contacts: momentum, mass, resolution; each with its limit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.observe.run_data import RunData
from kncal.record.series import BedSeries
from kncal.record.steps import NOT_PASSED_LIMIT, REACTION_LIMIT
from kncal.scene.gas_limits import COURANT_LARGEST

#: Relative error of the solid volume in the void fraction field: rounding only, unless the solver's floor clips it.
SOLIDS_LIMIT = 1e-9
#: The floor of the void fraction in DPMFoam's cloud: what reaches it loses solid volume.
EPS_G_FLOOR = 0.1
#: Closure of the weight balance, as a share of the weight.
BALANCE_LIMIT = 0.01


@dataclass(frozen=True, kw_only=True)
class Invariant:
    """One invariant in both runs.

    Attributes
    ----------
    name, text : of it; run, reference : the worst value of each, None if it has none (or one that is not a number)
    limit : allowed, ``at_least`` says on which side
    holds : in both runs
    """

    name: str
    text: str
    run: float | None
    reference: float | None
    limit: float
    at_least: bool
    holds: bool


def invariants(run: RunData, reference: RunData) -> tuple[Invariant, ...]:
    """Check the invariants of two runs, start-up included; the balance is that of the averages.

    There are none of runs without signals.
    """
    runs = (run, reference)
    series = [each.signals for each in runs if each.signals is not None]
    if len(series) < 2:
        return ()

    def largest(name: str) -> Callable[[BedSeries], float | None]:
        return lambda one: _extreme(getattr(one, name), np.max)

    rows = [
        ("reaction_error", "momentum booked on the particles and on the gas differs by, of the weight", REACTION_LIMIT),
        ("not_passed", "momentum that the gas received and no particle was given, of the weight", NOT_PASSED_LIMIT),
        ("solids_error", "solid volume in the void fraction field against that of the particles", SOLIDS_LIMIT),
        ("courant_max", "Courant number of the gas step (coarse in time above 1)", COURANT_LARGEST),
    ]
    checked = [_invariant(name, text, [largest(name)(s) for s in series], limit) for name, text, limit in rows]
    lowest = [_extreme(s.eps_g_min, np.min) for s in series]
    checked.insert(3, _invariant("eps_g_min", "smallest void fraction", lowest, EPS_G_FLOOR, at_least=True))
    balances = [each.estimate("weight_closure").value for each in runs]
    closures = [None if b is None else abs(b) for b in balances]
    text = "weight balance: |Δp A + floor + walls − weight − change of momentum|, of the weight, time average"
    checked.append(_invariant("weight_closure", text, closures, BALANCE_LIMIT))
    grains = [each.grains for each in runs]
    supports = [each.estimate("support").value for each in runs]
    at_rest = [
        None if g is None or s is None or not g.resting else abs(s - 1.0) for g, s in zip(grains, supports, strict=True)
    ]
    checked.append(
        _invariant("support", "at rest, |force on all walls − weight|, of the weight", at_rest, BALANCE_LIMIT)
    )
    return tuple(checked)


def _extreme(values: Array, of: Callable[..., float]) -> float | None:
    """Largest or smallest value, NaN if one of them is; None where the run has none."""
    if np.isnan(values).all():
        return None
    return float(of(values))


def _invariant(name: str, text: str, values: list[float | None], limit: float, *, at_least: bool = False) -> Invariant:
    first, second = (v if v is not None and np.isfinite(v) else None for v in values)
    known = [v for v in values if v is not None]
    holds = all(v > limit if at_least else v <= limit for v in known)  # False for NaN
    return Invariant(name=name, text=text, run=first, reference=second, limit=limit, at_least=at_least, holds=holds)
