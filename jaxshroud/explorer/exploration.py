"""What a page looks at: a scene with the changes that were made on the page, as a file and as a command."""

import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from jaxshroud.explorer.fields import in_si, number_fields
from jaxshroud.march.method import FAST, Method, RungeKutta, Taylor, method_of
from jaxshroud.march.stability import stiffest
from jaxshroud.march.tableau import TaylorOptions
from jaxshroud.scene.config import parse
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import grid_of_scenes
from jaxshroud.verbs.options import plan_march, resolve_options
from jaxshroud.verbs.row_accuracy import row_choice

# Tables whose entries decide what is in a compiled program.
STRUCTURE_TABLES = ("parts", "row")
STIFFENING = ("contact.gamma", "contact.k", "friction.k_d")


@dataclass(frozen=True, eq=False)
class Exploration:
    """A scene and the changes that were made to it on a page."""

    origin: str  # the scene as TOML, with the overrides of the command line
    name: str  # of the scene on the command line
    given: tuple[str, ...] = ()  # overrides of the command line
    changes: Mapping[str, str] = field(default_factory=dict)  # key -> text of its value

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


def method_on_page(file: SceneFile, accuracy: str | float) -> Method:
    """The method for an accuracy, with its steps: all that a page shows of a structure is marched by it.

    It is chosen for the scene; its steps also suit the upper ends of the sliders that make contact stiffer.
    """
    smooth = file.tables["parts"]["contact"] == "smooth"
    wish = RungeKutta("rk4", "auto") if smooth else accuracy
    if file.row_size is not None and not smooth:
        wish = method_of("auto", row_choice(accuracy, asked=False).method)
    resolved = resolve_options(file.scene, method=wish, verb="explore", rows=True)
    march = plan_march(resolved, resolved.lanes, FAST, periods=math.inf)
    numbers = [number for number in number_fields(file) if number.key.name in STIFFENING and number.value]
    stiffer = {n.key.name: np.array([in_si(n.key, n.value or 0.0), n.ends[1]]) for n in numbers}
    if isinstance(march.method.tableau, TaylorOptions) or not stiffer or file.tables["parts"]["contact"] == "none":
        return method_of(march.steps, march.method)
    largest = stiffest(grid_of_scenes(file.scene, stiffer), len(stiffer))[0]
    growth = max(largest / stiffest(resolved.lanes, 1)[0], 1.0)
    return method_of(math.ceil(growth * march.steps), march.method)


def method_words(method: Method) -> list[str]:
    """The options of a command that name a method."""
    if isinstance(method, Taylor):
        words = ["--tableau", "taylor", "--order", str(method.order), "--step-tolerance", f"{method.tolerance:g}"]
    else:
        words = ["--tableau", method.tableau.name, "--locate", method.locate]
    precision = ["--precision", method.precision] if method.precision != "float64" else []
    return [*words, *precision, "--steps-per-period", str(method.steps)]
