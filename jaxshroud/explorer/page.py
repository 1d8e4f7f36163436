"""The page of one tab: what it shows, and what follows from a change."""

from collections.abc import Callable
from functools import partial
from typing import Any

from bokeh.document import Document
from bokeh.events import ClientReconnected, ConnectionLost, DocumentReady
from bokeh.models import CustomJS, Div, Toggle

from jaxshroud.explorer.centre import Centre
from jaxshroud.explorer.controls import Controls
from jaxshroud.explorer.diagram import OF_A_ROW, Amount, Window
from jaxshroud.explorer.exploration import Exploration
from jaxshroud.explorer.jobs import Methods, YieldingProgress, diagram_job, map_job, run_job, verdict_job
from jaxshroud.explorer.keeping import Keeping
from jaxshroud.explorer.look import (
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
from jaxshroud.explorer.run_panel import RunPanel
from jaxshroud.explorer.saves import OF_A_SERVER, template_variables
from jaxshroud.explorer.words import motion_html, status_html, verdict_html
from jaxshroud.explorer.worker import Continue, Worker
from jaxshroud.scene.checks import InputError, StepTooLongError
from jaxshroud.scene.parts import Direction

FINER = "finer"  # what follows a level that is not the last
WORKERS = "run", "diagram", "verdict", "saves"


class TabPage:
    """The page of one tab."""

    def __init__(self, document: Document, exploration: Exploration, accuracy: str, methods: Methods):
        """The page, which computes once its tab is there.

        Args:
            document: Of the tab.
            exploration: The scene from the start.
            accuracy: The accuracy from the start.
            methods: The methods of all tabs.
        """
        self.document, self.start, self.exploration, self.methods = document, exploration, exploration, methods
        self.selected, self.results = {}, {}
        self.amount = Amount() if exploration.file.row_size is None else OF_A_ROW
        self.workers = {name: Worker(partial(self._failed, name)) for name in WORKERS}
        self.recolouring, in_row = Recolouring(), exploration.file.row_size is not None
        self.controls = Controls(exploration, self.change, accuracy)
        self.controls.reset.on_click(lambda event: self.reset())
        self.controls.accuracy.on_change("value", lambda attr, old, new: self.compute())
        self.centre = Centre(exploration, self.recolouring, self)
        self.motion = RunPanel(self.recolouring, in_row)
        self.keeping = Keeping(self)
        self.status = Div(text=status_html("Ready"), **styled(), name="status_text")
        self._add_roots()
        self.workings: dict[str, str] = {}
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
            "right": above_each_other(self.motion.layout, self.keeping.layout),
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
        self.exploration, self.selected = self.start, {}
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
        self.compute_run()
        self.compute_diagram()

    def compute_run(self) -> None:
        """Compute the motion, and then its verdict."""
        try:
            exploration = self.shown
        except (InputError, KeyError) as error:
            self._say_failed("run", error)
            return
        method = partial(self.methods.method, self.exploration, self.controls.accuracy.value)
        self._working("run", "motion")
        self.workers["verdict"].cancel()
        self.workers["run"].submit(
            run_job(exploration, method, self.amount.motion, self._in_page(self.show_run, exploration))
        )

    def compute_diagram(self) -> None:
        """Compute the diagram, or the map where that is what is shown."""
        exploration, centre = self.exploration, self.centre
        method = partial(self.methods.method, exploration, self.controls.accuracy.value)
        self.results.pop("map" if centre.shows_map else "diagram", None)
        self._working("diagram", "choosing the method, or compiling its program")
        if centre.shows_map:
            across, up = centre.windows
            show = self._in_page(self._show_map, across, up)
            job = map_job(exploration, method, across, up, self.amount, self._progress, show)
        else:
            direction = centre.direction
            show = self._in_page(self.show_level, centre.window, direction)
            job = diagram_job(exploration, method, centre.window, direction, self.amount, self._progress, show)
        self.workers["diagram"].submit(job)

    def compute_verdict(self, exploration: Exploration) -> None:
        """Find the verdict, after all else."""
        method = partial(self.methods.method, self.exploration, self.controls.accuracy.value)
        first = lambda: self.workers["run"].busy or self.workers["diagram"].busy
        show = self._in_page(self._show_verdict)
        self.workers["verdict"].submit(verdict_job(exploration, method, first, show))

    def _progress(self, go_on: Continue, level: int) -> YieldingProgress:
        word = "coarse" if level == 0 else f"finer, level {level}"
        tell = lambda share: self.later(self._working, "diagram", f"{word}, {share:.0%}")
        return YieldingProgress(go_on, tell, lambda: self.workers["run"].busy)

    # What is shown

    def show_run(self, exploration: Exploration, run: Any) -> None:
        """Show the motion of a scene, and then find its verdict."""
        self.results["run"] = run
        self.motion.show(run)
        self.motion.heading.text = motion_html(run, self.selected, exploration.file)
        self.motion.verdict.text = verdict_html(None)
        self.centre.mark(self.selected, exploration.file)
        self.keeping.show_commands()
        self._working("run", "")
        self.compute_verdict(exploration)

    def show_level(self, window: Window, direction: Direction, level: int, added: Any, whole: Any) -> None:
        """Show a level of the diagram."""
        self.results["diagram"] = whole
        self.centre.show_level(window, direction, level, added, whole)
        self.keeping.show_commands()
        last = level + 1 == self.amount.levels or direction != "independent"
        self._working("diagram", "" if last else FINER)

    def _show_map(self, across: Window, up: Window, level: int, whole: Any) -> None:
        self.results["map"] = whole
        self.centre.map.show_cells(whole, across, up, level)
        self._working("diagram", "" if level + 1 == self.amount.map_levels else FINER)

    def _show_verdict(self, found: Any) -> None:
        self.results["verdict"] = found
        self.motion.verdict.text = verdict_html(found)

    def _working(self, what: str, words: str) -> None:
        self.workings[what] = words
        busy = [f"{name}: {word}" if name != word else name for name, word in self.workings.items() if word]
        self.status.text = status_html("; ".join(busy))

    def _failed(self, what: str, error: Exception) -> None:
        self.later(self._say_failed, what, error)

    def _say_failed(self, what: str, error: Exception) -> None:
        accuracy = self.controls.accuracy.value
        if isinstance(error, StepTooLongError) and self.chosen_anew != self.exploration:
            self.chosen_anew = self.exploration
            self.methods.forget(self.exploration, accuracy)
            self.compute()
            return
        self.workings[what] = ""
        message = error.args[0] if isinstance(error, KeyError) and error.args else error
        self.status.text = status_html("", f"{what}: {message}")

    def _in_page(self, show: Callable[..., None], *given: Any) -> Callable[..., None]:
        """A function that lets the thread of the page show something."""
        return lambda *found: self.later(show, *given, *found)

    def later(self, call: Callable[..., None], *arguments: Any) -> None:
        """Call this in the thread of the page."""
        if self.document.session_context is None:
            call(*arguments)
            return
        self.document.add_next_tick_callback(partial(call, *arguments))

    def close(self) -> None:
        """End all work."""
        for worker in self.workers.values():
            worker.close()


def heading_of(exploration: Exploration) -> str:
    """The title of the scene, or its name."""
    return exploration.file.title or exploration.file.name
