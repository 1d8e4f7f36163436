"""Pictures of the influence of a scene's numbers: tornado charts, and the distribution of P_d."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes

from jaxshroud.io.scene_numbers import key_label, layout_in
from jaxshroud.plotting.page import Page, Panel, Summary
from jaxshroud.plotting.style import (
    BLUE,
    COLUMN_WIDTH,
    GREY,
    INK,
    ORANGE,
    AnyFigure,
    Appearance,
    PlotArray,
    Properties,
    fitting_title,
    legend_below,
)
from jaxshroud.scene.layout import PAIR
from jaxshroud.scene.quantities import quantity_symbol, unit_of
from jaxshroud.signals.effects import Effect, effects

MOST_BARS = 24
LONG_LABEL = 40  # letters of a label of numbers, symbols as formulas: beside it the axis below has less room
# unit -> as pictures show it, and how many of these it is
STRESS_UNITS = {"Pa": ("MPa", 1e-6)}
EFFECT_UNITS = {
    "%": ("percentage points", 1.0),
    "m^4": ("m$^4$", 1.0),
    "m": ("µm", 1e6),
    "rad": ("mrad", 1e3),
} | STRESS_UNITS
DRAW_UNITS = {"m^4": ("m$^4$", 1.0), "m": ("mm", 1e3)} | STRESS_UNITS


class Bars(NamedTuple):
    """The effects that a tornado chart shows."""

    of: str  # the quantity that they change, a `Quantity`
    effects: list[Effect]
    left_out: int  # number of smaller effects that are not shown
    blades: tuple[str, ...] = PAIR.names

    @property
    def labels(self) -> list[str]:
        """The label of each number, with its change where that is not 1 %."""
        per = ("" if e.per == "1 %" else f" (per {e.per})" for e in self.effects)
        return [f"{short_label(e.key, self.blades)}{change}" for e, change in zip(self.effects, per, strict=True)]


def gradient_page(data: Summary, appearance: Appearance) -> Page[Bars]:
    """The effect of 1 % more of each number (1 degree for angles), the largest on top.

    Args:
        data: `of`, `title`, and `value`, `ci` and `number` by their keys, as `gradient.json` holds them; `blades`.
        appearance: The requested appearance.
    """
    changes = [e for e in effects(data["value"], data["ci"], data["number"]) if np.isfinite(e.change)]
    changes = [e for e in changes if e.change] or changes
    bars = Bars(data["of"], changes[:MOST_BARS], len(changes[MOST_BARS:]), tuple(data.get("blades", PAIR.names)))
    size = COLUMN_WIDTH, 1.1 + 0.21 * max(len(bars.effects), 2)
    title = fitting_title(str(data.get("title", "")))
    return Page(bars, GRADIENT_PANELS, title, size, nothing="" if bars.effects else "there is no derivative")


def _draw_bars(panel: Axes, bars: Bars) -> None:
    shown = bars.effects
    rows = np.arange(len(bars.effects))
    unit, per_si = EFFECT_UNITS[unit_of(bars.of)]
    change = np.array([e.change for e in shown]) * per_si
    panel.barh(rows, change, color=np.where(change > 0, BLUE, ORANGE), height=0.7)
    ci = np.array([e.ci for e in shown]) * per_si
    if ci.any():
        panel.errorbar(change, rows, xerr=ci, fmt="none", ecolor=INK, elinewidth=0.8, capsize=1.5)
    panel.axvline(0.0, color=INK, lw=0.7)
    panel.set_yticks(rows, bars.labels)
    panel.tick_params(axis="y", length=0, which="both")
    fold = "\n" if max(map(len, bars.labels)) > LONG_LABEL else " "
    more = f", {bars.left_out} smaller ones left out" if bars.left_out else ""
    panel.set(xlabel=f"{quantity_symbol(bars.of)} per 1 % more{fold}[{unit}]{more}", ylim=(len(shown) - 0.4, -0.6))


GRADIENT_PANELS = (Panel("effects", _draw_bars),)


def short_label(key: str, names: Sequence[str]) -> str:
    """The label of a number where room is short: a blade with a name is called by its name alone."""
    return key_label(key, names).replace(" blade $", " $")


BEYOND_SHARE = {"<": "goes below 0", ">": "goes above 1"}  # mark -> its meaning


def scatter_page(ds: xr.Dataset, appearance: Appearance) -> Page[xr.Dataset]:
    """The share of draws below each P_d, and the share of each number in the variance, alone and in all.

    The intervals of the shares are estimates that may extend beyond 0 or 1; they are cut off there with a mark.

    Args:
        ds: A scatter.
        appearance: The requested appearance.
    """
    keys = [str(key) for key in ds["key"].to_numpy()]
    title = fitting_title(str(ds.attrs.get("title", "")), keys)
    height = 0.3 * len(keys)
    panels = Panel("draws", _draw_draws, 2.0), Panel("shares", _draw_variance_shares, 0.4 + height)
    nothing = "" if np.isfinite(ds["P_d"]).any() else "every draw stopped"
    return Page(ds, panels, title, (COLUMN_WIDTH, 2.9 + height), finish=_add_scatter_legend, nothing=nothing)


def _draw_draws(panel: Axes, ds: xr.Dataset) -> None:
    """The share of draws below each P_d."""
    of = ds.attrs.get("of", "P_d")
    unit, per_si = DRAW_UNITS.get(unit_of(of), (unit_of(of), 1.0))
    level = np.sort(ds["P_d" if of == "P_d" else "level"].to_numpy()) * per_si
    panel.step(level, (np.arange(level.size) + 1) / level.size, where="post", color=BLUE, label="draws")
    at_least = ds.attrs.get("at_least")
    if at_least is not None:
        low, high = ds.attrs["probability_low"], ds.attrs["probability_high"]
        chance = f"probability of at least {at_least:g} %: {ds.attrs['probability']:.0%} ({low:.0%} to {high:.0%})"
        panel.axvline(at_least, color=ORANGE, ls="--", lw=0.9, label=chance)
    panel.set(xlabel=f"{quantity_symbol(of)} [{unit}]", ylabel="share of draws below", ylim=(0, 1))


def _draw_variance_shares(panel: Axes, ds: xr.Dataset) -> None:
    """The share of each number in the variance, alone and in all."""
    rows = np.arange(ds.sizes["key"], dtype=float)
    for name, offset, color in (("first", -0.18, GREY), ("total", 0.18, BLUE)):
        share, low, high = (ds[n].to_numpy() for n in (name, f"{name}_low", f"{name}_high"))
        label = {"first": "alone", "total": "in all"}[name]
        panel.barh(rows + offset, np.clip(share, 0, 1), height=0.34, color=color, label=label)
        _draw_intervals(panel, rows + offset, low, high)
    panel.set_yticks(rows, _share_labels(ds))
    panel.tick_params(axis="y", length=0, which="both")
    of = quantity_symbol(ds.attrs.get("of", "P_d"))
    panel.set(xlabel=f"share of the variance of {of}", ylim=(len(rows) - 0.5, -0.5), xlim=(0, 1))


def _share_labels(ds: xr.Dataset) -> list[str]:
    """The label of each number."""
    names = layout_in(ds).names
    return [short_label(str(key), names) for key in ds["key"].to_numpy()]


def _add_scatter_legend(figure: AnyFigure, axes: Mapping[str, Axes], ds: xr.Dataset) -> None:
    legend_below(figure, [*axes["draws"].get_legend_handles_labels()[0], *_distinct_handles(axes["shares"])])


def _draw_intervals(panel: Axes, rows: PlotArray, low: PlotArray, high: PlotArray) -> None:
    """Draw estimated intervals, cut off at 0 and 1 with a mark."""
    ends = np.clip([low, high], 0, 1)
    panel.hlines(rows, *ends, color=INK, lw=0.8)
    for end, is_cut, marker in zip(ends, (low < 0, high > 1), "<>", strict=True):
        panel.plot(end[~is_cut], rows[~is_cut], "|", color=INK, ms=3, mew=0.8)
        if is_cut.any():
            style: Properties = {"color": INK, "ms": 3.5, "mew": 0, "clip_on": False, "zorder": 5}
            panel.plot(end[is_cut], rows[is_cut], marker, label=f"95 % interval {BEYOND_SHARE[marker]}", **style)


def _distinct_handles(panel: Axes) -> list[Artist]:
    """The handles of a panel's legend, each label once."""
    handles, labels = panel.get_legend_handles_labels()
    return list(dict(zip(labels, handles, strict=True)).values())
