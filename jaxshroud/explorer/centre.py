"""The centre of the page: the axis of the diagram, its window and direction, and the map beside it."""

from typing import Any, Protocol

import numpy as np
from bokeh.models import Div, RadioButtonGroup, Select, TextInput

from jaxshroud.explorer.controls import buttons, fault_of
from jaxshroud.explorer.diagram import Window
from jaxshroud.explorer.exploration import Exploration, few_digits, number_fields
from jaxshroud.explorer.messages import note_html
from jaxshroud.explorer.panels import DiagramPanel, MapPanel
from jaxshroud.explorer.saves import OF_A_SERVER
from jaxshroud.explorer.styles import Recolouring, above_each_other, beside, styled, wide
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import Key, parse_key
from jaxshroud.scene.layout import Direction
from jaxshroud.scene.overrides import axis
from jaxshroud.scene.text import read_shown, shown_text

WAYS: dict[str, Direction] = {
    "from rest": "independent",
    "forward": "forward",
    "backward": "backward",
    "all three": "both",
}
USUAL_KEY, USUAL_SECOND = "contact.gamma", "shroud.gap"  # of the axes
LEAST_ZOOM = 1e-9  # of the whole window
SETTLE = 250  # from the last change of the window until it is computed [ms]


class Owner(Protocol):
    """What the centre needs of its page."""

    exploration: Exploration
    document: Any

    def compute_diagram(self) -> None:
        """Compute what the centre shows."""

    def select(self, values: dict[str, float]) -> None:
        """Show the motion at these values."""


class Centre:
    """The centre of the page."""

    def __init__(self, exploration: Exploration, recolouring: Recolouring, owner: Owner):
        self.owner = owner
        self.silent = False
        self.pending = None
        numbers = {n.key.name: n for n in number_fields(exploration.file) if n.value is not None}
        whole = {name: number.ends for name, number in numbers.items()}
        self.whole = {name: Window(name, low, high) for name, (low, high) in whole.items()}
        usual = [*(a.key for a in exploration.file.axes), USUAL_KEY, *numbers]
        own = next(key for key in usual if key in numbers)
        self.window = self.whole[own]
        style = styled()
        self.key = Select(title="diagram over", value=own, options=list(numbers), name="key", width=150, **style)
        self.way = Select(
            title="each value starts", value="from rest", options=list(WAYS), name="direction", width=110, **style
        )
        self.ends = [TextInput(title=title, name=f"window {title}", width=90, **style) for title in ("from", "to")]
        self.wrong = Div(text="", visible=False, **wide())
        self.note = Div(text="", name="note", **wide())
        self.view = RadioButtonGroup(labels=["Diagram", "Map"], active=0, name="view", **style)
        self.diagram = DiagramPanel(recolouring, self._zoomed, self._chosen)
        self.diagram.on_reset(self.show_whole)
        others = sorted((name for name in numbers if name != own), key=USUAL_SECOND.__ne__) or [own]
        self.map = MapPanel(recolouring, others, self._chosen_of_map)
        self._listen()
        beside_it = {"◀ previous": lambda: self._step(-1), "next ▶": lambda: self._step(1)}
        zoom = {"zoom in": lambda: self._scale(0.5), "zoom out": lambda: self._scale(2.0), "whole": self.show_whole}
        self.steps = buttons({**beside_it, **zoom}, name=OF_A_SERVER)
        top = beside(self.view, self.key, self.way, *self.ends, name=OF_A_SERVER)
        self.layout = above_each_other(top, self.wrong, self.diagram.layout, self.map.layout, self.steps, self.note)
        self._show_window(self.window)

    def _listen(self) -> None:
        self.key.on_change("value", lambda attr, old, new: self._take_key(new))
        self.way.on_change("value", lambda attr, old, new: self.owner.compute_diagram())
        self.view.on_change("active", lambda attr, old, new: self._take_view())
        self.map.up.on_change("value", lambda attr, old, new: self._take_view())
        for end in self.ends:
            end.on_change("value", lambda attr, old, new: self._typed())

    # What is chosen

    @property
    def shows_map(self) -> bool:
        """Whether the map is shown, and not the diagram."""
        return self.view.active == 1

    @property
    def direction(self) -> Direction:
        """The direction that is chosen."""
        return WAYS[self.way.value]

    @property
    def windows(self) -> tuple[Window, Window]:
        """The windows of both keys of the map."""
        return self.window, self.whole[self.map.up.value]

    def _take_key(self, key: str) -> None:
        self.map.up.options = [name for name in self.whole if name != key]
        if self.map.up.value == key:
            self.map.up.value = self.map.up.options[0]
        self._take_window(self.whole[key])

    def _take_view(self) -> None:
        of_map = self.shows_map
        self.diagram.layout.visible = not of_map
        self.map.layout.visible = of_map
        self.way.visible = not of_map
        self.note.visible = not of_map
        if of_map:
            self.map.show_windows(*self.windows)
        self.owner.compute_diagram()

    def _take_window(self, window: Window) -> None:
        self._show_window(window)
        if self.shows_map:
            self.map.show_windows(*self.windows)
        self.owner.compute_diagram()

    def show_whole(self) -> None:
        """Show the whole window of the key."""
        self._take_window(self.whole[self.window.key])

    def _show_window(self, window: Window) -> None:
        self.silent = True
        self.window = window
        self.diagram.show_window(window)
        for end, value in zip(self.ends, (window.start, window.stop), strict=True):
            end.value = shown_text(parse_key(window.key)[0], value)
        self.silent = False

    def _typed(self) -> None:
        """Take the ends that were typed: bare numbers are in the unit that is shown."""
        if self.silent:
            return
        wrong = fault_of(self._take_ends)
        self.wrong.update(text=note_html(wrong, wrong=True) if wrong else "", visible=bool(wrong))

    def _take_ends(self) -> None:
        key, file = self.window.key, self.owner.exploration.file
        start, stop = (_end(parse_key(key)[0], end.value) for end in self.ends)
        found = axis(file, key, start=start, stop=stop, num=2)
        low, high = sorted(map(float, found.values))
        self._take_window(Window(key, low, high))

    def _zoomed(self, start: float, stop: float) -> None:
        """Take the window of the tools, once it has come to rest."""
        whole = self.whole[self.window.key]
        span = self.window.stop - self.window.start
        if max(abs(start - self.window.start), abs(stop - self.window.stop)) < 1e-6 * span:
            return
        if self.pending is not None:
            self.owner.document.remove_timeout_callback(self.pending)
        least = LEAST_ZOOM * (whole.stop - whole.start)

        def settle() -> None:
            self.pending = None
            if stop - start > least:
                self._take_window(self._allowed(start, stop))

        self.pending = self.owner.document.add_timeout_callback(settle, SETTLE)

    def _allowed(self, start: float, stop: float) -> Window:
        """A window within the range of its key."""
        number = next(n for n in number_fields(self.owner.exploration.file) if n.key.name == self.window.key)
        low = number.key.range.minimum if not number.key.range.open else min(number.ends[0], stop / 2)
        start = few_digits(number.key, max(start, low))
        stop = few_digits(number.key, min(stop, number.key.range.maximum))
        return Window(self.window.key, start, stop)

    def _scale(self, by: float) -> None:
        """Zoom around the value whose motion is shown, or around the middle."""
        window = self.window
        location = self.diagram.cursors[0].location
        middle = (window.start + window.stop) / 2
        if location is not None and window.start <= float(location) / self.diagram.factor <= window.stop:
            middle = float(location) / self.diagram.factor
        start, stop = middle + by * (window.start - middle), middle + by * (window.stop - middle)
        self._take_window(self._allowed(start, stop))

    # The motion of a value

    def _chosen(self, value: float) -> None:
        values = np.asarray(self.diagram.lanes.data["value"])
        if values.size:
            self.owner.select({self.window.key: float(values[np.argmin(np.abs(values - value))])})

    def _chosen_of_map(self, x: float, y: float) -> None:
        cells, spans = self.map.cells.data, self.windows
        if len(cells["x"]):
            far = [np.abs(cells[n] - v) / (w.stop - w.start) for n, v, w in zip("xy", (x, y), spans, strict=True)]
            at = int(np.argmin(np.hypot(*far)))
            self.owner.select({w.key: float(cells[n][at]) for n, w in zip("xy", spans, strict=True)})

    def _step(self, by: int) -> None:
        """Choose the value beside the one whose motion is shown."""
        values = np.asarray(self.diagram.lanes.data["value"])
        location = self.diagram.cursors[0].location
        if not values.size:
            return
        now = values.size // 2 if location is None else int(np.argmin(np.abs(values * self.diagram.factor - location)))
        self.owner.select({self.window.key: float(values[np.clip(now + by, 0, values.size - 1)])})

    def mark(self, selected: dict[str, float], file: SceneFile) -> None:
        """Mark the value whose motion is shown: that of a click, or the scene's own."""
        table, _, name = self.window.key.partition(".")
        own = file.given_tables.get(table, {}).get(name)
        value = selected.get(self.window.key, own if isinstance(own, int | float) else None)
        self.diagram.show_cursor(None if value is None else float(value))
        if len(selected) == 2:
            self.map.show_mark(*(selected[w.key] for w in self.windows if w.key in selected))

    def show_level(
        self, window: Window, direction: Direction, level: int, added: SweepResult, whole: SweepResult
    ) -> None:
        """Show what a level adds to the diagram."""
        if window != self.window:
            return
        if direction == "independent":
            self.diagram.show_level(level, added, whole)
            words = (
                f"{whole.status.size} values from rest, each {len(whole.period)} periods kept of {whole.period[-1]}."
            )
        else:
            self.diagram.show_directions(whole, direction)
            words = (
                f"{whole.status.shape[-1]} values; each starts where its neighbour ended, so a diagram of other values "
                "is another run."
            )
        self.note.text = note_html(words)


def _end(key: Key, text: str) -> Any:
    """The end of a window that a text gives, in SI units.

    Raises:
        InputError: It is no number.
    """
    try:
        return read_shown(key, text)
    except ValueError as error:
        raise InputError(f"{text} {error}") from None
