"""Bed runs made by hand for tests of comparisons: signals of known mean, spread and memory; nothing simulated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kncal.observe.run_data import RunData
from kncal.physics.material import Material
from kncal.record.facts import HEIGHTS, bed_facts
from kncal.record.outcome import RunResult
from kncal.record.series import BedSeries
from kncal.scene.contact import ContactChoice
from kncal.scene.gas import Gas
from kncal.scene.groups import Particles
from kncal.scene.plan import plan
from kncal.scene.run_control import RunControl
from kncal.scene.scene import MaterialData, Scene
from kncal.scene.walls import BoxWall

Floats = NDArray[np.float64]

PLASTIC = Material(young=1e7, poisson=0.25, density=1000.0, name="soft-plastic")
COUPLING = 5e-3
#: Memory of the signals [s].
TAU = 0.05
#: Means that both models share unless a test says otherwise.
MEANS = {"p_in": 14.0, "z_mean": 0.010, "kinetic_energy": 1e-4, "overlap_mean": 1.2e-6, "contacts": 90.0}
#: Standard deviation of each signal over its mean.
SPREAD = 0.05
#: Frames are this many couplings apart.
EVERY = 4
SCENE = Scene(
    name="mini",
    title="A small bubbling bed",
    materials={PLASTIC.name: MaterialData(young=1e7, poisson=0.25, density=1000.0)},
    walls={"column": BoxWall(shape="box", size=(0.03, 0.006, 0.06))},
    particles={"beads": Particles(count=300, diameter=1.2e-3, material=PLASTIC.name, place="lattice")},
    gravity=(0.0, 0.0, -9.81),
    gas=Gas(cells=(10, 2, 20), density=1.2, viscosity=1.8e-5, U_0=0.8),
    contact=ContactChoice(e_n=0.9, friction=0.1, v_0=0.5),
    run=RunControl(until_time=4.0, discard=0.2, coupling=COUPLING, frames_every=EVERY * COUPLING),
    tolerances={},
)


def ar1(generator: np.random.Generator, n: int, tau: float = TAU, step: float = COUPLING) -> Floats:
    """A stationary signal of mean 0, variance 1 and autocorrelation exp(-t/tau)."""
    from scipy.signal import lfilter

    phi = np.exp(-step / tau)
    noise = generator.standard_normal(n) * np.sqrt(1.0 - phi**2)
    noise[0] = generator.standard_normal()
    values: Floats = lfilter([1.0], [1.0, -phi], noise)
    return values


def run_data(
    kind: str,
    seed: int,
    *,
    scene: Scene = SCENE,
    length: float = 4.0,
    means: Mapping[str, float] | None = None,
    tau: float = TAU,
    status: str = "completed",
    cpu: tuple[float, float, float] = (12.0, 5.0, 1.0),
    bubble: bool = True,
) -> RunData:
    """A run of ``length`` s whose signals are AR(1) around ``means``, independent for every seed."""
    model = plan(scene, [kind])[kind]
    model = replace(
        model, dt=COUPLING / model.steps_per_coupling, couplings=round(length / COUPLING), frames_every=EVERY
    )
    n, generator = model.couplings, np.random.default_rng(seed)
    edges = np.concatenate([[0.0], np.geomspace(1e-9, 1e-4, 61)])
    facts = bed_facts(model, edges, np.array([]))
    mean = MEANS | dict(means or {})
    signal = {name: value * (1.0 + SPREAD * ar1(generator, n, tau)) for name, value in mean.items()}
    gas_weight = facts.gas_density * facts.gravity * (np.prod(facts.size) - facts.mass / facts.density)
    # momentum does not change, so what the gas does not carry stands on the floor
    drag = signal["p_in"] * facts.floor_area - gas_weight
    overlaps = generator.exponential(mean["overlap_mean"], size=(n, 90))
    frames = np.arange(EVERY, n + 1, EVERY)
    x = generator.uniform(0.0, 1.0, (len(frames), facts.count, 3)) * np.array([0.03, 0.006, 0.02])
    nz, ny, nx = facts.cells[::-1]
    level = 6.0 + ar1(generator, len(frames), tau, EVERY * COUPLING)
    z = np.arange(nz) + 0.5
    eps_g = 0.45 + 0.55 / (1.0 + np.exp(-4.0 * (z[None] - level[:, None])))
    eps_g = np.broadcast_to(eps_g[:, :, None, None], (len(frames), nz, ny, nx)).copy()
    if bubble:  # one that rises a cell per frame, again and again
        for frame in range(len(frames)):
            at = frame % 6
            if at < 4:
                eps_g[frame, at : at + 2, :, 4:6] = 0.95
    series = BedSeries(
        facts=facts,
        coupling=np.arange(1, n + 1),
        t=COUPLING * np.arange(1, n + 1),
        U_0=np.full(n, 0.8),
        p_in=signal["p_in"],
        floor=facts.weight - drag,
        walls=np.zeros(n),
        drag_z=drag,
        weight=np.full(n, facts.weight),
        momentum_z=np.zeros(n),
        kinetic_energy=signal["kinetic_energy"],
        kinetic_rotation=np.zeros(n),
        number=np.full(n, float(facts.count)),
        mass=np.full(n, facts.mass),
        z_mean=signal["z_mean"],
        z_95=1.9 * signal["z_mean"],
        overlap_max=overlaps.max(axis=1),
        overlap_mean=signal["overlap_mean"],
        contacts=signal["contacts"],
        reaction_error=np.full(n, 1e-15),
        not_passed=np.full(n, 1e-6),
        solids_error=np.full(n, 1e-16),
        eps_g_min=np.full(n, 0.35),
        courant_max=np.full(n, 0.4),
        watched=np.zeros(n),
        impacts=np.zeros((n, 2, 0), dtype=np.int32),
        impact_sums=np.zeros((n, 2, 3)),
        out_number=np.zeros((n, 0), dtype=np.int64),
        out_mass=np.zeros((n, 0)),
        wall_force=np.zeros((n, 0, HEIGHTS, 3)),
        histogram=np.stack([np.histogram(row, edges)[0] for row in overlaps]).astype(np.int64),
        frame_coupling=frames.astype(np.int64),
        t_frame=COUPLING * frames,
        x=x.astype(np.float32),
        v=(0.1 * generator.standard_normal(x.shape)).astype(np.float32),
        spin=np.zeros(x.shape, dtype=np.float32),
        kind=np.zeros(x.shape[:2], dtype=np.int16),
        eps_g=eps_g.astype(np.float32),
        p=np.broadcast_to(1e3 * (1.0 - z / nz)[None, :, None, None], eps_g.shape).astype(np.float32),
        U=np.zeros((*eps_g.shape, 3), dtype=np.float32),
    )
    dem, gas, exchange = cpu
    extra: dict[str, Any] = {"transport": "live", "cpu_dem": dem, "cpu_gas": gas, "cpu_exchange": exchange}
    result = RunResult(
        status=status,
        engine="coupled",
        model=kind,
        folder=Path("runs") / kind,
        steps=model.couplings * model.steps_per_coupling,
        dt=model.dt,
        cpu_seconds=sum(cpu),
        wall_seconds=sum(cpu),
        version="LIGGGHTS 3.8.0, OpenFOAM 1912",
        message="" if status == "completed" else "ERROR: lost atoms",
        extra=extra,
    )
    return RunData(model=model, result=result, signals=series)
