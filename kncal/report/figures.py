"""The figures of a comparison: which pictures its runs allow, and what to look at in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.observe.compare import Comparison
from kncal.observe.contacts import overlaps
from kncal.observe.run_data import RunData
from kncal.observe.truth import frames_at
from kncal.physics.material import sphere_mass
from kncal.record.series import BedSeries
from kncal.report import plots
from kncal.report.animation import animate, has_mp4, snapshot
from kncal.report.page import Figure
from kncal.report.style import Album
from kncal.scene.bodies import AXES, Particle, Wall
from kncal.scene.scene import Scene

if TYPE_CHECKING:
    import pandas as pd

#: Points of a drawn smooth line.
_POINTS = 600


def draw_comparison(comparison: Comparison, album: Album) -> None:
    """Draw every picture that the records of both runs allow."""
    if all(run.frames is not None for run in comparison.runs):
        _draw_contacts(comparison, album)
    if all(run.signals is not None for run in comparison.runs):
        _draw_signals(comparison, album)


def _draw_contacts(comparison: Comparison, album: Album) -> None:
    """Draw the first contact of both runs, and their motion."""
    _first_contacts(comparison, album)
    label, paths = _motions(comparison)
    album.add(
        "motion",
        plots.motion(paths, label),
        f"The whole run, {label}: how the contact model changes the motion after each contact.",
        f"{label} against time, linear and Hertz.",
    )


def draw_calibration(kn_curves: Mapping[str, Any], error_table: pd.DataFrame, album: Album) -> None:
    """Draw what puts a calibration in context: k_n of several methods, and the error against the time step.

    Parameters
    ----------
    kn_curves : as `kncal.report.overview.kn_curves` returns it; empty if there is no speed to calibrate at
    error_table : as `kncal.report.overview.error_table` returns it; empty if there is no prediction
    """
    for against, chosen in zip(("v_0", "e_n"), kn_curves.get("chosen", ()), strict=False):
        what = "impact speed" if against == "v_0" else "restitution"
        album.add(
            f"k_n_{against}",
            plots.stiffness(kn_curves[against], kn_curves[f"against_{against}"], against, float(chosen)),
            f"Linear stiffness by each method against {what}; the dotted line is this case. The distance between the"
            " curves shows how much the choice of the method matters.",
            f"Linear stiffness k_n against {what} for several methods.",
        )
    if len(error_table):
        album.add(
            "error_steps",
            plots.errors(error_table),
            "What the time step costs in accuracy: the predicted error for the worst moment of first touch within a"
            " step. The marked points are the steps of these runs.",
            "Predicted relative error against steps per contact, linear and Hertz.",
        )


#: Picture of a bed -> (what an observation must hold, how it is drawn, what to look at, what it shows).
_OBSERVED: Mapping[str, tuple[str, Any, str, str]] = {
    "voidage": (
        "eps_g",
        lambda runs: plots.voidage_maps(runs).axes[0],
        "Time mean of the void fraction eps_g, averaged over the depth, and the difference. A difference by chance has"
        " no shape.",
        "Maps of the mean void fraction, linear, Hertz, and their difference.",
    ),
    "overlaps": (
        "overlaps",
        plots.overlap_histogram,
        "Overlaps of all contacts between particles: here the two contact models must differ.",
        "Share of contacts against overlap over diameter, linear and Hertz.",
    ),
    "spectrum": (
        "spectrum",
        plots.pressure_spectra,
        "Spectrum of the inlet pressure: the peak is the frequency of the bubbles.",
        "Spectral density of the inlet pressure against frequency, linear and Hertz.",
    ),
    "bubbles": (
        "tracks",
        plots.bubble_rise,
        "Rise velocity of the bubbles against their diameter D; of a single one it is 0.711 √(g D).",
        "Rise velocity of bubbles against their diameter, linear and Hertz.",
    ),
    "fluidization_curve": (
        "curve",
        plots.fluidization_curves,
        "Pressure drop against falling gas velocity; U_mf is where the curve of the packed bed reaches the weight.",
        "Normalised pressure drop against gas velocity, linear and Hertz, with the packed bed's curve.",
    ),
    "velocity": (
        "solids",
        lambda runs: plots.velocity_profiles(runs, _mean_height(runs)),
        "Mean vertical velocity of the particles across the bed, at its mean height.",
        "Mean particle velocity against x, linear and Hertz.",
    ),
}


def _draw_signals(comparison: Comparison, album: Album) -> None:
    """Draw every picture that the signals of both runs allow.

    The animation is a GIF, its last picture a PNG; with the extra ``kncal[mp4]`` there is an MP4 as well.
    """
    data = comparison.runs
    runs = {d.model.kind: d.seen for d in data}
    scene = comparison.reference.model.scene
    moving, gas = not scene.frozen, all(d.seen.get("eps_g") is not None for d in data)
    several = moving and scene.number > 1
    signals = {}
    if gas:
        signals["p_in"] = "Pressure at the inlet." + (
            " Two chaotic runs never follow each other: compare the means and their bands." if several else ""
        )
    if scene.number and moving:
        signals["z_mean"] = (
            "Mean height of the particles: how far the bed is expanded, and whether it still drifts."
            if several
            else "Height of the particle."
        )
    for name, caption in signals.items():
        alt = f"{plots.SIGNALS[name][0]} against time, linear and Hertz."
        album.add(name, plots.signal_time(runs, name), caption, alt)
    for name, (needed, draw, caption, alt) in _OBSERVED.items():
        seen = [part for d in data if (part := d.seen.get(needed)) is not None]
        if name == "bubbles":
            seen = [tracks for tracks in seen if len(tracks.diameter)]
        if seen and (gas or name not in ("voidage", "velocity")):
            album.add(name, draw(runs), caption, alt)
    if several and all(len(d.series.t_frame) > 1 for d in data):
        _animation({kind: seen.series for kind, seen in runs.items()}, album)


def _mean_height(runs: plots.Runs) -> float:
    return float(np.mean([seen.estimates["z_mean"].value or 0.0 for seen in runs.values()]))


def _animation(runs: Mapping[str, BedSeries], album: Album) -> None:
    path = animate(runs, album.folder / "animation.gif")
    still = snapshot(runs, min(float(series.t_frame[-1]) for series in runs.values()), album.folder / "particles.png")
    if has_mp4():
        still = animate(runs, album.folder / "animation.mp4")
    album.figures.append(
        Figure(
            name="animation",
            png=still.name,
            svg=path.name,
            caption="Both runs at equal times, seen from the front, coloured by the speed of the particles.",
            alt="Animation of the particles, linear and Hertz side by side.",
            wide=True,
        )
    )


def _first_contacts(comparison: Comparison, album: Album) -> None:
    """Draw the first contact of the Hertz run in both models, unless nothing changes in it."""
    contacts = comparison.reference.observations.contacts
    if not contacts:
        return
    both = (("linear", comparison.run), ("hertz", comparison.reference))
    lines = [(kind, c) for kind, data in both if (c := _first_contact(data, contacts[0].pair)) is not None]
    runs = {kind: c.run for kind, c in lines}
    if not any(_changes(delta) for _, delta in runs.values()):
        return
    exact = {kind: c.exact for kind, c in lines if c.exact is not None}
    forces = {kind: c.run_force for kind, c in lines if c.run_force is not None}
    loops = {kind: c.exact_force for kind, c in lines if c.exact_force is not None}
    pair = " and ".join(contacts[0].pair)
    markers = "Markers: the runs." + (" Lines: the exact solutions, free of any time step." if exact else "")
    album.add(
        "overlap_time",
        plots.overlap_time(runs, exact),
        f"First contact of {pair}: do the two models agree in height and width? {markers}",
        f"Overlap against time of the first contact of {pair}, linear and Hertz.",
    )
    if forces or loops:
        album.add(
            "force_overlap",
            plots.force_loops(forces, loops),
            "The same contact, force against overlap. The area of a loop is the energy lost, its slope the stiffness:"
            " Hertz starts soft and ends stiff, the linear spring has one stiffness.",
            f"Normal force against overlap of the first contact of {pair}, linear and Hertz.",
        )


def _changes(delta: Array) -> bool:
    """Whether an overlap changes at all; a particle at rest on a wall has nothing to show."""
    return len(delta) > 1 and bool(np.ptp(delta) > 1e-3 * delta.max())


@dataclass(frozen=True)
class _Lines:
    """Lines of one model's first contact: (time, overlap) and (overlap, force), of the run and exact."""

    run: plots.Line
    exact: plots.Line | None
    run_force: plots.Line | None
    exact_force: plots.Line | None


def _first_contact(data: RunData, pair: tuple[str, str]) -> _Lines | None:
    """Lines of a pair's first contact, from touch to separation; three durations if it does not end."""
    event = next((c for c in data.observations.contacts if c.pair == pair), None)
    if event is None:
        return None
    scene, motion = data.model.scene, data.trajectory
    contact = data.model.between(*pair)
    first, _ = _bodies(scene, pair)
    series = data.observations.series[pair]
    start = event.t_start
    end = start + (event.t_c if event.complete else 3.0 * contact.t_c)
    inside = (motion.t >= start) & (motion.t <= end)
    delta = series.delta[inside]
    run = (motion.t[inside] - start, np.maximum(delta, 0.0))
    run_force = exact = exact_force = None
    if not _touches_others(data, pair, inside):
        # what the solver really applied: the recorded total force without the weight
        weight = float(sphere_mass(first.material, first.radius)) * np.asarray(scene.gravity)
        force = motion.force[inside, motion.names.index(first.name)] - weight
        run_force = (delta, (force * series.normal[inside]).sum(axis=1))
    if data.motion is not None:
        times = np.linspace(start, min(end, data.model.t_end), _POINTS)
        there = overlaps(scene, frames_at(data.model, data.motion, times))[pair]
        exact = (times - start, np.maximum(there.delta, 0.0))
        touching = there.delta >= 0.0
        exact_force = (there.delta[touching], contact.force(there.delta[touching], there.delta_dot[touching]))
    return _Lines(run, exact, run_force, exact_force)


def _bodies(scene: Scene, pair: tuple[str, str]) -> tuple[Particle, Particle | Wall]:
    return next((a, b) for a, b in scene.body_pairs() if (a.name, b.name) == pair)


def _touches_others(data: RunData, pair: tuple[str, str], inside: NDArray[np.bool_]) -> bool:
    """Whether the first body of ``pair`` is in another contact, which would show in its recorded force."""
    others = (s for p, s in data.observations.series.items() if p != pair and pair[0] in p)
    return any(bool((s.delta[inside] > 0.0).any()) for s in others)


def _motions(comparison: Comparison) -> tuple[str, dict[str, plots.Line]]:
    """Label and lines of the motion: gap to the wall that is hit first, else the largest displacement."""
    from scipy.interpolate import CubicHermiteSpline

    data = comparison.reference
    spheres = data.model.scene.spheres
    sides = data.trajectory.x.max(axis=0) - data.trajectory.x.min(axis=0)
    particle, axis = (int(i) for i in np.unravel_index(sides.argmax(), sides.shape))
    label, pair = f"displacement of {spheres[particle].name} along {AXES[axis]}", None
    if data.observations.contacts:
        first, second = _bodies(data.model.scene, data.observations.contacts[0].pair)
        if isinstance(second, Wall) and second.axis == AXES[axis]:
            label, pair = f"gap between {first.name} and {second.name}", (first.name, second.name)
    lines = {}
    for kind, run in (("linear", comparison.run), ("hertz", comparison.reference)):
        motion = run.trajectory
        if pair is None:
            y, rate = motion.x[:, particle, axis] - motion.x[0, particle, axis], motion.v[:, particle, axis]
        else:
            series = run.observations.series[pair]
            y, rate = -series.delta, -series.delta_dot
        # frames are far apart in flight, where the interpolant is exact
        times = np.union1d(motion.t, np.linspace(motion.t[0], motion.t[-1], _POINTS))
        lines[kind] = (times, CubicHermiteSpline(motion.t, y, rate)(times))
    return label, lines
