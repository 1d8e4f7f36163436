"""Pictures of fits: the measured values, the fitted scene, what is left over, and how sure each number is."""

from collections.abc import Mapping
from functools import partial

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from jaxshroud.plotting.page import Page, Panel
from jaxshroud.plotting.style import (
    BLUE,
    COLOURED_MARKS,
    COLUMN_WIDTH,
    GREY,
    INK,
    LENGTHS,
    AnyFigure,
    Appearance,
    Properties,
    fitting_title,
    legend_below,
    quantity,
)
from jaxshroud.scene.keys import parse_key
from jaxshroud.scene.measurements import BLADES, Channel, channel_named

MEASURE_STYLES = {"": "-", "rms": "-", "peak": "--"}
MEASURE_WORDS = {"": "", "rms": "RMS ", "peak": "peak "}
MILLISECONDS = 1e3
LIMITS_SHOWN = 2.0  # standard deviations of the noise
NUMBER_HEIGHT = 1.25  # of the panels of a number [inch]
MOST_RISE = 3.0  # of a profile, over that at the ends of intervals


def fit_page(ds: xr.Dataset, appearance: Appearance) -> Page[xr.Dataset]:
    """A panel for each measured quantity and the residuals over the noise; below, valleys and profile of each number.

    Args:
        ds: A fit.
        appearance: The requested appearance.
    """
    quantities = dict.fromkeys(str(name).partition("_")[0] for name in ds["channel"].to_numpy())
    panels = [Panel(name, partial(_draw_quantity, name=name, appearance=appearance)) for name in quantities]
    title = fitting_title(str(ds.attrs.get("title", "")), [str(key) for key in ds["key"].to_numpy()])
    panels.append(Panel("residuals", _draw_residuals, 0.6))
    below = _numbers_page(ds)
    size = COLUMN_WIDTH, 1.5 * len(panels) + below.size[1]
    single = [*panels, *below.panels]
    return Page(ds, panels, title, size, shared="x", finish=_add_legend, below=below, single=single)


def _numbers_page(ds: xr.Dataset) -> Page[xr.Dataset]:
    """The valleys that were found, and the profile, of each number."""
    panels = []
    for i, key in enumerate(map(str, ds["key"].to_numpy())):
        panels += [Panel(f"valleys {key}", partial(_draw_valleys, key=key, i=i))]
        panels += [Panel(f"profile {key}", partial(_draw_profile, key=key, i=i))]
    size = COLUMN_WIDTH, NUMBER_HEIGHT * len(panels) / 2
    return Page(ds, panels, "", size, columns=2, finish=lambda figure, axes, _: figure.align_ylabels([*axes.values()]))


def _draw_valleys(panel: Axes, ds: xr.Dataset, key: str, i: int) -> None:
    """chi^2 of every minimum that was found, within the bounds of a number."""
    label, scale = quantity(key)
    places = scale * ds["minima_at"].to_numpy()[:, i]
    chi2 = ds["minima"].to_numpy() / float(ds.attrs["freedom"])
    panel.plot(places[1:], chi2[1:], ls="", marker="o", ms=3, mfc="none", mec=GREY)
    panel.plot(places[:1], chi2[:1], ls="", marker="o", ms=3.5, color=INK)
    low, high = (scale * float(ds[f"bound_{end}"][i]) for end in ("low", "high"))
    panel.set(xlim=(low, high), xlabel=label, ylabel="minima of $\\chi^2$\nover freedom")
    if low > 0:
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        panel.xaxis.set_minor_formatter(NullFormatter())
    panel.set_yscale("log")
    panel.set_ylim(chi2.min() / 2, chi2.max() * 2)


def _draw_profile(panel: Axes, ds: xr.Dataset, key: str, i: int) -> None:
    """How chi^2 rises away from a number, and its interval."""
    least = float(ds.attrs["chi2"])
    best = float(ds["best"][i])
    symbol = parse_key(key)[0].symbol
    unit, factor = ("%", 100 / abs(best)) if best else parse_key(key)[0].shown

    def away(number):
        return factor * (np.asarray(number) - best)

    rise = (ds["profile_chi2"][i].to_numpy() - least) / (float(ds.attrs["profile_limit"]) - least)
    panel.axhline(1.0, color=GREY, lw=0.7, ls="--")
    panel.plot(away(ds["profile_at"][i]), rise, color=INK, marker="o", ms=2.2, lw=0.7)
    low, high = (float(away(ds[end][i])) for end in ("low", "high"))
    if np.isfinite(low):
        panel.axvspan(low, high, color=BLUE, alpha=0.2, lw=0)
    else:
        panel.text(0.5, 0.95, "not determined", ha="center", va="top", transform=panel.transAxes)
    panel.set(xlabel=f"change of ${symbol}$ [{unit}]", ylabel="rise of $\\chi^2$\nover its limit")
    panel.locator_params(axis="x", nbins=2)
    panel.ticklabel_format(axis="x", scilimits=(-2, 3))
    panel.set_ylim(-0.1 * MOST_RISE, max(1.2, min(MOST_RISE, 1.1 * float(np.nanmax(rise, initial=0.0)))))


def _place_axis(ds: xr.Dataset) -> tuple[str, float]:
    """The label of the x axis, and its factor from SI units."""
    return ("time [ms]", MILLISECONDS) if ds.attrs["data_kind"] == "history" else (r"$\omega$ [rad/s]", 1.0)


def _unit(ds: xr.Dataset, name: str, appearance: Appearance) -> tuple[str, float]:
    """The unit in which a quantity is drawn, and its factor from SI units."""
    if name == "theta":
        return "°", 180 / np.pi
    largest = max(float(np.abs(ds["measured"].to_numpy()[:, i]).max()) for i in _columns(ds, name))
    return LENGTHS[appearance.unit] if appearance.unit in LENGTHS else LENGTHS["mm" if largest > 1e-4 else "um"]


def _columns(ds: xr.Dataset, name: str) -> list[int]:
    return [i for i, channel in enumerate(ds["channel"].to_numpy()) if str(channel).partition("_")[0] == name]


def _marks(channel: Channel) -> tuple[str, str]:
    """The colour and the mark of a channel, those of its blade."""
    return COLOURED_MARKS[channel.blade % len(COLOURED_MARKS)]


def _channel(ds: xr.Dataset, i: int) -> Channel:
    channel = channel_named(str(ds["channel"].to_numpy()[i]))
    assert channel is not None  # which the fit has written
    return channel


def _draw_quantity(panel: Axes, ds: xr.Dataset, name: str, appearance: Appearance) -> None:
    """The measured values of one quantity, and the fit."""
    label, factor = _place_axis(ds)
    unit, scale = _unit(ds, name, appearance)
    measures = []
    symbol = r"\theta" if name == "theta" else name
    for i in _columns(ds, name):
        channel = _channel(ds, i)
        color, marker = _marks(channel)
        style = MEASURE_STYLES[channel.measure]
        side = channel.label if channel.label in BLADES else f"${symbol}_{{{channel.label}}}$"
        words = f"{side}, {MEASURE_WORDS[channel.measure]}measured"
        filled = color if style == "-" else "none"
        marks: Properties = {"ls": "", "marker": marker, "ms": 2.4, "mew": 0.5, "mec": color, "mfc": filled}
        panel.plot(factor * ds["at"], scale * ds["measured"][:, i], label=words, **marks)
        panel.plot(factor * ds["curve_at"], scale * ds["curve"][:, i], color=INK, ls=style, lw=0.7, label="fit")
        measures.append(channel.measure)
    panel.set(xlabel=label, ylabel=f"{'amplitude of ' if any(measures) else ''}${symbol}$ [{unit}]")


def _draw_residuals(panel: Axes, ds: xr.Dataset) -> None:
    """What is left over of every channel, over its noise."""
    label, factor = _place_axis(ds)
    panel.axhspan(-LIMITS_SHOWN, LIMITS_SHOWN, color=GREY, alpha=0.2, lw=0)
    left = ((ds["measured"] - ds["fitted"]) / ds["sigma"]).to_numpy()
    for i in range(len(ds["channel"])):
        color, marker = _marks(_channel(ds, i))
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
