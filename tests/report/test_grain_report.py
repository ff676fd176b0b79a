"""Pictures of many particles without gas: drawn from records whose answers are known, and from real runs."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from seen_grains import BOX, DT, MASS, chute, pile, seen_of

from kncal.core.errors import InputError
from kncal.observe.grain_metrics import grain_estimate
from kncal.report import grain_plots
from kncal.report.particle_picture import Panel, draw_particles

pytestmark = pytest.mark.slow
MODELS = ("linear", "hertz")


def texts(ax):
    figure = ax.get_figure(root=True)
    return " ".join(t.get_text() for t in figure.findobj(match=lambda one: hasattr(one, "get_text")))


def test_the_picture_of_a_surface_shows_the_angle_that_the_table_has():
    rng = np.random.default_rng(1)
    runs = {kind: seen_of([pile(rng, 0.45) for _ in range(21)], surface="slope") for kind in MODELS}
    ax = grain_plots.surfaces(runs)
    for kind in MODELS:
        found = grain_estimate(runs[kind], "dynamic_angle")
        assert f"{found.value:.3g} ± {found.width:.2g}°" in texts(ax)
    lines = {line.get_label(): line for line in ax.get_lines()}
    x, y = lines["line"].get_data()
    assert np.degrees(np.arctan(abs(np.diff(y) / np.diff(x)))) == pytest.approx(runs["linear"].fits[-1].angle)


def test_the_thick_part_of_a_discharge_curve_is_the_steady_one():
    rng = np.random.default_rng(2)
    out = MASS * np.cumsum(rng.poisson(np.where(np.arange(400) < 50, 0, 20)))
    seen = seen_of([pile(rng, 0.0)] * 41, out=out, inside=out[-1] - out + MASS)
    ax = grain_plots.discharge_curves(dict.fromkeys(MODELS, seen))
    thick = max(ax.get_lines(), key=lambda line: line.get_linewidth()).get_xdata()
    assert thick.min() >= seen.flow.begin - DT and thick.max() <= seen.flow.end + DT


def test_profiles_show_what_flows_and_nothing_where_nothing_is():
    ax = grain_plots.profiles(dict.fromkeys(MODELS, chute(0.0, noise=0.01)))
    axes = ax.get_figure(root=True).axes
    assert [a.get_xlabel().split(" ")[0] for a in axes] == ["solids", "v_x", "shear", "temperature"]
    velocity, height = axes[1].get_lines()[0].get_data()
    assert np.isnan(velocity[height > 0.049e3]).all()


def test_a_picture_of_what_was_not_recorded_is_refused():
    seen = dict.fromkeys(MODELS, seen_of([pile(np.random.default_rng(3), 0.0)] * 21))
    for draw in (grain_plots.discharge_curves, grain_plots.surfaces, grain_plots.wall_loads):
        with pytest.raises(InputError):
            draw(seen)


def test_particles_are_drawn_where_they_are_in_their_colours(tmp_path):
    """Two groups, left and right of the middle, seen from the front."""
    rng = np.random.default_rng(4)
    x = rng.uniform(BOX[0], BOX[1], (4000, 3))
    group = (x[:, 0] > 0.03).astype(float)
    panel = Panel(title="t", x=x, radius=np.full(4000, 1e-3), value=group, walls=np.zeros((0, 3, 3)))
    up, along = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    path = draw_particles([panel], tmp_path / "p.png", label="group", names=("red", "blue"), up=up, along=along)
    picture = np.asarray(Image.open(path).convert("RGB")).astype(float)
    row = picture[picture.shape[0] // 2 - 40 : picture.shape[0] // 2 + 40]
    bluish = (row[..., 2] - row[..., 0]).mean(axis=0)
    third = len(bluish) // 3
    assert bluish[:third].mean() > 20.0 > -20.0 > bluish[-third:].mean(), "#0072B2 left, #E69F00 right"
