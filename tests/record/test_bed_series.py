"""What is written piece by piece is read back whole, also after a death in the middle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from bed_runs import facts

from kncal.core.errors import InputError, ReadError
from kncal.record.facts import HEIGHTS
from kncal.record.series import UNITS, SeriesWriter, read_series, write_series_csv
from kncal.record.steps import DemStep, GasFields, GasStep, ParticleState

SMALL = facts(
    count=20,
    cells=(3, 2, 4),
    histogram_edges=(0.0, 1e-6, 1e-5, 1e-4),
    impact_edges=(0.0, 0.1, 1.0),
    outlets=("below",),
    walls=("hopper",),
)


def state(number: int) -> ParticleState:
    rng = np.random.default_rng(number)
    x, v, spin = rng.random((20, 3)) * SMALL.size, rng.normal(size=(20, 3)), rng.normal(size=(20, 3))
    return ParticleState(x, v, spin, np.zeros(20, dtype=np.int64))


def steps(number: int) -> tuple[GasStep, DemStep]:
    force = np.full((20, 3), 1e-4 * number)
    gas = GasStep(
        force=force,
        p_in=10.0 * number,
        reaction_error=1e-12 * SMALL.weight,
        not_passed=2e-6 * SMALL.weight,
        solids_error=1e-15,
        eps_g_min=0.4,
        courant_max=0.3,
    )
    dem = DemStep(
        floor_force=0.1,
        other_walls_force=-0.02,
        contacts=7.5,
        overlap_max=3e-6,
        overlap_mean=1e-6,
        histogram=np.array([number, 2, 1]),
        watched=1e-5,
        impacts=np.array([[number, 0], [1, 2]]),
        impact_sums=np.full((2, 3), 0.1 * number),
        out_number=np.array([number]),
        out_mass=np.array([1e-3 * number]),
        wall_force=np.full((1, HEIGHTS, 3), 0.5 * number),
    )
    return gas, dem


def fields(number: int) -> GasFields:
    return GasFields(
        eps_g=np.full((4, 2, 3), 0.5), p=np.full((4, 2, 3), float(number)), U=np.full((4, 2, 3, 3), 0.1 * number)
    )


def write(writer: SeriesWriter, first: int, last: int, every: int = 2) -> None:
    for number in range(first, last + 1):
        writer.add(number, 0.5, *steps(number), state(number))
        if number % every == 0:
            writer.frame(number, state(number), fields(number))


@pytest.mark.parametrize(("name", "value"), [("PIECE_SECONDS", -1.0), ("PIECE_BYTES", 0)])
def test_a_piece_never_ends_between_a_coupling_and_its_frame(tmp_path, monkeypatch, name, value):
    monkeypatch.setattr(f"kncal.record.series.{name}", value)
    with SeriesWriter(tmp_path / "series", SMALL) as writer:
        write(writer, 1, 7)
    assert len(list((tmp_path / "series").glob("piece-*.npz"))) == 7
    found = read_series(tmp_path / "series")
    np.testing.assert_array_equal(found.coupling, np.arange(1, 8))
    np.testing.assert_array_equal(found.frame_coupling, [2, 4, 6])


def test_everything_comes_back(tmp_path):
    with SeriesWriter(tmp_path / "series", SMALL) as writer:
        write(writer, 1, 5)
        writer.flush()
        write(writer, 6, 8)
    found = read_series(tmp_path / "series")
    assert found.facts == SMALL
    np.testing.assert_array_equal(found.coupling, np.arange(1, 9))
    np.testing.assert_allclose(found.t, 1e-3 * np.arange(1, 9))
    np.testing.assert_array_equal(found.p_in, 10.0 * np.arange(1, 9))
    np.testing.assert_allclose(found.drag_z, 20 * 1e-4 * np.arange(1, 9))
    np.testing.assert_allclose(found.reaction_error, 1e-12)
    np.testing.assert_allclose(found.not_passed, 2e-6)
    np.testing.assert_array_equal(found.walls, -0.02)
    np.testing.assert_array_equal(found.histogram[:, 0], np.arange(1, 9))
    np.testing.assert_array_equal(found.impacts[:, 0, 0], np.arange(1, 9))
    np.testing.assert_allclose(found.impact_sums[:, 1, 2], 0.1 * np.arange(1, 9))
    np.testing.assert_array_equal(found.watched, 1e-5)
    np.testing.assert_array_equal(found.out_number[:, 0], np.arange(1, 9))
    np.testing.assert_allclose(found.out_mass[:, 0], 1e-3 * np.arange(1, 9))
    np.testing.assert_allclose(found.wall_force[:, 0, 3, 2], 0.5 * np.arange(1, 9))
    mass = SMALL.density * np.pi / 6.0 * SMALL.diameter**3
    for row, number in enumerate(range(1, 9)):
        x, v, spin = state(number).x, state(number).v, state(number).spin
        inertia = 0.4 * mass * (0.5 * SMALL.diameter) ** 2
        assert found.kinetic_rotation[row] == pytest.approx(0.5 * inertia * (spin**2).sum())
        assert found.kinetic_energy[row] == pytest.approx(0.5 * mass * (v**2).sum())
        assert found.momentum_z[row] == pytest.approx(mass * v[:, 2].sum())
        assert found.z_mean[row] == pytest.approx(x[:, 2].mean())
        assert found.z_95[row] == np.sort(x[:, 2])[18]  # 19 of 20 do not exceed it
    np.testing.assert_array_equal(found.frame_coupling, [2, 4, 6, 8])
    np.testing.assert_array_equal(found.x[2], state(6).x.astype(np.float32))
    np.testing.assert_array_equal(found.v[2], state(6).v.astype(np.float32))
    np.testing.assert_array_equal(found.spin[2], state(6).spin.astype(np.float32))
    np.testing.assert_array_equal(found.kind[2], 0)
    np.testing.assert_array_equal(found.p[3], np.full((4, 2, 3), 8.0))
    assert found.U.shape == (4, 4, 2, 3, 3)


def test_a_run_that_dies_keeps_what_was_flushed(tmp_path):
    writer = SeriesWriter(tmp_path, SMALL)
    write(writer, 1, 4)
    writer.flush()
    write(writer, 5, 6)  # never flushed: the process is gone
    (tmp_path / "piece-00001.part").write_bytes(b"half a piece")
    found = read_series(tmp_path)
    np.testing.assert_array_equal(found.coupling, [1, 2, 3, 4])
    np.testing.assert_array_equal(found.frame_coupling, [2, 4])


def test_a_resumed_run_replaces_what_it_computes_anew(tmp_path):
    with SeriesWriter(tmp_path, SMALL) as writer:
        write(writer, 1, 3)
        writer.flush()
        write(writer, 4, 7)
    with SeriesWriter(tmp_path, SMALL) as again:  # the checkpoint was after 4
        for number in range(5, 10):
            again.add(number, 0.5, *steps(number), state(100 + number))
            if number % 2 == 0:
                again.frame(number, state(100 + number), fields(number))
    found = read_series(tmp_path)
    np.testing.assert_array_equal(found.coupling, np.arange(1, 10))
    np.testing.assert_array_equal(found.frame_coupling, [2, 4, 6, 8])
    assert found.z_mean[3] == pytest.approx(state(4).x[:, 2].mean())
    assert found.z_mean[4] == pytest.approx(state(105).x[:, 2].mean())
    np.testing.assert_array_equal(found.x[2], state(106).x.astype(np.float32))


def test_without_gas_or_motion_numbers_are_missing_not_made_up(tmp_path):
    dry = replace(SMALL, gas_density=0.0)
    with SeriesWriter(tmp_path / "dry", dry) as writer:
        writer.frame(0, state(0), None)
        writer.add(1, 0.0, None, steps(1)[1], state(0))
    found = read_series(tmp_path / "dry")
    assert (found.p_in[0], found.drag_z[0]) == (0.0, 0.0)
    assert np.isnan([found.eps_g_min[0], found.reaction_error[0]]).all()
    assert found.x.shape == (1, 20, 3)
    assert found.eps_g.shape == (0, 4, 2, 3)
    with SeriesWriter(tmp_path / "frozen", SMALL) as writer:
        writer.add(1, 0.5, steps(1)[0], None, state(0))
    still = read_series(tmp_path / "frozen")
    assert np.isnan([still.floor[0], still.contacts[0], still.overlap_max[0]]).all()
    assert still.p_in[0] == 10.0


def test_particles_that_are_not_there_count_for_nothing(tmp_path):
    mixed = replace(SMALL, groups=("small", "large"), radii=(1e-3, 2e-3), masses=(1e-6, 8e-6), numbers=(12, 8))
    one = state(0)
    kind = np.array([0] * 5 + [1] * 3 + [-1] * 12)
    for part in (one.x, one.v, one.spin):
        part[8:] = np.nan
    with SeriesWriter(tmp_path, mixed) as writer:
        writer.frame(0, one._replace(kind=kind), None)
        writer.add(1, 0.0, None, steps(1)[1], one._replace(kind=kind))
    found, mass = read_series(tmp_path), np.array([1e-6] * 5 + [8e-6] * 3)
    assert (found.number[0], found.mass[0]) == (8.0, pytest.approx(29e-6))
    assert found.weight[0] == pytest.approx(29e-6 * 9.81)
    assert found.momentum_z[0] == pytest.approx(mass @ one.v[:8, 2])
    assert found.kinetic_energy[0] == pytest.approx(0.5 * mass @ (one.v[:8] ** 2).sum(axis=1))
    radii = np.array([1e-3] * 5 + [2e-3] * 3)
    assert found.kinetic_rotation[0] == pytest.approx(0.2 * (mass * radii**2) @ (one.spin[:8] ** 2).sum(axis=1))
    np.testing.assert_array_equal(found.kind[0], kind)
    assert np.isnan(found.x[0][8:]).all() and np.isfinite(found.x[0][:8]).all()


def test_heights_are_along_up():
    tilted = replace(SMALL, low=(-1.0, 0.0, 0.5), size=(2.0, 1.0, 1.0), up=(0.6, 0.0, 0.8))
    assert tilted.heights[[0, -1]] == pytest.approx([-0.6 + 0.4, 0.6 + 1.2])
    assert len(tilted.heights) == HEIGHTS + 1


@pytest.mark.parametrize("index", [0, -1, slice(1, 3), [2, 0], np.array([True, False, True, True]), (1, 2), (..., 2),
                                   (slice(None), [0, 3]), slice(2, 2)])  # fmt: skip
def test_frames_on_the_disk_are_indexed_as_arrays(tmp_path, index):
    with SeriesWriter(tmp_path, SMALL) as writer:
        write(writer, 1, 5)
        writer.flush()
        write(writer, 6, 8)
    x = read_series(tmp_path).x
    whole = np.asarray(x)
    assert whole.shape == x.shape == (4, 20, 3)
    np.testing.assert_array_equal(x[index], whole[index])
    assert x[index].dtype == np.float32
    np.testing.assert_array_equal(list(x), whole)
    np.testing.assert_array_equal(x > 0.5, whole > 0.5)
    np.testing.assert_array_equal(2.0 * x, 2.0 * whole)


def test_refuses_to_mix_two_runs(tmp_path):
    SeriesWriter(tmp_path, SMALL).close()
    with pytest.raises(InputError, match="kind differ"):
        SeriesWriter(tmp_path, replace(SMALL, kind="hertz"))


def test_damage_is_named(tmp_path):
    with pytest.raises(ReadError, match=r"facts\.json"):
        read_series(tmp_path)
    SeriesWriter(tmp_path, SMALL).close()
    with pytest.raises(ReadError, match="no piece"):
        read_series(tmp_path)
    with SeriesWriter(tmp_path, SMALL) as writer:
        write(writer, 1, 3)
        writer.flush()
        write(writer, 4, 6)
    piece = tmp_path / "piece-00000.npz"
    whole = piece.read_bytes()
    piece.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ReadError, match="piece-00000"):
        read_series(tmp_path)
    piece.unlink()
    with pytest.raises(ReadError, match="coupling 1 is missing"):
        read_series(tmp_path)


def test_pickled_objects_are_not_loaded(tmp_path):
    SeriesWriter(tmp_path, SMALL).close()
    np.savez(tmp_path / "piece-00000.npz", rows=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ReadError, match="piece-00000"):
        read_series(tmp_path)


def test_wrong_shapes_are_named(tmp_path):
    SeriesWriter(tmp_path, SMALL).close()
    np.savez(tmp_path / "piece-00000.npz", rows=np.zeros((2, 3)))
    with pytest.raises(ReadError, match="rows is float64"):
        read_series(tmp_path)


def test_csv_has_units_and_all_digits(tmp_path):
    with SeriesWriter(tmp_path, SMALL) as writer:
        write(writer, 1, 4)
    found = read_series(tmp_path)
    write_series_csv(tmp_path / "series.csv", found)
    assert "p_in [Pa]" in (tmp_path / "series.csv").read_text().splitlines()[0]
    table = pd.read_csv(tmp_path / "series.csv", comment="#")
    assert list(table.columns) == list(UNITS)
    np.testing.assert_array_equal(table["kinetic_energy"], found.kinetic_energy)
