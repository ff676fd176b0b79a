"""Case files of beds: what they say comes through, what is wrong is named with its line, and the shipped beds hold."""

import json
import re
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kncal.core.errors import CaseFileError, InputError
from kncal.core.shipped import folder
from kncal.scene.bed_case_checks import _too_close
from kncal.scene.bed_case_file import dump_bed, load_bed, parse_bed
from kncal.scene.bed_scene import DEPTHS, PACKINGS, PARCELS, BedScene, Gas, Jet
from kncal.scene.bed_schema import BedParticlesTable, ColumnTable, GasTable
from kncal.scene.case_file import load_case, load_scene, shipped_cases
from kncal.scene.metrics import COUPLED, offered
from kncal.scene.needs import decide
from kncal.scene.scene import Scene

GOOD = """\
title = "a bed"
gravity = 9.8

[materials.soft]
young = 5e6
poisson = 0.3
density = 1000.0

[column]
width = 0.03
depth = 0.006
height = 0.09
cells = [10, 2, 30]
wall_material = "soft"

[particles]
count = 300
diameter = 0.0012
material = "soft"

[gas]
density = 1.2
viscosity = 1.8e-5
U_0 = 0.8

[contact]
e_n = 0.9
v_0 = 0.2
friction = 0.1

[[contact.pairs]]
between = ["particles", "walls"]
friction = 0.3

[run]
end_time = 0.5
coupling = 5e-4

[tolerances]
pressure_drop = 0.03

[needs]
tangential = false
"""
BEDS = shipped_cases(beds=True)


def test_what_is_said_comes_through():
    bed = parse_bed(GOOD, name="sample")
    assert isinstance(bed, BedScene)
    assert (bed.name, bed.title, bed.gravity) == ("sample", "a bed", 9.8)
    assert bed.column.cells == (10, 2, 30)
    assert bed.column.wall_material is bed.particles.material
    assert (bed.particles.count, bed.particles.packing, bed.particles.frozen) == (300, "settled", False)
    assert bed.gas == Gas(density=1.2, viscosity=1.8e-5, U_0=0.8)
    assert bed.contact.pairs[0].between == ("particles", "walls")
    assert (bed.run.end_time, bed.run.coupling, bed.run.discard) == (0.5, 5e-4, None)
    assert bed.tolerances == {"pressure_drop": 0.03}
    assert bed.overrules == {"tangential": False}


def test_gas_may_be_missing_jet_and_ramp_come_through():
    dry = parse_bed(re.sub(r"\[gas\].*?(?=\[contact\])", "", GOOD, flags=re.S), name="dry")
    assert dry.gas is None
    jet = parse_bed(
        GOOD.replace("U_0 = 0.8\n", "[gas.jet]\nx_low = 0.012\nx_high = 0.018\nvelocity = 5.0\n"), name="jet"
    )
    assert jet.gas is not None
    assert jet.gas.jet == Jet(x_low=0.012, x_high=0.018, velocity=5.0)
    assert jet.gas.inlet_at(0.1) == 0.0
    ramp = parse_bed(GOOD.replace("U_0 = 0.8", "ramp = [[0.1, 0.2], [0.3, 0.6]]"), name="ramp")
    assert ramp.gas is not None
    assert [ramp.gas.inlet_at(t) for t in (0.0, 0.1, 0.2, 0.3, 9.0)] == pytest.approx([0.2, 0.2, 0.4, 0.6, 0.6])


FAULTS = [
    # (what to change, into what, part of the message, key on the line that is named)
    ("width = 0.03", "width = -0.03", "column.width", "width"),
    ("width = 0.03", 'width = "30 mm"', "expected a number in SI units", "width"),
    ("width = 0.03", "wide = 0.03", "did you mean 'width'?", "wide"),
    ("depth = 0.006", "depth = 0.001", "at least a particle's diameter, 0.0012 m", "depth"),
    ("cells = [10, 2, 30]", "cells = [10, 2]", "2 entries for the numbers of gas cells", "cells"),
    ("cells = [10, 2, 30]", "cells = [10, 0, 30]", "column.cells[1] = 0", "cells"),
    ("cells = [10, 2, 30]", "cells = [10, 2.0, 30]", "whole number", "cells"),
    ('wall_material = "soft"', 'wall_material = "sofd"', "did you mean 'soft'?", "wall_material"),
    ('wall_material = "soft"', 'front_back = "layer"', "expected one cell in y", "cells"),
    ('wall_material = "soft"', 'front_back = "layers"', "'layer'", "front_back"),
    ("count = 300", "count = 30000", "fills 1.68 of the column", "count"),
    ("count = 300", "count = 300\npositions = [[0.01, 0.003, 0.01]]", 'expected packing = "given"', "positions"),
    ("count = 300", 'count = 1\npacking = "given"', "0 of them: expected as many as count, 1", None),
    (
        "count = 300",
        'count = 1\npacking = "given"\npositions = [[0.04, 0.003, 0.01]]',
        "expected a centre inside the column",
        "positions",
    ),
    (
        "count = 300",
        'count = 2\npacking = "given"\npositions = [[0.01, 0.003, 0.01], [0.01, 0.0035, 0.01]]',
        "overlaps positions[0] by more than a radius",
        "positions",
    ),
    ('material = "soft"\n\n[gas]', 'material = "softer"\n\n[gas]', "did you mean 'soft'?", None),
    ("density = 1.2", "density = 1200.0", "expected less than the particles' 1000", "density"),
    ("viscosity = 1.8e-5", "viscosity = 1e-300", "gas.viscosity = 1e-300", "viscosity"),
    ("viscosity = 1.8e-5", "viscosity = 101.0", "gas.viscosity = 101.0", "viscosity"),
    ("density = 1.2", "density = 1e-5", "gas.density", "density"),
    ("viscosity = 1.8e-5", "", "missing: expected dynamic viscosity [Pa s]", None),
    ("U_0 = 0.8", "U_0 = 0.8\nramp = [[0.0, 1.0]]", "expected one of U_0, ramp and jet", "ramp"),
    ("U_0 = 0.8", "ramp = [[0.0, 1.0], [0.0, 2.0]]", "expected them to increase", "ramp"),
    ("U_0 = 0.8", 'drag = "Gidaspow"', "'ErgunWenYu'", "drag"),
    ("U_0 = 0.8", "parcels_per_particle = 2", "parcels_per_particle = 2", "parcels_per_particle"),
    ("U_0 = 0.8", "[gas.jet]\nx_low = 0.02\nx_high = 0.01\nvelocity = 1.0", "expected above x_low = 0.02", "x_high"),
    ("v_0 = 0.2\n", "", "a bed has no first impact to take it from", None),
    ('between = ["particles", "walls"]', 'between = ["particles", "floor"]', "between = 'floor'", "between"),
    ("friction = 0.3", "", "changes nothing", None),
    ("coupling = 5e-4", "coupling = 1.0", "expected at most end_time, 0.5 s", "coupling"),
    ("coupling = 5e-4", "coupling = 5e-4\ngas_step = 1e-3", "expected at most the coupling interval", "gas_step"),
    ("coupling = 5e-4", "coupling = 5e-4\ndiscard = 0.5", "expected less than end_time", "discard"),
    ("coupling = 5e-4", "coupling = 5e-4\nuntil_time = 1.0", "unknown key", "until_time"),
    ("gravity = 9.8", "gravity = [0.0, 0.0, -9.8]", "expected a number", "gravity"),
    ("gravity = 9.8", "gravity = 0.0", "nothing settles", "gravity"),
    ("pressure_drop = 0.03", "pressure_dorp = 0.03", "did you mean 'pressure_drop'?", "pressure_dorp"),
    ("tangential = false", "gas = false", "expected one of rolling, tangential", None),
    ("[materials.soft]", "[materials.walls]", "stands for the bodies of a bed", None),
]


def test_all_particles_in_one_place_are_found_without_counting_their_pairs():
    """They make n²/2 pairs, which would take all memory."""
    tracemalloc.start()
    told = _too_close(np.full((13_000, 3), 0.01), 6e-4)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert told == [(0, 1), (0, 2), (0, 3)]
    assert peak < 1e8


@given(st.integers(2, 60), st.integers(0, 10**6))
def test_particles_that_are_too_close_are_found_wherever_they_are(n, seed):
    x = np.random.default_rng(seed).uniform(0.0, 4.0, (n, 3))
    apart = np.linalg.norm(x[:, None] - x[None], axis=-1) + np.diag(np.full(n, np.inf))
    close = {(int(i), int(k)) for i, k in np.argwhere(apart < 0.5) if i < k}
    told = _too_close(x, 0.5)
    assert bool(told) == bool(close)
    assert set(told) <= close


@pytest.mark.parametrize(("old", "new", "text", "key"), FAULTS)
def test_faults_are_named_with_line_key_and_remedy(old, new, text, key):
    assert GOOD.count(old) == 1
    bad = GOOD.replace(old, new)
    with pytest.raises(CaseFileError) as caught:
        parse_bed(bad, name="sample", where="here/case.toml")
    message = str(caught.value)
    assert text in message
    assert message.startswith("here/case.toml")
    if key is not None:
        changed = bad.count("\n", 0, bad.index(new)) - 1  # some name a key just above the change
        rows = list(enumerate(bad.splitlines(), start=1))
        line = next(i for i, row in rows[changed:] + rows[:changed] if re.match(rf"{key} =", row))
        assert f"line {line}:" in message


def test_a_layer_starts_in_its_middle_plane():
    layer = GOOD.replace("cells = [10, 2, 30]", 'cells = [10, 1, 30]\nfront_back = "layer"')
    given = 'count = 1\npacking = "given"\npositions = [[0.01, {}, 0.01]]'
    assert parse_bed(layer.replace("count = 300", given.format(0.003)), name="x").particles.positions[0][1] == 0.003
    with pytest.raises(CaseFileError, match="the middle plane of the layer"):
        parse_bed(layer.replace("count = 300", given.format(0.0031)), name="x")


def test_frozen_at_given_places_and_gas_alone_need_no_contact():
    frozen = 'count = 1\nfrozen = true\npacking = "given"\npositions = [[0.01, 0.003, 0.01]]'
    for particles in (frozen, "count = 0"):
        text = GOOD.replace("v_0 = 0.2\n", "").replace("count = 300", particles)
        assert parse_bed(text, name="x").contact.v_0 is None


def test_all_faults_at_once():
    bad = (
        GOOD.replace("width = 0.03", "width = -1.0")
        .replace("e_n = 0.9", "e_n = 2.0")
        .replace("count = 300", "count = -1")
    )
    with pytest.raises(CaseFileError) as caught:
        parse_bed(bad, name="sample")
    assert [key for key in ("column.width", "contact.e_n", "particles.count") if key in str(caught.value)] == [
        "column.width",
        "contact.e_n",
        "particles.count",
    ]


def test_the_choices_of_the_schema_are_those_of_the_scene():
    fields = {
        (ColumnTable, "front_back"): DEPTHS,
        (BedParticlesTable, "packing"): PACKINGS,
        (GasTable, "parcels_per_particle"): PARCELS,
    }
    for (table, name), choices in fields.items():
        assert table.model_fields[name].annotation.__args__ == choices  # type: ignore[union-attr]


# --- one door for both kinds of case --------------------------------------------------------------------------


def test_a_column_makes_a_bed(tmp_path: Path):
    home = tmp_path / "my_bed"
    home.mkdir()
    (home / "case.toml").write_text(GOOD, encoding="utf-8")
    assert load_case(home) == load_bed(home) == parse_bed(GOOD, name="my_bed")
    assert isinstance(load_case("wall_impact"), Scene)
    with pytest.raises(CaseFileError, match=r"expected a case of single contacts, one of .*wall_impact"):
        load_scene(home)
    with pytest.raises(CaseFileError, match=r"column: missing: expected \[column\] with width"):
        load_bed("wall_impact")


def test_shipped_cases_are_beds_or_single_contacts():
    assert set(BEDS) | set(shipped_cases(beds=False)) == set(shipped_cases())
    assert not set(BEDS) & set(shipped_cases(beds=False))
    assert all(isinstance(load_case(name), BedScene) for name in BEDS)
    assert {"packed_bed", "fluidization_curve", "bubbling_bed_mini", "bubbling_bed"} <= set(BEDS)


# --- written back ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BEDS)
def test_shipped_beds_are_written_back(name):
    bed = load_bed(name)
    assert parse_bed(dump_bed(bed), name=name) == bed


def test_odd_numbers_are_written_back_to_the_bit():
    bed = parse_bed(GOOD, name="x")
    third = replace(
        bed,
        gas=Gas(density=1.0 / 3.0, viscosity=1e-5 / 7.0, jet=Jet(x_low=0.003, x_high=0.006, velocity=10.0 / 3.0)),
        particles=replace(
            bed.particles, count=2, packing="given", positions=((0.1 / 3, 0.001, 0.01), (0.02, 0.001, 1e-3 / 3))
        ),
        column=replace(bed.column, width=0.2 / 3.0, wall_material=None),
    )
    assert parse_bed(dump_bed(third), name="x") == third


def test_what_no_case_file_may_say_is_refused():
    bed = parse_bed(GOOD, name="x")
    with pytest.raises(InputError, match=r"cannot be written.*column\.width"):
        dump_bed(replace(bed, column=replace(bed.column, width=-1.0)))
    other = replace(bed.particles.material, young=1e7)
    with pytest.raises(InputError, match="two different materials are called 'soft'"):
        dump_bed(replace(bed, column=replace(bed.column, wall_material=other)))


# --- the shipped beds -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BEDS)
def test_shipped_beds_say_what_they_are(name):
    home, bed = folder("cases") / name, load_bed(name)
    lines = (home / "case.toml").read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# ")
    assert lines[0].endswith("SI units.")
    assert len(lines) <= 70
    assert bed.title
    assert bed.source
    assert bed.tolerances, "a comparison needs tolerances for a verdict"
    readme = (home / "README.md").read_text(encoding="utf-8")
    assert readme.startswith(f"# {bed.title}")
    assert f"    kncal compare {name}\n" in readme
    expected = json.loads((home / "expected.json").read_text(encoding="utf-8"))
    assert set(expected) == {"note", "metrics"}
    assert set(expected["metrics"]) == {"linear", "hertz"}
    for metrics in expected["metrics"].values():
        assert metrics
        for metric, entry in metrics.items():
            assert metric in offered(COUPLED)
            assert set(entry) == {"value", "rel_tol", "source"}
            assert 0.0 < entry["rel_tol"] <= 0.1


PROMISED = {
    "terminal_velocity": {"gas", "motion", "depth", "coupling", "liggghts", "openfoam"},
    "packed_bed": {"gas", "settling", "contacts", "tangential", "damping", "depth", "liggghts", "openfoam"},
    "bubbling_bed": {
        *("gas", "motion", "settling", "contacts", "tangential", "damping", "coupling", "liggghts", "openfoam")
    },
}


@pytest.mark.parametrize("name", PROMISED)
def test_shipped_beds_need_what_their_physics_says(name):
    needs = decide(load_bed(name))
    assert {item.name for item in needs.items if item.used} == PROMISED[name]
    assert needs.dimensions == (2 if name == "bubbling_bed" else 3)
