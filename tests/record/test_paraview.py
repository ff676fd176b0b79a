"""VTK files, read back with pyvista as ParaView would."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kncal.core.errors import InputError, ReadError
from kncal.record.frames import Trajectory
from kncal.record.paraview import write_paraview, write_particles
from kncal.scene.meshes import read_mesh
from kncal.scene.wall_motion import walls_at
from kncal.scene.walls import DiscWall, PlateWall, Rotation

pytestmark = pytest.mark.slow


@pytest.fixture
def motion() -> Trajectory:
    rng = np.random.default_rng(5)
    step = np.array([0, 1, 2, 100, 250])
    x, v, spin, force = rng.standard_normal((4, 5, 3, 3))
    return Trajectory(
        names=("a", "b", "c"), step=step, t=step * 1e-6, x=x, v=v, spin=spin, force=force, radius=np.array([1.0, 2, 3])
    )  # fmt: skip


@pytest.mark.parametrize("every", [1, 2, 9])
def test_collection_reads_back_with_true_times(tmp_path: Path, motion: Trajectory, every: int) -> None:
    import pyvista

    path = write_particles(motion, tmp_path / "an odd & <name>", every=every)
    reader = pyvista.get_reader(path)
    kept = range(0, 5, every)
    assert reader.time_values == motion.t[::every].tolist()
    for number, frame in enumerate(kept):
        reader.set_active_time_point(number)
        points = reader.read()[0]
        np.testing.assert_array_equal(points.points, motion.x[frame])
        assert points.points.dtype == np.float64
        assert points.n_verts == 3
        for name, expected in {
            "id": [1, 2, 3],
            "radius": motion.radius,
            "velocity": motion.v[frame],
            "spin": motion.spin[frame],
            "force": motion.force[frame],
        }.items():
            np.testing.assert_array_equal(points.point_data[name], expected)


def test_every_must_be_positive(tmp_path: Path, motion: Trajectory) -> None:
    with pytest.raises(InputError, match="every"):
        write_particles(motion, tmp_path, every=0)


@pytest.mark.parametrize("suffix", [".vtp", ".vtk", ".stl", ".vtu", ".msh", ".ply"])
def test_meshes_of_many_formats(tmp_path: Path, suffix: str) -> None:
    """The surface area of a tetrahedron with a right corner at the origin: three halves, and sqrt(3)/2."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    triangles = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    path = tmp_path / f"mesh{suffix}"
    if suffix in (".vtp", ".vtk"):
        import pyvista

        pyvista.PolyData.from_regular_faces(points, triangles).save(path)
    else:
        import meshio

        meshio.Mesh(points, [("triangle", triangles)]).write(path)
    mesh = read_mesh(path)
    assert mesh.area == pytest.approx(1.5 + np.sqrt(3) / 2, rel=1e-6)


def test_particles_read_back_as_a_mesh(tmp_path: Path, motion: Trajectory) -> None:
    write_particles(motion, tmp_path)
    mesh = read_mesh(tmp_path / "particles" / "000000000100.vtp")
    np.testing.assert_array_equal(mesh.points, motion.x[3])


BOMB = b"""<?xml version="1.0"?>
<!DOCTYPE x [<!ENTITY a "0 0 0"><!ENTITY b "&a;&a;&a;&a;">]>
<VTKFile type="PolyData"><PolyData><Piece NumberOfPoints="1"><Points><DataArray type="Float64"
NumberOfComponents="3" format="ascii">&a;</DataArray></Points></Piece></PolyData></VTKFile>
"""


@pytest.mark.parametrize("suffix", [".vtp", ".vtu", ".vtk"])
@pytest.mark.parametrize(
    "data",
    [
        BOMB,
        b"\xef\xbb\xbf\n " + BOMB,
        BOMB.replace(b"<!DOCTYPE", b"<!--" + b" " * (1 << 20) + b"--><!DOCTYPE"),
        BOMB.decode().encode("utf-16"),
        BOMB.decode().encode("utf-16-le"),
        BOMB.decode().encode("utf-16-be"),
    ],
    ids=["plain", "mark", "far", "utf-16", "utf-16-le", "utf-16-be"],
)
def test_document_types_are_refused(tmp_path: Path, suffix: str, data: bytes) -> None:
    path = tmp_path / f"bomb{suffix}"
    path.write_bytes(data)
    with pytest.raises(ReadError, match=r"DOCTYPE|16-bit"):
        read_mesh(path)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        *((name, b"nonsense\n") for name in ("a.vtp", "a.vtk", "a.vtu", "a.stl", "a.msh", "a.unknown", "a", "a.xdmf")),
        *((name, data) for name in ("a.vtk", "a.stl") for data in (b"", b"\x00\x01\x02")),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, name: str, data: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(ReadError) as caught:
        read_mesh(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("part", [0.3, 0.6, 0.9])
def test_truncated_files_are_refused(tmp_path: Path, motion: Trajectory, part: float) -> None:
    write_particles(motion, tmp_path)
    path = tmp_path / "particles" / "000000000000.vtp"
    data = path.read_bytes()
    path.write_bytes(data[: int(part * len(data))])
    with pytest.raises(ReadError):
        read_mesh(path)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="No such file"):
        read_mesh(tmp_path / "none.vtp")


def test_walls_move_from_frame_to_frame_and_go_when_they_are_taken_away(tmp_path: Path) -> None:
    """A plate turns by a quarter between frames, a disc stays and is taken away; particles that left are not drawn."""
    import pyvista

    plate = PlateWall(
        shape="plate",
        corner=(0.0, 0.0, 0.0),
        edge_1=(1.0, 0.0, 0.0),
        edge_2=(0.0, 0.0, 1.0),
        motion=(Rotation(kind="rotate", axis=(0.0, 0.0, 1.0), period=4.0),),
    )
    disc = DiscWall(shape="disc", centre=(0.0, 0.0, -1.0), radius=1.0, remove_at=1.5)
    far = np.array([-9.0, -9.0, -9.0]), np.array([9.0, 9.0, 9.0])
    x = np.zeros((3, 2, 3))
    x[2, 1] = np.nan
    series: Any = SimpleNamespace(
        facts=SimpleNamespace(radii=(0.5, 0.25)),
        t_frame=np.array([0.0, 1.0, 2.0]),
        frame_coupling=np.array([0, 1, 2]),
        eps_g=(),
        x=x,
        v=x,
        spin=x,
        kind=np.array([[0, 1], [0, 1], [0, -1]], dtype=np.int16),
    )
    walls = {"plate": plate, "disc": disc}
    path = write_paraview(series, tmp_path, lambda t: walls_at(walls, t, 0.5, path_of=Path, extent=far, radius=0.1))
    reader = pyvista.get_reader(path)
    ends = {0: [1.0, 0.0], 1: [0.0, 1.0], 2: [-1.0, 0.0]}
    for number, end in ends.items():
        reader.set_active_time_point(number)
        blocks = reader.read()
        particles, drawn = blocks[0], blocks[1]
        np.testing.assert_allclose(
            drawn.bounds[:4], np.sort([[0.0, end[0]], [0.0, end[1]]], axis=1).ravel(), atol=1e-12
        )
        assert blocks.n_blocks == (2 if number == 2 else 3)
        np.testing.assert_array_equal(particles.point_data["radius"], [0.5] if number == 2 else [0.5, 0.25])
    assert len(list((tmp_path / "walls" / "disc").iterdir())) == 1
