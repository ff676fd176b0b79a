"""The particles of runs with their walls, side by side, drawn off-screen by pyvista.

A child process draws (``python -m kncal.report.particle_picture``): a graphics driver that does not work must not end
kncal. Particles are drawn at their true size; walls are seen through.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from kncal.core.checks import Array
from kncal.core.child import answer, ask
from kncal.core.files import replacing

#: Pixels of one panel, and what drawing may take beyond what Python and VTK have taken already [bytes], [s].
PANEL, MEMORY, SECONDS = (620, 620), 4 * 1024**3, 60
#: Colours of groups (Okabe and Ito).
_GROUPS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#F0E442", "#999999")


@dataclass(frozen=True, kw_only=True)
class Panel:
    """What one panel shows.

    Attributes
    ----------
    title : above it
    x, radius, value : (n, 3) [m], (n,) [m], and what the colour is of: (n,)
    walls : (m, 3, 3) triangles [m]
    """

    title: str
    x: Array
    radius: Array
    value: Array
    walls: Array


def draw_particles(
    panels: Sequence[Panel], path: Path, *, label: str, names: Sequence[str] = (), up: Array, along: Array
) -> Path:
    """Write a PNG of panels side by side, seen against ``along`` from a little above; returns ``path``.

    ``label``: of the colours; ``names``: of the groups, if ``value`` is the number of one; ``up``, ``along``: unit
    vectors (3,).

    Raises
    ------
    ChildError
        If it could not be drawn here.
    """
    arrays: dict[str, Any] = {"up": up, "along": along, "text": np.array([label, *names])}
    for k, panel in enumerate(panels):
        arrays |= {f"{name}{k}": np.asarray(value) for name, value in vars(panel).items()}
    given = io.BytesIO()
    np.savez(given, allow_pickle=False, **arrays)
    png = ask("kncal.report.particle_picture", given=given.getvalue(), seconds=2 * SECONDS)
    with replacing(path) as file:
        file.write(png)
    return path


def _draw(arrays: Mapping[str, Any]) -> bytes:
    import pyvista
    from PIL import Image

    label, *names = (str(text) for text in arrays["text"])
    count = sum(name.startswith("title") for name in arrays)
    values = np.concatenate([arrays[f"value{k}"] for k in range(count)])
    low = 0.0 if label.startswith("speed") else float(values.min())
    limits = (low, float(np.quantile(values, 0.99))) if not names else (-0.5, len(names) - 0.5)
    plotter = pyvista.Plotter(off_screen=True, shape=(1, count), window_size=(PANEL[0] * count, PANEL[1]), border=False)
    for k in range(count):
        plotter.subplot(0, k)
        panel = {name: arrays[f"{name}{k}"] for name in ("title", "x", "radius", "value", "walls")}
        _particles(plotter, panel, limits, label, names)
        _walls(plotter, panel["walls"])
        plotter.add_text(str(panel["title"]), position="upper_left", font_size=11, color="black")
        _look(plotter, arrays, k)
    picture = io.BytesIO()
    Image.fromarray(plotter.screenshot(return_img=True)).save(picture, format="PNG")
    return picture.getvalue()


def _particles(
    plotter: Any, panel: Mapping[str, Any], limits: tuple[float, float], label: str, names: Sequence[str]
) -> None:
    import pyvista

    points = pyvista.PolyData(panel["x"])
    points["radius"], points[label] = panel["radius"], panel["value"]
    bar = {"title": label, "vertical": False, "color": "black", "n_labels": 5, "fmt": "%.3g"}
    bar |= {"title_font_size": 18, "label_font_size": 16, "height": 0.06, "width": 0.6}
    actor = plotter.add_mesh(
        points,
        scalars=label,
        style="points_gaussian",
        render_points_as_spheres=True,
        emissive=False,
        clim=limits,
        cmap=list(_GROUPS[: len(names)]) if names else "viridis",
        scalar_bar_args=bar | {"position_x": 0.2, "position_y": 0.02},
        show_scalar_bar=not names,
    )
    actor.mapper.scale_array = "radius"
    actor.mapper.SetScaleFactor(1.0)
    if names:
        for i, (name, colour) in enumerate(zip(names, _GROUPS, strict=False)):
            plotter.add_text(name, position=(0.02, 0.02 + 0.045 * i), viewport=True, font_size=10, color=colour)


def _walls(plotter: Any, triangles: Array) -> None:
    import pyvista

    if not len(triangles):
        return
    corners = np.arange(3 * len(triangles)).reshape(-1, 3)
    faces = pyvista.PolyData.from_regular_faces(triangles.reshape(-1, 3), corners)
    plotter.add_mesh(faces, color="#8090A0", opacity=0.12)
    edges = faces.clean().extract_feature_edges(30.0)
    if edges.n_points:
        plotter.add_mesh(edges, color="#666666", line_width=1.0, opacity=0.6)


def _look(plotter: Any, arrays: Mapping[str, Any], k: int) -> None:
    up, along = arrays["up"], arrays["along"]
    x, walls = arrays[f"x{k}"], arrays[f"walls{k}"].reshape(-1, 3)
    low, high = x.min(axis=0), x.max(axis=0)
    if len(walls):  # as much of them as is near the particles
        room = 0.25 * (high - low).max()
        low = np.maximum(low - room, np.minimum(walls.min(axis=0), low))
        high = np.minimum(high + room, np.maximum(walls.max(axis=0), high))
    middle, reach = 0.5 * (low + high), float(np.linalg.norm(high - low))
    side = np.cross(up, along)
    plotter.camera.position = middle - 2.0 * reach * (along - 0.25 * side - 0.35 * up)
    plotter.camera.focal_point, plotter.camera.up = middle, up
    plotter.camera.parallel_projection = True
    plotter.background_color = "white"
    ahead = along - 0.25 * side - 0.35 * up
    across = np.cross(ahead, up) / np.linalg.norm(np.cross(ahead, up))
    above = np.cross(across, ahead) / np.linalg.norm(ahead)
    corners = np.array(list(product(*zip(low, high, strict=True)))) if len(walls) else x
    room = arrays[f"radius{k}"].max()
    half = [float(np.abs((corners - middle) @ axis).max()) + room for axis in (across, above)]
    width, height = plotter.renderer.GetSize()
    scale = max(half[1] / 0.84, half[0] / 0.95 * height / width)
    plotter.reset_camera(bounds=np.column_stack([low, high]).ravel().tolist())
    plotter.camera.parallel_scale = scale
    down = 0.1 * scale * above  # room for the colours' scale
    plotter.camera.position, plotter.camera.focal_point = plotter.camera.position - down, middle - down


if __name__ == "__main__":
    import pyvista

    pyvista.vtk_verbosity("off")
    with np.load(io.BytesIO(sys.stdin.buffer.read()), allow_pickle=False) as file:
        found = dict(file)
    answer(lambda: _draw(found), MEMORY, SECONDS)
