"""The optional parts of scenes: each makes another valid scene, in what it says it changes and in nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from shutil import copyfile

import pytest
from models import with_bodies

from kncal.core.errors import InputError
from kncal.scene.case_file import dump_case, load_case, shipped_cases
from kncal.scene.plan import plan
from kncal.scene.scene import Scene
from kncal.study.trim.parts import PARTS, parts_of
from kncal.study.trim.trim import OFF, ON, OTHER, Part
from kncal.study.variants import texts

pytestmark = pytest.mark.slow


def changed(scene: Scene, part: Part, folder: Path) -> Scene:
    path = folder / f"{scene.name}.toml"
    path.write_text(dump_case(scene), "utf-8")
    for name in scene.files:
        copyfile(scene.path_of(name), folder / name)
    return replace(load_case(path, overrides=texts(part.changes)), title=scene.title)


def everything(name: str) -> Scene:
    """A shipped case with every coefficient above zero, so that every part has something to switch."""
    return load_case(name, overrides=["contact.friction=0.2", "contact.rolling_friction=0.1"])


@pytest.mark.parametrize("name", shipped_cases())
def test_every_part_that_applies_gives_another_scene_that_can_be_planned(name: str, tmp_path: Path) -> None:
    scene = everything(name)
    for part in parts_of(scene, "linear"):
        assert part.group in PARTS
        if part.why_not:
            assert not part.changes
            continue
        other = changed(scene, part, tmp_path)
        assert (other != scene) == bool(part.changes)
        assert part.changes or part.model == "hertz"
        if other.coupled:
            assert plan(other, ("linear",))["linear"].couplings > 0
        else:
            assert plan(other, ("linear",))["linear"].n_steps > 0


@pytest.mark.parametrize("name", ["bubbling_bed_mini", "fluidization_curve", "oblique_impact", "head_on_collision"])
def test_what_is_left_out_can_be_put_back(name: str, tmp_path: Path) -> None:
    """Off and on are inverse to each other: the scene without a part is offered the same part again."""
    scene = everything(name)
    for part in parts_of(scene, "linear"):
        if part.why_not or part.group in ("depth", "gas", "damping", "output", "walls", "contact_model"):
            continue
        other = changed(scene, part, tmp_path)
        back = [p for p in parts_of(other, "linear") if p.group == part.group]
        inverse = {OFF: ON, ON: OFF, OTHER: OTHER}[part.change]
        assert inverse in {p.change for p in back}
    models = {model: parts_of(scene, model, ["contact_model"])[0] for model in ("linear", "hertz")}
    assert (models["linear"].change, models["linear"].model) == (ON, "hertz")
    assert (models["hertz"].change, models["hertz"].model) == (OFF, "linear")


def test_one_layer_has_as_many_particles_per_floor_area(tmp_path: Path) -> None:
    scene = load_case("bubbling_bed_mini")
    (part,) = parts_of(scene, "linear", ["depth"])
    layer = changed(scene, part, tmp_path)
    assert (layer.front_back, layer.gas.cells[1]) == ("layer", 1)
    per_area = [s.number / (s.box.width * s.box.depth) for s in (scene, layer)]
    # to the nearest whole particle
    assert per_area[1] == pytest.approx(per_area[0], rel=0.5 / layer.number)
    assert parts_of(layer, "linear", ["depth"])[0].why_not


def test_damping_goes_in_every_pair(tmp_path: Path) -> None:
    scene = load_case("bubbling_bed")  # e_n of the walls differs
    (part,) = parts_of(scene, "linear", ["damping"])
    contact = changed(scene, part, tmp_path).contact
    assert {contact.e_n, *(pair.e_n for pair in contact.pairs)} == {1.0}


def test_a_wall_out_of_reach_may_go_and_one_in_reach_may_not(tmp_path: Path) -> None:
    scene = load_case("wall_impact")
    side = replace(scene.planes[0], name="side", axis="x", position=1.0)
    (part,) = parts_of(with_bodies(scene, planes=(*scene.planes, side)), "linear", ["walls"])
    assert part.changes == {"walls.side": None}
    assert "can be touched" in parts_of(scene, "linear", ["walls"])[0].why_not


def test_unknown_parts_and_those_of_other_cases_are_refused() -> None:
    with pytest.raises(InputError, match="drag"):
        parts_of(load_case("wall_impact"), "linear", ["drag"])
    with pytest.raises(InputError, match="rolling"):
        parts_of(load_case("bubbling_bed_mini"), "linear", ["roling"])
