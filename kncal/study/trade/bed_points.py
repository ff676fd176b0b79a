"""The contacts that a trade of a bed tries, and the bed that all of them share: one packing, one step of reference."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from kncal.core.errors import CaseFileError, InputError
from kncal.core.files import write_text
from kncal.physics.fluidization import minimum_fluidization_velocity
from kncal.physics.laws import LAWS
from kncal.physics.methods import METHODS
from kncal.physics.timestep import predict_error
from kncal.scene.bed_scene import PARTICLES, BedScene
from kncal.scene.case_file import CASE, dump_case, load_case
from kncal.scene.case_text import toml_value
from kncal.scene.load import bottom_overlaps
from kncal.scene.model import BedModel, PairContact
from kncal.scene.plan import pair_choice, plan
from kncal.study.trade.base import TradeOptions
from kncal.study.trade.points import Contact, merged, own_name, share_name, softer_materials
from kncal.study.variants import removing

#: The packing that all runs start from is settled by a spring under which the bottom of the bed overlaps so much of the
#: diameter, where the case's own is more than `STIFF` times as stiff: to settle a real modulus would take longer than
#: many runs, and a packing hardly depends on it.
START_OVERLAP, STIFF = 1e-3, 3.0
#: The step of the reference may change restitution, duration and overlaps of its contacts, in the mean over the
#: sub-step phases of first touch, by this share of the smallest tolerance.
CONVERGED = 0.1
_EPS_MF = 0.45


def shared_case(case: str | Path, scene: BedScene, folder: Path) -> tuple[Path, tuple[str, ...]]:
    """Write the case that all candidates are variants of, from one start; return it, and what to know about it."""
    particles = scene.particles
    notes: tuple[str, ...] = ()
    if particles.packing == "settled" and particles.count:
        if fluidised(scene):
            particles = replace(particles, packing="lattice", settle_k_n=None)
            notes = (
                "All runs start from the loose lattice, not from a settled bed: averages begin after the start-up,"
                " which the gas makes in both, and settling a stiff bed takes as long as running it.",
            )
        elif particles.settle_k_n is None:
            particles = replace(particles, settle_k_n=settling_spring(scene))
            notes = (f"All runs start from one packing, settled with k_n = {particles.settle_k_n:.3g} N/m.",)
    path = folder / "start" / scene.name / CASE
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, dump_case(replace(scene, particles=particles)))
    return path, notes


def fluidised(scene: BedScene) -> bool:
    """Return whether steady gas moves the bed: faster than U_mf (Ergun) of the bed as loose as U_mf is stated at."""
    gas, p = scene.gas, scene.particles
    if gas is None or gas.ramp or p.frozen or scene.gravity <= 0.0:
        return False
    density = float(p.material.density)
    U_mf = minimum_fluidization_velocity(p.diameter, density, gas.density, gas.viscosity, _EPS_MF, scene.gravity)
    return gas.jet is not None or float(U_mf) < gas.U_0


def settling_spring(scene: BedScene) -> float:
    """Return the stiffness that the bed settles with [N/m]: its own, or a softer one if that is too stiff for it."""
    model = plan(scene, ("linear",))["linear"]
    own = model.between(PARTICLES, PARTICLES).k
    overlap = bottom_overlaps(model).get((0, 0), 0.0)
    wanted = START_OVERLAP * scene.particles.diameter
    return own if overlap <= 0.0 or wanted < STIFF * overlap else own * overlap / wanted


def reference_steps(scene: BedScene, steps: tuple[float, ...], tolerance: float) -> tuple[float, float]:
    """Return N of the reference, and the discretisation error of one contact there, mean over phases [-].

    The chaos of a bed hides what a step does to its averages until runs are very long, so that N is chosen by what the
    step does to contacts: the smallest of ``steps`` and the case's own, not below the latter, at which no mean error
    of a contact is more than `CONVERGED` of the ``tolerance``; else the largest.
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
        if found <= CONVERGED * tolerance:
            break
    return chosen, found


def unsoftened(case: str | Path, options: TradeOptions) -> BedModel:
    """Return the linear model by the case's own method at the real modulus.

    Raises
    ------
    CaseFileError
        If the case with ``options.reference`` is not valid, or no bed.
    """
    scene = load_case(case, overrides=options.reference)
    if not isinstance(scene, BedScene):
        raise CaseFileError(f"{case}: a case of single contacts; expected that of a bed")
    return plan(scene, ("linear",))["linear"]


def bed_contacts(case: str | Path, options: TradeOptions) -> tuple[Contact, dict[str, list[Contact]]]:
    """Return the reference, and the contacts to try by kind.

    Kinds: "softened" (linear, the case's own method; its factor 1 is the unsoftened one), "reduced" (Hertz with a
    reduced modulus; with factor 1 it is the reference at another step), "overlap" (by overlap limits) and "method"
    (by other methods). The walls' contact is softened like that of two particles.
    """
    base = tuple(options.reference)
    model = unsoftened(case, options)
    scene = model.scene
    own = own_name(scene)  # type: ignore[arg-type]
    shortest = min(model.contacts.values(), key=lambda contact: contact.t_c, default=None)
    stripped = merged(base, removing(case, "contact.method", "contact.options", "contact.k_n", *_pair_stiffness(scene)))

    def by_method(name: str, how: str, *overrides: str) -> Contact:
        contact = merged(stripped, overrides)
        return Contact(name=name, how=how, factor=_factor(case, contact, shortest), model="linear", overrides=contact)

    groups: dict[str, list[Contact]] = {
        "softened": [
            Contact(
                name=f"linear-{own}" if factor == 1.0 else f"linear-{own}-{share_name(factor)}",
                how=own if factor == 1.0 else "softened",
                factor=factor,
                model="linear",
                overrides=base if factor == 1.0 else merged(base, _softened(model, factor)),
            )
            for factor in dict.fromkeys((1.0, *options.factors))
        ],
        "reduced": [
            Contact(
                name="hertz" if factor == 1.0 else f"hertz-E-{share_name(factor)}",
                how="reduced_modulus",
                factor=factor,
                model="hertz",
                overrides=base if factor == 1.0 else merged(base, softer_materials(case, base, factor)),
            )
            for factor in dict.fromkeys((1.0, *options.factors))
        ],
        "overlap": [
            by_method(
                f"linear-overlap-{100.0 * share:g}pct",
                "limited_overlap",
                "contact.method=limited_overlap",
                f"contact.options={{fraction = {share!r}}}",
            )
            for share in options.overlaps
        ],
        "method": [
            by_method(f"linear-{method.name}", method.name, f"contact.method={method.name}")
            for method in METHODS.values()
            if not method.required and method.name != own
        ],
    }
    return Contact(name="reference", how="reference", factor=None, model="hertz", overrides=base), groups


def _softened(model: BedModel, factor: float) -> tuple[str, ...]:
    """Override k_n of both pairs by ``factor`` times the planned one; everything else of a pair stays."""
    scene = model.scene
    rows = []
    for pair, contact in model.contacts.items():
        a, b = model.species.bodies(pair)
        numbers = pair_choice(scene, a, b)
        values = {"between": [a.name, b.name], "e_n": numbers.e_n, "friction": numbers.friction}
        values |= {} if numbers.v_0 is None else {"v_0": numbers.v_0}
        values |= {"k_n": factor * contact.k}
        rows.append("{" + ", ".join(f"{key} = {toml_value(value)}" for key, value in values.items()) + "}")
    return (f"contact.pairs=[{', '.join(rows)}]",)


def _pair_stiffness(scene: BedScene) -> tuple[str, ...]:
    return tuple(f"contact.pairs.{k}.k_n" for k, row in enumerate(scene.contact.pairs) if row.k_n is not None)


def _factor(case: str | Path, overrides: tuple[str, ...], base: PairContact | None) -> float | None:
    """k_n of the shortest contact over that of the case's own method; None where it cannot be planned or has none."""
    try:
        scene = load_case(case, overrides=overrides)
        contacts = plan(scene, ("linear",))["linear"].contacts if isinstance(scene, BedScene) else {}
    except (CaseFileError, InputError):
        return None  # the run will be refused with the reason
    shortest = min(contacts.values(), key=lambda contact: contact.t_c, default=None)
    return None if shortest is None or base is None else shortest.k / base.k
