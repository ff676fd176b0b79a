"""One impact, exactly: the reference contact and its linear equivalent in physical units, and their picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.physics.calibration import Calibration
from kncal.physics.impact import impact_path
from kncal.report.plots import Line, force_loops, overlap_time
from kncal.report.style import save_picture


@dataclass(frozen=True, kw_only=True)
class CollisionPath:
    """Time series of one contact; every field has shape (n,).

    Attributes
    ----------
    t, delta, delta_dot, force : [s], [m], [m/s], [N] (positive: repulsion)
    """

    t: Array
    delta: Array
    delta_dot: Array
    force: Array


def collision_paths(calibration: Calibration, n: int = 400) -> dict[str, CollisionPath]:
    """Return the exact paths of a scalar calibration: "linear", and "hertz" for the reference law.

    Raises
    ------
    InputError
        If the calibration is one of arrays.
    """
    c = calibration
    if np.ndim(c.k_n) != 0:
        raise InputError(f"calibration of shape {np.shape(c.k_n)}: expected one impact, not an array of them")
    mass, speed = float(c.pair.m_eff), float(c.v_0)
    paths = {}
    for kind, law, duration in (("linear", "linear", c.t_c), ("hertz", c.law, c.reference.t_c)):
        path = impact_path(law, 1.0 if law == "hertz" else float(c.e_n), c.end, n)
        time = float(duration) / path.tau[-1]
        paths[kind] = CollisionPath(
            t=path.tau * time,
            delta=path.x * speed * time,
            delta_dot=path.x_dot * speed,
            force=path.force * mass * speed / time,
        )
    return paths


def plot_collision(calibration: Calibration, picture: Path) -> None:
    """Draw overlap against time and force against overlap of both contacts into ``picture`` (.png or .svg).

    Raises
    ------
    InputError
        For another file type, or a folder that does not exist.
    """
    from matplotlib.figure import Figure

    paths = collision_paths(calibration)
    over: dict[str, Line] = {kind: (p.t, p.delta) for kind, p in paths.items()}
    loop: dict[str, Line] = {kind: (p.delta, p.force) for kind, p in paths.items()}
    figure = Figure(figsize=(11.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    overlap_time({}, over, left)
    force_loops({}, loop, right)
    save_picture(figure, picture)
