"""What the time step of a model does to the restitution of its contacts, and the step that would do."""

from __future__ import annotations

import math
from dataclasses import dataclass

from kncal.physics.timestep import ADVISED_ERROR, WARNED_ERROR, advised_steps, restitution_error
from kncal.scene.model import PairContact


@dataclass(frozen=True, kw_only=True)
class StepError:
    """A step that makes e_n more wrong than `WARNED_ERROR`.

    Attributes
    ----------
    error : largest predicted relative error of e_n over the sub-step phases of first touch [-]; may be infinite
    steps : steps per contact t_c/dt [-]
    advised : steps per contact that make it right to `ADVISED_ERROR`, None: none does
    wanted : the run.steps_per_contact, of the model's shortest contact, that gives this contact ``advised``
    """

    error: float
    steps: float
    advised: float | None
    wanted: float | None

    def __str__(self) -> str:
        """Say it, with what to do."""
        off = f"up to {100.0 * self.error:.2g} %" if math.isfinite(self.error) else "beyond all bounds"
        text = f"{self.steps:.3g} steps per contact: e_n is {off} off by the step alone: expected "
        if self.wanted is None:
            return f"{text}a larger e_n, or more run.steps_per_contact"
        return f"{text}run.steps_per_contact = {self.wanted:g} for {100.0 * ADVISED_ERROR:g} %, or a smaller step"


def step_error(contact: PairContact, dt: float, shortest: float) -> StepError | None:
    """Return what is wrong with a step ``dt`` [s] for a contact; None if it is fine, or nothing is predicted.

    ``shortest``: the duration [s] that the model's steps per contact are counted by.
    """
    # rounded, so that the points of a sweep share most predictions
    e_n, steps = float(f"{contact.e_n:.2g}"), float(f"{contact.t_c / dt:.3g}")
    error = restitution_error(contact.law, e_n, steps, contact.end)
    if error is None or error <= WARNED_ERROR:
        return None
    advised = advised_steps(contact.law, e_n, contact.end)
    wanted = None if advised is None else float(math.ceil(advised * shortest / contact.t_c - 1e-9))
    return StepError(error=error, steps=steps, advised=advised, wanted=wanted)
