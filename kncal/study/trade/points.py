"""The contacts that a trade tries, as variants of the case: one vocabulary of overrides for all of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kncal.core.errors import CaseFileError, InputError, KncalError
from kncal.physics.methods import METHODS
from kncal.scene.case_file import load_case, load_scene
from kncal.scene.case_text import parse_toml, read_case, toml_key, toml_value
from kncal.scene.model import Model
from kncal.scene.overrides import overridden, parse_override
from kncal.scene.plan import pair_choice, plan
from kncal.scene.scene import Scene
from kncal.study.trade.base import Candidate, TradeOptions
from kncal.study.variants import Variant, removing


@dataclass(frozen=True, kw_only=True)
class Contact:
    """A contact whose number of steps is open.

    Attributes
    ----------
    name : unique in a trade
    how, factor : as of `Candidate`
    model : "linear" or "hertz"
    overrides : ``KEY=VALUE``, none of the step or the end of the run
    """

    name: str
    how: str
    factor: float | None
    model: str
    overrides: tuple[str, ...]

    def at(self, steps_per_contact: float, *run: str) -> Candidate:
        """Return the contact at N steps per contact; ``run``: overrides of the run, the same for all of a trade."""
        name = f"{self.name}-N{steps_per_contact:g}"
        overrides = merged(self.overrides, run, (f"run.steps_per_contact={float(steps_per_contact)!r}",))
        return Candidate(
            name=name,
            how=self.how,
            factor=self.factor,
            steps_per_contact=float(steps_per_contact),
            variant=Variant(name=name, model=self.model, overrides=overrides),
        )


def merged(*groups: Iterable[str]) -> tuple[str, ...]:
    """Return overrides of which the last of each key counts."""
    return tuple({parse_override(text).path: text for group in groups for text in group}.values())


def share_name(factor: float) -> str:
    """Return a factor as part of a name: "over-30" for 1/30."""
    share = 1.0 / factor
    return (
        f"over-{round(share)}" if abs(share - round(share)) < 1e-9 * share and share >= 1.0 else f"times-{factor:.6g}"
    )


def check_reference(case: str | Path, given: tuple[str, ...]) -> None:
    """Refuse ``--reference`` of anything but materials."""
    for text in given:
        override = parse_override(text)
        if override.path[0] != "materials":
            raise InputError(
                f"--reference {text[:100]!r}: expected a key of [materials], e.g. materials.NAME.young=1e9; other "
                "values of the case are changed in its file"
            )
    if given:
        load_case(case, overrides=given)


def softer_materials(case: str | Path, reference: tuple[str, ...], factor: float) -> tuple[str, ...]:
    """Return the overrides that multiply Young's modulus of every material of the case (with ``reference``)."""
    text, _, where = read_case(case)
    tables = overridden(parse_toml(text, where), map(parse_override, reference))
    materials: Mapping[str, Mapping[str, Any]] = tables["materials"]
    return tuple(
        f"materials.{toml_key(name)}.young={float(values['young']) * factor!r}" for name, values in materials.items()
    )


def own_name(scene: Scene) -> str:
    """Return what the case's own linear contact is called: its method, or "prescribed" where it gives k_n."""
    return "prescribed" if scene.contact.k_n is not None else scene.contact.method


def contacts(case: str | Path, options: TradeOptions) -> tuple[Contact, list[Contact]]:
    """Return the reference, and the contacts to try against it.

    The first to try is the case's own linear contact, unsoftened, with factor 1; then the other methods that need no
    option, the softened ones, those by overlap limits, and Hertz at the real and at reduced moduli.

    Raises
    ------
    CaseFileError
        If the case with ``options.reference`` is not valid, or cannot be planned.
    """
    base = tuple(options.reference)
    scene = load_scene(case, overrides=base)
    unsoftened = plan(scene, ("linear",))["linear"]
    reference = Contact(name="reference", how="reference", factor=None, model="hertz", overrides=base)
    own = own_name(scene)
    found = [Contact(name=f"linear-{own}", how=own, factor=1.0, model="linear", overrides=base)]
    stripped = merged(base, _without_stiffness(case, scene))
    shortest = _stiffness(unsoftened)

    def by_method(name: str, how: str, *overrides: str) -> None:
        contact = merged(stripped, overrides)
        try:
            stiffness = _stiffness(plan(load_scene(case, overrides=contact), ("linear",))["linear"])
        except KncalError:
            factor = None  # the run will be refused with the reason
        else:
            factor = stiffness / shortest
        found.append(Contact(name=name, how=how, factor=factor, model="linear", overrides=contact))

    for method in METHODS.values():
        if not method.required and method.name != own:
            by_method(f"linear-{method.name}", method.name, f"contact.method={method.name}")
    found += [
        Contact(
            name=f"linear-{own}-{share_name(factor)}",
            how="softened",
            factor=factor,
            model="linear",
            overrides=softened(case, scene, unsoftened, factor, stripped),
        )
        for factor in options.factors
        if factor != 1.0
    ]
    for fraction in options.overlaps:
        overrides = ("contact.method=limited_overlap", f"contact.options={{fraction={fraction!r}}}")
        by_method(f"linear-overlap-{100.0 * fraction:g}pct", "limited_overlap", *overrides)
    found += [
        Contact(
            name="hertz" if factor == 1.0 else f"hertz-E-{share_name(factor)}",
            how="reduced_modulus",
            factor=factor,
            model="hertz",
            overrides=merged(base, softer_materials(case, base, factor)) if factor != 1.0 else base,
        )
        for factor in options.factors
    ]
    return reference, found


def softened(
    case: str | Path, scene: Scene, unsoftened: Model, factor: float, stripped: tuple[str, ...]
) -> tuple[str, ...]:
    """Return overrides under which every pair has ``factor`` times its k_n; everything else of a pair stays.

    They go with ``stripped``, which takes out how the case finds k_n, and hold what is needed of it.

    One k_n where all pairs have the same, else an exception for each pair (the impact speed of each, too, since
    a prescribed k_n has none of its own).

    Raises
    ------
    InputError
        If a case cannot have that many exceptions.
    """
    wanted = {pair: factor * contact.k for pair, contact in unsoftened.contacts.items()}
    if len(set(wanted.values())) == 1:
        change = merged(stripped, (f"contact.k_n={next(iter(wanted.values()))!r}",))
    else:
        rows = []
        for a, b in scene.body_pairs():
            numbers = pair_choice(scene, a, b)
            values = {"between": [a.name, b.name], "e_n": numbers.e_n, "friction": numbers.friction}
            values |= {} if numbers.v_0 is None else {"v_0": numbers.v_0}
            values |= {"k_n": wanted[unsoftened.species.pair_of((a.name, b.name))]}
            rows.append(", ".join(f"{key} = {toml_value(value)}" for key, value in values.items()))
        kept = [text for text in stripped if parse_override(text).path[:2] != ("contact", "pairs")]
        change = merged(kept, (f"contact.pairs=[{', '.join(f'{{{row}}}' for row in rows)}]",))
    try:
        load_scene(case, overrides=change)
    except CaseFileError as error:
        raise InputError(f"{scene.name}: k_n cannot be softened pair by pair ({len(wanted)} pairs): {error}") from error
    return change


def _without_stiffness(case: str | Path, scene: Scene) -> tuple[str, ...]:
    """Overrides that take out how the case finds or prescribes k_n."""
    keys = ["contact.method", "contact.options", "contact.k_n"]
    keys += [f"contact.pairs.{i}.k_n" for i, row in enumerate(scene.contact.pairs) if row.k_n is not None]
    return removing(case, *keys)


def _stiffness(model: Model) -> float:
    """Stiffness of the shortest contact [N/m]: k_n, or Hertz's secant at the largest overlap."""
    contact = min(model.contacts.values(), key=lambda c: c.t_c)
    return contact.k if contact.n == 1.0 else contact.k * math.sqrt(contact.delta_max or math.nan)
