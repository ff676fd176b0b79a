"""A mesh file from a stranger: bounded, in the folder of the case, finite, or refused with file and key."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from granular import placed, plan_of

from kncal.core.errors import CaseFileError, KncalError, ReadError
from kncal.scene import meshes
from kncal.scene.limits import check
from kncal.scene.meshes import read_mesh
from kncal.scene.shapes import write_stl

pytestmark = pytest.mark.slow
WALL = '[walls.hopper]\nshape = "mesh"\nfile = "hopper.stl"\n'
PLATE = np.array([[[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.02, 0.0]]])


def refusal(home: Path) -> str:
    with pytest.raises(KncalError) as refused:
        for finding in check(plan_of(placed((0.0, 0.0, 0.05)) + WALL, home=home)):
            if finding.level == "refuse":
                raise CaseFileError(finding.message)
    return str(refused.value)


def binary(triangles: np.ndarray) -> bytes:
    rows = b"".join(struct.pack("<12fH", 0, 0, 1, *corners.ravel(), 0) for corners in triangles)
    return b"\0" * 80 + struct.pack("<I", len(triangles)) + rows


def test_a_good_file_is_taken_in_text_and_binary(tmp_path: Path) -> None:
    for write in (lambda path: write_stl(PLATE, path), lambda path: path.write_bytes(binary(PLATE))):
        write(tmp_path / "hopper.stl")
        found = check(plan_of(placed((0.0, 0.0, 0.05)) + WALL, home=tmp_path))
        assert not [f for f in found if f.level == "refuse"]


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_coordinates_that_are_not_finite_are_refused(number: float, tmp_path: Path) -> None:
    bad = PLATE.copy()
    bad[0, 1, 0] = number
    (tmp_path / "hopper.stl").write_bytes(binary(bad))
    assert "hopper.stl" in refusal(tmp_path)


def test_more_triangles_than_a_wall_may_have_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(meshes, "MOST_TRIANGLES", 3)
    (tmp_path / "hopper.stl").write_bytes(binary(np.concatenate([PLATE + 0.03 * i for i in range(5)])))
    assert "5 triangles" in refusal(tmp_path)


def test_a_header_that_claims_billions_of_triangles_is_refused_at_once(tmp_path: Path) -> None:
    data = bytearray(binary(PLATE))
    data[80:84] = struct.pack("<I", 2**32 - 1)
    (tmp_path / "hopper.stl").write_bytes(bytes(data))
    assert "hopper.stl" in refusal(tmp_path)


@pytest.mark.parametrize("text", [True, False])
def test_a_file_that_is_cut_off_is_refused(text: bool, tmp_path: Path) -> None:
    """VTK reads the triangles that are there: half a hopper."""
    path = tmp_path / "hopper.stl"
    many = np.concatenate([PLATE + 0.03 * i for i in range(5)])
    if text:
        write_stl(many, path)
    else:
        path.write_bytes(binary(many))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert "cut off" in refusal(tmp_path)


def test_a_link_that_leads_out_of_the_case_is_refused(tmp_path: Path) -> None:
    outside, home = tmp_path / "outside.stl", tmp_path / "case"
    home.mkdir()
    write_stl(PLATE, outside)
    (home / "hopper.stl").symlink_to(outside)
    assert "hopper.stl" in refusal(home)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    assert "hopper.stl" in refusal(tmp_path)


@pytest.mark.parametrize("suffix", [".xdmf", ".xmf", ".h5m", ".med", ".cgns", ".exe", ""])
def test_formats_that_may_name_other_files_are_not_read(suffix: str, tmp_path: Path) -> None:
    """An XDMF file names the file of its numbers: one anywhere on the machine."""
    secret = tmp_path / "secret.bin"
    secret.write_bytes(bytes(72))
    text = f'<Xdmf><DataItem Format="Binary">{secret}</DataItem></Xdmf>'
    (tmp_path / f"a{suffix}").write_text(text)
    with pytest.raises(ReadError, match="expected one of"):
        read_mesh(tmp_path / f"a{suffix}")
