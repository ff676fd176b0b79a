"""Tables of walls and motions: what is refused, and where a refusal says that the fault is."""

from __future__ import annotations

from typing import Any

import pytest

from kncal.core.errors import CaseFileError, InputError
from kncal.scene.case_file import parse_case
from kncal.scene.walls import WALLS, ConeWall, MeshWall, PlateWall, Translation

WALL_FAULTS = """
[walls.hopper]
shape = "cone"
radius_low = 0.1
radius_high = 0.2
low = 0
[[walls.hopper.motion]]
kind = "rotatee"
[[walls.hopper.motion]]
period = 1
[[walls.hopper.motion]]
kind = "rotate"
axis = [0, 0, 0]
periode = 1
[walls.belt]
axis = "z"
position = 0
material = "rigid"
motion = 1
"""


def test_refusal_of_a_wall_names_line_and_key_without_marks_of_its_kind() -> None:
    with pytest.raises(CaseFileError) as refused:
        parse_case(WALL_FAULTS, name="x")
    told = str(refused.value)
    for wanted in (
        "line 2: walls.hopper.high: missing",
        "line 8: walls.hopper.motion[0].kind = 'rotatee'",
        "line 9: walls.hopper.motion[1].kind: missing: expected one of translate, rotate, oscillate",
        "line 13: walls.hopper.motion[2].axis = [0, 0, 0]",
        "line 14: walls.hopper.motion[2].periode: unknown key",
        "line 19: walls.belt.motion = 1",
    ):
        assert wanted in told


@pytest.mark.parametrize(
    "name",
    ["/etc/passwd.stl", "../a.stl", "a/../../b.stl", "a\n.stl", "a", "", "..", "x" * 300 + ".stl", "a\u2028.stl"],
)
def test_file_of_a_mesh_stays_in_the_folder_of_the_case(name: str) -> None:
    with pytest.raises(InputError, match="file"):
        MeshWall(shape="mesh", file=name)


_SPAN = {"low": 0.0, "high": 1.0}


@pytest.mark.parametrize(
    ("shape", "values", "key"),
    [
        ("cylinder", {"radius": 1.0, "low": 1.0, "high": 1.0}, "high"),
        ("cone", _SPAN | {"radius_low": 0.0, "radius_high": 0.0}, "radius_high"),
        ("plate", {"corner": (0, 0, 0), "edge_1": (1, 0, 0), "edge_2": (-2, 0, 0)}, "edge_2"),
        ("disc", {"centre": (0, 0, 0), "radius": 1.0, "hole": 1.0}, "hole"),
        ("plane", {"axis": "z", "position": 0.0, "material": "rigid", "surface_velocity": (1, 0, 0)}, ""),
    ],
)
def test_values_that_contradict_each_other_are_told_at_their_key(shape: str, values: dict[str, Any], key: str) -> None:
    kind = WALLS[shape]
    found = [path for path, _ in kind.problems(kind.table(shape=shape, **values))]
    assert found == ([(key,)] if key else [])


def test_motion_ends_after_its_start_and_excludes_a_belt() -> None:
    late = Translation(kind="translate", velocity=(1.0, 0.0, 0.0), start=1.0, stop=0.5)
    wall = ConeWall(
        shape="cone", radius_low=0.0, radius_high=1.0, **_SPAN, motion=(late,), surface_velocity=(1.0, 0.0, 0.0)
    )
    assert [path for path, _ in WALLS["cone"].problems(wall)] == [("motion", 0, "stop"), ("surface_velocity",)]
    assert wall.moves
    assert not PlateWall(shape="plate", corner=(0, 0, 0), edge_1=(1, 0, 0), edge_2=(0, 1, 0)).moves
