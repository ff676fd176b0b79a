"""The small integrator: the same iteration as LIGGGHTS' for a few spheres and plane walls, in plain floats.

Velocity Verlet (kick, drift, force, kick) with forces from x(t + dt) and v(t + dt/2); the set-up force at
step 0 sees the full-step velocity and does not load the tangential springs. Where nothing touches and only
gravity acts, velocity Verlet is exact, so flights are passed in one stride per frame. Plain floats, because
NumPy is slower for arrays of three numbers.

Sources: Swope et al., J. Chem. Phys. 76 (1982) 637 (velocity Verlet); Cundall & Strack, Géotechnique 29
(1979) 47 (tangential spring with a Coulomb limit); radii of the contact points as measured in LIGGGHTS 3.8.0.
"""

from __future__ import annotations

import math
import sys
from array import array
from collections.abc import Callable
from math import sqrt

import numpy as np

from kncal.core.errors import RunError
from kncal.engines.plan_checks import check_contact, check_schedule, expect
from kncal.engines.tunnelling import PASSED_THROUGH
from kncal.physics.material import sphere_mass
from kncal.physics.normal_force import Force, normal_force
from kncal.record.frames import Trajectory
from kncal.scene.bodies import AXES, Wall
from kncal.scene.flight import pair_touch_time, wall_touch_time
from kncal.scene.model import PairContact, Plan

#: Steps between two reports of progress (and two looks at whether the numbers are still finite).
REPORT_EVERY = 2000
#: More frames, or numbers in all of them, are no record that could be read back.
MOST_FRAMES, MOST_NUMBERS = 5_000_000, 60_000_000
#: Whole steps left before the next touch when a flight is passed in one stride.
_STRIDE_MARGIN = 2

#: Adds the forces of one contact; the argument says whether the tangential spring moves. Returns the gap [m].
_Apply = Callable[[bool], float]
_Vector = tuple[float, float, float]


def _law(contact: PairContact) -> Force:
    return normal_force(contact.k, contact.n, contact.c, contact.p, cut=contact.end == "force")


class _Motion:
    """Where everything is: flat lists of three numbers per particle.

    The contacts hold on to the lists, so they are changed in place only.
    """

    def __init__(self, model: Plan) -> None:
        particles, dt, gravity = model.scene.spheres, model.dt, model.scene.gravity
        masses = [float(sphere_mass(p.material, p.radius)) for p in particles]
        self.dt = dt
        self.x = [float(c) for p in particles for c in p.position]
        self.v = [float(c) for p in particles for c in p.velocity]
        self.spin = [float(c) for p in particles for c in p.spin]
        self.force = [0.0] * (3 * len(particles))
        self.torque = [0.0] * (3 * len(particles))
        self.gravity = [float(g) for _ in particles for g in gravity]
        self.weight = [m * g for m in masses for g in gravity]
        self.kick = [0.5 * dt / m for m in masses for _ in range(3)]
        inertias = [0.4 * m * p.radius**2 for m, p in zip(masses, particles, strict=True)]
        self.turn = [0.5 * dt / inertia for inertia in inertias for _ in range(3)]
        self.turning = any(c.friction > 0.0 for c in model.contacts.values())
        self.applies = _contacts(model, self)
        self.stride_limits = _stride_limits(model, self)

    def load(self, moving: bool) -> float:
        """Compute all forces; return the smallest gap [m]."""
        self.force[:] = self.weight
        if self.turning:
            self.torque[:] = [0.0] * len(self.torque)
        return min([apply(moving) for apply in self.applies], default=math.inf)

    def step(self) -> float:
        """One step of velocity Verlet; return the smallest gap [m]."""
        x, v, kick, force, dt = self.x, self.v, self.kick, self.force, self.dt
        v[:] = [b + s * f for b, s, f in zip(v, kick, force, strict=True)]
        x[:] = [a + dt * b for a, b in zip(x, v, strict=True)]
        if self.turning:
            self._turn()
        gap = self.load(True)
        v[:] = [b + s * f for b, s, f in zip(v, kick, force, strict=True)]
        if self.turning:
            self._turn()
        return gap

    def _turn(self) -> None:
        self.spin[:] = [w + s * t for w, s, t in zip(self.spin, self.turn, self.torque, strict=True)]

    def free_steps(self) -> int:
        """Return how many whole steps surely pass before anything touches."""
        return min((limit() for limit in self.stride_limits), default=sys.maxsize)

    def fly(self, most: int) -> int:
        """Move on by up to ``most`` whole steps of free flight; return how many, 0 if a touch is near."""
        stride = min(most, self.free_steps())
        if stride < 1:
            return 0
        h = stride * self.dt
        self.x[:] = [a + h * (b + 0.5 * h * g) for a, b, g in zip(self.x, self.v, self.gravity, strict=True)]
        self.v[:] = [b + h * g for b, g in zip(self.v, self.gravity, strict=True)]
        return stride


def integrate(model: Plan, progress: Callable[[int, int], None] | None = None) -> Trajectory:
    """Run ``model`` for its ``n_steps`` and return the recorded frames.

    A frame is followed by the next one ``record_every`` steps later in contact, else up to ``flight_every`` steps
    later, but before anything can touch; step 0 and the last step are always recorded.

    Parameters
    ----------
    model : Plan
    progress : called every `REPORT_EVERY` steps or so with (steps done, steps in all); what it raises ends
        the run

    Raises
    ------
    RenderError
        If `check` refuses the model.
    RunError
        If a particle goes through another body or a number is no longer finite: the time step is too long or
        the contact too soft; or if there would be more than `MOST_FRAMES` frames or `MOST_NUMBERS` in them.
    """
    check(model)
    motion = _Motion(model)
    x, v, spin, force = motion.x, motion.v, motion.spin, motion.force
    last = model.n_steps
    steps, frames = array("q"), tuple(array("d") for _ in range(4))
    step, next_frame, next_report = 0, 0, REPORT_EVERY
    most = min(MOST_FRAMES, MOST_NUMBERS // (4 * len(x)))
    gap = motion.load(False)
    while True:
        if step == next_frame:
            if len(steps) >= most:
                raise RunError(
                    f"step {step} of {last}: {most} frames of {len(x) // 3} particles are recorded, expected no more: "
                    "take a larger run.record_every, or a shorter run"
                )
            steps.append(step)
            for frame, values in zip(frames, (x, v, spin, force), strict=True):
                frame.extend(values)
            free = 0 if gap <= 0.0 else min(model.flight_every, motion.free_steps())
            next_frame = min(last, step + max(model.record_every, free))
        if step >= next_report or step == last:
            if not math.isfinite(sum(x) + sum(v) + sum(spin)):
                raise RunError(
                    f"step {step}: a position or velocity is not finite: expected a smaller time step", "not-finite"
                )
            if progress is not None:
                progress(step, last)
            next_report = step + REPORT_EVERY
        if step == last:
            break
        if gap > 0.0 and next_frame - step > 1 and (stride := motion.fly(next_frame - step)):
            step += stride
            gap = motion.load(True)
        else:
            gap = motion.step()
            step += 1
    return _trajectory(model, steps, frames)


def check(model: Plan) -> None:
    """Refuse what this integrator would not simulate, or not simulate right.

    Raises
    ------
    RenderError
        For rolling friction, cohesion, and numbers that make no run (a step or stiffness that is not positive ...).
    """
    for names, contact in model.named.items():
        for key in ("rolling_friction", "cohesion"):
            value = getattr(contact, key)
            expect(value == 0.0, names, f"{key} = {value:g}", "0 (the builtin engine has none), or the engine liggghts")
        check_contact(names, contact)
    check_schedule(model)


def _trajectory(model: Plan, counted: array[int], frames: tuple[array[float], ...]) -> Trajectory:
    particles = model.scene.spheres
    steps = np.array(counted, dtype=np.int64)
    shape = (len(steps), len(particles), 3)
    x, v, spin, force = (np.array(frame, dtype=np.float64).reshape(shape) for frame in frames)
    return Trajectory(
        names=tuple(p.name for p in particles),
        step=steps,
        t=steps.astype(np.float64) * model.dt,
        x=x,
        v=v,
        spin=spin,
        force=force,
        radius=np.array([p.radius for p in particles], dtype=np.float64),
    )


def _contacts(model: Plan, motion: _Motion) -> list[_Apply]:
    index = {p.name: i for i, p in enumerate(model.scene.spheres)}
    applies = []
    for a, b in model.scene.body_pairs():
        contact = model.between(a.name, b.name)
        if isinstance(b, Wall):
            applies.append(_wall_contact(model, contact, motion, index[a.name], b))
        else:
            applies.append(_pair_contact(model, contact, motion, index[a.name], index[b.name]))
    return applies


class _Tangential:
    """Spring and dashpot of a contact along its surface, k_t delta^(n-1) and c_t delta^p."""

    def __init__(self, contact: PairContact) -> None:
        self.k_t, self.c_t, self.p = contact.k_t, contact.c_t, contact.p
        self.linear, self.spring = contact.n == 1.0, contact.spring

    def at(self, delta: float, limit: float, stretch: float, speed: float) -> tuple[float, float, float]:
        """Return the share of its stretch that the spring keeps, its stiffness [N/m], and the damping [N s/m].

        Beyond ``limit`` [N], friction times the normal force, the spring slips and the dashpot is off; without a
        spring the dashpot pulls with that at most.
        """
        c_t = self.c_t * delta**self.p if self.c_t else 0.0
        if not self.spring:
            return 0.0, 0.0, limit / speed if c_t * speed > limit else c_t
        k_t = self.k_t if self.linear else self.k_t * sqrt(delta)  # Mindlin 1949: 8 G_eff sqrt(R_eff delta)
        pull = k_t * stretch
        return (limit / pull, k_t, 0.0) if pull > limit else (1.0, k_t, c_t)


def _wall_contact(model: Plan, contact: PairContact, motion: _Motion, i: int, wall: Wall) -> _Apply:
    x, v, spin, force, torque = motion.x, motion.v, motion.spin, motion.force, motion.torque
    radius, plane, dt = float(model.scene.spheres[i].radius), float(wall.position), model.dt
    axis = AXES.index(wall.axis)
    n, b, c = 3 * i + axis, 3 * i + (axis + 1) % 3, 3 * i + (axis + 2) % 3
    side = 1.0 if x[n] > plane else -1.0
    law, mu, tangential = _law(contact), contact.friction, _Tangential(contact)
    who = f"{model.scene.spheres[i].name}–{wall.name}"
    s_b = s_c = 0.0

    def apply(moving: bool) -> float:
        nonlocal s_b, s_c
        distance = side * (x[n] - plane)
        delta = radius - distance
        if delta <= 0.0:
            s_b = s_c = 0.0
            return -delta
        if distance <= 0.0:
            raise RunError(_through(who), PASSED_THROUGH)
        f_n = law(delta, -side * v[n])
        force[n] += side * f_n
        if mu == 0.0:
            return -delta
        # velocity of the contact point, v + spin x (-arm n); LIGGGHTS puts it half-way into the overlap
        arm = side * (radius - 0.5 * delta)
        u_b, u_c = v[b] - arm * spin[c], v[c] + arm * spin[b]
        if moving:
            s_b += u_b * dt
            s_c += u_c * dt
        stretch, speed = sqrt(s_b * s_b + s_c * s_c), sqrt(u_b * u_b + u_c * u_c)
        keeps, k_t, c_t = tangential.at(delta, mu * abs(f_n), stretch, speed)
        s_b *= keeps
        s_c *= keeps
        f_b, f_c = -k_t * s_b - c_t * u_b, -k_t * s_c - c_t * u_c
        force[b] += f_b
        force[c] += f_c
        torque[b] += arm * f_c
        torque[c] -= arm * f_b
        return -delta

    return apply


def _pair_contact(model: Plan, contact: PairContact, motion: _Motion, i: int, j: int) -> _Apply:
    x, v, force, torque = motion.x, motion.v, motion.force, motion.torque
    first, second = model.scene.spheres[i], model.scene.spheres[j]
    r_i, r_j = float(first.radius), float(second.radius)
    r_sum, nearest = r_i + r_j, max(r_i, r_j)
    i0, i1, i2, j0, j1, j2 = 3 * i, 3 * i + 1, 3 * i + 2, 3 * j, 3 * j + 1, 3 * j + 2
    law, mu, friction = _law(contact), contact.friction, _PairFriction(contact, motion, i, j)
    who = f"{first.name}–{second.name}"

    def apply(moving: bool) -> float:
        d_0, d_1, d_2 = x[i0] - x[j0], x[i1] - x[j1], x[i2] - x[j2]
        distance = sqrt(d_0 * d_0 + d_1 * d_1 + d_2 * d_2)
        delta = r_sum - distance
        if delta <= 0.0:
            friction.forget()
            return -delta
        if distance <= nearest:
            raise RunError(_through(who), PASSED_THROUGH)
        n_0, n_1, n_2 = d_0 / distance, d_1 / distance, d_2 / distance
        v_0, v_1, v_2 = v[i0] - v[j0], v[i1] - v[j1], v[i2] - v[j2]
        v_n = v_0 * n_0 + v_1 * n_1 + v_2 * n_2
        f_n = law(delta, -v_n)
        f_0, f_1, f_2 = f_n * n_0, f_n * n_1, f_n * n_2
        if mu > 0.0:
            arm_i, arm_j = r_i - 0.5 * delta, r_j - 0.5 * delta
            v_t = (v_0 - v_n * n_0, v_1 - v_n * n_1, v_2 - v_n * n_2)
            u = friction.sliding((n_0, n_1, n_2), v_t, arm_i, arm_j)
            if moving:
                friction.shear((n_0, n_1, n_2), u)
            t_0, t_1, t_2 = friction.pull(delta, mu * abs(f_n), u)
            f_0, f_1, f_2 = f_0 + t_0, f_1 + t_1, f_2 + t_2
            m_0, m_1, m_2 = n_1 * t_2 - n_2 * t_1, n_2 * t_0 - n_0 * t_2, n_0 * t_1 - n_1 * t_0
            for k, arm in ((i0, arm_i), (j0, arm_j)):
                torque[k] -= arm * m_0
                torque[k + 1] -= arm * m_1
                torque[k + 2] -= arm * m_2
        force[i0] += f_0
        force[i1] += f_1
        force[i2] += f_2
        force[j0] -= f_0
        force[j1] -= f_1
        force[j2] -= f_2
        return -delta

    return apply


class _PairFriction:
    """The tangential spring of a pair, kept in the tangent plane, and its dashpot."""

    def __init__(self, contact: PairContact, motion: _Motion, i: int, j: int) -> None:
        self.spin, self.i, self.j, self.dt = motion.spin, 3 * i, 3 * j, motion.dt
        self.tangential = _Tangential(contact)
        self.forget()

    def forget(self) -> None:
        self.s = (0.0, 0.0, 0.0)

    def sliding(self, n: _Vector, v_t: _Vector, arm_i: float, arm_j: float) -> _Vector:
        """Velocity of the contact point, v_t - (arm_i spin_i + arm_j spin_j) x n."""
        spin, i, j = self.spin, self.i, self.j
        w_0 = arm_i * spin[i] + arm_j * spin[j]
        w_1 = arm_i * spin[i + 1] + arm_j * spin[j + 1]
        w_2 = arm_i * spin[i + 2] + arm_j * spin[j + 2]
        return (
            v_t[0] - (w_1 * n[2] - w_2 * n[1]),
            v_t[1] - (w_2 * n[0] - w_0 * n[2]),
            v_t[2] - (w_0 * n[1] - w_1 * n[0]),
        )

    def shear(self, n: _Vector, u: _Vector) -> None:
        """Stretch the spring by the velocity ``u`` of the contact point."""
        s_0, s_1, s_2 = (s + self.dt * rate for s, rate in zip(self.s, u, strict=True))
        along = s_0 * n[0] + s_1 * n[1] + s_2 * n[2]
        self.s = (s_0 - along * n[0], s_1 - along * n[1], s_2 - along * n[2])

    def pull(self, delta: float, limit: float, u: _Vector) -> _Vector:
        """Force on the first body [N]; the spring slips back to the Coulomb limit, without damping."""
        (s_0, s_1, s_2), (u_0, u_1, u_2) = self.s, u
        stretch, speed = sqrt(s_0 * s_0 + s_1 * s_1 + s_2 * s_2), sqrt(u_0 * u_0 + u_1 * u_1 + u_2 * u_2)
        keeps, k_t, c_t = self.tangential.at(delta, limit, stretch, speed)
        s_0, s_1, s_2 = self.s = (s_0 * keeps, s_1 * keeps, s_2 * keeps)
        return -k_t * s_0 - c_t * u_0, -k_t * s_1 - c_t * u_1, -k_t * s_2 - c_t * u_2


def _through(who: str) -> str:
    return (
        f"{who}: the overlap reached the radius, the particle went through: expected a stiffer contact "
        "for this impact, or a smaller time step"
    )


def _stride_limits(model: Plan, motion: _Motion) -> list[Callable[[], int]]:
    """For every pair a function: how many whole steps surely pass before it touches, in free flight."""
    x, v, scene = motion.x, motion.v, model.scene
    index = {p.name: i for i, p in enumerate(scene.spheres)}

    def whole(time: float) -> int:
        return model.n_steps if time == math.inf else math.floor(time / model.dt) - _STRIDE_MARGIN

    def wall_limit(i: int, radius: float, wall: Wall) -> Callable[[], int]:
        axis = AXES.index(wall.axis)
        n, plane = 3 * i + axis, float(wall.position)
        side = 1.0 if x[n] > plane else -1.0
        pull = side * scene.gravity[axis]
        return lambda: whole(wall_touch_time(side * (x[n] - plane) - radius, side * v[n], pull))

    def pair_limit(i: int, j: int, r_sum: float) -> Callable[[], int]:
        a, b = 3 * i, 3 * j

        def limit() -> int:
            d = (x[a] - x[b], x[a + 1] - x[b + 1], x[a + 2] - x[b + 2])
            w = (v[a] - v[b], v[a + 1] - v[b + 1], v[a + 2] - v[b + 2])
            return whole(pair_touch_time(d, w, r_sum))

        return limit

    limits = []
    for p, other in scene.body_pairs():
        if isinstance(other, Wall):
            limits.append(wall_limit(index[p.name], p.radius, other))
        else:
            limits.append(pair_limit(index[p.name], index[other.name], p.radius + other.radius))
    return limits
