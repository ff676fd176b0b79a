"""The gas on two ranks of the real DPMFoam: the same as on one, as far as its linear solvers go."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from threading import Event

import gas_columns as columns
import numpy as np
import pytest

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.core.shipped import folder as shipped_folder
from kncal.core.stopping import stoppable
from kncal.engines.coupled import Coupled
from kncal.engines.dpmfoam.case import write_case
from kncal.engines.dpmfoam.decomposed import TOLERANCE, divisions
from kncal.engines.dpmfoam.grid import Grid
from kncal.engines.dpmfoam.restart import RestartGas
from kncal.record.openfoam import read_cells, write_parcel_constants, write_parcel_motion
from kncal.record.series import read_series
from kncal.runs.folder import read_manifest
from kncal.runs.workflow import run_case
from kncal.scene.case_file import load_case

pytestmark = [
    *columns.needs_openfoam,
    pytest.mark.skipif(
        shutil.which("mpirun") is None, reason="Open MPI is not installed (apt-get install openmpi-bin)"
    ),
]

#: Both solutions leave a normalised residual of TOLERANCE at most, so each pressure is off by about that share of the
#: pressure drop (see `kncal.engines.dpmfoam.decomposed`); the norm is a few times the gas that flows through. The
#: forces follow from the velocities, whose own tolerance is a tenth of it.
BOUND = 10.0 * TOLERANCE


def far(one: Array, two: Array) -> float:
    """Largest difference, as a share of the largest value."""
    return float(np.abs(one - two).max() / np.abs(one).max())


def test_bound_is_that_of_the_rendered_case() -> None:
    text = (shipped_folder("templates") / "openfoam" / "system" / "fvSolution.j2").read_text()
    found = re.search(r'"p\.\*".* tolerance ([^;]+); relTol 0;', text)
    assert found is not None
    assert float(found[1]) == TOLERANCE


def test_cuts_are_across_one_axis_and_never_across_the_depth() -> None:
    assert divisions((10, 2, 30), 1) == (1, 1, 1)
    assert divisions((10, 2, 30), 5) == (5, 1, 1)  # two layers each
    assert divisions((10, 2, 30), 6) == (1, 1, 6)
    assert divisions((10, 2, 30), 30) == (1, 1, 30)
    with pytest.raises(InputError, match="at most 30"):
        divisions((10, 2, 30), 31)


@pytest.mark.parametrize(
    ("cells", "front_back", "particles"),
    [((5, 2, 15), "periodic", True), ((3, 2, 15), "walls", True), ((5, 2, 15), "walls", False)],
    ids=["cut across x, periodic", "cut across z", "gas alone"],
)
def test_two_ranks_give_the_forces_and_the_pressure_of_one(cells, front_back, particles, tmp_path: Path) -> None:
    given = columns.setup(cells, front_back=front_back)
    x = columns.packing((*given.size[:2], 0.6 * given.size[2])) if particles else np.zeros((0, 3))
    folders = [tmp_path / "on 1 rank", tmp_path / "on 2 ranks"]  # such names are what OpenFOAM refuses
    steps, fields = [], []
    for ranks, folder in enumerate(folders, start=1):
        gas = RestartGas(given, folder, ranks=ranks, oversubscribe=True)
        for _ in range(2):  # the second starts from what was put together after the first
            steps.append(gas.step(x, np.zeros_like(x), *columns.alike(x)))
        fields.append(gas.fields())
    for one, two in zip(steps[:2], steps[2:], strict=True):
        assert two.p_in == pytest.approx(one.p_in, rel=BOUND)
        if particles:
            assert far(one.force, two.force) <= BOUND
            # what is booked twice agrees on any number of ranks
            assert two.reaction_error <= 1e-10 * columns.weight(x)
            assert two.solids_error < 1e-12
    one, two = fields
    assert np.abs(one.eps_g - two.eps_g).max() < 1e-14
    assert far(one.p, two.p) <= BOUND
    assert far(one.U, two.U) <= BOUND
    assert "nProcs : 2" in (folders[1] / "log.DPMFoam").read_text()
    assert not [path for path in tmp_path.rglob("*") if path.is_symlink()]  # a run that goes on refuses links


def test_a_state_goes_on_with_another_number_of_ranks(tmp_path: Path) -> None:
    given, none = columns.setup(), np.zeros((0, 3))
    serial = RestartGas(given, tmp_path / "serial")
    wanted = [serial.step(none, none, none[:, 0], none[:, 0]).p_in for _ in range(2)][-1]
    before = RestartGas(given, tmp_path / "two", ranks=2, oversubscribe=True)
    before.step(none, none, none[:, 0], none[:, 0])
    before.save(tmp_path / "state")
    after = RestartGas(given, tmp_path / "three", ranks=3, oversubscribe=True)
    after.load(tmp_path / "state")
    assert after.step(none, none, none[:, 0], none[:, 0]).p_in == pytest.approx(wanted, rel=BOUND)


def test_allrun_by_hand_takes_the_parcels_along(tmp_path: Path) -> None:
    given = columns.setup()
    x = columns.packing((*given.size[:2], 0.6 * given.size[2]))
    inside, cell = Grid(given).locate(x)
    end = f"{2 * given.step:.9g}"
    pressures = []
    for ranks in (1, 2):
        folder = tmp_path / f"by hand $HOME #{ranks}"
        write_case(given, folder, end_time=2 * given.step, write_interval=2, ranks=ranks, oversubscribe=True)
        write_parcel_constants(folder / "0", *columns.alike(x), np.ones(len(x)))
        write_parcel_motion(folder / "0", inside, cell, np.zeros_like(x))
        done = subprocess.run(
            [str(folder / "Allrun")],
            cwd="/",
            env={"PATH": "/usr/bin:/bin"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        log = (folder / "log.DPMFoam").read_text()
        assert f"nProcs : {ranks}" in log
        assert re.findall(r"Current number of parcels += (\d+)", log) == 2 * [str(len(x))]
        pressures.append(read_cells(folder / end / "p", int(np.prod(given.cells))))
        assert not list(folder.glob("processor*"))
    # the parcels of two starts move on by themselves: the difference of the first step passes into the second
    assert far(*pressures) <= 2 * BOUND


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_gas_step_that_is_stopped_counts_as_interrupted(ranks: int, tmp_path: Path) -> None:
    given, none, event = columns.setup(), np.zeros((0, 3)), Event()
    gas = RestartGas(given, tmp_path, ranks=ranks, oversubscribe=True)
    event.set()
    with stoppable(event), pytest.raises(KeyboardInterrupt):
        gas.step(none, none, none[:, 0], none[:, 0])


def test_a_frozen_bed_runs_on_two_ranks_from_its_case_to_its_series(tmp_path: Path) -> None:
    scene = load_case("packed_bed")
    scene = scene.with_group(count=400, place="lattice")
    scene = replace(scene, run=replace(scene.run, until_time=1e-3, frames_every=1e-3), tolerances={})
    series = []
    for ranks in (1, 2):
        out = tmp_path / str(ranks)
        results = run_case(scene, Coupled("restart", ranks=ranks, oversubscribe=True), out, ("linear",))
        assert results["linear"].status == "completed", results
        assert read_manifest(out / "linear")["ranks"] == ranks
        series.append(read_series(out / "linear" / "series"))
    one, two = series
    assert len(one.t) == 2
    assert far(one.p_in, two.p_in) <= BOUND
    assert far(one.drag_z, two.drag_z) <= BOUND
