"""Basins of attraction: which motion each start of a plane ends on."""

from collections.abc import Sequence

import jax
import numpy as np

from jaxshroud.batch.runs import Progress, starts
from jaxshroud.march.method import Choices, Method
from jaxshroud.march.stability import Steps
from jaxshroud.motion.random_starts import SPREAD, reach
from jaxshroud.results.attractors import rows_of_attractors
from jaxshroud.results.basins import Basins
from jaxshroud.results.dimension import about, dimension
from jaxshroud.scene.checks import count_argument
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import grid_of_scenes
from jaxshroud.scene.keys import key_parts
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.attractors import aimed, found_from, paths


def basins(
    scene: Scene | SceneFile,
    plane: Sequence[str] = ("x[0]", "v_x[0]"),
    *,
    ranges: Sequence[tuple[float, float] | None] | None = None,
    num: int = 100,
    most_periods: int = 512,
    steps_per_period: Steps | None = None,
    method: Method | Choices | None = None,
    accuracy: str | float | None = None,
    progress: Progress | None = None,
) -> Basins:
    """Which of the coexisting motions each start of a plane ends on.

    Args:
        scene: One scene, or a scene file; its initial motion is that of all starts outside the plane.
        plane: Two numbers of the initial motion, such as "x[0]" and "v_x[0]".
        ranges: Of both, in SI units; None: what `attractors` draws its starts from.
        num: Values along each.
        most_periods: Drive periods after which a motion that has not settled on an orbit counts as aperiodic.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the scene needs.
        method: How to march; where only steps are given RK4, with events located by the guard's cubic.
        accuracy: "fast", "balanced" (the default where nothing is said of steps or method), "reference" or a number.
        progress: Called with (lane-periods done, at most).

    Returns:
        The attractors as `attractors` finds them, and that of each start. A start with overlapping blocks is an onset
        at once.

    Raises:
        InputError: The plane is not of two numbers of the initial motion, or a count is too small.
        Interrupted: Ctrl-C.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> js.basins(scene, num=3, steps_per_period=100).label.shape
        (3, 3)
    """
    count_argument("num", num, 2)
    keys = [f"initial.{name.removeprefix('initial.')}" for name in plane]
    if len(set(keys)) != 2:
        raise InputError(f"Argument `plane` must name two numbers of the initial motion, but is {', '.join(plane)}.")
    one, aim, told = aimed("basins", scene, most_periods, steps_per_period, method, accuracy)
    asked_for = ranges or (None, None)
    wide = reach(one)
    axes = {key: _values(key, wide, ends, num) for key, ends in zip(keys, asked_for, strict=True)}
    grid = grid_of_scenes(one, axes)
    states = starts(jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), grid))
    found = found_from(one, states, most_periods, aim, progress)
    values = rows_of_attractors(found, paths(found, one, aim))
    values |= {name: np.asarray(values[name]).reshape(num, num) for name in ("label", "status")}
    coords = {dimension(key): (dimension(key), v, about(key)) for key, v in axes.items()}
    return Basins.of_values(values, tuple(map(dimension, keys)), told, coords)


def _values(key: str, wide, ends: tuple[float, float] | None, num: int) -> np.ndarray:
    """The values along one number of the start."""
    _, name, blade = key_parts(key)
    most = SPREAD * float(np.max(getattr(wide, name)) if blade is None else getattr(wide, name)[blade])
    low, high = (-most, most) if ends is None else sorted(map(float, ends))
    if not low < high:
        raise InputError(f"The range of {key} is empty: {low:g} to {high:g}.")
    return np.linspace(low, high, num)
