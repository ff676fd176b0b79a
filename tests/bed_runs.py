"""Made-up bed runs with known answers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from kncal.record.facts import HEIGHTS, BedFacts
from kncal.record.series import UNITS, BedSeries

EDGES = tuple(float(edge) for edge in np.linspace(0.0, 1e-4, 201))


def facts(**changes: Any) -> BedFacts:
    values: dict[str, Any] = {
        "name": "made-up",
        "kind": "linear",
        "size": (0.06, 0.01, 0.12),
        "cells": (24, 1, 48),
        "front_back": "walls",
        "count": 500,
        "diameter": 2e-3,
        "density": 1000.0,
        "gravity": 9.81,
        "gas_density": 1.2,
        "jet": False,
        "coupling": 1e-3,
        "histogram_edges": EDGES,
        "low": (0.0, 0.0, 0.0),
        "periodic": (),
        "up": (0.0, 0.0, 1.0),
        "groups": ("beads",),
        "pairs": ((0, 0), (0, 1)),
        "walls": (),
        "outlets": (),
    } | changes
    d, density = values["diameter"], values["density"]
    of_one = {"radii": (0.5 * d,), "masses": (density * math.pi / 6.0 * d**3,), "numbers": (values["count"],)}
    return BedFacts(**(of_one | values))


def series(of: BedFacts, couplings: int, **arrays: Any) -> BedSeries:
    """A run in which all is zero but what is given; frames as given by x (frames, n, 3), every ``every`` couplings."""
    nx, ny, nz = of.cells
    every = arrays.pop("every", 1)
    rows: dict[str, Any] = {name: np.zeros(couplings) for name in UNITS}
    rows["coupling"] = np.arange(1, couplings + 1)
    rows["t"] = rows["coupling"] * of.coupling
    rows |= {"weight": np.full(couplings, of.weight), "mass": np.full(couplings, of.mass)}
    rows["number"] = np.full(couplings, float(of.count))
    frames = max((len(arrays[name]) for name in ("x", "eps_g", "p") if name in arrays), default=0)
    gas_frames = frames if of.gas_density else 0
    number = every * np.arange(1, frames + 1)
    rest: dict[str, Any] = {
        "histogram": np.zeros((couplings, len(of.histogram_edges) - 1), dtype=np.int64),
        "watched": np.zeros(couplings),
        "impacts": np.zeros((couplings, 2, of.impact_bins), dtype=np.int32),
        "impact_sums": np.zeros((couplings, 2, 3)),
        "out_number": np.zeros((couplings, len(of.outlets)), dtype=np.int64),
        "out_mass": np.zeros((couplings, len(of.outlets))),
        "wall_force": np.zeros((couplings, len(of.walls), HEIGHTS, 3)),
        "frame_coupling": number,
        "t_frame": number * of.coupling,
        "x": np.zeros((frames, of.count, 3)),
        "v": np.zeros((frames, of.count, 3)),
        "spin": np.zeros((frames, of.count, 3)),
        "kind": np.zeros((frames, of.count), dtype=np.int16),
        "eps_g": np.ones((gas_frames, nz, ny, nx)),
        "p": np.zeros((gas_frames, nz, ny, nx)),
        "U": np.zeros((gas_frames, nz, ny, nx, 3)),
    }
    values = rows | rest | arrays
    for name in ("x", "v", "spin", "eps_g", "p", "U"):
        values[name] = np.asarray(values[name], dtype=np.float32)
    return BedSeries(facts=of, **values)


def correlated(n: int, tau: float, seed: int) -> np.ndarray:
    """AR(1) of unit variance, mean 0, started in equilibrium; correlation exp(-k/tau) at lag k."""
    from scipy.signal import lfilter

    rng = np.random.default_rng(seed)
    a = math.exp(-1.0 / tau)
    start = rng.normal()
    noise = math.sqrt(1.0 - a * a) * rng.normal(size=n)
    values, _ = lfilter([1.0], [1.0, -a], noise, zi=[a * start])
    return np.asarray(values)


def integrated(tau: float) -> float:
    """Integrated autocorrelation time of `correlated` in samples: 1/2 + sum of exp(-k/tau)."""
    a = math.exp(-1.0 / tau)
    return 0.5 * (1.0 + a) / (1.0 - a)


def disc_fraction(of: BedFacts, centre: tuple[float, float], radius: float, parts: int = 8) -> np.ndarray:
    """(nz, ny, nx) share of each cell inside a cylinder along y with its axis at (x, z)."""
    nx, ny, nz = of.cells
    x = (np.arange(nx * parts) + 0.5) * of.size[0] / (nx * parts)
    z = (np.arange(nz * parts) + 0.5) * of.size[2] / (nz * parts)
    inside = (x[None, :] - centre[0]) ** 2 + (z[:, None] - centre[1]) ** 2 < radius**2
    share = inside.reshape(nz, parts, nx, parts).mean(axis=(1, 3))
    return np.repeat(share[:, None, :], ny, axis=1)


def bubbling(of: BedFacts, seed: int, *, speed: float = 0.2, couplings: int = 4000, every: int = 20) -> BedSeries:
    """A bed 60 mm high of eps_g = 0.45 through which bubbles of 8 mm radius rise; forces in balance at every moment."""
    rng = np.random.default_rng(seed)
    t = np.arange(1, couplings + 1) * of.coupling
    wobble = 0.1 * np.sin(2.0 * math.pi * 3.0 * t) + 0.05 * correlated(couplings, 100.0, seed)
    floor = of.weight * (0.08 + 0.3 * np.exp(-t / 0.15))
    momentum = 0.02 * of.mass * wobble
    change = np.diff(momentum, prepend=0.0) / of.coupling
    drag = of.weight - floor + change
    gas_weight = of.gas_density * of.gravity * (np.prod(of.size) - of.mass / of.density)
    frames = couplings // every
    x = rng.random((frames, of.count, 3)) * np.array([of.size[0], of.size[1], 0.06])
    v = rng.normal(scale=0.05, size=(frames, of.count, 3))
    z = (np.arange(of.cells[2]) + 0.5) * of.size[2] / of.cells[2]
    eps_g = np.where(z < 0.06, 0.45, 1.0)[None, :, None, None] * np.ones((frames, 1, of.cells[1], of.cells[0]))
    for k in range(frames):
        height = 0.012 + speed * (k + 1) * every * of.coupling % 0.036
        eps_g[k] = np.maximum(eps_g[k], 0.45 + 0.55 * disc_fraction(of, (0.03, height), 0.008))
        void = np.hypot(x[k, :, 0] - 0.03, x[k, :, 2] - height) < 0.008
        x[k, void, 0] = 0.002 + 0.01 * rng.random(void.sum())
        v[k, :, 2] += np.where(np.abs(x[k, :, 0] - 0.03) < 0.015, 0.1, -0.1)
    overlaps = rng.exponential(5e-6, size=(couplings, 50)).clip(max=9.9e-5)
    histogram = np.stack([np.histogram(row, bins=of.histogram_edges)[0] for row in overlaps])
    return series(
        of,
        couplings,
        every=every,
        p_in=(drag + gas_weight) / of.floor_area,
        floor=floor,
        drag_z=drag,
        momentum_z=momentum,
        kinetic_energy=1e-4 * (1.0 + wobble),
        z_mean=0.03 * (1.0 + 0.2 * wobble),
        z_95=0.057 * (1.0 + 0.2 * wobble),
        overlap_mean=overlaps.mean(axis=1),
        overlap_max=overlaps.max(axis=1),
        contacts=np.full(couplings, 50.0),
        histogram=histogram,
        x=x,
        v=v,
        eps_g=eps_g,
        p=np.where(z < 0.06, 1.0 - z / 0.06, 0.0)[None, :, None, None] * np.full((frames, 1, *of.cells[1::-1]), 300.0),
    )
