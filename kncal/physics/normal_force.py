"""The normal force of one contact as a function of overlap and its rate, for integrators."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

#: Overlap [m] and its rate [m/s] -> force [N].
Force = Callable[[float, float], float]


def normal_force(k: float, n: float, c: float, p: float, *, cut: bool = False) -> Force:
    """Return F(delta, delta_dot) = k delta^n + c delta^p delta_dot [N]; if ``cut``, without its attraction."""
    force: Force
    if n == 1.0 and p == 0.0:

        def force(delta: float, rate: float) -> float:
            return k * delta + c * rate

    elif n == 1.5 and (p == 0.25 or c == 0.0):

        def force(delta: float, rate: float) -> float:
            root = sqrt(delta)
            return k * delta * root + c * sqrt(root) * rate

    else:

        def force(delta: float, rate: float) -> float:
            return float(k * delta**n + c * delta**p * rate)

    if cut:
        return lambda delta, rate: max(force(delta, rate), 0.0)
    return force
