"""Flow through an outlet: the discharge curve, its steady part, the rate with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.physics.statistics import MIN_SAMPLES, Average, average, start_up

#: Blocks of the flow in whose means the steady part is looked for.
_BLOCKS = 50


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
    marginal standard error of the mean of blocks (`kncal.physics.statistics.start_up`), and a block more: the
    beginning, and the fall when the vessel runs empty. The rate is the mean over what is left, its interval that of a
    correlated signal.

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
    size = max(len(rate) // _BLOCKS, 1)  # single particles make a rate so noisy that its fall does not show
    blocks = rate[: len(rate) // size * size].reshape(-1, size).mean(axis=1)
    tail = start_up(blocks[::-1])
    head = start_up(blocks[: len(blocks) - tail])
    # a block that is half of the change is worse than one less
    begin, end = (head + bool(head)) * size, (len(blocks) - tail - bool(tail)) * size
    if end - begin < MIN_SAMPLES:
        raise InputError("the flow is never steady: expected a longer one")
    found = average(times[begin:end], rate[begin:end], float(times[begin]))
    return Discharge(begin=float(times[begin]), end=float(times[end - 1]), rate=found, t=t, out=out)
