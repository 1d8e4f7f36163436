"""The pictures of results of all kinds: the registry of their pages, and the one function that draws them."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import matplotlib as mpl
import matplotlib.style
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import LineCollection, QuadMesh
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, LogFormatter, LogLocator, MaxNLocator

from jaxshroud.plotting.page import Page, Panel, figure_of
from jaxshroud.plotting.plot_amplitude import response_page
from jaxshroud.plotting.plot_attractors import attractors_page, basins_page
from jaxshroud.plotting.plot_branch import branch_page
from jaxshroud.plotting.plot_campbell import campbell_page
from jaxshroud.plotting.plot_diagnosis import diagnosis_page, power_page
from jaxshroud.plotting.plot_fit import fit_page
from jaxshroud.plotting.plot_mistuned import mistuned_page
from jaxshroud.plotting.plot_orbit import lyapunov_page, orbit_page
from jaxshroud.plotting.plot_run import run_page
from jaxshroud.plotting.plot_sensitivity import gradient_page, scatter_page
from jaxshroud.plotting.plot_sweep import sweep_page
from jaxshroud.plotting.plot_trade import trade_page
from jaxshroud.plotting.plot_tuning import robustness_page, tuning_page
from jaxshroud.plotting.style import (
    GREY,
    STYLE,
    AnyFigure,
    Appearance,
    as_is,
    fit_title,
    new_figure,
    show_message,
    typeset,
)
from jaxshroud.scene.checks import InputError

# Kind of a result -> the function that makes its page from its content, the appearance and options of its own.
PAGES: dict[str, Callable[..., Page]] = {
    "trajectory": run_page,
    "sweep": sweep_page,
    "response": response_page,
    "power": power_page,
    "diagnosis": diagnosis_page,
    "orbit": orbit_page,
    "lyapunov": lyapunov_page,
    "branch": branch_page,
    "attractors": attractors_page,
    "basins": basins_page,
    "gradient": gradient_page,
    "scatter": scatter_page,
    "fit": fit_page,
    "tuned": tuning_page,
    "robustness": robustness_page,
    "trade": trade_page,
    "campbell": campbell_page,
    "mistuned": mistuned_page,
}
# Kinds of results.
CURVES = ("trajectory", "sweep", "response", "power", "lyapunov", "branch", "campbell", "mistuned")
BEHIND = 0.5  # zorder of a picture behind another
FEWEST_TICKS = 3


def picture(
    kind: str,
    content: object,
    ax: Axes | None = None,
    panel: str | None = None,
    /,
    *,
    over: tuple[str, Any] | None = None,
    **options: object,
) -> Figure:
    """A result as a page of panels, or one panel of it.

    Args:
        kind: The kind of the result: one of `PAGES`.
        content: The result as its page takes it.
        ax: Draw one panel there, by default the first.
        panel: Draw only this panel.
        over: The kind and the content of another result, drawn behind this one in grey.
        options: Fields of `Appearance`, and options of the page.

    Raises:
        ValueError: There is no such picture or panel, an option of the whole figure is given with `ax`, or the other
            result cannot be drawn behind this one.
    """
    if kind not in PAGES:
        raise InputError(f"There is no picture of a result of the kind {kind!r}.")
    appearance = Appearance()._replace(**{name: options.pop(name) for name in Appearance._fields if name in options})
    if kind == "branch" and over is not None and over[0] == "sweep":
        options["over"] = over[1]
        over = None
    page = PAGES[kind](content, appearance, **options)
    if over is not None:
        page = _over(page, kind, PAGES[over[0]](over[1], appearance, **options), over[0])
    if ax is not None:
        _draw_alone(page, panel, ax, appearance)
        return figure_of(ax)
    page = page if panel is None else page.only(panel)
    with mpl.rc_context(STYLE | page.rc), _style_context(appearance.style):
        figure = new_figure(page.title, *page.size, appearance)
        if page.nothing:
            return show_message(figure, page.nothing)
        page.draw_on(figure)
        _set_xlabel(figure.axes, appearance)
        for axes in figure.axes:
            fit_title(axes)
            if page.set_ticks:
                set_ticks(axes)
    return figure


def _over(page: Page, kind: str, behind: Page, other_kind: str) -> Page:
    """The page with the lines of another of its kind, in grey, behind its own.

    Raises:
        ValueError: They are not curves of one kind, or there is nothing to draw.
    """
    if other_kind != kind or kind not in CURVES:
        raise InputError(f"`over`: two results of one kind have a picture ({', '.join(CURVES)}), not these.")
    if behind.nothing:
        raise InputError(f"`over`: {behind.nothing}")
    others = {panel.name: panel for panel in behind.single or behind.panels}

    def with_other(panel: Panel) -> Panel:
        other = others.get(panel.name)
        return panel if other is None else panel._replace(draw=partial(_draw_both, panel, other, behind.content))

    def finish(figure: AnyFigure, axes: Mapping[str, Axes], content: Any) -> None:
        page.finish(figure, axes, content)
        for ax in axes.values():
            ax.set_xlim(_union(ax.get_xlim(), ax.dataLim.intervalx))

    return replace(
        page,
        panels=[*map(with_other, page.panels)],
        single=[*map(with_other, page.single)],
        title=f"{page.title}; grey: {behind.title.removeprefix(page.title).removeprefix(', but ')}",
        finish=finish,
    )


def _draw_both(panel: Panel, other: Panel, behind: object, ax: Axes, content: object) -> None:
    """Draw a panel over another, which is grey, on axes that show both.

    Raises:
        ValueError: The panels are no curves, or their axes differ.
    """
    before = set(ax.get_children())
    other.draw(ax, behind)
    for artist in set(ax.get_children()) - before:
        if isinstance(artist, QuadMesh):
            raise InputError("`over`: panels of colours cannot be drawn over one another; choose another `panel`.")
        if isinstance(artist, Line2D | LineCollection):
            artist.set(color=GREY, label="_", zorder=BEHIND)
            if isinstance(artist, Line2D):
                artist.set(markeredgecolor=GREY)
        else:
            artist.remove()
    for container in ax.containers:
        container.set_label("_")
    labels = _axis_labels(ax)
    x = ax.get_xlim()
    y = ax.get_ylim()
    ax.set_autoscale_on(True)
    panel.draw(ax, content)
    if labels != _axis_labels(ax):
        raise InputError(f"`over`: the axes differ ({', '.join(labels)}); give a common `unit`, or one `panel`.")
    ax.set(xlim=_union(ax.get_xlim(), x), ylim=_union(ax.get_ylim(), y))


def _axis_labels(ax: Axes) -> list[str]:
    """The labels of both axes, and those of ticks that a panel has set."""
    ticks = ax.get_xticklabels() if isinstance(ax.xaxis.get_major_locator(), FixedLocator) else []
    return [ax.get_xlabel(), ax.get_ylabel(), *(tick.get_text() for tick in ticks)]


def _union(one: Sequence[float], other: Sequence[float]) -> tuple[float, float]:
    """The limits that contain both of two, which ascend."""
    return min(one[0], other[0]), max(one[1], other[1])


def _draw_alone(page: Page, name: str | None, ax: Axes, appearance: Appearance) -> None:
    """Draw one panel on axes of the user's own figure.

    Raises:
        ValueError: There is no such panel, or an option of the whole figure is given.
    """
    panel = page.panel(name)
    if page.nothing:
        ax.text(0.5, 0.5, page.nothing, ha="center", va="center", transform=ax.transAxes)
    else:
        assert page.content is not None
        panel.draw(ax, page.content)
    for option in ("width", "style"):
        if getattr(appearance, option) is not None:
            raise InputError(f"`{option}` belongs to the figure; leave it out, or leave `ax` out.")
    if appearance.title is not None:
        ax.set_title(typeset(as_is(appearance.title)))
    _set_xlabel([ax], appearance)


@contextmanager
def _style_context(path: str | os.PathLike[str] | None) -> Iterator[None]:
    """A context with the matplotlib style that a user asks for."""
    with ExitStack() as stack:
        try:
            stack.enter_context(matplotlib.style.context([] if path is None else os.fspath(path)))
        except OSError:
            raise InputError(f"{path}: not a style of matplotlib; give the name of one, or a file") from None
        yield


def _set_xlabel(axes: list[Axes], appearance: Appearance) -> None:
    """Set the x label that was requested, if the picture has a single x axis."""
    labelled = [ax for ax in axes if ax.get_xlabel()]
    if appearance.xlabel is None or not labelled:
        return
    if len({ax.get_xlabel() for ax in labelled}) > 1:
        raise InputError("This picture has several x axes; label one of its panels, drawn alone.")
    for ax in labelled:
        ax.set_xlabel(typeset(as_is(appearance.xlabel)))


def set_ticks(axes: Axes) -> None:
    """Set at least three ticks on every axis that has a scale."""
    for axis in (axes.xaxis, axes.yaxis):
        locator = axis.get_major_locator()
        if isinstance(locator, MaxNLocator):
            locator.set_params(min_n_ticks=FEWEST_TICKS)
            for nbins in (5, FEWEST_TICKS):
                if axis is axes.xaxis and _is_crowded(axes):
                    locator.set_params(nbins=nbins)
        elif isinstance(locator, LogLocator) and _count_visible_ticks(axis) < FEWEST_TICKS:
            axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(LogFormatter(labelOnlyBase=True, minor_thresholds=(0, 0)))


def _is_crowded(axes: Axes) -> bool:
    """Whether the labels of the x axis take more than two thirds of its length."""
    locs = axes.xaxis.get_majorticklocs()
    box = axes.get_window_extent()
    letters = sum(map(len, axes.xaxis.get_major_formatter().format_ticks(list(locs))))
    size = float(mpl.rcParams["xtick.labelsize"]) * axes.figure.dpi / 72
    return letters * 0.6 * size > 2 / 3 * box.width


def _count_visible_ticks(axis: Axis) -> int:
    low, high = sorted(axis.get_view_interval())
    return sum(low <= at <= high for at in axis.get_majorticklocs())
