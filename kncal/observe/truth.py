"""What a run should have shown: exact metrics of the same model, and the discretisation error to expect of it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from kncal.core.checks import Array
from kncal.observe.contacts import Observations, observe
from kncal.observe.run_data import ExactMotion
from kncal.physics.closed_forms import gross_sliding, slip_end
from kncal.physics.laws import LAWS
from kncal.physics.material import sphere_mass
from kncal.physics.timestep import predict_error
from kncal.record.frames import Trajectory
from kncal.scene.ballistics import first_touch
from kncal.scene.bodies import AXES
from kncal.scene.exact import ExactSolution, SlipError, solve
from kncal.scene.model import Plan

#: Frames per contact and between contacts at which an exact motion is observed; the Hermite estimators are of
#: fourth order, so that this many leave a relative error of about 1e-10.
_FRAMES = 400
#: Share of the slip that may go sideways for a motion in one plane.
_STRAIGHT = 1e-12


def exact_motion(model: Plan) -> ExactSolution | None:
    """Return the exact motion of ``model``; None where friction or cohesion acts: there is no exact motion here.

    With friction only one pair of bodies is asked whether it slips at all.
    """
    if model.needs.uses("cohesion") or (model.needs.uses("tangential") and len(model.scene.body_pairs()) != 1):
        return None
    try:
        return solve(model, model.t_end)
    except SlipError:
        return None


def exact_metrics(model: Plan, motion: ExactSolution | None) -> dict[str, float] | None:
    """Return the metrics (see `kncal.observe.contacts`) of the exact motion, as far as there is one; None if there is
    not.

    Where friction acts, one sphere against one wall still has an exact normal motion (friction does not act on it), and
    the closed forms of slip and of gross sliding where they hold.
    """
    if motion is not None:
        return dict(observe(model, exact_trajectory(model, motion)).metrics)
    if len(model.scene.body_pairs()) != 1 or not model.scene.planes or model.needs.uses("cohesion"):
        return None
    smooth = model.without_friction()
    frames = exact_trajectory(smooth, solve(smooth, model.t_end))
    normal = observe(smooth, frames).metrics
    kept = ("e_n", "t_c", "delta_max", "delta_mean", "rebound_height")
    return {k: v for k, v in normal.items() if k.startswith(kept)} | _friction_metrics(model, normal)


def _friction_metrics(model: Plan, normal: Mapping[str, float]) -> dict[str, float]:
    (contact,) = model.contacts.values()
    (particle,), (wall,) = model.scene.spheres, model.scene.planes
    axis = AXES.index(wall.axis)
    n = np.eye(3)[axis] * (1.0 if particle.position[axis] > wall.position else -1.0)
    along = np.asarray(particle.velocity) * (1.0 - np.abs(n))
    slip = along - particle.radius * np.cross(particle.spin, n)
    v_t = float(np.linalg.norm(along))
    forward = along if v_t > 0.0 else slip
    forward = forward / np.linalg.norm(forward) if forward.any() else forward
    speed = float(slip @ forward)
    if speed <= 0.0 or np.linalg.norm(slip - speed * forward) > _STRAIGHT * speed:
        return {}
    touch = first_touch(model.scene, particle, wall)
    if touch is None:
        if any(particle.spin):
            return {}
        end = slip_end(v_t, contact.friction, abs(model.scene.gravity[axis]))
        return {"slip_end_time": end.time, "slip_end_speed": end.speed}
    attracts = contact.end == "overlap" and contact.c > 0.0
    attracts = attracts or contact.c_t > 0.0  # a contact that slips all the time begins and ends with sticking
    e_n, v_n = min(normal.get("e_n", math.nan), 1.0), touch[1]  # an elastic one may be 1 and a rounding more
    if math.isnan(e_n) or attracts or speed < 3.5 * contact.friction * (1.0 + e_n) * v_n:
        return {}
    spin = (v_t - speed) / particle.radius
    slid = gross_sliding(v_n, v_t, friction=contact.friction, e_n=e_n, radius=particle.radius, spin=spin)
    values = {"spin_out": slid.spin, "slip_out": slid.slip, "rebound_angle": slid.rebound_angle, "v_out": slid.v_n}
    turned = slid.tangential_restitution
    return values if turned is None else {**values, "tangential_restitution": turned}


def exact_trajectory(model: Plan, motion: ExactSolution) -> Trajectory:
    """Return the exact motion as frames: dense in the contacts, with one frame just before and after each."""
    times = [np.linspace(0.0, motion.t_end, _FRAMES)]
    for contact in motion.contacts:
        start, end = contact.t_start, contact.t_start + contact.t_c
        margin = 1e-3 * contact.t_c
        times.append(np.linspace(start - margin, end + margin, _FRAMES))
    return frames_at(model, motion, np.unique(np.clip(np.concatenate(times), 0.0, motion.t_end)))


def frames_at(model: Plan, motion: ExactMotion, t: Array) -> Trajectory:
    """Return the exact motion as frames at the times ``t`` [s]."""
    x, v = motion.at(t)
    # Observations take the acceleration of free flight from the force on a free particle: its weight.
    mass = np.array([float(sphere_mass(p.material, p.radius)) for p in model.scene.spheres])
    weight = mass[:, None] * np.asarray(model.scene.gravity)
    return Trajectory(
        names=tuple(p.name for p in model.scene.spheres),
        step=np.arange(t.size),
        t=t,
        x=x,
        v=v,
        spin=np.broadcast_to([p.spin for p in model.scene.spheres], x.shape),
        force=np.broadcast_to(weight, x.shape),
        radius=np.array([p.radius for p in model.scene.spheres]),
    )


def predicted_errors(model: Plan, observations: Observations) -> dict[str, float]:
    """Return the relative discretisation error to expect of every metric that comes from contacts (worst phase).

    A later contact starts with the errors of the speeds that all earlier ones left; its overlaps go with the speed
    (Hertz: the 4/5 power, the duration the -1/5), heights with its square.
    """
    errors: dict[str, float] = {}
    inherited = 0.0
    for k, event in enumerate(observations.contacts, start=1):
        contact = model.between(*event.pair)
        law = LAWS.find(contact.law)
        worst = predict_error(law.name, contact.e_n, contact.t_c / model.dt, contact.end).worst
        suffix = "" if k == 1 else f"_{k}"
        own = {
            "e_n": worst["e_n"],
            "t_c": worst["t_c"] + 0.2 * inherited,
            "delta_max": worst["delta_max"] + inherited,
            "delta_mean": worst["delta_mean"] + inherited,
            "v_out": worst["e_n"] + inherited,
            "rebound_height": 2.0 * (worst["e_n"] + inherited),
        }
        errors |= {name + suffix: value for name, value in own.items()}
        inherited += worst["e_n"]
    return errors
