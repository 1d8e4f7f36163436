"""A page as data: the panels that show a result, their layout, and what is added once they are drawn."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, NamedTuple, TypeVar

from matplotlib.axes import Axes

from jaxshroud.plotting.style import COLUMN_WIDTH, AnyFigure
from jaxshroud.scene.checks import word_argument

PANEL_HEIGHT = 2.5  # of a panel drawn alone [inch]
Summary = Mapping[str, Any]  # the plain values of a result by their names, as its `summary` gives them
Content = TypeVar("Content")  # of a page, prepared once for all its panels


class Panel(NamedTuple, Generic[Content]):
    """One panel of a page."""

    name: str  # by which users ask for it
    draw: Callable[[Axes, Content], None]  # draws the content of the page on the axes, with labels
    height: float = 1.0  # of its row, relative to the other rows
    columns: int = 1  # that it spans


def _add_nothing(figure: AnyFigure, axes: Mapping[str, Axes], content: object) -> None:
    """Add nothing."""


@dataclass(frozen=True)
class Page(Generic[Content]):
    """The picture of one result.

    On axes that a user gives, the first panel is drawn by default.
    """

    content: Content | None  # None only where there is nothing to draw
    panels: Sequence[Panel[Content]]
    title: str
    size: tuple[float, float]  # width and height [inch]
    columns: int = 1
    shared: str = ""  # axes that all panels have in common: "", "x" or "xy"
    finish: Callable[[AnyFigure, Mapping[str, Axes], Content], None] = _add_nothing  # adds legends and further marks
    nothing: str = ""  # the message that replaces the picture where there is nothing to draw
    below: "Page[Any] | None" = None  # a part with a layout of its own, which `size` includes
    single: Sequence[Panel[Content]] = ()  # the panels that can be drawn alone, where these are not `panels`
    set_ticks: bool = True  # at least three on every axis
    rc: Mapping[str, Any] = field(default_factory=dict)  # matplotlib's, over those of the package's style

    def panel(self, name: str | None) -> Panel[Content]:
        """The panel of that name, by default the first.

        Raises:
            ValueError: There is no such panel.
        """
        panels = {panel.name: panel for panel in self.single or self.panels}
        if name is not None:
            word_argument("panel", name, tuple(panels))
        return panels[name or next(iter(panels))]

    def only(self, name: str) -> "Page[Content]":
        """The page with a single panel.

        Raises:
            ValueError: There is no such panel.
        """
        size = self.size[0] if self.columns == 1 else COLUMN_WIDTH, PANEL_HEIGHT
        panel = self.panel(name)._replace(columns=1)
        return replace(self, panels=[panel], size=size, columns=1, finish=_add_nothing, below=None)

    @property
    def rows(self) -> list[list[str]]:
        """The names of the panels in rows of `columns`, with "" where there is no panel."""
        rows: list[list[str]] = [[]]
        for panel in self.panels:
            if len(rows[-1]) + panel.columns > self.columns:
                rows.append([])
            rows[-1] += [panel.name] * panel.columns
        return [row + [""] * (self.columns - len(row)) for row in rows]

    def draw_on(self, figure: AnyFigure) -> None:
        """Draw all panels."""
        if self.below is not None:
            heights = [self.size[1] - self.below.size[1], self.below.size[1]][-1 - bool(self.panels) :]
            parts = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False).ravel()
            self.below.draw_on(parts[-1])
            figure = parts[0]
        if not self.panels:
            return
        assert self.content is not None
        heights = {panel.name: panel.height for panel in self.panels}
        axes = figure.subplot_mosaic(
            self.rows,  # type: ignore[arg-type]
            sharex="x" in self.shared,
            sharey="y" in self.shared,
            height_ratios=[heights[row[0]] for row in self.rows],
            empty_sentinel="",
        )
        for panel in self.panels:
            panel.draw(axes[panel.name], self.content)
        if self.shared:
            for ax in axes.values():
                ax.label_outer()
        self.finish(figure, axes, self.content)
