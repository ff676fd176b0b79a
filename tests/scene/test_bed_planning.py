"""The numbers of a bed: those of the calibration, steps and intervals that fit, nothing but the normal law differs."""

import math
from dataclasses import fields, replace

import pytest
from bed_runs import facts, series
from hypothesis import given
from hypothesis import strategies as st
from shipped import BEDS

from kncal import calibrate, pair, wall_pair
from kncal.core.errors import CaseFileError, InputError
from kncal.engines.liggghts.impacts import speed_edges
from kncal.engines.liggghts.shared import histogram_edges
from kncal.physics.timestep import contact_time
from kncal.scene.case_file import load_case
from kncal.scene.contact import PairChoice
from kncal.scene.model import KINDS
from kncal.scene.needs import BED_PHYSICS, decide
from kncal.scene.plan import COUPLING_BYTES, PAIR_BYTES, pair_of, plan
from kncal.scene.scene import Scene

MINI = load_case("bubbling_bed_mini")
PAIRS = (("beads", "beads"), ("beads", "column"))


def with_contact(bed: Scene, **changes) -> Scene:
    return replace(bed, contact=replace(bed.contact, **changes))


@pytest.mark.parametrize("name", BEDS)
def test_every_shipped_bed_can_be_planned(name):
    bed = load_case(name)
    models = plan(bed)
    assert tuple(models) == KINDS
    for model in models.values():
        assert model.coupling == model.steps_per_coupling * model.dt
        assert bed.run.coupling * (1.0 - 1.0 / model.steps_per_coupling) < model.coupling
        assert model.coupling <= bed.run.coupling * (1.0 + 1e-8)
        assert model.couplings * model.coupling >= bed.run.until_time * (1.0 - 1e-8)
        assert (model.couplings - 1) * model.coupling < bed.run.until_time
        shortest = min(c.t_c for c in model.contacts.values())
        assert model.dt * bed.run.steps_per_contact == pytest.approx(shortest, rel=1e-12)
    linear, hertz = (models[kind].named for kind in KINDS)
    for names in PAIRS:
        one, two = linear[names], hertz[names]
        assert (one.friction, one.rolling_friction, one.m_eff, one.end) == (
            two.friction, two.rolling_friction, two.m_eff, two.end,
        )  # fmt: skip
        assert (one.n, two.n) == (1.0, 1.5)
        # a soft material keeps Hertz affordable: the same N costs about the same
        assert one.t_c == pytest.approx(two.t_c, rel=0.35)


def test_the_numbers_are_those_of_the_calibration():
    material, radius = MINI.spheres[0].material, MINI.diameter / 2.0
    models = plan(MINI)
    for names, both in zip(PAIRS, (pair(material, radius), wall_pair(material, radius, material)), strict=True):
        c = calibrate(both, v_0=0.2, e_n=0.9)
        linear, hertz = (models[kind].between(*names) for kind in KINDS)
        assert linear.k == pytest.approx(c.k_n, rel=1e-12)
        assert linear.c == pytest.approx(c.eta_n, rel=1e-12)
        assert linear.t_c == pytest.approx(c.t_c, rel=1e-12)
        assert linear.k_t == pytest.approx(0.285714 * c.k_n, rel=1e-12)
        assert hertz.k == pytest.approx(both.k_h, rel=1e-12)
        assert hertz.c == pytest.approx(c.reference.C * math.sqrt(both.m_eff * both.k_h), rel=1e-12)
        assert hertz.t_c == pytest.approx(c.reference.t_c, rel=1e-12)


def test_the_step_of_mfix_in_its_tutorial():
    """MFIX prints 1.33715e-5 s for fluid_bed_2d: a fiftieth of the particles' contact."""
    model = plan(load_case("bubbling_bed"), ["linear"])["linear"]
    assert model.dt == pytest.approx(1.33715e-5, rel=1e-5)
    assert model.steps_per_coupling == 37
    walls = model.between("beads", "column")
    assert (walls.e_n, walls.c, walls.k) == (1.0, 0.0, 1000.0)


def test_rigid_walls_are_stiffer():
    rigid = MINI.with_box(material="rigid")
    soft, hard = (plan(bed)["linear"].between("beads", "column") for bed in (MINI, rigid))
    assert hard.k == pytest.approx(2.0**0.8 * soft.k, rel=1e-12)  # k_n goes with k_h^(4/5), k_h with E_eff
    one, two = (pair_of(*[bed.bodies[0]] * 2) for bed in (MINI, rigid))
    assert (one.m_eff, one.R_eff, one.E_eff) == (two.m_eff, two.R_eff, two.E_eff)


def test_exceptions_by_kind_and_by_material():
    for between in (("beads", "column"), ("column", "beads"), ("soft", "column")):
        bed = with_contact(MINI, pairs=(PairChoice(between=between, e_n=0.5, friction=0.7),))
        contacts = plan(bed)["linear"].named
        assert (contacts["beads", "column"].e_n, contacts["beads", "column"].friction) == (0.5, 0.7)
        assert (contacts["beads", "beads"].e_n, contacts["beads", "beads"].friction) == (0.9, 0.1)
    everything = with_contact(MINI, pairs=(PairChoice(between=("soft", "soft"), friction=0.7),))
    assert {c.friction for c in plan(everything)["linear"].contacts.values()} == {0.7}


def test_friction_that_is_not_needed_is_left_out():
    bed = replace(with_contact(MINI, rolling_friction=0.1), needs={"tangential": False})
    for contact in plan(bed)["hertz"].contacts.values():
        assert (contact.friction, contact.rolling_friction) == (0.0, 0.0)


def test_without_speed_or_stiffness_there_is_no_contact():
    with pytest.raises(CaseFileError, match=r"no first impact to calibrate at: expected contact\.v_0"):
        plan(with_contact(MINI, v_0=None))


def test_prescribed_stiffness_without_speed_takes_the_resting_hertz_contact():
    bed = with_contact(MINI, v_0=None, k_n=100.0)
    models = plan(bed)
    linear, hertz = (models[kind].between("beads", "beads") for kind in KINDS)
    assert linear.k == 100.0
    assert linear.t_c == pytest.approx(float(contact_time(100.0, linear.m_eff, 0.9)), rel=1e-12)
    assert hertz.v_0 is hertz.delta_max is None
    # half a period about the overlap that the weight above presses together: stiffer under a deeper bed
    deep = bed.with_group(count=2 * bed.number)
    deeper = plan(deep)["hertz"].between("beads", "beads")
    assert hertz.t_c / deeper.t_c == pytest.approx(2.0 ** (1.0 / 6.0), rel=1e-12)
    with pytest.raises(CaseFileError, match=r"no gravity between 'beads' and 'beads'"):
        plan(replace(bed, gravity=(0.0, 0.0, 0.0)))


def test_nothing_for_liggghts_means_no_contacts_and_the_wished_interval():
    gas_only = with_contact(MINI, v_0=None).with_group(count=0)
    model = plan(gas_only)["linear"]
    assert model.contacts == {}
    assert (model.steps_per_coupling, model.dt, model.coupling) == (1, 5e-4, 5e-4)


def test_frozen_but_settled_has_the_contacts_of_its_settling():
    assert set(plan(load_case("packed_bed"))["hertz"].named) == set(PAIRS)


@given(st.floats(1e-6, 1e-2), st.floats(4.0, 500.0))
def test_interval_and_step_fit_each_other(coupling, steps):
    bed = replace(MINI, run=replace(MINI.run, coupling=coupling, steps_per_contact=steps, until_time=0.02))
    for model in plan(bed).values():
        assert model.steps_per_coupling >= 1
        assert model.coupling == model.steps_per_coupling * model.dt
        assert model.coupling <= coupling * (1.0 + 1e-8)
        assert model.coupling > coupling - model.dt * (1.0 + 1e-8)
        assert model.frames_every >= 1


def test_an_interval_that_is_a_whole_number_of_steps_stays_one():
    dt = plan(MINI, ["linear"])["linear"].dt
    for n in (1, 3, 7, 49, 1000):
        bed = replace(MINI, run=replace(MINI.run, coupling=n * dt))
        assert plan(bed, ["linear"])["linear"].steps_per_coupling == n


def test_endless_runs_are_refused():
    hard = {"soft": replace(MINI.materials["soft"], young=6e10)}
    bed = replace(MINI, materials=hard, run=replace(MINI.run, until_time=1e3))
    with pytest.raises(CaseFileError, match=r"the linear model needs .* steps .*softer material"):
        plan(bed)


# --- what a bed needs -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gas", "run"),
    [
        ({"cells": (100, 100, 100)}, {"until_time": 1.0, "frames_every": 5e-4}),
        ({}, {"until_time": 100.0, "coupling": 1e-5, "steps_per_contact": 5.0}),
    ],
)
def test_records_that_fill_the_memory_are_refused(gas, run):
    """2000 frames of a million gas cells; ten million couplings."""
    bed = replace(MINI, gas=replace(MINI.gas, **gas), run=replace(MINI.run, **run))
    with pytest.raises(CaseFileError, match=r"run\.frames_every.*run\.coupling"):
        plan(bed)


def test_what_a_coupling_records_is_as_large_as_planned():
    run = series(facts(histogram_edges=tuple(histogram_edges(1e-3)), impact_edges=tuple(speed_edges())), 10)
    arrays = [getattr(run, f.name) for f in fields(run) if f.name not in ("facts", "coupling")]
    per_coupling = sum(a.nbytes / 10 for a in arrays if len(a) == 10) + run.coupling.nbytes / 10
    assert per_coupling == pytest.approx(COUPLING_BYTES + 2 * PAIR_BYTES, rel=0.1)


def used(bed: Scene) -> set[str]:
    return {item.name for item in decide(bed).items if item.used}


def test_the_table_is_complete_and_says_why():
    needs = decide(MINI)
    assert tuple(item.name for item in needs.items) == BED_PHYSICS
    assert all(item.reason for item in needs.items)
    assert len(needs.rows()) == len(BED_PHYSICS) + 1


def test_no_gas_no_openfoam():
    assert used(MINI) - used(replace(MINI, gas=None)) == {"gas", "coupling", "openfoam"}


def test_frozen_at_known_places_needs_no_liggghts():
    bed = MINI.with_group(frozen=True, place="lattice")
    assert used(bed) == {"gas", "depth", "openfoam"}
    assert used(bed.with_group(count=0, frozen=False)) == {"gas", "depth", "openfoam"}


def test_smooth_particles_need_no_tangential_force_unless_asked():
    smooth = with_contact(MINI, friction=0.0, rolling_friction=0.2)
    assert used(MINI) - used(smooth) == {"tangential", "history"}  # nothing sets them rolling either
    rough_walls = with_contact(smooth, pairs=(PairChoice(between=("beads", "column"), friction=0.2),))
    assert used(rough_walls) - used(smooth) == {"tangential", "history", "rolling"}
    asked = decide(replace(smooth, needs={"tangential": True}))
    assert asked.uses("tangential")
    assert [item.name for item in asked.items if item.overruled] == ["tangential"]
    with pytest.raises(InputError, match="physics to overrule"):
        decide(replace(MINI, needs={"gas": False}))


def test_a_single_particle_touches_nothing_unless_it_gets_there():
    one = load_case("terminal_velocity")
    assert "contacts" not in used(one)
    assert "contacts" in used(replace(one, run=replace(one.run, until_time=2.0)))  # falls 57 mm/s, has 92 mm
    blown = replace(one, gas=replace(one.gas, U_0=0.52))
    assert "contacts" in used(blown)  # rises 22 mm, has 7 mm


@pytest.mark.parametrize(
    ("gas_step", "steps"), [(None, 1), (5e-4, 1), (2.5e-4, 2), (2.4e-4, 3), (1e-4, 5), (1.3e-5, 39)]
)
def test_gas_steps_are_no_longer_than_asked_for_and_fill_the_interval(gas_step, steps):
    model = plan(replace(MINI, run=replace(MINI.run, coupling=5e-4, gas_step=gas_step)), ["linear"])["linear"]
    assert model.gas_steps in (steps, steps - 1)  # the interval is rounded down to whole DEM steps
    assert model.gas_step * model.gas_steps == pytest.approx(model.coupling, rel=1e-15)
    if gas_step is not None:
        assert model.gas_step <= gas_step * (1.0 + 1e-8)
        assert model.gas_steps == 1 or model.coupling / (model.gas_steps - 1) > gas_step
