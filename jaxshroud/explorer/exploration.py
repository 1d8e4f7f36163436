"""What a page looks at: a scene with the changes that were made on the page, and its numbers that have fields."""

import math
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from jaxshroud.march.method import FAST, Method, Taylor, method_of
from jaxshroud.march.stability import lanes_that_auto_steps_follow, stiffest
from jaxshroud.march.tableau import TaylorOptions
from jaxshroud.orbits.short_runs import HorizonEnds, end_states
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.config import parse
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import grid_of_scenes
from jaxshroud.scene.keys import ALL_KEYS, Key, key_in
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.text import read_shown, shown_text
from jaxshroud.verbs.accuracy import accuracy_level
from jaxshroud.verbs.arguments import Asked, plan_march, resolve_options

Continue = Callable[[], None]  # to be called regularly: raises `Outdated` once the work is no longer wanted
# In the order of the page; of rivals a scene gives one.
FIELD_KEYS = (
    *("shroud.gap", "contact.gamma", "contact.k", "contact.width", "friction.mu", "friction.k_d"),
    *("drive.F_0", "drive.M_0", "drive.level", "drive.omega", "drive.f", "drive.speed", "drive.engine_order"),
    *("drive.F_x_mean", "drive.F_y_mean", "drive.M_mean"),
    *("shroud.alpha", "drive.beta", "blades.k_x", "blades.c_x"),
)
FIRST_FIELDS = 10  # that are open from the start
AROUND_VALUE = (
    "drive.omega",
    "drive.f",
    "drive.speed",
    "blades.k_x",
    "shroud.alpha",
)  # whose sliders do not begin at 0
SLIDER_STEPS = 200
REACH = 3.0  # of a slider, times the value
NICE_STEPS = (1.0, 2.0, 5.0, 10.0)
LEAST_SLID, MOST_SLID = 1e-100, 1e100  # values that a slider can have
DIGITS = 9  # of what a slider gives


class NumberField(NamedTuple):
    """A number of a scene on a page, in the unit that it is shown in."""

    key: Key
    value: float | None  # None: no slider, as it is one for each blade or interface, or beyond all sliders
    text: str  # the value, or all of them
    low: float
    high: float
    step: float

    @property
    def unit(self) -> str:
        """The unit that is shown."""
        return self.key.shown[0]

    @property
    def label(self) -> str:
        """What the number is, with its unit."""
        unit = f" [{self.unit}]" if self.unit else ""
        return f"{self.key.parts[1]}, {self.key.label}{unit}"

    @property
    def ends(self) -> tuple[float, float]:
        """The ends of the slider in SI units."""
        return in_si(self.key, self.low), in_si(self.key, self.high)

    def refusal(self, text: str) -> str | None:
        """What is wrong with a text whose number is out of the range of the key, in the unit that is shown."""
        try:
            values = np.ravel(read_shown(self.key, text))
        except ValueError:
            return None
        allowed, (unit, factor) = self.key.range, self.key.shown
        shown = allowed._replace(minimum=allowed.minimum * factor, maximum=allowed.maximum * factor)
        for value in map(float, values[~allowed.holds(values)]):
            said = f"{self.key.parts[1]} = {text.strip()} {shown.fault(value * factor)} {unit}".strip()
            return f"{said}; {self.text} is kept"
        return None


def in_si(key: Key, shown: float) -> float:
    """A number of few digits in the unit that is shown, as one would type it, in SI units."""
    return float(read_shown(key, f"{shown:.{DIGITS}g}"))


def few_digits(key: Key, value: float) -> float:
    """A value in SI units, rounded to few digits in the unit that is shown."""
    return in_si(key, value * key.shown[1])


def number_fields(file: SceneFile) -> list[NumberField]:
    """The fields of the numbers that a scene gives."""
    given = file.given_tables
    rows = [key_in(ALL_KEYS[name], file.layout) for name in FIELD_KEYS]
    return [_number_field(row, given[row.parts[0]][row.parts[1]], file) for row in rows if _gives(given, row)]


def _gives(given: dict, row: Key) -> bool:
    table, name = row.parts
    return given.get(table, {}).get(name) is not None


def _number_field(row: Key, value: Any, file: SceneFile) -> NumberField:
    text = shown_text(row, value)
    shown = math.nan if isinstance(value, list | tuple) else float(value) * row.shown[1]
    if shown and not LEAST_SLID < abs(shown) < MOST_SLID:
        return NumberField(row, None, text, 0.0, 1.0, 0.01)
    low, high = _slider_ends(row, shown, row.shown[1], file)
    step = _nice_step((high - low) / SLIDER_STEPS)
    low, high = math.floor(low / step) * step, math.ceil(high / step) * step
    low = max(low, step if row.range.open else row.range.minimum * row.shown[1])
    high = min(high, row.range.maximum * row.shown[1])
    return NumberField(row, shown, text, float(f"{low:.{DIGITS}g}"), float(f"{high:.{DIGITS}g}"), step)


def _slider_ends(row: Key, shown: float, factor: float, file: SceneFile) -> tuple[float, float]:
    """The ends of a slider: those of the scene's own sweep, or some way around the value, within the key's range."""
    axis = next((a for a in file.axes if a.key == row.name), None)
    if axis is not None:
        return float(np.min(axis.values)) * factor, float(np.max(axis.values)) * factor
    reach = REACH * abs(shown) or 1.0
    low, high = (0.5 * shown, 1.5 * shown) if row.name in AROUND_VALUE else (0.0 if shown >= 0 else -reach, reach)
    return max(low, row.range.minimum * factor), min(high, row.range.maximum * factor)


def _nice_step(step: float) -> float:
    power = 10.0 ** math.floor(math.log10(step))
    return float(f"{next(n for n in NICE_STEPS if n * power >= step * (1 - 1e-9)) * power:.6g}")


# Tables whose entries decide what is in a compiled program.
STRUCTURE_TABLES = ("parts", "row")
MAX_PAGE_ANGLE = 2e4  # omega_max times a drive period: some 1e5 steps, a minute of a diagram
STIFFENING = ("contact.gamma", "contact.k", "friction.k_d")


@dataclass(frozen=True, eq=False)
class Exploration:
    """A scene and the changes that were made to it on a page."""

    origin: str  # the scene as TOML, with the overrides of the command line
    name: str  # of the scene on the command line
    given: tuple[str, ...] = ()  # overrides of the command line
    changes: Mapping[str, str] = field(default_factory=dict)  # key -> text of its value

    def __reduce__(self) -> tuple[object, ...]:
        """What is sent to another process: not what was worked out."""
        return Exploration, (self.origin, self.name, self.given, dict(self.changes))

    @cached_property
    def overrides(self) -> list[str]:
        """The changes as overrides."""
        return [f"{key}={text}" for key, text in self.changes.items()]

    @cached_property
    def file(self) -> SceneFile:
        """The scene with its changes.

        Raises:
            SceneError: A change is wrong.
        """
        return parse(self.origin, self.name, self.overrides)

    def changed(self, key: str, text: str) -> "Exploration":
        """The same with another value of a key.

        Raises:
            SceneError: The value is wrong.
        """
        later = replace(self, changes={**self.changes, key: text})
        _ = later.file.scene, number_fields(later.file)  # raise what is wrong before anything is shown
        return later

    @property
    def structure(self) -> tuple[object, ...]:
        """What decides which program is compiled."""
        tables = self.file.tables
        return (*(repr(tables.get(table)) for table in STRUCTURE_TABLES), repr(tables["contact"].get("reading")))

    def toml(self) -> str:
        """The scene with its changes as a scene file."""
        return self.file.text()

    def command(self, verb: str, *words: str) -> str:
        """A command of a verb that computes what the page shows."""
        sets = [word for text in (*self.given, *self.overrides) for word in ("--set", text)]
        return shlex.join(["jaxshroud", verb, self.name, *sets, *words])


def method_on_page(file: SceneFile, accuracy: str | float, go_on: Continue = lambda: None) -> Method:
    """The method for an accuracy, with its steps: all that a page shows of a structure is marched by it.

    It is chosen for the scene; its steps also suit the upper ends of the sliders that make contact stiffer.

    Args:
        file: The scene.
        accuracy: The accuracy.
        go_on: Called before each trial: raises what ends the choice.

    Raises:
        InputError: The scene needs so many steps that a page would show nothing for minutes.
    """
    by_accuracy = Asked(accuracy_level(accuracy), by_argument=False)  # of smooth contact there is none
    resolved = resolve_options(file.scene, method=by_accuracy, verb="explore")
    _check_length(resolved.lanes)

    def ends(*of: Any) -> HorizonEnds:
        go_on()
        return end_states(*of)

    march = plan_march(resolved, resolved.lanes, FAST, ends=ends)
    numbers = [number for number in number_fields(file) if number.key.name in STIFFENING and number.value]
    stiffer = {n.key.name: np.array([in_si(n.key, n.value or 0.0), n.ends[1]]) for n in numbers}
    if isinstance(march.method.tableau, TaylorOptions) or not stiffer or file.tables["parts"]["contact"] == "none":
        return method_of(march.steps, march.method)
    largest = stiffest(grid_of_scenes(file.scene, stiffer), len(stiffer))[0]
    growth = max(largest / stiffest(resolved.lanes, 1)[0], 1.0)
    return method_of(math.ceil(growth * march.steps), march.method)


def _check_length(lanes: Scene) -> None:
    """Raise InputError where one drive period takes too long to march."""
    if lanes.parts.contact == "none":
        return  # in closed form
    if not lanes_that_auto_steps_follow(lanes).all():
        raise InputError("these numbers are too large, or a spring too stiff or a drive too slow, to march them")
    omega_max, period = stiffest(lanes, 1)
    if omega_max * period > MAX_PAGE_ANGLE:
        raise InputError(
            f"a drive period takes {omega_max * period / (2 * math.pi):.2g} vibrations of the stiffest spring, and a "
            f"page at most {MAX_PAGE_ANGLE / (2 * math.pi):.0f}; the command simulate marches it"
        )


def method_words(method: Method) -> list[str]:
    """The options of a command that name a method."""
    if isinstance(method, Taylor):
        words = ["--tableau", "taylor", "--order", str(method.order), "--step-tolerance", f"{method.tolerance:g}"]
    else:
        words = ["--tableau", method.tableau.name, "--locate", method.locate]
    precision = ["--precision", method.precision] if method.precision != "float64" else []
    return [*words, *precision, "--steps-per-period", str(method.steps)]
