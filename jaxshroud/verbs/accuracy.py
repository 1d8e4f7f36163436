"""How to march for an accuracy that is asked for: from a table measured on random scenes, and a trial of the scene.

`python tests/benchmarks/accuracy.py` measures `accuracy.json` anew: for every class of stiffness and every level, the
cheapest setting that all but 2 % of its lanes meet with a margin of three.
"""

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

from jaxshroud.march.method import Choices
from jaxshroud.march.stability import stiffest, stiffness_ratio
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.setting import LEVELS, Setting, end_states, state_errors

NAMED = {"fast": 1e-3, "balanced": 1e-6, "reference": 1e-10}
CLASSES = (1.5, 4.0, 12.0, np.inf)  # upper bounds of omega_max over the largest frequency without contact


PROBED = 256  # lanes, at most, on which a setting is tried before it is chosen
SHARE = 0.95  # of the lanes, for which an accuracy is promised
FINER = 3  # settings tried beyond the table's, each of half the step or a tenth of the tolerance
SURE = 3.0  # an estimated error is one draw: where motions multiply errors, another may be so many times as large
ROUNDINGS = 2.0**-50  # relative, of forces
ABOUT = 2.0  # times the least error is as good, where none is small enough


@dataclass(frozen=True)
class Choice:
    """A setting chosen for an accuracy."""

    accuracy: float  # of the state after three periods, relative to its largest number, for 95 % of lanes
    setting: Setting
    steps: int
    promised: bool  # False: it is not to be had, and this is about the best there is
    reached: float = np.nan  # error that so many of the probed lanes stay below, by comparison with a finer march

    @property
    def method(self) -> Choices:
        """The static choices of the march, without a ledger."""
        return self.setting.method

    def __str__(self) -> str:
        product = "" if self.setting.order else " (omega_max h)"
        told = f"accuracy {self.accuracy:.0e}: {self.setting}{product}, {self.steps} steps a period"
        if self.promised:
            return told
        best = f"{self.reached:.0e} is the best for 95 % of runs"
        return f"{told}; not to be had: {best}, as impacts multiply errors and flat contact drops its rocking"


@cache
def _table() -> list[dict[str, list]]:
    """For each class of stiffness: levels that can be promised, with the numbers of a `Setting`."""
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
        raise InputError(f"must be {', '.join(NAMED)} or a number from 1e-10 to 1e-2, but is {asked!r}")
    return value


def choose(scenes: Scene, batch_dims: int, asked: str | float) -> Choice:
    """How to march for an accuracy.

    The table says what is enough for scenes of such a stiffness. How much the motion itself multiplies errors, at
    impacts and between nearly parallel faces, differs from scene to scene: each setting is tried on the scenes at hand
    over three periods against a finer one, and that taken where it misses.

    Args:
        scenes: One scene, or many with so many leading dimensions: the stiffest decides on the step.
        batch_dims: How many those are.
        asked: "fast", "balanced", "reference" or a number; see `NAMED`.

    Returns:
        The cheapest setting that was enough; the best where none was, not promised.

    Raises:
        ValueError: There is no such accuracy.
    """
    wanted = level(asked)
    lanes = jax.tree.map(lambda a: np.reshape(a, (-1, *np.shape(a)[batch_dims:])), scenes)
    probe, turn, tried = _probe(lanes), stiffest(lanes, 1), []
    for setting in _candidates(lanes, wanted):
        steps = setting.steps(*turn)
        error = SURE * _shared(estimated_errors(probe, setting, steps))
        tried.append(Choice(wanted, setting, steps, error <= wanted, error))
        if tried[-1].promised:
            return tried[-1]
    least = min(choice.reached for choice in tried)
    return next(choice for choice in tried if choice.reached <= ABOUT * least)


def _candidates(lanes: Scene, wanted: float) -> list[Setting]:
    """Settings of the table for an accuracy and finer ones, and others beyond these."""
    row = _table()[int(np.searchsorted(CLASSES, stiffness_ratio(lanes, 1)))]
    able = {float(at): Setting(*setting) for at, setting in row.items()}
    enough = [able[at] for at in sorted(able, reverse=True) if at <= wanted * 1.001] or [able[min(able)]]
    finer = [enough[-1].finer(n) for n in range(1, FINER + 1)]
    finer = [setting for setting in finer if setting.finer(1).tolerance < setting.tolerance / 2 or not setting.order]
    return list(dict.fromkeys([*enough, *finer]))


def _probe(lanes: Scene) -> Scene:
    """Some of the lanes, evenly spread."""
    count = len(lanes.drive.omega)
    some = np.unique(np.linspace(0, count - 1, min(count, PROBED)).astype(int))
    return jax.tree.map(lambda a: np.asarray(a)[some], lanes)


def _shared(errors: np.ndarray) -> float:
    """The error that so many lanes stay below; those that stop have none."""
    known = errors[np.isfinite(errors)]
    return float(np.quantile(known, SHARE, method="higher")) if len(known) else 0.0


def estimated_errors(scenes: Scene, setting: Setting, steps: int) -> np.ndarray:
    """Error of each lane (leading axis) by comparison with a finer march in float64; NaN where it stops.

    That one is driven by forces a few roundings larger: how much the motion multiplies roundings is an error too.
    """
    finer, loads = setting.finer(1).exact.method, lambda scenes: (scenes.drive.F_0, scenes.drive.M_0)
    nudged = eqx.tree_at(loads, scenes, replace_fn=lambda a: np.asarray(a) * (1 + ROUNDINGS))
    return state_errors(end_states(scenes, steps, setting.method), end_states(nudged, 2 * steps, finer))


def broken(scenes: Scene, choice: Choice) -> np.ndarray:
    """Which lanes (leading axis) do not meet the accuracy, by their estimated errors."""
    flat = jax.tree.map(np.asarray, scenes)
    return ~(estimated_errors(flat, choice.setting, choice.steps) <= choice.accuracy)
