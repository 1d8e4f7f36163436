"""How to march for an accuracy that is asked for: from a table measured on random scenes.

`python tests/benchmarks/accuracy.py` measures `accuracy.json` anew: for every class of stiffness and every level, the
cheapest setting that all but 2 % of its lanes meet with a margin of three.
"""

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import jax
import numpy as np

from jaxshroud.integrate import Method
from jaxshroud.scene import Scene
from jaxshroud.setting import LEVELS, Setting, end_states, state_errors
from jaxshroud.stability import stiffest, stiffness_ratio

NAMED = {"fast": 1e-3, "balanced": 1e-6, "reference": 1e-10}
CLASSES = (1.5, 4.0, 12.0, np.inf)  # upper bounds of omega_max over the largest frequency without contact


@dataclass(frozen=True)
class Choice:
    """A setting chosen for an accuracy."""

    accuracy: float  # of the state after three periods, relative to its largest number, for 95 % of lanes
    setting: Setting
    steps: int
    promised: bool  # False: in scenes so stiff errors grow too fast for it, and this is the best there is

    @property
    def method(self) -> Method:
        """The static choices of the march, without a ledger."""
        return self.setting.method

    def __str__(self) -> str:
        doubt = "" if self.promised else "; not promised in a scene so stiff"
        return f"accuracy {self.accuracy:.0e}: {self.setting} (omega_max h), {self.steps} steps a period{doubt}"


@cache
def _table() -> list[dict[str, list]]:
    """For each class of stiffness: levels that can be promised, with tableau, locator, precision and omega_max h."""
    return json.loads((Path(__file__).parent / "accuracy.json").read_text("utf-8"))


def level(asked: str | float) -> float:
    """The accuracy that a name or a number stands for.

    Raises:
        ValueError: It is no name, and no number from 1e-10 to 1e-2.
    """
    try:
        value = NAMED[asked] if asked in NAMED else float(asked)  # type: ignore[index]
    except ValueError:
        value = np.nan
    if not LEVELS[-1] * 0.999 <= value <= LEVELS[0] * 1.001:
        raise ValueError(f"must be {', '.join(NAMED)} or a number from 1e-10 to 1e-2, but is {asked!r}")
    return value


def choose(scenes: Scene, batch_dims: int, asked: str | float) -> Choice:
    """How to march for an accuracy.

    Args:
        scenes: One scene, or many with so many leading dimensions: the stiffest decides.
        batch_dims: How many those are.
        asked: "fast", "balanced", "reference" or a number; see `NAMED`.

    Returns:
        The cheapest setting of the table at that level or a finer one; the finest where none is promised to be enough.

    Raises:
        ValueError: There is no such accuracy.
    """
    wanted = level(asked)
    row = _table()[int(np.searchsorted(CLASSES, stiffness_ratio(scenes, batch_dims)))]
    able = {float(at): Setting(*setting) for at, setting in row.items()}
    fine_enough = [at for at in able if at <= wanted * 1.001]
    setting = able[max(fine_enough) if fine_enough else min(able)]
    return Choice(wanted, setting, setting.steps(*stiffest(scenes, batch_dims)), bool(fine_enough))


def estimated_errors(scenes: Scene, choice: Choice) -> np.ndarray:
    """Error of each lane (leading axis) by comparison with half the step in float64: which lanes break the promise."""
    finer = Setting(choice.setting.tableau, "cubic", "float64", choice.setting.product / 2)
    fine = end_states(scenes, 2 * choice.steps, finer.method)
    return state_errors(end_states(scenes, choice.steps, choice.method), fine)


def broken(scenes: Scene, choice: Choice) -> np.ndarray:
    """Which lanes (leading axis) do not meet the accuracy, by their estimated errors."""
    flat = jax.tree.map(np.asarray, scenes)
    return ~(estimated_errors(flat, choice) <= choice.accuracy)
