"""Derivatives of the vibration-power reduction of a scene, or of many, and a check of them."""

from collections.abc import Sequence
from functools import partial
from typing import Literal

import numpy as np

from jaxshroud.batch.extent import fits
from jaxshroud.batch.runs import Plan, Progress
from jaxshroud.batch.threads import Interrupted
from jaxshroud.march.method import Choices, Method
from jaxshroud.march.stability import Steps
from jaxshroud.model.state import State
from jaxshroud.motion.gradient import Of, Slope, Smoothing, differences_on, slope_of, slope_on_orbit, with_numbers
from jaxshroud.motion.orbit import Cycle
from jaxshroud.motion.shooting import TOLERANCE, Aim
from jaxshroud.motion.together import alone_found, together
from jaxshroud.results.gradient import Gradient
from jaxshroud.results.orbit import Orbit
from jaxshroud.scene.checks import count_argument, positive_argument, word_argument
from jaxshroud.scene.errors import InputError
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.vary import numbers_that_count, value_of
from jaxshroud.verbs.lanes import Lanes, lanes_of, of_all, told
from jaxshroud.verbs.orbit import cycles_of


def gradient(
    scene: Scene | SceneFile,
    wrt: Sequence[str] | Literal["all"],
    *,
    of: Of = "P_d",
    at: Orbit | None = None,
    sigma: float = 0.01,
    pairs: int = 128,
    seed: int = 0,
    most_periods: int = 512,
    n_periods: int | None = None,
    transient: int | None = None,
    steps_per_period: Steps | None = None,
    method: Method | Choices | None = None,
    accuracy: str | float | None = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
    dims: Sequence[str] | None = None,
) -> Gradient:
    """Gradient of the left blade's P_d, or of P, with respect to numbers of the scene.

    Where the scene settles on a periodic orbit the gradient is exact, by the implicit function theorem. Elsewhere it is
    the gradient of the average over a normal distribution of the parameters around their values, with an interval.

    Args:
        scene: One scene, or many with leading axes, which then come first in all results; or a scene file, whose [run]
            counts where an argument is not given.
        wrt: Keys as for `vary`; without a blade's index both blades change together. "all": every number that the
            motion may depend on; see `Gradient.effects`.
        of: What to differentiate.
        at: The orbit, or orbits, where they are known already; how they were marched is then the default.
        sigma: Standard deviation of that distribution, relative to each parameter's value.
        pairs: Antithetic pairs of samples; all samples start from the scene's initial state.
        seed: Of the samples.
        most_periods: Drive periods after which a motion that has not repeated counts as aperiodic.
        n_periods: Drive periods that each sample's P_d is averaged over; by default 64.
        transient: Drive periods each sample runs before; by default 64.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs, as where only a
            method is given.
        method: How to march; where only steps are given RK4, with events located by the guard's cubic.
        accuracy: "fast", "balanced" (the default where nothing is said of steps or method), "reference" or a number:
            chooses steps and method, in float64.
        state: Where the run to the orbit starts, at drive phase 0; by default `scene.initial`, apart.
        progress: Called with (lane-periods done, lane-periods at most) while orbits are looked for.
        throw: Raise where a lane has no derivative, rather than flag it.
        dims: Names of the leading axes; by default `lane`.

    Returns:
        The derivatives and what they are worth. A lane that has none has NaN and a flag; the others are not affected.

    Raises:
        KeyError: The scene has no such number.
        ValueError: There is no such `of`, a count is too small, `sigma` is not positive, or a smoothed derivative is
            asked for with respect to a number that is 0.
        NumericalError: With `throw`, or of a single scene: the march stops in this scene or in nearly all of its
            neighbourhood.
        LinAlgError: With `throw`, or of a single scene: the orbit's equations cannot be solved.

    Source:
        dP/dp = P_p + P_z (I - M)^-1 Phi_p for the fixed point z of the flow Phi over the orbit's periods.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> found = js.gradient(scene, ["shroud.gap"], steps_per_period=100)
        >>> found.kind, found.ci
        ('periodic', {'shroud.gap': 0.0})
    """
    word_argument("of", of, Of)
    positive_argument("sigma", sigma)
    count_argument("most_periods", most_periods, 1)
    if at is not None and steps_per_period is None and method is None and accuracy is None:
        steps_per_period, method = at.steps_per_period, at.method
    lanes = lanes_of(
        scene,
        n_periods=n_periods,
        transient=transient,
        steps_per_period=steps_per_period,
        method=method,
        accuracy=accuracy,
        dims=dims,
    )
    throw, march = throw or not lanes.shape, lanes.how
    if isinstance(wrt, str):
        wrt = numbers_that_count(lanes.asked.scene) if wrt == "all" else (wrt,)
    numbered = [with_numbers(one, wrt) for one in lanes.scenes]
    aim = Aim(march.steps, TOLERANCE[march.method.precision], march.method)
    plan = Plan(lanes.asked.transient, lanes.asked.n_periods, march.steps, 0.0, march.method)
    way = Smoothing(sigma, pairs, plan, seed)
    try:
        cycles = (
            cycles_of(lanes.begun(numbered, state), None, most_periods, aim, progress, throw)
            if at is None
            else _known(at, lanes)
        )
        if not all(cycle.sound or "stopped" in cycle.flags for cycle in cycles):
            count_argument("pairs", pairs, 2)
            fits(2 * pairs, plan.transient, plan.kept)
        tried = [slope_of(one, wrt, of, cycle, way) for one, cycle in zip(numbered, cycles, strict=True)]
        slopes = of_all(lambda: together(tried), partial(_missing, cycles, len(wrt)), throw)
    except Interrupted:
        raise Interrupted(None) from None
    orbits = Orbit.of_cycles(cycles, lanes.shape, **lanes.about) if at is None else at
    numbers = [[value_of(one, key) for key in wrt] for one in numbered]
    return told(Gradient.of_slopes(slopes, wrt, of, orbits, numbers, **lanes.about), throw)


def _known(at: Orbit, lanes: Lanes) -> list[Cycle]:
    if np.shape(at.q) != lanes.shape:
        raise InputError(f"Argument `at` has lanes {np.shape(at.q)}, but the scene has {lanes.shape}.")
    return at.cycles


def _missing(cycles: list[Cycle], size: int, lane: int, flag: str) -> Slope:
    """What is told of a lane without a derivative."""
    nothing = np.full(size, np.nan)
    cycle = cycles[lane]
    flags = tuple(dict.fromkeys((*cycle.flags, flag)))
    return Slope("none", nothing, nothing, np.nan, np.nan, cycle, np.nan, np.nan, flags)


def on_orbit(found: Orbit, wrt: Sequence[str], of: Of = "P_d") -> Gradient:
    """The exact gradient on the orbit of a single scene; ValueError if there is no such `of`."""
    word_argument("of", of, Of)
    cycle = found.cycle()
    numbers = [[value_of(cycle.scene, key) for key in wrt]]
    return Gradient.of_slopes([alone_found(slope_on_orbit(cycle, wrt, of))], wrt, of, found, numbers)


def differences(found: Orbit, wrt: Sequence[str], step: float, of: Of = "P_d") -> dict[str, float]:
    """Fourth-order central differences of `of` on orbits followed from scene to scene: a check of `gradient`.

    Args:
        found: The orbit of a single scene.
        wrt: Keys as for `gradient`.
        step: Relative to each parameter's value, or absolute where that is 0.
        of: What to differentiate.

    Returns:
        The derivative with respect to each key; NaN where an orbit so near does not close.

    Raises:
        ValueError: There is no such `of`, the step is not positive, or there are orbits of many scenes.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> found = js.orbit(scene, steps_per_period=100)
        >>> exact = js.gradient(scene, ["shroud.gap"], at=found).value["shroud.gap"]
        >>> abs(js.differences(found, ["shroud.gap"], 1e-4)["shroud.gap"] / exact - 1) < 1e-6
        True
    """
    word_argument("of", of, Of)
    positive_argument("step", step)
    return differences_on(found.cycle(), wrt, step, of)
