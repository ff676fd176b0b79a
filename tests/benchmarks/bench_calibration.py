"""How fast is a calibration? 1e6 random pairs at once, next to integrating each impact as an ODE.

Run: .venv/bin/python tests/benchmarks/bench_calibration.py [pairs]
CPU seconds of this process; the ODE route is timed on a sample and both are given per calibration.
"""

from __future__ import annotations

import os
import sys
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from scipy.integrate import solve_ivp

import kncal
from kncal.physics.laws import LAWS
from kncal.physics.methods import METHODS

OPTIONS = {
    "limited_overlap": {"fraction": 0.01},
    "contact_time": {"t_c": 1e-6},
    "static_load": {"force": 1e-3},
}
SAMPLE = 40


def random_inputs(rng: np.random.Generator, count: int) -> tuple[kncal.Pair, np.ndarray, np.ndarray]:
    material = kncal.Material(young=10 ** rng.uniform(9.0, 11.5, count), poisson=0.25, density=2500.0)
    radius_1, radius_2 = (10 ** rng.uniform(-4.0, -2.0, count) for _ in range(2))
    pair = kncal.pair(material, radius_1, material, radius_2)
    return pair, 10 ** rng.uniform(-3.0, 0.0, count), rng.uniform(0.05, 1.0, count)


def by_ode(pair: kncal.Pair, v_0: float, C: float, p: float) -> float:
    """Mean overlap of one Tsuji, Kuwabara–Kono or Hunt–Crossley impact by DOP853 with an event (C is given)."""

    def rhs(_: float, y: np.ndarray) -> list[float]:
        x = max(y[0], 0.0)
        return [y[1], -(x**1.5 + C * x**p * y[1]), y[0]]

    def separated(_: float, y: np.ndarray) -> float:
        return y[0]

    separated.terminal, separated.direction = True, -1  # type: ignore[attr-defined]
    out = solve_ivp(rhs, (0.0, 100.0), [0.0, 1.0, 0.0], "DOP853", events=separated, rtol=1e-10, atol=1e-12)
    length = (pair.m_eff * v_0**2 / pair.k_h) ** 0.4
    return float(out.y[2, -1] / out.t[-1] * length)


def main() -> None:
    count = int(float(sys.argv[1])) if len(sys.argv) > 1 else 1_000_000
    rng = np.random.default_rng(1)
    pair, v_0, e_n = random_inputs(rng, count)
    print(f"{count} random pairs, v_0 and e_n; CPU seconds, first use builds the law's table")
    print(f"{'law':>16} {'method':>20} {'end':>8} {'first':>8} {'again':>8}")
    kncal.calibrate(kncal.pair(kncal.Material(young=1e9, poisson=0.25, density=2500.0), 1e-3), v_0=1.0, e_n=1.0)
    combinations = [(law, "mean_overlap", end) for law in LAWS for end in ("overlap", "force")]
    combinations += [("tsuji", method, "overlap") for method in METHODS if method != "mean_overlap"]
    again = 0.0
    for law, method, end in combinations:
        times = []
        for _ in range(2):
            start = time.process_time()
            kncal.calibrate(pair, v_0=v_0, e_n=e_n, law=law, method=method, end=end, **OPTIONS.get(method, {}))
            times.append(time.process_time() - start)
        print(f"{law:>16} {method:>20} {end:>8} {times[0]:8.3f} {times[1]:8.3f}")
        if (law, method, end) == ("tsuji", "mean_overlap", "overlap"):
            again = times[1]

    C = np.asarray(kncal.dimensionless_impact("tsuji", e_n[:SAMPLE]).C)
    fields = {name: np.asarray(getattr(pair, name))[:SAMPLE] for name in ("m_eff", "k_h")}
    start = time.process_time()
    for i in range(SAMPLE):
        one = type("One", (), {name: float(values[i]) for name, values in fields.items()})
        by_ode(one, float(v_0[i]), float(C[i]), 0.25)  # type: ignore[arg-type]
    ode = (time.process_time() - start) / SAMPLE
    print(f"one impact by ODE (damping already known): {1e3 * ode:.2f} ms; here: {1e6 * again / count:.3f} µs")
    print(f"ratio: {ode * count / again:.0f}")


if __name__ == "__main__":
    main()
