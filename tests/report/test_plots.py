"""What is drawn is what was given: lines, units, marks."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kncal.core.errors import InputError
from kncal.core.units import percent, quantity, si_prefix
from kncal.report import plots, style

PREFIXES = {"p": 1e-12, "n": 1e-9, "µ": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12}


def half_sine(k: float, m: float = 1e-5, v_0: float = 1.0, n: int = 101):
    """Undamped linear impact: delta = v_0/omega sin(omega t), F = k delta."""
    omega = math.sqrt(k / m)
    t = np.linspace(0.0, math.pi / omega, n)
    delta = v_0 / omega * np.sin(omega * t)
    return t, delta, k * delta


@given(value=st.floats(1e-11, 1e14), sign=st.sampled_from([-1.0, 1.0]))
def test_prefixes_keep_the_value_and_make_it_readable(value: float, sign: float):
    factor, label = si_prefix([0.0, sign * value, math.nan], "m")
    assert factor * PREFIXES[label.removesuffix("m")] == pytest.approx(1.0)
    assert 1.0 - 1e-6 <= factor * value < 1000.0


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0, "m", "0 m"),
        (2.34e-6, "m", "2.34 µm"),
        (1e-3, "s", "1 ms"),
        (7.5e5, "N/m", "750 kN/m"),
        (-2e-3, "N", "-2 mN"),
        (1234.5, "rad/s", "1234.5 rad/s"),
        (0.9, "–", "0.9"),
        (12345, "", "12,345"),
        (0.05, "%", "5 %"),
        (None, "m", "–"),
        (math.nan, "m", "–"),
    ],
)
def test_quantities_as_text(value, unit, text):
    assert quantity(value, unit) == text


def test_percent_shows_the_sign():
    assert (percent(0.05), percent(-0.05), percent(None)) == ("+5 %", "-5 %", "–")


def test_overlaps_are_drawn_in_microns_and_microseconds():
    t, delta, _ = half_sine(1e4)
    ax = plots.overlap_time({"linear": (t, delta)}, {"hertz": (t, 2.0 * delta)})
    exact, run = ax.get_lines()
    np.testing.assert_allclose(run.get_xdata(), 1e6 * t)
    np.testing.assert_allclose(run.get_ydata(), 1e6 * delta)
    np.testing.assert_allclose(exact.get_ydata(), 2e6 * delta)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time since first touch [µs]", "overlap δ [µm]")


def test_attraction_is_named_only_where_there_is_one():
    _, delta, force = half_sine(1e4)
    assert not plots.force_loops({"linear": (delta, force)}, {}).texts
    ax = plots.force_loops({"linear": (delta, force - 0.1 * force.max())}, {})
    assert "attraction" in ax.texts[0].get_text()
    assert ax.get_ylim()[0] < 0.0


def test_stiffness_against_speed_is_a_straight_line_of_slope_two_fifths():
    v = np.logspace(-1.0, 1.0, 9)
    ax = plots.stiffness(v, {"max_overlap": 1e5 * v**0.4}, "v_0", 1.0)
    line = ax.get_lines()[0]
    slopes = np.diff(np.log(line.get_ydata())) / np.diff(np.log(line.get_xdata()))
    np.testing.assert_allclose(slopes, 0.4)
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")


def test_stiffness_is_drawn_against_speed_or_restitution_only():
    with pytest.raises(InputError, match="against = 'radius'"):
        plots.stiffness(np.ones(2), {"max_overlap": np.ones(2)}, "radius", 1.0)


def test_a_name_with_a_dollar_is_text():
    t = np.linspace(0.0, 1.0, 5)
    ax = plots.motion({"linear": (t, t), "hertz": (t, t)}, r"gap between $\frac{ball} and floor")
    ax.get_figure().canvas.draw()
    assert r"$\frac{ball}" in ax.get_ylabel()


def test_the_steps_that_were_run_are_marked():
    n = [10, 20, 50]
    rows = [
        {"model": kind, "steps_per_contact": k, "run": k == 20, "error_e_n": 1.0 / k, "error_delta_max": 0.0}
        for kind in ("linear", "hertz")
        for k in n
    ]
    ax = plots.errors(pd.DataFrame(rows))
    marked = [line for line in ax.get_lines() if line.get_marker() in ("o", "s") and len(line.get_xdata())]
    assert [(list(m.get_xdata()), list(m.get_ydata())) for m in marked] == [([20.0], [0.05])] * 2
    # an error of zero has no place on a logarithmic axis
    assert not any("maximum overlap" in str(line.get_label()) for line in ax.get_lines())


def test_drawing_on_given_axes_keeps_them():
    ax = style.new_axes()
    t, delta, force = half_sine(1e4)
    assert plots.overlap_time({"linear": (t, delta)}, {}, ax) is ax
    assert plots.force_loops({"linear": (delta, force)}, {}, ax) is ax


def test_the_same_data_give_the_same_files(tmp_path):
    t, delta, _ = half_sine(1e4)
    files = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        files.append(style.save(plots.overlap_time({"linear": (t, delta)}, {}), tmp_path / name, "picture"))
    (png, svg), (png_2, svg_2) = files
    assert png.read_bytes().startswith(b"\x89PNG") and png.read_bytes() == png_2.read_bytes()
    assert b"<svg" in svg.read_bytes() and svg.read_bytes() == svg_2.read_bytes()


@pytest.mark.parametrize(
    ("value", "width", "unit", "text"),
    [
        (0.32336, 9.4e-4, "m", "323.36 ± 0.94 mm"),
        (0.0, 2e-6, "m", "0.0 ± 2.0 µm"),
        (0.05, 0.001, "%", "5.00 ± 0.10 %"),
        (0.898, 0.0037, "–", "0.8980 ± 0.0037"),
        (12.5, 0.31, "rad/s", "12.50 ± 0.31 rad/s"),
        (None, 0.1, "m", "–"),
    ],
)
def test_a_value_and_its_width_have_one_prefix(value, width, unit, text):
    assert quantity(value, unit, width=width) == text
