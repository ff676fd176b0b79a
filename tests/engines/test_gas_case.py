"""The case folder: what is in it, and the mesh that blockMesh makes of it."""

from __future__ import annotations

import re
from pathlib import Path

import gas_columns as columns
import numpy as np
import pytest

from kncal.core.errors import RenderError, RunError
from kncal.engines.base import GasSetup
from kncal.engines.dpmfoam.case import write_case
from kncal.engines.dpmfoam.grid import Grid
from kncal.engines.dpmfoam.programs import make_mesh
from kncal.engines.dpmfoam.restart import RestartGas
from kncal.scene.gas import Jet

SETUPS = {
    "floor": columns.setup((3, 2, 4)),
    "periodic": columns.setup((4, 3, 2), front_back="periodic"),
    "layer": columns.setup((6, 1, 4), front_back="layer", walls="noSlip"),
    "jet": columns.setup((7, 2, 3), jet=Jet(x_low=6e-3, x_high=12e-3, velocity=3.0), inlet=0.0),
    "jet at a side": columns.setup((5, 1, 3), jet=Jet(x_low=0.0, x_high=6e-3, velocity=3.0), inlet=0.0),
    "jet all over": columns.setup((2, 1, 3), jet=Jet(x_low=0.0, x_high=6e-3, velocity=3.0), inlet=0.0),
    "odd sizes": columns.setup((7, 3, 5), size=(0.1, 0.033, 0.27)),
}


def test_a_case_is_complete_readable_and_written_once(tmp_path: Path) -> None:
    setup = SETUPS["jet"]
    folder = tmp_path / "gas"
    write_case(setup, folder, end_time=0.1, write_interval=7, functions='libs ("libx.so");')
    names = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert names == {
        *("system/blockMeshDict", "system/controlDict", "system/fvSchemes", "system/fvSolution"),
        *("constant/g", "constant/transportProperties", "constant/turbulenceProperties.air"),
        *("constant/kinematicCloudProperties", "0/U.air", "0/p", "0/alpha.air", "0/alpha.air_0"),
        *("Allrun", "case.foam"),
    }
    assert (folder / "Allrun").stat().st_mode & 0o111
    for name in names - {"Allrun", "case.foam"}:
        text = (folder / name).read_text("ascii")
        assert f"object {name.rpartition('/')[2]};" in text.splitlines()[0]
        code = re.sub(r"//.*", "", text)
        assert code.count("{") == code.count("}") and code.count("(") == code.count(")")
        for word in re.findall(r"[A-Za-z](?=\()", code):  # a word that a bracket would become part of
            assert name == "system/fvSchemes", (name, word)
        assert not re.search(r"\{\{|\}\}|\{%|<#|None|\bnan\b", text)
    control = (folder / "system/controlDict").read_text()
    assert "endTime 0.1;" in control and "writeInterval 7;" in control and 'libs ("libx.so");' in control
    with pytest.raises(RenderError, match="holds something else"):
        write_case(setup, folder, end_time=0.1)
    with pytest.raises(RenderError, match="finite number"):
        write_case(setup, tmp_path / "other", end_time=float("nan"))
    assert not (tmp_path / "other").exists()


def test_numbers_keep_every_bit(tmp_path: Path) -> None:
    setup = columns.setup(inlet=1.0 / 3.0, step=1e-4 / 3.0, density=1.2000000000000002)
    write_case(setup, tmp_path, end_time=setup.step)
    assert f"deltaT {setup.step!r};" in (tmp_path / "system/controlDict").read_text()
    assert f"inletVelocity uniform (0 0 {setup.inlet!r});" in (tmp_path / "0/U.air").read_text()
    assert "rho.air 1.2000000000000002;" in (tmp_path / "constant/transportProperties").read_text()


@pytest.mark.solver
@pytest.mark.parametrize("setup", SETUPS.values(), ids=SETUPS.keys())
def test_the_mesh_is_the_grid(setup: GasSetup, tmp_path: Path) -> None:
    write_case(setup, tmp_path / "gas", end_time=setup.step)
    assert make_mesh(tmp_path / "gas") > 0.0
    blocks = columns.read_case(tmp_path / "gas")
    mesh, grid = blocks["internalMesh"], Grid(setup)
    assert mesh.n_cells == grid.count
    _, cell = grid.locate(np.array(mesh.cell_centers().points, dtype=float))
    assert cell.tolist() == list(range(grid.count))  # the solver's own labels
    bounds = np.reshape(mesh.bounds, (3, 2))
    assert bounds == pytest.approx(np.stack([np.zeros(3), grid.size], axis=1), rel=1e-6, abs=1e-9)
    volumes = mesh.compute_cell_sizes(length=False, area=False)["Volume"]
    assert volumes == pytest.approx(np.full(grid.count, grid.volume), rel=1e-5)
    inlet = np.reshape(blocks["boundary"]["inlet"].bounds, (3, 2))
    slot = (0.0, setup.size[0]) if setup.jet is None else (setup.jet.x_low, setup.jet.x_high)
    assert inlet == pytest.approx(np.array([slot, (0.0, setup.size[1]), (0.0, 0.0)]), rel=1e-6, abs=1e-9)
    assert blocks["boundary"]["inlet"].n_cells == grid.inlet_faces
    assert np.ptp(np.array(blocks["boundary"]["outlet"].points)[:, 2]) == 0.0
    if setup.front_back == "layer":
        assert blocks["boundary"]["front_back"].n_cells == 2 * grid.count


@pytest.mark.solver
def test_parcels_and_fields_are_read_for_users(tmp_path: Path) -> None:
    setup = columns.setup((3, 2, 6))
    folder = tmp_path / "gas"
    gas = RestartGas(setup, folder)
    x = columns.packing((0.009, 0.006, 0.009))
    gas.step(x, 0 * x, *columns.alike(x))
    blocks = columns.read_case(folder)
    assert blocks["internalMesh"].cell_data["U.air"].shape == (36, 3)
    # VTK keeps single precision
    assert grid_order(blocks["internalMesh"].cell_data["p"], setup) == pytest.approx(
        gas.fields().p.ravel() / setup.density, rel=1e-5
    )
    assert grid_order(blocks["internalMesh"].cell_data["alpha.air"], setup) == pytest.approx(
        gas.fields().eps_g.ravel(), rel=1e-6
    )
    assert blocks["lagrangian"]["kinematicCloud"].n_points == len(x)


def grid_order(values: np.ndarray, setup: GasSetup) -> np.ndarray:
    """Cell values of a mesh of one block, x fastest, as the solver counts."""
    return np.asarray(values)[Grid(setup).labels.ravel()]


@pytest.mark.solver
def test_a_mesh_that_cannot_be_made_says_why(tmp_path: Path) -> None:
    write_case(columns.setup(), tmp_path / "gas", end_time=1.0)
    path = tmp_path / "gas" / "system" / "blockMeshDict"
    path.write_text(path.read_text().replace("hex (0 1", "hex (0 77"))
    with pytest.raises(
        RunError, match=r"exit code 1: --> FOAM FATAL IO ERROR.*label 77 out of range.*see .*log\.blockMesh"
    ):
        make_mesh(tmp_path / "gas")
