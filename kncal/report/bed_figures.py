"""The figures of a bed report: which pictures the data allow, and what to look at in them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kncal.observe.compare import Comparison
from kncal.observe.run_data import BedRunData
from kncal.report import bed_plots as pictures
from kncal.report import plots
from kncal.report.animation import animate, has_mp4, snapshot
from kncal.report.figures import Figure
from kncal.scene.bed_scene import BedScene

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def _signals(scene: BedScene, *, gas: bool) -> dict[str, str]:
    """Return the signals to draw against time: name in `kncal.report.bed_plots.SIGNALS` -> what to look at."""
    frozen, count = scene.particles.frozen, scene.particles.count
    found = {}
    if gas:
        chaotic = count > 1 and not frozen
        found["p_in"] = "Pressure at the inlet." + (
            " Two chaotic runs never follow each other: compare the means and their bands." if chaotic else ""
        )
    if count == 1 and not frozen:
        found["z_mean"] = "Height of the particle."
    elif count and not frozen:
        found["z_mean"] = "Mean height of the particles: how far the bed is expanded, and whether it still drifts."
    return found


def draw_bed_figures(comparison: Comparison[BedRunData], folder: Path) -> tuple[Figure, ...]:
    """Write every figure that the data allow into ``folder``, as PNG and SVG.

    The animation is a GIF, its last picture a PNG; with the extra ``kncal[mp4]`` there is an MP4 as well.
    """
    data = (comparison.run, comparison.reference)
    runs = {d.model.kind: (d.series, d.seen) for d in data}
    observed = [d.seen for d in data]
    figures = []

    def add(name: str, ax: Axes, caption: str, alt: str) -> None:
        png, svg = plots.save(ax, folder, name)
        figures.append(Figure(name=name, png=png.name, svg=svg.name, caption=caption, alt=alt))

    gas = all(seen.eps_g is not None for seen in observed)
    scene = comparison.reference.model.scene
    for name, caption in _signals(scene, gas=gas).items():
        alt = f"{pictures.SIGNALS[name][0]} against time, linear and Hertz."
        add(name, pictures.signal_time(runs, name), caption, alt)
    if gas:
        add(
            "voidage",
            pictures.voidage_maps(runs).axes[0],
            "Time mean void fraction eps_g, averaged over the depth, and the difference: noise has no shape.",
            "Maps of the mean void fraction, linear, Hertz, and their difference.",
        )
    if any(seen.overlaps is not None for seen in observed):
        add(
            "overlaps",
            pictures.overlap_histogram(runs),
            "Overlaps of all contacts between particles: this is where the two contacts must differ.",
            "Share of contacts against overlap over diameter, linear and Hertz.",
        )
    if any(seen.spectrum is not None for seen in observed):
        add(
            "spectrum",
            pictures.pressure_spectra(runs),
            "Spectrum of the inlet pressure: the peak is the rhythm of the bubbles.",
            "Spectral density of the inlet pressure against frequency, linear and Hertz.",
        )
    if any(seen.tracks is not None and len(seen.tracks.diameter) for seen in observed):
        add(
            "bubbles",
            pictures.bubble_rise(runs),
            "Rise velocity of the bubbles against their diameter D; of a single one it is 0.711 √(g D).",
            "Rise velocity of bubbles against their diameter, linear and Hertz.",
        )
    if any(seen.curve is not None for seen in observed):
        add(
            "fluidization_curve",
            pictures.fluidization_curves(runs),
            "Pressure drop against falling gas velocity; U_mf is where the packed bed's curve reaches the weight.",
            "Normalised pressure drop against gas velocity, linear and Hertz, with the packed bed's curve.",
        )
    if any(seen.solids is not None for seen in observed) and gas:
        height = float(np.mean([seen.averages["z_mean"].mean for seen in observed]))
        add(
            "velocity",
            pictures.velocity_profiles(runs, height),
            "Mean vertical velocity of the particles across the bed, at its mean height.",
            "Mean particle velocity against x, linear and Hertz.",
        )
    several = scene.particles.count > 1 and not scene.particles.frozen  # of one particle the curve shows more
    if several and all(len(d.series.t_frame) > 1 for d in data):
        frames = {kind: series for kind, (series, _) in runs.items()}
        path = animate(frames, folder / "animation.gif")
        still = snapshot(frames, min(float(d.series.t_frame[-1]) for d in data), folder / "particles.png")
        video = folder / "animation.mp4"
        video.unlink(missing_ok=True)  # an earlier report's
        if has_mp4():
            animate(frames, video)
        figures.append(
            Figure(
                name="animation",
                png=video.name if video.is_file() else still.name,
                svg=path.name,
                caption="Both runs at equal times, seen from the front, coloured by the speed of the particles.",
                alt="Animation of the particles, linear and Hertz side by side.",
            )
        )
    return tuple(figures)
