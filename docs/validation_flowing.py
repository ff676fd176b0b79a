"""The rows of docs/validation.md on a chute and a vibrated bed."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import brentq
from validation_entry import BOTH, Entry, expected

from kncal.observe.run_data import RunData
from kncal.scene.scene import Scene
from kncal.scene.walls import Oscillation

_GRAINS, _BLOCK = "Many particles without gas", "plastic block, closed form"


def _force(run: RunData) -> Any:
    """Force of the particles on all walls, (intervals, 3) [N], after the start-up."""
    series = run.series
    return series.wall_force.sum(axis=(1, 2))[series.t >= (run.model.scene.run.discard or 0.0)]


def base_angle(run: RunData) -> float:
    """Angle of the mean force on the base to the base's normal [°]."""
    x, _, z = _force(run).mean(axis=0)
    return float(np.degrees(np.arctan2(x, -z)))


def slope(scene: Scene) -> float:
    """Angle of gravity to the base's normal [°]: what the base's force has in steady flow."""
    x, _, z = scene.gravity
    return float(np.degrees(np.arctan2(x, -z)))


def flight(run: RunData) -> float:
    """Share of time in which less than a hundredth of the weight stands on the floor."""
    up = _force(run)[:, 2]
    return float((-up < 0.01 * run.series.facts.weight).mean())


def floor_force(run: RunData) -> float:
    """Mean vertical force on the floor over the weight, over as many whole periods as there are."""
    (motion,) = run.model.scene.walls["floor"].motion
    assert isinstance(motion, Oscillation)  # noqa: S101  # as the case says
    down, interval = -_force(run)[:, 2], run.series.facts.coupling
    whole = round(motion.period * (len(down) * interval // motion.period) / interval)
    return float(down[-whole:].mean() / run.series.facts.weight)


def block_flight(scene: Scene) -> float:
    """Share of a period that a block flies which sticks to the vibrated floor until that falls away faster.

    It leaves at sin(a) = g/(A omega^2), and is back after the phase x:
    sin(a) + x cos(a) - sin(a) x^2/2 = sin(a + x).
    """
    (motion,) = scene.walls["floor"].motion
    assert isinstance(motion, Oscillation)  # noqa: S101  # as the case says
    omega = 2.0 * np.pi / motion.period
    a = np.arcsin(scene.g / (motion.amplitude[2] * omega**2))
    back = brentq(lambda x: np.sin(a) + x * np.cos(a) - 0.5 * np.sin(a) * x**2 - np.sin(a + x), 0.1, 2.0 * np.pi)
    return float(back / (2.0 * np.pi))


FLOWING = [
    Entry(
        section=_GRAINS,
        what="chute: angle of the force on its base",
        source="weight in steady flow",
        case="chute",
        metric="base_angle",
        models=BOTH,
        value=base_angle,
        unit="°",
        reference=slope,
        tolerance=0.04,
        long=True,
    ),
    expected(
        _GRAINS, "chute: exponent of the profile", "chute", "profile_exponent", "Silbert et al. (2001)", long=True
    ),
    Entry(
        section=_GRAINS,
        what="vibrated bed: floor force over weight, whole periods",
        source="momentum",
        case="vibrated_bed",
        metric="floor_force",
        models=BOTH,
        value=floor_force,
        reference=1.0,
        tolerance=0.02,
        long=True,
    ),
    Entry(
        section=_GRAINS,
        what="vibrated bed: share of time in flight",
        source=_BLOCK,
        case="vibrated_bed",
        metric="flight",
        models=BOTH,
        value=flight,
        reference=block_flight,
        tolerance=0.1,
        long=True,
    ),
]
