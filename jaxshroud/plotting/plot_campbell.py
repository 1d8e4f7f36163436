"""Campbell diagrams: natural frequencies and the lines of engine orders over the speed."""

from collections.abc import Iterable, Mapping
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
OWN_ORDER: Properties = {"color": INK, "lw": 1.3}
OTHER_ORDER: Properties = {"color": GREY, "lw": 0.5}
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
MANY_LINES = 6  # of one motion in one state of contact: more are drawn as a band
BAND_ALPHA = 0.25
END_NUMBER: Properties = {**SMALL_NOTE, "xycoords": "data", "ha": "right", "annotation_clip": True, "zorder": 2.5}
BELOW: Properties = {"xytext": (-1, -1.5), "va": "top"}
ABOVE: Properties = {"xytext": (-1, 1.5), "va": "bottom"}


class CampbellData(NamedTuple):
    """What a Campbell diagram shows."""

    ds: xr.Dataset
    styles: dict[str, Properties]  # of the states of contact that are shown
    top: float  # end of the axis of frequencies [Hz]


def campbell_page(ds: xr.Dataset, appearance: Appearance) -> Page[CampbellData]:
    """Natural frequencies of blades apart and stuck, the lines of engine orders, and their crossings.

    Args:
        ds: A `Campbell` result.
        appearance: The requested appearance.
    """
    drawn = ds["contact"].to_numpy()[np.isfinite(_curves(ds)[1]).any(axis=1)]
    touching = [name for name in FACES if name in drawn]
    styles = {**{name: APART for name in ("apart",) if name in drawn}, **dict.fromkeys(touching[:1], IN_CONTACT)}
    content = CampbellData(ds, styles, _top(ds, styles))
    title = fitting_title(str(ds.attrs.get("title", "")), ["drive.omega"])
    return Page(content, CAMPBELL_PANELS, title, (COLUMN_WIDTH, 3.6), finish=_add_campbell_legend)


def _curves(ds: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Speeds [rpm], and the frequency of each family there (families, speeds); NaN where it is not in that contact."""
    if "frequency_at_speed" in ds:
        return ds["rotor_speed"].to_numpy() * RPM, ds["frequency_at_speed"].to_numpy()
    ends = np.array([ds.attrs["start"], ds.attrs["stop"]]) * RPM
    return ends, np.repeat(ds["frequency"].to_numpy()[:, None], 2, axis=1)


def _lines_of(ds: xr.Dataset, contact: str) -> dict[str, list[int]]:
    """The families of a state of contact by the names of their lines: those of one motion together where many."""
    lines: dict[str, list[int]] = {}
    for i in np.flatnonzero(ds["contact"].to_numpy() == contact):
        lines.setdefault(str(ds["family"].to_numpy()[i]).partition(",")[0], []).append(int(i))
    single = {}
    for motion, members in lines.items():
        if len(members) > MANY_LINES:
            single[motion] = members
        else:
            single |= {str(ds["family"].to_numpy()[i]): [i] for i in members}
    return single


def _top(ds: xr.Dataset, contacts: Iterable[str]) -> float:
    """The end of the axis of frequencies [Hz]: above what engine orders reach, and the families not far from there."""
    reached = float(ds["engine_order"].max()) * ds.attrs["stop"] / (2 * np.pi)
    _, curves = _curves(ds)
    shown = []
    for members in (members for contact in contacts for members in _lines_of(ds, contact).values()):
        frequency = curves[members][np.isfinite(curves[members])]
        shown.append(min(reached, frequency.max(initial=0.0)))
        shown += [*frequency[frequency < NEAR * reached]] if len(members) == 1 else []
    return HEADROOM * max(shown, default=reached)


def _draw_frequencies(panel: Axes, data: CampbellData) -> None:
    start, stop, own = (data.ds.attrs[name] * RPM for name in ("start", "stop", "speed"))
    panel.set(xlim=(start, stop), ylim=(0, data.top), xlabel="speed [rpm]", ylabel="frequency [Hz]")
    _draw_orders(panel, data)
    panel.axvline(own, color=INK, lw=0.8, ls=":")
    labelled: list[float] = []
    speed, curves = _curves(data.ds)
    for contact, style in data.styles.items():
        for name, members in _lines_of(data.ds, contact).items():
            _draw_line(panel, name, speed, curves[members], style, labelled)
            if len(members) > 1:
                _name_ends(panel, data.ds["family"].to_numpy()[members], speed, curves[members])
        families = data.ds.isel(family=np.flatnonzero(data.ds["contact"].to_numpy() == contact))
        speeds = families["crossing_speed"].to_numpy() * RPM
        excited = families["excited"].to_numpy() if "excited" in families else 1
        family, order = np.nonzero((speeds >= start) & (speeds <= stop) & (excited == 1))
        orders = families["engine_order"].to_numpy()[order]
        at = speeds[family, order], orders * speeds[family, order] / RPM / (2 * np.pi)
        panel.plot(*at, "o", ms=CROSSING_SIZES[contact], mew=0, color=style["color"], zorder=3)


def _draw_line(
    panel: Axes, name: str, speed: np.ndarray, curves: np.ndarray, style: Properties, labelled: list[float]
) -> None:
    """Draw a line, or the band of several, with its name at the left end, where there is room.

    `labelled` has the frequencies at which there are names.
    """
    ends = np.fmin.reduce(curves), np.fmax.reduce(curves)  # NaN where all are
    if len(curves) > 1:
        panel.fill_between(speed, *ends, color=style["color"], alpha=BAND_ALPHA, lw=0)
    for end in ends[: len(curves)]:
        panel.plot(speed, end, **style)
    known = np.flatnonzero(np.isfinite(ends[1]))
    if not known.size:
        return
    top = panel.get_ylim()[1]
    frequency = float(ends[1][known[0]]) if len(curves) == 1 else min(ends[1][known[0]], (1 - LABEL_ROOM) * top)
    if not frequency <= top or any(abs(frequency - other) < LABEL_ROOM * top for other in labelled):
        return
    labelled.append(frequency)
    left = (speed[known[0]] - speed[0]) / (speed[-1] - speed[0])
    panel.annotate(name.replace(", either blade", "").replace(", each blade", ""), (left, frequency), **FAMILY_NAME)


def _name_ends(panel: Axes, names: np.ndarray, speed: np.ndarray, curves: np.ndarray) -> None:
    """Write the nodal diameters, or the blades, of both ends of a band at its right end."""
    known = np.flatnonzero(np.isfinite(curves).all(axis=0))
    if not known.size:
        return
    last = curves[:, known[-1]]
    for i, side in ((last.argmin(), BELOW), (last.argmax(), ABOVE)):
        member = str(names[i]).partition(", ")[2].replace("nodal diameter", "ND")
        panel.annotate(member, (speed[known[-1]], last[i]), **side, **END_NUMBER)


def _own_orders(ds: xr.Dataset) -> np.ndarray:
    """The engine orders of the drive."""
    orders = ds["engine_order"].to_numpy()
    return orders[ds["own"].to_numpy() == 1] if "own" in ds else np.array([ds.attrs["drive_order"]])


def _draw_orders(panel: Axes, data: CampbellData) -> None:
    """Draw the lines of the engine orders, each with its number where it leaves the picture, if there is room."""
    start, stop = (data.ds.attrs[name] for name in ("start", "stop"))
    own = _own_orders(data.ds)
    ends = []
    for order in sorted(data.ds["engine_order"].to_numpy(), key=lambda order: order not in own):
        per_speed = order / (2 * np.pi)
        end = min(stop, data.top / per_speed)
        if end <= start:
            continue
        style, weight = (OWN_ORDER, "bold") if order in own else (OTHER_ORDER, "normal")
        panel.plot([start * RPM, end * RPM], [start * per_speed, end * per_speed], zorder=1.5, **style)
        place = (end - start) / (stop - start), end * per_speed / data.top
        if order in own or all(max(abs(place[0] - x), abs(place[1] - y)) > NUMBER_ROOM for x, y in ends):
            ends.append(place)
            at = AT_RIGHT if end == stop else AT_TOP
            panel.annotate(f"{order:g}", place, weight=weight, **at, **ORDER_NUMBER)


CAMPBELL_PANELS = (Panel("frequency", _draw_frequencies),)


def _add_campbell_legend(figure: AnyFigure, axes: Mapping[str, Axes], data: CampbellData) -> None:
    own = [f"{order:g}" for order in _own_orders(data.ds)]
    handles = [Line2D([], [], **style, label=name) for name, style in data.styles.items()]
    handles.append(Line2D([], [], **OWN_ORDER, label=f"order{'s' * (len(own) > 1)} {' and '.join(own)}, the drive's"))
    if data.ds.sizes["engine_order"] > len(own):
        handles.append(Line2D([], [], **OTHER_ORDER, label="other orders"))
    handles.append(Line2D([], [], color=INK, lw=0.8, ls=":", label="the scene's speed"))
    legend_below(figure, handles)
