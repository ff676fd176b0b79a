"""What a report shows of many particles without gas: one part for each thing that was measured, with its picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from kncal.core.checks import Array
from kncal.core.child import ChildError
from kncal.core.errors import InputError
from kncal.observe.granular import GrainObservations
from kncal.observe.run_data import RunData
from kncal.report import grain_plots
from kncal.report.page import Figure, Section
from kncal.report.particle_picture import Panel, draw_particles
from kncal.report.style import Album, model_name
from kncal.report.tables import wall_surfaces

#: Title -> (name of its picture, how it is drawn, what to look at, what a blind reader is told).
_PARTS: Mapping[str, tuple[str, Callable[[grain_plots.GrainRuns], Any], str, str]] = {
    "Angle of the surface": (
        "surface",
        grain_plots.surfaces,
        "The last frame that was measured. Dots: where the coarse-grained solids fraction falls through half of that"
        " inside. Blue dots were fitted, the others are too near to an end. The number is that of all frames measured,"
        " the line that of this one.",
        "Particles of both runs seen along the slope, with the fitted surface line.",
    ),
    "Discharge": (
        "discharge",
        grain_plots.discharge_curves,
        "What has passed the outlets. The thick part is steady: the mass flow rate is its slope.",
        "Mass that passed the outlets against time, linear and Hertz.",
    ),
    "Profiles": (
        "profiles",
        grain_plots.profiles,
        "Means over the steady frames, coarse-grained with a Gaussian of one largest particle diameter, or of"
        " observe.width; the band is the 95 % interval of the velocity. Nothing is drawn where reflection at a side of"
        " the box flattens it.",
        "Solids fraction, velocity, shear rate and granular temperature along an axis, linear and Hertz.",
    ),
    "Mixing": (
        "mixing",
        grain_plots.mixing_curves,
        "Lacey's index in cells of equal numbers of particles: 0 separate, 1 as by chance. The band is one standard"
        " deviation of a single frame.",
        "Mixing index against time, linear and Hertz.",
    ),
    "Forces on the walls": (
        "wall_forces",
        grain_plots.wall_loads,
        "Left: the vertical force that each cross-section carries, the weight above less what the walls take. Dashed"
        " grey: without walls. Right: what the walls take.",
        "Vertical force against height with Janssen's law, linear and Hertz.",
    ),
}


def grains_section(runs: Sequence[RunData], album: Album) -> Section:
    """Draw what runs of many particles without gas show, and return its section; an empty one of other runs."""
    seen = {run.model.kind: found for run in runs if (found := run.grains) is not None}
    if len(seen) < len(runs):
        return Section(title=_TITLE)
    parts = [Section(title="Particles", figures=_picture(seen, album))]
    for title, (name, draw, caption, alt) in _PARTS.items():
        try:
            axes = draw(seen)
        except InputError:  # not recorded, or nothing to measure: the table of the metrics says why
            continue
        album.add(name, axes, caption, alt)
        parts.append(Section(title=title, figures=(album.figures[-1],)))
    return Section(title=_TITLE, parts=tuple(parts))


_TITLE = "What the particles do"


def _picture(seen: Mapping[str, GrainObservations], album: Album) -> tuple[Figure, ...]:
    """Draw a frame of each run with the walls; nothing where there is no graphics to draw by."""
    first = next(iter(seen.values()))
    groups = list(dict.fromkeys(first.series.facts.groups))
    several = len(set(groups) - set(first.scene.held)) > 1
    sizes = len(set(first.series.facts.radii)) > 1
    what = "group" if several else "diameter [mm]" if sizes else "speed [m/s]"
    along = np.eye(3)["xyz".index(first.scene.observe.axis)]
    if abs(along @ np.asarray(first.space.up)) > 0.9:
        along = np.roll(along, 1)
    try:
        panels = [_panel(kind, one, several, sizes) for kind, one in seen.items()]
        path = draw_particles(
            panels,
            album.folder / "grains.png",
            label=what,
            names=groups if several else (),
            up=np.asarray(first.space.up),
            along=along,
        )
    except (InputError, ChildError):
        return ()
    caption = f"One frame of each run with its walls, coloured by {what.partition(' [')[0]}."
    return (
        Figure(
            name="grains",
            png=path.name,
            svg=path.name,
            caption=caption,
            alt=f"Particles in their walls. {caption}",
            wide=True,
        ),
    )


def _panel(kind: str, seen: GrainObservations, several: bool, sizes: bool) -> Panel:
    last = seen.shown
    speed = np.linalg.norm(last.v, axis=1)
    value = seen.groups[last.kind].astype(np.float64) if several else 2e3 * last.radius if sizes else speed
    title = f"{model_name(kind)}, t = {last.t:.3g} s"
    return Panel(title=title, x=last.x, radius=last.radius, value=value, walls=_walls(seen, last.t))


def _walls(seen: GrainObservations, t: float) -> Array:
    """Return the triangles (m, 3, 3) of the walls that are there at ``t`` [s], where they are then."""
    found = wall_surfaces(seen.scene, seen.series.facts.coupling, t)
    return np.concatenate([np.zeros((0, 3, 3)), *found.values()])
