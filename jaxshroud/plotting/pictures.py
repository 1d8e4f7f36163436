"""The pictures of results of all kinds: the registry of their pages, and the one function that draws them."""

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import matplotlib as mpl
import matplotlib.style
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, LogLocator, MaxNLocator

from jaxshroud.plotting.page import Page, figure_of
from jaxshroud.plotting.plot_amplitude import amplitude_page, response_page
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
from jaxshroud.plotting.style import STYLE, Appearance, as_is, fit_title, new_figure, show_message, typeset
from jaxshroud.scene.checks import InputError

# Kind of a result -> the function that makes its page from its content, the appearance and options of its own.
PAGES: dict[str, Callable[..., Page]] = {
    "trajectory": run_page,
    "sweep": sweep_page,
    "amplitude": amplitude_page,
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
FEWEST_TICKS = 3


def picture(
    kind: str, content: object, ax: Axes | None = None, panel: str | None = None, /, **options: object
) -> Figure:
    """A result as a page of panels, or one panel of it.

    Args:
        kind: The kind of the result: one of `PAGES`.
        content: The result as its page takes it.
        ax: Draw one panel there, by default the first.
        panel: Draw only this panel.
        options: Fields of `Appearance`, and options of the page.

    Raises:
        ValueError: There is no such picture or panel, or an option of the whole figure is given with `ax`.
    """
    if kind not in PAGES:
        raise InputError(f"There is no picture of a result of the kind {kind!r}.")
    appearance = Appearance()._replace(**{name: options.pop(name) for name in Appearance._fields if name in options})
    page = PAGES[kind](content, appearance, **options)
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
    """Set the x label that was asked for, if the picture has a single x axis."""
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
            if axis is axes.xaxis and _is_crowded(axes):
                locator.set_params(nbins=5)
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
