"""Panels of how robust a tuned design is; nothing here simulates."""

from collections.abc import Mapping
from math import ceil
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase

from jaxshroud.results.drawing import BLUE, GREY, INK, ORANGE, PLAIN, SKY, WIDE, Look, new_figure, quantity
from jaxshroud.results.look import styled
from jaxshroud.results.words import between, wrapped

ACROSS = 3  # panels in a row
BESIDE = 0.35  # share of the interval's width that is shown on either side
ABOVE = 3.0  # losses shown, in those that may be


def panels_of(robust: Mapping[str, Any]) -> int:
    """How many panels there are: one for each number, and one for the scatter."""
    return len(robust["intervals"]) + bool(robust["scatter"])


def rows_of_panels(robust: Mapping[str, Any]) -> int:
    """In how many rows."""
    return ceil(panels_of(robust) / ACROSS)


@styled
def robustness(data: Mapping[str, Any], *, look: Look = PLAIN) -> Figure:
    """The loss of P_d over each number with its interval, and the scatter of P_d, alone.

    Args:
        data: A tuning as `tune.json` holds it, with `robust`.
        look: What is asked for otherwise.
    """
    figure = new_figure(str(data["title"]), WIDE, WIDE * (0.1 + 0.3 * rows_of_panels(data["robust"])), look)
    draw_robust(figure.add_subfigure(figure.add_gridspec()[0]), data)
    return figure


def draw_robust(figure: FigureBase, data: Mapping[str, Any]) -> None:
    """The loss of P_d over each number with its interval, and the scatter of P_d.

    Args:
        figure: Where to.
        data: A tuning as `tune.json` holds it, with `robust`.
    """
    robust = data["robust"]
    across = min(panels_of(robust), ACROSS)
    panels = figure.subplots(rows_of_panels(robust), across, squeeze=False).ravel()
    told = "each number alone; shaded: loss of $P_d$ up to the dashed line in any condition"
    figure.suptitle(wrapped(told, round(14 * figure.bbox.width / figure.figure.dpi)), x=0.01, ha="left")  # type: ignore[union-attr]
    for panel, (key, within) in zip(panels, robust["intervals"].items(), strict=False):
        _draw_loss(panel, key, within, robust["loss"])
    for panel in panels[::across][: rows_of_panels(robust)]:
        panel.set_ylabel("loss of $P_d$ [points]")
    if robust["scatter"]:
        _draw_scatter(panels[len(robust["intervals"])], robust)
    for panel in panels[panels_of(robust) :]:
        panel.remove()


def _draw_loss(panel: Axes, key: str, within: Mapping[str, Any], loss: float) -> None:
    label, unit = quantity(key)
    looked, lost = (np.array(within[name], float) for name in ("looked", "loss"))
    low, high = within["low"], within["high"]
    panel.axvspan(low * unit, high * unit, color=SKY, alpha=0.25, lw=0, zorder=0)
    panel.axhline(loss, color=ORANGE, ls="--", lw=0.9)
    panel.plot(looked * unit, lost, color=BLUE, lw=0.8, marker="o", ms=1.4)
    panel.plot(within["at"] * unit, 0.0, "*", color=ORANGE, mec=INK, mew=0.5, ms=7, clip_on=False, zorder=5)
    width = (high - low) or (looked[-1] - looked[0]) or abs(high) or 1.0
    panel.set_xlim(
        max(low - BESIDE * width, looked[0] - 0.03 * width) * unit,
        min(high + BESIDE * width, looked[-1] + 0.03 * width) * unit,
    )
    inside = lost[(looked >= low) & (looked <= high) & np.isfinite(lost)]
    panel.set_ylim(min(inside.min(initial=0.0) - 0.1 * loss, -0.3 * loss), ABOVE * loss)
    panel.set_xlabel(label)


def _draw_scatter(panel: Axes, robust: Mapping[str, Any]) -> None:
    P_d = np.sort(np.array(robust["sampled_P_d"], float))
    panel.step(P_d, (np.arange(P_d.size) + 1) / P_d.size, where="post", color=BLUE, lw=0.9)
    panel.axvline(min(robust["nominal_P_d"]), color=GREY, lw=0.9, ls=":")
    if robust.get("at_least") is not None:
        panel.axvline(robust["at_least"], color=ORANGE, ls="--", lw=0.9)
        chance = between(*(robust[name] for name in ("probability", "probability_low", "probability_high")))
        panel.set_title(f"at least {robust['at_least']:g} %:\n{chance}", fontsize=7, color=INK)
    panel.set(xlabel="worst $P_d$ of a draw [%]", ylabel="share of draws below", ylim=(0, 1))
