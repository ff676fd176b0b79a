"""From recorded frames to numbers: every contact with its sub-step start and end, and the metrics of a run.

A contact is the time during which the overlap is positive; after a force end the bodies coast until it is zero
(see `kncal.physics.contact_estimators` for the estimators).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.core.checks import Array
from kncal.physics.contact_estimators import ContactMeasure, measure_contact
from kncal.physics.material import sphere_mass
from kncal.record.frames import Trajectory
from kncal.scene.bodies import AXES, Body, Particle, Wall
from kncal.scene.contact_event import ContactEvent, Names, only_binary
from kncal.scene.model import Plan
from kncal.scene.scene import Scene

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "ContactMeasure",
    "Observations",
    "OverlapSeries",
    "measure_contact",
    "observe",
    "overlaps",
]

#: A particle slides on a wall from the start if its first gap is below this share of the radius ...
_TOUCHING = 1e-3
#: ... and it approaches or leaves more slowly than this share of its slip speed.
_ALONG = 1e-3
#: Below this share of the impact speed a tangential velocity is rounding: the impact is not oblique.
_OBLIQUE = 1e-9


@dataclass(frozen=True, kw_only=True)
class OverlapSeries:
    """Overlap and relative motion of one pair at every frame.

    Attributes
    ----------
    pair : names of the two bodies
    t : (frames,) [s]
    delta, delta_dot : (frames,) overlap (negative: a gap) and its rate [m], [m/s]
    normal : (frames, 3) unit vector from the second body to the first
    velocity : (frames, 3) of the first body relative to the second [m/s]
    pull : (frames,) second derivative of the overlap from all forces on the bodies [m/s²]; that of free flight in a
        free frame
    """

    pair: Names
    t: Array
    delta: Array
    delta_dot: Array
    normal: Array
    velocity: Array
    pull: Array


@dataclass(frozen=True, kw_only=True)
class Observations:
    """What a run showed.

    Attributes
    ----------
    contacts : all contacts in the order of their start
    metrics : name -> value [SI]; what does not apply is not there. The k-th contact of ``contacts`` has the
        suffix ``_k`` (none for the first): e_n, t_c, delta_max, delta_mean, v_out, rebound_height (highest gap
        over the wall after it). For the first contact, if its contact point slips: tangential_restitution (only if
        the centre moves along the other body, too), spin_out (of the first body about the axis of rolling forward,
        [rad/s]), slip_out (of the contact point, forward, [m/s]), rebound_angle (of the centre from the normal, [rad]);
        forward is where the centre goes, or else the contact point. For a particle that starts on a wall:
        slip_end_time, slip_end_speed.
    series : (name, name) -> OverlapSeries
    """

    contacts: tuple[ContactEvent, ...]
    metrics: Mapping[str, float]
    series: Mapping[Names, OverlapSeries]

    def to_frame(self) -> pd.DataFrame:
        """One row per contact, SI units."""
        import pandas as pd

        rows = [{"body_1": c.pair[0], "body_2": c.pair[1], **_without_pair(c)} for c in self.contacts]
        columns = ["body_1", "body_2", *(f for f in ContactEvent.__dataclass_fields__ if f != "pair")]
        return pd.DataFrame(rows, columns=columns)

    def to_dict(self) -> dict[str, Any]:
        """Contacts and metrics, ready for JSON."""
        contacts = [{"pair": list(c.pair), **_without_pair(c)} for c in self.contacts]
        return {"contacts": contacts, "metrics": dict(self.metrics)}


def _without_pair(contact: ContactEvent) -> dict[str, Any]:
    values = asdict(contact)
    del values["pair"]
    return values


def overlaps(scene: Scene, trajectory: Trajectory) -> dict[Names, OverlapSeries]:
    """Overlap of every pair of bodies at every frame; keys (name, name) in the order of `Scene.body_pairs`."""
    return {(a.name, b.name): _relative(trajectory, a, b) for a, b in scene.body_pairs()}


def _relative(trajectory: Trajectory, a: Particle, b: Body) -> OverlapSeries:
    i = trajectory.names.index(a.name)
    x, w = trajectory.x[:, i], trajectory.v[:, i]
    push = trajectory.force[:, i] / float(sphere_mass(a.material, a.radius))
    if isinstance(b, Wall):
        axis = AXES.index(b.axis)
        side = 1.0 if a.position[axis] > b.position else -1.0
        n = np.zeros_like(x)
        n[:, axis] = side
        delta = a.radius - side * (x[:, axis] - b.position)
        closing, pull = -side * w[:, axis], -side * push[:, axis]
    else:
        j = trajectory.names.index(b.name)
        d, w = x - trajectory.x[:, j], w - trajectory.v[:, j]
        push = push - trajectory.force[:, j] / float(sphere_mass(b.material, b.radius))
        distance = np.sqrt(np.einsum("fk,fk->f", d, d))
        n = d / distance[:, None]
        delta = a.radius + b.radius - distance
        closing = -np.einsum("fk,fk->f", w, n)
        along = np.einsum("fk,fk->f", w, w) - closing**2
        pull = -np.einsum("fk,fk->f", push, n) - along / distance
    return OverlapSeries(
        pair=(a.name, b.name), t=trajectory.t, delta=delta, delta_dot=closing, normal=n, velocity=w, pull=pull
    )


def observe(model: Plan, trajectory: Trajectory) -> Observations:
    """Find every contact in the frames of a run, and the metrics that apply."""
    scene, t = model.scene, trajectory.t
    series = overlaps(scene, trajectory)
    found = [(_event(r, *run), *run) for r in series.values() for run in _runs(r.delta)]
    # a stable sort keeps the order of the pairs for contacts that start together
    found.sort(key=lambda item: item[0].t_start)
    events = only_binary([event for event, _, _ in found], trajectory.names)
    found = [(event, start, out) for event, (_, start, out) in zip(events, found, strict=True)]
    bodies = {body.name: body for body in scene.bodies}
    metrics: dict[str, float] = {}
    for k, (event, _, out) in enumerate(found, start=1):
        suffix = "" if k == 1 else f"_{k}"
        values = {
            "delta_max": event.delta_max,
            "delta_mean": event.delta_mean,
            "e_n": event.e_n,
            "v_out": event.v_out,
        }
        if event.complete:
            values["t_c"] = event.t_c
        wall = bodies[event.pair[1]]
        if isinstance(wall, Wall) and event.v_out is not None:
            later = [other.t_start for other, _, _ in found[k:] if event.pair[0] in other.pair]
            free = min(later, default=math.inf) - float(t[out])
            values["rebound_height"] = _rebound_height(scene, wall, series[event.pair], out, free)
        metrics |= {name + suffix: value for name, value in values.items() if value is not None}
    if found and found[0][0].complete:
        event, start, out = found[0]
        metrics |= _oblique(series[event.pair], trajectory, event, start, out)
    for a, b in scene.body_pairs():
        if isinstance(b, Wall) and model.between(a.name, b.name).friction > 0.0 and "slip_end_time" not in metrics:
            metrics |= _slip_end(trajectory, a, series[a.name, b.name])
    return Observations(contacts=events, metrics=metrics, series=series)


def _runs(delta: Array) -> list[tuple[int, int]]:
    """(last free frame before, first free frame after) of every contact; else the first or last frame."""
    inside = (delta > 0.0).astype(np.int8)
    edges = np.diff(inside, prepend=0, append=0)
    first, after = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [(max(int(i) - 1, 0), min(int(j), len(delta) - 1)) for i, j in zip(first, after, strict=True)]


def _event(r: OverlapSeries, start: int, out: int) -> ContactEvent:
    part = slice(start, out + 1)
    m = measure_contact(r.t[part], r.delta[part], r.delta_dot[part], pull_in=r.pull[start], pull_out=r.pull[out])
    started, ended, v_in = bool(m.started), bool(m.ended), float(m.v_in)
    v_out = float(m.v_out) if ended else None
    complete = started and ended
    return ContactEvent(
        pair=r.pair,
        t_start=float(m.t_start),
        t_c=float(m.t_c),
        delta_max=float(m.delta_max),
        delta_mean=float(m.delta_mean),
        v_in=v_in,
        v_out=v_out,
        e_n=v_out / v_in if complete and v_out is not None and v_in > 0.0 else None,
        complete=complete,
    )


def _rebound_height(scene: Scene, wall: Wall, r: OverlapSeries, out: int, free: float) -> float | None:
    """Highest gap after the contact [m], gap + v²/(2 g); None without a pull back or without free flight."""
    axis = AXES.index(wall.axis)
    g = -float(r.normal[out, axis]) * scene.gravity[axis]
    speed = max(-float(r.delta_dot[out]), 0.0)
    if g <= 0.0 or speed / g > free:
        return None
    return float(-r.delta[out]) + speed**2 / (2.0 * g)


def _oblique(r: OverlapSeries, trajectory: Trajectory, event: ContactEvent, start: int, out: int) -> dict[str, float]:
    before, slip = _along(r, trajectory, start)
    noise = _OBLIQUE * float(np.linalg.norm(r.velocity[start]))
    slide = float(np.linalg.norm(before))
    forward = before if slide > noise else slip
    if (size := float(np.linalg.norm(forward))) <= noise or event.v_out is None:
        return {}
    # in a pair the tangent plane turns with the bodies
    ahead = forward / size - (forward @ r.normal[out]) / size * r.normal[out]
    ahead /= np.linalg.norm(ahead)
    after = float(r.velocity[out] @ ahead)
    spin = trajectory.spin[out, trajectory.names.index(event.pair[0])]
    values = {
        "spin_out": float(spin @ np.cross(r.normal[out], ahead)),
        "slip_out": float(_along(r, trajectory, out)[1] @ ahead),
        "rebound_angle": float(np.arctan2(after, event.v_out)),
    }
    return values | ({"tangential_restitution": after / slide} if slide > noise else {})


def _along(r: OverlapSeries, trajectory: Trajectory, frame: int) -> tuple[Array, Array]:
    """Velocities in the tangent plane: of the first centre, and of its contact point, relative to the second body."""
    spheres = [trajectory.names.index(name) for name in r.pair if name in trajectory.names]
    turn = trajectory.radius[spheres] @ trajectory.spin[frame, spheres]
    centre = r.velocity[frame] + r.delta_dot[frame] * r.normal[frame]
    return centre, centre - np.cross(turn, r.normal[frame])


def _slip_end(trajectory: Trajectory, a: Particle, r: OverlapSeries) -> dict[str, float]:
    """First time at which the contact point of a particle that starts on a wall no longer slips forward."""
    arm = a.radius - 0.5 * np.maximum(r.delta, 0.0)
    spin = trajectory.spin[:, trajectory.names.index(a.name)]
    v_t = r.velocity + r.delta_dot[:, None] * r.normal
    slip = v_t - arm[:, None] * np.cross(spin, r.normal)
    start = float(np.linalg.norm(slip[0]))
    if -r.delta[0] > _TOUCHING * a.radius or start == 0.0 or abs(r.delta_dot[0]) > _ALONG * start:
        return {}
    speed = slip @ (slip[0] / start)
    ended = np.flatnonzero(speed <= 0.0)
    if ended.size == 0:
        return {}
    # friction is constant while it slips, so the velocities are linear in time
    k = int(ended[0])
    share = speed[k - 1] / (speed[k - 1] - speed[k])
    time = trajectory.t[k - 1] + share * (trajectory.t[k] - trajectory.t[k - 1])
    centre = v_t[k - 1] + share * (v_t[k] - v_t[k - 1])
    return {"slip_end_time": float(time), "slip_end_speed": float(np.linalg.norm(centre))}
