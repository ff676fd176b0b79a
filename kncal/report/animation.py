"""The particles of a run, or of several side by side, as a picture of one instant or an animation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import one_of, positive
from kncal.core.errors import InputError
from kncal.core.units import si_prefix
from kncal.record.series import BedSeries

#: More frames make the file large and show nothing more.
MAX_FRAMES = 120
#: Formats, by suffix.
FORMATS = (".gif", ".mp4")
_DPI = 80
_Picture = NDArray[np.uint8]


class _Stage:
    """The particles of every run on axes side by side, seen from the front, coloured by speed; redrawn per frame."""

    def __init__(self, runs: Mapping[str, BedSeries], fastest: float, top: float) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.collections import EllipseCollection
        from matplotlib.figure import Figure

        facts = next(iter(runs.values())).facts
        (left, _, bottom), (width, _, _) = facts.low, facts.size
        panel = float(np.clip(4.8 * width / (top - bottom), 1.6, 5.0))
        # an even number of pixels, which video needs
        across, up = (2.0 * round(0.5 * _DPI * inches) / _DPI for inches in (1.5 + (panel + 0.35) * len(runs), 5.6))
        self.figure = Figure(figsize=(across, up), dpi=_DPI, layout="compressed")
        self.canvas = FigureCanvasAgg(self.figure)
        self.factor, unit = si_prefix(facts.size, "m")
        self.runs = runs
        self.particles = []
        for ax, kind in zip(self.figure.subplots(1, len(runs), sharey=True, squeeze=False)[0], runs, strict=True):
            ax.set_xlim(self.factor * left, self.factor * (left + width))
            ax.set_ylim(self.factor * bottom, self.factor * top)
            ax.set_aspect("equal")
            ax.set_xlabel(f"x [{unit}]")
            ax.set_title({"linear": "linear", "hertz": "Hertz"}.get(kind, kind), fontsize=10)
            drawn = EllipseCollection(
                0.0,
                0.0,
                0.0,
                units="xy",
                offsets=np.zeros((1, 2)),
                offset_transform=ax.transData,
                cmap="viridis",
                linewidths=0.0,
                animated=True,
            )
            drawn.set_clim(0.0, fastest)
            ax.add_collection(drawn)
            self.particles.append(drawn)
        first = self.figure.axes[0]
        first.set_ylabel(f"z [{unit}]")
        self.figure.colorbar(self.particles[0], ax=self.figure.axes, label="speed [m/s]", shrink=0.7, extend="max")
        self.clock = self.figure.suptitle("t = 0.000 s", fontsize=10)
        self.canvas.draw()
        self.figure.set_layout_engine("none")  # the places are found, with room for the clock
        self.clock.set_animated(True)
        self.canvas.draw()  # all but the particles and the clock, once
        self.background = self.canvas.copy_from_bbox(self.figure.bbox)

    def draw(self, frames: Mapping[str, int]) -> _Picture:
        """Draw frame ``frames[kind]`` of every run; returns (height, width, 3) bytes."""
        self.canvas.restore_region(self.background)
        for drawn, (kind, series) in zip(self.particles, self.runs.items(), strict=True):
            x, v, kinds = series.x[frames[kind]], series.v[frames[kind]], series.kind[frames[kind]]
            there = np.flatnonzero(kinds >= 0)
            order = there[np.argsort(-x[there, 1], kind="stable")]  # the nearest last
            drawn.set_offsets(self.factor * x[order][:, [0, 2]])
            sizes = 2.0 * self.factor * np.array(series.facts.radii)[kinds[order]]
            drawn.set(widths=sizes, heights=sizes)
            drawn.set_array(np.linalg.norm(v[order], axis=1))
            self.figure.draw_artist(drawn)
        kind, series = next(iter(self.runs.items()))
        self.clock.set_text(f"t = {series.t_frame[frames[kind]]:.3f} s")
        self.figure.draw_artist(self.clock)
        return np.asarray(self.canvas.buffer_rgba())[..., :3].copy()


def snapshot(runs: Mapping[str, BedSeries], t: float, path: Path) -> Path:
    """Draw the frames nearest to ``t`` [s] of every run side by side as PNG into ``path``, which is returned."""
    from PIL import Image

    stage = _stage(runs)
    Image.fromarray(stage.draw({kind: _nearest(series, t) for kind, series in runs.items()})).save(path)
    return path


def animate(runs: Mapping[str, BedSeries], path: Path, seconds: float = 12.0) -> Path:
    """Write the particles of every run side by side, coloured by speed, as an animation.

    Parameters
    ----------
    runs : mapping
        Model -> its series; shown at equal times, over the time that all cover.
    path : Path
        ``.gif`` (Pillow), or ``.mp4``, which needs imageio with ffmpeg.
    seconds : float
        How long the animation plays [s]; at most `MAX_FRAMES` pictures, so a longer run is shown coarser.

    Raises
    ------
    InputError
        If the format is unknown or its writer is not installed, or there are fewer than two frames.
    """
    one_of("the suffix of path", path.suffix, FORMATS)
    positive("seconds", seconds, unit="s")
    stage = _stage(runs)
    reference = min(runs.values(), key=lambda series: float(series.t_frame[-1]))
    if len(reference.t_frame) < 2:
        raise InputError(f"{len(reference.t_frame)} frames: expected at least 2 for an animation")
    every = -(-len(reference.t_frame) // MAX_FRAMES)
    times = reference.t_frame[::every]

    def draw(t: float) -> _Picture:
        return stage.draw({kind: _nearest(series, t) for kind, series in runs.items()})

    pictures = map(draw, times.tolist())
    pause = seconds / len(times)
    if path.suffix == ".gif":
        _write_gif(path, pictures, pause, samples=[draw(t) for t in times[:: -(-len(times) // 5)].tolist()])
    else:
        _write_mp4(path, pictures, pause)
    return path


def _stage(runs: Mapping[str, BedSeries]) -> _Stage:
    if not runs or any(not len(series.t_frame) for series in runs.values()):
        raise InputError("no frames to draw: expected runs with recorded frames")
    speeds = [np.linalg.norm(series.v[:: _stride(series)], axis=2).ravel() for series in runs.values()]
    fastest = max(float(np.quantile(v[np.isfinite(v)], 0.99)) if np.isfinite(v).any() else 0.0 for v in speeds)
    facts = next(iter(runs.values())).facts
    bottom, lid = facts.low[2], facts.low[2] + facts.size[2]
    highest = max(float(np.max(x[:, 2], initial=bottom, where=~np.isnan(x[:, 2]))) for s in runs.values() for x in s.x)
    top = bottom + 1.05 * (highest + facts.diameter - bottom)
    return _Stage(runs, fastest=max(fastest, 1e-6), top=min(top, lid))


def _stride(series: BedSeries) -> int:
    return max(1, len(series.t_frame) // 20)


def _nearest(series: BedSeries, t: float) -> int:
    return int(np.abs(series.t_frame - t).argmin())


def _write_gif(path: Path, pictures: Iterator[_Picture], pause: float, samples: list[_Picture]) -> None:
    from PIL import Image

    # One palette for all: colours do not flicker, and frames that change little are small. It is made from pictures of
    # the whole run: in the first one, at rest, most of the colours do not occur.
    palette = Image.fromarray(np.concatenate(samples)).quantize(256, dither=Image.Dither.NONE)
    colours = np.array(palette.getpalette(), dtype=np.uint8).reshape(-1, 3)
    colours[(colours >= 248).all(axis=1)] = 255  # white stays white
    palette.putpalette(colours.tobytes())
    frames = (Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures)
    first = next(frames)
    # GIF counts in 10 ms, and viewers slow down what is faster than 20 ms
    first.save(path, save_all=True, append_images=frames, duration=max(20, 10 * round(100.0 * pause)), loop=0)


def has_mp4() -> bool:
    """Return whether what MP4 needs is installed, the extra ``kncal[mp4]``."""
    from importlib.util import find_spec

    return find_spec("imageio") is not None and find_spec("imageio_ffmpeg") is not None


def _write_mp4(path: Path, pictures: Iterator[_Picture], pause: float) -> None:
    from importlib import import_module

    try:
        imageio = import_module("imageio.v2")
        import_module("imageio_ffmpeg")
    except ImportError as error:
        raise InputError(
            f"{path.name}: MP4 needs imageio with ffmpeg ({error}); install them with pip install 'kncal[mp4]' "
            "(which is imageio[ffmpeg]), or ask for .gif"
        ) from error
    writer: Any = imageio.get_writer(path, format="FFMPEG", fps=1.0 / pause, codec="libx264", macro_block_size=2)
    try:
        for picture in pictures:
            writer.append_data(picture)
    finally:
        writer.close()
