"""The contact lines of a LIGGGHTS deck, to paste into a deck of one's own: properties, pair style, time step, walls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, cast

from kncal.core.checks import in_range, instance, one_of, plain_name, single
from kncal.core.errors import InputError
from kncal.core.shipped import folder as shipped_folder
from kncal.core.templating import render
from kncal.engines.liggghts.deck_tables import STYLES, AtomType, atom_types, contact_context
from kncal.engines.plan_checks import expect
from kncal.physics.matrix import PairMatrix
from kncal.physics.timestep import usual_steps
from kncal.scene.contact import ContactChoice
from kncal.scene.model import PairContact
from kncal.scene.pair_contact import PairNumbers, Rest, pair_contact
from kncal.scene.plan import species_contacts
from kncal.scene.scene import Scene
from kncal.scene.species import species_of

Contacts = Mapping[tuple[str, str], PairContact]


def liggghts_block(
    types: Sequence[AtomType], contacts: Contacts, style: str = "hooke/stiffness", steps_per_contact: float = 50.0
) -> str:
    """Return deck lines that give every pair of types its contact in LIGGGHTS 3.8.0, numbers with all their digits.

    Parameters
    ----------
    types : the atom types 1, 2, ... of the deck
    contacts : (name, name) of two types, in any order -> its contact. All of the kind ("linear" or "hertz") that
        `STYLES` names for the style. Two walls never touch; of other pairs without a contact the block says so
    style : normal model: "hooke/stiffness", "hooke" (LIGGGHTS finds k_n by strain energy itself) or "hertz"
    steps_per_contact : N of the block's time step, N steps in its shortest contact

    Raises
    ------
    InputError
        For another style, or a name that could be a command.
    RenderError
        If there is no contact, a number is out of its range, or LIGGGHTS would make another contact of these.
    """
    one_of("style", style, STYLES)
    n = float(in_range("steps_per_contact", single("steps_per_contact", steps_per_contact), 1.0, 1e7))
    index = {plain_name("name of a type", t.name): i for i, t in enumerate(types)}
    table = {}
    for (one, other), contact in contacts.items():
        i, j = sorted((index[one], index[other]))
        if not (types[i].is_wall and types[j].is_wall):
            table[i, j] = contact
    context = contact_context(style, types, table, style, absolute=False)
    shortest = min(c.t_c for c in table.values())
    expect(0.0 < shortest < float("inf"), style, f"t_c = {shortest!r}", "a finite value > 0")
    walls = [i for i, t in enumerate(types, 1) if t.is_wall]
    context |= {"steps": n, "shortest": shortest, "dt": shortest / n, "walls": walls, "one_line": True}
    return render(shipped_folder("templates") / "liggghts", "contacts.j2", context)


def matrix_block(
    matrix: PairMatrix,
    style: str = "hooke/stiffness",
    *,
    friction: float = 0.0,
    k_t_ratio: float | None = None,
    steps_per_contact: float | None = None,
) -> str:
    """Return the block of the pairs of `kncal.calibrate_matrix`.

    Parameters
    ----------
    style : {"hooke/stiffness", "hooke", "hertz"}
        LIGGGHTS' normal model. "hooke" is for the method strain_energy and one ``v_0``; "hertz" is the reference
        contact itself, of the law tsuji or hertz.
    friction : Coulomb coefficient of all pairs [-]
    k_t_ratio : k_t/k_n of the linear styles [-]. None: Mindlin's ratio of each pair; 1 for "hooke", which has only
        1 and 2/7
    steps_per_contact : N of the block's time step; None: `kncal.physics.timestep.usual_steps` of the smallest e_n

    Raises
    ------
    InputError
        For another style, a number out of its range, or a matrix without materials.
    RenderError
        If the model of LIGGGHTS has no such contact.
    """
    instance("matrix", matrix, PairMatrix, "made by kncal.calibrate_matrix")
    kind = STYLES[one_of("style", style, STYLES)]
    if unknown := [name for name in matrix.names if name not in matrix.materials]:
        raise InputError(f"no material of {unknown[0]!r}: expected a matrix made by kncal.calibrate_matrix")
    mu = float(in_range("friction", single("friction", friction), 0.0, 10.0))
    ratio = 1.0 if k_t_ratio is None and style == "hooke" else k_t_ratio
    if ratio is not None:
        ratio = float(in_range("k_t_ratio", single("k_t_ratio", ratio), 0.0, 10.0))
    contacts = {}
    for (a, b), c in matrix.calibrations.items():
        choice = ContactChoice(end=cast("Literal['overlap', 'force']", c.end), k_t_ratio=ratio)
        numbers = PairNumbers(float(c.e_n), mu, float(c.v_0), float(c.k_n))
        contacts[a, b] = pair_contact(
            choice, c.pair, numbers, kind, Rest(0.0, 0.0), scene="matrix", names=f"{a}, {b}", law=c.contact_law
        )
    if steps_per_contact is None:
        first = min(matrix.calibrations.values(), key=lambda c: float(c.e_n))
        steps_per_contact = usual_steps(first.contact_law, float(first.e_n), first.end)
    types = [AtomType(name=n, material=matrix.materials[n], is_wall=n in matrix.walls) for n in matrix.names]
    return liggghts_block(types, contacts, style, steps_per_contact)


def case_block(scene: Scene, style: str = "hooke/stiffness", steps_per_contact: float = 50.0) -> str:
    """Return the block of a case: a type per material and radius, a type per wall material, every pair's own numbers.

    Also pairs that don't meet in the case get their numbers, since a deck of one's own may let them; friction is the
    case's, whether or not the case needs it.

    Raises
    ------
    CaseFileError
        If a pair of the case has neither an impact speed nor a prescribed k_n.
    ValidityError
        If the overlap of a pair of the case would reach the radius.
    InputError, RenderError
        As `liggghts_block`.
    """
    kind, species = STYLES[one_of("style", style, STYLES)], species_of(scene)
    meeting = dict.fromkeys((pair for pair in species.pairs() if species.meetings(pair)), 0.0)
    met, unmet = species_contacts(scene, kind, meeting)
    types = atom_types(species)
    contacts = {(types[i].name, types[j].name): contact for (i, j), contact in (met | unmet).items()}
    return liggghts_block(types, contacts, style, steps_per_contact)
