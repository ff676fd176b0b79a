"""Which bodies are alike: one contact for each pair of species, whatever the number of bodies."""

from dataclasses import replace
from itertools import product

import pytest
from models import with_bodies

from kncal import CaseFileError
from kncal.physics.material import Material
from kncal.scene.bodies import Particle, Wall
from kncal.scene.case_file import load_case
from kncal.scene.contact import ContactChoice, PairChoice
from kncal.scene.plan import plan
from kncal.scene.run_control import RunControl
from kncal.scene.scene import Scene
from kncal.scene.species import listed, species_of

GLASS = Material(young=5e7, poisson=0.25, density=2500.0, name="glass")
BRASS = Material(young=1e8, poisson=0.3, density=8000.0, name="brass")


def many(number: int, sizes: int = 1, pairs: tuple[PairChoice, ...] = ()) -> Scene:
    """Spheres of glass of a few sizes that fall on a floor, far apart from each other."""
    return Scene.of(
        name="many",
        spheres=tuple(
            Particle(
                name=f"p{i}",
                material=GLASS,
                radius=1e-3 * (1 + i % sizes),
                position=(0.1 * (i % 10), 0.1 * (i // 10), 0.02),
            )
            for i in range(number)
        ),
        planes=(Wall(name="floor", axis="z", position=0.0, material=BRASS),),
        gravity=(0.0, 0.0, -9.81),
        contact=ContactChoice(e_n=0.9, v_0=0.5, pairs=pairs),
        run=RunControl(until_time=0.01),
    )


def test_material_radius_and_exceptions_make_a_species():
    exceptions = (PairChoice(between=("p0", "floor"), e_n=0.5), PairChoice(between=("glass", "brass"), e_n=0.7))
    table = species_of(many(12, sizes=2, pairs=exceptions))
    assert [[body.name for body in bodies] for bodies in table.members] == [
        ["p0"],
        [f"p{i}" for i in range(1, 12, 2)],
        [f"p{i}" for i in range(2, 12, 2)],
        ["floor"],
    ]
    assert set(table.pairs()) == {(0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3)}
    assert [table.meetings(which) for which in ((0, 0), (1, 1), (1, 2), (2, 3))] == [0, 15, 30, 5]
    assert table.pair_of(("p0", "floor")) == (0, 3)
    assert table.pair_of(("p2", "p1")) == (1, 2)


def test_every_exception_holds_for_the_bodies_it_names():
    # all ways to name two of three bodies or their material: alike bodies must have one choice with every partner
    scene = many(4)
    for between in product(("p0", "p1", "floor", "glass", "brass"), repeat=2):
        given = replace(scene, contact=replace(scene.contact, pairs=(PairChoice(between=between, e_n=0.5),)))
        table = species_of(given)
        choices: dict[object, set[object]] = {}
        for a, b in given.body_pairs():
            choices.setdefault(table.pair_of((a.name, b.name)), set()).add(given.choice_for(a, b))
        assert all(len(found) == 1 for found in choices.values()), between


def test_bodies_alike_have_one_contact():
    for model in plan(many(40, sizes=2)).values():
        assert sum(map(model.species.meetings, model.contacts)) == 40 * 39 // 2 + 40
        assert len(model.contacts) == 5
        assert not model.unmet


def test_what_bodies_of_a_scene_do_not_form_is_there_for_others():
    for model in plan(load_case("falling_particle")).values():
        assert set(model.contacts) == {(0, 1)}
        (contact,) = model.unmet.values()
        # two equal spheres: half the mass and half the radius that one has against a wall
        assert contact.m_eff == pytest.approx(0.5 * model.contacts[0, 1].m_eff, rel=1e-12)
        assert contact.R_eff == pytest.approx(0.5 * model.contacts[0, 1].R_eff, rel=1e-12)
        # and no part in the time step
        assert model.dt * model.scene.run.steps_per_contact == pytest.approx(model.contacts[0, 1].t_c, rel=1e-12)


def test_an_error_names_bodies_that_it_is_about():
    scene = many(3)
    lost = replace(scene, gravity=(0.0, 0.0, 0.0), contact=ContactChoice(k_n=1e4, e_n=0.9))
    touching = [replace(p, position=(2.1e-3 * i * i, 0.0, 0.02)) for i, p in enumerate(lost.spheres)]
    with pytest.raises(CaseFileError, match="'p0' and 'p1'"):
        plan(with_bodies(lost, spheres=tuple(touching), planes=()))


def test_long_lists_are_cut_with_a_count():
    assert listed(["a", "b"]) == "a, b"
    assert listed([str(i) for i in range(100)]).endswith("4 and 95 more")
