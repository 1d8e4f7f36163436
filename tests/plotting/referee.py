"""What a referee of a journal would complain of in a picture, found from the places of its texts and legends."""

from itertools import combinations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.text import Text
from matplotlib.transforms import Bbox

SLACK = 1.0  # pixels by which a text may leave its place: hinting


def complaints(figure: Figure) -> list[str]:
    """Texts that are cut at the edge, titles and legends wider than their axes, and texts that touch each other."""
    figure.canvas.draw()
    shown = [(text, text.get_window_extent()) for text in _texts(figure)]
    told = [f"cut: {_name(text)}" for text, box in shown if not _contains(figure.bbox, box)]
    for axes in figure.axes:
        told += [f"wider than its axes: {_name(title)}" for title in _titles(axes) if _overruns(title, axes)]
        legend = axes.get_legend()
        if legend is not None and not _spans(axes.get_window_extent(), legend.get_window_extent()):
            told.append(f"wider than its axes: legend of {[_name(text) for text in legend.get_texts()]}")
    for legend in figure.findobj(Legend):
        own = {id(text) for text in legend.get_texts()}
        box = legend.get_window_extent()
        told += [f"below a legend: {_name(text)}" for text, at in shown if id(text) not in own and _touch(box, at)]
    for (one, box), (other, other_box) in combinations(shown, 2):
        if _touch(box, other_box):
            told.append(f"touch: {_name(one)} and {_name(other)}")
    return told


def _texts(figure: Figure) -> list[Text]:
    """The texts that are seen; tick labels beyond the ends of their axis are not."""
    every = figure.findobj(lambda artist: isinstance(artist, Text) and bool(artist.get_text().strip()))
    hidden = {id(text) for axes in figure.axes for text in _unseen_tick_labels(axes)}
    return [text for text in every if isinstance(text, Text) and text.get_visible() and id(text) not in hidden]


def _unseen_tick_labels(axes: Axes) -> list[Text]:
    labels: list[Text] = []
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]:
            if not (axes.axison and low - 1e-9 * abs(low) <= tick.get_loc() <= high + 1e-9 * abs(high)):
                labels += [tick.label1, tick.label2]
        if not axes.axison:
            labels += [axis.label, axis.offsetText]
    return labels


def _titles(axes: Axes) -> list[Text]:
    return [text for text in (axes.title, *axes.findobj(lambda a: a is axes._left_title)) if text.get_text()]


def _overruns(title: Text, axes: Axes) -> bool:
    return not _spans(axes.get_window_extent(), title.get_window_extent())


def _spans(outer: Bbox, inner: Bbox) -> bool:
    return outer.x0 - SLACK <= inner.x0 and inner.x1 <= outer.x1 + SLACK


def _contains(outer: Bbox, inner: Bbox) -> bool:
    return _spans(outer, inner) and outer.y0 - SLACK <= inner.y0 and inner.y1 <= outer.y1 + SLACK


def _touch(one: Bbox, other: Bbox) -> bool:
    width = min(one.x1, other.x1) - max(one.x0, other.x0)
    return width > SLACK and min(one.y1, other.y1) - max(one.y0, other.y0) > SLACK


def _name(text: Text) -> str:
    return repr(text.get_text())
