"""Case files of beds: what they say comes through, what is wrong is named with its line, and the shipped beds hold."""

import json
import re
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shipped import BEDS

from kncal.core.errors import CaseFileError, InputError
from kncal.core.shipped import folder
from kncal.scene.box_checks import _too_close
from kncal.scene.case_file import dump_case, load_case, parse_case
from kncal.scene.gas import Gas, Jet
from kncal.scene.metrics import COUPLED, offered
from kncal.scene.needs import decide
from kncal.scene.placement import PLACEMENTS
from kncal.scene.run_control import RunControl
from kncal.scene.scene import PARCELS

GOOD = """\
title = "a bed"
gravity = [0.0, 0.0, -9.8]    # m/s²

[materials.soft]
young = 5e6
poisson = 0.3
density = 1000.0

[walls.column]
shape = "box"
size = [0.03, 0.006, 0.09]
material = "soft"

[particles.beads]
count = 300
place = "settled"
diameter = 0.0012
material = "soft"

[gas]
cells = [10, 2, 30]
density = 1.2
viscosity = 1.8e-5
U_0 = 0.8

[contact]
e_n = 0.9
v_0 = 0.2
friction = 0.1

[[contact.pairs]]
between = ["beads", "column"]
friction = 0.3

[run]
until_time = 0.5
coupling = 5e-4

[tolerances]
pressure_drop = 0.03

[needs]
tangential = false
"""


def test_what_is_said_comes_through():
    bed = parse_case(GOOD, name="sample")
    assert (bed.name, bed.title, bed.gravity, bed.g) == ("sample", "a bed", (0.0, 0.0, -9.8), 9.8)
    assert (bed.box.width, bed.box.depth, bed.box.height) == (0.03, 0.006, 0.09)
    assert [body.name for body in bed.bodies] == ["beads", "column"]
    assert bed.planes[0].material is bed.spheres[0].material
    assert (bed.number, bed.group.place, bed.frozen) == (300, "settled", False)
    assert bed.gas == Gas(cells=(10, 2, 30), density=1.2, viscosity=1.8e-5, U_0=0.8)
    assert bed.contact.pairs[0].between == ("beads", "column")
    assert (bed.run.until_time, bed.run.coupling, bed.run.discard) == (0.5, 5e-4, None)
    assert bed.tolerances == {"pressure_drop": 0.03}
    assert bed.needs == {"tangential": False}


def test_gas_may_be_missing_jet_and_ramp_come_through():
    dry = parse_case(re.sub(r"\[gas\].*?(?=\[contact\])", "", GOOD, flags=re.S), name="dry")
    assert dry.gas is None
    jet = parse_case(
        GOOD.replace("U_0 = 0.8\n", "[gas.jet]\nx_low = 0.012\nx_high = 0.018\nvelocity = 5.0\n"), name="jet"
    )
    assert jet.gas is not None
    assert jet.gas.jet == Jet(x_low=0.012, x_high=0.018, velocity=5.0)
    assert jet.gas.inlet_at(0.1) == 0.0
    ramp = parse_case(GOOD.replace("U_0 = 0.8", "ramp = [[0.1, 0.2], [0.3, 0.6]]"), name="ramp")
    assert ramp.gas is not None
    assert [ramp.gas.inlet_at(t) for t in (0.0, 0.1, 0.2, 0.3, 9.0)] == pytest.approx([0.2, 0.2, 0.4, 0.6, 0.6])


SIZE, BEADS = "size = [0.03, 0.006, 0.09]", 'count = 300\nplace = "settled"'
FAULTS = [
    # (what to change, into what, part of the message, key on the line that is named)
    (SIZE, "size = [-0.03, 0.006, 0.09]", "walls.column.size[0]", "size"),
    (SIZE, 'size = ["30 mm", 0.006, 0.09]', "expected a number in SI units", "size"),
    (SIZE, "sice = [0.03, 0.006, 0.09]", "did you mean 'size'?", "sice"),
    (SIZE, "size = [0.03, 0.006]", "2 entries for the [width, depth, height]", "size"),
    (SIZE, "size = [0.03, 0.001, 0.09]", "at least a particle's diameter, 0.0012 m", "size"),
    ("cells = [10, 2, 30]", "cells = [10, 2]", "2 entries for the numbers of gas cells", "cells"),
    ("cells = [10, 2, 30]", "cells = [10, 0, 30]", "gas.cells[1] = 0", "cells"),
    ("cells = [10, 2, 30]", "cells = [10, 2.0, 30]", "whole number", "cells"),
    ('material = "soft"\n\n[particles', 'material = "sofd"\n\n[particles', "did you mean 'soft'?", None),
    ('title = "a bed"', 'title = "a bed"\nlayer = "y"', "expected one cell in y", "cells"),
    ('title = "a bed"', 'title = "a bed"\nlayer = "x"', "expected only y, the depth", "layer"),
    ('title = "a bed"', 'title = "a bed"\nperiodic = ["y", "z"]', "expected only y, the depth", "periodic"),
    ('title = "a bed"', 'title = "a bed"\nlayer = "y"\nperiodic = ["y"]', "given together with periodic", "layer"),
    ("count = 300", "count = 30000", "fills 1.68 of the box", "count"),
    ("count = 300\n", "", "count: missing: expected number of particles", None),
    (BEADS, f"{BEADS}\npositions = [[0.01, 0.003, 0.01]]", 'expected place = "given"', "positions"),
    (BEADS, "count = 1", "0 of them: expected as many as count, 1", None),
    (BEADS, 'place = "setled"\ncount = 300', "did you mean 'settled'?", "place"),
    (BEADS, "positions = [[0.04, 0.003, 0.01]]", "expected a centre inside the box", "positions"),
    (BEADS, "position = [0.04, 0.003, 0.01]", "expected a centre inside the box", "position"),
    (
        BEADS,
        "positions = [[0.01, 0.003, 0.01], [0.01, 0.0035, 0.01]]",
        "overlaps positions[0] by more than a radius",
        "positions",
    ),
    (BEADS, f"{BEADS}\nvelocity = [0.0, 0.0, 1.0]", "particles start at rest in a box", "velocity"),
    (BEADS, "count = 300\nplace = 'lattice'\nsettle_k_n = 10.0", 'given together with place = "lattice"', "settle_k_n"),
    ('material = "soft"\n\n[gas]', 'material = "softer"\n\n[gas]', "did you mean 'soft'?", None),
    ("density = 1.2", "density = 1200.0", "expected less than the particles' 1000", "density"),
    ("viscosity = 1.8e-5", "viscosity = 1e-300", "gas.viscosity = 1e-300", "viscosity"),
    ("viscosity = 1.8e-5", "viscosity = 101.0", "gas.viscosity = 101.0", "viscosity"),
    ("density = 1.2", "density = 1e-5", "gas.density", "density"),
    ("viscosity = 1.8e-5", "", "missing: expected dynamic viscosity [Pa s]", None),
    ("U_0 = 0.8", "U_0 = 0.8\nramp = [[0.0, 1.0]]", "expected one of U_0, ramp and jet", "ramp"),
    ("U_0 = 0.8", "ramp = [[0.0, 1.0], [0.0, 2.0]]", "expected them to increase", "ramp"),
    ("U_0 = 0.8", "ramp = [[0.0, 1.0], [0.5, 2e3]]", "gas.ramp[1][1] = 2000.0", "ramp"),
    ("U_0 = 0.8", 'drag = "Gidaspow"', "'ErgunWenYu'", "drag"),
    ("U_0 = 0.8", "parcels_per_particle = 2", "parcels_per_particle = 2", "parcels_per_particle"),
    ("U_0 = 0.8", "[gas.jet]\nx_low = 0.02\nx_high = 0.01\nvelocity = 1.0", "expected above x_low = 0.02", "x_high"),
    ("v_0 = 0.2\n", "", "a bed has no first impact to take it from", None),
    ('between = ["beads", "column"]', 'between = ["beads", "floor"]', "between = 'floor'", "between"),
    ('between = ["beads", "column"]', 'between = ["column", "column"]', "expected names of two bodies", "between"),
    ("friction = 0.3", "", "changes nothing", None),
    ("coupling = 5e-4", "coupling = 1.0", "expected at most until_time, 0.5 s", "coupling"),
    ("coupling = 5e-4", "coupling = 5e-4\ngas_step = 1e-3", "expected at most the coupling interval", "gas_step"),
    ("coupling = 5e-4", "coupling = 5e-4\ndiscard = 0.5", "expected less than until_time", "discard"),
    ("coupling = 5e-4", "coupling = 5e-4\ndt = 1e-6", "no meaning for a run that is coupled", "dt"),
    ("coupling = 5e-4", "", "expected run.coupling [s]", None),
    ("gravity = [0.0, 0.0, -9.8]", "gravity = [0.0, 0.0, 9.8]", "expected it downwards", "gravity"),
    ("gravity = [0.0, 0.0, -9.8]", "gravity = [0.0, 1.0, -9.8]", "expected it downwards", "gravity"),
    ("gravity = [0.0, 0.0, -9.8]", "", "nothing settles", None),
    ("pressure_drop = 0.03", "pressure_dorp = 0.03", "did you mean 'pressure_drop'?", "pressure_dorp"),
    ("tangential = false", "gas = false", "expected one of history, rolling, tangential", None),
    ("[gas]", '[walls.lid]\naxis = "z"\nposition = 0.08\nmaterial = "soft"\n\n[gas]', "only the wall of shape", None),
    ("[gas]", '[particles.sand]\nmaterial = "soft"\ndiameter = 1e-3\n\n[gas]', "expected one group", None),
]

#: As kncal 0.1 had them, and what its place is now.
OLD = [
    ("[walls.column]", "[column]", 'shape = "box"'),
    ("[particles.beads]", "[particles]", "[particles.beads]"),
    ("[particles.beads]", "[[particles]]", "[particles.NAME]"),
    ("[walls.column]", "[[walls]]", "[walls.NAME]"),
    ("until_time = 0.5", "end_time = 0.5", "run.until_time in place of run.end_time"),
    ("gravity = [0.0, 0.0, -9.8]", "gravity = 9.8", "gravity = [0.0, 0.0, -9.8]"),
]


@pytest.mark.parametrize(("new", "old", "remedy"), OLD)
def test_a_case_of_an_earlier_kncal_is_refused_in_one_line_with_the_new_spelling(new, old, remedy):
    with pytest.raises(CaseFileError) as caught:
        parse_case(GOOD.replace(new, old), name="sample", where="here/case.toml")
    assert "\n" not in str(caught.value)
    assert "kncal 0.1" in str(caught.value)
    assert remedy in str(caught.value)


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
        parse_case(bad, name="sample", where="here/case.toml")
    message = str(caught.value)
    assert text in message
    assert message.startswith("here/case.toml")
    if key is not None:
        changed = bad.count("\n", 0, bad.index(new)) - 1  # some name a key just above the change
        rows = list(enumerate(bad.splitlines(), start=1))
        line = next(i for i, row in rows[changed:] + rows[:changed] if re.match(rf"{key} =", row))
        assert f"line {line}:" in message


def test_a_layer_starts_in_its_middle_plane():
    layer = GOOD.replace("cells = [10, 2, 30]", "cells = [10, 1, 30]").replace("gravity", 'layer = "y"\ngravity')
    given = "position = [0.01, {}, 0.01]"
    assert parse_case(layer.replace(BEADS, given.format(0.003)), name="x").group.centres[0][1] == 0.003
    with pytest.raises(CaseFileError, match="the middle plane of the layer"):
        parse_case(layer.replace(BEADS, given.format(0.0031)), name="x")


def test_frozen_at_given_places_and_gas_alone_need_no_contact():
    for particles in ("frozen = true\nposition = [0.01, 0.003, 0.01]", "count = 0"):
        text = GOOD.replace("v_0 = 0.2\n", "").replace(BEADS, particles)
        assert parse_case(text, name="x").contact.v_0 is None


def test_all_faults_at_once():
    bad = GOOD.replace("[0.03,", "[-1.0,").replace("e_n = 0.9", "e_n = 2.0").replace("count = 300", "count = -1")
    with pytest.raises(CaseFileError) as caught:
        parse_case(bad, name="sample")
    for key in ("walls.column.size", "contact.e_n", "particles.beads.count"):
        assert key in str(caught.value)


def test_the_choices_of_a_case_are_those_of_the_registries():
    assert Gas.__pydantic_fields__["parcels_per_particle"].annotation.__args__ == PARCELS  # type: ignore[union-attr]
    for place in set(PLACEMENTS) - {"stream"}:  # which is for particles without gas
        own = "position = [0.01, 0.003, 0.01]" if place == "given" else "count = 1"
        assert parse_case(GOOD.replace(BEADS, f'place = "{place}"\n{own}'), name="x").group.place == place


# --- written back ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BEDS)
def test_shipped_beds_are_written_back(name):
    bed = load_case(name)
    assert parse_case(dump_case(bed), name=name) == bed


def test_odd_numbers_are_written_back_to_the_bit():
    bed = parse_case(GOOD, name="x")
    third = replace(
        bed.with_group(count=2, place="given", positions=((0.1 / 3, 0.001, 0.01), (0.02, 0.001, 1e-3 / 3))).with_box(
            size=(0.2 / 3.0, 0.006, 0.09), material="rigid"
        ),
        gas=Gas(
            cells=(10, 2, 30),
            density=1.0 / 3.0,
            viscosity=1e-5 / 7.0,
            jet=Jet(x_low=0.003, x_high=0.006, velocity=10.0 / 3.0),
        ),
        run=RunControl(until_time=1.0 / 3.0, coupling=1e-3 / 3.0, frames_every=0.1 / 3.0),
    )
    assert parse_case(dump_case(third), name="x") == third


def test_what_no_case_file_may_say_is_refused():
    bed = parse_case(GOOD, name="x")
    with pytest.raises(InputError, match=r"(?s)cannot be written.*at least a particle's diameter"):
        dump_case(bed.with_box(size=(1e-4, 0.006, 0.09)))


# --- the shipped beds -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BEDS)
def test_shipped_beds_say_what_they_are(name):
    home, bed = folder("cases") / name, load_case(name)
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
    "packed_bed": {"gas", "settling", "contacts", "tangential", "history", "damping", "depth", "liggghts", "openfoam"},
    "bubbling_bed": {
        *(
            "gas",
            "motion",
            "settling",
            "contacts",
            "tangential",
            "history",
            "damping",
            "coupling",
            "liggghts",
            "openfoam",
        )
    },
}


@pytest.mark.parametrize("name", PROMISED)
def test_shipped_beds_need_what_their_physics_says(name):
    needs = decide(load_case(name))
    assert {item.name for item in needs.items if item.used} == PROMISED[name]
    assert needs.dimensions == (2 if name == "bubbling_bed" else 3)
