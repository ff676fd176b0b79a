"""Exact motion of a few bodies with normal contacts only, from event to event: no time step of a solver in it.

`solve` gives the motion, `bounce_time` the end time of a run "until the apex after n contacts"; closed forms for
single problems come along from `kncal.physics.closed_forms`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from kncal.core.checks import Array, in_range
from kncal.core.errors import ValidityError
from kncal.physics.closed_forms import DampedBounce, GrossSliding, SlipEnd, damped_bounce, gross_sliding, slip_end
from kncal.scene.contact_event import ContactEvent
from kncal.scene.exact_motion import EventMotion, SlipError
from kncal.scene.exact_pairs import Segment
from kncal.scene.model import Plan

__all__ = [
    "DampedBounce",
    "ExactSolution",
    "GrossSliding",
    "SlipEnd",
    "SlipError",
    "bounce_time",
    "damped_bounce",
    "gross_sliding",
    "slip_end",
    "solve",
]

#: Calls without a start or an end of a contact (20 contact durations each) after which bodies never separate.
_PATIENCE = 5


@dataclass(frozen=True)
class ExactSolution:
    """The exact motion of a model.

    Attributes
    ----------
    names : of the particles
    t_end : [s]
    contacts : every contact in the order of its start; the last may be incomplete
    rest_time : time from which all bodies are at rest in contact [s], None if they are not
    statement : one sentence about how the motion goes on at ``t_end``
    """

    names: tuple[str, ...]
    t_end: float
    contacts: tuple[ContactEvent, ...]
    rest_time: float | None
    statement: str
    segments: tuple[Segment, ...] = field(repr=False)

    def at(self, times: ArrayLike) -> tuple[Array, Array]:
        """Return positions and velocities (times, particles, 3) [m], [m/s] at ``times`` in 0 … t_end.

        Raises
        ------
        InputError
            If a time is outside.
        """
        t = np.atleast_1d(in_range("times", times, 0.0, self.t_end, unit="s")).ravel()
        which = np.searchsorted([s.t_0 for s in self.segments], t, side="right") - 1
        x = np.empty((t.size, len(self.names), 3))
        v = np.empty_like(x)
        for k in np.unique(which):
            here = which == k
            x[here], v[here] = self.segments[k].at(t[here])
        return x, v


def solve(model: Plan, t_end: float) -> ExactSolution:
    """Return the exact motion of ``model`` from 0 to ``t_end`` [s].

    The forces are those of the model's normal contacts and gravity. A contact with friction is accepted only as
    long as nothing moves tangentially in it.

    Raises
    ------
    InputError
        If ``t_end`` is negative or not finite.
    ValidityError
        If friction or cohesion would act, or an overlap reaches a radius.
    """
    end = float(in_range("t_end", t_end, 0.0, math.inf, unit="s"))
    motion = EventMotion(model)
    while motion.t < end and motion.rest_time is None:
        motion.advance(end)
    segments = motion.segments or [Segment(0.0, motion.x, motion.v, motion.gravity)]
    return ExactSolution(
        names=motion.names,
        t_end=end,
        contacts=motion.contacts(end),
        rest_time=motion.rest_time,
        statement=motion.statement(),
        segments=tuple(segments),
    )


def bounce_time(model: Plan, n: int) -> float:
    """Return the time of the apex after the n-th contact of ``model`` [s], or half way to the next contact before it.

    Without gravity, or if nothing moves up after that contact: its end plus half its duration in place of the apex.

    Raises
    ------
    ValidityError
        If there are fewer than ``n`` contacts that end, with the reason; as `solve`.
    """
    bounces = int(in_range("n", n, 1, 1e6))
    motion = EventMotion(model)
    idle = 0
    while len(motion.ended) < bounces:
        before = (len(motion.ended), len(motion.open))
        moving = motion.advance(math.inf)
        idle = idle + 1 if (len(motion.ended), len(motion.open)) == before else 0
        if not moving or motion.rest_time is not None or idle > _PATIENCE:
            why = motion.statement() if motion.open else "nothing touches any more"
            most = f"run.until_bounces of at most {len(motion.ended)}, or " if motion.ended else ""
            raise ValidityError(
                f"{model.scene.name} ({model.kind}): only {len(motion.ended)} of the {bounces} contacts end ({why}): "
                f"expected {most}run.until_time"
            )
    last = motion.ended[bounces - 1]
    g = float(np.linalg.norm(model.scene.gravity))
    rise = 0.0
    if g > 0.0:
        up = -np.asarray(model.scene.gravity) / g
        rise = max(float(motion.v[i] @ up) / g for i, name in enumerate(motion.names) if name in last.pair)
    end = last.t_start + last.t_c
    apex = end + (rise if rise > 0.0 else 0.5 * last.t_c)
    while motion.t < apex and not motion.open and motion.advance(apex):
        pass
    following = [event.t_start for event in motion.contacts(apex) if event.t_start > end]
    return min(apex, 0.5 * (end + min(following, default=math.inf)))
