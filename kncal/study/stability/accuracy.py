"""The accuracy edge: from how many steps per contact on the restitution is right to within 1 %, 5 %.

It lies far below the stability edge, and it is what a time step should be chosen by.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from kncal.core.errors import InputError
from kncal.physics.timestep import predict_error
from kncal.scene.model import PairContact
from kncal.study.stability.edges import Runner, run_builtin
from kncal.study.stability.outcome import REFUSED, Outcome
from kncal.study.stability.probes import Ingredients, Probe, impact_on_wall

#: Errors of e_n whose edges are looked for [-].
ERRORS = (0.01, 0.05)
#: Steps per contact that are tried; below three an impact may pass without a step in it.
NUMBERS = tuple(float(n) for n in np.round(3.0 * 2.0 ** (np.arange(0, 28) / 4.0), 2))


@dataclass(frozen=True, kw_only=True)
class AccuracyEdge:
    """Steps per contact from which on e_n is right to within ``error``, at any sub-step phase tried.

    Attributes
    ----------
    kind : "linear" or "hertz"; e_n : restitution [-]; error : allowed relative error of e_n [-]
    measured : smallest number of steps tried at and above which no error is larger; None: none of them
    predicted : the same by `kncal.physics.timestep.predict_error`
    confirmed : whether LIGGGHTS agrees at ``measured``; None: not asked
    dt : time step at ``measured`` [s]
    """

    kind: str
    e_n: float
    error: float
    measured: float | None
    predicted: float | None
    confirmed: bool | None
    dt: float | None


def duration(probe: Probe) -> float:
    """Return the contact duration of an impact probe [s]."""
    return min(c.t_c for c in probe.model.contacts.values())


def steps_of_impact(probe: Probe, dt: float) -> int:
    """Return the number of steps in which all bodies of an impact probe have met and left each other again."""
    # the latest starts after 1.2 durations (see `kncal.study.stability.probes.impact_on_wall`)
    return max(math.ceil((1.3 + 2.2) * duration(probe) / dt), 12)


def impacts(run: Runner, probe: Probe, steps: Iterable[float]) -> list[Outcome]:
    """Run an impact probe to its end with each of the time steps [s]."""
    return run(probe, [(dt, steps_of_impact(probe, dt)) for dt in steps])


def accuracy_edges(given: Ingredients, kind: str, e_n: float, liggghts: Runner | None = None) -> list[AccuracyEdge]:
    """Return the accuracy edges of one contact, by the builtin engine, each confirmed by LIGGGHTS if there is it."""
    probe = impact_on_wall(given, kind, e_n)
    (contact,) = {c.law: c for (_, other), c in probe.model.named.items() if other == "floor"}.values()
    found = impacts(run_builtin, probe, (contact.t_c / n for n in NUMBERS))
    measured = {n: _error(outcome) for n, outcome in zip(NUMBERS, found, strict=True)}
    predicted = {n: _predicted(contact, n) for n in NUMBERS}
    where = {error: n for error in ERRORS if (n := _from_where(measured, error)) is not None}
    again: dict[float, float] = {}
    if liggghts is not None and where:
        asked = impacts(liggghts, probe, (contact.t_c / n for n in where.values()))
        again = {error: _error(seen) for error, seen in zip(where, asked, strict=True) if seen.code != REFUSED}
    edges = []
    for error in ERRORS:
        seen, expected = where.get(error), _from_where(predicted, error)
        confirmed = again[error] <= error if error in again else None
        edges.append(
            AccuracyEdge(
                kind=kind,
                e_n=e_n,
                error=error,
                measured=seen,
                predicted=expected,
                confirmed=confirmed,
                dt=None if seen is None else contact.t_c / seen,
            )
        )
    return edges


def _predicted(contact: PairContact, steps: float) -> float:
    try:
        return predict_error(contact.law, contact.e_n, steps, contact.end).worst["e_n"]
    except InputError:  # with so few steps strong damping lets the contact never end
        return math.inf


def _error(outcome: Outcome) -> float:
    return abs(outcome.numbers.get("e_n_error", math.inf))


def _from_where(errors: dict[float, float], allowed: float) -> float | None:
    wrong = [n for n, error in errors.items() if error > allowed]
    right = [n for n in errors if n > max(wrong, default=0.0)]
    return min(right, default=None)
