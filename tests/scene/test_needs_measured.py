"""The rules of `kncal.scene.needs` against runs: what they leave out has no effect, what they keep has one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from models import with_bodies
from shipped import SINGLE

from kncal.runs.workflow import load
from kncal.scene.case_file import dump_case, load_case
from kncal.scene.needs import decide
from kncal.scene.scene import Scene
from kncal.study import Variant, run_variants
from kncal.study.trim.effects import resolution_of
from kncal.study.trim.run import TrimOptions, trim
from kncal.study.trim.trim import ON, Trim
from kncal.study.variants import changes_of

pytestmark = pytest.mark.slow

#: Friction in every contact, so that the rule has to look at the motion.
ROUGH = "contact.friction=0.3"


def trimmed(case: str | Path, out: Path, *parts: str, engine: str = "builtin", overrides: tuple[str, ...] = ()) -> Trim:
    """Run with no tolerance, so that the discretisation error is the only measure of an effect."""
    given = [f"tolerances.{name}=none" for name in load_case(case).tolerances]
    options = TrimOptions(engine=engine, rounds=1, parts=parts, overrides=(*given, *overrides))
    return trim(case, out, options)


@pytest.mark.parametrize("case", SINGLE)
def test_friction_that_the_rules_leave_out_has_no_effect_and_what_they_keep_has_one(case: str, tmp_path: Path) -> None:
    """With friction 0.3 in every contact: a head-on contact does not feel it, an oblique and a sliding one do."""
    needed = decide(load_case(case, overrides=[ROUGH])).uses("tangential")
    (result,) = trimmed(case, tmp_path, "tangential", overrides=(ROUGH,)).results
    assert (result.part.change == ON) == (not needed)
    assert result.verdict == ("keep" if needed else "not needed")
    if not needed:
        # no surface slides: not even the last bit may differ
        assert {e.difference.value for e in result.effects if e.difference.value is not None} == {0.0}
        assert len(result.effects) > 2


@pytest.mark.parametrize("case", [case for case in SINGLE if decide(load_case(case)).uses("damping")])
def test_damping_that_the_rules_keep_has_an_effect(case: str, tmp_path: Path) -> None:
    (result,) = trimmed(case, tmp_path, "damping").results
    assert result.verdict == "keep"


@pytest.mark.parametrize("case", SINGLE)
def test_the_motion_stays_in_as_many_dimensions_as_the_rules_say(case: str, tmp_path: Path) -> None:
    """Displacements span a space of that rank; the engine computes three dimensions and knows nothing of it."""
    needs = decide(load_case(case, overrides=[ROUGH]))
    found = run_variants(
        case, [Variant(name="full", model="linear", changes=changes_of([ROUGH]))], tmp_path, engine="builtin"
    )
    folder = found["full"].folder
    assert folder is not None
    x = load(folder).trajectory.x
    sizes = np.linalg.svd((x - x[0]).reshape(-1, 3), compute_uv=False)
    assert sizes[0] > 0.0
    assert np.all(sizes[needs.dimensions :] <= 1e-12 * sizes[0])


def test_a_wall_that_the_rules_call_out_of_reach_can_be_taken_away(tmp_path: Path) -> None:
    scene = load_case("falling_particle")
    walls = [replace(scene.planes[0], name=f"side_{x}", axis="x", position=float(x)) for x in (-1, 1)]
    path = tmp_path / "shaft.toml"
    path.write_text(dump_case(with_bodies(scene, planes=(*scene.planes, *walls))), "utf-8")
    found = trimmed(path, tmp_path / "out", "walls")
    (result,) = found.results
    assert result.verdict == "leave out"
    assert {e.difference.value for e in result.effects if e.difference.value is not None} == {0.0}
    assert list(found.trimmed.walls) == ["floor"]


def test_half_the_step_changes_no_more_than_the_resolution(tmp_path: Path) -> None:
    """The measure itself: the error of a run is bounded by what halving its step moves."""
    variants = [Variant(name=f"n{n}", model="linear", changes={"run.steps_per_contact": n}) for n in (50, 100, 400)]
    runs = run_variants("oblique_impact", variants, tmp_path, engine="builtin")
    coarse, half, fine = (load(runs[v.name].folder) for v in variants)  # type: ignore[arg-type]
    bound = resolution_of(coarse, half)
    error = resolution_of(coarse, fine)
    for metric in ("spin_out", "tangential_restitution", "trajectory"):
        assert error[metric] / 4.0 <= bound[metric] + 1e-12


@pytest.mark.solver
@pytest.mark.parametrize("case", ["wall_impact", "head_on_collision"])
def test_liggghts_feels_neither_friction_nor_rolling_friction_in_a_head_on_contact(case: str, tmp_path: Path) -> None:
    rough = (ROUGH, "contact.rolling_friction=0.1")
    found = trimmed(case, tmp_path, "tangential", "rolling", engine="liggghts", overrides=rough)
    assert [r.verdict for r in found.results] == ["not needed", "not needed"]
    for result in found.results:
        assert {e.difference.value for e in result.effects if e.difference.value is not None} == {0.0}


@pytest.mark.solver
def test_liggghts_feels_rolling_friction_where_the_rules_keep_it(tmp_path: Path) -> None:
    rough = (ROUGH, "contact.rolling_friction=0.1")
    found = trimmed("oblique_impact", tmp_path, "tangential", "rolling", engine="liggghts", overrides=rough)
    assert [r.verdict for r in found.results] == ["keep", "keep"]


@pytest.mark.solver
def test_a_bed_of_one_particle_that_touches_nothing_needs_no_friction(tmp_path: Path) -> None:
    """Twenty couplings of it, with friction that the rules leave out and forced on: the same to the last bit."""
    overrides = (ROUGH, "contact.e_n=0.9", "run.until_time=0.004", "run.frames_every=0.001")
    scene = load_case("terminal_velocity", overrides=overrides)
    assert isinstance(scene, Scene)
    assert not decide(scene).uses("tangential")
    variants = [
        Variant(name=name, model="linear", changes=changes_of([*overrides, *more]))
        for name, more in (("left-out", ()), ("forced", ("needs.tangential=true",)))
    ]
    runs = run_variants("terminal_velocity", variants, tmp_path)
    left_out, forced = (load(runs[v.name].folder).series for v in variants)  # type: ignore[arg-type]
    assert np.abs(left_out.v).max() > 0.0
    for name in ("x", "v", "p_in", "drag_z", "z_mean", "kinetic_energy"):
        assert np.array_equal(getattr(left_out, name), getattr(forced, name)), name
