"""Flow through an outlet: the discharge curve, its steady part, the rate with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.physics.statistics import MIN_SAMPLES, Average, average, start_up


@dataclass(frozen=True, kw_only=True)
class Discharge:
    """Flow through an outlet.

    Attributes
    ----------
    begin, end : of the steady part [s]
    rate : average over it [kg/s], or [1/s] of a number
    t : (n,) [s]; out : (n,) what passed until then [kg], or their number
    """

    begin: float
    end: float
    rate: Average
    t: Array
    out: Array


def discharge(t: Array, out: Array) -> Discharge:
    """Return the flow of what passed an outlet, ``out`` (n,) [kg] or [-] until ``t`` (n,) [s], evenly spaced.

    The steady part lies between the first and the last that passed. From either end of it is left out what raises the
    marginal standard error of the mean rate (`kncal.physics.statistics.start_up`): the beginning, and the fall when
    the vessel runs empty. The rate is the mean over what is left, its interval that of a correlated signal.

    Raises
    ------
    InputError
        If too little passed for a rate.
    """
    passed = np.flatnonzero(np.diff(out) > 0.0)
    if len(passed) < 2:
        raise InputError("nothing, or too little, passed the outlet: expected a flow")
    first, last = int(passed[0]), int(passed[-1]) + 1
    rate = np.diff(out)[first:last] / np.diff(t)[first:last]
    times = t[first + 1 : last + 1]
    if len(rate) < 2 * MIN_SAMPLES:
        raise InputError(f"{len(rate)} intervals of flow: expected at least {2 * MIN_SAMPLES}; record more often")
    tail = start_up(rate[::-1])
    rate, times = rate[: len(rate) - tail], times[: len(times) - tail]
    head = start_up(rate)
    found = average(times, rate, float(times[head]))
    return Discharge(begin=float(times[head]), end=float(times[-1]), rate=found, t=t, out=out)
