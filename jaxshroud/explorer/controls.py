"""The left of the page: a field and a slider for each number, the choices, and the buttons."""

from collections.abc import Callable, Mapping
from typing import Any

from bokeh.models import Button, Div, Select, Slider, TextInput

from jaxshroud.explorer.exploration import DIGITS, FIRST_FIELDS, Exploration, NumberField, number_fields
from jaxshroud.explorer.messages import note_html
from jaxshroud.explorer.styles import above_each_other, beside, styled, wide
from jaxshroud.scene.layout import ACCURACIES, PAIR
from jaxshroud.scene.text import override_of

Change = Callable[[str, str], None]  # called with a key and the text of its value; raises InputError
CHOICES: Mapping[str, Mapping[str, str]] = {  # key -> words on the page -> text of the value
    "contact.reading": {"consistent": '"consistent"', "printed": '"printed"'},
    "parts.motion": {"x": '["x"]', "x, y": '["x","y"]', "x, y, theta": '["x","y","theta"]'},
    "parts.friction": {"bilinear": '"bilinear"', "none": '"none"'},
    "parts.contact": {"spring": '"spring"', "none": '"none"'},
    "parts.neighbour": {"blade": '"blade"', "rigid": '"rigid"'},
}
CHOICES_OF_ROWS = ("parts.motion", "parts.friction")  # choices that a row has too


class FieldWidgets:
    """The field of a number, with its slider and its message."""

    def __init__(self, number: NumberField, change: Change):
        self.number = number
        self.change = change
        self.silent = False
        style = wide()
        self.text = TextInput(title=number.label, value=number.text, name=f"field {number.key.name}", **style)
        self.message = Div(text="", visible=False, name=f"message {number.key.name}", **style)
        self.text.on_change("value", lambda attr, old, new: self._typed(new))
        self.slider = None
        if number.value is not None:
            ends = {"start": number.low, "end": number.high, "step": number.step}
            shown = {"title": None, "show_value": False, "value": number.value, "name": f"slider {number.key.name}"}
            self.slider = Slider(**ends, **shown, **style)
            self.slider.on_change("value_throttled", lambda attr, old, new: self._slid(new))
        widgets = [self.text, *([self.slider] if self.slider else []), self.message]
        self.layout = above_each_other(*widgets, margin=0)

    def _typed(self, text: str) -> None:
        """Take what was typed: a bare number is in the unit that is shown."""
        if self.silent:
            return
        key = self.number.key
        refusal = self.number.refusal(text)
        self.say(refusal or fault_of(lambda: self.change(key.name, override_of(key, text))))

    def _slid(self, shown: float) -> None:
        self._typed(f"{shown:.{DIGITS}g}")

    def say(self, message: str) -> None:
        """Show what is wrong with the field, or nothing."""
        self.message.update(text=note_html(message, wrong=True) if message else "", visible=bool(message))

    def show(self, number: NumberField) -> None:
        """Show another value."""
        self.silent = True
        self.number = number
        try:
            self.text.value = number.text
            if self.slider is not None and number.value is not None:
                low = min(self.slider.start, number.value)
                high = max(self.slider.end, number.value)
                self.slider.update(start=low, end=high, value=number.value)
            self.say("")
        finally:
            self.silent = False


def fault_of(change: Callable[[], None]) -> str:
    """What is wrong with a change, which is made unless it is refused; empty where nothing is."""
    try:
        change()
    except Exception as error:  # an absurd number can fail anywhere: the page stays as it was, and says so
        return str(error.args[0] if error.args else error).removeprefix("--set: ")
    return ""


class Controls:
    """The left of the page."""

    def __init__(self, exploration: Exploration, change: Change, accuracy: str):
        """The controls of a scene.

        Args:
            exploration: The scene.
            change: Called with a key and the text of its value.
            accuracy: The accuracy from the start.
        """
        self.change = change
        style = wide()
        numbers = number_fields(exploration.file)
        self.fields = {number.key.name: FieldWidgets(number, change) for number in numbers}
        layouts = [widgets.layout for widgets in self.fields.values()]
        self.silent = False
        in_row = exploration.file.layout != PAIR
        keys = [key for key in CHOICES if not in_row or key in CHOICES_OF_ROWS]
        self.choices = {
            key: Select(title=key, options=list(CHOICES[key]), name=f"choice {key}", width_policy="max", **style)
            for key in keys
        }
        for key, choice in self.choices.items():
            choice.on_change("value", lambda attr, old, new, key=key: self._chosen(key, new))
        accuracies: list[Any] = list(dict.fromkeys((accuracy, *ACCURACIES)))
        self.accuracy = Select(title="accuracy", value=accuracy, options=accuracies, name="accuracy", **style)
        self.wrong = Div(text="", visible=False, **style)
        self.reset = Button(label="Reset all", name="reset", **style)
        self.layout = above_each_other(
            *layouts[:FIRST_FIELDS],
            *self.choices.values(),
            self.accuracy,
            self.wrong,
            *layouts[FIRST_FIELDS:],
            self.reset,
        )
        self.show(exploration)

    def _chosen(self, key: str, words: str) -> None:
        if self.silent:
            return
        wrong = fault_of(lambda: self.change(key, CHOICES[key][words]))
        self.wrong.update(text=note_html(wrong, wrong=True) if wrong else "", visible=bool(wrong))

    def show(self, exploration: Exploration) -> None:
        """Show the numbers and the choices of a scene."""
        for number in number_fields(exploration.file):
            if number.key.name in self.fields:
                self.fields[number.key.name].show(number)
        tables = exploration.file.tables
        self.silent = True
        try:
            for key, choice in self.choices.items():
                table, name = key.split(".")
                value = tables[table].get(name)
                words = ", ".join(value) if isinstance(value, list | tuple) else str(value)
                choice.update(options=list(dict.fromkeys([*CHOICES[key], words])), value=words)
        finally:
            self.silent = False


def buttons(labels: Mapping[str, Callable[[], None]], **options: Any) -> Any:
    """A row of buttons: label -> what a click calls."""
    made = [Button(label=label, **styled(), name=label, width_policy="min") for label in labels]
    for button, call in zip(made, labels.values(), strict=True):
        button.on_click(lambda event, call=call: call())
    return beside(*made, **options)
