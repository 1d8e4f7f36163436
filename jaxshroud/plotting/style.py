"""What all pictures share: sizes, style, colours, labels of numbers, titles, and the saving of figures."""

import os
import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from html import escape, unescape
from io import BytesIO
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple, TypedDict

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure
from matplotlib.rcsetup import cycler
from numpy.typing import NDArray

from jaxshroud.io.files import write
from jaxshroud.io.scene_numbers import key_label
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.derived_inputs import alternative_keys
from jaxshroud.scene.keys import ALL_KEYS, key_stem, parse_key
from jaxshroud.scene.layout import PAIR
from jaxshroud.scene.title import CHANGE_SEPARATOR, subject_of

GREEK = "alpha|beta|gamma|zeta|theta|phi|omega|tau|mu|sigma"
SYMBOL = re.compile(rf"(?<![\w\\])(?:({GREEK}|[A-Za-z])_({GREEK}|\w{{1,2}})|({GREEK}))(?!\w)")
UNIT_POWER = re.compile(r"\b([a-z]+)\^(-?\d+(?:\.\d+)?)\b")
DECIMAL = re.compile(r"(?<![\w.\\])(\d+(?:\.\d+)?)e([+-]?)0*(\d+)\b")
FORMULA_END = re.compile(r"(?<!\\)\$")  # either end
ENTRY = r"[A-Za-z]\w*(?:\[\d+\](?:\.\w+(?:\[\d+\])?)?)?"  # of a table of a scene
KEY = re.compile(rf"\b((?:{'|'.join(sorted({key.partition('.')[0] for key in ALL_KEYS}))})\.{ENTRY})")
KEY_NAMES = {row.parts[1] for row in ALL_KEYS.values()}
OVER, AVERAGED_PERIODS, DIAGRAM_QUANTITIES = " over ", "n", ("x_1", "P_d")  # in titles that announce a diagram


def as_is(text: str) -> str:
    """Text from outside for matplotlib, which draws its dollars."""
    return text.replace("$", r"\$")


def typeset(text: str) -> str:
    """Text with its symbols, powers of units and powers of ten set as formulas; existing formulas stay unchanged."""
    parts = FORMULA_END.split(text)
    for i in range(0, len(parts), 2):
        plain = SYMBOL.sub(lambda match: f"${_formula(*match.groups())}$", parts[i])
        plain = UNIT_POWER.sub(r"\1$^{\2}$", plain)
        parts[i] = DECIMAL.sub(lambda match: rf"${match[1]} \times 10^{{{match[2].strip('+')}{match[3]}}}$", plain)
    return "$".join(parts)


def markup(text: str) -> str:
    """Text as HTML with formulas as in `typeset`; its dollars are shown, and keys of a scene are set as code."""
    return "$".join(map(_markup_between_dollars, text.split("$")))


def _markup_between_dollars(text: str) -> str:
    parts = KEY.split(re.sub(r"\b[A-Za-z](?= / \w)", r"$\g<0>$", text))  # every second part is a key
    written = [escape(part).replace("P_d_worst", "$P_{d,worst}$") for part in parts[::2]]
    parts[::2] = [_as_html(typeset(part)).replace("+-", "&plusmn;") for part in written]
    parts[1::2] = [f"<code>{part}</code>" for part in parts[1::2]]
    return "".join(parts)


def _as_html(text: str) -> str:
    """Text with formulas as HTML."""
    parts = text.split("$")
    for i in range(1, len(parts), 2):
        formula = re.sub(r"_(\w)", r"_{\1}", parts[i].replace(r"\times", "&times;"))
        formula = re.sub(r"(?<![\\&\w])([A-Za-z])(?![A-Za-z\d;])|\\([A-Za-z]+)", _letter, formula)
        parts[i] = re.sub(r"([_^])\{([^{}]*)\}", lambda match: _shifted(*match.groups()), formula)
    return "".join(parts)


def _letter(match: re.Match[str]) -> str:
    return f"<i>{match[1] or f'&{match[2]};'}</i>"


def _shifted(sign: str, text: str) -> str:
    tag = {"_": "sub", "^": "sup"}[sign]
    return f"<{tag}>{text.replace('-', '&minus;')}</{tag}>"


def unicode_text(text: str) -> str:
    """Text with Greek letters and subscripts as Unicode characters, for titles without markup."""
    text = re.sub(rf"(?<!\w)({GREEK})(?![A-Za-z])", lambda match: unescape(f"&{match[1]};"), text)
    return re.sub(r"(?<=\b\w)_(\d)\b", lambda match: chr(ord("₀") + int(match[1])), text)


BEFORE_UNIT = r"(?<=\d) (?=(?:N|kN|Hz|rad|rpm|mm|um|μm|m|kg|g|%|°)(?!\w))|(?<=\d N) (?=m(?!\w))"  # a blank that stays


def wrapped(text: str, width: int) -> str:
    """Text in as few lines of at most `width` visible characters as it takes, alike in length; formulas are whole."""
    lines = _lines_of(text, width)
    narrowest = next(fewer for fewer in range(1, width + 1) if len(_lines_of(text, fewer)) == len(lines))
    return "\n".join(_lines_of(text, narrowest))


def _lines_of(text: str, width: int) -> list[str]:
    lines = [""]
    length = 0
    for word in re.findall(rf"(?:\\\$|\$(?:\\\$|[^$])*\$| = |{BEFORE_UNIT}|[^\s$])+", text):
        size = _visible_length(word)
        if length and length + 1 + size > width:
            lines = [*lines, ""]
            length = 0
        lines[-1] += f" {word}" if length else word
        length += size + (length > 0)
    return lines


def _visible_length(text: str) -> int:
    """The number of characters of a text with formulas that take place."""
    return len(re.sub(r"\\\w+", "a", text).translate({ord(c): None for c in "${}_^"}))


def fit_title(panel: Axes) -> None:
    """Break the title of a panel that is not laid out yet where it would be wider than the panel."""
    location = mpl.rcParams["axes.titlelocation"]
    text = panel.get_title(loc=location)
    if not text:
        return
    title = panel.set_title(text, loc=location)
    room = TITLE_ROOM * panel.get_window_extent().width
    letters = _visible_length(text)
    while title.get_window_extent().width > room and letters > FEWEST_LETTERS:
        letters -= 1
        title.set_text(wrapped(text, letters))


def _formula(base: str | None, below: str | None, alone: str | None) -> str:
    def greek(word):
        return rf"\{word}" if re.fullmatch(GREEK, word) else word

    return greek(alone) if alone else f"{greek(base or '')}_{{{greek(below or '')}}}"


def fitting_title(title: str, keys: Iterable[str] = (), shows: Collection[str] = ()) -> str:
    """The part of a title that holds for a picture: of "Fig. 9: x_1 over gamma, but M_0 = 1 N m" all, some or nothing.

    Args:
        title: The title of a scene: its origin, what the article's figure shows of it, and the numbers that were
            changed.
        keys: The numbers on the axes of the picture.
        shows: The quantities that it shows over these: "x_1", "P_d".

    Returns:
        The title without values of numbers that are on an axis, and without what the picture does not show.
    """
    varied = {parse_key(key)[0].parts[1] if key_stem(key) in ALL_KEYS else key for key in keys}
    varied |= {{"k": "gamma", "gamma": "k"}.get(name, name) for name in varied}
    varied |= {other.split(".")[1] for key in keys for other in alternative_keys(key_stem(key))}
    heading, _, changes = title.partition(CHANGE_SEPARATOR)
    subject, colon, claim = heading.partition(": ")
    is_single_point = bool(varied) and "=" in claim and OVER not in claim
    if not _is_true(subject if colon else heading, varied, shows):
        heading = ""
    elif is_single_point or not _is_true(claim, varied, shows):
        heading = subject_of(heading)
    fixed = ", ".join(
        change for change in changes.split(", ") if change.partition(" = ")[0].removeprefix("initial ") not in varied
    )
    return as_is(CHANGE_SEPARATOR.join(filter(None, (heading, fixed))))


def _is_true(text: str, varied: set[str], shows: Collection[str]) -> bool:
    """Whether the text announces a diagram that is shown over varied numbers, and gives none of these a value."""
    shown, _, over = text.partition(OVER)
    over, comma, rest = over.partition(",")
    announced = _names_in([AVERAGED_PERIODS, *(name for name in KEY_NAMES if len(name) > 1)], over)
    if announced and not (announced & varied and _names_in(DIAGRAM_QUANTITIES, shown) <= set(shows)):
        return False
    return not any(
        f"{name} =" in text or (len(name) > 1 and _names_in([name], shown + comma + rest)) for name in varied
    )


def _names_in(names: Collection[str], text: str) -> set[str]:
    return {name for name in names if re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text)}


INCH = 25.4  # [mm]
FEWEST_LETTERS = 8  # of a line of a title
TITLE_ROOM = 0.85  # of the width that a panel has before the figure is laid out, which takes some of it for labels
Properties = dict[str, Any]  # of artists of matplotlib, as keyword arguments
COLUMN_WIDTH, PAGE_WIDTH = 88 / INCH, 140 / INCH  # one and one and a half columns [inch]
# Colours after Okabe and Ito, which colour-blind readers tell apart.
INK, GREY, BLUE, ORANGE, SKY, PINK = "#1a1a1a", "#8c8c8c", "#0072B2", "#E69F00", "#56B4E9", "#CC79A7"
GREEN, RED, YELLOW, DARK, PALE = "#009E73", "#D55E00", "#F0E442", "#4d4d4d", "#b8b8b8"  # pale: not settled
COLOURS = (BLUE, ORANGE, GREEN, PINK, SKY, RED, DARK, YELLOW)  # of what has no colour of its own
COLOURED_MARKS = list(zip((BLUE, ORANGE, GREEN, PINK, RED, SKY), "osD^vP", strict=True))
STYLE: Any = {
    **dict.fromkeys(("font.size", "axes.titlesize", "figure.titlesize"), 8),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 7),
    **dict.fromkeys(("xtick.direction", "ytick.direction"), "in"),
    "xtick.major.pad": 5,  # keeps the first label clear of that of the y axis
    **{"axes.titlelocation": "left", "axes.linewidth": 0.6, "hatch.linewidth": 0.4},
    **{"legend.frameon": False, "legend.handlelength": 1.2, "legend.columnspacing": 1.2},
    "axes.prop_cycle": cycler(color=COLOURS),
    **{"pdf.fonttype": 42, "svg.fonttype": "none"},  # text stays text
}
NO_LAYOUT: Any = {"figure.autolayout": False, "figure.constrained_layout.use": False}
DOTS_PER_INCH = 200
# Key of the scene -> symbol, words, unit, units per SI unit.
QUANTITIES = {row.name: (row.symbol, row.label, *row.shown) for row in ALL_KEYS.values()}
STOPPED_STYLE: Properties = {
    "facecolor": "#ededed",
    "edgecolor": "#9c9c9c",
    "hatch": "//////",
}  # of lanes without numbers

PER_MICRO, PER_MILLI = 1e6, 1e3
LENGTHS = {"m": ("m", 1.0), "mm": ("mm", 1e3), "um": ("µm", 1e6)}  # unit of length -> its symbol, units per metre

TIGHT_LEGEND: Properties = {"handlelength": 0.8, "handletextpad": 0.3, "columnspacing": 0.6, "borderaxespad": 0.1}

PlotArray = NDArray[np.float64]
IntegerArray = NDArray[np.integer[Any]]
BoolArray = NDArray[np.bool_]
AnyFigure = Figure | SubFigure


class AppearanceOptions(TypedDict, total=False):
    """The fields of `Appearance` as keyword arguments."""

    title: str | None
    xlabel: str | None
    unit: str | None
    width: float | None
    style: str | os.PathLike[str] | None


class Appearance(NamedTuple):
    """The appearance of a picture that a user asks for; None leaves a choice to the picture."""

    title: str | None = None  # "" for none
    xlabel: str | None = None
    unit: str | None = None  # of displacements and of lengths that are varied: one of `LENGTHS`, or "gap"
    width: float | None = None  # [mm]
    style: str | os.PathLike[str] | None = None  # a matplotlib style: a file or a name

    def inches(self, usual: float) -> float:
        """The width, by default the `usual` one [inch]."""
        return usual if self.width is None else self.width / INCH


DEFAULT_APPEARANCE = Appearance()


class Picture(Figure):
    """A figure that notebooks show as a picture even without pyplot."""

    def _repr_png_(self) -> bytes:
        return figure_content(self, "png")


def new_figure(title: str, width: float, height: float, appearance: Appearance = DEFAULT_APPEARANCE) -> Figure:
    """An empty figure of `width` by `height` [inch], or of the width that the appearance asks for."""
    width = appearance.inches(width)
    title = typeset(title if appearance.title is None else as_is(appearance.title))
    figure = Picture(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(wrapped(title, round(15 * width)))
    return figure


def show_message(figure: Figure, text: str) -> Figure:
    """The figure, made flat, with a message in place of a picture."""
    figure.set_figheight(1.5)
    figure.text(0.5, 0.45, text, ha="center", va="center", color=INK)
    return figure


MOST_COLUMNS = 6  # of a legend


def legend_below(figure: AnyFigure, handles: Sequence[Artist]) -> None:
    """Add a legend below the panels, in as few rows as fit, and these alike."""
    for rows in range(max(ceil(len(handles) / MOST_COLUMNS), 1), len(handles) + 1):
        columns = ceil(len(handles) / rows)
        legend = figure.legend(handles=list(handles), loc="outside lower center", ncols=columns)
        if columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            return
        legend.remove()


def shade(figure: Figure, low: float, high: float) -> None:
    """Shade the range between two values of x in every panel."""
    for panel in figure.axes:
        panel.axvspan(low, high, color=SKY, alpha=0.25, lw=0, zorder=0)


def quantity(
    key: str,
    appearance: Appearance = DEFAULT_APPEARANCE,
    unit: str = "SI",
    names: Sequence[str] = PAIR.names,
    words: str = "",
) -> tuple[str, float]:
    """The axis label of a number of a scene, and its factor from SI units; an unknown key gets the given unit.

    `names` are those of the blades; `words` are the label without its unit, where they are known.
    """
    stem = key_stem(key)
    if stem not in ALL_KEYS:
        return as_is(f"{key} [{unit}]" if unit else key), 1.0
    row = ALL_KEYS[stem]
    unit, factor = row.shown
    if row.unit == "m" and appearance.unit in LENGTHS:
        unit, factor = LENGTHS[appearance.unit]
    label = words or key_label(key, names)
    return f"{label} [{unit}]" if unit else label, float(factor)


def save_figure(figure: Figure, *paths: str | os.PathLike[str], dpi: int = DOTS_PER_INCH) -> None:
    """Write a figure to files of one or more formats, each completely or not at all.

    Args:
        figure: Any figure.
        paths: The files; their suffixes select the formats: .png, .pdf or .svg.
        dpi: Dots per inch of .png.

    Raises:
        ValueError: A suffix is not a format of matplotlib.
        WriteError: A path cannot be written.
    """
    for path in map(Path, paths):
        if not path.suffix:
            raise InputError(f"{path}: a picture needs a suffix, such as .png, .pdf or .svg.")
    with _laid_out(figure, dpi):
        for path in map(Path, paths):
            write(path, figure_content(figure, path.suffix[1:].lower(), dpi))


@contextmanager
def _laid_out(figure: Figure, dpi: int) -> Iterator[None]:
    """Within, the figure keeps one layout: with a layout engine, matplotlib draws every file twice."""
    engine = figure.get_layout_engine()
    dots = figure.dpi
    with mpl.rc_context(STYLE | NO_LAYOUT):
        try:
            if engine is not None and figure.axes:  # as in `Figure.draw`
                figure.dpi = dpi
                engine.execute(figure)
                figure.dpi = dots
                figure.set_layout_engine(None)
            yield
        finally:
            figure.dpi = dots
            figure.set_layout_engine(engine)


def figure_content(figure: Figure, form: str, dpi: int = DOTS_PER_INCH) -> bytes:
    """A figure as the content of a file in a format: "png", "pdf" or "svg"."""
    content = BytesIO()
    with mpl.rc_context(STYLE):  # how vector formats write text is decided when they are written
        figure.savefig(content, format=form, dpi=dpi)
    return content.getvalue()
