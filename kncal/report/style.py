"""How figures look: colours, axes, legends, files.

The colours are those of Okabe and Ito, which people with any colour vision tell apart; dashes and markers differ too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kncal.core.errors import InputError
from kncal.report.page import Figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Colour, dashes and marker of each model.
STYLES: Mapping[str, dict[str, Any]] = {
    "linear": {"color": "#0072B2", "linestyle": "-", "marker": "o"},
    "hertz": {"color": "#D55E00", "linestyle": (0, (5, 2)), "marker": "s"},
}
#: Colours and dashes of lines that stand for no model.
CYCLE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#000000")
DASHES = ("-", (0, (5, 2)), (0, (5, 1.5, 1, 1.5)), (0, (1, 1.5)), (0, (8, 2)), (0, (3, 1, 1, 1, 1, 1)), "-")
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
#: Dots per inch of a PNG, and what keeps its date out of a file: the same data give the same bytes.
_DPI = 130
_DATELESS: Mapping[str, dict[str, None]] = {".png": {"Software": None}, ".svg": {"Date": None, "Creator": None}}
#: Wider figures than this [inch] take the whole width of a page.
_COLUMN = 6.0


def model_name(kind: str) -> str:
    """Return the name of a model as people write it."""
    return "Hertz" if kind == "hertz" else kind


def line_style(kind: str) -> dict[str, Any]:
    """Return colour and dashes of a model's line, without its marker."""
    return {key: value for key, value in STYLES[kind].items() if key != "marker"}


def new_axes(width: float = 5.6, height: float = 3.8) -> Axes:
    """Return axes on a figure of their own (inches) that needs no display."""
    from matplotlib.figure import Figure as Canvas

    return Canvas(figsize=(width, height), layout="constrained").add_subplot()


def panels(rows: int, columns: int, width: float, height: float, **options: Any) -> list[Axes]:
    """Return the axes of ``rows`` times ``columns`` panels, row by row, on a figure of their own (inches)."""
    from matplotlib.figure import Figure as Canvas

    canvas = Canvas(figsize=(width, height), layout="constrained")
    return list(canvas.subplots(rows, columns, squeeze=False, **options).flat)


def save(ax: Axes, folder: Path, name: str) -> tuple[Path, Path]:
    """Write the figure of ``ax`` as ``name.png`` (130 dots per inch) and ``name.svg``; returns both paths.

    The same data give the same bytes: no date, no random identifiers.
    """
    from matplotlib import rc_context

    figure = ax.get_figure(root=True)
    if figure is None:
        raise InputError(f"picture {name}: the axes have been removed from their figure")
    png, svg = folder / f"{name}.png", folder / f"{name}.svg"
    with rc_context({"svg.hashsalt": name}):
        save_picture(figure, png)
        figure.set_layout_engine("none")  # the places are found: to find them again takes longer than to draw
        save_picture(figure, svg)
    return png, svg


def save_picture(figure: Any, picture: Path) -> None:
    """Write a figure into one file, .png or .svg.

    Raises
    ------
    InputError
        For another file type, or a folder that does not exist.
    """
    if picture.suffix not in (".png", ".svg"):
        raise InputError(f"{picture}: expected a name that ends in .png or .svg")
    if not picture.parent.is_dir():
        raise InputError(f"{picture}: the folder {picture.parent} does not exist")
    figure.savefig(picture, dpi=_DPI, metadata=_DATELESS[picture.suffix])


class Album:
    """The figures of a page, written into ``folder`` one by one; ``figures`` lists them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.figures: list[Figure] = []

    def add(self, name: str, ax: Axes | None, caption: str, alt: str) -> None:
        """Write the figure of ``ax`` as PNG and SVG; None: there is nothing to draw."""
        if ax is None:
            return
        png, svg = save(ax, self.folder, name)
        wide = bool(ax.get_figure(root=True).get_size_inches()[0] > _COLUMN)  # type: ignore[union-attr]
        self.figures.append(Figure(name=name, png=png.name, svg=svg.name, caption=caption, alt=alt, wide=wide))


def bare(ax: Axes) -> None:
    """Light grid behind the lines, no box."""
    ax.grid(True, which="major", color="0.88", linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def dress(ax: Axes, x: str, y: str, columns: int = 2) -> Axes:
    """Make the axes `bare`, name them ``x`` and ``y``, put the legend above, where it hides nothing; returns them."""
    bare(ax)
    ax.set_xlabel(x)
    ax.set_ylabel(y, parse_math=False)  # a name from a case is text, also if it holds a $
    if ax.get_legend_handles_labels()[0]:
        above = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0, 1.0, 0.1), "borderaxespad": 0.3}
        ax.legend(ncols=columns, frameon=False, fontsize=9, columnspacing=1.2, handlelength=2.2, **above)
    return ax


def shared_legend(axes: Any, columns: int) -> None:
    """Put one legend above all panels of a figure: each text once."""
    lines: dict[str, Any] = {}
    for ax in axes:
        for line, text in zip(*ax.get_legend_handles_labels(), strict=True):
            lines.setdefault(text, line)
    axes[0].get_figure(root=True).legend(
        lines.values(), lines.keys(), loc="outside upper left", ncols=columns, frameon=False, fontsize=9
    )


def plain_ticks(axis: Any) -> None:
    """On a logarithmic axis write 1, 2, 5, 10 as numbers, or decades of a long range; no minor labels that collide."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(base=10, subs=(1.0,) if high > 100.0 * low else (1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: _plain(value)))
    axis.set_minor_locator(NullLocator())  # thousands of minor ticks take seconds to lay out


def _plain(value: float) -> str:
    exponent = round(math.log10(value)) if value > 0.0 else 0
    if -4 <= exponent < 5 or not math.isclose(value, 10.0**exponent):
        return f"{value:g}"
    return f"10{str(exponent).translate(_SUPERSCRIPT)}"


def log_axes(ax: Axes) -> None:
    """Make both axes logarithmic with `plain_ticks`, once everything is drawn."""
    ax.set_xscale("log")
    ax.set_yscale("log")
    plain_ticks(ax.xaxis)
    plain_ticks(ax.yaxis)
