"""The styles of the page: its template, the colours of light and dark, and the style of figures."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

from bokeh.layouts import column, row
from bokeh.models import Column, ColumnDataSource, CustomJSTickFormatter, GlyphRenderer, InlineStyleSheet
from bokeh.plotting import figure
from bokeh.themes import Theme
from jinja2 import Environment, Template

from jaxshroud.plotting.plot_sweep import MOTION_COLOURS
from jaxshroud.plotting.style import BLUE, DARK, INK, PALE, SKY
from jaxshroud.scene.keys import Key

HERE = Path(__file__).parent
TOOLS = "xpan,xbox_zoom,xwheel_zoom,reset,save"


class Colours(NamedTuple):
    """The colours of figures in light or in dark."""

    paper: str
    ink: str
    soft: str
    grid: str
    strong: str  # of the left blade's curves
    motions: tuple[str, ...]  # by the places in `MOTION_COLOURS`


LIGHT = Colours("#ffffff", INK, DARK, "#e4e4e4", BLUE, tuple(MOTION_COLOURS.values()))
ON_DARK = {
    DARK: "#d9d9d9",
    PALE: "#5f6670",
    BLUE: "#3b8fd6",
    SKY: "#b5e3ff",
}  # on dark paper
NIGHT = Colours(
    "#16191d", "#ececec", "#b5b8bc", "#31363c", SKY, tuple(ON_DARK.get(c, c) for c in MOTION_COLOURS.values())
)


def page_template() -> Template:
    """The template of the page; what is put into it is text, whatever is in it."""
    return Environment(autoescape=True).from_string(file_text("page.html"))


def styled(**options: Any) -> dict[str, Any]:
    """Arguments of a field, a button or a text, with the style that follows that of the page."""
    return {"stylesheets": [InlineStyleSheet(css=file_text("widgets.css"))], **options}


def wide(**options: Any) -> dict[str, Any]:
    """The same for what is as wide as its part of the page."""
    return styled(sizing_mode="stretch_width", **options)


def file_text(name: str) -> str:
    """The text of a file of this folder."""
    return (HERE / name).read_text("utf-8")


def empty_source(names: Iterable[str], name: str | None = None) -> Any:
    """A source of columns with these names, which are empty."""
    return ColumnDataSource({column: [] for column in names}, name=name)


def above_each_other(*parts: Any, **options: Any) -> Any:
    """Parts of the page below each other."""
    return column(*parts, sizing_mode="stretch_width", **options)


def beside(*parts: Any, **options: Any) -> Any:
    """Parts of the page beside each other, in as many lines as they need."""
    return row(*parts, sizing_mode="stretch_width", styles={"flex-wrap": "wrap"}, **options)


def root(name: str, *parts: Any) -> Any:
    """A root of the page. Its name is its id too: pages are sent before their documents are made."""
    made: Any = Column.__new__(Column, id=name)  # as Bokeh does for what it reads
    made.__init__(name=name, children=list(parts), sizing_mode="stretch_width")
    return made


def figure_theme(colours: Colours) -> Theme:
    """The theme of all figures in light or in dark."""
    axis = {
        **dict.fromkeys(("axis_line_color", "major_tick_line_color"), colours.soft),
        "minor_tick_line_color": None,
        **dict.fromkeys(("major_label_text_color", "axis_label_text_color"), colours.ink),
        **{"axis_label_text_font_style": "normal", "axis_label_text_font_size": "12px"},
        **{"major_label_text_font_size": "11px", "axis_label_standoff": 4},
    }
    clear = {"background_fill_color": colours.paper, "border_fill_color": colours.paper}
    return Theme(
        json={
            "attrs": {
                "Plot": {**clear, "outline_line_color": colours.grid, "min_border_right": 12},
                "Grid": {"grid_line_color": colours.grid},
                "Axis": axis,
                "Title": {"text_color": colours.ink, "text_font_size": "12px", "text_font_style": "normal"},
                "Legend": {
                    **{"label_text_color": colours.ink, "background_fill_color": colours.paper},
                    **{"background_fill_alpha": 0.7, "label_text_font_size": "11px", "border_line_alpha": 0.0},
                    **{"padding": 2, "spacing": 0, "margin": 4, "glyph_width": 14, "glyph_height": 12},
                },
                "ColorBar": {
                    **{"major_label_text_color": colours.ink, "title_text_color": colours.ink},
                    **{"background_fill_color": colours.paper},
                },
            }
        }
    )


Recolour = Callable[[Colours], None]


class Recolouring:
    """What must be passed on when the page changes between light and dark."""

    def __init__(self) -> None:
        self.listeners: list[Recolour] = []

    def line(self, renderer: GlyphRenderer, colour: str) -> GlyphRenderer:
        """A renderer whose line and filling follow a field of `Colours`."""

        def recolour(colours: Colours) -> None:
            for name in ("line_color", "fill_color"):
                if name in renderer.glyph.properties():
                    setattr(renderer.glyph, name, getattr(colours, colour))

        recolour(LIGHT)
        self.listeners.append(recolour)
        return renderer

    def text(self, renderer: GlyphRenderer) -> None:
        """Let the words of a renderer follow the ink."""
        self.listeners.append(lambda colours: setattr(renderer.glyph, "text_color", colours.ink))

    def tell(self, colours: Colours) -> None:
        """Take other colours."""
        for listener in self.listeners:
            listener(colours)


def new_plot(title: str, height: int, x_label: str, y_label: str, name: str, **options: Any) -> Any:
    """A figure of the page's width."""
    labels = {"title": title, "x_axis_label": x_label, "y_axis_label": y_label, "name": name}
    usual: dict[str, Any] = {"height": height, "sizing_mode": "stretch_width", "tools": TOOLS, "min_width": 200}
    plot: Any = figure(**{**labels, **usual, **options})
    plot.toolbar.logo = None
    plot.toolbar.autohide = False
    return plot


def scaled_ticks(axis: Any, factor: float) -> None:
    """Let an axis, or a bar of colours, of numbers in SI units show them in another unit."""
    code = f"const v = tick * {factor!r}; return Math.abs(v) < 1e-12 ? '0' : String(Number(v.toPrecision(6)));"
    axis.formatter = CustomJSTickFormatter(code=code)


def key_html(items: Iterable[tuple[str, str]]) -> str:
    """Words with their colours."""
    keys = (
        f'<span class="key"><i style="background:{colour}" aria-hidden="true"></i>{word}</span>'
        for word, colour in items
    )
    return f'<div class="legend">{"".join(keys)}</div>'


def axis_words(row: Key) -> str:
    """The label of the axis of a key, with its name and its unit."""
    name, unit = row.parts[1], row.shown[0]
    return f"{row.label}{'' if name in row.label.split() else f' {name}'}{f' [{unit}]' if unit else ''}"


def legend_html(present: set[int]) -> str:
    """The colours of period numbers, in words: those at these places of `MOTION_COLOURS`."""
    items = [
        f'<span class="key"><i class="motion{place}" aria-hidden="true"></i>{name}</span>'
        for place, name in enumerate(MOTION_COLOURS)
        if place in present
    ]
    return f'<div class="legend">{"".join(items)}</div>'
