"""Campbell diagrams: natural frequencies and the lines of engine orders over the speed."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from jaxshroud.plotting.page import Page, Panel
from jaxshroud.plotting.style import (
    BLUE,
    COLUMN_WIDTH,
    GREY,
    INK,
    ORANGE,
    AnyFigure,
    Appearance,
    Properties,
    fitting_title,
    legend_below,
)
from jaxshroud.scene.units import RPM

APART: Properties = {"color": BLUE, "ls": "-", "lw": 1.1}
IN_CONTACT: Properties = {"color": ORANGE, "ls": (0, (4, 2)), "lw": 1.1}
CROSSING_SIZES = {"apart": 4.5, "stuck": 2.6, "sliding": 2.6}  # sizes: where both have one frequency, both are seen
FACES = ("stuck", "sliding")  # faces on each other: sliding ones are shown where the model has no friction
HEADROOM = 1.06  # of the axis of frequencies over what it has to show
NEAR = 2.5  # times what engine orders reach: families below that are shown, crossed or not
SMALL_NOTE: Properties = {"textcoords": "offset points", "fontsize": 6, "color": INK}
FAMILY_NAME: Properties = {**SMALL_NOTE, "xycoords": ("axes fraction", "data"), "xytext": (7, 1.5), "zorder": 2.5}
FAMILY_NAME |= {"path_effects": [withStroke(linewidth=1.5, foreground="white")]}
ORDER_NUMBER: Properties = {**SMALL_NOTE, "xycoords": "axes fraction", "annotation_clip": False}
AT_RIGHT: Properties = {"xytext": (2, 0), "ha": "left", "va": "center"}
AT_TOP: Properties = {"xytext": (0, 1), "ha": "center", "va": "bottom"}
NUMBER_ROOM = 0.035  # of the length of an axis, between the numbers of engine orders
LABEL_ROOM = 0.055  # of the height of the axis, which a label takes


class CampbellData(NamedTuple):
    """What a Campbell diagram shows."""

    ds: xr.Dataset
    styles: dict[str, Properties]  # of the states of contact that are shown
    top: float  # end of the axis of frequencies [Hz]


def campbell_page(ds: xr.Dataset, appearance: Appearance) -> Page[CampbellData]:
    """Natural frequencies of blades apart and stuck, the lines of engine orders, and their crossings.

    Args:
        ds: A `Campbell` result.
        appearance: The appearance asked for.
    """
    touching = [name for name in FACES if name in ds["contact"].to_numpy()]
    content = CampbellData(ds, {"apart": APART, **{name: IN_CONTACT for name in touching[:1]}}, _top(ds))
    title = fitting_title(str(ds.attrs.get("title", "")), ["drive.omega"])
    return Page(content, CAMPBELL_PANELS, title, (COLUMN_WIDTH, 3.6), finish=_add_campbell_legend)


def _top(ds: xr.Dataset) -> float:
    """The end of the axis of frequencies [Hz]: above what engine orders reach, and the families not far from there."""
    reached = float(ds["engine_order"].max()) * ds.attrs["stop"] / (2 * np.pi)
    frequency = ds["frequency"].to_numpy()
    if "frequency_at_speed" in ds:
        curves = ds["frequency_at_speed"].to_numpy()
        frequency = curves[np.isfinite(curves)]
    return HEADROOM * max(min(reached, frequency.max()), frequency[frequency < NEAR * reached].max(initial=0.0))


def _draw_frequencies(panel: Axes, data: CampbellData) -> None:
    start, stop, own = (data.ds.attrs[name] * RPM for name in ("start", "stop", "speed"))
    panel.set(xlim=(start, stop), ylim=(0, data.top), xlabel="speed [rpm]", ylabel="frequency [Hz]")
    _draw_orders(panel, data)
    panel.axvline(own, color=INK, lw=0.8, ls=":")
    labelled: list[float] = []
    for contact, style in data.styles.items():
        families = data.ds.isel(family=np.flatnonzero(data.ds["contact"].to_numpy() == contact))
        _draw_lines(panel, families, style)
        speeds = families["crossing_speed"].to_numpy() * RPM
        excited = families["excited"].to_numpy() if "excited" in families else 1
        family, order = np.nonzero((speeds >= start) & (speeds <= stop) & (excited == 1))
        orders = families["engine_order"].to_numpy()[order]
        at = speeds[family, order], orders * speeds[family, order] / RPM / (2 * np.pi)
        panel.plot(*at, "o", ms=CROSSING_SIZES[contact], mew=0, color=style["color"], zorder=3)
        _name_families(panel, families, labelled, data.top)


def _draw_lines(panel: Axes, families: xr.Dataset, style: Properties) -> None:
    """Draw the frequencies of families over the speed: curves where they depend on it."""
    if "frequency_at_speed" not in families:
        for frequency in families["frequency"].to_numpy():
            panel.axhline(frequency, **style)
        return
    for curve in families["frequency_at_speed"].to_numpy():
        panel.plot(families["rotor_speed"].to_numpy() * RPM, curve, **style)


def _left_ends(families: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Where the line of each family begins: its place on the axis of speeds from 0 to 1, and its frequency."""
    if "frequency_at_speed" not in families:
        return np.zeros(families.sizes["family"]), families["frequency"].to_numpy()
    curves = families["frequency_at_speed"].to_numpy()
    speeds = families["rotor_speed"].to_numpy()
    first = np.isfinite(curves).argmax(axis=1)
    return (speeds[first] - speeds[0]) / (speeds[-1] - speeds[0]), curves[np.arange(len(curves)), first]


def _name_families(panel: Axes, families: xr.Dataset, labelled: list[float], top: float) -> None:
    """Name the lines at their left ends, where there is room; `labelled` has the frequencies named so far."""
    for name, left, frequency in zip(families["family"].to_numpy(), *_left_ends(families), strict=True):
        if not frequency <= top or any(abs(frequency - other) < LABEL_ROOM * top for other in labelled):
            continue
        labelled.append(frequency)
        panel.annotate(
            str(name).replace(", either blade", "").replace(", each blade", ""), (left, frequency), **FAMILY_NAME
        )


def _draw_orders(panel: Axes, data: CampbellData) -> None:
    """Draw the lines of the engine orders, each with its number where it leaves the picture, if there is room."""
    start, stop, own = (data.ds.attrs[name] for name in ("start", "stop", "drive_order"))
    orders = sorted(data.ds["engine_order"].to_numpy(), key=lambda order: order != own)
    ends = []
    for order in orders:  # the drive's own first, which has its number in any case
        per_speed = order / (2 * np.pi)
        end = min(stop, data.top / per_speed)
        if end <= start:
            continue
        style: Properties = {"color": INK, "lw": 1.0} if order == own else {"color": GREY, "lw": 0.6}
        panel.plot([start * RPM, end * RPM], [start * per_speed, end * per_speed], zorder=1.5, **style)
        place = (end - start) / (stop - start), end * per_speed / data.top
        if all(max(abs(place[0] - x), abs(place[1] - y)) > NUMBER_ROOM for x, y in ends):
            ends.append(place)
            panel.annotate(f"{order:g}", place, **(AT_RIGHT if end == stop else AT_TOP), **ORDER_NUMBER)


CAMPBELL_PANELS = (Panel("frequency", _draw_frequencies),)


def _add_campbell_legend(figure: AnyFigure, axes: Mapping[str, Axes], data: CampbellData) -> None:
    own = data.ds.attrs["drive_order"]
    handles = [Line2D([], [], **style, label=name) for name, style in data.styles.items()]
    handles.append(Line2D([], [], color=INK, lw=1.0, label=f"order {own:g}, the drive's"))
    if data.ds.sizes["engine_order"] > 1:
        handles.append(Line2D([], [], color=GREY, lw=0.6, label="other orders"))
    handles.append(Line2D([], [], color=INK, lw=0.8, ls=":", label="the scene's speed"))
    legend_below(figure, handles)
