"""The page of one tab: what it shows, what follows from a change, and the page as a file."""

from collections.abc import Callable
from functools import partial
from typing import Any

from bokeh.document import Document
from bokeh.events import ClientReconnected, ConnectionLost, DocumentReady
from bokeh.models import CustomJS, Div, Toggle

from jaxshroud.batch.plan import Progress
from jaxshroud.explorer.centre import Centre
from jaxshroud.explorer.controls import Controls
from jaxshroud.explorer.diagram import OF_A_ROW, Amount, Window, diagram
from jaxshroud.explorer.engine import ENDED, WORKERS, Engine, Message
from jaxshroud.explorer.exploration import Exploration
from jaxshroud.explorer.export import Export
from jaxshroud.explorer.jobs import DiagramWish, MapWish, Methods, RunWish, SaveWish, VerdictWish, Wish
from jaxshroud.explorer.messages import motion_html, status_html, verdict_html
from jaxshroud.explorer.run_panel import RunPanel
from jaxshroud.explorer.saves import OF_A_SERVER, static_page, template_variables
from jaxshroud.explorer.styles import (
    LIGHT,
    NIGHT,
    Recolouring,
    above_each_other,
    beside,
    figure_theme,
    page_template,
    root,
    styled,
)
from jaxshroud.scene.checks import StepTooLongError
from jaxshroud.scene.layout import PAIR, Direction
from jaxshroud.verbs.simulate import simulate

FINER = "finer"  # what follows a level that is not the last


class TabPage:
    """The page of one tab."""

    def __init__(
        self,
        document: Document,
        exploration: Exploration,
        accuracy: str,
        methods: Methods,
        engine: Callable[[], Engine] | None = None,
    ):
        """The page, which computes once its tab is there.

        Args:
            document: Of the tab.
            exploration: The scene from the start.
            accuracy: The accuracy from the start.
            methods: The methods of all tabs.
            engine: Gives what computes; None: nothing is computed.
        """
        self.document, self.start, self.exploration, self.methods = document, exploration, exploration, methods
        self.selected, self.results = {}, {}
        self.amount = Amount() if exploration.file.layout == PAIR else OF_A_ROW
        self.take_engine = engine
        self.engine = None
        self.shows = {}
        self.numbers = dict.fromkeys(WORKERS, 0)  # of the last wishes
        self.recolouring = Recolouring()
        in_row = exploration.file.layout != PAIR
        self.controls = Controls(exploration, self.change, accuracy)
        self.controls.reset.on_click(lambda event: self.reset())
        self.controls.accuracy.on_change("value", lambda attr, old, new: self.compute())
        self.centre = Centre(exploration, self.recolouring, self)
        self.motion = RunPanel(self.recolouring, in_row)
        self.export = Export(self)
        self.status = Div(text=status_html("Ready"), **styled(), name="status_text")
        self._add_roots()
        self.workings: dict[str, str] = {}
        self.failures: dict[str, str] = {}
        self.chosen_anew: Exploration | None = None  # the scene for which the method was unstable

    def _add_roots(self) -> None:
        document = self.document
        self.dark = Toggle(label="dark", width=60, **styled())
        self.dark.js_on_change(
            "active", CustomJS(code="document.documentElement.classList.toggle('dark', cb_obj.active)")
        )
        self.dark.on_change("active", lambda attr, old, new: self._recolour(new))
        parts = {
            "status": beside(self.status, beside(self.dark, name=OF_A_SERVER)),
            "left": self.controls.layout,
            "centre": self.centre.layout,
            "right": above_each_other(self.motion.layout, self.export.layout),
        }
        for name, part in parts.items():
            document.add_root(root(name, part))
        document.title = f"{self.heading} · jaxshroud explore"
        document.template = page_template()
        document.template_variables.update(template_variables(self.heading))
        document.theme = figure_theme(LIGHT)
        self.recolouring.tell(LIGHT)
        ready = "if (!document.documentElement.dataset.still) "
        ready += "dark.active = matchMedia('(prefers-color-scheme: dark)').matches"
        document.js_on_event(DocumentReady, CustomJS(args={"dark": self.dark}, code=ready))
        shown = "document.getElementById('lost').style.display = '{}'"
        document.js_on_event(ConnectionLost, CustomJS(code=shown.format("block")))
        document.js_on_event(ClientReconnected, CustomJS(code=shown.format("none")))
        document.on_event(DocumentReady, lambda event: self.compute())

    @property
    def heading(self) -> str:
        """The title of the scene from the start."""
        return heading_of(self.start)

    def _recolour(self, dark: bool) -> None:
        colours = NIGHT if dark else LIGHT
        self.document.theme = figure_theme(colours)
        self.recolouring.tell(colours)

    # Changes

    def change(self, key: str, text: str) -> None:
        """Take another value of a key.

        Raises:
            InputError: The value is wrong.
        """
        self.exploration = self.exploration.changed(key, text)
        self.selected = {name: value for name, value in self.selected.items() if name != key}
        self.controls.show(self.exploration)
        self.compute()

    def reset(self) -> None:
        """Go back to the scene from the start."""
        self.exploration = self.start
        self.selected = {}
        self.controls.show(self.exploration)
        self.compute()

    def select(self, values: dict[str, float]) -> None:
        """Show the motion at these values."""
        self.selected = values
        self.compute_run()

    # Computations

    @property
    def shown(self) -> Exploration:
        """The scene whose motion is shown."""
        shown = self.exploration
        for key, value in self.selected.items():
            shown = shown.changed(key, repr(value))
        return shown

    def compute(self) -> None:
        """Compute all that is shown anew."""
        self.failures = {}
        self.compute_run()
        self.compute_diagram()

    def compute_run(self) -> None:
        """Compute the motion, and then its verdict."""
        try:
            exploration = self.shown
        except Exception as error:
            self._say_failed("run", error)
            return
        self._working("run", "motion")
        self.numbers["verdict"] += 1  # one on the way is out of date
        if self.engine is not None:
            self.engine.send(Message("cancel", "verdict"))
        self.submit("run", RunWish(exploration, self.method, self.amount.motion), partial(self.show_run, exploration))

    def compute_diagram(self) -> None:
        """Compute the diagram, or the map where that is what is shown."""
        centre, method = self.centre, self.method
        self.results.pop("map" if centre.shows_map else "diagram", None)
        self._working("diagram", "choosing the method, or compiling its program")
        if centre.shows_map:
            wish = MapWish(method, centre.windows, self.amount)
            show = partial(self._show_map, *centre.windows)
        else:
            wish = DiagramWish(method, centre.window, centre.direction, self.amount)
            show = partial(self.show_level, centre.window, centre.direction)
        self.submit("diagram", wish, show)

    def compute_verdict(self, exploration: Exploration) -> None:
        """Find the verdict, after all else."""
        self.submit("verdict", VerdictWish(exploration, self.method), self._show_verdict)

    @property
    def method(self) -> tuple[Exploration, str]:
        """The scene and the accuracy for which the method is chosen."""
        return self.exploration, self.controls.accuracy.value

    def submit(self, name: str, wish: Wish, show: Callable[..., None]) -> None:
        """Let a worker of the engine fulfil a wish, in place of an earlier one, and show what is found."""
        if self.take_engine is None:
            return
        if self.engine is None:
            self.engine = self.take_engine()
            self.failures.pop("engine", None)
            self.engine.listen(partial(self.later, self._heard))
        self.numbers[name] += 1
        self.shows[name] = show
        known = None if isinstance(wish, SaveWish) else self.methods.known(*wish.method)
        if known is not None:  # by another tab
            self.engine.send(Message("learn", content=(*self.method, known)))
        self.engine.send(Message("submit", name, self.numbers[name], (wish,)))

    def _heard(self, message: Message) -> None:
        """Take a message of the engine, unless it is about an earlier wish."""
        if message.kind == "chosen":
            self.methods.learn(*message.content)
        elif message.kind == "ended":
            self.engine = None
            self.workings = {}
            self._working("engine", "", ENDED)
        elif message.number == self.numbers[message.worker]:
            if message.kind == "show":
                self.shows[message.worker](*message.content)
            elif message.kind == "progress":
                level, share = message.content
                self._working("diagram", f"{'coarse' if level == 0 else f'finer, level {level}'}, {share:.0%}")
            elif message.worker == "saves":
                self.export.refuse(*message.content)
            else:
                self._say_failed(message.worker, *message.content)

    # What is shown

    def show_run(self, exploration: Exploration, run: Any) -> None:
        """Show the motion of a scene, and then find its verdict."""
        self.results["run"] = run
        self.motion.show(run)
        self.motion.heading.text = motion_html(run, self.selected, exploration.file)
        self.motion.verdict.text = verdict_html(None)
        self.centre.mark(self.selected, exploration.file)
        self.export.show_commands()
        self._working("run", "")
        self.compute_verdict(exploration)

    def show_level(self, window: Window, direction: Direction, level: int, added: Any, whole: Any) -> None:
        """Show a level of the diagram."""
        self.results["diagram"] = whole
        self.centre.show_level(window, direction, level, added, whole)
        self.export.show_commands()
        last = level + 1 == self.amount.levels or direction != "independent"
        self._working("diagram", "" if last else FINER)

    def _show_map(self, across: Window, up: Window, level: int, whole: Any) -> None:
        self.results["map"] = whole
        self.centre.map.show_cells(whole, across, up, level)
        self._working("diagram", "" if level + 1 == self.amount.map_levels else FINER)

    def _show_verdict(self, found: Any) -> None:
        self.results["verdict"] = found
        self.motion.verdict.text = verdict_html(found)

    def _working(self, what: str, words: str, wrong: str = "") -> None:
        """Show what is being done, or what went wrong: that stays until the same is done again."""
        self.workings[what], self.failures[what] = words, wrong
        busy, failed = ("; ".join(f"{n}: {w}" for n, w in of.items() if w) for of in (self.workings, self.failures))
        self.status.text = status_html(busy, failed)

    def _say_failed(self, what: str, error: Exception) -> None:
        accuracy = self.controls.accuracy.value
        if isinstance(error, StepTooLongError) and self.chosen_anew != self.exploration:
            self.chosen_anew = self.exploration
            self.methods.forget(self.exploration, accuracy)
            if self.engine is not None:
                self.engine.send(Message("forget", content=self.method))
            self.compute()
            return
        self._working(what, "", str(error.args[0] if isinstance(error, KeyError) and error.args else error))

    def later(self, call: Callable[..., None], *arguments: Any) -> None:
        """Call this in the thread of the page, which says what fails there."""
        self.document.add_next_tick_callback(partial(self._attempt, call, *arguments))

    def _attempt(self, call: Callable[..., None], *arguments: Any) -> None:
        try:
            call(*arguments)
        except Exception as error:
            self._working("this page", "", str(error))

    def close(self) -> None:
        """End all work."""
        if self.engine is not None:
            self.engine.close()
        self.take_engine = self.engine = None


def heading_of(exploration: Exploration) -> str:
    """The title of the scene, or its name."""
    return exploration.file.title or exploration.file.name


def written_page(exploration: Exploration, accuracy: str, report: Progress) -> bytes:
    """The page of a scene, which needs no server: its coarse diagram from rest, and its own motion.

    Args:
        exploration: The scene.
        accuracy: The accuracy of both.
        report: Called with the lane-periods done, and in all.
    """
    document = Document()
    page = TabPage(document, exploration, accuracy, Methods())
    window = page.centre.window
    method = page.methods.method(exploration, accuracy)
    coarse = diagram(
        exploration.file, window, window.new_values(0, page.amount.values), "independent", page.amount, method, report
    )
    page.show_level(window, "independent", 0, coarse, coarse)
    page.show_run(exploration, simulate(exploration.file, n_periods=page.amount.motion, method=method))
    page.motion.verdict.text = ""
    page.close()
    return static_page(document, page.heading, dark=False)
