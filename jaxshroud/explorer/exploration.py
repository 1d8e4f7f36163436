"""What a page looks at: a scene with the changes that were made on the page, as a file and as a command."""

import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from jaxshroud.explorer.fields import in_si, number_fields
from jaxshroud.explorer.worker import Continue
from jaxshroud.march.method import FAST, Method, RungeKutta, Taylor, method_of
from jaxshroud.march.stability import lanes_that_auto_steps_follow, stiffest
from jaxshroud.march.tableau import TaylorOptions
from jaxshroud.motion.short_runs import end_states
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.config import parse
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import grid_of_scenes
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.asked import Asked
from jaxshroud.verbs.options import resolve_options
from jaxshroud.verbs.plan import plan_march
from jaxshroud.verbs.setting import accuracy_level

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
    smooth = file.tables["parts"]["contact"] == "smooth"
    by_accuracy = Asked(accuracy_level(accuracy), by_argument=False)
    resolved = resolve_options(file.scene, method=RungeKutta("rk4", "auto") if smooth else by_accuracy, verb="explore")
    _check_length(resolved.lanes)

    def ends(*of: Any) -> np.ndarray:
        go_on()
        return end_states(*of)

    march = plan_march(resolved, resolved.lanes, FAST, periods=math.inf, ends=ends)
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
