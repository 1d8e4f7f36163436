"""Pictures of mistuned rows: amplification over sigma, amplitudes of tuned and mistuned rows, and the worst pattern."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from jaxshroud.plotting.page import (
    AmplitudeUnit,
    Page,
    Panel,
    ParameterAxis,
    amplitude_unit,
    legend_above,
    parameter_axis,
    title_of,
)
from jaxshroud.plotting.style import (
    BLUE,
    COLUMN_WIDTH,
    GREY,
    INK,
    ORANGE,
    PALE,
    RED,
    AnyFigure,
    Appearance,
    PlotArray,
    Properties,
)
from jaxshroud.signals.waves import whitehead_factor

PERCENT = 100.0
SPREAD = 0.28  # half width of the patterns of one sigma, in distances of the groups
BOUND_STYLE: Properties = {"color": INK, "lw": 0.8, "ls": (0, (4, 2))}
QUANTILE_MARKERS = "vo^"
QUANTILE_DISTANCE = 0.06
MANY_PATTERNS = 60  # beyond which their points are small
LEAST_SHARE = 0.2  # of the height up to Whitehead's factor that patterns take if its line is drawn
ROOM_FOR_WORDS = 1.4  # height of the axis over that of the patterns where it is not


class MistunedContent(NamedTuple):
    """What the picture of a mistuned row shows."""

    ds: xr.Dataset
    axis: ParameterAxis
    unit: AmplitudeUnit
    worst: tuple[int, int, int]  # design, sigma and pattern of the largest amplification drawn


def mistuned_page(ds: xr.Dataset, appearance: Appearance) -> Page[MistunedContent]:
    """The amplification, the amplitudes and the worst pattern of a mistuned row.

    Args:
        ds: A `Mistuned`.
        appearance: The requested appearance.
    """
    title = title_of(ds)
    size = (COLUMN_WIDTH, 5.4)
    level = np.nan_to_num(ds["amplification"].to_numpy(), nan=-np.inf)
    if not np.isfinite(level).any():
        return Page(None, MISTUNED_PANELS, title, size, nothing="of every pattern a lane stopped")
    worst = tuple(int(i) for i in np.unravel_index(level.argmax(), level.shape))
    largest = float(np.nanmax(ds["amplitude"].to_numpy()))
    unit = amplitude_unit(str(ds.attrs["of"]), largest, appearance, blade=None)
    content = MistunedContent(ds, parameter_axis(ds["value"], appearance), unit, worst)  # pyright: ignore[reportArgumentType]
    return Page(content, MISTUNED_PANELS, title, size, finish=_align_mistuned)


def _draw_amplification(panel: Axes, shown: MistunedContent) -> None:
    """The amplification of every pattern in groups by sigma, with quantiles and their intervals."""
    ds = shown.ds
    designs = [str(name) for name in ds["design"].to_numpy()]
    sigmas = ds["sigma"].to_numpy()
    width = 1 / len(designs)
    for i, design in enumerate(designs):
        places = np.arange(len(sigmas)) + (i - (len(designs) - 1) / 2) * width
        color = (BLUE, ORANGE, RED, GREY)[i % 4]
        for j, place in enumerate(places):
            level = np.sort(ds["amplification"].to_numpy()[i, j])
            level = level[np.isfinite(level)]
            beside = SPREAD * width * np.cos(2.4 * np.arange(level.size))  # spread evenly
            size = 2.2 if level.size > MANY_PATTERNS else 3.6
            panel.plot(place + beside, level, ".", ms=size, mew=0, color=PALE, label="patterns" if i + j == 0 else None)
            _draw_quantiles(panel, place, ds.isel(design=i, sigma=j), color, i + j == 0)
        if len(designs) > 1:
            panel.plot([], [], lw=2, color=color, label=design)
    bound = whitehead_factor(ds.sizes["blade"])
    panel.set_xticks(range(len(sigmas)), [f"{PERCENT * sigma:g}" for sigma in sigmas])
    highest, low = float(np.nanmax(ds["amplification"].to_numpy())), float(np.nanmin(ds["amplification"].to_numpy()))
    low = min(1.0, low)
    panel.set(xlabel="standard deviation of the mistuning [%]", ylabel="amplification", xlim=(-0.5, len(sigmas) - 0.5))
    top = _draw_bound(panel, bound, highest, low, rubs=not ds.attrs.get("linear"))
    panel.set_ylim(low - 0.06 * (top - low), top + 0.06 * (top - low))
    panel.tick_params(axis="x", which="both", length=0)
    legend_above(panel)


def _draw_bound(panel: Axes, bound: float, highest: float, low: float, rubs: bool) -> float:
    """The upper end of the axis, with Whitehead's line unless it would press the patterns to the bottom."""
    words = f"Whitehead (linear, one mode per blade): {bound:.3g}"
    top = max(bound, highest)
    is_far = highest - low < LEAST_SHARE * (bound - low)
    if is_far:
        words = f"{words},\nbeyond this axis"
        top = low + ROOM_FOR_WORDS * max(highest - low, 1e-3)
    else:
        panel.axhline(bound, **BOUND_STYLE)
    words += ("; " if is_far else "\n") + "this ring rubs" if rubs else ""
    note: Properties = {
        "xytext": (-3, -2),
        "textcoords": "offset points",
        "ha": "right",
        "va": "top",
        "fontsize": 6.5,
    }
    panel.annotate(words, (1, top), xycoords=("axes fraction", "data"), **note)
    return top


def _draw_quantiles(panel: Axes, place: float, ds: xr.Dataset, color: str, first: bool) -> None:
    """The quantiles of one group, each with its 95 % interval; a missing end is left out."""
    value, low, high = (ds[name].to_numpy() for name in ("quantile", "quantile_low", "quantile_high"))
    low, high = np.where(np.isfinite(low), low, value), np.where(np.isfinite(high), high, value)
    bars: Properties = {"color": color, "lw": 0, "elinewidth": 0.9, "capsize": 2.2, "capthick": 0.9, "ms": 3.5}
    for i in np.flatnonzero(np.isfinite(value)):
        errors = [[max(value[i] - low[i], 0)], [max(high[i] - value[i], 0)]]
        beside = place + (i - (len(value) - 1) / 2) * QUANTILE_DISTANCE
        label = f"{PERCENT * float(ds['share'][i]):g} % are below" if first else None
        panel.errorbar([beside], [value[i]], errors, fmt=QUANTILE_MARKERS[i], zorder=3, label=label, **bars)


def _draw_mistuned_amplitudes(panel: Axes, shown: MistunedContent) -> None:
    """The largest amplitude of all blades over the values: of the tuned row, the median pattern and the worst one."""
    ds, axis, unit, (design, sigma, pattern) = shown
    of_sigma = ds.isel(design=design, sigma=sigma)
    level = of_sigma["amplification"].to_numpy()
    middle = int(np.nanargmin(np.abs(level - np.nanmedian(level))))
    curves: list[tuple[str, xr.DataArray, Properties]] = [
        ("tuned", ds["tuned_amplitude"], {"color": INK, "lw": 1.0}),
        ("median pattern", of_sigma["amplitude"].isel(pattern=middle), {"color": BLUE, "lw": 0.9}),
        ("worst of those drawn", of_sigma["amplitude"].isel(pattern=pattern), {"color": ORANGE, "lw": 0.9}),
    ]
    if "searched_amplitude" in ds:
        curves.append(("worst by gradient", ds["searched_amplitude"], {"color": RED, "lw": 0.9, "ls": (0, (3, 1))}))
    for label, amplitude, appearance in curves:
        panel.plot(axis.values, unit.factor * _over_directions(amplitude), label=label, **appearance)
    panel.set(xlabel=axis.label, ylabel=unit.label, xlim=axis.values[[0, -1]])
    panel.set_ylim(bottom=0)
    legend_above(panel)


def _over_directions(amplitude: xr.DataArray) -> PlotArray:
    """The largest amplitude of all directions; NaN where all lanes stopped."""
    level = amplitude.transpose("direction", "value").to_numpy()
    largest = np.where(np.isfinite(level), level, -np.inf).max(axis=0)
    return np.where(np.isfinite(largest), largest, np.nan)


def _draw_pattern(panel: Axes, shown: MistunedContent) -> None:
    """The mistuning of each blade in the worst pattern: that of a search, else of those drawn."""
    ds, (design, sigma, pattern) = shown.ds, shown.worst
    searched = "searched_mistuning" in ds
    at = {"design": design, "sigma": sigma, "pattern": pattern}
    deviation = (ds["searched_mistuning"] if searched else ds["mistuning"].isel(at)).to_numpy()
    blades = np.arange(len(deviation))
    color = RED if searched else ORANGE
    kind = "worst by gradient" if searched else "worst of those drawn"
    panel.bar(blades, PERCENT * deviation, width=0.7, color=color, label=kind)
    panel.axhline(0, color=INK, lw=0.6)
    panel.set(xlabel="blade", ylabel="mistuning [%]")
    legend_above(panel)
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))


def _align_mistuned(figure: AnyFigure, axes: Mapping[str, Axes], shown: MistunedContent) -> None:
    figure.align_ylabels([*axes.values()])


MISTUNED_PANELS = (
    Panel("amplification", _draw_amplification, 1.5),
    Panel("amplitude", _draw_mistuned_amplitudes, 1.3),
    Panel("pattern", _draw_pattern, 0.7),
)
