"""How a picture looks: what users ask for beyond its own choice, and words set as formulas."""

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import wraps
from typing import Any, ParamSpec

import matplotlib as mpl
import matplotlib.style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, LogLocator, MaxNLocator

from jaxshroud.results.drawing import STYLE, Look
from jaxshroud.results.words import typeset
from jaxshroud.scene.errors import InputError

FEWEST_TICKS = 3
P = ParamSpec("P")


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """A picture in the package's style, with that of its argument `look` over it."""

    @wraps(draw)
    def page(*args: P.args, **kwargs: P.kwargs) -> Figure:
        look: Any = kwargs.get("look", Look())
        with mpl.rc_context(STYLE), _own_style(look.style):
            figure = draw(*args, **kwargs)
            _label(figure.axes, look)
            for panel in figure.axes:
                with_ticks(panel)
        return figure

    return page


@contextmanager
def _own_style(path: str | os.PathLike[str] | None) -> Iterator[None]:
    with ExitStack() as stack:
        try:
            stack.enter_context(matplotlib.style.context([] if path is None else os.fspath(path)))
        except OSError:
            raise InputError(f"{path}: not a style of matplotlib; give the name of one, or a file") from None
        yield


def _label(panels: list[Axes], look: Look) -> None:
    """The x label asked for, where there is one such axis."""
    labelled = [panel for panel in panels if panel.get_xlabel()]
    if look.xlabel is None or not labelled:
        return
    if len({panel.get_xlabel() for panel in labelled}) > 1:
        raise InputError("This picture has several x axes; label one of its panels, drawn alone.")
    for panel in labelled:
        panel.set_xlabel(typeset(look.xlabel))


def on_axes(ax: Axes, look: Look) -> None:
    """What can be asked of a panel that is drawn into a user's own figure.

    Raises:
        ValueError: Something that belongs to the figure is asked for.
    """
    for name in ("width", "style"):
        if getattr(look, name) is not None:
            raise InputError(f"`{name}` belongs to the figure; leave it out, or leave `ax` out.")
    if look.title is not None:
        ax.set_title(typeset(look.title))
    _label([ax], look)


def with_ticks(panel: Axes) -> None:
    """At least three ticks on every axis that has a scale."""
    for axis in (panel.xaxis, panel.yaxis):
        locator = axis.get_major_locator()
        if isinstance(locator, MaxNLocator):
            locator.set_params(min_n_ticks=FEWEST_TICKS)
            if axis is panel.xaxis and _crowded(panel):
                locator.set_params(nbins=5)
        elif isinstance(locator, LogLocator) and _seen(axis) < FEWEST_TICKS:
            axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(LogFormatter(labelOnlyBase=True, minor_thresholds=(0, 0)))


def _crowded(panel: Axes) -> bool:
    """Whether the labels of the x axis take more than two thirds of it."""
    locs, box = panel.xaxis.get_majorticklocs(), panel.get_window_extent()
    letters = sum(map(len, panel.xaxis.get_major_formatter().format_ticks(list(locs))))
    size = float(mpl.rcParams["xtick.labelsize"]) * panel.figure.dpi / 72
    return letters * 0.6 * size > 2 / 3 * box.width


def _seen(axis: Any) -> int:
    """How many of its ticks are in view."""
    low, high = sorted(axis.get_view_interval())
    return sum(low <= at <= high for at in axis.get_majorticklocs())
