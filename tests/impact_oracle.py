"""An independent solution of one impact: the equation of motion in time, DOP853, events; forces written out here."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

Force = Callable[[float, float, float], float]


def _hertz(p: float) -> Force:
    return lambda x, v, C: math.copysign(abs(x) ** 1.5, x) + C * abs(x) ** p * v


FORCES: dict[str, Force] = {
    "linear": lambda x, v, C: x + C * v,
    "hertz": lambda x, v, C: math.copysign(abs(x) ** 1.5, x),
    "tsuji": _hertz(0.25),
    "kuwabara_kono": _hertz(0.5),
    "hunt_crossley": _hertz(1.5),
}


def collide(force: Force, C: float, end: str, until: float) -> dict[str, float]:
    """e_n, x_max, tau_c, x_mean, x_end and the work of the dashpot, from x = 0, x_dot = 1; gives up at ``until``."""

    def rate(_: float, s: np.ndarray) -> list[float]:
        elastic = force(s[0], 0.0, C)
        total = force(s[0], s[1], C)
        return [s[1], -total, s[0], (total - elastic) * s[1]]

    def turn(_: float, s: np.ndarray) -> float:
        return s[1]

    def apart(_: float, s: np.ndarray) -> float:
        return s[0]

    def no_force(_: float, s: np.ndarray) -> float:
        return force(s[0], s[1], C)

    for event in (turn, apart, no_force):
        event.direction = -1.0
    options = {"method": "DOP853", "rtol": 3e-14, "atol": 1e-16}
    last = apart if end == "overlap" else no_force
    turn.terminal = last.terminal = True
    first = solve_ivp(rate, (0.0, until), [0.0, 1.0, 0.0, 0.0], events=turn, first_step=1e-12, **options)
    t_top, top = first.t_events[0][0], first.y_events[0][0]
    second = solve_ivp(rate, (t_top, until), top, events=last, **options)
    t_end, state = second.t_events[0][0], second.y_events[0][0]
    return {
        "e_n": -state[1],
        "x_max": top[0],
        "tau_c": t_end,
        "x_mean": state[2] / t_end,
        "x_end": state[0],
        "work": state[3],
    }
