"""What all pictures share: sizes, style, colours, the words for a scene's numbers, and how a figure is saved.

Figures are built on `matplotlib.figure.Figure` alone: no window, no global state, nothing left open.
"""

import os
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from jaxshroud.results.dimension import words
from jaxshroud.results.files import write
from jaxshroud.results.words import typeset, wrapped
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.keys import KEYS

INCH = 25.4  # [mm]
COLUMN, WIDE = 88 / INCH, 140 / INCH  # one and one and a half columns [inch]
STYLE: Any = {
    **dict.fromkeys(("font.size", "axes.titlesize", "figure.titlesize"), 8),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 7),
    **dict.fromkeys(("xtick.direction", "ytick.direction"), "in"),
    **{"axes.titlelocation": "left", "axes.linewidth": 0.6, "hatch.linewidth": 0.4},
    **{"legend.frameon": False, "legend.handlelength": 1.2, "legend.columnspacing": 1.2},
    **{"pdf.fonttype": 42, "svg.fonttype": "none"},  # text stays text
}
# Key of the scene -> symbol, words, unit, units per SI unit.
QUANTITIES = {row.name: (row.symbol, row.label, *row.shown) for row in KEYS.values()}
# Colours after Okabe and Ito, which colour-blind readers tell apart.
INK, GREY, BLUE, ORANGE, SKY, PINK = "#1a1a1a", "#8c8c8c", "#0072B2", "#E69F00", "#56B4E9", "#CC79A7"

LENGTHS = {"m": ("m", 1.0), "mm": ("mm", 1e3), "um": ("µm", 1e6)}  # units of lengths -> as written, how many are 1 m

Floats = NDArray[np.float64]


class Look(NamedTuple):
    """What a user asks of a picture; None leaves it to the picture."""

    title: str | None = None  # "" for none
    xlabel: str | None = None
    unit: str | None = None  # of displacements and of lengths that are varied: one of `LENGTHS`, or "gap"
    width: float | None = None  # [mm]
    style: str | os.PathLike[str] | None = None  # of matplotlib: a file, or a name

    def inches(self, usual: float) -> float:
        """The width, by default the `usual` one [inch]."""
        return usual if self.width is None else self.width / INCH


PLAIN = Look()


class Picture(Figure):
    """A figure that notebooks show as a picture, whether or not pyplot is there."""

    def _repr_png_(self) -> bytes:
        return _content(self, "png")


def new_figure(title: str, width: float, height: float, look: Look = PLAIN) -> Figure:
    """An empty figure of `width` by `height` [inch], unless its look is another."""
    width, title = look.inches(width), typeset(title if look.title is None else look.title)
    figure = Picture(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(wrapped(title, round(15 * width)))
    return figure


def say(figure: Figure, text: str) -> Figure:
    """A flat figure that says `text` in place of a picture."""
    figure.set_figheight(1.5)
    figure.text(0.5, 0.45, text, ha="center", va="center", color=INK)
    return figure


def legend_below(figure: Figure, handles: list[Any]) -> None:
    """A legend below the panels, in as many columns as fit."""
    for columns in range(min(6, len(handles)), 0, -1):
        legend = figure.legend(handles=handles, loc="outside lower center", ncols=columns)
        if columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            return
        legend.remove()


def shade(figure: Figure, low: float, high: float) -> None:
    """Shade what lies between two values along x, in every panel."""
    for panel in figure.axes:
        panel.axvspan(low, high, color=SKY, alpha=0.25, lw=0, zorder=0)


def quantity(key: str, look: Look = PLAIN, unit: str = "SI") -> tuple[str, float]:
    """Axis label of one of the scene's numbers, and its unit per SI unit; of an unknown one with the given unit."""
    stem = key.partition("[")[0]
    if stem not in QUANTITIES:
        return f"{key} [{unit}]" if unit else key, 1.0
    _, _, unit, factor = QUANTITIES[stem]
    if KEYS[stem].unit == "m" and look.unit in LENGTHS:
        unit, factor = LENGTHS[look.unit]
    return f"{words(key)} [{unit}]" if unit else words(key), float(factor)


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write `figure`: never half a file.

    Args:
        figure: Any figure.
        path: Its suffix says the format: .png (200 dpi), .pdf or .svg.

    Raises:
        ValueError: The suffix names no format of matplotlib.
        WriteError: The place cannot be written.
    """
    path = Path(path)
    if not path.suffix:
        raise InputError(f"{path}: a picture needs a suffix, such as .png, .pdf or .svg.")
    write(path, _content(figure, path.suffix[1:].lower()))


def _content(figure: Figure, form: str) -> bytes:
    """What a file of that format holds."""
    picture = BytesIO()
    with mpl.rc_context(STYLE):  # text of vector formats is what it is when they are written
        figure.savefig(picture, format=form, dpi=200)
    return picture.getvalue()
