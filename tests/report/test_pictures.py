"""What is drawn is what was given; animations and ParaView files hold every frame."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from bed_runs import bubbling, facts, series

from kncal.core.errors import InputError
from kncal.observe.averages import observe_bed
from kncal.record.paraview import write_paraview
from kncal.report import plots, style
from kncal.report.animation import animate, snapshot

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def runs():
    beds = {
        "linear": bubbling(facts(), 1, couplings=1500),
        "hertz": bubbling(facts(kind="hertz"), 2, couplings=1500, speed=0.25),
    }
    return {kind: observe_bed(bed, discard=0.5) for kind, bed in beds.items()}


def few(runs, frames: int = 4):
    """The series of both runs with a few frames only."""
    names = ("frame_coupling", "t_frame", "x", "v", "eps_g", "p", "U")
    return {
        kind: replace(seen.series, **{n: getattr(seen.series, n)[:frames] for n in names})
        for kind, seen in runs.items()
    }


def legend(ax) -> str:
    return " | ".join(text.get_text() for text in ax.get_legend().get_texts())


@pytest.mark.parametrize("name", plots.SIGNALS)
def test_signals_show_their_averages(runs, name):
    ax = plots.signal_time(runs, name)
    average = runs["hertz"].estimates[plots.SIGNALS[name][2]]
    factor = ax.get_lines()[2].get_ydata()[0] / getattr(runs["hertz"].series, name)[0]
    mean = next(line for line in ax.get_lines() if line.get_label().startswith("Hertz"))
    np.testing.assert_allclose(mean.get_ydata(), factor * average.value)
    np.testing.assert_allclose(mean.get_xdata(), [0.5, 1.5])
    assert ("not reliable" in mean.get_label()) == (not average.reliable)


def test_unknown_signal_is_refused(runs):
    with pytest.raises(InputError, match="z_mean"):
        plots.signal_time(runs, "z_meen")


def test_voidage_maps_show_both_and_their_difference(runs):
    figure = plots.voidage_maps(runs)
    images = [ax.get_images()[0] for ax in figure.axes if ax.get_images() and ax.get_title()]
    assert [image.axes.get_title() for image in images] == ["linear", "Hertz", "linear – Hertz"]
    linear, hertz = (observed.eps_g[:, 0, :] for observed in runs.values())
    np.testing.assert_array_equal(images[0].get_array(), linear)
    np.testing.assert_allclose(images[2].get_array(), linear - hertz)
    assert images[0].get_extent() == pytest.approx([0.0, 60.0, 0.0, 120.0])
    assert images[0].origin == "lower"
    other = bubbling(facts(cells=(12, 1, 24)), 1, couplings=300)
    with pytest.raises(InputError, match="same cells"):
        plots.voidage_maps({"linear": runs["linear"], "hertz": observe_bed(other, discard=0.0)})


def test_overlap_histogram_has_the_area_of_what_it_shows(runs):
    ax = plots.overlap_histogram(runs)
    density, edges, _ = ax.patches[0].get_data()
    overlaps = runs["linear"].overlaps
    drawn = 1.0 - overlaps.histogram[0] / overlaps.counted  # the bin that begins at zero has no place
    assert (density * np.diff(np.log10(edges))).sum() == pytest.approx(drawn)
    assert "mean 0.25 %" in legend(ax)  # 5 µm of 2 mm


def test_spectrum_names_the_frequency(runs):
    observed = runs["linear"]
    ax = plots.pressure_spectra(runs)
    assert f"linear: {observed.spectrum.dominant:.3g}" in legend(ax)
    np.testing.assert_array_equal(ax.get_lines()[0].get_ydata(), observed.spectrum.density[1:])


def test_profiles_and_bubbles(runs):
    ax = plots.velocity_profiles(runs, 0.03)
    x, v_z = ax.get_lines()[0].get_data()
    assert np.mean(v_z[np.abs(x - 30.0) < 15.0]) == pytest.approx(0.1, abs=0.02)
    ax = plots.bubble_rise(runs)
    assert np.median(ax.get_lines()[0].get_ydata()) == pytest.approx(0.2, rel=0.05)
    assert "single bubble" in legend(ax)


def test_pictures_without_gas_are_empty_not_broken(tmp_path):
    dry = series(facts(gas_density=0.0), 300, floor=np.ones(300))
    runs = {"linear": observe_bed(dry)}
    for ax in (plots.signal_time(runs, "p_in"), plots.overlap_histogram(runs), plots.pressure_spectra(runs)):
        assert style.save(ax, tmp_path, "empty")[0].stat().st_size > 0
    with pytest.raises(InputError, match="void fraction"):
        plots.voidage_maps(runs)


def test_gif_plays_every_frame(runs, tmp_path):
    from PIL import Image

    path = animate(few(runs), tmp_path / "bed.gif", seconds=2.0)
    with Image.open(path) as gif:
        assert gif.n_frames == 4
        assert gif.info["duration"] == 500
        pictures_seen = []
        for frame in range(4):
            gif.seek(frame)
            pictures_seen.append(np.asarray(gif.convert("RGB")))
    assert all((a != b).any() for a, b in pairwise(pictures_seen))


def test_snapshot_shows_particles_where_they_are(tmp_path):
    """All particles but two in the upper left quarter of the panel: there are the coloured pixels."""
    from PIL import Image

    of = facts()
    x = np.random.default_rng(1).random((1, of.count, 3)) * [0.025, 0.01, 0.025] + [0.002, 0.0, 0.032]
    x[0, :2] = [[0.058, 0.005, 0.058], [0.002, 0.005, 0.002]]
    path = snapshot({"linear": series(of, 1, x=x, v=np.ones_like(x))}, 0.0, tmp_path / "snap.png")
    picture = np.asarray(Image.open(path).convert("HSV"))
    colour = picture[:, : int(0.82 * picture.shape[1]), 1] > 100  # without the colour bar
    rows, columns = np.nonzero(colour)
    assert len(rows) > 1000
    middle = (rows.min() + rows.max()) / 2.0, (columns.min() + columns.max()) / 2.0
    in_corner = (rows < middle[0] * 1.05) & (columns < middle[1] * 1.05)
    assert in_corner.mean() > 0.95


def test_long_runs_are_thinned(runs, tmp_path, monkeypatch):
    from PIL import Image

    monkeypatch.setattr("kncal.report.animation.MAX_FRAMES", 3)
    with Image.open(animate(few(runs, 7), tmp_path / "bed.gif", seconds=1.0)) as gif:
        assert gif.n_frames == 3


def test_animation_refusals(runs, tmp_path):
    with pytest.raises(InputError, match=r"\.gif"):
        animate(few(runs), tmp_path / "bed.avi")
    with pytest.raises(InputError, match="at least 2"):
        animate(few(runs, 1), tmp_path / "bed.gif")
    with pytest.raises(InputError, match="no frames"):
        animate(few(runs, 0), tmp_path / "bed.gif")


def test_mp4_with_the_extra_or_a_refusal_that_names_it(runs, tmp_path):
    path = tmp_path / "bed.mp4"
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        with pytest.raises(InputError, match=r"imageio\[ffmpeg\]"):
            animate(few(runs), path)
        return
    animate(few(runs), path)
    assert path.read_bytes()[4:8] == b"ftyp"


def test_paraview_opens_particles_and_gas_as_one_series(runs, tmp_path):
    import pyvista

    bed = few(runs, 3)["linear"]
    reader = pyvista.get_reader(write_paraview(bed, tmp_path / "paraview"))
    np.testing.assert_allclose(reader.time_values, bed.t_frame)
    reader.set_active_time_value(reader.time_values[1])
    particles, gas = reader.read()
    np.testing.assert_array_equal(particles.points, bed.x[1])
    np.testing.assert_array_equal(particles.point_data["velocity"], bed.v[1])
    np.testing.assert_allclose(particles.point_data["radius"], 1e-3)
    assert gas.bounds == pytest.approx((0.0, 0.06, 0.0, 0.01, 0.0, 0.12))
    # the cell that holds a point has the void fraction of that place
    nx, _, nz = bed.facts.cells
    for x, z in ((0.03, 0.02), (0.001, 0.1), (0.031, 0.055)):
        cell = gas.find_containing_cell((x, 0.005, z))
        assert gas.cell_data["eps_g"][cell] == bed.eps_g[1, int(z / 0.12 * nz), 0, int(x / 0.06 * nx)]


def test_paraview_without_gas(tmp_path):
    dry = series(facts(gas_density=0.0), 2, x=np.random.default_rng(1).random((2, 500, 3)))
    path = write_paraview(dry, tmp_path)
    assert sorted(p.name for p in (tmp_path / "particles").iterdir()) == ["000000001.vtp", "000000002.vtp"]
    assert not (tmp_path / "gas").exists()
    assert path.read_text().count("<DataSet") == 2
