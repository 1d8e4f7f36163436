"""Pictures of tunings, and of the robustness of the tuned design."""

from collections.abc import Mapping, Sequence
from functools import partial
from math import ceil
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from jaxshroud.io.scene_numbers import key_label
from jaxshroud.plotting.page import Page, Panel, Summary
from jaxshroud.plotting.style import (
    BLUE,
    COLUMN_WIDTH,
    GREY,
    INK,
    ORANGE,
    PINK,
    SKY,
    AnyFigure,
    Appearance,
    PlotArray,
    Properties,
    fitting_title,
    legend_below,
    quantity,
)
from jaxshroud.scene.layout import PAIR
from jaxshroud.scene.quantities import is_reduction, quantity_symbol
from jaxshroud.signals.effects import between

SHARE_LABEL = "share below"
ACROSS, ROBUST_HEIGHT = 2, 1.3  # panels in a row, and the height of a row [inch]
FEW_LOSSES = 40  # values of a number that are joined by a line; more are dots, as their losses jump between motions
INTERVAL_MARGIN = 0.35  # share of the interval's width that is shown on either side
LOSSES_SHOWN = 3.0  # largest loss shown, relative to the permissible one


def robustness_page(data: Summary, appearance: Appearance) -> Page[Summary]:
    """The loss of P_d over each number with its interval, and the scatter of P_d.

    Args:
        data: A tuning as `tune.json` holds it, with `robust`.
        appearance: The requested appearance.
    """
    part = robustness_part(data["robust"])
    size = COLUMN_WIDTH, 0.3 + part.size[1]
    return Page(data, (), fitting_title(str(data["title"]), data["over"]), size, below=part, single=part.panels)


def robustness_part(robust: Summary) -> Page[Summary]:
    """The panels of robustness: one for each number, and one for the scatter; the last fills its row."""
    panels = [Panel(key, partial(_draw_loss, key=key)) for key in robust["intervals"]]
    panels += [Panel("scatter", _draw_P_d_scatter)] * bool(robust["scatter"])
    across = min(len(panels), ACROSS)
    rows = ceil(len(panels) / ACROSS)
    panels[-1] = panels[-1]._replace(columns=across * rows - len(panels) + 1)
    size = COLUMN_WIDTH, 0.6 + ROBUST_HEIGHT * rows
    return Page(robust, panels, "", size, columns=across, finish=_explain_losses)


def _explain_losses(figure: AnyFigure, axes: Mapping[str, Axes], robust: Summary) -> None:
    """Add a heading and a legend, and labels to the left column."""
    figure.suptitle("each number alone, worst condition")
    for panel in [*axes.values()][::ACROSS]:
        if panel.get_ylabel() != SHARE_LABEL:
            panel.set_ylabel("loss [points]")
    losses: list[Artist] = [
        Line2D([], [], color=ORANGE, ls="--", lw=0.9, label="permissible loss"),
        Patch(color=SKY, alpha=0.25, label="within it"),
    ]
    nominal = axes["scatter"].get_legend_handles_labels()[0] if "scatter" in axes else []
    legend_below(figure, [DESIGN_MARK, *losses, *nominal])


def _reduction_symbol(robust: Summary) -> str:
    """What is lost: P_d, or the reduction of another quantity."""
    of = str(robust.get("of", "P_d"))
    return quantity_symbol(of) if is_reduction(of) else f"reduction of {quantity_symbol(of)}"


def _names(data: Summary) -> Sequence[str]:
    """The names of the blades."""
    return data.get("blades", PAIR.names)


def _draw_loss(panel: Axes, robust: Summary, key: str) -> None:
    interval, loss = robust["intervals"][key], robust["loss"]
    label, unit = quantity(key, names=_names(robust))
    values, losses = (np.array(interval[name], float) for name in ("looked", "loss"))
    low, high = interval["low"], interval["high"]
    panel.axvspan(low * unit, high * unit, color=SKY, alpha=0.25, lw=0, zorder=0)
    panel.axhline(loss, color=ORANGE, ls="--", lw=0.9)
    panel.plot(interval["at"] * unit, 0.0, **DESIGN_STYLE)
    width = (high - low) or (values[-1] - values[0]) or abs(high) or 1.0
    panel.set_xlim(
        max(low - INTERVAL_MARGIN * width, values[0] - 0.03 * width) * unit,
        min(high + INTERVAL_MARGIN * width, values[-1] + 0.03 * width) * unit,
    )
    begin, end = panel.get_xlim()
    few = np.count_nonzero((values * unit >= begin) & (values * unit <= end)) <= FEW_LOSSES
    panel.plot(values * unit, losses, ".", color=BLUE, ls="-" if few else "", lw=0.8, ms=3 if few else 1.5, mew=0)
    shown = losses[(values >= low) & (values <= high) & np.isfinite(losses)]
    panel.set_ylim(min(shown.min(initial=0.0) - 0.1 * loss, -0.3 * loss), LOSSES_SHOWN * loss)
    panel.set_xlabel(label)


def _draw_P_d_scatter(panel: Axes, robust: Summary) -> None:
    P_d = np.sort(np.array(robust["sampled_P_d"], float))
    panel.step(P_d, (np.arange(P_d.size) + 1) / P_d.size, where="post", color=BLUE, lw=0.9)
    panel.axvline(min(robust["nominal_P_d"]), color=INK, lw=0.9, ls=":", label="design without scatter")
    if robust.get("at_least") is not None:
        panel.axvline(robust["at_least"], color=ORANGE, ls="--", lw=0.9, label=f"at least {robust['at_least']:g} %")
        chance = between(*(robust[name] for name in ("probability", "probability_low", "probability_high")))
        panel.set_title(f"probability {chance}")
    panel.set(xlabel=f"worst {_reduction_symbol(robust)} of a draw [%]", ylabel=SHARE_LABEL, ylim=(0, 1))


DESIGN_STYLE: Properties = {
    "marker": "*",
    "color": ORANGE,
    "ls": "",
    "mec": INK,
    "mew": 0.5,
    "ms": 8,
    "clip_on": False,
    "zorder": 5,
}
DESIGN_MARK = Line2D([], [], label="tuned design", **DESIGN_STYLE)
STEP_LABEL = "update, then round of samples"
START_STYLE: Properties = {"marker": "o", "color": INK, "lw": 1.0, "mfc": "white", "mec": INK, "mew": 0.6, "ms": 3.5}
ROUNDS_STYLE: Properties = {"marker": ".", "color": INK, "ls": "", "ms": 4}
ROUND_DASHES = (0, (2.5, 1.2))  # dashes of the rounds of samples


class TuningData(NamedTuple):
    """A tuning as `tune.json` holds it, with its paths as arrays."""

    data: Summary
    points: PlotArray  # (updates, starts, keys)
    scores: PlotArray  # (updates, starts)
    best: int  # index of the best path
    rounds: PlotArray  # designs of the rounds of samples, with their scores in the last column


def tuning_page(data: Summary, appearance: Appearance) -> Page[TuningData]:
    """The paths of a tuning on the map of its objective, or key by key if it has no map, and the scores of the paths.

    The best path continues as a dashed line through the rounds of samples around its end, to the tuned design. Of one
    number the picture is the score over its values instead. If the tuning has `robust`, its panels follow below.

    Args:
        data: A tuning as `tune.json` holds it.
        appearance: The requested appearance.
    """
    symbol = quantity_symbol(str(data.get("of", "P_d")))
    title = ": ".join(filter(None, (fitting_title(str(data["title"]), data["over"]), f"{data['goal']} of {symbol}")))
    below = None if data.get("robust") is None else robustness_part(data["robust"])
    points, scores = np.array(data["points"]), np.array(data["scores"], float)
    best = int(np.nanargmax(scores[-1]))
    content = TuningData(data, points, scores, best, _sample_rounds(data, points[-1, best], scores[-1, best]))
    more = 0.0 if below is None else below.size[1]
    if len(data["over"]) == 1:
        values = Panel("values", _draw_values)
        return Page(content, (values,), title, (COLUMN_WIDTH, 3.2 + more), finish=_name_values, below=below)
    paths = Panel("designs", _draw_keys if data["map"] is None else _draw_paths, 3.6)
    size = COLUMN_WIDTH, 4.9 + more
    return Page(content, (paths, Panel("scores", _draw_scores)), title, size, finish=_name_paths, below=below)


def _draw_values(panel: Axes, tuning: TuningData) -> None:
    """The score at all values of one number that were tried, and where the best is."""
    data = tuning.data
    (key, ends), (design,) = *data["over"].items(), data["design"].values()
    label, unit = quantity(key, names=_names(data))
    low, high = data["best_between"][key]
    panel.axvspan(low * unit, high * unit, color=SKY, alpha=0.25, lw=0, zorder=0)
    scan = np.array(data["scanned"], float)[:, 0]
    order = np.argsort(scan)
    scores, half = (np.array(data[name], float)[order] for name in ("scanned_scores", "scanned_ci"))
    panel.errorbar(scan[order] * unit, scores, half, fmt="o-", color=BLUE, ms=3, lw=0.9, capsize=1.5)
    looked = _looked_at(tuning)
    panel.plot(looked[:, 0] * unit, looked[:, 1], **ROUNDS_STYLE)
    panel.plot(design * unit, looked[-1, 1], **DESIGN_STYLE)
    panel.set(xlabel=label, ylabel="score [%]", xscale="log" if ends[0] > 0 else "linear")


def _looked_at(tuning: TuningData) -> PlotArray:
    """The values of one number after the scan, up to the tuned one, with their scores."""
    path = np.column_stack([tuning.points[:, tuning.best], tuning.scores[:, tuning.best]])
    return np.concatenate([path, tuning.rounds])


def _name_values(figure: AnyFigure, axes: Mapping[str, Axes], tuning: TuningData) -> None:
    """Add the legend of the values."""
    del axes
    tried: Properties = {"color": BLUE, "marker": "o", "ms": 3, "lw": 0.9}
    handles: list[Artist] = [Line2D([], [], label="scan, with 95 % intervals", **tried)]
    if np.ptp(_looked_at(tuning)[:, 0]):
        handles.append(Line2D([], [], label="looked at later", **ROUNDS_STYLE))
    legend_below(figure, [*handles, Patch(color=SKY, alpha=0.25, label="the best is between"), DESIGN_MARK])


def _name_paths(figure: AnyFigure, axes: Mapping[str, Axes], tuning: TuningData) -> None:
    """Add the legend of the paths."""
    best: Properties = {"color": BLUE, "lw": 1.2}
    handles: list[Artist] = []
    if tuning.data["map"] is not None:
        handles = [Line2D([], [], label="start and path", **START_STYLE), DESIGN_MARK]
    handles.append(Line2D([], [], label="score of the best path", **best))
    if len(tuning.rounds) > 1:
        handles.append(Line2D([], [], ls=ROUND_DASHES, label="samples at its end", **best))
    if tuning.scores.shape[1] > 1:
        handles.append(Line2D([], [], color=GREY, lw=0.6, label="other paths"))
    legend_below(figure, handles)


def _draw_scores(panel: Axes, tuning: TuningData) -> None:
    """The objective less the penalties along each path."""
    scores, best, rounds = tuning.scores, tuning.best, tuning.rounds
    for i in range(scores.shape[1]):
        panel.plot(scores[:, i], color=BLUE if i == best else GREY, lw=1.2 if i == best else 0.6)
    if len(rounds) > 1:
        update = len(scores) - 1 + np.arange(len(rounds))
        panel.plot(update, rounds[:, -1], color=BLUE, lw=1.2, ls=ROUND_DASHES)
    panel.set(xlabel=STEP_LABEL if len(rounds) > 1 else "update", ylabel="score [%]")
    panel.margins(x=0.01)
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))


def _sample_rounds(data: Summary, end: PlotArray, score: float) -> PlotArray:
    """The designs of the rounds of samples after the end of the best path, with their scores in the last column."""
    first = np.append(end, score)[None]
    rounds = np.column_stack([np.array(data["polished"], float), np.array(data["polished_scores"], float)])
    return np.concatenate([first, rounds])


def _draw_paths(panel: Axes, tuning: TuningData) -> None:
    """All paths on the map of the objective."""
    data, points, best = tuning.data, tuning.points, tuning.best
    (x_key, x_ends), (y_key, y_ends) = data["over"].items()
    (x_label, x_unit), (y_label, y_unit) = (quantity(key, names=_names(data)) for key in (x_key, y_key))
    x, y = np.array(data["map"]["first"]) * x_unit, np.array(data["map"]["second"]) * y_unit
    mesh = panel.pcolormesh(
        x, y, np.array(data["map"]["objective"], float).T, cmap="viridis", shading="nearest", rasterized=True
    )
    panel.figure.colorbar(mesh, ax=panel, label="objective [%]", location="top", aspect=40, pad=0.02)
    for i in range(points.shape[1]):
        path = points[:, i] * [x_unit, y_unit]
        width, size = (1.4, 3.5) if i == best else (0.7, 2.0)
        panel.plot(*path.T, color="white", lw=width + 1.2)
        panel.plot(*path.T, color=INK, lw=width)
        start: Properties = {**START_STYLE, "ms": size, "ls": ""}
        panel.plot(*path[0], **start)
    end = np.array(list(data["design"].values())) * [x_unit, y_unit]
    panel.plot(*end, **DESIGN_STYLE)
    panel.set(xlabel=x_label, ylabel=y_label, xlim=x[[0, -1]], ylim=y[[0, -1]])
    panel.set_xscale("log" if x_ends[0] > 0 else "linear")
    panel.set_yscale("log" if y_ends[0] > 0 else "linear")
    path = tuning.rounds[:, :-1] * [x_unit, y_unit]  # the continuation of the best path
    panel.plot(*path.T, color="white", lw=2.2)
    panel.plot(*path.T, color=INK, lw=1.0, ls=ROUND_DASHES)


def _draw_keys(panel: Axes, tuning: TuningData) -> None:
    """The best path and its rounds of samples, each key on a scale from its lower to its upper bound."""
    data = tuning.data
    path = tuning.points[:, tuning.best]
    rounds = tuning.rounds
    colors = [BLUE, ORANGE, PINK, SKY, INK, GREY]
    for i, (key, (low, high)) in enumerate(data["over"].items()):
        value = np.concatenate([path[:, i], rounds[1:, i]])
        share = np.log(value / low) / np.log(high / low) if low > 0 else (value - low) / (high - low)
        style: Properties = {"color": colors[i % len(colors)], "marker": "" if i < len(colors) else ".", "ms": 3}
        panel.plot(share[: len(path)], label=key_label(key, _names(data)), **style)
        panel.plot(np.arange(len(path) - 1, len(share)), share[len(path) - 1 :], ls=ROUND_DASHES, **style)
    panel.set(xlabel=STEP_LABEL, ylabel="place between the bounds", ylim=(-0.02, 1.02), title="the best path")
    panel.legend(loc="best")
