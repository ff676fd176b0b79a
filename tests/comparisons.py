"""Runs made by hand for tests of comparisons: a bead on a straight path, metrics as given, nothing simulated."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from models import R, model, on_wall

from kncal.observe.contacts import Observations
from kncal.observe.run_data import RunData
from kncal.record.frames import Trajectory
from kncal.record.outcome import RunResult


def path(t: Any, x: Any, v: Any) -> Trajectory:
    """One bead on the x axis; ``t``, ``x``, ``v`` of shape (frames,)."""
    t = np.asarray(t, dtype=float)
    xyz, speed = np.zeros((len(t), 1, 3)), np.zeros((len(t), 1, 3))
    xyz[:, 0, 0], speed[:, 0, 0] = x, v
    nothing = np.zeros_like(xyz)
    return Trajectory(("bead",), np.arange(len(t)), t, xyz, speed, nothing, nothing, np.array([R]))


def uniform(speed: float = 1.0, duration: float = 2.0, frames: int = 5) -> Trajectory:
    """x = speed·t."""
    t = np.linspace(0.0, duration, frames)
    return path(t, speed * t, np.full_like(t, speed))


def run_data(
    kind: str,
    metrics: Mapping[str, float],
    trajectory: Trajectory | None = None,
    *,
    steps: int = 1000,
    cpu: float = 2.0,
    status: str = "completed",
    scene: Any = None,
    **fields: Any,
) -> RunData:
    """A run of one bead above a wall with the given metrics."""
    planned = model(scene or on_wall(), kind, t_end=2.0)
    result = RunResult(
        status=status,
        engine="liggghts",
        model=kind,
        folder=Path("runs") / kind,
        steps=steps,
        dt=planned.dt,
        cpu_seconds=cpu,
        wall_seconds=2.0 * cpu,
        version="1",
        message="" if status == "completed" else "ERROR: lost atoms",
    )
    observations = Observations(contacts=(), metrics=dict(metrics), series={})
    return RunData(model=planned, result=result, frames=trajectory or uniform(), contacts=observations, **fields)
