"""Records of many particles without gas whose answers are known, as observers read them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from kncal.observe.averages import window_start
from kncal.observe.grains import Grains
from kncal.observe.granular import GrainObservations

D, DENSITY, G, DT = 2e-3, 2500.0, 9.81, 0.01
MASS = DENSITY * np.pi / 6.0 * D**3
_OBSERVE = {"surface": None, "axis": "y", "centre": (0, 0), "width": None, "profile": "z", "cell_number": 25}
BOX = ((0.0, 0.0, 0.0), (0.06, 0.02, 0.05))


def seen_of(
    frames, *, v=None, kinds=None, speeds=None, out=None, inside=None, walls=None, tilt=0.0, outlets=("out",), **observe
):
    """A record of frames (n, 3), one per ten intervals, as observers read it."""
    couplings, number = 10 * (len(frames) - 1), len(frames[0])
    t = DT * np.arange(1, couplings + 1)
    v = [np.zeros((number, 3))] * len(frames) if v is None else v
    there = [np.isfinite(x[:, 0]) for x in frames]
    kind = np.zeros(number, dtype=np.int16) if kinds is None else kinds
    inside = np.full(couplings, MASS * there[-1].sum()) if inside is None else inside
    energy = 0.5 * inside * np.broadcast_to(np.sqrt(3.0) * 0.1 if speeds is None else speeds, t.shape) ** 2
    up = (float(np.sin(tilt)), 0.0, float(np.cos(tilt)))
    facts = SimpleNamespace(
        count=number, gas_density=0.0, gravity=G, diameter=D, coupling=DT, radii=(D / 2,) * 3, masses=(MASS,) * 3,
        groups=("red", "blue", "blue"), walls=("floor", "wall"), outlets=outlets, low=BOX[0], size=BOX[1],
        periodic=("x", "y"), up=up, heights=np.linspace(0.0, BOX[1][2], 26), driven_until=0.0,
    )  # fmt: skip
    series = SimpleNamespace(
        facts=facts, t=t, U_0=np.zeros(couplings), contacts=np.ones(couplings),
        floor=np.ones(couplings), p_in=np.full(couplings, np.nan),
        z_mean=np.ones(couplings), kinetic_energy=energy, kinetic_rotation=0.4 * energy, mass=inside,
        out_mass=np.tile(np.zeros((couplings, 1)) if out is None else np.reshape(out, (-1, 1)), len(outlets)),
        t_frame=DT * 10 * np.arange(len(frames)),
        frame_coupling=10 * np.arange(len(frames)),
        x=[x.astype(np.float32) for x in frames], v=v, spin=[np.zeros((number, 3))] * len(frames),
        kind=[np.where(here, kind, -1) for here in there],
        wall_force=np.zeros((couplings, 0, 25, 3)) if walls is None else walls,
    )  # fmt: skip
    scene = SimpleNamespace(
        observe=SimpleNamespace(**_OBSERVE | observe),
        d_max=D, layer=None, contact=SimpleNamespace(friction=0.5, pairs=()), walls={},
        outlets={name: SimpleNamespace(delete=name == "out") for name in outlets},
        particles=dict.fromkeys(("red", "blue"), SimpleNamespace(frozen=False, place="given")),
        gravity=tuple(-G * np.array(up)),
    )  # fmt: skip
    return GrainObservations(series=series, scene=scene, window=window_start(series))


def pile(rng, slope, n=7000):
    x = rng.uniform(BOX[0], BOX[1], (n, 3))
    x[x[:, 2] > 0.025 + slope * (x[:, 0] - 0.03)] = np.nan
    return x


def grains(x, v=None, d=D, t=0.0):
    n = len(x)
    radius = np.broadcast_to(np.asarray(d) / 2.0, (n,)).astype(float)
    return Grains(
        t=t,
        x=np.asarray(x, dtype=float),
        v=np.zeros((n, 3)) if v is None else v,
        spin=np.zeros((n, 3)),
        radius=radius,
        mass=2500.0 * 4.0 / 3.0 * np.pi * radius**3,
        kind=np.zeros(n, dtype=np.int64),
        row=np.arange(n),
    )


def chute(tilt, n=1.5, noise=0.0):
    rng, height, frames, speeds = np.random.default_rng(6), 0.045, [], []
    for _ in range(41):
        x = rng.uniform(BOX[0], (0.06, 0.02, height), (6000, 3))
        v = rng.normal(0.0, noise, x.shape) if noise else np.zeros_like(x)
        v[:, 0] -= 0.2 + 0.8 * (1.0 - (1.0 - x[:, 2] / height) ** n)
        frames.append(x)
        speeds.append(v)
    return seen_of(frames, v=speeds, tilt=tilt, outlets=())
