"""What became of a run: stable, or what went wrong first, with the numbers that say so."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from kncal.core.errors import InputError, KncalError, RunError
from kncal.engines.tunnelling import PASSED_THROUGH, passages
from kncal.observe.contacts import Observations, observe
from kncal.observe.energy import balance_of, energy
from kncal.physics.material import sphere_mass
from kncal.physics.timestep import predict_error
from kncal.record.frames import Trajectory
from kncal.scene.model import Plan

STABLE, GAIN, RESTITUTION = "stable", "energy-gain", "wrong-restitution"
TUNNELLING, LOST, NOT_FINITE, REFUSED, FAILED = "tunnelling", "lost-particles", "not-finite", "refused", "failed"
#: What a run can come to, from good to bad.
OUTCOMES = (STABLE, RESTITUTION, GAIN, TUNNELLING, LOST, NOT_FINITE, REFUSED, FAILED)

#: A restitution this far off is wrong, whatever the time step leads one to expect.
RESTITUTION_WRONG = 0.05
#: The worst of a sample of sub-step phases may lie this share of itself beyond the worst of another sample.
_SAMPLED = 1.25
#: The nudge of a probe at rest has grown if the kinetic energy of the last third of the steps is larger than in the
#: third before by this factor.
GROWN = 4.0
#: ... or if it was ever larger than at the start by this factor: growth ends early where the stiffness of Hertz
#: contacts depends on the amplitude, and at 1e8, when a contact opens (see `kncal.study.stability.probes.NUDGE`).
OPENED = 100.0
#: Below this share of the kinetic energy at the start, what is left is rounding.
_GONE = 1e-8


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a run.

    Attributes
    ----------
    code : one of `OUTCOMES`
    message : one sentence
    numbers : what was measured: energy_change and balance_error (shares of the energy at the start), e_n (worst
        contact), e_n_error and e_n_predicted (relative), growth (factor of the amplitude per step, of a probe at rest),
        momentum (change of the total momentum over the sum of |p| at the start, of a scene without walls)
    """

    code: str
    message: str
    numbers: Mapping[str, float] = field(default_factory=dict)

    @property
    def stable(self) -> bool:
        """Whether nothing went wrong."""
        return self.code == STABLE


def outcome_of_failure(failure: str, message: str) -> Outcome:
    """Return the outcome of a run that did not complete; ``failure`` is one of `kncal.record.outcome.FAILURES`."""
    codes = {PASSED_THROUGH: TUNNELLING, "lost-particles": LOST, "not-finite": NOT_FINITE, "bad-input": REFUSED}
    return Outcome(code=codes.get(failure, FAILED), message=message)


def outcome_of_error(error: KncalError) -> Outcome:
    """Return the outcome of a run that raised, in the run (`RunError`) or before it."""
    return outcome_of_failure(error.failure if isinstance(error, RunError) else "bad-input", str(error))


def judge(model: Plan, trajectory: Trajectory, *, pressed: bool = False) -> Outcome:
    """Return what became of a run, from its frames.

    Parameters
    ----------
    model : Plan
        Smooth contacts; the energy of others cannot be told.
    trajectory : dense in contact
    pressed : the bodies start at rest under load (see `kncal.study.stability.probes`): a growing nudge is what is
        looked for
    """
    for array in (trajectory.x, trajectory.v, trajectory.force):
        if not np.isfinite(array).all():
            return Outcome(code=NOT_FINITE, message="a position, velocity or force is not finite")
    if through := passages(model, trajectory):
        return Outcome(code=TUNNELLING, message=through[0])
    return _judge_pressed(model, trajectory) if pressed else _judge_motion(model, trajectory)


def _judge_pressed(model: Plan, trajectory: Trajectory) -> Outcome:
    found = energy(model.without_friction(), trajectory)  # of a spring that sticks nothing is looked at
    part = len(found.t) // 3
    if part < 10 or found.kinetic[0] <= 0.0:
        raise InputError(
            f"{len(found.t)} frames: expected at least 30, and a nudge at the start, to see whether it grows"
        )
    middle, late = float(found.kinetic[part : 2 * part].max()), float(found.kinetic[2 * part :].max())
    start = float(found.kinetic[0])
    ratio = late / middle if late > _GONE * start else 0.0
    most = float(found.kinetic.max()) / start
    growth = ratio ** (0.5 / part)
    gain = float(found.mechanical[-1] - found.mechanical[0]) / max(float(found.stored[0]), np.finfo(float).tiny)
    numbers = {"growth": growth, "energy_change": gain}
    if ratio > GROWN or most > OPENED:
        message = f"a nudge grows; the energy changes by {gain:.3g} of what is stored"
        return Outcome(code=GAIN, message=message, numbers=numbers)
    return Outcome(code=STABLE, message=f"a nudge does not grow (factor {growth:.4g} per step)", numbers=numbers)


def _judge_motion(model: Plan, trajectory: Trajectory) -> Outcome:
    seen, found = observe(model, trajectory), energy(model, trajectory)
    scale = float(found.kinetic[0] + found.stored[0])
    numbers: dict[str, float] = {}
    if scale > 0.0:
        numbers["energy_change"] = float(found.mechanical[-1] - found.mechanical[0]) / scale
        balances = [balance_of(event, found) for event in seen.contacts]
        numbers["balance_error"] = max(balances, key=abs, default=0.0)
    if not model.scene.planes and not any(model.scene.gravity):
        numbers["momentum"] = _momentum(model, trajectory)
    numbers |= _restitution(model, seen)
    worst = numbers.get("e_n_predicted")
    created = numbers.get("energy_change", 0.0)
    # an undamped contact may give back a little more than it got, by an error of the step that is no instability
    allowed = 2.0 * _SAMPLED * worst if worst is not None else RESTITUTION_WRONG
    if created > allowed + 1e-9:
        return Outcome(code=GAIN, message=f"the energy grows by {100.0 * created:.3g} %", numbers=numbers)
    off = numbers.get("e_n_error")
    if off is None:
        unended = [event for event in seen.contacts if not event.complete]
        text = f"{len(unended)} contact(s) do not end" if unended else "nothing touched"
        return Outcome(code=STABLE, message=f"no gain of energy; {text}", numbers=numbers)
    beyond = worst is not None and abs(off) > _SAMPLED * worst + 1e-9
    if abs(off) > RESTITUTION_WRONG or beyond:
        expected = "no prediction at so few steps" if worst is None else f"predicted: up to {100.0 * worst:.3g} %"
        return Outcome(
            code=RESTITUTION,
            message=f"e_n is {100.0 * off:+.3g} % off ({expected})",
            numbers=numbers,
        )
    return Outcome(code=STABLE, message=f"e_n is {100.0 * off:+.3g} % off, as predicted", numbers=numbers)


def _restitution(model: Plan, seen: Observations) -> dict[str, float]:
    """The contact whose restitution is furthest off; nothing for bodies that touch several others at once."""
    touched: dict[str, int] = {}
    for event in seen.contacts:
        for name in event.pair:
            touched[name] = touched.get(name, 0) + 1
    moving = {p.name for p in model.scene.spheres}
    single = [e for e in seen.contacts if e.e_n is not None and all(touched[n] == 1 for n in e.pair if n in moving)]
    if not single:
        return {}
    event = max(single, key=lambda e: abs(float(e.e_n or 0.0) / _exact_e_n(model, e.pair) - 1.0))
    e_n, exact = float(event.e_n or 0.0), _exact_e_n(model, event.pair)
    numbers = {"e_n": e_n, "e_n_error": e_n / exact - 1.0}
    c = model.between(*event.pair)
    steps = c.t_c / model.dt
    try:
        numbers["e_n_predicted"] = predict_error(c.law, c.e_n, max(steps, 3.0), c.end).worst["e_n"]
    except InputError:
        return numbers  # too few steps for any prediction
    if steps < 3.0:
        del numbers["e_n_predicted"]
    return numbers


def _exact_e_n(model: Plan, pair: tuple[str, str]) -> float:
    return model.between(*pair).e_n


def _momentum(model: Plan, trajectory: Trajectory) -> float:
    m = np.array([float(sphere_mass(p.material, p.radius)) for p in model.scene.spheres])
    p = np.einsum("p,fpk->fk", m, trajectory.v)
    scale = float((m * np.linalg.norm(trajectory.v[0], axis=1)).sum())
    return float(np.linalg.norm(p[-1] - p[0])) / scale if scale > 0.0 else math.nan
