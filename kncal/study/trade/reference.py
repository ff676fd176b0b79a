"""The reference of a trade: when all runs end, and at which N Hertz has converged."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kncal.core.errors import InputError, KncalError, RunError
from kncal.physics.laws import LAWS
from kncal.physics.timestep import predict_error
from kncal.scene.case_file import load_case
from kncal.scene.model import Plan
from kncal.scene.plan import MOST_STEPS, plan
from kncal.scene.scene import Scene
from kncal.study.trade.candidates import Contact
from kncal.study.trade.errors import Reference, converge
from kncal.study.trade.runs import Runs
from kncal.study.trade.trade import Candidate, Convergence
from kncal.study.variants import Changes, removing, texts

#: The reference is tried at these numbers of steps per contact.
REFERENCE_STEPS = tuple(100.0 * 2.0**k for k in range(8))
#: What is to be left of the reference's error at most, where no tolerance says.
DEFAULT_THRESHOLD = 1e-3
#: The reference takes this share of the smallest tolerance.
_SHARE = 0.1
#: A reference that would have more steps than this is not refined further.
_MOST_STEPS = min(20_000_000, MOST_STEPS)


@dataclass(frozen=True, kw_only=True)
class Ends:
    """When the runs of a trade end.

    Attributes
    ----------
    changes : that pin it, the same for all
    until : where the case itself ends, by the reference [s]; None: at the pinned time
    contacts : contacts 1 to this number count, None: all
    pinned : [s]
    """

    changes: Changes
    until: float | None
    contacts: int | None
    pinned: float

    @property
    def overrides(self) -> tuple[str, ...]:
        """The same as texts."""
        return texts(self.changes)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What to know about it."""
        if self.until is None:
            return ()
        return (
            f"All runs end at {self.pinned:.4g} s, when the softest contact is over, so that their costs compare. Paths"
            f" are compared up to {self.until:.4g} s, where the case itself ends.",
        )


def ends_of(case: str | Path, scene: Scene, reference: Contact, tried: Sequence[Contact]) -> Ends:
    """Pin the end of all runs: costs compare only over the same time, and the softest contact takes longest.

    A prescribed time step is taken out: N decides here.
    """
    no_dt = removing(case, "run.dt")
    if scene.run.until_time is not None:
        return Ends(changes=no_dt, until=None, contacts=None, pinned=scene.run.until_time)
    until = plan(load_case(case, overrides=texts({**reference.changes, **no_dt})), ("hertz",))["hertz"].t_end
    latest = until
    for contact in tried:
        try:
            models = plan(load_case(case, overrides=texts({**contact.changes, **no_dt})), (contact.model,))
        except KncalError:
            continue  # it cannot be, or never bounces: its run tells why
        latest = max(latest, models[contact.model].t_end)
    changes = {"run.until_bounces": None, "run.until_time": latest, **no_dt}
    return Ends(changes=changes, until=until, contacts=scene.run.until_bounces, pinned=latest)


def converged_steps(model: Plan, threshold: float, least: float) -> float:
    """Return the N of `REFERENCE_STEPS` (at least ``least``) at which any sub-step phase of the first touch would do.

    A damped linear contact jumps at touch and converges slower than Hertz. Its predicted worst error at a hundred steps
    falls with 1/N at least.
    """
    first = REFERENCE_STEPS[0]
    laws = {(c.law, c.e_n, c.end) for c in model.contacts.values()}
    worst = max(float(max(predict_error(law, e_n, first, end).worst.values())) for law, e_n, end in laws)
    needed = max(least, first * worst / threshold)
    return next((n for n in REFERENCE_STEPS if n >= needed), REFERENCE_STEPS[-1])


def find_reference(
    runs: Runs, contact: Contact, ends: Ends, tolerances: Mapping[str, float]
) -> tuple[Candidate, Reference, Convergence]:
    """Double N until no judged metric moves by more than a tenth of the smallest tolerance, nor has more left.

    Raises
    ------
    RunError
        If a run of the reference does not complete.
    """
    threshold = _SHARE * min(tolerances.values()) if tolerances else DEFAULT_THRESHOLD
    tried: dict[float, Any] = {}
    for n in REFERENCE_STEPS:
        candidate = contact.at(n, ends.changes)
        runs.run([candidate])
        ended = runs.ended[candidate.name]
        if candidate.name not in runs.data:
            raise RunError(f"the reference at N = {n:g} {ended.status.replace('_', ' ')}: {ended.message}")
        tried[n] = runs.data[candidate.name]
        found = converge(tried, tolerances, threshold, ends.until, ends.contacts)
        if found.converged or 2 * tried[n].model.n_steps > _MOST_STEPS:
            break
    truth = Reference(run=tried[n], until=ends.until, contacts=ends.contacts, left=found.left)
    return candidate, truth, found


def reference_steps(scene: Scene, steps: tuple[float, ...], tolerance: float) -> tuple[float, float]:
    """Return N of the reference, and the discretisation error of one contact there, mean over phases [-].

    The chaos of a bed hides what a step does to its averages until runs are very long, so that N is chosen by what the
    step does to contacts: the smallest of ``steps`` and the case's own, not below the latter, at which no mean error
    of a contact is more than `_SHARE` of the ``tolerance``; else the largest.
    """
    own = scene.run.steps_per_contact
    found = math.nan
    chosen = own
    for chosen in sorted({own, *(n for n in steps if n > own)}):
        try:
            predicted = predict_error(LAWS.find(scene.contact.law), scene.contact.e_n, chosen, scene.contact.end)
        except InputError:
            continue
        found = max(abs(value) for value in predicted.mean.values())
        if found <= _SHARE * tolerance:
            break
    return chosen, found
