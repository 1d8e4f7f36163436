"""What is kept of a page: copies of the scene and of commands, and files."""

from typing import Any

from bokeh.models import Button, CustomJS, Div, PreText, Select

from jaxshroud.explorer.exploration import method_words
from jaxshroud.explorer.jobs import SaveWish
from jaxshroud.explorer.messages import note_html
from jaxshroud.explorer.saves import OF_A_SERVER, SavedFile, download_source, static_page
from jaxshroud.explorer.styles import above_each_other, beside, styled

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


class Export:
    """The buttons that copy and save, below the motion."""

    def __init__(self, page: Any):
        self.page = page
        style = styled()
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
        options: list[Any] = [*RESULT_FILES, SCENE_FILE, PAGE_FILE]
        self.what = Select(title="save", value=options[0], options=options, name="what to save", width=150, **style)
        save = Button(label="Save", name="save", width=70, align="end", **style)
        save.on_click(lambda event: self.save())
        self.message = Div(text="", name="save message", tags=[self.download], **style)  # sent with it
        self.layout = above_each_other(
            beside(self.what, save, name=OF_A_SERVER),
            self.message,
            beside(*copies, name=OF_A_SERVER),
            self.command,
            self.sweep_command,
            self.toml,
        )

    def _copy_button(self, label: str, source: PreText) -> Button:
        button = Button(label=label, name=label, width_policy="min", **styled())
        code = "navigator.clipboard.writeText(source.text); button.label = 'Copied'; "
        code += "setTimeout(() => { button.label = label; }, 1500);"
        button.js_on_click(CustomJS(args={"source": source, "button": button, "label": label}, code=code))
        return button

    def show_commands(self) -> None:
        """Show the commands of what is shown now, and the scene."""
        page, window = self.page, self.page.centre.window
        found = page.methods.known(page.exploration, page.controls.accuracy.value)
        if found is None:  # another accuracy is being prepared
            return
        method = method_words(found)
        periods = str(page.amount.motion)
        self.command.text = page.shown.command("simulate", "--periods", periods, *method, "--out", "run.nc")
        self.toml.text = page.shown.toml()
        values = max(len(page.centre.diagram.lanes.data["value"]), 2)
        ends = ["--start", repr(window.start), "--stop", repr(window.stop), "--num", str(values)]
        length = ["--periods", str(page.amount.kept), "--transient", str(page.amount.transient)]
        words = ["--along", window.key, *ends, "--direction", page.centre.direction, *length, *method]
        self.sweep_command.text = page.exploration.command("sweep", *words, "--amplitudes", "--out", "diagram")

    def save(self) -> None:
        """Let the browser save what is chosen."""
        what, page = self.what.value, self.page
        if what == PAGE_FILE:
            self._give(SavedFile("page.html", static_page(page.document, page.heading, page.dark.active)))
        elif what == SCENE_FILE:
            self._give(SavedFile("scene.toml", page.shown.toml().encode()))
        else:
            kind, name = RESULT_FILES[what]
            result = page.results.get(kind)
            if result is None:
                self.message.text = note_html(f"There is no {kind} yet; look at it first.", wrong=True)
                return
            page.submit("saves", SaveWish(name, result), self._give)

    def refuse(self, error: Exception) -> None:
        """Say what was wrong with what was to be saved."""
        self.message.text = note_html(str(error), wrong=True)

    def _give(self, file: SavedFile) -> None:
        self.download.data = file.columns
        self.message.text = note_html(f"{file.name}, {len(file.content) / 1e3:.0f} kB")
