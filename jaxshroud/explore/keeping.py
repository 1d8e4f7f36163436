"""What is kept of a page: copies of the scene and of commands, and files."""

from collections.abc import Callable
from typing import Any

from bokeh.layouts import column, row
from bokeh.models import Button, CustomJS, Div, PreText, Select

from jaxshroud.explore.exploration import method_words
from jaxshroud.explore.look import widget_style
from jaxshroud.explore.saves import SavedFile, download_source, result_file, static_page
from jaxshroud.explore.words import note_html
from jaxshroud.scene.checks import InputError

RESULT_FILES = {
    "diagram, NetCDF": ("diagram", "diagram.nc"),
    "diagram, PNG": ("diagram", "diagram.png"),
    "diagram, SVG": ("diagram", "diagram.svg"),
    "motion, NetCDF": ("run", "run.nc"),
    "motion, PNG": ("run", "run.png"),
    "motion, SVG": ("run", "run.svg"),
    "verdict, NetCDF": ("verdict", "diagnosis.nc"),
    "verdict, PNG": ("verdict", "diagnosis.png"),
    "map, NetCDF": ("map", "map.nc"),
    "map, PNG": ("map", "map.png"),
    "map, SVG": ("map", "map.svg"),
}
SCENE_FILE, PAGE_FILE = "scene, TOML", "this page, HTML"


class Keeping:
    """The buttons that copy and save, below the motion."""

    def __init__(self, page: Any):
        self.page, style = page, {"stylesheets": [widget_style()]}
        self.download = download_source()
        self.toml, self.command = (PreText(text="", name=name, **style) for name in ("toml", "command"))
        self.sweep_command = PreText(text="", name="sweep command", **style)
        self.toml.visible = False
        copies = [
            self._copy_button(label, source)
            for label, source in {
                "Copy as TOML": self.toml,
                "Copy the motion's command": self.command,
                "Copy the diagram's command": self.sweep_command,
            }.items()
        ]
        options = [*RESULT_FILES, SCENE_FILE, PAGE_FILE]
        self.what = Select(title="save", value=options[0], options=options, name="what to save", width=150, **style)
        save = Button(label="Save", name="save", width=70, align="end", **style)
        save.on_click(lambda event: self.save())
        self.message = Div(text="", name="save message", **style)
        wrap: dict[str, Any] = {"styles": {"flex-wrap": "wrap"}, "sizing_mode": "stretch_width"}
        self.layout = column(
            row(self.what, save, **wrap), self.message, row(*copies, **wrap), self.command, self.sweep_command, self.toml,
            sizing_mode="stretch_width",
        )  # fmt: skip

    def _copy_button(self, label: str, source: PreText) -> Button:
        button = Button(label=label, name=label, width_policy="min", stylesheets=[widget_style()])
        code = "navigator.clipboard.writeText(source.text); button.label = 'Copied'; "
        code += "setTimeout(() => { button.label = label; }, 1500);"
        button.js_on_click(CustomJS(args={"source": source, "button": button, "label": label}, code=code))
        return button

    def show(self, run_command: str) -> None:
        """Show the commands of what is shown now, and what the scene is."""
        page, window = self.page, self.page.centre.window
        self.command.text = run_command
        self.toml.text = page.shown.toml()
        method = page.methods.method(page.exploration, page.controls.accuracy.value)
        direction = page.centre.direction
        values = max(len(page.centre.diagram.lanes.data["value"]), 2)
        words = [
            "--along",
            window.key,
            "--start",
            repr(window.start),
            "--stop",
            repr(window.stop),
            "--num",
            str(values),
        ]
        length = ["--periods", str(page.length.kept), "--transient", str(page.length.transient)]
        words += ["--direction", direction, *length, *method_words(method), "--amplitudes", "--out", "diagram"]
        self.sweep_command.text = page.exploration.command("sweep", *words)

    def save(self) -> None:
        """Let the browser save what is chosen."""
        what, page = self.what.value, self.page
        if what == PAGE_FILE:
            self._give(SavedFile("page.html", static_page(page.document, page.heading)))
        elif what == SCENE_FILE:
            self._give(SavedFile("scene.toml", page.shown.toml().encode()))
        else:
            kind, name = RESULT_FILES[what]
            result = page.results.get(kind)
            if result is None:
                self.message.text = note_html(f"There is no {kind} yet; look at it first.", wrong=True)
                return
            page.workers["saves"].submit(self._job(lambda: result_file(name, result)))

    def _job(self, make: Callable[[], SavedFile]) -> Callable[[Any], None]:
        def job(go_on: Callable[[], None]) -> None:
            try:
                made = make()
            except InputError as error:
                self.page.later(self._refuse, error)
                return
            go_on()
            self.page.later(self._give, made)

        return job

    def _refuse(self, error: Exception) -> None:
        self.message.text = note_html(str(error), wrong=True)

    def _give(self, file: SavedFile) -> None:
        self.download.data = file.columns
        self.message.text = note_html(f"{file.name}, {len(file.content) / 1e3:.0f} kB")
