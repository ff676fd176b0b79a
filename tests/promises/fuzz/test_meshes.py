"""Damaged meshes: the native readers may crash, but only in the child that tries them; see `kncal.core.child`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kncal.core.errors import ReadError
from kncal.scene.meshes import read_mesh
from tests.promises.fuzz.conftest import fuzzed
from tests.promises.fuzz.test_parsers import damaged

_SUFFIXES = (".vtk", ".vtp", ".vtu", ".stl", ".msh", ".ply")
_PIECES = (b"POINTS 999999999999 float", b'NumberOfPoints="999999999999"', b"<!DOCTYPE x>", b'format="appended"')


def good(folder: Path, suffix: str) -> bytes:
    import meshio

    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    path = folder / f"good{suffix}"
    if suffix == ".vtp":
        import pyvista

        pyvista.PolyData(points).save(path)
    else:
        meshio.Mesh(points, [("triangle", np.array([[0, 2, 1], [0, 1, 3]]))]).write(path)
    return path.read_bytes()


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("good")
    return {suffix: good(folder, suffix) for suffix in _SUFFIXES}


@pytest.mark.slow
@fuzzed(share=0.005, short=6)
@given(data=st.data(), suffix=st.sampled_from(_SUFFIXES))
def test_meshes(
    meshes: dict[str, bytes], tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, suffix: str
) -> None:
    """Whatever the native reader does, kncal has a mesh or says ReadError; a child takes a second, so they are few."""
    path = tmp_path_factory.mktemp("fuzz") / f"mesh{suffix}"
    path.write_bytes(data.draw(damaged(meshes[suffix], *_PIECES)))
    try:
        assert read_mesh(path).n_points > 0
    except ReadError as error:
        assert str(path) in str(error)


def test_a_reader_that_crashes_or_asks_for_everything_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "huge.vtk"
    path.write_text(
        "# vtk DataFile Version 3.0\nx\nBINARY\nDATASET POLYDATA\nPOINTS 99999999999 double\n", encoding="ascii"
    )
    with pytest.raises(ReadError, match=r"huge\.vtk"):
        read_mesh(path)
