"""Variants of a case: each runs once per round, keeps its name, and is refused alone."""

from __future__ import annotations

import pytest

from kncal.core.errors import CaseFileError, InputError
from kncal.runs.workflow import load
from kncal.study import Variant, removing, run_variants

CASE = """
[materials.glass]
young = 1e7
poisson = 0.25
density = 2500.0

[particles.bead]
material = "glass"
diameter = 0.002
position = [0.0, 0.0, 0.001001]
velocity = [0.0, 0.0, -1.0]

[walls.floor]
axis = "z"
position = 0.0
material = "rigid"

[contact]
e_n = 0.9
v_0 = 1.0
method = "mean_overlap"

[run]
steps_per_contact = 20
until_time = 0.0004
"""


@pytest.fixture
def case(tmp_path):
    path = tmp_path / "bead" / "case.toml"
    path.parent.mkdir()
    path.write_text(CASE)
    return path


def soft(name: str, k_n: str) -> Variant:
    return Variant(name=name, model="linear", changes={"contact.k_n": float(k_n), "contact.method": None})


def test_every_variant_has_its_own_result_in_the_order_given(case, tmp_path):
    variants = [
        soft("soft", "1000"),
        Variant(name="hertz", model="hertz", changes={"materials.glass.young": 2e7}),
        soft("softer", "250"),
    ]
    found = run_variants(case, variants, tmp_path / "study", engine="builtin", rounds=2)
    assert list(found) == ["soft", "hertz", "softer"]
    assert all(run.completed and len(run.cpu_seconds) == 2 for run in found.values())
    # four times softer is twice as long a contact, hence half as many steps
    assert found["softer"].dt == pytest.approx(2.0 * found["soft"].dt, rel=1e-12)
    data = {name: load(run.folder) for name, run in found.items()}
    assert data["soft"].model.between("bead", "floor").k == 1000.0
    assert data["hertz"].model.scene.spheres[0].material.young == 2e7


def test_a_variant_that_cannot_run_says_why_and_the_others_run(case, tmp_path):
    variants = [
        Variant(name="bad", model="linear", changes={"contact.e_n": 2}),
        soft("good", "1000"),
        Variant(name="typo", model="linear", changes={"contact.kn": 5}),
    ]
    found = run_variants(case, variants, tmp_path / "study", engine="builtin")
    assert [run.status for run in found.values()] == ["refused", "completed", "refused"]
    assert "e_n" in found["bad"].message
    assert "kn" in found["typo"].message
    assert found["bad"].folder is None
    alone = run_variants(case, variants[:1], tmp_path / "other", engine="builtin")
    assert alone["bad"].status == "refused"


def test_the_same_input_is_one_run_and_runs_that_are_there_are_kept(case, tmp_path):
    first = run_variants(case, [soft("a", "1000"), soft("b", "1000.0")], tmp_path / "study", engine="builtin")
    assert first["a"].folder == first["b"].folder
    stamp = (first["a"].folder / "result.json").stat().st_mtime_ns
    more = run_variants(case, [soft("c", "500"), soft("a", "1e3")], tmp_path / "study", engine="builtin", rounds=2)
    assert more["a"].folder == first["a"].folder
    assert (more["a"].folder / "result.json").stat().st_mtime_ns == stamp
    assert more["a"].cpu_seconds[0] == first["a"].cpu_seconds[0]
    assert len(more["a"].cpu_seconds) == 2


def test_two_variants_of_one_name_and_a_bad_case_are_refused(case, tmp_path):
    with pytest.raises(InputError, match="names that differ"):
        run_variants(case, [soft("a", "1"), soft("a", "2")], tmp_path / "study", engine="builtin")
    case.write_text(CASE.replace("density = 2500.0", ""))
    with pytest.raises(CaseFileError, match="density"):
        run_variants(case, [soft("a", "1")], tmp_path / "study", engine="builtin")
    assert not (tmp_path / "study").exists()


@pytest.mark.parametrize(("name", "model", "key"), [("a b", "linear", "a"), ("a", "both", "a"), ("a", "hertz", "a..b")])
def test_a_variant_is_checked_when_it_is_made(name, model, key):
    with pytest.raises(InputError, match="expected"):
        Variant(name=name, model=model, changes={key: 1})


def test_only_what_a_case_has_is_taken_out(case):
    assert removing(case, "contact.method", "contact.k_n", "gas") == {"contact.method": None}
