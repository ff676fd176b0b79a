"""What a scene runs into, found before a run: refused, or said; nothing is changed.

The limits themselves are functions of `kncal.scene.contact_limits`, `kncal.scene.box_limits` and
`kncal.scene.gas_limits`; `LIMITS` says for which scenes each speaks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from kncal.scene import box_limits, contact_limits, gas_limits, granular_limits, wall_limits
from kncal.scene.finding import Finding
from kncal.scene.load import EPS_SETTLED, settled_voidage
from kncal.scene.model import Plan
from kncal.scene.scene import Scene
from kncal.scene.species import listed

#: Limits that differ from model to model; of the others (gas, coupling) each is said once.
_OF_CONTACTS = ("dem-step", "static-overlap", "cohesion")


class Limit(NamedTuple):
    """One limit: for which scenes it speaks, and what finds it in a plan and the voidage of the packing [-]."""

    speaks: Callable[[Any], bool]
    find: Callable[[Any, float], Iterable[Finding]]


def _single(scene: Scene) -> bool:
    return not scene.coupled


def _many(scene: Scene) -> bool:
    return scene.coupled


def _boxed(scene: Scene) -> bool:
    return scene.run.coupling is not None


def _granular(scene: Scene) -> bool:
    return scene.coupled and scene.run.coupling is None


def _gas(scene: Scene) -> bool:
    return scene.gas is not None


def _heavy(scene: Scene) -> bool:
    """Whether gas acts against the weight of particles."""
    return scene.gas is not None and scene.number > 0 < scene.g


def _loose(scene: Scene) -> bool:
    """Whether gas acts against the weight of particles that can move."""
    return _heavy(scene) and not scene.frozen


#: Every limit, in the order in which they are said.
LIMITS = (
    Limit(_single, lambda p, _: contact_limits.first_impacts_starts_and_rest(p)),
    Limit(_single, lambda p, _: contact_limits.steps(p)),
    Limit(_single, lambda p, _: contact_limits.recording(p)),
    Limit(lambda _: True, lambda p, _: contact_limits.cohesion(p)),
    Limit(_boxed, lambda p, _: box_limits.depth(p.scene)),
    Limit(_many, lambda p, _: contact_limits.dem_steps(p)),
    Limit(_many, lambda p, _: contact_limits.bottom_of_bed(p)),
    Limit(_granular, lambda p, _: granular_limits.impacts(p)),
    Limit(_granular, lambda p, _: granular_limits.streams(p.scene)),
    Limit(_granular, lambda p, _: granular_limits.phases(p)),
    Limit(_granular, lambda p, _: granular_limits.strays(p.scene)),
    Limit(_granular, lambda p, _: wall_limits.walls(p)),
    Limit(_gas, lambda p, _: box_limits.jet_faces(p.scene, p.scene.gas)),
    Limit(_gas, lambda p, _: box_limits.small_cells(p.scene, p.scene.gas)),
    Limit(_gas, lambda p, eps: gas_limits.courant(p, p.scene.gas, eps)),
    Limit(_gas, lambda p, eps: box_limits.coarse_cells(p.scene, p.scene.gas, eps)),
    Limit(_gas, lambda p, _: gas_limits.added_mass(p.scene, p.scene.gas)),
    Limit(_gas, lambda p, eps: gas_limits.fast_gas(p.scene, p.scene.gas, eps)),
    Limit(_gas, lambda p, eps: gas_limits.held_drag(p, p.scene.gas, eps)),
    Limit(_heavy, lambda p, eps: gas_limits.relaxation(p, p.scene.gas, eps)),
    Limit(_heavy, lambda p, _: gas_limits.way(p, p.scene.gas)),
    Limit(_loose, lambda p, eps: gas_limits.lift(p.scene, p.scene.gas, eps)),
    Limit(_loose, lambda p, eps: box_limits.room(p.scene, p.scene.gas, eps)),
)


def check(plan: Plan, positions: ArrayLike | None = None) -> tuple[Finding, ...]:
    """Return every limit that a scene runs into, refusals first; warnings of its contacts are in `PairContact`.

    Of bodies that are alike (`kncal.scene.species`) the worst.

    Parameters
    ----------
    plan : Plan
    positions : (n, 3) centres of the settled packing [m]; its voidage is then measured instead of assumed
    """
    scene, eps = plan.scene, EPS_SETTLED
    found: list[Finding] = []
    if positions is not None and _boxed(scene):
        x = np.asarray(positions, dtype=np.float64)
        found += box_limits.places(scene, x)
        if all(finding.code != "positions" for finding in found):
            eps = settled_voidage(scene, x)
    for limit in LIMITS:
        if limit.speaks(scene):
            found += limit.find(plan, eps)
    return tuple(sorted(found, key=lambda finding: finding.level != "refuse"))


def findings_of(plans: Iterable[Plan]) -> Iterator[tuple[str, Finding]]:
    """Yield the limits that the plans of one scene run into, and before each its model; of gas and coupling only once.

    Coupling intervals of the models are whole numbers of their own steps, so numbers in the texts differ a little.
    """
    said: set[tuple[str, str]] = set()
    for plan in plans:
        shared = plan.scene.coupled
        found = [f for f in check(plan) if not shared or f.code in _OF_CONTACTS or (f.code, f.level) not in said]
        said |= {(f.code, f.level) for f in found}
        yield from (("" if shared and f.code not in _OF_CONTACTS else f"{plan.kind}: ", f) for f in found)


def warnings_of(plans: Mapping[str, Plan]) -> tuple[str, ...]:
    """Return the warnings about the runs of these plans, each text once, with the pairs that it is about.

    Attraction at the end of the contact, which nearly every damped contact has, is left to the tables.
    """
    texts = dict.fromkeys(
        f"{model}{found.message}" for model, found in findings_of(plans.values()) if found.level == "warn"
    )
    pairs: dict[str, dict[str, None]] = {}
    codes: dict[str, str] = {}
    for plan in plans.values():
        for which, contact in plan.contacts.items():
            for code, text in contact.warnings.items():
                if code != "attraction":
                    pairs.setdefault(text, {})[plan.species.label(which)] = None
                    codes[text] = code
    told: dict[str, list[str]] = {}
    for text, names in pairs.items():
        told.setdefault(codes[text], []).append(f"{listed(list(names))}: {text}")
    return (*texts, *(text for each in told.values() for text in _first(each)))


def _first(texts: list[str]) -> Iterator[str]:
    """The first few of the warnings of one kind; of the others how many they are."""
    most = contact_limits.MOST_ALIKE
    yield from texts[:most]
    if len(texts) > most:
        yield f"{len(texts) - most} more kinds of pairs have the last of these limits, with other numbers"


def no_contact(*plans: Plan) -> str:
    """Return why no contact is seen in the frames of runs of these plans, and what to do."""
    # in words alike for both models
    sparse = [finding for plan in plans for finding in contact_limits.recording(plan)]
    if sparse:
        return f"no contact was recorded: {sparse[0].message}"
    return "no contact happened: lengthen run.until_time"
