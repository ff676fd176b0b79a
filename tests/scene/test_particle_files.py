"""Particles from files of others: what was written is read; what no particle can be is refused with file and line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kncal.core.errors import InputError, ReadError
from kncal.scene.particle_files import read_particles
from kncal.scene.sizes import MOST_CLASSES, half_width

X = np.array([[0.1, 0.2, 0.3], [1e-3, -2e-3, 3.5e-3], [0.0, 1.0 / 3.0, 5e-8]])
V = np.array([[0.0, 0.0, -1.0], [0.5, 0.25, 0.0], [1e-9, 2.0, 3.0]])
SPIN = 10.0 * V[::-1]
D = np.array([2e-3, 2e-3, 3e-3])


def row(*values: float) -> str:
    return " ".join(f"{value:.17g}" for value in values)


def csv(path: Path) -> Path:
    rows = [row(*x, d, *v).replace(" ", ",") for x, d, v in zip(X, D, V, strict=True)]
    path.write_text("\n".join(["x,y,z,diameter,vx,vy,vz", *rows]) + "\n", encoding="ascii")
    return path


def dump(path: Path) -> Path:
    head = "ITEM: TIMESTEP\n{}\nITEM: NUMBER OF ATOMS\n3\nITEM: BOX BOUNDS ff ff ff\n0 1\n0 1\n0 1\n"
    head += "ITEM: ATOMS id type x y z radius vx vy vz omegax omegay omegaz \n"
    rows = [f"{i} 1 {row(*X[i - 1], D[i - 1] / 2, *V[i - 1], *SPIN[i - 1])} \n" for i in (3, 1, 2)]
    first = [f"{i} 1 {row(*[9.0] * 10)} \n" for i in (1, 2, 3)]
    path.write_text(head.format(0) + "".join(first) + head.format(10) + "".join(rows), encoding="ascii")
    return path


def data(path: Path) -> Path:
    lines = ["a title", "", "3 atoms", "1 atom types", "0 1 xlo xhi", "0 1 ylo yhi", "0 1 zlo zhi", "", "Atoms", ""]
    lines += [f"{i} 1 {row(D[i - 1], 2500.0, *X[i - 1])}" for i in (2, 3, 1)]
    lines += ["", "Velocities", "", *(f"{i} {row(*V[i - 1], *SPIN[i - 1])}" for i in (3, 1, 2))]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def points(path: Path) -> Path:
    import pyvista

    mesh = pyvista.PolyData(X)
    mesh.point_data["radius"], mesh.point_data["velocity"], mesh.point_data["spin"] = 0.5 * D, V, SPIN
    mesh.save(path)
    return path


@pytest.mark.parametrize(
    ("write", "name", "spins"), [(csv, "a.csv", False), (dump, "dump.liggghts", True), (data, "a.data", True)]
)
def test_what_was_written_is_read(tmp_path: Path, write, name: str, spins: bool) -> None:
    found = read_particles(write(tmp_path / name))
    assert np.array_equal(found.x, X)
    assert np.array_equal(found.v, V)
    assert np.array_equal(found.spin, SPIN if spins else 0.0 * SPIN)
    assert np.array_equal(found.diameter, D)


@pytest.mark.slow
def test_points_of_vtk(tmp_path: Path) -> None:
    found = read_particles(points(tmp_path / "a.vtp"), scale=1e-3)
    assert found.x == pytest.approx(1e-3 * X)
    assert found.diameter == pytest.approx(1e-3 * D)
    assert np.array_equal(found.v, V)  # a scale is of lengths in the file, not of speeds
    assert np.array_equal(found.spin, SPIN)


def test_few_diameters_stay_many_become_classes(tmp_path: Path) -> None:
    made, kind = read_particles(csv(tmp_path / "a.csv")).classes(0.02, 0.5)
    assert made.diameters.tolist() == [2e-3, 3e-3]
    assert kind.tolist() == [0, 0, 1]
    many = np.random.default_rng(1).lognormal(np.log(1e-3), 0.2, 2000)
    text = "".join(f"0,0,{i}e-2,{d!r}\n" for i, d in enumerate(many.tolist()))
    (tmp_path / "b.csv").write_text(f"x,y,z,diameter\n{text}", encoding="ascii")
    made, kind = read_particles(tmp_path / "b.csv").classes(0.02, 0.5)
    assert made.diameters.size <= MOST_CLASSES
    assert np.sum(made.diameters[kind] ** 3) == pytest.approx(np.sum(many**3))  # mass
    assert np.max(np.abs(np.log(many / made.diameters[kind]))) <= half_width(0.02, 0.5)


def test_classes_need_diameters(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y,z\n0,0,0\n", encoding="ascii")
    with pytest.raises(InputError, match="diameter"):
        read_particles(tmp_path / "a.csv").classes(0.02, 0.5)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x,y,z\n0,0,0\n1,2\n", "line 3"),
        ("x,y,z\n\n0,0,1e999\n", "line 3"),
        ("x,y,z\n0,0,nan\n", "line 2"),
        ("x,y,z\n0,0,1_0\n", "line 2"),
        ("x,y,diamter\n0,0,1\n", "diameter"),
        ("x,y\n0,0\n", "z"),
        ("x,y,z,diameter\n0,0,0,0\n", "line 2"),
        ("x,y,z,vx\n0,0,0,0\n", "vy"),
        ("x,y,z,x\n0,0,0,0\n", "line 1"),
        ("x,y,z,id\n0,0,0,1\n0,0,1,1\n", "twice"),
        ("x,y,z\n", "no particles"),
        (
            "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n2\nITEM: BOX BOUNDS\n0 1\n0 1\n0 1\nITEM: ATOMS x y z\n1 2 3\n",
            "2",
        ),
        ("ITEM: TIMESTEP\n0\n", "line 1"),
        ("t\n2 atoms\n\nAtoms\n\n1 1 1e-3 2500 0 0 0\n", "2"),
        ("t\n1 atoms\n\nAtoms\n\n1 1 0 0 0\n", "line 6"),
        ("t\n1 atoms\n", "Atoms"),
    ],
)
def test_damage_is_told(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "bad.txt"
    path.write_text(text, encoding="ascii")
    with pytest.raises(ReadError, match=rf"bad\.txt.*{told}"):
        read_particles(path)
