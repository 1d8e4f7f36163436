"""Which setting keeps an accuracy on given scenes: from a table measured on random scenes, and by trials."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxshroud.activity import counted
from jaxshroud.batch.periods import LANES_PER_CALL
from jaxshroud.batch.plan import Progress, Tick, Ticker
from jaxshroud.march.method import Choices
from jaxshroud.march.stability import stiffest, stiffness_ratio
from jaxshroud.orbits.short_runs import HORIZON, HorizonEnds, end_states, state_errors
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.signals.averages import least_tilt
from jaxshroud.verbs.accuracy import Choice, Setting, SettingTrial, accuracy_level, by_series, flat_return_for

STIFFNESS_CLASSES = (1.5, 4.0, 12.0, np.inf)  # upper bounds of omega_max over the largest frequency without contact
MAX_PROBED_LANES = 256  # on which a setting is tried before it is chosen
PROMISED_SHARE = 0.95  # of the lanes, for which an accuracy is promised
MAX_FINER_SETTINGS = 3  # tried beyond those of the table, each with half the step or a tenth of the tolerance
ERROR_MARGIN = 3.0  # an estimated error is one draw: where motions multiply errors, another may be larger by this
MAX_SHARE = 0.1  # of the trial steps of a run, for the choice of its method
LEAST_BUDGET = 10**6  # trial steps, for runs of pairs that are shorter than the choice: a few seconds
COARSE_ORDER, FINE_ORDER = 12, 14  # of series that the table does not have: each order is a program of its own
FINE_BELOW = 1e-8  # accuracies for which the finer order is taken
SERIES_SHARE = 0.01  # of an accuracy, as their tolerance
EXPECTED_TRIALS = 2
SLACK = 3.0  # in the proportion of errors to tolerances
LEAST_TOLERANCE = 1e-14  # which is tried in any case
PARALLEL_TILT = 0.1  # see `least_tilt`
TILTED, PARALLEL = 0, 1  # places in the table
EndStates = Callable[[Scene, int, Choices, Tick], HorizonEnds]
FORCE_PERTURBATION = 2.0**-50  # relative
ACCEPTABLE_RATIO = 2.0  # to the smallest error, if no error is small enough: the first such setting is taken


@cache
def _accuracy_table() -> list[list[dict[str, list]]]:
    """For tilted and for nearly parallel faces, and each class of stiffness: the promised levels, with settings."""
    return json.loads((Path(__file__).parent / "accuracy.json").read_text("utf-8"))


def choose(
    scenes: Scene,
    batch_dims: int,
    accuracy: str | float,
    *,
    lane_periods: float | int = math.inf,
    ends: EndStates = end_states,
) -> Choice:
    """The setting by which scenes are marched with an accuracy.

    The table says which setting is enough for scenes of such a stiffness and tilt. How much the motion itself
    multiplies errors, at impacts and between nearly parallel faces, differs from scene to scene. Each setting is
    therefore tried on some of the given scenes over three periods against a finer one, and a finer one is tried if its
    error is too large: as long as another trial like the last one stays within `MAX_SHARE` of the trial steps of the
    run that the choice is for, or within `LEAST_BUDGET`. These are counted, so that a choice is the same on every
    machine.

    Args:
        scenes: One scene, or many with leading axes: the stiffest one determines the step.
        batch_dims: The number of leading axes.
        accuracy: "fast", "balanced", "reference" or a number; see `NAMED`.
        lane_periods: Of the run that the choice is for; 0: the word of the table counts, if it has one.
        ends: Marches lanes to the horizon; best by the programs that the run needs.

    Returns:
        The cheapest setting that is accurate enough, promised; else about the best one, not promised; the finest that
        was tried where the budget has ended.

    Raises:
        ValueError: There is no such accuracy.
    """
    level = accuracy_level(accuracy)
    lanes = without_given(jax.tree.map(lambda a: np.reshape(a, (-1, *np.shape(a)[batch_dims:])), scenes))
    frequency_and_period = stiffest(lanes, 1)
    choices = []
    spent = 0
    has_table = lanes.row is None and lanes.contact.points is None and lanes.mode_numbers is None
    in_table = False
    candidates = _two_settings(level)
    if has_table:
        candidates, in_table = _candidates(lanes, level)
    first = Choice(level, candidates[0], candidates[0].steps(*frequency_and_period), in_table or None)
    if in_table and not lane_periods:
        return first
    probe = _probe(lanes, _affordable_lanes(len(lanes.drive.omega), lane_periods))
    least_budget = LEAST_BUDGET if lanes.row is None else 0  # a trial step of a row may take a hundred times as long
    if not (has_table or lane_periods):
        return replace(first, why="nothing is marched")
    shortest = 3 * HORIZON * len(probe.drive.omega) - MAX_SHARE * lane_periods
    if not has_table and first.steps * shortest > least_budget:
        return replace(first, why="a trial would take more than a tenth of the run")
    while candidates:
        setting, *candidates = candidates
        steps = setting.steps(*frequency_and_period)
        with counted("lane-periods of a trial of a method", 2 * HORIZON * len(probe.drive.omega)) as tick:
            trial = setting_trial(probe, setting, steps, ends, tick)
        error = ERROR_MARGIN * _promised_error(trial.errors)
        choices.append(Choice(level, setting, steps, error <= level, error, trial=trial))
        if choices[-1].promised:
            return choices[-1]
        candidates = [finer for finer in candidates if _may_suffice(finer, setting, error / level)]
        spent += trial.work
        of_run = trial.own_work / (HORIZON * len(trial.errors)) * lane_periods
        if candidates and spent + trial.work > max(MAX_SHARE * of_run, least_budget):
            return replace(choices[-1], curtailed=True)
    smallest = min(choice.reached for choice in choices)
    return next(choice for choice in choices if choice.reached <= ACCEPTABLE_RATIO * smallest)


def _setting(row: Sequence[Any]) -> Setting:
    """A setting of the table, whose last fields may be left out."""
    return Setting(**dict(zip(Setting._fields, row, strict=False)))


def _candidates(lanes: Scene, accuracy: float) -> tuple[list[Setting], bool]:
    """The settings of the table for an accuracy and for better ones, then finer ones; is it the table's first word?"""
    near = PARALLEL if least_tilt(lanes) < PARALLEL_TILT and lanes.parts.has("theta", 0) else TILTED
    rows = _accuracy_table()[near][: int(np.searchsorted(STIFFNESS_CLASSES, stiffness_ratio(lanes, 1))) + 1]
    settings = {float(level): _setting(setting) for level, setting in rows[-1].items()}
    sufficient = [settings[level] for level in sorted(settings, reverse=True) if level <= accuracy * 1.001]
    finest = [_setting(list(row.values())[-1]) for row in rows if row]
    begun = 4 * flat_return_for(accuracy)  # trials show whether this is enough
    found = [setting._replace(flat_return=begun) for setting in sufficient or finest[-1:]]
    found = [setting for pair in zip([found[0], *found], found, strict=False) for setting in _decades(*pair)]
    finer = [found[-1].finer(n) for n in range(1, MAX_FINER_SETTINGS + 1)]
    finer = [setting for setting in finer if setting.finer(1).tolerance < setting.tolerance / 2 or not setting.order]
    return list(dict.fromkeys([*found, *finer])), bool(sufficient)


def _two_settings(accuracy: float) -> list[Setting]:
    """The settings of rows, of faces of points and of blades by modes; the second is finer."""
    setting = by_series(FINE_ORDER if accuracy < FINE_BELOW else COARSE_ORDER, SERIES_SHARE * accuracy)
    setting = setting._replace(flat_return=flat_return_for(accuracy))
    return [setting, setting.finer(1)]


def _decades(coarse: Setting, fine: Setting) -> list[Setting]:
    """The finer of two settings; before it, if both are series, its order with the decades of tolerance between."""
    if not (coarse.order and fine.order):
        return [fine]
    first, last = round(math.log10(coarse.tolerance)), round(math.log10(fine.tolerance))
    return [*(fine._replace(tolerance=10.0**n) for n in range(first - 1, last, -1)), fine]


def _may_suffice(finer: Setting, tried: Setting, excess: float) -> bool:
    """Whether a setting may be fine enough where the one that was tried errs by a factor `excess` too much.

    The errors of power series of one order are about proportional to their tolerance.
    """
    same = finer.order == tried.order != 0
    return not same or finer.tolerance * excess <= SLACK * tried.tolerance or finer.tolerance <= LEAST_TOLERANCE


def _affordable_lanes(count: int, lane_periods: float | int) -> int:
    """On how many of the lanes settings are tried for a run of so many lane-periods: at least on a chunk."""
    width = 1 if count == 1 else LANES_PER_CALL
    trial = 2 * HORIZON * width  # with the finer setting, of the lanes that a call marches
    chunks = min(MAX_SHARE * lane_periods / (EXPECTED_TRIALS * trial), MAX_PROBED_LANES // width)
    return min(count, max(int(chunks), 1) * width)


def _probe(lanes: Scene, most: int) -> Scene:
    """At most so many of the lanes, evenly spread."""
    count = len(lanes.drive.omega)
    some = np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))
    return jax.tree.map(lambda a: np.asarray(a)[some], lanes)


def _promised_error(errors: np.ndarray) -> float:
    """The error that `PROMISED_SHARE` of the lanes keep, without lanes that stop."""
    finite = errors[np.isfinite(errors)]
    return float(np.quantile(finite, PROMISED_SHARE, method="higher")) if len(finite) else 0.0


def setting_trial(scenes: Scene, setting: Setting, steps: int, ends: EndStates, tick: Tick) -> SettingTrial:
    """The error of each lane (leading axis) by comparison with a finer march in float64.

    Both march to the horizon by `ends`. The finer march is driven by forces that are a few roundings larger, so that
    the growth of roundings counts too.
    """
    perturbed = eqx.tree_at(lambda s: s.drive, scenes, scenes.drive.scaled(1 + FORCE_PERTURBATION))
    own = ends(scenes, steps, setting.method, tick)
    finer = ends(perturbed, 2 * steps, setting.finer(1).exact.method, tick)
    return SettingTrial(scenes, ends, state_errors(own.motions, finer.motions), own.trials, own.trials + finer.trials)


def missed_lanes(scenes: Scene, choice: Choice, progress: Progress | None = None) -> np.ndarray:
    """Whether each lane (leading axis) may miss the accuracy: whether it differs too much from the finer march.

    Where the method was chosen by a trial of the same lanes, that trial says so.
    """
    trial = choice.trial
    lanes = without_given(scenes)
    if trial is None or not _are_same(lanes, trial.scenes):
        ends = end_states if trial is None else trial.ends
        ticker = Ticker(2 * HORIZON * len(lanes.drive.omega), progress)
        trial = setting_trial(lanes, choice.setting, choice.steps, ends, ticker)
    return ~(trial.errors <= choice.accuracy)


def _are_same(scenes: Scene, others: Scene) -> bool:
    """Whether scenes (leading axis) are the same ones in the same order."""
    values, of_others = jax.tree.leaves(scenes), jax.tree.leaves(others)
    alike = jax.tree.structure(scenes) == jax.tree.structure(others)
    return alike and all(map(np.array_equal, values, of_others))
