"""The contacts that a trade tries, as variants of the case; and of a bed the start that all of its runs share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kncal.core.errors import CaseFileError, InputError, KncalError
from kncal.physics.methods import METHODS
from kncal.scene.case_file import CASE, load_case, write_case
from kncal.scene.case_text import parse_toml, read_case, toml_key
from kncal.scene.load import bottom_overlaps, fluidised
from kncal.scene.model import Plan
from kncal.scene.overrides import overridden, parse_override
from kncal.scene.plan import pair_choice, plan
from kncal.scene.scene import Scene
from kncal.study.trade.trade import Candidate, TradeOptions
from kncal.study.variants import Changes, Variant, changes_of, removing, texts

#: The packing that all runs of a bed start from is settled by a spring under which the bottom of the bed overlaps so
#: much of the diameter, where the case's own is more than `STIFF` times as stiff: to settle a real modulus would take
#: longer than many runs, and a packing hardly depends on it.
START_OVERLAP, STIFF = 1e-3, 3.0


@dataclass(frozen=True, kw_only=True)
class Contact:
    """A contact whose number of steps is open.

    Attributes
    ----------
    name : unique in a trade
    how, factor : as of `Candidate`
    model : "linear" or "hertz"
    changes : of the case, none of the step or the end of the run
    """

    name: str
    how: str
    factor: float | None
    model: str
    changes: Changes = field(default_factory=dict)

    def at(self, steps_per_contact: float, run: Changes | None = None) -> Candidate:
        """Return the contact at N steps per contact; ``run``: changes of the run, the same for all of a trade."""
        name, steps = f"{self.name}-N{steps_per_contact:g}", float(steps_per_contact)
        changes = {**self.changes, **(run or {}), "run.steps_per_contact": steps}
        variant = Variant(name=name, model=self.model, changes=changes)
        return Candidate(name=name, how=self.how, factor=self.factor, steps_per_contact=steps, variant=variant)


def check_reference(case: str | Path, given: tuple[str, ...]) -> None:
    """Refuse ``--reference`` of anything but materials."""
    for text in given:
        if parse_override(text).path[0] != "materials":
            raise InputError(
                f"--reference {text[:100]!r}: expected a key of [materials], e.g. materials.NAME.young=1e9; other "
                "values of the case are changed in its file"
            )
    if given:
        load_case(case, overrides=given)


def contacts(case: str | Path, options: TradeOptions) -> tuple[Contact, list[Contact]]:
    """Return the reference, and the contacts to try against it.

    The first to try is the case's own linear contact, unsoftened, with factor 1; then the softened ones, Hertz at the
    real and at reduced moduli, those by overlap limits, and the other methods that need no option. Walls are softened
    like particles.

    Raises
    ------
    CaseFileError
        If the case with ``options.reference`` is not valid, cannot be planned, or has no contacts.
    """
    base = changes_of(options.reference)
    scene = load_case(case, overrides=options.reference)
    unsoftened = _linear(scene)
    if not unsoftened.contacts:
        raise CaseFileError(f"{scene.name}: no particle moves, so there is no contact to trade")
    # a prescribed k_n has no method
    own = "prescribed" if scene.contact.k_n is not None else str(scene.contact.method)
    stripped = {**base, **_without_stiffness(case, scene)}
    shortest = _stiffness(unsoftened)

    def by_method(name: str, how: str, changes: Changes) -> Contact:
        changes = {**stripped, **changes}
        try:
            factor = _stiffness(_linear(load_case(case, overrides=texts(changes)))) / shortest
        except (KncalError, ValueError):
            factor = None  # the run will be refused with the reason
        return Contact(name=f"linear-{name}", how=how, factor=factor, model="linear", changes=changes)

    softer = [factor for factor in options.factors if factor != 1.0]
    found = [Contact(name=f"linear-{own}", how=own, factor=1.0, model="linear", changes=base)]
    for factor in softer:
        changes = softened(case, scene, unsoftened, factor, stripped)
        name = f"linear-{own}-{share_name(factor)}"
        found.append(Contact(name=name, how="softened", factor=factor, model="linear", changes=changes))
    for factor in options.factors:
        name = "hertz" if factor == 1.0 else f"hertz-E-{share_name(factor)}"
        changes = base if factor == 1.0 else {**base, **softer_materials(case, options.reference, factor)}
        found.append(Contact(name=name, how="reduced_modulus", factor=factor, model="hertz", changes=changes))
    for share in options.overlaps:
        limit = {"contact.method": "limited_overlap", "contact.options": {"fraction": share}}
        found.append(by_method(f"overlap-{100.0 * share:g}pct", "limited_overlap", limit))
    for method in METHODS.values():
        if not method.required and method.name != own:
            found.append(by_method(method.name, method.name, {"contact.method": method.name}))
    return Contact(name="reference", how="reference", factor=None, model="hertz", changes=base), found


def share_name(factor: float) -> str:
    """Return a factor as part of a name: "over-30" for 1/30."""
    share = 1.0 / factor
    whole = abs(share - round(share)) < 1e-9 * share and share >= 1.0
    return f"over-{round(share)}" if whole else f"times-{factor:.6g}"


def softer_materials(case: str | Path, reference: tuple[str, ...], factor: float) -> dict[str, Any]:
    """Return the changes that multiply Young's modulus of every material of the case (with ``reference``)."""
    text, _, where = read_case(case)
    materials: Mapping[str, Mapping[str, Any]] = overridden(parse_toml(text, where), map(parse_override, reference))[
        "materials"
    ]
    return {f"materials.{toml_key(name)}.young": float(m["young"]) * factor for name, m in materials.items()}


def softened(case: str | Path, scene: Scene, unsoftened: Plan, factor: float, stripped: Changes) -> dict[str, Any]:
    """Return changes under which every pair has ``factor`` times its k_n; everything else of a pair stays.

    They hold ``stripped``, which takes out how the case finds k_n. One k_n where all pairs have the same, else an
    exception for each pair (the impact speed of each, too, since a prescribed k_n has none of its own).

    Raises
    ------
    InputError
        If a case cannot have that many exceptions.
    """
    wanted = {pair: factor * contact.k for pair, contact in unsoftened.contacts.items()}
    if len(set(wanted.values())) == 1:
        changes = {**stripped, "contact.k_n": next(iter(wanted.values()))}
    else:
        changes = {key: value for key, value in stripped.items() if not key.startswith("contact.pairs.")}
        rows = []
        species = unsoftened.species
        # an exception names bodies: one for each wall of a species, too
        every = ((species.bodies(pair)[0], b) for pair in wanted for b in species.members[pair[1]])
        for a, b in every if scene.coupled else scene.body_pairs():
            numbers = pair_choice(scene, a, b)
            row = {key: value for key, value in numbers._asdict().items() if value is not None}
            rows.append({"between": [a.name, b.name], **row, "k_n": wanted[species.pair_of((a.name, b.name))]})
        changes["contact.pairs"] = rows
    try:
        load_case(case, overrides=texts(changes))
    except CaseFileError as error:
        raise InputError(f"{scene.name}: k_n cannot be softened pair by pair ({len(wanted)} pairs): {error}") from error
    return changes


def _linear(scene: Scene) -> Plan:
    found: Plan = plan(scene, ("linear",))["linear"]
    return found


def _without_stiffness(case: str | Path, scene: Scene) -> dict[str, Any]:
    """Changes that take out how the case finds or prescribes k_n."""
    keys = ["contact.method", "contact.options", "contact.k_n"]
    keys += [f"contact.pairs.{i}.k_n" for i, row in enumerate(scene.contact.pairs) if row.k_n is not None]
    return removing(case, *keys)


def _stiffness(found: Plan) -> float:
    """k_n of the shortest contact [N/m]."""
    return min(found.contacts.values(), key=lambda contact: contact.t_c).k


# --- the start of a bed -------------------------------------------------------


def shared_case(scene: Scene, folder: Path) -> tuple[Path, tuple[str, ...]]:
    """Write the case that all candidates are variants of, from one start; return it, and what to know about it."""
    notes: tuple[str, ...] = ()
    if scene.settles:
        if fluidised(scene):
            scene = scene.with_settled(place="lattice", settle_k_n=None)
            notes = (
                "All runs start from the loose lattice, not from a settled bed: averages begin after the start-up,"
                " which the gas makes in both, and settling a stiff bed takes as long as running it.",
            )
        elif all(group.settle_k_n is None for group in scene.particles.values()):
            k_n = settling_spring(scene)
            scene = scene.with_settled(settle_k_n=k_n)
            notes = (f"All runs start from one packing, settled with k_n = {k_n:.3g} N/m.",)
    path = folder / "start" / scene.name / CASE
    path.parent.mkdir(parents=True, exist_ok=True)
    write_case(scene, path)
    return path, notes


def settling_spring(scene: Scene) -> float:
    """Return the stiffness that the bed settles with [N/m]: its own, or a softer one if that is too stiff for it."""
    model = plan(scene, ("linear",))["linear"]
    own = model.contacts[0, 0].k
    overlap = bottom_overlaps(model).get((0, 0), 0.0)
    wanted = START_OVERLAP * scene.diameter
    return own if overlap <= 0.0 or wanted < STIFF * overlap else own * overlap / wanted
