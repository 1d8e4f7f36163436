"""What a report is asked for: limits, scatter and conditions, merged with those of a tuning, and their checks."""

import math
from collections.abc import Mapping, Sequence
from itertools import product

import jax
import numpy as np

from jaxshroud.motion.levels import check_resonance, check_vibration
from jaxshroud.results.tuned import Tuned
from jaxshroud.scene.checks import InputError, count_argument, seed_argument
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.quantities import RequiredReduction, check_quantity
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.vary import value_of, with_numbers
from jaxshroud.verbs.design_problem import check_condition, design_corners, problem_of
from jaxshroud.verbs.options import ResolvedOptions
from jaxshroud.verbs.report_sections import Limits
from jaxshroud.verbs.scatter import check_at_least, draw_rows
from jaxshroud.verbs.scattering import Spread, scatter_bounds

Bounds = Mapping[str, tuple[float, float]]
Conditions = Mapping[str, Sequence[float]]


def report_request(
    scene: Scene,
    limits: Limits,
    scatters: Mapping[str, Spread],
    conditions: Conditions,
    tuned: Tuned | None,
    of: RequiredReduction | None = None,
) -> tuple[Limits, dict[str, tuple[float, float]], dict[str, Sequence[float]]]:
    """The limits, the bounds of numbers that scatter and the conditions of a report, merged with those of a tuning.

    Raises:
        KeyError: The scene has no such number.
        InputError: A half width is not positive.
    """
    bounds = scatter_bounds(scene, scatters)
    if tuned is None:
        return limits, bounds, dict(conditions)
    own_bounds = tuned.ends_of_scatter({key: value_of(scene, key) for key in tuned.scatters})
    limits = Limits(
        tuned.at_least if limits.at_least is None and of in (None, tuned.quantity) else limits.at_least,
        min(limits.most_force, tuned.most_force),
        min(limits.most_penetration, tuned.most_penetration),
    )
    return limits, own_bounds | bounds, {**tuned.conditions, **conditions}


def varied_by(scene: Scene, scatters: Bounds, conditions: Conditions) -> Scene:
    """The scenes (leading axis) of a report: the design in all its conditions, and at the ends of its scatter.

    Raises:
        KeyError: The scene has no such number.
        ValueError: A value is out of its range, or there is none.
    """
    scene = with_numbers(scene, list(dict.fromkeys([*scatters, *conditions])))
    for key, values in conditions.items():
        check_condition(key, values, scene.layout)
    in_conditions = scenes_at(scene, list(conditions), np.array(list(product(*conditions.values())), float))
    if not scatters:
        return in_conditions
    at_ends = design_corners(problem_of(scene, scatters, {}))
    return jax.tree.map(lambda *a: np.concatenate(a), in_conditions, at_ends)


def check_report(
    scene: Scene,
    resolved: ResolvedOptions,
    limits: Limits,
    scatters: Bounds,
    conditions: Conditions,
    counts: tuple[int, int, int],
    of: RequiredReduction = "P_d",
) -> None:
    """Raise an InputError for arguments that a part of the report would refuse, or could say nothing about.

    Args:
        scene: The design.
        resolved: The resolved arguments that all verbs share.
        limits: The limits that are to be kept.
        scatters: Keys of numbers that scatter, with their bounds.
        conditions: Keys of operating conditions, with their values.
        counts: Draws of the scatter, random starts, and the seed of both.
        of: The reduction that is judged.
    """
    check_quantity(of, scene.parts, scene.layout)
    draws, starts, seed = counts
    for name in ("most_force", "most_penetration"):
        if not (value := getattr(limits, name)) > 0:
            raise InputError(f"Argument `{name}` must be positive, but is {value}.")
    check_at_least(limits.at_least)
    count_argument("starts", starts, 1)
    seed_argument(seed)
    if scatters:
        draw_rows(scene, scatters, limits.at_least, draws, seed, resolved, math.prod(map(np.size, conditions.values())))
    in_conditions = varied_by(scene, {}, conditions)
    check_vibration(of, in_conditions)
    check_resonance(of, in_conditions)
