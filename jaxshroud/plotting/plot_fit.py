"""Pictures of fits: the measured values, the fitted scene, and what is left over."""

from collections.abc import Mapping
from functools import partial

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes

from jaxshroud.plotting.page import Page, Panel
from jaxshroud.plotting.style import (
    BLUE,
    COLUMN_WIDTH,
    GREY,
    INK,
    LENGTHS,
    ORANGE,
    AnyFigure,
    Look,
    Properties,
    fitting_title,
    legend_below,
)

SIDE_MARKS = {"left": (BLUE, "o"), "right": (ORANGE, "s")}  # blade -> colour and mark
MEASURE_STYLES = {"": "-", "rms": "-", "peak": "--"}
MEASURE_WORDS = {"": "", "rms": "RMS ", "peak": "peak "}
MILLISECONDS = 1e3
LIMITS_SHOWN = 2.0  # standard deviations of the noise


def fit_page(ds: xr.Dataset, look: Look) -> Page[xr.Dataset]:
    """A panel for each measured quantity, and the residuals over the noise below.

    Args:
        ds: A fit.
        look: The appearance asked for.
    """
    quantities = dict.fromkeys(str(name).partition("_")[0] for name in ds["channel"].to_numpy())
    panels = [Panel(name, partial(_draw_quantity, name=name, look=look)) for name in quantities]
    title = fitting_title(str(ds.attrs.get("title", "")), [str(key) for key in ds["key"].to_numpy()])
    size = COLUMN_WIDTH, 1.5 + 1.5 * len(panels)
    return Page(ds, [*panels, Panel("residuals", _draw_residuals, 0.6)], title, size, shared="x", finish=_add_legend)


def _place_axis(ds: xr.Dataset) -> tuple[str, float]:
    """The label of the x axis, and its factor from SI units."""
    return ("time [ms]", MILLISECONDS) if ds.attrs["data_kind"] == "history" else (r"$\omega$ [rad/s]", 1.0)


def _unit(ds: xr.Dataset, name: str, look: Look) -> tuple[str, float]:
    """The unit in which a quantity is drawn, and its factor from SI units."""
    if name == "theta":
        return "°", 180 / np.pi
    largest = max(float(np.abs(ds["measured"].to_numpy()[:, i]).max()) for i in _columns(ds, name))
    return LENGTHS[look.unit] if look.unit in LENGTHS else LENGTHS["mm" if largest > 1e-4 else "um"]


def _columns(ds: xr.Dataset, name: str) -> list[int]:
    return [i for i, channel in enumerate(ds["channel"].to_numpy()) if str(channel).partition("_")[0] == name]


def _words(channel: str) -> tuple[str, str]:
    """The measure of a channel, which a history has not, and its blade."""
    parts = channel.split("_")
    return "_".join(parts[1:-1]), parts[-1]


def _draw_quantity(panel: Axes, ds: xr.Dataset, name: str, look: Look) -> None:
    """The measured values of one quantity, and the fit."""
    (label, factor), (unit, scale) = _place_axis(ds), _unit(ds, name, look)
    measures = []
    for i in _columns(ds, name):
        measure, side = _words(str(ds["channel"].to_numpy()[i]))
        color, marker = SIDE_MARKS[side]
        style = MEASURE_STYLES[measure]
        words = f"{side}, {MEASURE_WORDS[measure]}measured"
        filled = color if style == "-" else "none"
        marks: Properties = {"ls": "", "marker": marker, "ms": 2.4, "mew": 0.5, "mec": color, "mfc": filled}
        panel.plot(factor * ds["at"], scale * ds["measured"][:, i], label=words, **marks)
        panel.plot(factor * ds["curve_at"], scale * ds["curve"][:, i], color=INK, ls=style, lw=0.7, label="fit")
        measures.append(measure)
    symbol = r"$\theta$" if name == "theta" else f"${name}$"
    panel.set(xlabel=label, ylabel=f"{'amplitude of ' if any(measures) else ''}{symbol} [{unit}]")


def _draw_residuals(panel: Axes, ds: xr.Dataset) -> None:
    """What is left over of every channel, over its noise."""
    label, factor = _place_axis(ds)
    panel.axhspan(-LIMITS_SHOWN, LIMITS_SHOWN, color=GREY, alpha=0.2, lw=0)
    left = ((ds["measured"] - ds["fitted"]) / ds["sigma"]).to_numpy()
    for i, channel in enumerate(ds["channel"].to_numpy()):
        color, marker = SIDE_MARKS[_words(str(channel))[1]]
        panel.plot(factor * ds["at"], left[:, i], ls="", marker=marker, ms=1.8, mew=0, color=color)
    panel.set(xlabel=label, ylabel="residual\nover noise")
    panel.set_ylim(*(np.array([-1, 1]) * max(3.2, 1.1 * float(np.nanmax(np.abs(left), initial=0.0)))))


def _add_legend(figure: AnyFigure, axes: Mapping[str, Axes], ds: xr.Dataset) -> None:
    figure.align_ylabels([*axes.values()])
    shown: dict[str, Artist] = {}
    for panel in axes.values():
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            shown.setdefault(label, handle)
    legend_below(figure, sorted(shown.values(), key=lambda handle: handle.get_label() == "fit"))
