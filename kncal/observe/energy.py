"""Where the energy of a run is: kinetic, stored in the springs, potential of gravity; and what the dashpots took.

Tangential springs and sliding take energy that normal overlaps do not tell: the balance is that of smooth contacts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import ValidityError
from kncal.observe.contacts import OverlapSeries, overlaps
from kncal.physics.material import sphere_mass
from kncal.record.frames import Trajectory
from kncal.scene.contact_event import ContactEvent
from kncal.scene.model import Plan


@dataclass(frozen=True, kw_only=True)
class Energy:
    """Energy at every frame of a run [J], each of shape (frames,).

    Attributes
    ----------
    t : time [s]
    kinetic : of all particles, translation and rotation
    stored : in all springs, k delta^(n+1)/(n+1)
    potential : of gravity, zero at the start
    dissipated : work of all dashpots since the start, by the trapezoidal rule between frames
    """

    t: Array
    kinetic: Array
    stored: Array
    potential: Array
    dissipated: Array

    @property
    def mechanical(self) -> Array:
        """What can still become motion."""
        return self.kinetic + self.stored + self.potential

    @property
    def error(self) -> Array:
        """Mechanical and dissipated energy less the mechanical energy at the start: zero for the exact motion."""
        return np.asarray(self.mechanical + self.dissipated - self.mechanical[0])


def energy(model: Plan, trajectory: Trajectory) -> Energy:
    """Return where the energy of a run is.

    Raises
    ------
    ValidityError
        If a contact has friction, whose work cannot be told from frames.
    """
    rubbing = ["–".join(names) for names, c in model.named.items() if c.friction > 0.0]
    if rubbing:
        raise ValidityError(f"{rubbing[0]}: the work of friction is not in the frames: expected smooth contacts")
    scene, frames = model.scene, len(trajectory.t)
    m = np.array([float(sphere_mass(p.material, p.radius)) for p in scene.spheres])
    inertia = 0.4 * m * trajectory.radius**2
    moving = 0.5 * np.einsum("p,fpk->f", m, trajectory.v**2)
    turning = 0.5 * np.einsum("p,fpk->f", inertia, trajectory.spin**2)
    fallen = trajectory.x - trajectory.x[0]
    stored, dissipated = np.zeros(frames), np.zeros(frames)
    for names, series in overlaps(scene, trajectory).items():
        spring, power = _contact(model, names, series)
        stored += spring
        dissipated[1:] += np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(trajectory.t))
    return Energy(
        t=trajectory.t,
        kinetic=moving + turning,
        stored=stored,
        potential=-np.einsum("p,k,fpk->f", m, np.asarray(scene.gravity), fallen),
        dissipated=dissipated,
    )


def _contact(model: Plan, names: tuple[str, str], series: OverlapSeries) -> tuple[Array, Array]:
    """Energy in the spring [J] and power of the dashpot [W] at every frame."""
    c = model.between(*names)
    delta = np.maximum(series.delta, 0.0)
    spring = c.k * delta ** (c.n + 1.0) / (c.n + 1.0)
    damping = np.where(delta > 0.0, c.c * delta**c.p, 0.0) * series.delta_dot
    if c.end == "force":  # attraction is cut off: the dashpot only takes what makes the spring's force zero
        damping = np.maximum(damping, -c.k * delta**c.n)
    return spring, np.asarray(damping * series.delta_dot)


def balance_of(event: ContactEvent, found: Energy) -> float:
    """Return the balance error of one contact over the energy at its start: what the step created (or lost) [-]."""
    inside = np.flatnonzero((found.t >= event.t_start) & (found.t <= event.t_start + event.t_c))
    if not inside.size:
        return 0.0
    first, last = max(int(inside[0]) - 1, 0), min(int(inside[-1]) + 1, len(found.t) - 1)
    scale = float(found.kinetic[first] + found.stored[first])
    return float(found.error[last] - found.error[first]) / scale if scale > 0.0 else 0.0
