"""A run's numbers for other programs: tables for spreadsheets and pandas, frames for ParaView."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from kncal.core.files import write_csv
from kncal.observe.run_data import RunData
from kncal.record.paraview import write_paraview, write_particles
from kncal.scene.scene import Scene
from kncal.scene.wall_motion import Surfaces, walls_at

#: Frames for ParaView are thinned to about this many files.
PARAVIEW_FRAMES = 500

_CONTACT_UNITS = {
    "t_start": "s",
    "t_c": "s",
    "delta_max": "m",
    "delta_mean": "m",
    "v_in": "m/s",
    "v_out": "m/s",
    "e_n": "-",
    "complete": "-",
}
_BODIES = {"body_1": "-", "body_2": "-"}


def export_tables(data: RunData) -> tuple[Path, Path]:
    """Write ``contacts.csv`` (a row per contact) and ``overlaps.csv`` (a row per pair and frame) into the run's folder.

    The first line of each names the units; an overlap below zero is a gap.
    """
    import pandas as pd

    folder = data.result.folder
    contacts, overlaps = folder / "contacts.csv", folder / "overlaps.csv"
    write_csv(contacts, data.observations.to_frame(), _BODIES | _CONTACT_UNITS)
    frames = [
        pd.DataFrame(
            {"body_1": pair[0], "body_2": pair[1], "t": series.t, "delta": series.delta, "delta_dot": series.delta_dot}
        )
        for pair, series in data.observations.series.items()
    ]
    units = _BODIES | {"t": "s", "delta": "m", "delta_dot": "m/s"}
    write_csv(overlaps, pd.concat(frames, ignore_index=True), units)
    return contacts, overlaps


def wall_surfaces(scene: Scene, interval: float, time: float) -> Surfaces:
    """Return the triangles (n, 3, 3) [m] of the walls of a scene that are there at ``time`` [s], where they are then.

    ``interval`` [s]: what happens to walls does so at the ends of intervals.
    """
    return walls_at(
        scene.walls,
        time,
        interval,
        path_of=scene.path_of,
        extent=scene.extent,
        radius=0.5 * scene.d_min,
        open_axes=scene.open_axes,
    )


def export_paraview(data: RunData) -> Path:
    """Write frames and walls for ParaView into the folder ``paraview`` of the run's; returns the file to open."""
    folder = data.result.folder / "paraview"
    if data.signals is not None:
        return write_paraview(data.signals, folder, partial(wall_surfaces, data.model.scene, data.model.coupling))
    every = max(1, -(-data.trajectory.step.size // PARAVIEW_FRAMES))
    return write_particles(data.trajectory, folder, every)
