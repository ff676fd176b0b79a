"""The state of a few bodies between events, and how it moves on: the engine of `kncal.scene.exact`.

Free flight is a closed form up to the root at which two bodies touch; a contact is integrated by DOP853 (Hairer,
Nørsett & Wanner, Solving Ordinary Differential Equations I, 1993) at a relative tolerance of 1e-12, between
events: an overlap returns to zero, a force is cut, another pair touches. Overlaps are carried along as changes since
the last event, so that a micrometre keeps its digits at a height of metres.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import ValidityError
from kncal.physics.material import sphere_mass
from kncal.physics.normal_force import normal_force
from kncal.scene.contact_event import ContactEvent, only_binary
from kncal.scene.exact_pairs import BodyPair, Segment, pairs_of
from kncal.scene.flight import pair_touch_time, wall_touch_time
from kncal.scene.model import Plan

_RTOL = 1e-12
#: Contact durations per call of DOP853; after each call it is asked whether the bodies have come to rest.
_CHUNK = 20.0
#: Evaluations of the forces in one such call; an ordinary contact takes a few thousand.
_MOST_WORK = 100_000
#: Motion left, as a share of the overlap, at which bodies in contact are at rest.
_REST = 1e-9
#: Tangential speed, as a share of the relative speed, that still counts as a normal impact.
_NORMAL = 1e-12

#: Overlap [m], its rate [m/s] and the normal of one pair from the state (displacements, velocities, ...).
_Probe = Callable[[list[float]], tuple[float, float, tuple[float, float, float]]]


class SlipError(ValidityError):
    """A contact slips with friction: there is no exact motion here."""


@dataclass
class _Open:
    """A contact that has started."""

    t_start: float
    v_in: float
    started: bool
    area: float
    delta_max: float
    #: the force is cut and the bodies coast apart
    coasting: bool = False


class EventMotion:
    """The state between events, and how it moves on."""

    def __init__(self, model: Plan) -> None:
        scene = model.scene
        self.model = model
        self.names = tuple(p.name for p in scene.spheres)
        self.mass = np.array([float(sphere_mass(p.material, p.radius)) for p in scene.spheres])
        self.gravity = np.array(scene.gravity, dtype=np.float64)
        self.t = 0.0
        self.x = np.array([p.position for p in scene.spheres], dtype=np.float64)
        self.v = np.array([p.velocity for p in scene.spheres], dtype=np.float64)
        self.spin = np.array([p.spin for p in scene.spheres], dtype=np.float64)
        self.radius = np.array([p.radius for p in scene.spheres], dtype=np.float64)
        self.pairs = pairs_of(model)
        if sticky := next((pair for pair in self.pairs if pair.contact.cohesion > 0.0), None):
            raise ValidityError(
                f"{scene.name}: {sticky.names[0]}–{sticky.names[1]} have a cohesion energy density of "
                f"{sticky.contact.cohesion:g} J/m³: expected 0 for an exact motion; integrate the model instead, up to "
                "run.until_time"
            )
        self.delta = [self._overlap(p) for p in self.pairs]
        self.open: dict[int, _Open] = {}
        self.ended: list[ContactEvent] = []
        self.segments: list[Segment] = []
        self.rest_time: float | None = None
        for k, pair in enumerate(self.pairs):
            if self.delta[k] > 0.0:
                self._begin(k, started=False)
            elif self.delta[k] == 0.0 and self._pressed(pair):
                self._begin(k, started=True)

    def _overlap(self, pair: BodyPair) -> float:
        if pair.j is None:
            wall = next(w for w in self.model.scene.planes if w.name == pair.names[1])
            return float(pair.r_sum - pair.side * (self.x[pair.i, pair.axis] - wall.position))
        return float(pair.r_sum - np.linalg.norm(self.x[pair.i] - self.x[pair.j]))

    def _rate(self, pair: BodyPair) -> float:
        return -float(pair.relative(self.v) @ pair.normal(self.x))

    def _pressed(self, pair: BodyPair) -> bool:
        """Whether bodies that just touch go on into each other."""
        rate = self._rate(pair)
        return rate > 0.0 or (rate == 0.0 and pair.j is None and -pair.side * self.gravity[pair.axis] > 0.0)

    def advance(self, t_end: float) -> bool:
        """Move on to the next event or a little further, at most to ``t_end``; False if nothing is to come."""
        return self._touch(t_end) if self.open else self._fly(t_end)

    def _fly(self, t_end: float) -> bool:
        times = [self._touch_time(k) for k in range(len(self.pairs))]
        wait = min(times, default=math.inf)
        if wait == math.inf and t_end == math.inf:
            return False
        self.segments.append(Segment(self.t, self.x, self.v, self.gravity))
        touched = self.t + wait <= t_end
        h = wait if touched else t_end - self.t
        u = h * (self.v + 0.5 * h * self.gravity)
        self.v = self.v + h * self.gravity
        self._move(u, h)
        for k, time in enumerate(times):
            # two bodies that touch at one instant touch in one event
            if touched and time == wait:
                self.delta[k] = 0.0
                self._begin(k, started=True)
        return True

    def _touch_time(self, k: int) -> float:
        pair, gap = self.pairs[k], max(-self.delta[k], 0.0)
        if pair.j is None:
            return wall_touch_time(gap, -self._rate(pair), float(pair.side * self.gravity[pair.axis]))
        d, w = self.x[pair.i] - self.x[pair.j], pair.relative(self.v)
        return pair_touch_time(
            (float(d[0]), float(d[1]), float(d[2])), (float(w[0]), float(w[1]), float(w[2])), pair.r_sum
        )

    def _move(self, u: Array, h: float) -> None:
        self.delta = [d + float(p.change(self.x, u)) for d, p in zip(self.delta, self.pairs, strict=True)]
        self.x = self.x + u
        self.t += h

    def _begin(self, k: int, *, started: bool) -> None:
        pair = self.pairs[k]
        w, n = pair.relative(self.v), pair.normal(self.x)
        others = (pair.i,) if pair.j is None else (pair.i, pair.j)
        turn = sum(self.radius[m] * np.cross(self.spin[m], n) for m in others)
        slip = w - (w @ n) * n - turn
        if pair.contact.friction > 0.0 and np.linalg.norm(slip) > _NORMAL * np.linalg.norm(w):
            raise SlipError(
                f"{self.model.scene.name}: {pair.names[0]}–{pair.names[1]} touch at t = {self.t:.6g} s with a "
                f"tangential velocity and friction {pair.contact.friction:g}: expected a normal impact or no "
                "friction for an exact solution; integrate the model instead"
            )
        rate = self._rate(pair)
        self.open[k] = _Open(self.t, rate, started, 0.0, self.delta[k])

    def _end(self, k: int) -> None:
        self.ended.append(self._event(k, ended=True))
        del self.open[k]
        self.delta[k] = 0.0

    def _event(self, k: int, *, ended: bool) -> ContactEvent:
        touch = self.open[k]
        t_c = self.t - touch.t_start
        v_out = -self._rate(self.pairs[k]) if ended else None
        complete = touch.started and ended
        return ContactEvent(
            pair=self.pairs[k].names,
            t_start=touch.t_start,
            t_c=t_c,
            delta_max=max(touch.delta_max, self.delta[k]),
            delta_mean=touch.area / t_c if t_c > 0.0 else self.delta[k],
            v_in=touch.v_in,
            v_out=v_out,
            e_n=v_out / touch.v_in if complete and v_out is not None and touch.v_in > 0.0 else None,
            complete=complete,
        )

    def _touch(self, t_end: float) -> bool:
        from scipy.integrate import solve_ivp

        active = sorted(self.open)
        half = self.x.size
        t_c = max(self.pairs[k].contact.t_c for k in active)
        start = np.concatenate([np.zeros(half), self.v.ravel(), np.zeros(len(active))])
        events, actions = self._events(active)
        span = min(t_end - self.t, _CHUNK * t_c)
        found: Any = solve_ivp(
            self._derivative(active),
            (0.0, span),
            start,
            method="DOP853",
            rtol=_RTOL,
            atol=self._tolerance(active),
            events=events,
            dense_output=True,
        )
        if found.status < 0:
            raise ValidityError(f"{self.model.scene.name}: contact at t = {self.t:.6g} s: {found.message}")
        h, y = float(found.t[-1]), found.y[:, -1]
        if h > 0.0:
            self.segments.append(Segment(self.t, self.x, self.v, self.gravity, found.sol))
        for peak, (what, k) in enumerate(actions):
            if what == "peak" and found.t_events[peak].size:
                shape = (-1, *self.x.shape)
                changes = self.pairs[k].change(self.x, found.y_events[peak][:, :half].reshape(shape))
                self.open[k].delta_max = max(self.open[k].delta_max, self.delta[k] + float(changes.max()))
        for m, k in enumerate(active):
            self.open[k].area += float(y[2 * half + m])
        self.v = y[half : 2 * half].reshape(self.x.shape).copy()
        self._move(y[:half].reshape(self.x.shape), h)
        for k in active:
            deepest = max(self.open[k].delta_max, self.delta[k])
            if deepest >= self.pairs[k].deepest:
                raise ValidityError(
                    f"{self.model.scene.name}: {self.pairs[k].names[0]}–{self.pairs[k].names[1]}: the overlap "
                    f"{deepest:.3g} m reaches the radius: expected a stiffer contact or a slower impact"
                )
        for (what, k), times in zip(actions, found.t_events, strict=True):
            # a terminal event is the last thing that happened
            if found.status == 1 and what != "peak" and times.size:
                self._act(what, k)
        self._settle(active)
        if found.status == 0 and self.open:
            self._rest(sorted(self.open), t_c)
        return True

    def _settle(self, active: list[int]) -> None:
        """Also act on what happened at the same instant as the event that was found (symmetric scenes)."""
        for k, pair in enumerate(self.pairs):
            if k in self.open and k in active and self._rate(pair) < 0.0:
                if self.delta[k] <= 0.0:
                    self._end(k)
                elif pair.contact.end == "force" and self._force(k)(self.delta[k], self._rate(pair)) <= 0.0:
                    self.open[k].coasting = True
            elif k not in self.open and self.delta[k] >= 0.0 and self._pressed(pair):
                self._begin(k, started=True)

    def _act(self, what: str, k: int) -> None:
        if what == "end":
            self._end(k)
        elif what == "begin":
            self.delta[k] = 0.0
            self._begin(k, started=True)
        else:
            self.open[k].coasting = what == "cut"

    def _tolerance(self, active: list[int]) -> Array:
        """Absolute tolerances, from the overlap and speed that the energy of the contacts allows."""
        g = float(np.linalg.norm(self.gravity))
        length, speed = 0.0, 0.0
        for k in active:
            c, delta, rate = self.pairs[k].contact, self.delta[k], self._rate(self.pairs[k])
            static = (c.m_eff * g / c.k) ** (1.0 / c.n)
            energy = 0.5 * c.m_eff * rate**2 + c.k * max(delta, static) ** (c.n + 1.0) / (c.n + 1.0)
            length = max(length, (energy * (c.n + 1.0) / c.k) ** (1.0 / (c.n + 1.0)))
            speed = max(speed, math.sqrt(2.0 * energy / c.m_eff))
        tiny = np.finfo(np.float64).tiny
        sizes = [length, speed, length * self.pairs[active[0]].contact.t_c]
        counts = [self.x.size, self.x.size, len(active)]
        return np.repeat([max(0.1 * _RTOL * size, tiny) for size in sizes], counts)

    def _rest(self, active: list[int], t_c: float) -> None:
        """Note that everything has come to rest in its contacts, if it has."""
        y = np.concatenate([np.zeros(self.x.size), self.v.ravel(), np.zeros(len(active))])
        acceleration = np.array(self._derivative(active)(0.0, y)[self.x.size : 2 * self.x.size])
        limit = _REST * min(max(self.delta[k], 0.0) for k in active)
        if np.abs(self.v).max() * t_c <= limit and np.abs(acceleration).max() * t_c**2 <= limit:
            self.rest_time = self.t
            self.v = np.zeros_like(self.v)
            self.segments.append(Segment(self.t, self.x, self.v, np.zeros(3)))

    def statement(self) -> str:
        """How the motion goes on, in words."""
        touching = ", ".join("–".join(self.pairs[k].names) for k in sorted(self.open))
        if self.rest_time is not None:
            return f"at rest in contact from t = {self.rest_time:.6g} s on ({touching})"
        return f"in contact at t = {self.t:.6g} s ({touching})" if touching else "in free flight"

    def contacts(self, t_end: float) -> tuple[ContactEvent, ...]:
        """All contacts up to ``t_end``, in the order of their start."""
        for k, touch in self.open.items():
            # bodies at rest are not integrated further
            touch.area += (t_end - self.t) * self.delta[k]
        self.t = t_end
        events = [*self.ended, *(self._event(k, ended=False) for k in sorted(self.open))]
        return only_binary(sorted(events, key=lambda event: event.t_start), self.names)

    def _probe(self, k: int) -> _Probe:
        pair, delta_0, half = self.pairs[k], self.delta[k], self.x.size
        if pair.j is None:
            axis, side = 3 * pair.i + pair.axis, pair.side
            nx, ny, nz = (float(c) for c in pair.normal(self.x))
            return lambda y: (delta_0 - side * y[axis], -side * y[half + axis], (nx, ny, nz))
        a, b = 3 * pair.i, 3 * pair.j
        dx, dy, dz = (float(c) for c in self.x[pair.i] - self.x[pair.j])
        near = math.sqrt(dx * dx + dy * dy + dz * dz)

        def probe(y: list[float]) -> tuple[float, float, tuple[float, float, float]]:
            wx, wy, wz = y[a] - y[b], y[a + 1] - y[b + 1], y[a + 2] - y[b + 2]
            x, y_, z = dx + wx, dy + wy, dz + wz
            far = math.sqrt(x * x + y_ * y_ + z * z)
            grown = (wx * (dx + x) + wy * (dy + y_) + wz * (dz + z)) / (near + far)
            x, y_, z = x / far, y_ / far, z / far
            h = half
            rate = (y[h + b] - y[h + a]) * x + (y[h + b + 1] - y[h + a + 1]) * y_ + (y[h + b + 2] - y[h + a + 2]) * z
            return delta_0 - grown, rate, (x, y_, z)

        return probe

    def _force(self, k: int) -> Callable[[float, float], float]:
        """The force of a contact, before any cut, continued to small gaps for trial points beyond the end."""
        contact = self.pairs[k].contact
        law = normal_force(contact.k, contact.n, contact.c, contact.p)
        if contact.n == 1.0 and contact.p == 0.0:
            return law
        return lambda delta, rate: law(delta, rate) if delta > 0.0 else 0.0

    def _derivative(self, active: list[int]) -> Callable[[float, Any], list[float]]:
        """Right-hand side for (displacements, velocities, time integrals of the active overlaps)."""
        half, left = self.x.size, _MOST_WORK
        rest = [float(g) for _ in self.names for g in self.gravity]
        parts = []
        for k in active:
            pair, touch = self.pairs[k], self.open[k]
            masses = (float(self.mass[pair.i]), math.inf if pair.j is None else float(self.mass[pair.j]))
            at = (3 * pair.i, 0 if pair.j is None else 3 * pair.j)
            parts.append((self._probe(k), self._force(k), touch.coasting, at, masses))

        def derivative(_: float, state: Any) -> list[float]:
            nonlocal left
            left -= 1
            if left < 0:
                touching = ", ".join("–".join(self.pairs[k].names) for k in active)
                raise ValidityError(
                    f"{self.model.scene.name}: the contact at t = {self.t:.6g} s ({touching}) is too strongly damped "
                    f"to be followed exactly ({_MOST_WORK} evaluations were not enough): expected a larger e_n"
                )
            y, a, overlaps = state.tolist(), rest[:], []
            for probe, force, coasting, (i, j), (m_i, m_j) in parts:
                delta, rate, normal = probe(y)
                overlaps.append(delta)
                if not coasting:
                    f = force(delta, rate)
                    for axis, n in enumerate(normal):
                        a[i + axis] += f * n / m_i
                        a[j + axis] -= f * n / m_j
            return [*y[half : 2 * half], *a, *overlaps]

        return derivative

    def _events(self, active: list[int]) -> tuple[list[Any], list[tuple[str, int]]]:
        """Event functions for solve_ivp, and what each means for which pair."""
        events: list[Any] = []
        actions: list[tuple[str, int]] = []

        def add(what: str, k: int, value: Callable[[list[float]], float], direction: int) -> None:
            def event(_: float, state: Any) -> float:
                return value(state.tolist())

            event.terminal = what != "peak"  # type: ignore[attr-defined]
            event.direction = direction  # type: ignore[attr-defined]
            events.append(event)
            actions.append((what, k))

        for k, pair in enumerate(self.pairs):
            probe = self._probe(k)
            if k not in active:
                add("begin", k, lambda y, probe=probe: probe(y)[0], +1)  # type: ignore[misc]
                continue
            add("end", k, lambda y, probe=probe: probe(y)[0], -1)  # type: ignore[misc]
            add("peak", k, lambda y, probe=probe: probe(y)[1], -1)  # type: ignore[misc]
            if pair.contact.end == "force":
                force = self._force(k)
                value = lambda y, probe=probe, force=force: force(*probe(y)[:2])  # noqa: E731
                add("press" if self.open[k].coasting else "cut", k, value, +1 if self.open[k].coasting else -1)
        return events, actions
