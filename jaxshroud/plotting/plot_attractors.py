"""Pictures of coexisting attractors and of their basins."""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from jaxshroud.plotting.page import LEAST_SPAN, Page, Panel, legend_above, parameter_axis, scale_of, title_of
from jaxshroud.plotting.style import (
    COLOURED_MARKS,
    COLOURS,
    COLUMN_WIDTH,
    GREY,
    INK,
    PALE,
    PER_MICRO,
    QUANTITIES,
    STOPPED_STYLE,
    AnyFigure,
    Appearance,
    Properties,
    legend_below,
)
from jaxshroud.scene.keys import Motion

N_COLOURS = len(COLOURS)  # attractors with a colour of their own; the others share the last
NARROWEST, WIDENING = 0.8, 0.7  # width of the line of the last orbit, and what each earlier one is wider [pt]
CHAOS_WIDTH = 0.4  # of the line of an aperiodic attractor, which crosses itself
DASHES: Any = ("-", (0, (6, 2)), (0, (3, 2)), (0, (1, 1.5)))  # orbits nearly the same are seen through each other
POINT_STYLE: Properties = {"marker": "o", "ls": "", "mfc": "white", "mec": INK, "mew": 0.7, "ms": 3.5, "zorder": 3}
LETTER_STYLE: Properties = {"textcoords": "offset points", "ha": "center", "va": "center", "zorder": 4, "fontsize": 7}
LETTER_STYLE |= {"path_effects": [withStroke(linewidth=2, foreground="white")]}
LETTER_PLACES = ((6, 5), (-6, 5), (6, -5), (-6, -5), (0, 8), (0, -8))  # about the point of an attractor [pt]
SHARE_LIMITS = -0.04, 1.04  # a mark at 0 or 1 is whole
MOST_FREE = 2.0  # times the largest amplitude: larger ones without contact would hide the differences


class AttractorsData(Protocol):
    """The attributes of attractors, each with a row for each attractor; see `results.attractors.Attractors`."""

    data: xr.Dataset
    kind: np.ndarray
    share: np.ndarray
    share_low: np.ndarray
    share_high: np.ndarray
    P_d: np.ndarray
    P_d_ci: np.ndarray
    P_d_least: np.ndarray
    P_d_most: np.ndarray
    motion: Motion
    path_x: np.ndarray
    path_v_x: np.ndarray
    label: np.ndarray  # of each start
    gap: float

    @property
    def names(self) -> list[str]:
        """The names of the attractors."""
        ...

    @property
    def worst(self) -> int | None:
        """The index of the attractor with the smallest P_d."""
        ...


class BasinsData(AttractorsData, Protocol):
    """The attributes of basins."""

    @property
    def plane(self) -> tuple[str, str]:
        """The keys of the two numbers that span the plane."""
        ...

    @property
    def at_strobe(self) -> np.ndarray:
        """The place of each attractor in the plane, (attractors, 2)."""
        ...


def colour(attractor: int) -> str:
    """The colour of an attractor, by its index."""
    return COLOURS[min(attractor, N_COLOURS - 1)]


def _line_width(i: int, count: int) -> float:
    """The width of line `i` of `count`, so that each is seen below the later ones."""
    return NARROWEST + WIDENING * (min(count, N_COLOURS) - 1 - min(i, N_COLOURS - 1))


def _mark_point(panel: Axes, attractors: AttractorsData, i: int, at: Any) -> None:
    """The Poincaré point of an attractor, with its letter."""
    panel.plot(*at, **POINT_STYLE)
    place = LETTER_PLACES[i % len(LETTER_PLACES)]
    panel.annotate(attractors.names[i].partition(":")[0], tuple(at), place, **LETTER_STYLE)


def attractors_page(attractors: AttractorsData, appearance: Appearance) -> Page[AttractorsData]:
    """The orbits of attractors, the shares of starts that lead to them, and their P_d; of a row the amplitudes."""
    nothing = "" if len(attractors.share) else "no attractor was found"
    title = title_of(attractors.data)
    if "x_peak" in attractors.data:
        return Page(attractors, ROW_MOTION_PANELS, title, (COLUMN_WIDTH, 2.9), nothing=nothing)
    size = COLUMN_WIDTH, 4.2
    return Page(attractors, ATTRACTOR_PANELS, title, size, columns=2, finish=_share_rows, nothing=nothing)


def _share_rows(figure: AnyFigure, axes: Mapping[str, Axes], attractors: AttractorsData) -> None:
    """Name the attractors only once, at the left panel of those with a row for each attractor; explain the marks."""
    axes["P_d"].sharey(axes["shares"])
    axes["P_d"].tick_params(labelleft=False)
    legend_below(figure, [Line2D([], [], color=GREY, label="orbit", lw=1.5), POINT_HANDLE])


def _draw_orbits(panel: Axes, attractors: AttractorsData) -> None:
    """The path of the first blade, and its Poincaré point; earlier orbits are drawn wider, below later ones."""
    scale = scale_of(np.asarray(attractors.gap))
    count = len(attractors.share)
    for i in range(count):
        x = attractors.path_x[i] * scale.factor
        name = attractors.names[i]
        is_aperiodic = attractors.kind[i] == 2
        width = CHAOS_WIDTH if is_aperiodic else _line_width(i, count)
        dashes = "-" if is_aperiodic else DASHES[i % len(DASHES)]
        style: Properties = {"color": colour(i), "lw": width, "ls": dashes, "zorder": 2 - 0.5 * is_aperiodic}
        panel.plot(x, attractors.path_v_x[i], label=name, **style)
        _mark_point(panel, attractors, i, (attractors.motion.x[i, 0] * scale.factor, attractors.motion.v_x[i, 0]))
    panel.set(xlabel=scale.label("1"), ylabel="$v_{x1}$ [m/s]")


POINT_HANDLE = Line2D([], [], label="Poincaré point", **POINT_STYLE)


def _set_rows(panel: Axes, attractors: AttractorsData) -> np.ndarray:
    """Set a row for each attractor, the first on top."""
    rows = np.arange(len(attractors.share))
    panel.set(yticks=rows, yticklabels=attractors.names, ylim=(len(rows) - 0.5, -0.5))
    return rows


def _draw_shares(panel: Axes, attractors: AttractorsData) -> None:
    for i in _set_rows(panel, attractors).tolist():
        errors = [[attractors.share[i] - attractors.share_low[i]], [attractors.share_high[i] - attractors.share[i]]]
        panel.errorbar([attractors.share[i]], [i], xerr=errors, fmt="o", ms=3, color=colour(i), capsize=2, lw=0.8)
    panel.set(xlabel="share of starts", xlim=SHARE_LIMITS)


def _draw_attractor_power(panel: Axes, attractors: AttractorsData) -> None:
    for i in _set_rows(panel, attractors).tolist():
        style: Properties = {"color": colour(i), "lw": 0.8}
        low = attractors.P_d_least[i] - attractors.P_d_ci[i]
        high = attractors.P_d_most[i] + attractors.P_d_ci[i]
        panel.plot([low, high], [i, i], **style)
        panel.plot([attractors.P_d[i]], [i], "o", ms=3, mfc=colour(i) if i != attractors.worst else "white", **style)
    panel.margins(x=0.15)
    low, high = panel.get_xlim()
    middle, half = (low + high) / 2, max(high - low, LEAST_SPAN) / 2
    panel.set(xlabel="$P_d$ [%] (worst: hollow)", xlim=(middle - half, middle + half))


def _draw_motion_amplitudes(panel: Axes, attractors: AttractorsData) -> None:
    """The amplitude of each blade on the most frequent motions, and without contact unless that is far larger."""
    ds = attractors.data
    blades = ds["blade"].to_numpy()
    peaks = PER_MICRO * ds["x_peak"].to_numpy()
    free = PER_MICRO * ds["x_free"].to_numpy()[0]
    for i, (color, marker) in enumerate(COLOURED_MARKS[: len(peaks)]):
        label = f"motion {i + 1}: $P_d$ = {float(ds['P_d'][i]):.4g} %"
        panel.plot(blades, peaks[i], marker, ls="-", lw=0.7, ms=4 - 0.4 * i, color=color, label=label)
    top, most = (float(np.nanmax(levels, initial=0.0)) for levels in (peaks, free))
    if most < MOST_FREE * top:
        panel.plot(blades, free, "_", ms=9, color=INK, label="without contact")
        top = max(top, most)
    panel.set(xlabel="blade", ylabel="amplitude of $x$ [μm]", ylim=(0, 1.08 * top or 1.0))
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    legend_above(panel)


ATTRACTOR_PANELS = (
    Panel("orbits", _draw_orbits, 2.3, 2),
    Panel("shares", _draw_shares),
    Panel("P_d", _draw_attractor_power),
)
ROW_MOTION_PANELS = (Panel("amplitudes", _draw_motion_amplitudes),)


def basins_page(basins: BasinsData, appearance: Appearance) -> Page[BasinsData]:
    """The attractor to which each start of a plane leads."""
    return Page(basins, BASIN_PANELS, title_of(basins.data), (COLUMN_WIDTH, 3.6), finish=_name_basins)


def _draw_basins(panel: Axes, basins: BasinsData) -> None:
    across, up = (parameter_axis(basins.data[dim]) for dim in basins.data["label"].dims)
    label = np.minimum(basins.label.T, N_COLOURS - 1)
    cells = np.ma.masked_less(label, -1)
    colours = ListedColormap([PALE, *COLOURS])
    panel.patch.set(**STOPPED_STYLE)
    panel.pcolormesh(across.edges, up.edges, cells, cmap=colours, vmin=-1.5, vmax=N_COLOURS - 0.5, rasterized=True)
    panel.set(xlabel=across.label, ylabel=up.label, xlim=across.edges[[0, -1]], ylim=up.edges[[0, -1]])
    for i, at in _places_inside(panel, basins):
        _mark_point(panel, basins, i, at)


BASIN_PANELS = (Panel("basins", _draw_basins),)


def _name_basins(figure: AnyFigure, axes: Mapping[str, Axes], basins: BasinsData) -> None:
    """Add the legend of the attractors."""
    count = min(len(basins.share), N_COLOURS)
    handles: list[Artist] = [Patch(color=colour(i), label=basins.names[i]) for i in range(count)]
    if (basins.label == -1).any():
        handles.append(Patch(color=PALE, label="undecided"))
    if (basins.label == -2).any():
        handles.append(Patch(label="stopped", **STOPPED_STYLE))
    if _places_inside(axes["basins"], basins):
        handles.append(POINT_HANDLE)
    legend_below(figure, handles)


def _places_inside(panel: Axes, basins: BasinsData) -> list[tuple[int, np.ndarray]]:
    """The attractors whose place at the strobe is inside the panel, with this place."""
    places = basins.at_strobe * _factors(basins)
    left, right = panel.get_xlim()
    foot, top = panel.get_ylim()
    return [(i, place) for i, place in enumerate(places) if left <= place[0] <= right and foot <= place[1] <= top]


def _factors(basins: BasinsData) -> list[float]:
    """The factors from SI units to those of the picture, for both axes."""
    return [QUANTITIES[key.split("[")[0]][3] for key in basins.plane]
